# Copyright 2026 The obb_collision developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Distances of triangle meshes: this library's beside python-fcl's and coal's, in one run.

The same surfaces at the same random poses, as in ``meshes``; the installed peers are called from
Python pair by pair, and compute closest points as well. One thread each; processor time, turn by
turn, the best of several turns.

    python -m tools.peers.mesh_distances [--pairs N] [--json FILE]
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.benchmarks.pair_peers import coal_mesh, fcl_mesh
from obb_collision.benchmarks.timing import on_threads, seconds_of
from obb_collision.cli import Parser, interruptible, option, whole
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.typing import Floats
from tools.peers.meshes import TURNS, print_table

Ask = Callable[[], Floats]


def ask_coal(coal: Any, shapes: list[Mesh], centers: Floats, rotations: Floats) -> Ask:
    """Return a function that asks coal for all distances (n,); centers (2, n, 3)."""
    first, second = (coal_mesh(coal, shape) for shape in shapes)
    places = [list(map(coal.Transform3s, *side)) for side in zip(rotations, centers, strict=True)]
    request, result = coal.DistanceRequest(True), coal.DistanceResult()

    def run() -> Floats:
        found = []
        for one, other in zip(*places, strict=True):
            result.clear()
            found.append(coal.distance(first, one, second, other, request, result))
        return np.array(found)

    return run


def ask_fcl(fcl: Any, shapes: list[Mesh], centers: Floats, rotations: Floats) -> Ask:
    """Return a function that asks python-fcl for all distances (n,); centers (2, n, 3)."""
    models = [fcl_mesh(fcl, shape) for shape in shapes]
    sides = [
        [
            fcl.CollisionObject(model, fcl.Transform(r, c))
            for r, c in zip(turns, places, strict=True)
        ]
        for model, turns, places in zip(models, rotations, centers, strict=True)
    ]
    request = fcl.DistanceRequest(enable_nearest_points=True)

    def run() -> Floats:
        return np.array(
            [
                fcl.distance(one, other, request, fcl.DistanceResult())
                for one, other in zip(*sides, strict=True)
            ]
        )

    return run


PEERS: dict[str, Callable[[Any, list[Mesh], Floats, Floats], Ask]] = {
    "fcl": ask_fcl,
    "coal": ask_coal,
}


def installed() -> list[str]:
    """Return the installed peers, by module."""
    return [name for name in PEERS if importlib.util.find_spec(name)]


def compare(first: Any, second: Any, pairs: int, spread: float) -> dict[str, float]:
    """Return microseconds per pair, the share that collides, and how far apart our bounds are.

    Of each peer installed its microseconds, that over ours, and by how much its distance differs
    from ours at most, where nothing collides (metres).
    """
    rng = np.random.default_rng(0)
    centers = rng.uniform(-spread, spread, (2, pairs, 3))
    rotations = np.array([Rotation.random(pairs, random_state=rng).as_matrix() for _ in range(2)])
    shapes = [Mesh(mesh.vertices, mesh.faces) for mesh in (first, second)]
    bodies = [
        PlacedMeshes(
            MeshTrees.build(shape.vertices, shape.faces, solid=False),
            *(np.zeros(pairs, np.int64), places, turns),
        )
        for shape, places, turns in zip(shapes, centers, rotations, strict=True)
    ]
    names = installed()
    asked = [
        PEERS[name](importlib.import_module(name), shapes, centers, rotations) for name in names
    ]
    with on_threads(1):
        found = oc.clearances(bodies[0], bodies[1])
        theirs = [ask() for ask in asked]
        runs: list[Callable[[], object]] = [lambda: oc.clearances(bodies[0], bodies[1]), *asked]
        times = np.array([[seconds_of(run)[1] for run in runs] for _ in range(TURNS)]).min(axis=0)
    apart = found.distances > 0.0
    row = {
        "ours_us": 1e6 * times[0] / pairs,
        "colliding": 1.0 - float(apart.mean()),
        "bounds_m": float((found.upper - found.distances).max()),
    }
    for name, seconds, distances in zip(names, times[1:], theirs, strict=True):
        row[f"{name}_us"] = 1e6 * seconds / pairs
        row[f"{name}_ratio"] = seconds / times[0]
        off = np.abs(distances - found.upper)[apart]
        row[f"{name}_differ_m"] = float(off.max(initial=0.0))
    return row


@interruptible("mesh_distances")
def main(arguments: list[str] | None = None) -> None:
    """Print the table; ``--json FILE`` writes it too."""
    parser = Parser(description="distances of meshes beside python-fcl and coal")
    option(parser, "--pairs", whole(1, 10**8), 200, "pairs of poses a row")
    own, difference = {"bounds_m": ".0e"}, ("differ_m", ".0e")
    print_table(parser, arguments, compare, installed(), own, difference)


if __name__ == "__main__":
    raise SystemExit(main())

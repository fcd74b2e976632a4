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

"""Triangle meshes: verdicts and distances beside those of python-fcl and coal, in one run.

All get the same surfaces at the same random poses; the installed peers are called from Python pair
by pair with shapes and transforms made beforehand, which is how they are used. One thread each;
processor time, turn by turn, the best of several turns.

    python -m tools.peers.meshes [--pairs N] [--json FILE]
"""

from __future__ import annotations

import importlib
import importlib.util
import json
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from trimesh import creation

import obb_collision as oc
from obb_collision.benchmarks.effects import PlacedPairs
from obb_collision.benchmarks.levels import MESH_PEERS, Query, coal_mesh, fcl_mesh
from obb_collision.benchmarks.timing import on_threads, seconds_of
from obb_collision.cli import Parser, interruptible, new_file, option, whole
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.queries.meshes.meshes import mesh_collisions
from obb_collision.queries.meshes.placed import PlacedMeshes
from tools.peers.effects import coal_distances, fcl_distances

#: Turns of each side; the best counts, since others use the machine too.
TURNS = 5
#: Centres of either body are drawn from cubes of these half edges, metres; meshes are about 1 m.
SPREADS = {"deep": 0.4, "near": 0.8, "apart": 1.6}
DISTANCES = {
    "fcl": partial(fcl_distances, fcl_mesh),
    "coal": partial(coal_distances, coal_mesh),
}


def meshes() -> dict[str, Any]:
    """Return the pairs compared by name."""
    ball, fine = creation.icosphere(subdivisions=3), creation.icosphere(subdivisions=5)
    torus = creation.torus(0.7, 0.25, 64, 32)
    ring = creation.annulus(0.5, 0.8, 0.6, sections=64)
    box = creation.box((1.0, 1.0, 1.0))
    return {
        "ball 1,280 / ball 1,280": (ball, ball),
        "ball 20,480 / ball 20,480": (fine, fine),
        "torus 4,096 / torus 4,096": (torus, torus),
        "ring 512 / torus 4,096": (ring, torus),
        "box 12 / torus 4,096": (box, torus),
        "box 12 / box 12": (box, box),
    }


def installed() -> list[str]:
    """Return the installed peers, by module."""
    return [name for name in DISTANCES if importlib.util.find_spec(name)]


def compare(first: Any, second: Any, pairs: int, spread: float) -> dict[str, dict[str, float]]:
    """Return figures of verdicts and of distances of pairs at random poses.

    Microseconds per pair and the share that collides; of each peer installed its microseconds, that
    over ours, and by how much it differs: on how many pairs, or by how many metres at most where
    nothing collides.
    """
    rng = np.random.default_rng(0)
    centers = rng.uniform(-spread, spread, (2, pairs, 3))
    rotations = [Rotation.random(pairs, random_state=rng).as_matrix() for _ in range(2)]
    shapes = [Mesh(mesh.vertices, mesh.faces) for mesh in (first, second)]
    a, b = (
        PlacedMeshes(
            MeshTrees.build(shape.vertices, shape.faces, solid=False),
            np.zeros(pairs, np.int64), center, rotation,
        )
        for shape, center, rotation in zip(shapes, centers, rotations, strict=True)
    )  # fmt: skip
    places, rows = (centers.reshape(-1, 3), np.concatenate(rotations)), np.arange(2 * pairs)
    both = np.column_stack([rows[:pairs], rows[pairs:]])
    query = Query(rows // pairs, *places, *both.T)
    placed = PlacedPairs(shapes, both // pairs, *places, both)
    peers = {peer.module: peer for peer in MESH_PEERS if peer.shape == "mesh"}
    names = installed()
    with on_threads(1):
        hits, found = mesh_collisions(a, b), oc.clearances(a, b)
        asked = {name: peers[name].load(shapes)(query) for name in names}
        verdicts = _figures(lambda: mesh_collisions(a, b), asked)
        modules = {name: importlib.import_module(name) for name in names}
        measured = {name: DISTANCES[name](modules[name], placed) for name in names}
        distances = _figures(lambda: oc.clearances(a, b), measured)
        for name in names:
            verdicts[f"{name}_differ"] = int((hits != asked[name]()).sum())
            off = np.abs(measured[name]() - found.upper)[~hits]
            distances[f"{name}_differ"] = float(off.max(initial=0.0))
    distances["bounds_m"] = float((found.upper - found.distances).max())
    share = {"colliding": float(hits.mean())}
    return {"verdicts": verdicts | share, "distances": distances | share}


def _figures(ours: Callable[[], Any], asked: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Return microseconds per pair, ours and of peers, and by how much theirs is longer."""
    pairs = len(ours())
    runs = [ours, *asked.values()]
    times = np.array([[seconds_of(run)[1] for run in runs] for _ in range(TURNS)]).min(axis=0)
    row = {"ours_us": 1e6 * times[0] / pairs}
    for name, seconds in zip(asked, times[1:], strict=True):
        row[f"{name}_us"], row[f"{name}_ratio"] = 1e6 * seconds / pairs, seconds / times[0]
    return row


@interruptible("meshes")
def main(arguments: list[str] | None = None) -> None:
    """Print the table; ``--json FILE`` writes it too."""
    parser = Parser(description="mesh against mesh beside python-fcl and coal")
    option(parser, "--pairs", whole(1, 10**8), 200, "pairs of poses a row")
    option(parser, "--json", new_file(), text="write the figures to a file")
    options = parser.parse_args(arguments)
    rows, peers = {}, installed()
    heads = "".join(f"{name + ' µs':>10}{'ratio':>7}{'differ':>9}" for name in peers)
    print(f"{'triangles':28}{'poses':>7}{'hits':>7}{'':>11}{'ours µs':>9}{heads}")
    for name, (first, second) in meshes().items():
        for label, spread in SPREADS.items():
            for what, row in compare(first, second, options.pairs, spread).items():
                rows[f"{name}, {label}, {what}"] = row
                cells = "".join(
                    f"{row[f'{peer}_us']:10.2f}{row[f'{peer}_ratio']:7.1f}{row[f'{peer}_differ']:9.1g}"
                    for peer in peers
                )
                hits = f"{row['colliding']:7.0%}"
                print(f"{name:28}{label:>7}{hits}{what:>11}{row['ours_us']:9.2f}{cells}")
    for peer in peers:
        ratios = np.array([row[f"{peer}_ratio"] for row in rows.values()])
        print(f"{peer} / ours: least {ratios.min():.1f}, median {np.median(ratios):.1f}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    raise SystemExit(main())

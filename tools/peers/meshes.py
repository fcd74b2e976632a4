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

"""Triangle meshes: this library's trees beside python-fcl's and coal's, in one run.

All get the same surfaces at the same random poses and decide whether they collide; the installed
peers are called from Python pair by pair with transforms made beforehand, which is how they are
used. All are timed by the processor time of this process, turn by turn, the best of several turns.

    python -m tools.peers.meshes [--pairs N] [--json FILE]
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from trimesh import creation

from obb_collision.benchmarks.pair_peers import MESH_PEERS, Peer, Query
from obb_collision.benchmarks.timing import seconds_of
from obb_collision.cli import Parser, interruptible, new_file, option, whole
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.queries.meshes.meshes import mesh_collisions
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.typing import Mask

#: Turns of each side; the best counts, since others use the machine too.
TURNS = 5
#: Centres of either body are drawn from cubes of these half edges, metres; meshes are about 1 m.
SPREADS = {"deep": 0.4, "near": 0.8, "apart": 1.6}


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


def compare(first: Any, second: Any, pairs: int, spread: float) -> dict[str, float]:
    """Return microseconds per pair and the share that collides.

    Of each peer installed its microseconds, that over ours, and on how many pairs it differs.
    """
    rng = np.random.default_rng(0)
    centers = rng.uniform(-spread, spread, (2, pairs, 3))
    rotations = [Rotation.random(pairs, random_state=rng).as_matrix() for _ in range(2)]
    bodies = []
    for mesh, center, rotation in zip((first, second), centers, rotations, strict=True):
        trees = MeshTrees.build(mesh.vertices, mesh.faces, solid=False)
        bodies.append(PlacedMeshes(trees, np.zeros(pairs, np.int64), center, rotation))

    def collide() -> Mask:
        return mesh_collisions(bodies[0], bodies[1])

    shapes = [Mesh(mesh.vertices, mesh.faces) for mesh in (first, second)]
    places = centers.reshape(-1, 3), np.concatenate(rotations)
    rows = np.arange(2 * pairs)
    query = Query(rows // pairs, *places, rows[:pairs], rows[pairs:])
    asked = {name: peer.load(shapes)(query) for name, peer in installed().items()}
    ours = collide()
    theirs = {name: ask() for name, ask in asked.items()}
    runs = [collide, *asked.values()]
    times = np.array([[seconds_of(run)[1] for run in runs] for _ in range(TURNS)]).min(axis=0)
    row = {"ours_us": 1e6 * times[0] / pairs, "colliding": float(ours.mean())}
    for name, seconds in zip(asked, times[1:], strict=True):
        row[f"{name}_us"] = 1e6 * seconds / pairs
        row[f"{name}_ratio"] = seconds / times[0]
        row[f"{name}_differ"] = int((ours != theirs[name]).sum())
    return row


def installed() -> dict[str, Peer]:
    """Return the installed peers, by module."""
    peers = {peer.module: peer for peer in MESH_PEERS if peer.shape == "mesh"}
    return {name: peers[name] for name in ("fcl", "coal") if importlib.util.find_spec(name)}


@interruptible("meshes")
def main(arguments: list[str] | None = None) -> None:
    """Print the table; ``--json FILE`` writes it too."""
    parser = Parser(description="mesh against mesh beside python-fcl and coal")
    option(parser, "--pairs", whole(1, 10**8), 1000, "pairs of poses a row")
    print_table(parser, arguments, compare, list(installed()), {}, ("differ", ".0f"))


def print_table(
    parser: Parser,
    arguments: list[str] | None,
    compare: Callable[[Any, Any, int, float], dict[str, float]],
    peers: list[str],
    own: Mapping[str, str],
    difference: tuple[str, str],
) -> None:
    """Print what ``compare`` returns for all pairs of meshes, a row per spread of the poses.

    own: further columns of ours, by head, with their formats; difference: a column of each peer.
    """
    option(parser, "--json", new_file(), text="write the figures to a file")
    options = parser.parse_args(arguments)
    rows, (what, kind) = {}, difference
    heads = "".join(f"{head:>9}" for head in ("ours µs", *own))
    heads += "".join(f"{name + ' µs':>10}{'ratio':>7}{'differ':>9}" for name in peers)
    print(f"{'triangles':28}{'poses':>7}{'hits':>7}{heads}")
    for name, (first, second) in meshes().items():
        for label, spread in SPREADS.items():
            row = rows[f"{name}, {label}"] = compare(first, second, options.pairs, spread)
            cells = f"{row['ours_us']:9.2f}" + "".join(f"{row[k]:9{own[k]}}" for k in own)
            cells += "".join(
                f"{row[f'{peer}_us']:10.2f}{row[f'{peer}_ratio']:7.1f}{row[f'{peer}_{what}']:9{kind}}"
                for peer in peers
            )
            print(f"{name:28}{label:>7}{row['colliding']:7.0%}{cells}")
    for peer in peers:
        ratios = np.array([row[f"{peer}_ratio"] for row in rows.values()])
        print(f"{peer} / ours: least {ratios.min():.1f}, median {np.median(ratios):.1f}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    raise SystemExit(main())

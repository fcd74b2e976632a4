"""Triangle meshes: this library's trees beside python-fcl's BVHModel, in one run.

Both get the same surfaces at the same random poses and say whether they collide; python-fcl is
called from Python pair by pair with transforms made beforehand, which is how it is used. Both
are timed by the processor time of this process, turn by turn, the best of several turns.

    python -m obb_collision.benchmarks.mesh_peers [--pairs N] [--json FILE]
"""

from __future__ import annotations

import argparse
import importlib
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from trimesh import creation

from obb_collision.geometry.mesh_tree import MeshTrees
from obb_collision.queries.mesh_collision import PlacedMeshes, mesh_collisions

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
    """Return microseconds a pair of either side, their ratio, the hits, the disagreements."""
    rng = np.random.default_rng(0)
    centers = rng.uniform(-spread, spread, (2, pairs, 3))
    rotations = [Rotation.random(pairs, random_state=rng).as_matrix() for _ in range(2)]
    bodies = []
    for mesh, center, rotation in zip((first, second), centers, rotations, strict=True):
        trees = MeshTrees.build(mesh.vertices, mesh.faces, solid=False)
        bodies.append(PlacedMeshes(trees, np.zeros(pairs, np.int64), center, rotation))
    fcl_collide = _fcl(first, second, bodies)

    def collide() -> NDArray[np.bool_]:
        return mesh_collisions(bodies[0], bodies[1])

    ours, theirs = collide(), fcl_collide()
    turns = [(_seconds(collide), _seconds(fcl_collide)) for _ in range(TURNS)]
    times = np.array(turns).min(axis=0)
    return {
        "ours_us": 1e6 * times[0] / pairs,
        "fcl_us": 1e6 * times[1] / pairs,
        "ratio": times[1] / times[0],
        "colliding": float(ours.mean()),
        "disagree": int((ours != theirs).sum()),
    }


def _fcl(first: Any, second: Any, bodies: list[PlacedMeshes]) -> Callable[[], NDArray[np.bool_]]:
    fcl = importlib.import_module("fcl")
    objects, transforms = [], []
    for mesh, placed in zip((first, second), bodies, strict=True):
        model = fcl.BVHModel()
        model.beginModel(len(mesh.vertices), len(mesh.faces))
        model.addSubModel(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        model.endModel()
        objects.append(fcl.CollisionObject(model))
        places = zip(placed.rotations, placed.centers, strict=True)
        transforms.append([fcl.Transform(r, c) for r, c in places])
    a, b = objects
    request = fcl.CollisionRequest()

    def run() -> NDArray[np.bool_]:
        hits = np.empty(len(transforms[0]), np.bool_)
        for n, (place_a, place_b) in enumerate(zip(*transforms, strict=True)):
            a.setTransform(place_a)
            b.setTransform(place_b)
            hits[n] = fcl.collide(a, b, request, fcl.CollisionResult()) > 0
        return hits

    return run


def _seconds(run: Callable[[], object]) -> float:
    start = time.process_time()
    run()
    return time.process_time() - start


def main(arguments: list[str] | None = None) -> None:
    """Print the table; ``--json FILE`` writes it too."""
    parser = argparse.ArgumentParser(description="mesh against mesh beside python-fcl")
    parser.add_argument("--pairs", type=int, default=1000, help="pairs of poses a row")
    parser.add_argument("--json", type=Path, help="write the figures to a file")
    options = parser.parse_args(arguments)
    rows = {}
    print(f"{'triangles':28}{'poses':>7}{'hits':>7}{'ours us':>9}{'fcl us':>9}{'ratio':>7}  differ")
    for name, (first, second) in meshes().items():
        for label, spread in SPREADS.items():
            row = rows[f"{name}, {label}"] = compare(first, second, options.pairs, spread)
            print(
                f"{name:28}{label:>7}{row['colliding']:7.0%}{row['ours_us']:9.2f}"
                f"{row['fcl_us']:9.2f}{row['ratio']:7.1f}  {row['disagree']:.0f}"
            )
    ratios = np.array([row["ratio"] for row in rows.values()])
    print(f"python-fcl / ours: least {ratios.min():.1f}, median {np.median(ratios):.1f}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()

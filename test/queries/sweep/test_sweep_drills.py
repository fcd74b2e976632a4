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

"""All sweeps of boxes that turn up to 100 times about axes of tilted plates that they sink into.

None that certainly collide is called free, nor apart at a time after that; the truth needs nothing
of the package (`sweep_oracle.certain_overlap`). ``--pairs 100000``: the long run.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from mesh_zoo import zoo
from moving_bodies import motion_of_boxes
from scipy.spatial.transform import Rotation
from sweep_motions import CORNER_SIGNS, Twisting, drills, pair_rows
from sweep_oracle import certain_overlap

import obb_collision as oc
from obb_collision import MeshTrees
from obb_collision.geometry.trees.pool import HullPool, Hulls
from obb_collision.queries.convex.support import BOX, CORNERS, ConvexBodies
from obb_collision.queries.sweep.convex import convex_sweeps
from obb_collision.queries.sweep.sweep import TOLERANCE
from obb_collision.typing import Floats, Integers

CHUNK = 2500
CORNERS_OF_MESH, FACES = zoo()["box0"]
#: Until when pairs of rows are certainly apart.
FreeUntil = Callable[[Twisting, Integers], Floats]


def by_boxes(motion: Twisting, rows: Integers) -> Floats:
    moving = oc.MovingBoxes.from_twists(motion.boxes, motion.twists, 1.0, origins=motion.origins)
    return oc.sweeps(moving, moving, rows).free_until


def by_hulls(motion: Twisting, rows: Integers) -> Floats:
    """Every other pair with the formula of a box, the others with corners."""
    boxes, count = motion.boxes, len(motion.boxes)
    pool = HullPool()
    for half in boxes.half_extents:
        pool.append(Hulls.of(CORNER_SIGNS * half))
    kinds = np.where(np.arange(count) % 4 < 2, BOX, CORNERS).astype(np.int8)
    bodies = ConvexBodies(
        kinds, np.pad(boxes.half_extents, ((0, 0), (0, 1))), np.zeros(count), pool.all,
        np.arange(count), boxes.centers, boxes.rotations,
    )  # fmt: skip
    begin = np.zeros(len(rows))
    return convex_sweeps(bodies, motion_of_boxes(motion), rows, begin, TOLERANCE).free_until


def corners_from_origins(motion: Twisting) -> Floats:
    """Corners (n, 8, 3) in the frames that turn with the boxes about their origins."""
    boxes = motion.boxes
    arms = np.einsum("nji,nj->ni", boxes.rotations, boxes.centers - motion.origins)
    return np.asarray(arms[:, None] + np.sign(CORNERS_OF_MESH) * boxes.half_extents[:, None])


def by_meshes(motion: Twisting, rows: Integers) -> Floats:
    trees = MeshTrees.join([MeshTrees.build(c, FACES) for c in corners_from_origins(motion)])
    every = np.arange(len(motion.boxes))
    placed = oc.PlacedMeshes(trees, every, motion.origins, motion.boxes.rotations)
    found = oc.sweeps(
        placed, placed, rows, duration=1.0, twists_a=motion.twists, twists_b=motion.twists
    )
    return found.free_until


def in_scene(level: str) -> FreeUntil:
    """Predict impacts of meshes on a level, pairs 16 m from each other."""

    def predicted(motion: Twisting, rows: Integers) -> Floats:
        scene, places = oc.Scene(accuracy=level), motion.origins.copy()
        for k, pair in enumerate(rows):
            places[pair] += 16.0 * np.array([k % 16, k // 16 % 16, k // 256])
        turns = Rotation.from_matrix(motion.boxes.rotations).as_quat()
        for k, corners in enumerate(corners_from_origins(motion)):
            scene.add(str(k), oc.shapes.Mesh(corners, FACES), [*places[k], *turns[k]])
        scene.set_twists(np.arange(len(places)), motion.twists)
        scene.set_effect("sweep", "on", horizon=1.0)
        report, until = scene.check(), np.full(len(rows), np.inf)
        until[report.pairs[:, 0] // 2] = 0.0
        ahead = report.swept.predicted
        until[ahead.pairs[:, 0] // 2] = ahead.free_until
        return until

    return predicted


SWEEPS: dict[str, FreeUntil] = {"boxes": by_boxes, "hulls": by_hulls, "meshes": by_meshes}
SWEEPS |= {f"scene at {level}": in_scene(level) for level in ("obb", "hull", "mesh")}


@pytest.mark.parametrize("name", SWEEPS)
def test_none_that_certainly_collides_is_called_free(name: str, pairs: int) -> None:
    rng = np.random.default_rng(1)
    left = total = 2 * pairs if name == "boxes" else pairs // 10
    certain = missed = free = 0
    while left > 0:
        motion = drills(rng, min(left, CHUNK))
        rows = pair_rows(len(motion.boxes) // 2)
        half = motion.boxes.half_extents
        truth = certain_overlap(motion_of_boxes(motion), half, rows, rng, 30)
        until = SWEEPS[name](motion, rows)
        missed += int((until > truth).sum())
        certain += int(np.isfinite(truth).sum())
        free += int(np.isinf(until).sum())
        left -= len(rows)
    print(f"{name}: {total} motions, {certain} certainly collide, {free} free")  # noqa: T201
    assert missed == 0
    assert certain > 0.4 * total
    assert free > 0.2 * total

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

"""The effect ``sweep`` above obb: impacts of shapes, in order between the levels, none missed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from each import each
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.accuracy import Accuracy
from obb_collision.queries.sweep.sweep import Sweeps
from obb_collision.scene.effects import LEVELS
from obb_collision.typing import Floats

HORIZON = 4.0
LEVELS_OF_SWEEP = ("obb", *(level.name.lower() for level in LEVELS["sweep"]))


def shapes_of(rng: np.random.Generator, count: int) -> list[oc.shapes.Shape]:
    """Return shapes of all kinds."""
    shapes: list[oc.shapes.Shape] = []
    while len(shapes) < count:
        size = rng.uniform(0.1, 0.4, 3)
        shapes += [
            oc.shapes.Box(2.0 * size),
            oc.shapes.Sphere(size[0]),
            oc.shapes.Capsule(size[0], size[1]),
            oc.shapes.Cylinder(size[0], 2.0 * size[1]),
            oc.shapes.Cone(size[0], 2.0 * size[1]),
            oc.shapes.Ellipsoid(size),
            oc.shapes.Hull(rng.normal(size=(12, 3)) * 0.5 * size),
            oc.shapes.Mesh(rng.normal(size=(4, 3)) * size, [[0, 2, 1], [0, 1, 3]]),
            oc.shapes.Mesh(rng.normal(size=(6, 3)) * size, [[0, 2, 1], [3, 4, 5]]),
        ]
    return shapes[:count]


def twists_of(seed: int, count: int) -> Floats:
    rng = np.random.default_rng(seed + 100)
    return np.asarray(rng.normal(size=(count, 6)) * rng.choice([0.0, 0.3, 1.0], (count, 1)))


def moving_scene(seed: int, *, padding: float = 0.0, count: int = 24, **options: str) -> oc.Scene:
    """Return such shapes that move all over the place."""
    rng = np.random.default_rng(seed)
    scene = oc.Scene(padding=padding)
    for number, shape in enumerate(shapes_of(rng, count)):
        turn = Rotation.random(1, rng).as_quat()[0]
        scene.add(str(number), shape, [*rng.uniform(-1.2, 1.2, 3), *turn])
    scene.set_twists(np.arange(count), twists_of(seed, count))
    scene.set_effect("sweep", "on", horizon=HORIZON, **options)
    return scene


def free(found: Sweeps) -> dict[tuple[int, int], float]:
    return {(i, j): t for (i, j), t in zip(found.pairs.tolist(), found.free_until, strict=True)}


@each("seed", range(4))
@each("padding", [0.0, 0.02])
def test_no_impact_is_before_that_at_a_coarser_level(seed: int, padding: float) -> None:
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.uniform(-1.2, 1.2, (24, 3)), Rotation.random(24, rng).as_quat()])
    seen: list[list[dict[tuple[int, int], float]]] = []
    for level in LEVELS_OF_SWEEP:
        scene = moving_scene(seed, padding=padding, accuracy=level)
        ahead = scene.check().swept.predicted
        scene.move_indices(np.arange(24), poses)
        seen.append([free(ahead), free(scene.check().swept.passed)])
    for coarse, fine in pairwise(seen):
        assert len(fine[0]) > 5
        for k in range(2):
            for pair, time in fine[k].items():
                if pair in coarse[k]:  # what is nearer than a radius is swept, however short
                    assert time >= coarse[k][pair]
        assert set(fine[0]) <= set(coarse[0])
        assert fine[0] != coarse[0]


@each("level", LEVELS_OF_SWEEP)
@each("seed", range(3))
def test_nothing_predicted_is_late_or_missed(level: str, seed: int) -> None:
    """Against clearances on that level, step by step along the twists."""
    scene = moving_scene(seed, accuracy=level)
    scene.set_effect("clearance", max_distance=0.0, accuracy=level)
    report = scene.check()
    until, known = free(report.swept.predicted), set(map(tuple, report.pairs.tolist()))
    poses = np.array([scene.pose(str(n)) for n in range(24)])
    twists = twists_of(seed, 24)
    scene.set_effect("sweep", "off")
    collided = set()
    for time in np.linspace(0.0, HORIZON, 60)[1:]:
        turned = Rotation.from_rotvec(twists[:, 3:] * time) * Rotation.from_quat(poses[:, 3:])
        scene.move_indices(
            np.arange(24), np.column_stack([poses[:, :3] + twists[:, :3] * time, turned.as_quat()])
        )
        near = scene.check().clearances
        for pair in map(tuple, near.pairs.tolist()):
            if pair not in known:
                collided.add(pair)
                assert until[pair] <= time * (1.0 + 1e-9)
    assert len(collided) > 5


def test_shapes_pass_each_other_where_boxes_do_not() -> None:
    for level, hits in (("obb", 1), ("hull", 0)):
        scene = oc.Scene(accuracy=level)
        scene.add("ball", oc.shapes.Sphere(0.5), [-3, 0, 0, 0, 0, 0, 1])
        scene.add("post", oc.shapes.Cylinder(0.5, 4.0), [0, 0.8, 0.9, 0.0, 0.6, 0.0, 0.8])
        scene.add("other", oc.shapes.Sphere(0.5), [0, -0.8, 0.8, 0, 0, 0, 1])
        scene.set_effect("sweep", "on", horizon=10.0)
        scene.set_twist("ball", [1, 0, 0, 0, 0, 0])
        report = scene.check()
        assert ([0, 2] in report.swept.predicted.pairs.tolist()) == bool(hits)
        scene.move("ball", [3, 0, 0, 0, 0, 0, 1])
        passed = scene.check().swept.passed
        assert ([0, 2] in passed.pairs.tolist()) == bool(hits)


@each("swapped", [False, True])
def test_round_shapes_meet_meshes_at_their_very_radius(swapped: bool) -> None:
    """A mesh around the cylinder would be up to a few percent early."""
    corners = np.array([[0.0, -1, -1], [0, 1, -1], [0, 0, 1], [-0.1, 0, 0]])
    wall = oc.shapes.Mesh(corners, [[0, 1, 2], [0, 2, 3], [2, 1, 3], [1, 0, 3]])
    scene = oc.Scene(accuracy="mesh", padding=0.02)
    can, still = oc.shapes.Cylinder(0.3, 0.4), ("wall", wall, [0, 0, 0, 0, 0, 0, 1])
    for name, shape, pose in (("can", can, [2.0, 0, 0, 0, 0, 0.1, 0.99498744]), still)[
        :: 1 - 2 * swapped
    ]:
        scene.add(name, shape, pose)
    scene.set_twist("can", [-0.5, 0, 0, 0, 0, 0])
    scene.set_effect("sweep", "on", horizon=HORIZON)
    found = scene.check().swept.predicted
    truth = (2.0 - 0.3 - 0.04) / 0.5
    assert truth - 2e-4 <= found.times[0] <= truth
    np.testing.assert_allclose(found.normals[0], [1.0 if swapped else -1.0, 0, 0], atol=1e-6)
    assert len(found) == 1


def test_a_short_motion_through_something_thin_in_a_thick_box_is_seen() -> None:
    """A needle of a hull through another: far less than half a box, and apart before and after."""
    thin = oc.shapes.Hull(
        np.array([[0, 0, 0], [1, 1, 1], [1, 1, 1.001], [0, 0.001, 0], [1, 0.2, 0.1]])
    )
    ball = oc.shapes.Capsule(0.001, 0.3)
    assert min(thin.local_box[2]) > 0.0
    scene = oc.Scene(accuracy="hull")
    scene.add("thin", thin)
    scene.add("ball", ball, [0.3, 0.3, 0.1, 0, 0, 0, 1])
    scene.set_effect("sweep", "on", horizon=0.0)
    seen = 0
    for step in range(200):
        x = 0.3 + 0.004 * step
        before = scene.check()
        scene.move("ball", [x, 0.3, 0.1, 0, 0, 0, 1])
        after = scene.check()
        passed = len(after.swept.passed)
        assert not (len(before) and passed)
        seen += passed + len(after)
    assert seen > 0


def test_what_begins_within_the_tolerance_and_goes_through_is_not_lost() -> None:
    scene = oc.Scene(accuracy="hull")
    scene.add("wall", oc.shapes.Cylinder(3.0, 0.01))
    scene.add("ball", oc.shapes.Sphere(0.1), [0, 0, 0.105 + 1e-9, 0, 0, 0, 1])
    scene.set_effect("sweep", "on")
    assert len(scene.check()) == 0
    scene.move("ball", [0, 0, -0.5, 0, 0, 0, 1])
    report = scene.check()
    assert len(report) == 0
    assert report.swept.passed.pairs.tolist() == [[0, 1]]
    assert report.swept.passed.times[0] <= 2e-9


def test_what_collided_before_is_left_to_the_pairs() -> None:
    scene = oc.Scene(accuracy="hull")
    scene.add("wall", oc.shapes.Cylinder(3.0, 0.01))
    scene.add("ball", oc.shapes.Sphere(0.1), [0, 0, 0.05, 0, 0, 0, 1])
    scene.set_effect("sweep", "on")
    assert len(scene.check()) == 1
    scene.move("ball", [0, 0, -0.5, 0, 0, 0, 1])
    assert len(scene.check().swept.passed) == 0


def test_a_budget_lowers_sweeps_with_their_pairs() -> None:
    scene = moving_scene(0)
    scene.accuracy, scene.time_budget = Accuracy.HULL, 1e-9
    report = scene.check()
    assert report.cap == Accuracy.OBB
    assert free(report.swept.predicted) == free(moving_scene(0).check().swept.predicted)

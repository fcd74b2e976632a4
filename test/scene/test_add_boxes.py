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

"""Objects added many at a time are those added one by one, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from each import each

import obb_collision as oc
from obb_collision import shapes as kinds_of_shapes

TINY = float(np.nextafter(np.finfo(np.float64).tiny, 1.0))


def state(scene: oc.Scene) -> list[object]:
    """Return what can be seen of a scene."""
    report, boxes = scene.check("sweep"), scene.boxes
    swept, indices = report.swept, scene.indices
    arrays = [indices, scene.objects.poses_of(indices), *vars(boxes).values(), report.accuracies]
    arrays += [
        report.pairs,
        report.cycle.active[indices],
        swept.predicted.pairs,
        swept.passed.pairs,
    ]
    names = scene.names
    return [
        names,
        [scene.objects.shape_of(name) for name in names],
        *(array.tolist() for array in arrays),
    ]


def some(count: int, seed: int) -> tuple[list[str], np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    names = [f"a/{number}" for number in rng.permutation(3 * count)[:count]]
    sizes, poses = rng.uniform(0.1, 2.0, (count, 3)), rng.normal(size=(count, 7))
    sizes[0] = TINY, 0.0, 3.0
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    return names, sizes, poses


@pytest.mark.filterwarnings("ignore:.*far from unit length")
def test_boxes_added_at_once_are_those_added_one_by_one() -> None:
    one, many = oc.Scene(padding=0.01), oc.Scene(padding=0.01)
    for seed in range(4):  # later ones replace some of the earlier ones
        names, sizes, poses = some(30, seed)
        levels = ["aabb" if number % 7 == 0 else None for number in range(len(names))]
        for name, size, pose, level in zip(names, sizes, poses, levels, strict=True):
            one.add(name, oc.shapes.Box(size), pose, accuracy=level)
        many.add_boxes(names, sizes, poses, levels)
        assert state(one) == state(many)
        for scene in (one, many):
            scene.remove(names[3])
            scene.add(names[5], oc.shapes.Sphere(0.5), padding=0.2)
    assert many.obb(names[0]).half_extents[0] >= 0.5 * TINY + 0.01


def test_other_shapes_come_with_their_boxes() -> None:
    one, many = oc.Scene(accuracy="hull"), oc.Scene(accuracy="hull")
    names, sizes, poses = some(40, 9)
    sizes[0] = 1.0
    poses[:, :3] *= 2.0
    shapes: list[Any] = [None, kinds_of_shapes.Ellipsoid, kinds_of_shapes.Cylinder] * 14
    bodies: list[Any] = []
    body: Any
    for name, size, pose, kind in zip(names, sizes, poses, shapes, strict=False):
        x, y, z = size.tolist()
        if kind is None:
            body, trusted = oc.shapes.Box(size), None
        elif kind is kinds_of_shapes.Ellipsoid:
            body, trusted = kind(0.5 * size), kind.trusted(radii=(0.5 * x, 0.5 * y, 0.5 * z))
        else:
            body = kind(0.5, 1.0, size)
            trusted = kind.trusted(radius=0.5, length=1.0, scale=(x, y, z))
        assert trusted is None or trusted == body
        one.add(name, body, pose)
        bodies.append(trusted)
    many.add_boxes(names, sizes, poses, None, bodies)
    assert state(one) == state(many)
    assert len(one.check()) > 0


def test_bad_boxes_are_refused_all_together() -> None:
    scene = oc.Scene()
    names, sizes, poses = some(4, 1)
    for bad in (
        (names[:3], sizes, poses),
        (["x"] * 4, sizes, poses),
        (names, -sizes, poses),
        (names, sizes * np.nan, poses),
        (names, sizes, np.zeros((4, 7))),
        ([*names[:3], "\ud800"], sizes, poses),
        (names, sizes, poses, ["no level"] * 4),
    ):
        with pytest.raises(ValueError, match="must"):
            scene.add_boxes(*bad)
    assert len(scene) == 0
    assert scene.add_boxes([], np.empty((0, 3)), np.empty((0, 7))).tolist() == []


@each("renewed", [True, False])
def test_what_is_renewed_or_in_place_of_another_did_not_pass_from_where_that_was(
    renewed: bool,
) -> None:
    scene = oc.Scene()
    scene.add("wall", oc.shapes.Box([0.1, 9, 9]))
    away = np.array([[2.0, 0, 0, 0, 0, 0, 1]])
    slots = scene.add_boxes(["a", "b"], np.ones((2, 3)), [-away[0]] * 2)
    scene.allow("[abc]", "[abc]")
    scene.set_effect("sweep", "on")
    scene.check()
    if renewed:
        scene.objects.renew(slots[:1])
        scene.move_indices(slots, np.repeat(away, 2, axis=0))
    else:
        scene.move("b", away[0])
        anew = scene.objects.begin_boxes(["c"], np.ones((1, 3)), away, instead=slots[:1])
        assert anew.tolist() == slots[:1].tolist()
    assert scene.check().swept.passed.pairs.tolist() == [[0, slots[1]]]
    scene.move_indices(slots[:1], -away)
    assert scene.check().swept.passed.pairs.tolist() == [[0, slots[0]]]


def test_boxes_that_need_no_check_are_those_that_were_checked() -> None:
    one, other = oc.Scene(padding=0.01), oc.Scene(padding=0.01)
    names, sizes, poses = some(40, 5)
    for scene in (one, other):
        scene.add("a/0", oc.shapes.Sphere(0.5))
        scene.objects.remove(scene.add_boxes(["x", "y"], sizes[:2], poses[:2]))
    names = [f"b/{number}" for number in range(40)]
    levels = [oc.Accuracy.AABB if number % 7 == 0 else None for number in range(40)]
    assert other.objects.begin_boxes(names, sizes, poses, levels).tolist() == (
        one.add_boxes(names, sizes, poses, levels).tolist()
    )
    assert state(one) == state(other)
    some_rows = np.array([one.index(name) for name in names[3:9]])
    one.add_boxes(names[3:9], sizes[9:15], poses[3:9], levels[3:9])
    other.objects.resize_boxes(some_rows, sizes[9:15])
    assert state(one) == state(other)


@each("before, after", [(6, 6), (6, 4), (4, 6), (0, 3)])
def test_boxes_in_place_of_others_are_as_if_these_had_been_removed(before: int, after: int) -> None:
    one, other = (oc.Scene(padding=0.01, accuracy="hull") for _ in range(2))
    names, sizes, poses = some(before + 4, 6)
    for scene in (one, other):
        for name, pose in zip(names, poses, strict=True):
            scene.add(name, oc.shapes.Sphere(0.5), pose, padding=0.1, accuracy="mesh")
        scene.set_enabled(names[0], False)
        scene.objects.set_twists(range(before), np.ones((before, 6)))
        scene.objects.grow(np.arange(before), np.full(before, 0.2))
        scene.check()
    gone, sizes = np.arange(before), np.resize(sizes, (after, 3))
    poses = np.resize(poses, (after, 7))
    come = [f"new/{number}" for number in range(after)]
    one.objects.remove(gone)
    slots = one.objects.begin_boxes(come, sizes, poses)
    assert other.objects.begin_boxes(come, sizes, poses, instead=gone).tolist() == slots.tolist()
    other.objects.remove(gone[after:])
    assert state(one) == state(other)
    assert [other.objects.padding_overrides, other.names] == [
        one.objects.padding_overrides,
        one.names,
    ]
    for scene in (one, other):
        scene.padding = 0.05  # of those that have none of their own
    assert state(one) == state(other)


def test_a_renamed_object_is_the_same_under_its_new_name() -> None:
    scene = oc.Scene()
    slots = scene.add_boxes(["a", "b"], np.ones((2, 3)), [[0, 0, 0, 0, 0, 0, 1]] * 2)
    scene.allow("c", "*")
    assert scene.check().names() == [("a", "b")]
    scene.objects.rename(slots[:1], ["c"])
    assert (scene.index("c"), "a" in scene, scene.names) == (slots[0], False, ["c", "b"])
    assert scene.check().names() == [], "rules count by the new name"

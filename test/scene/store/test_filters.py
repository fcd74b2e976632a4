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

"""The store of a scene: which pairs count by filters, and boxes that are added at once."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st
from small_robots import link, urdf
from support import refused

import obb_collision as oc
from obb_collision.shapes import Box, Cylinder, Ellipsoid, Sphere

NAMES = [f"{space}/{number}" for space in ("arm", "arm/hand", "cup", "") for number in range(3)]
NAMES += ["plain", "arm"]
PARTS = {f"{body}#/{number}": body for body in ("arm/1", "cup/0") for number in (0, 12)}
NAMES += [*PARTS, "arm/x#/1", "cup#/1"]
PATTERNS = ["*", "arm/*", "cup/?", "arm/hand/*", "*/1", "cup/0", "plain", "arm/1", "absent/*"]
side = st.lists(st.sampled_from(PATTERNS), min_size=1, max_size=3).map(tuple)
rules = st.lists(st.tuples(side, side, st.booleans()), max_size=4)
only = st.lists(st.tuples(side, side), max_size=3)
within = st.lists(st.sampled_from(["*", "arm", "arm*", "cup", "absent"]), max_size=2)


def fits(a: str, b: str, first: Sequence[str], second: Sequence[str]) -> bool:
    """Return whether a pair, in either order, matches two sides."""

    def matches(name: str, patterns: Sequence[str]) -> bool:
        both = {name, PARTS.get(name, name)}
        return any(fnmatchcase(one, pattern) for one in both for pattern in patterns)

    straight = matches(a, first) and matches(b, second)
    return straight or (matches(a, second) and matches(b, first))


def counts(a: str, b: str, rules: Any, only: Any, within: Any) -> bool:
    """Return whether a pair counts, by the meaning of each filter."""
    last = [allowed for first, second, allowed in rules if fits(a, b, first, second)]
    listed = not only or any(fits(a, b, *sides) for sides in only)
    bodies = [PARTS.get(name, name) for name in (a, b)]
    if bodies[0] == bodies[1] and a in PARTS and b in PARTS:
        return False
    spaces = {name.rpartition("/")[0] if "/" in name else None for name in bodies}
    (space,) = spaces if len(spaces) == 1 else (None,)
    inside = space is not None and any(fnmatchcase(space, pattern) for pattern in within)
    return listed and not (last and last[-1]) and not inside


def crowd(count: int = len(NAMES)) -> oc.Scene:
    """Return boxes that all collide."""
    scene = oc.Scene()
    for name in NAMES[:count]:
        scene.add(name, Box([1, 1, 1]))
    return scene


def counted(scene: oc.Scene, rules: Any, only: Any, within: Any) -> list[tuple[str, str]]:
    """Return the pairs that count, in the order of a report."""
    pairs = combinations(scene.names, 2)
    return [(a, b) for a, b in pairs if counts(a, b, rules, only, within)]


@given(rules, only, within, st.data())
def test_pairs_count_by_filters(rules: Any, only: Any, within: Any, data: st.DataObject) -> None:
    scene = crowd(data.draw(st.integers(0, len(NAMES))))
    scene.rules.warns = False  # of objects that are still to come
    report, everything = scene.check(), counted(scene, [], [], [])
    for rule in rules:
        scene.allow(*rule)
    # a rule that is set again moves to the end
    sides = [{first, second} for first, second, _ in rules]
    last = [rule for n, rule in enumerate(rules) if sides[n] not in sides[n + 1 :]]
    scene.check()
    scene.rules.check_only = only
    assert scene.check().names() == counted(scene, last, only, [])
    scene.rules.allowed_within = within
    for _ in range(3):  # objects come, go and change their slots
        expected = counted(scene, last, only, within)
        assert scene.any_collision() == bool(expected)
        assert scene.check().names() == expected
        assert scene.check(["contacts"]).contacts.pairs.tolist() == scene.check().pairs.tolist()
        for name in data.draw(st.lists(st.sampled_from(NAMES), max_size=4)):
            if name in scene:
                scene.remove(name)
            else:
                scene.add(name, Box([1, 1, 1]))
    assert report.names() == everything, "a report stays as it was"
    scene.rules.check_only = []
    assert scene.check().names() == counted(scene, last, [], within)
    scene.rules.allowed_within, scene.rules.allowed = [], []
    assert scene.check().names() == counted(scene, [], [], [])


def test_rules_that_were_taken_back_are_forgotten_and_others_stay() -> None:
    scene = crowd()
    scene.allow("arm/0", "cup/1")
    for k in range(2000):
        scene.allow(f"arm/{k}", "cup/2")
        scene.allow("cup/2", f"arm/{k}", False)
    assert scene.rules.allowed == [("arm/0", "cup/1", True)]
    scene.allow("cup/*", "arm/*")
    scene.allow("arm/0", "cup/1", False)  # overrules the one before: not forgotten
    assert ("arm/0", "cup/1") in scene.check().names()
    assert ("arm/1", "cup/1") not in scene.check().names()
    for wrong in ([("*", "*", True), ("", "*", True)], [("*", "", True)]):
        refused("names or patterns", setattr, scene.rules, "allowed", wrong)
    refused("names or patterns", scene.allow, "", "*")
    assert len(scene.rules.allowed) == 2
    for k in range(2000):
        scene.rules.allowed = [("arm/*", f"cup/{k}", True)]
    scene.clear()
    assert scene.rules.allowed == [("arm/*", "cup/1999", True)]


WRONG: dict[str, list[Any]] = {
    "check_only": [[("", "a")], [("a", ())], [("a", "b", "c")], ["ab"], 3],
    "allowed_within": [[3], "\n"],
    "padding_overrides": [[("a", -1.0)], [("a", float("nan"))], [("", 1.0)], [("a",)], 3],
}


@each("name, value", [(name, value) for name, values in WRONG.items() for value in values])
def test_what_is_no_filter_is_refused_and_changes_nothing(name: str, value: Any) -> None:
    scene = crowd(5)
    scene.rules.check_only, scene.rules.allowed_within = [("a/*", "b/*")], ["a"]
    scene.objects.padding_overrides = [("a*", 0.5)]
    part = scene.objects if name == "padding_overrides" else scene.rules
    before, boxes = getattr(part, name), scene.boxes.half_extents
    refused(name, setattr, part, name, value)
    assert getattr(part, name) == before
    assert (scene.boxes.half_extents == boxes).all()


def test_paddings_follow_names_however_objects_come() -> None:
    scene = oc.Scene(padding=0.125)
    scene.objects.padding_overrides = [("a/*", 0.25), ("*/3", 0.5)]
    one, pose = Box([1, 1, 1]), [0, 0, 0, 0, 0, 0, 1]
    scene.add("a/1", one)
    scene.add("b/1", one)
    scene.add("a/2", one, padding=0.0)
    scene.add_boxes(["a/3", "b/2"], np.ones((2, 3)), [pose] * 2)
    begun = scene.objects.begin_boxes(["a/4", "c/3"], np.ones((2, 3)), np.array([pose] * 2, float))
    extents = {"a/1": 0.75, "b/1": 0.625, "a/2": 0.5, "a/3": 1, "b/2": 0.625, "a/4": 0.75, "c/3": 1}

    def check() -> None:
        assert {name: scene.obb(name).half_extents[0] for name in scene.names} == extents

    check()
    scene.objects.resize_boxes(begun, np.full((2, 3), 2.0))
    extents.update({"a/4": 1.25, "c/3": 1.5})
    check()
    scene.objects.rename(begun, ["c/4", "a/5"])
    del extents["a/4"], extents["c/3"]
    extents.update({"c/4": 1.125, "a/5": 1.25})
    check()
    scene.set_padding("b/1", 0.0)
    scene.set_padding("a/2", None)
    extents.update({"b/1": 0.5, "a/2": 0.75})
    check()
    scene.padding = 0.0
    extents.update({"b/2": 0.5, "c/4": 1.0})
    check()
    scene.objects.padding_overrides = []
    own = dict.fromkeys(extents, 0.5)
    extents.update({**own, "c/4": 1.0, "a/5": 1.0})
    check()


def test_a_padding_makes_a_scene_that_was_checked_collide() -> None:
    scene = oc.Scene()
    for n in range(3):
        scene.add(f"a/{n}", Box([1, 1, 1]), [1.25 * n, 0, 0, 0, 0, 0, 1])
    assert scene.check().names() == []
    scene.objects.padding_overrides = [("a/0", 0.25)]
    assert scene.check().names() == [("a/0", "a/1")]
    scene.set_padding("a/2", 0.25)
    assert scene.check().names() == [("a/0", "a/1"), ("a/1", "a/2")]
    scene.objects.padding_overrides = []
    assert scene.check().names() == [("a/1", "a/2")]


TINY = float(np.nextafter(np.finfo(np.float64).tiny, 1.0))


def state(scene: oc.Scene) -> list[object]:
    """Return what can be seen of a scene."""
    report, indices, names = scene.check("sweep"), scene.indices, scene.names
    arrays: list[Any] = [indices, scene.objects.poses_of(indices), *scene.boxes.arrays]
    arrays += [report.accuracies, report.pairs, report.cycle.active[indices]]
    arrays += [report.swept.predicted.pairs, report.swept.passed.pairs]
    shapes = [scene.objects.shape_of(name) for name in names]
    return [names, shapes, scene.objects.padding_overrides, *(array.tolist() for array in arrays)]


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
            one.add(name, Box(size), pose, accuracy=level)
        many.add_boxes(names, sizes, poses, levels)
        assert state(one) == state(many)
        for scene in (one, many):
            scene.remove(names[3])
            scene.add(names[5], Sphere(0.5), padding=0.2)
    assert many.obb(names[0]).half_extents[0] >= 0.5 * TINY + 0.01


def test_other_shapes_come_with_their_boxes() -> None:
    one, many = oc.Scene(accuracy="hull"), oc.Scene(accuracy="hull")
    names, sizes, poses = some(40, 9)
    sizes[0] = 1.0
    poses[:, :3] *= 2.0
    bodies: list[Any] = []
    for number, (name, size, pose) in enumerate(zip(names, sizes, poses, strict=True)):
        x, y, z = size.tolist()
        body, trusted = (
            (Box(size), None),
            (Ellipsoid(0.5 * size), Ellipsoid.trusted(radii=(0.5 * x, 0.5 * y, 0.5 * z))),
            (Cylinder(0.5, 1, size), Cylinder.trusted(radius=0.5, length=1.0, scale=(x, y, z))),
        )[number % 3]
        assert trusted is None or trusted == body
        one.add(name, body, pose)
        bodies.append(trusted)
    many.add_boxes(names, sizes, poses, None, bodies)
    assert state(one) == state(many)
    assert len(one.check()) > 0


def test_bad_boxes_are_refused_all_together() -> None:
    scene = oc.Scene()
    names, sizes, poses = some(4, 1)
    for wrong in (names[:3], ["x"] * 4, [*names[:3], "\ud800"]):
        refused("must", scene.add_boxes, wrong, sizes, poses)
    for bad in ((-sizes, poses), (sizes * np.nan, poses), (sizes, np.zeros((4, 7)))):
        refused("must", scene.add_boxes, names, *bad)
    refused("must", scene.add_boxes, names, sizes, poses, ["no level"] * 4)
    assert len(scene) == 0
    assert scene.add_boxes([], np.empty((0, 3)), np.empty((0, 7))).tolist() == []


@each("renewed", [True, False])
def test_what_is_renewed_or_in_place_of_another_did_not_pass_from_there(renewed: bool) -> None:
    scene = oc.Scene()
    scene.add("wall", Box([0.1, 9, 9]))
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
        scene.add("a/0", Sphere(0.5))
        scene.objects.remove(scene.add_boxes(["x", "y"], sizes[:2], poses[:2]))
    names = [f"b/{number}" for number in range(40)]
    levels = [oc.Accuracy.AABB if number % 7 == 0 else None for number in range(40)]
    begun = other.objects.begin_boxes(names, sizes, poses, levels)
    assert begun.tolist() == one.add_boxes(names, sizes, poses, levels).tolist()
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
            scene.add(name, Sphere(0.5), pose, padding=0.1, accuracy="mesh")
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
    for scene in (one, other):
        scene.padding = 0.05  # of those that have none of their own
    assert state(one) == state(other)


def test_a_renamed_object_is_the_same_under_its_new_name() -> None:
    scene = crowd(2)
    slot, other = scene.index(NAMES[0]), NAMES[1]
    scene.allow("c", "*")
    assert scene.check().names() == [(NAMES[0], other)]
    scene.objects.rename(np.array([slot]), ["c"])
    assert (scene.index("c"), NAMES[0] in scene, scene.names) == (slot, False, ["c", other])
    assert scene.check().names() == [], "rules count by the new name"


def test_a_misspelt_name_of_check_only_is_warned_of_and_refused_if_known() -> None:
    scene = oc.Scene()
    scene.rules.check_only = [(("grippr/*", "arm"), "*")]
    assert not scene.check().names()  # objects are still to come
    scene.add("gripper", Box([1, 1, 1]))
    scene.add("arm", Box([1, 1, 1]))
    with pytest.warns(UserWarning, match="'grippr/.*, which matches no object; did") as caught:
        scene.check()
    assert [each.filename for each in caught] == [__file__]
    scene.add("cup", Box([1, 1, 1]))
    scene.check()  # once
    with pytest.raises(ValueError, match=r"^sides must fit objects, got 'grippr/\*'; did you"):
        scene.check_only([("grippr/*", "cup")], known=True)
    assert scene.rules.check_only == [(("grippr/*", "arm"), "*")]
    scene.check_only([("gripp*", "c?p")], known=True)
    assert scene.check().names() == [("gripper", "cup")]


def test_check_only_may_name_links() -> None:
    robot = oc.Robot.from_urdf(urdf(link("hand", '<sphere radius="0.1"/>')))
    scene = oc.Scene()
    scene.add("cup", Box([1, 1, 1]))
    scene.check_only([("hand", "cup"), ("hnad", "cup")])
    with pytest.warns(UserWarning, match="check_only names 'hnad', which matches no object") as one:
        assert not oc.RobotScene(robot, scene).check([[]]).valid[0]
    assert len(one) == 1

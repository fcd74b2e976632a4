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

"""Filters of pairs and paddings by name, against what each means for one pair or object."""

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

import obb_collision as oc

NAMES = [f"{space}/{number}" for space in ("arm", "arm/hand", "cup", "") for number in range(3)]
NAMES += ["plain", "arm"]
PATTERNS = ["*", "arm/*", "cup/?", "arm/hand/*", "*/1", "cup/0", "plain", "arm/1", "absent/*"]
side = st.lists(st.sampled_from(PATTERNS), min_size=1, max_size=3).map(tuple)
rules = st.lists(st.tuples(side, side, st.booleans()), max_size=4)
only = st.lists(st.tuples(side, side), max_size=3)
within = st.lists(st.sampled_from(["*", "arm", "arm*", "cup", "absent"]), max_size=2)


def fits(a: str, b: str, first: Sequence[str], second: Sequence[str]) -> bool:
    """Return whether a pair, in either order, matches two sides."""

    def matches(name: str, patterns: Sequence[str]) -> bool:
        return any(fnmatchcase(name, pattern) for pattern in patterns)

    straight = matches(a, first) and matches(b, second)
    return straight or (matches(a, second) and matches(b, first))


def counts(a: str, b: str, rules: Any, only: Any, within: Any) -> bool:
    """Return whether a pair counts, by the meaning of each filter."""
    last = [allowed for first, second, allowed in rules if fits(a, b, first, second)]
    listed = not only or any(fits(a, b, *sides) for sides in only)
    spaces = {name.rpartition("/")[0] if "/" in name else None for name in (a, b)}
    (space,) = spaces if len(spaces) == 1 else (None,)
    inside = space is not None and any(fnmatchcase(space, pattern) for pattern in within)
    return listed and not (last and last[-1]) and not inside


def crowd(count: int = len(NAMES)) -> oc.Scene:
    """Return boxes that all collide."""
    scene = oc.Scene()
    for name in NAMES[:count]:
        scene.add(name, oc.shapes.Box([1, 1, 1]))
    return scene


def counted(scene: oc.Scene, rules: Any, only: Any, within: Any) -> list[tuple[str, str]]:
    """Return the pairs that count, in the order of a report."""
    pairs = combinations(scene.names, 2)
    return [(a, b) for a, b in pairs if counts(a, b, rules, only, within)]


@given(rules, only, within, st.data())
def test_pairs_count_as_every_filter_says(
    rules: Any, only: Any, within: Any, data: st.DataObject
) -> None:
    scene = crowd(data.draw(st.integers(0, len(NAMES))))
    report, everything = scene.check(), list(combinations(scene.names, 2))
    for rule in rules:
        scene.allow(*rule)
    # a rule that is set again moves to the end
    last = [rule for n, rule in enumerate(rules) if not _comes_again(rule, rules[n + 1 :])]
    scene.rules.check_only, scene.rules.allowed_within = only, within
    for _ in range(3):  # objects come, go and change their slots
        expected = counted(scene, last, only, within)
        assert scene.any_collision() == bool(expected)
        assert scene.check().names() == expected
        assert scene.check(["contacts"]).contacts.pairs.tolist() == scene.check().pairs.tolist()
        for name in data.draw(st.lists(st.sampled_from(NAMES), max_size=4)):
            if name in scene:
                scene.remove(name)
            else:
                scene.add(name, oc.shapes.Box([1, 1, 1]))
    assert report.names() == everything, "a report stays as it was"
    scene.rules.check_only, scene.rules.allowed_within, scene.rules.allowed = [], [], []
    assert scene.check().names() == counted(scene, [], [], [])


def _comes_again(rule: Any, later: Any) -> bool:
    return any({rule[0], rule[1]} == {other[0], other[1]} for other in later)


def test_rules_that_were_taken_back_are_forgotten() -> None:
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
        with pytest.raises(ValueError, match="names or patterns"):
            scene.rules.allowed = wrong
    with pytest.raises(ValueError, match="names or patterns"):
        scene.allow("", "*")
    assert len(scene.rules.allowed) == 2
    for k in range(2000):
        scene.rules.allowed = [("arm/*", f"cup/{k}", True)]
    scene.clear()
    assert scene.rules.allowed == [("arm/*", "cup/1999", True)]


@each(
    "name, value",
    [
        ("check_only", [("", "a")]),
        ("check_only", [("a", ())]),
        ("check_only", [("a", "b", "c")]),
        ("check_only", ["ab"]),
        ("check_only", 3),
        ("allowed_within", [3]),
        ("allowed_within", "\n"),
        ("padding_overrides", [("a", -1.0)]),
        ("padding_overrides", [("a", float("nan"))]),
        ("padding_overrides", [("", 1.0)]),
        ("padding_overrides", [("a",)]),
        ("padding_overrides", 3),
    ],
)
def test_what_is_no_filter_is_refused_and_changes_nothing(name: str, value: Any) -> None:
    scene = crowd(5)
    scene.rules.check_only, scene.rules.allowed_within = [("a/*", "b/*")], ["a"]
    scene.objects.padding_overrides = [("a*", 0.5)]
    part = scene.objects if name == "padding_overrides" else scene.rules
    before, boxes = getattr(part, name), scene.boxes.half_extents
    with pytest.raises(ValueError, match=name):
        setattr(part, name, value)
    assert getattr(part, name) == before
    assert (scene.boxes.half_extents == boxes).all()


def test_paddings_follow_names_however_objects_come() -> None:
    scene = oc.Scene(padding=0.125)
    scene.objects.padding_overrides = [("a/*", 0.25), ("*/3", 0.5)]
    one, pose = oc.shapes.Box([1, 1, 1]), [0, 0, 0, 0, 0, 0, 1]
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
        scene.add(f"a/{n}", oc.shapes.Box([1, 1, 1]), [1.25 * n, 0, 0, 0, 0, 0, 1])
    assert scene.check().names() == []
    scene.objects.padding_overrides = [("a/0", 0.25)]
    assert scene.check().names() == [("a/0", "a/1")]
    scene.set_padding("a/2", 0.25)
    assert scene.check().names() == [("a/0", "a/1"), ("a/1", "a/2")]
    scene.objects.padding_overrides = []
    assert scene.check().names() == [("a/1", "a/2")]

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


@given(rules, only, within, st.lists(st.permutations(NAMES), min_size=1, max_size=4), st.data())
def test_pairs_count_as_every_filter_says(
    rules: Any, only: Any, within: Any, orders: list[list[str]], data: st.DataObject
) -> None:
    filters = oc.Scene().rules
    for rule in rules:
        filters.add(*rule)
    filters.check_only, filters.allowed_within = only, within
    # a rule that is set again moves to the end
    rules = [rule for n, rule in enumerate(rules) if not _comes_again(rule, rules[n + 1 :])]
    for version, order in enumerate(orders):  # objects come, go and change their slots
        size = data.draw(st.integers(0, len(order)))
        gone = data.draw(st.sets(st.integers(0, len(order))))
        shown = order[:size]
        names = [None if n in gone else name for n, name in enumerate(shown)]
        pair_filter = filters.pair_filter(names, version)
        if pair_filter is None:
            assert [*rules, *only, *within] == []
            continue
        live = [n for n, name in enumerate(names) if name is not None]
        pairs = np.array(list(combinations(live, 2)), np.int64).reshape(-1, 2)
        expected = [counts(shown[i], shown[j], rules, only, within) for i, j in pairs.tolist()]
        assert pair_filter(*pairs.T).tolist() == expected


def _comes_again(rule: Any, later: Any) -> bool:
    return any({rule[0], rule[1]} == {other[0], other[1]} for other in later)


def test_a_filter_in_use_stays_as_it_was_when_names_change() -> None:
    filters = oc.Scene().rules
    filters.allowed_within = ["*"]
    first = filters.pair_filter(["a/1", "a/2", "b/1"], 1)
    assert first is not None
    pairs = np.array([0, 0]), np.array([1, 2])
    assert first(*pairs).tolist() == [False, True]
    second = filters.pair_filter(["a/1", "b/2", "a/3", "c/1"], 2)
    assert second is not None
    assert second(*pairs).tolist() == [True, False]
    assert first(*pairs).tolist() == [False, True]


def row_of_cubes(count: int = 5) -> oc.Scene:
    scene = oc.Scene()
    for n in range(count):
        scene.add(f"{'ab'[n % 2]}/{n}", oc.shapes.Box([1, 1, 1]), [0.25 * n, 0, 0, 0, 0, 0, 1])
    return scene


def test_a_scene_checks_only_the_pairs_it_is_told_to() -> None:
    scene = row_of_cubes()
    everything = scene.check().names()
    assert len(everything) == 10
    scene.rules.check_only = [("a/*", ("b/1", "b/3"))]
    mixed = [(a, b) for a, b in everything if a[0] != b[0]]
    assert scene.check().names() == mixed
    assert scene.any_collision()
    scene.allow("a/0", "*")
    assert scene.check().names() == [(a, b) for a, b in mixed if "a/0" not in (a, b)]
    scene.rules.check_only = [("a/0", "*")]
    assert scene.check().names() == []
    assert not scene.any_collision()
    scene.rules.check_only, scene.rules.allowed = [], []
    assert scene.check().names() == everything


def test_objects_may_touch_within_their_namespaces() -> None:
    scene = row_of_cubes()
    everything = scene.check().names()
    scene.rules.allowed_within = ["*"]
    assert scene.check().names() == [(a, b) for a, b in everything if a[0] != b[0]]
    scene.add("b/9", oc.shapes.Box([9, 9, 9]))  # those to come, too
    assert ("b/1", "b/9") not in scene.check().names()
    scene.remove("b/9")
    scene.rules.allowed_within = "b"
    assert scene.check().names() == [(a, b) for a, b in everything if (a[0], b[0]) != ("b", "b")]
    assert scene.rules.allowed_within == ["b"]


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
    scene = row_of_cubes()
    scene.rules.check_only, scene.rules.allowed_within = [("a/*", "b/*")], ["a"]
    scene.objects.padding_overrides = [("a/*", 0.5)]
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

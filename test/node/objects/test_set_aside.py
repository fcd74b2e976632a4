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

"""Checks that fail with some objects: those are set aside, named, grey, and the rest is checked."""

from __future__ import annotations

from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from each import each
from objects_rig import START, ObjectsRig, UnforeseenError
from rig import A1, A2, Patch, Rig, color, cube, pose, sync

from obb_collision import find_pairs
from obb_collision.node import namespace_number
from obb_collision.node.cycle.cycle import MAX_TRIES, RETRY_PERIOD, SetAside
from obb_collision.node.diagnostics.answer import UNKNOWN, Reason
from obb_collision.node.messages.box_markers import COLORS, DOUBTFUL
from obb_collision.node.objects.conditions import ASIDE
from obb_collision.node.objects.states import State
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.status import objects_answer
from obb_collision.scene import checker
from obb_collision.scene.effects import clearance, contacts, points
from obb_collision.scene.objects import SceneObjects

BAD = ("bad", 1)


class Failing:
    """Makes checks fail while all objects of one of some groups of slots take part."""

    def __init__(self, patch: Patch) -> None:
        self.groups: list[set[int]] = []
        self.calls = 0
        find = checker.Checker.find

        def fail_or_find(checker: Any, *args: Any) -> Any:
            self.calls += 1
            active = set(np.flatnonzero(checker._store.active).tolist())
            if any(group <= active for group in self.groups):
                raise UnforeseenError("by the test")
            return find(checker, *args)

        patch.setattr(checker.Checker, "find", fail_or_find)


class Checked:
    """Cubes in a line, each colliding with the next one, and their checks."""

    def __init__(self, count: int, patch: Patch) -> None:
        self.rig = ObjectsRig(*(("a", number) for number in range(count)))
        poses = np.zeros((count, 7))
        poses[:, 0], poses[:, 6] = 0.75 * np.arange(count), 1.0
        self.rig.objects.states.store(self.rig.slots, poses, State("", 0, START))
        self.rig.cycle()
        self.failing = Failing(patch)
        self.guard = Guard(lambda line: None, lambda: True)
        self.now = 0.0
        self.aside = SetAside(self.rig.objects, self.guard, lambda: self.now)

    def check(self, effects: tuple[str, ...] = ()) -> Any:
        self.failing.calls = 0
        return self.aside.check(effects)

    def slots_aside(self) -> list[int]:
        return np.flatnonzero(self.rig.objects.table.has(ASIDE)).tolist()

    def pairs_without(self, *bad: int) -> list[list[int]]:
        """Pairs of all other objects, by a scene of their own."""
        kept = [slot for slot in self.rig.slots.tolist() if slot not in bad]
        boxes = self.rig.objects.scene.boxes[np.searchsorted(self.rig.slots, kept)]
        return np.array(kept)[find_pairs(boxes)].tolist()


@each("count", [5, 100])
@each("bad", [[0], [2], [4], [1, 3], [0, 1, 2, 3, 4]])
def test_what_fails_is_set_aside_alone(count: int, bad: list[int], monkeypatch: Patch) -> None:
    checked = Checked(count, monkeypatch)
    checked.failing.groups = [{slot} for slot in bad]
    report = checked.check()
    assert report.pairs.tolist() == checked.pairs_without(*bad)
    assert checked.slots_aside() == bad
    assert checked.guard.counts == {"check": len(bad)}
    assert "(a/" in checked.guard.last
    assert checked.failing.calls <= MAX_TRIES
    table = checked.rig.objects.table
    assert table.doubtful[bad].all()
    assert np.flatnonzero(table.unplaceable).tolist() == bad
    found = objects_answer(checked.rig.objects, checked.rig.now)
    assert found.reasons == (Reason("internal_error", tuple(f"a/{n}" for n in bad), len(bad)),)
    assert found.level == UNKNOWN


def test_of_objects_that_fail_only_together_one_is_set_aside(monkeypatch: Patch) -> None:
    checked = Checked(50, monkeypatch)
    checked.failing.groups = [{7, 31}, {3, 4, 40}]
    report = checked.check()
    aside = checked.slots_aside()
    assert len(aside) == 2
    assert all(group & set(aside) for group in checked.failing.groups)
    assert report.pairs.tolist() == checked.pairs_without(*aside)


def test_the_next_checks_cost_no_more_until_they_are_tried_again(monkeypatch: Patch) -> None:
    checked = Checked(20, monkeypatch)
    checked.failing.groups = [{3}, {11}]
    checked.check()
    for _ in range(5):
        checked.check()
        assert checked.failing.calls <= 1
    checked.failing.groups = [{11}]
    assert checked.slots_aside() == [3, 11]
    checked.now = RETRY_PERIOD
    assert checked.check().pairs.tolist() == checked.pairs_without(11)
    assert checked.slots_aside() == [11]
    checked.failing.groups = []
    checked.now = 2 * RETRY_PERIOD
    assert checked.check().pairs.tolist() == checked.pairs_without()
    assert checked.slots_aside() == []
    assert not checked.rig.objects.table.doubtful.any()


def test_many_that_fail_are_found_over_several_cycles(monkeypatch: Patch) -> None:
    checked = Checked(400, monkeypatch)
    bad = list(range(0, 400, 4))
    checked.failing.groups = [{slot} for slot in bad]
    cycles = 0
    while checked.slots_aside() != bad:
        cycles += 1
        assert cycles < 20
        report = checked.check()
        assert checked.failing.calls <= MAX_TRIES + 4, "no cycle takes long"
        assert set(map(tuple, report.pairs.tolist())) <= set(map(tuple, checked.pairs_without()))
    assert cycles > 1
    assert report.pairs.tolist() == checked.pairs_without(*bad)


@each("error", [UnforeseenError, MemoryError])
def test_what_fails_without_any_object_is_no_objects_fault(error: Any, monkeypatch: Patch) -> None:
    checked = Checked(5, monkeypatch)
    with monkeypatch.context() as patch:
        patch.setattr(checker.Checker, "find", Mock(side_effect=error))
        with pytest.raises(error):
            checked.check()
    assert checked.slots_aside() == []
    assert checked.check().pairs.tolist() == checked.pairs_without()


def test_one_that_is_removed_or_comes_anew_is_no_longer_set_aside(monkeypatch: Patch) -> None:
    checked = Checked(5, monkeypatch)
    checked.failing.groups = [{2}]
    checked.check()
    checked.failing.groups = []
    objects = checked.rig.objects
    objects.shapes.remove(np.array([2]))
    assert checked.check().pairs.tolist() == [[0, 1], [3, 4]]
    assert checked.slots_aside() == []
    assert not objects.table.doubtful.any()


@each("stage", ["placing objects", "check"])
def test_an_object_that_fails_is_unknown_alone(stage: str, rig: Rig, monkeypatch: Patch) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0)), cube(BAD, (6, 0, 0)))
    assert rig.pairs() == set()
    table, place = rig.node.objects.table, SceneObjects.place
    bad = table.slots[BAD]

    def fail(scene: Any, slots: Any, poses: Any) -> None:
        if bad in slots:
            raise UnforeseenError("by the test")
        place(scene, slots, poses)

    if stage == "check":
        Failing(monkeypatch).groups = [{bad}]
    else:
        monkeypatch.setattr(SceneObjects, "place", fail)
    rig.send_states(["a/2", "bad/1"], [pose(4), pose(7)])
    rig.says(UNKNOWN, "bad/1")
    assert rig.node.guard.counts[stage] >= 1
    assert "bad/1" in rig.node.guard.last
    assert "cycle" not in rig.node.guard.counts
    rig.until(lambda: grey(rig) == ["bad"], "one grey marker")
    rig.send_states(["a/2"], [pose(0.5)])
    assert rig.pairs() == {("a/1", "a/2")}
    kind = "unplaceable" if stage == "check" else "refused"
    assert "bad/1" in rig.status(": objects")[f"names {kind}"]
    monkeypatch.undo()
    rig.send_states(["bad/1"], [pose(0.7)])
    rig.until(lambda: len(sync(rig)) == 3, "all pairs, once it is tried again")
    assert not table.doubtful.any()


def grey(rig: Rig) -> list[str]:
    markers = rig.next("obb_collision/markers").markers
    return [marker.ns for marker in markers if color(marker) == COLORS[DOUBTFUL]]


FAR = 50.0
"""Where the objects are (m, y) for which effects fail."""
EFFECTS = {
    "contacts": (contacts, "pair_contacts", "contacts"),
    "clearances": (clearance, "near_pairs", "clearance"),
    "points_inside": (points, "points_in_bodies", "points"),
}


@each("topic", list(EFFECTS))
def test_an_effect_that_fails_names_its_object(topic: str, rig: Rig, monkeypatch: Patch) -> None:
    module, function, effect = EFFECTS[topic]
    given = getattr(module, function)

    def fail(boxes: Any, some: Any, *args: Any) -> Any:
        rows = np.arange(len(boxes)) if effect == "points" else some.ravel()
        if (boxes.centers[rows, 1] >= FAR).any():
            raise UnforeseenError("by the test")
        return given(boxes, some, *args)

    monkeypatch.setattr(module, function, fail)
    bad = cube(BAD, (0, FAR, 0)), cube(("bad", 2), (0.5, FAR, 0))
    rig.send(cube(A1), cube(A2, (0.5, 0, 0)), *bad)
    rig.send_points([[0.0, 0, 0], [0.0, FAR, 0]])
    if effect != "points":
        rig.stamp -= 1_000_000  # that of the points is none of the states
        assert rig.pairs() == {("a/1", "a/2"), ("bad/1", "bad/2")}
    cloud = rig.until(lambda: (message := rig.next(topic)).width and message, "rows of the others")
    number = namespace_number("bad").to_bytes(4, "little", signed=True)
    assert number not in bytes(cloud.data), "left out"
    assert namespace_number("a").to_bytes(4, "little", signed=True) in bytes(cloud.data)
    key = f"effect {effect} last failure"
    assert "bad/" in rig.until(lambda: rig.status("cycle").get(key), "a failure that is named")

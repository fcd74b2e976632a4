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

"""The table of objects: their conditions, how names and keys find them, and room for more."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")
from each import each
from objects_rig import ObjectsRig

import obb_collision
from obb_collision.node import namespace_number
from obb_collision.node.messages.conversions import name_from_key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import stand_in
from obb_collision.node.objects import conditions
from obb_collision.node.objects.conditions import (
    ALL,
    LIVE,
    STALE,
    STATES,
    TIRED,
    WAITING,
    Event,
    begin,
    end,
    happen,
    judge,
)
from obb_collision.node.objects.table import COLUMNS, FIRST_ROWS, ObjectTable
from obb_collision.shapes import Box

EVENTS = {name: value for name, value in vars(conditions).items() if isinstance(value, Event)}
WRITER = "conditions.py"


@each("event", EVENTS.values())
def test_an_event_changes_its_facts_only_and_needs_others(event: Event) -> None:
    assert event.needs & LIVE
    for before in range(0, ALL + 1, 7):
        column = np.array([before], np.uint16)
        if before & event.needs == event.needs:
            happen(column, np.array([0]), event)
            assert column[0] == before & ~event.ends | event.begins
            assert column[0] & LIVE
        else:
            with pytest.raises(ValueError, match="that cannot be"):
                happen(column, np.array([0]), event)
            assert column[0] == before


@each("name", [name for name in EVENTS if name.endswith("_REFUSED")])
def test_what_is_refused_is_never_placed(name: str) -> None:
    assert EVENTS[name].begins & STATES["refused"]


def test_who_waits_no_longer_is_not_tired() -> None:
    for event in EVENTS.values():
        assert bool(event.ends & WAITING) <= bool(event.ends & TIRED)


def test_a_new_object_is_unplaced_and_one_that_ended_has_no_fact() -> None:
    column = np.full(3, ALL, np.uint16)
    end(column, slice(0, 2))
    begin(column, np.array([1]))
    judge(column, STALE, np.array([True, False, True]))
    assert column.tolist() == [0, LIVE | STATES["unplaced"], ALL]
    with pytest.raises(ValueError, match="judged"):
        judge(column, LIVE, column > 0)


def test_nothing_else_writes_conditions() -> None:
    package = Path(obb_collision.__file__).parent
    for file in package.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store):
                written = ast.unparse(node.value)
                assert "condition" not in written.split(".")[-1] or file.name == WRITER, file


SPACES = ("", "/", "a", "/a", "a/b", "b", "5", "#7", "é", stand_in(namespace_number("b")))
IDS = (0, 1, -1, 5, 2**31 - 1, -(2**31))
KEYS = st.tuples(st.sampled_from((*SPACES, 7, namespace_number("b"))), st.sampled_from(IDS))
"""Of an object: its namespace, or the number of one, and its id."""
TEXTS = ("", "01", "-0", "+1", " 1", "x", "1.0", str(2**31), str(-(2**31) - 1), str(2**32 + 1))
NAMES = st.tuples(
    st.sampled_from(("", "/", *(f"{space}/" for space in SPACES), "\ud800/", "no/")),
    st.sampled_from((*map(str, IDS), *TEXTS)),
).map("".join)


def slot_of(name: str, table: ObjectTable) -> int:
    """Return the slot of the first object whose name is this one, with a slash in front or not."""
    for text in (name, "/" + name):
        for slot in np.flatnonzero(table.live).tolist():
            (namespace, ident), number = table.key(slot), int(table.ns[slot])
            known = [namespace]
            if namespace == stand_in(number):  # its name was not received yet
                known += [space for space in SPACES if namespace_number(space) == number]
            if text in [f"{each}/{ident}" for each in known]:
                return int(slot)
    return -1


@settings(max_examples=300, deadline=None)
@given(
    changes=st.lists(st.tuples(st.booleans(), KEYS), max_size=20),
    names=st.lists(NAMES, max_size=20),
)
def test_the_slots_are_those_of_a_search(
    changes: list[tuple[bool, tuple[str | int, int]]], names: list[str]
) -> None:
    table = ObjectTable()
    free = iter(range(len(changes)))
    for ends, (space, ident) in changes:
        try:
            known = table.namespaces
            number = known.admit(space) if isinstance(space, str) else known.admit_number(space)
        except RefusedError:
            continue
        (slot,) = table.find(np.array([number]), np.array([ident])).tolist()
        if slot < 0:
            table.claim_many(np.array([next(free)]), np.array([number]), np.array([ident]))
        elif ends:
            table.release_many(np.array([slot]))
            known.forget_unused()
    expected = [slot_of(name, table) for name in names]
    assert table.find_named(names).tolist() == expected
    assert table.find_named([]).tolist() == []


def test_an_id_that_is_too_large_is_not_one_of_the_next_namespace() -> None:
    table = ObjectTable()
    table.claim(0, ("a", 1))
    following = table.namespaces.admit_number(namespace_number("a") + 1)
    table.claim_many(np.array([1]), np.array([following]), np.array([1]))
    names = ["a/1", f"a/{1 + 2**32}", f"{stand_in(following)}/{1 - 2**32}", f"#{following}/1"]
    assert table.find_named(names).tolist() == [0, -1, -1, 1]


@each("failing", range(0, len(COLUMNS), 2))
def test_an_object_without_room_in_the_tables_leaves_no_trace(
    failing: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = [("box", k) for k in range(FIRST_ROWS + 1)]
    rig = ObjectsRig(*keys[:-1])
    calls, made = 0, np.zeros_like

    def zeros_like(*given: Any, **options: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > failing:
            raise MemoryError
        return made(*given, **options)

    objects = rig.objects
    monkeypatch.setattr(np, "zeros_like", zeros_like)
    with pytest.raises(MemoryError):
        objects.shapes.put(keys[-1], Box([1.0, 1.0, 1.0]))
    monkeypatch.undo()
    assert len({len(getattr(objects.table, column)) for column in COLUMNS}) == 1
    for known in (keys[:-1], keys):
        objects.update(rig.now)
        assert objects.scene.names == [name_from_key(key) for key in known]
        assert objects.table.keys(objects.scene.indices) == known
        objects.shapes.put(keys[-1], Box([1.0, 1.0, 1.0]))

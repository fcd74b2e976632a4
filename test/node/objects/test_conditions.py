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

"""The condition of an object changes by legal events only, and by nothing else."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
from each import each

import obb_collision
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

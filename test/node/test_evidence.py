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

"""What is known of collisions, by the state of the objects: each code reached, and left again."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")
from objects_rig import START, ObjectsRig

from obb_collision.node.diagnostics.answer import COLLIDING, UNKNOWN, Answer, Reason
from obb_collision.node.objects.refusals import MAX_NAMES, MAX_READ, MEMORY, UnknownObjects
from obb_collision.scene.store.overrides import Overrides

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)


def test_names_of_unknown_objects_count_for_a_second_and_not_after_their_delete() -> None:
    rig = ObjectsRig(A1)
    unknown = UnknownObjects(rig.objects.table)
    unknown.ignored = Overrides([("dust/*", True)])
    unknown.note(["a/1", "/a/2", "b/1", "dust/7"], START)
    assert unknown.names(START) == ["a/2", "b/1"]
    unknown.deleted([B1], START + 1)
    unknown.note(["b/1"], START + MEMORY)
    assert unknown.names(START + MEMORY - 1) == ["a/2"]
    assert unknown.names(START + MEMORY) == []
    unknown.note(["b/1"], START + MEMORY + 1)
    unknown.clock_jumped(-MEMORY)
    assert unknown.names(START + 1) == ["b/1"]
    dust = [f"dust/{number}" for number in range(MAX_READ)]
    unknown.note([*dust[1:], "a/2"], START + 1)
    assert unknown.names(START + 1) == ["b/1", "a/2"]
    assert not unknown.left_out(START + 1)
    unknown.note([*dust, "dust/unread"], START + 1)
    assert unknown.left_out(START + 1), "whether that is ignored is not known"
    unknown.note((f"c/{number}" for number in range(2 * MAX_NAMES)), START + 1)
    assert len(unknown.names(START + 1)) == MAX_NAMES
    assert unknown.left_out(START + MEMORY), "there are at least so many"
    assert not unknown.left_out(START + MEMORY + 1)


def test_reasons_are_in_the_order_of_the_codes_each_once_and_pairs_come_first() -> None:
    stale, blocked = Reason("stale", ("a/1",), 12), Reason("blocked")
    found = Answer((), stamp=None).but(stale).but(blocked, Reason("stale", ("a/2",)))
    assert [(each.code, each.who) for each in found.reasons] == [
        ("blocked", ()),
        ("stale", ("a/1",)),
    ]
    assert (found.level, found.flag(True), found.flag(False)) == (UNKNOWN, True, False)
    status = found.to_ros("node", START, True)
    values = {pair.key: pair.value for pair in status.values}
    assert (values["reason"], values["who"], values["reasons"]) == ("blocked", "", "blocked stale")
    assert "a/1 and 11 more" in status.message
    assert Answer((stale,), pairs=1).level == COLLIDING
    assert Answer((stale,), pairs=1).flag(False)

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

from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
from objects_rig import SECOND, START, ObjectsRig

from obb_collision.node.diagnostics.answer import COLLIDING, FREE, UNKNOWN, Answer, Reason
from obb_collision.node.objects.refusals import MAX_NAMES, MAX_READ, MEMORY, UnknownObjects
from obb_collision.node.objects.staleness import AgeLimits
from obb_collision.node.objects.table import COLLIDE, IGNORE, KEEP
from obb_collision.scene.store.overrides import Overrides
from obb_collision.shapes import Box

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)


def known(rig: ObjectsRig, seconds: float = 0.0) -> Answer:
    """Return what is known some seconds later, after a cycle."""
    rig.now += round(seconds * SECOND)
    rig.cycle()
    return rig.known()


def codes(rig: ObjectsRig, seconds: float = 0.0) -> dict[str, tuple[str, ...]]:
    """Return whom each reason is about, some seconds later, after a cycle."""
    return {reason.code: reason.who for reason in known(rig, seconds).reasons}


def late() -> ObjectsRig:
    """Return an object that was placed, and a state of it that waits for its frame."""
    rig = ObjectsRig(A1)
    rig.frames.spans["arm"] = (START, START + SECOND)
    rig.send(START + 1, "arm")
    assert known(rig).level == FREE
    rig.now += 2 * SECOND
    rig.send(START + 2 * SECOND, "arm")
    rig.cycle()
    return rig


def test_a_refused_newcomer_counts_until_its_lifetime_ends_and_that_declares_nothing() -> None:
    rig = ObjectsRig()
    rig.objects.declare_empty()
    rig.objects.shapes.refuse(A2, "bad scale", shape=True, expiry=START + SECOND)
    rig.objects.shapes.refuse(B1, "bad scale", shape=True)
    assert codes(rig) == {"refused": ("a/2 (bad scale)", "b/1 (bad scale)")}
    assert codes(rig, 2.0) == {"refused": ("b/1 (bad scale)",)}
    assert rig.objects.unplaceable.pop(B1)
    assert rig.objects.is_empty
    assert not rig.objects.is_declared_empty


def test_an_object_that_is_not_placed_in_time_is_late_until_it_is() -> None:
    rig = late()
    assert codes(rig, 0.1) == {}, "it may still come in time"
    found = known(rig, 0.2)
    assert (found.level, found.flag(True), found.flag(False)) == (UNKNOWN, True, False)
    assert found.reasons == (Reason("late_frame", ("a/1",), 1),)
    rig.frames.spans["arm"] = (START, START + 3 * SECOND)
    assert codes(rig, 1.0) == {}, "placed at last"
    assert rig.x() == 2.0


def test_what_collides_is_said_though_another_object_is_not_placed_in_time() -> None:
    rig = late()
    rig.objects.shapes.put(B1, Box((1.0, 1.0, 1.0)))
    rig.slots = np.append(rig.slots, rig.objects.table.slots[B1])
    rig.send(START, row=1)
    found = known(rig, 0.3)
    assert (found.level, [each.code for each in found.reasons]) == (COLLIDING, ["late_frame"])


@pytest.mark.parametrize("shape", [True, False])
def test_an_object_whose_latest_state_was_refused_is_not_known_until_one_is_accepted(
    shape: bool,
) -> None:
    rig = ObjectsRig(A1)
    rig.send(START)
    assert known(rig).level == FREE
    rig.objects.shapes.refuse(A1, "bad", shape=shape)
    found = known(rig)
    assert (found.level, found.flag(True), found.flag(False)) == (UNKNOWN, True, False)
    assert found.reasons == (Reason("refused", ("a/1",), 1),)
    if shape:
        rig.objects.shapes.put(A1, Box((1.0, 1.0, 1.0)))
    rig.send(START + 1)
    assert codes(rig) == {}


def test_an_object_is_without_a_pose_until_its_frame_is_known() -> None:
    rig = ObjectsRig(A1, A2)
    rig.send(START + 1, "robot", 0)
    rig.send(START + 1, "", 1)
    assert codes(rig) == {"unplaced": ("a/1",)}
    assert codes(rig, 9.0) == {"unplaced": ("a/1",)}, "one code for each object"
    rig.frames.spans["robot"] = START, START + 99 * SECOND
    assert known(rig, 1.0).level == COLLIDING


def limits(**options: Any) -> ObjectsRig:
    """Return objects a/1, a/2 apart from b/1, each told of once, and their limits."""
    rig = ObjectsRig(A1, A2, B1)
    rig.objects.staleness.limits = AgeLimits(**options)
    for row in range(3):
        rig.send(START + (1 + 5 * row) * SECOND, row=row)
    rig.now += SECOND
    rig.cycle()
    return rig


def test_the_limit_of_all_counts_from_the_second_message_and_one_by_name_from_the_first() -> None:
    rig = limits(timeout=0.5, timeouts=Overrides([("b/*", 2.0)]))
    assert codes(rig) == {}, "told of once"
    assert codes(rig, 1.5) == {"stale": ("b/1",)}
    rig.send(START + 40 * SECOND, row=0)
    assert codes(rig, 0.4) == {"stale": ("b/1",)}
    assert codes(rig, 0.2) == {"stale": ("a/1", "b/1")}
    rig.send(START + 50 * SECOND, row=0)
    rig.send(START + 60 * SECOND, row=2)
    assert codes(rig) == {}
    rig.objects.staleness.limits = AgeLimits(timeouts=Overrides([("a/*", 0.5), ("a/2", 0.0)]))
    assert codes(rig, 1.0) == {"stale": ("a/1",)}


def test_the_policy_of_stale_objects_goes_by_name() -> None:
    policies = Overrides([("a/1", KEEP), ("a/2", IGNORE), ("b/1", COLLIDE)])
    rig = limits(timeouts=Overrides([("*", 0.5)]), policies=policies, speed=1.0, reach=1.0)
    found = known(rig)
    assert (found.level, found.reasons, found.counts["stale"]) == (FREE, (), 3)
    assert [note for note in found.notes if "a/1" in note], "what is accepted is said"
    assert codes(rig, 5.0) == {"stale": ("b/1",)}, "beyond its growth"
    rig.objects.shapes.refuse(A2, "bad", shape=False)
    assert codes(rig) == {"stale": ("b/1",)}, "a/2 takes part in nothing"
    rig.send(START + 20 * SECOND, row=2)
    assert codes(rig) == {}


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

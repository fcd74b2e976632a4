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

"""What is known of collisions after a cycle, by the state of the objects."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
from objects_rig import SECOND, START, ObjectsRig
from rig import cube

from obb_collision.node.diagnostics import answer as answers
from obb_collision.node.diagnostics.answer import COLLIDING, FREE, UNKNOWN, Answer, answer
from obb_collision.shapes import Box

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
PAIR = (cube(A1), cube(A2, (0.5, 0, 0)))
STATUS = "collision_status"


def test_a_refused_newcomer_is_forgotten_when_its_lifetime_ends() -> None:
    rig = ObjectsRig(A1)
    rig.send(START + 1)
    rig.objects.shapes.refuse(A2, "bad scale", shape=True, expiry=START + SECOND)
    rig.objects.shapes.refuse(B1, "bad scale", shape=True)
    rig.cycle()
    assert set(rig.objects.unplaceable) == {A2, B1}
    rig.now += 2 * SECOND
    rig.cycle()
    assert set(rig.objects.unplaceable) == {B1}


def known(rig: ObjectsRig, **options: Any) -> Answer:
    """Return what is known after a cycle, checked as the node does."""
    rig.cycle()
    given: dict[str, Any] = {"paused": "", "failed": False, "timeout": rig.object_timeout} | options
    report = rig.objects.scene.check()
    return answer(rig.objects, given.pop("report", report), now=rig.now, **given)


def late(policy: str, object_timeout: float = 0.0) -> ObjectsRig:
    """Return an object that was placed, and a state of it that waits in vain for its frame."""
    rig = ObjectsRig(A1, object_timeout=object_timeout)
    rig.objects.staleness.set(policy, 1.0, 1.0)
    rig.frames.spans["arm"] = (START, START + SECOND)
    rig.send(START + 1, "arm")
    assert known(rig).level == FREE
    rig.now += 2 * SECOND
    rig.send(START + 2 * SECOND, "arm")
    rig.cycle()
    rig.now += SECOND // 10  # less than transform_timeout
    return rig


@pytest.mark.parametrize("policy", ["keep", "ignore"])
def test_an_object_that_is_not_placed_in_time_makes_the_answer_unknown(policy: str) -> None:
    rig = late(policy)
    assert known(rig).level == FREE, "it may still come in time"
    rig.now += SECOND // 5
    found = known(rig)
    assert (found.level, found.flag(True), found.flag(False)) == (UNKNOWN, True, False)
    assert found.message == "1 not placed in time: a/1"
    rig.frames.spans["arm"] = (START, START + 3 * SECOND)
    rig.now += SECOND
    assert known(rig).level == FREE, "placed at last"


@pytest.mark.parametrize("shape", [True, False])
def test_an_object_whose_latest_state_was_refused_makes_the_answer_unknown(shape: bool) -> None:
    rig = ObjectsRig(A1, B1, object_timeout=1.5)
    rig.objects.staleness.set("ignore", 1.0, 1.0)
    rig.send(START, row=0)
    rig.send(START + 9 * SECOND, row=1)
    assert known(rig).level == FREE
    rig.objects.shapes.refuse(A1, "bad", shape=shape)
    found = known(rig)
    assert (found.level, found.flag(True), found.flag(False)) == (UNKNOWN, True, False)
    assert found.message == "1 refused, where they were before: a/1"
    rig.now += 2 * SECOND
    rig.send(START + 10 * SECOND, row=1)
    assert known(rig).level == FREE, "it is stale, and takes part in nothing"


def test_a_stale_object_that_is_not_placed_counts_as_far_as_it_takes_part() -> None:
    levels = {}
    for policy in ("keep", "ignore"):
        rig = late(policy, object_timeout=1.5)
        rig.now += SECOND // 5
        rig.cycle()
        assert rig.objects.table.stale[rig.slots[0]]
        rig.objects.shapes.put(B1, Box((1.0, 1.0, 1.0)), (), None)  # a fresh one, elsewhere
        rig.slots = np.array([rig.objects.table.slots[B1]])
        rig.send(rig.now)
        levels[policy] = known(rig).level
    assert levels == {"keep": UNKNOWN, "ignore": FREE}


def test_what_collides_is_said_though_another_object_is_not_placed_in_time() -> None:
    rig = late("keep")
    rig.objects.shapes.put(B1, Box((1.0, 1.0, 1.0)), (), None)
    rig.slots = np.array([rig.objects.table.slots[B1]])
    rig.send(START)
    rig.now += SECOND // 5
    found = known(rig)
    assert found.level == COLLIDING
    assert found.message == "1 pair collides; 1 not placed in time: a/1"


def test_no_state_for_longer_than_the_timeout_is_not_known() -> None:
    rig = ObjectsRig(A1, A2, object_timeout=0.5)
    rig.send(START + 1)
    assert known(rig).level == COLLIDING, "both in one place"
    rig.objects.shapes.remove(rig.slots[1:2])
    rig.slots = rig.slots[:1]
    assert known(rig).level == FREE
    rig.now += SECOND
    blind = known(rig)
    assert (blind.level, blind.unknown) == (UNKNOWN, answers.BLIND)
    assert blind.message.startswith("no state placed for 1.0 s; 1 stale: a/1")
    assert blind.flag(True)
    assert not blind.flag(False)


def test_one_stale_object_among_others_is_named_only() -> None:
    rig = ObjectsRig(A1, A2, object_timeout=0.5)
    rig.send(START + 1, row=0)
    rig.send(START + 9 * SECOND, row=1)
    rig.now += SECOND
    rig.send(rig.now + SECOND // 2, row=1)
    found = known(rig)
    assert (found.level, found.stale, found.names_stale) == (FREE, 1, ("a/1",))
    assert found.message == "free; 1 stale: a/1"


def test_objects_that_wait_for_their_transform_are_without_a_box() -> None:
    rig = ObjectsRig(A1, A2)
    rig.send(START + 1, "robot", 0)
    rig.send(START + 1, "", 1)
    found = known(rig)
    assert (found.level, found.names_missing) == (UNKNOWN, ("a/1",))
    rig.frames.spans["robot"] = START, START + 5 * SECOND
    assert known(rig).level == COLLIDING


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"paused": answers.DISABLED}, answers.DISABLED),
        ({"failed": True}, answers.FAILED),
        ({"report": None}, answers.UNCHECKED),
        ({"overdue": 0.75}, "overload: states wait for 0.8 s"),
    ],
)
def test_what_makes_the_whole_unknown(options: dict[str, Any], reason: str) -> None:
    rig = ObjectsRig(A1)
    rig.send(START + 1)
    assert known(rig).level == FREE
    found = known(rig, **options)
    assert (found.level, found.message) == (UNKNOWN, reason)

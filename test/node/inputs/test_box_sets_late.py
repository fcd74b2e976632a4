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


"""Sets of boxes in frames whose transforms come late, or never; without topics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
from objects_rig import MILLISECOND, START, KnownUntil
from rclpy.serialization import serialize_message
from rig import pose
from std_msgs.msg import Header

from obb_collision.node import boxes_to_ros
from obb_collision.node.diagnostics.answer import Reason, objects_answer
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.inputs.boxes import BoxInput
from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.frames import EXTRAPOLATION
from obb_collision.node.objects.objects import Objects
from obb_collision.node.runtime.guard import Guard


class MovedFrames(KnownUntil):
    """Frames one metre along x."""

    def lookup(self, frame: str, stamp: int) -> Any:
        return super().lookup(frame, stamp) + np.array([1.0, 0, 0, 0, 0, 0, 0])


class Sets:
    """An input of sets on its own; times in milliseconds since the start."""

    def __init__(self) -> None:
        self.now, self.frames = START, MovedFrames()
        guard = Guard(pytest.fail, lambda: True)
        self.objects = Objects("map", self.frames, guard)
        self.monitor = InputMonitor("object_boxes", lambda text: None)
        self.input = BoxInput(self.objects, self.frames, self.monitor, lambda: self.now, guard)
        self.input.waiting.timeout = 0.2

    def send(self, time: int, *ids: int, frame: str = "camera") -> None:
        stamp = START + time * MILLISECOND
        self.now = max(self.now, stamp)
        header = Header(stamp=stamp_to_ros(stamp), frame_id=frame)
        places = [pose(ident) for ident in ids]
        message = boxes_to_ros(ids, places, np.ones((len(ids), 3)), header=header)
        self.input.take(serialize_message(message))

    def cycle(self, time: int) -> dict[int, float]:
        """Run a cycle; returns where which boxes are."""
        self.now = START + time * MILLISECOND
        self.input.apply()
        self.objects.update(self.now)
        slots = self.objects.table.slots
        places = self.objects.scene.poses_of(list(slots.values()) or np.empty(0, np.int64))[:, 0]
        return {key[1]: float(place) for key, place in zip(slots, places, strict=True)}

    def known_until(self, time: int) -> None:
        self.frames.spans["camera"] = START, START + time * MILLISECOND

    def reasons(self) -> tuple[Reason, ...]:
        return objects_answer(self.objects, self.now).reasons


def test_the_newest_set_that_can_be_placed_is_applied() -> None:
    sets = Sets()
    sets.known_until(10)
    sets.send(0, 1, 2)
    assert sets.cycle(1) == {1: 2.0, 2: 3.0}, "placed by the frame"
    sets.send(20, 3)
    assert sets.cycle(21) == {1: 2.0, 2: 3.0}, "its transform is late: the last set stays"
    sets.send(40, 4)
    sets.known_until(30)
    assert sets.cycle(41) == {3: 4.0}
    sets.known_until(50)
    assert sets.cycle(60) == {4: 5.0}
    assert not sets.monitor.refused
    assert sets.monitor.superseded == 0
    sets.send(45, 5)
    sets.send(48, 6)
    assert sets.cycle(61) == {6: 7.0}
    assert sets.monitor.superseded == 1


def test_sets_that_are_always_late_lag_and_do_not_freeze() -> None:
    sets = Sets()
    seen = []
    for number in range(40):
        sets.known_until(50 * number - 60)
        sets.send(50 * number, number)
        seen.append(list(sets.cycle(50 * number)))
    assert seen[2:] == [[number] for number in range(38)]
    assert not sets.monitor.refused


def test_a_set_that_waits_too_long_is_refused_and_said() -> None:
    sets = Sets()
    sets.known_until(10)
    sets.send(0, 1)
    sets.cycle(1)
    assert sets.reasons() == ()
    sets.send(100, 1, 2)
    sets.cycle(250)
    assert not sets.monitor.refused
    assert sets.cycle(310) == {1: 2.0}
    assert sets.monitor.refused == {EXTRAPOLATION: 1}
    assert sets.reasons() == (Reason("refused", ("boxes/2 (extrapolation)", "boxes/1"), 2),)
    assert sets.objects.table.doubtful[0], "its latest set could not be used"
    sets.known_until(400)
    sets.send(390, 1)
    assert sets.cycle(391) == {1: 2.0}
    assert sets.reasons() == ()
    assert not sets.objects.table.doubtful[0]


def test_a_set_in_an_unknown_frame_leaves_the_one_before_it_to_be_used() -> None:
    sets = Sets()
    sets.frames.waits = False
    sets.send(0, 1, frame="map")
    sets.send(10, 2, frame="nowhere")
    assert sets.cycle(11) == {1: 1.0}
    assert sets.monitor.refused == {"unknown frame": 1}


def test_a_jump_of_the_clock_shifts_what_waits() -> None:
    sets = Sets()
    sets.send(100, 1)
    sets.input.clock_jumped(-1000 * MILLISECOND)
    assert sets.cycle(-950) == {}
    assert not sets.monitor.refused
    sets.send(-900, 2, frame="map")
    assert sets.cycle(-899) == {2: 2.0}, "stamps of before the jump order nothing"


def test_frames_may_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    sets = Sets()
    monkeypatch.setattr(sets.frames, "lookup", lambda *_: np.full(7, np.nan))
    sets.send(0, 1)
    assert sets.cycle(1) == {}
    assert sets.monitor.refused == {"bad transform": 1}

    def refuse(*_: Any) -> Any:
        raise RefusedError("unknown frame")

    monkeypatch.setattr(sets.frames, "lookup", refuse)
    sets.send(2, 1)
    sets.cycle(400)
    assert sets.monitor.refused == {"bad transform": 1, "unknown frame": 1}

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


"""What can be known of inputs of which the newest message counts: sets of boxes, sensors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import inf
from typing import Any, NamedTuple, TypeAlias

from evidence_things import AHEAD, OFFSET, REORDERED, WAIT, Sender, Thing

RADIUS = 0.11
"""Of the balls about points (m): with it nothing just touches."""
LATER, OLDER, REFUSED = "later", "older", "refused"
Points: TypeAlias = "Sequence[float] | None"


class Message(NamedTuple):
    """A message that waits, with the time of its receipt; content: rows, or x of points."""

    frame: str
    stamp: float
    at: float
    content: Any
    sender: Sender


class Newest:
    """Who sends messages, by which stamp of late and when, and what waits; the last one is last."""

    def __init__(self) -> None:
        self.waiting: list[Message] = []
        self.orders: dict[Sender, tuple[float, float]] = {}
        self.taking_turns = False

    def is_in_order(self, sender: Sender, stamp: float, now: float) -> bool:
        """Take note of a message; False for one that is older than the last of its sender."""
        self.taking_turns |= sender in self.orders and [*self.orders][-1] != sender
        order, received = self.orders.pop(sender, (0.0, -inf))
        is_late = 0 < stamp < order and now - received <= REORDERED
        believed = stamp if 0 < stamp <= now + AHEAD else order
        self.orders[sender] = (order, received) if is_late else (believed, now)
        return not is_late

    def forget(self, gone: set[Sender]) -> None:
        if self.taking_turns:
            self.orders = {one: x for one, x in self.orders.items() if one not in gone}
            self.taking_turns = len(self.orders) > 1

    def clear(self) -> None:
        self.waiting.clear()
        self.taking_turns = False

    def jump(self, by: float) -> None:
        self.waiting = [one._replace(at=one.at + by) for one in self.waiting]
        self.orders = {one: (0.0, at + by) for one, (_, at) in self.orders.items()}


class Source(Newest):
    """A sensor that sees points along x. leaves_out: the points of the robot."""

    def __init__(self, topic: str, leaves_out: bool) -> None:
        super().__init__()
        self.topic, self.leaves_out = topic, leaves_out
        self.name = f"sources/{topic}/0"
        self.renew()

    def renew(self) -> None:
        self.thing, self.left_out = Thing(2.0 * RADIUS, ()), False

    def take(self, model: Any, frame: str, stamp: float, points: Points, is_read: bool) -> None:
        """Take a message; points: None if they cannot be used; is_read: whether the rest can."""
        if not is_read:
            self.apply(model)
            self.thing.bad_pose = True
            model.cannot_read()
        elif not self.is_in_order(model.sender, stamp, model.now):
            self.apply(model)
            self.thing.overtaken = True
        else:
            if frame == "map" and not self.leaves_out:
                self.waiting.clear()
            self.waiting.append(Message(frame, stamp, model.now, points, model.sender))

    def apply(self, model: Any) -> None:
        """Use the newest message that can be used; those that are newer are refused or wait."""
        refused: list[str] = []
        waiting, self.waiting = self.waiting, []
        while waiting:
            one = waiting.pop()
            why = self.use(one, model)
            if not why:
                break
            if why == LATER and model.now - one.at <= WAIT and not refused:
                self.waiting.insert(0, one)
            else:
                refused.append(why)
        self.thing.late |= LATER in refused
        self.thing.bad_pose |= REFUSED in refused
        self.thing.overtaken |= OLDER in refused

    def use(self, one: Message, model: Any) -> str:
        """Use a message, or return why not."""
        thing = self.thing
        if not model.is_placed_at(one.frame, one.stamp):
            return LATER
        if 0 < one.stamp < thing.order and one.at - thing.received <= REORDERED:
            return OLDER
        if one.content is None:
            return REFUSED
        shift, spans = OFFSET * (one.frame == "odom"), []
        if self.leaves_out:
            if not model.robot.is_known:
                return REFUSED
            spans = model.robot.spans_at(one.stamp, model.joints_age)
            if spans is None:
                return LATER
        thing.points = [
            x for x in one.content if not any(low <= x + shift <= high for low, high in spans)
        ]
        self.left_out = len(thing.points) < len(one.content)
        model.place_at(thing, shift, one)
        return ""


def senders_of(things: Iterable[Thing]) -> set[Sender]:
    """Return whose states and shapes are in use, and not stale."""
    return {one for thing in things if not thing.stale for one in (thing.sender, thing.maker)}

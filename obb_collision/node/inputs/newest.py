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

"""Inputs of which the newest message replaces all before it: sets of boxes, and sensors.

A message waits until the next cycle, and the newest one that can be placed is applied.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from obb_collision.node.inputs.clouds import QueuedCloud, WaitingClouds
from obb_collision.node.inputs.senders import ALONE, ANY
from obb_collision.node.messages.conversions import NANOSECONDS
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import check_name
from obb_collision.node.objects.frames import FrameSource
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.states import ANEW, OLDER
from obb_collision.typing import Floats, Mask

MOST_SENDERS = 100
"""Senders of an input that are remembered, those heard last."""


class NewestInput:
    """Takes messages of a topic, and applies the newest one; subclasses define what that means.

    read: returns the cloud in the bytes of a message, given how many points or rows are allowed.
    """

    def __init__(
        self,
        objects: Objects,
        frames: FrameSource,
        clock: Callable[[], int],
        topic: str,
        read: Callable[[bytes, int], QueuedCloud],
    ) -> None:
        self._objects, self._table, self._clock = objects, objects.table, clock
        self.topic, self._read = topic, read
        self._monitor = objects.monitors[topic]
        self.waiting = WaitingClouds(objects, frames, self._monitor)
        self._orders: dict[int, tuple[int, int]] = {}
        """By sender, the latest at the end: the stamp (ns) before which others are late, and the
        time of its receipt (ns)."""
        self.is_contested = False
        """Whether several senders take turns, so that each replaces the message of the other."""

    def queue(self, data: bytes, now: int) -> None:
        """Queue a serialised message for the next cycle."""
        sender = self._monitor.sender
        try:
            cloud = self._read(data, self._objects.max_points)
            check_name(cloud.frame, "frame")
            self._note_order(cloud.stamp, now, sender)
        except RefusedError as error:
            self.apply()  # the messages before it
            self._doubt(error.reason)
            if error.reason != OLDER or not self._own.any():
                raise
            self._monitor.refuse(error.reason, "whole message", error.detail)
            return
        cloud = cloud._replace(received=now, sender=sender)
        self._monitor.superseded += self.waiting.add(cloud)

    def _note_order(self, stamp: int, now: int, sender: int) -> None:
        """Store the stamp of a message; RefusedError if its sender has sent a newer one before."""
        self._note_turn(sender)
        states, (order, received) = self._objects.states, self._orders.pop(sender, (0, 0))
        before = order - stamp
        if stamp and before > 0:
            detail = f"{before / NANOSECONDS:.1f} s before the last one"
            if now - received <= states.order_timeout:
                self._orders[sender] = order, received
                raise RefusedError(OLDER, detail)
            self._monitor.doubt(ANEW, "whole message", detail)
        is_believed = stamp and stamp <= now + states.stamp_tolerance
        self._orders[sender] = stamp if is_believed else order, now

    def _note_turn(self, sender: int) -> None:
        """Note the sender: senders that take turns contest the input; one that follows does not."""
        if sender == ALONE:
            self.forget([other for other in self._orders if other != ALONE])
        is_last = next(reversed(self._orders), sender) == sender
        self.is_contested |= sender == ANY or (sender in self._orders and not is_last)
        if len(self._orders) > MOST_SENDERS:
            del self._orders[next(iter(self._orders))]

    @property
    def senders(self) -> tuple[int, ...]:
        """Senders of messages, the latest at the end."""
        return tuple(self._orders)

    def forget(self, senders: Iterable[int]) -> None:
        """Forget senders that are gone; if one is left, the input is no longer contested."""
        for sender in senders:
            self._orders.pop(sender, None)
        self.is_contested &= len(self._orders) > 1

    def cleared(self) -> None:
        """Drop waiting messages: all objects were removed."""
        self.waiting.clouds.clear()
        self.is_contested = False

    def apply(self) -> None:
        """Apply the newest message that can be placed, if one waits."""
        if self.waiting.clouds:
            now = self._clock()
            self._monitor.superseded += self.waiting.use_newest(now, self._use, self._refuse)

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        self.waiting.clock_jumped(shift)
        self._orders = {sender: (0, at + shift) for sender, (_, at) in self._orders.items()}

    @property
    def _own(self) -> Mask:
        """(rows,) which objects came by this input."""
        raise NotImplementedError

    def _use(self, cloud: QueuedCloud, frame: Floats | None) -> None:
        """Use a message whose frame is at ``frame`` (7,), None for the fixed frame."""
        raise NotImplementedError

    def _refuse(self, cloud: QueuedCloud, error: RefusedError) -> None:
        """Take note of a message that cannot be used."""
        raise NotImplementedError

    def _doubt(self, reason: str) -> None:
        """Mark that a newer message could not be used: the objects of the last one stay."""
        raise NotImplementedError

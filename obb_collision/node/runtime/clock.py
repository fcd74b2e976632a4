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

"""Time of the node's clock, and detection of its jumps.

Ages and lifetimes are differences of this clock, so that they stand still with a paused simulation.
Where it jumps (a simulation begins anew, a bag loops, a robot without a battery for its clock gets
the time from the network) they would be off by the jump, so that all stored times must be
shifted.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from obb_collision.node.messages.conversions import NANOSECONDS, stamp_from_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.runtime.inner import refuse_clocks

LARGEST_SLEW = NANOSECONDS // 10
"""The system's clock against steady time: more than this (ns) between two looks is a jump. Looks
are at most seconds apart, and clocks are slewed by 0.5 ms a second at most."""

WARN_PERIOD = 5.0
"""Minimum seconds between two warnings about /clock."""


def boot_time() -> int:
    """Return the nanoseconds of a clock that never jumps, and continues during suspend."""
    try:
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    except (AttributeError, OSError):  # Linux only
        return time.monotonic_ns()


def refuse_bad_clocks(node: Node) -> None:
    """Prevent times before 1970 on /clock from raising exceptions in the executor, as in rclpy."""

    def is_bad(message: Clock) -> bool:
        try:
            stamp_from_ros(message.clock)
        except RefusedError as error:
            warn = node.get_logger().warning
            warn(f"/clock: refused {error}", throttle_duration_sec=WARN_PERIOD)
            return True
        return False

    refuse_clocks(node, is_bad)


class NodeClock:
    """Reads a clock and detects its jumps.

    read: the time (ns); is_simulated: whether it is that of /clock. on_jump(shift, now) is called
    with the length of a jump (ns), before the new time is used. seconds: steady time (s).
    """

    def __init__(
        self,
        read: Callable[[], int],
        is_simulated: Callable[[], bool],
        on_jump: Callable[[int, int], None],
        steady: Callable[[], int] = boot_time,
        seconds: Callable[[], float] = time.monotonic,
    ) -> None:
        self._read, self._is_simulated, self._steady = read, is_simulated, steady
        self._on_jump = on_jump
        self._last, self._last_steady = read(), steady()
        self._was_simulated = is_simulated()
        self.seconds = seconds
        """Steady time (s)."""
        self.moved = seconds()
        """When it was last seen to move, by steady time (s)."""

    @property
    def has_time(self) -> bool:
        """Whether the clock has a time: a simulated one has none before the first /clock."""
        return self._last > 0

    def now(self) -> int:
        """Return the time of the clock (ns)."""
        before, now, steady = self._steady(), self._read(), self._steady()
        if steady - before > LARGEST_SLEW // 2:  # interrupted in between: the readings do not match
            return now
        simulated = self._is_simulated()
        moved, elapsed = now - self._last, steady - self._last_steady
        if moved:
            self.moved = self.seconds()
        shift = 0
        if simulated and self._was_simulated:
            # zero: no message of /clock so far; forward it may go as fast as it likes
            shift = moved if moved < 0 or (self._last == 0 and now > 0) else 0
        elif simulated or self._was_simulated or abs(moved - elapsed) > LARGEST_SLEW:
            shift = moved - elapsed
        self._last, self._last_steady, self._was_simulated = now, steady, simulated
        if shift:
            self._on_jump(shift, now)
        return now

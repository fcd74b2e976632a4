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

"""Motions of joints: their values and velocities at a time, for demos and measurements."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from math import fmod

import numpy as np

from obb_collision.typing import Floats


@dataclass(frozen=True)
class JointLoop:
    """Through states of joints and back to the first, at constant velocities in between.

    states (n, joints); times (n,): when it is at each, seconds, ascending from 0; period: when it
    is back at the first.
    """

    states: tuple[tuple[float, ...], ...]
    times: tuple[float, ...]
    period: float

    def at(self, time: float) -> tuple[Floats, Floats]:
        """Return values (joints,) and velocities (joints,) at a time (s)."""
        passed = fmod(time, self.period)
        row = bisect_right(self.times, passed) - 1
        states, times = np.array(self.states), (*self.times, self.period)
        velocities = (states[(row + 1) % len(states)] - states[row]) / (times[row + 1] - times[row])
        return states[row] + velocities * (passed - times[row]), velocities

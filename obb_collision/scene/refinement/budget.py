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

"""A time budget: which level above OBB fits a cycle, and how much of the cycle is left.

What a pair costs on a level is estimated from the cycles before. The cap, the highest level that
pairs are decided on, falls at once when what it costs no longer fits, and rises only when a higher
level has fitted with room to spare for some cycles, for more of them after every rise that did not
last.
OBB is the minimum: levels below it are not quicker (find_pairs on 10,000 crowded boxes: 8.9 ms on
"aabb", 12.2 on "sphere", 8.9 on "obb"), they only report more pairs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from statistics import median_low
from time import perf_counter

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.numerics.constants import MAX_MAGNITUDE
from obb_collision.words import shown

#: The levels that a budget chooses from, and how many pairs ask for each.
ABOVE = (Accuracy.HULL, Accuracy.MESH)
Counts = Mapping[Accuracy, int]

#: Cycles in which the cap is chosen anew each time, since the first ones load and compile.
SETTLING = 5
#: Share of the time that is planned with; the rest is for what no estimate foresees.
PLANNED = 0.9
#: A level is taken when it needs less than this share of the time there is for pairs ...
ROOMY = 0.7
#: ... for this many cycles (half a second at 50 Hz), left at once when it needs all of it.
WAIT = 25
#: After a rise that lasted for less than LASTING cycles the next one waits twice as long ...
LASTING = 1000
#: ... up to this many cycles (a minute at 50 Hz).
LONGEST_WAIT = 3200
#: Estimates are medians of this many cycles, as other processes may have had the processor in one.
WINDOW = 9
#: A level of which one pair takes longer than there is left is tried again twice as late each time,
#: up to once in so many chances: a single measurement may be an outlier, several are not.
RAREST_TRIAL = 10
#: At least this share of what a call takes is due to its pairs, not to the call.
LEAST_SHARE = 0.1


class Budget:
    """Seconds per cycle, and the cap that keeps cycles within them.

    seconds: from ``start`` to ``finish`` of a cycle; may be set at any time. clock: seconds,
    rising. Raises ValueError for a time that is not positive and finite.
    """

    def __init__(self, seconds: float, clock: Callable[[], float] = perf_counter) -> None:
        self.seconds = seconds
        self.clock = clock
        self.cap = Accuracy.OBB  # of the last cycle
        self.used = 0.0  # seconds of the last cycle
        self.cycle = 0
        self._risen = -LASTING
        self._waits = dict.fromkeys(ABOVE, WAIT)
        self._roomy = dict.fromkeys(ABOVE, 0)  # cycles in a row with room for a level
        self._pauses = dict.fromkeys(ABOVE, 0)  # chances to try a level that are skipped ...
        self._gaps = dict.fromkeys(ABOVE, 1)  # ... and how many it will be next
        self._costs: dict[Accuracy, deque[float]] = {r: deque(maxlen=WINDOW) for r in ABOVE}
        self._calls: dict[Accuracy, deque[float]] = {r: deque(maxlen=WINDOW) for r in ABOVE}
        self._before: deque[float] = deque(maxlen=WINDOW)
        self._after: deque[float] = deque(maxlen=WINDOW)
        self.start()

    @property
    def seconds(self) -> float:
        """The time of a cycle."""
        return self._seconds

    @seconds.setter
    def seconds(self, value: float) -> None:
        number = isinstance(value, (int, float, np.integer, np.floating))
        if not number or isinstance(value, bool) or not 0.0 < value <= MAX_MAGNITUDE:
            raise ValueError(f"time_budget must be positive seconds or None, got {shown(value)}")
        self._seconds = float(value)
        self._settled = 0  # cycles with this time

    def start(self) -> None:
        """Begin a cycle."""
        self._start = self.clock()
        self._refined: float | None = None

    def finish(self) -> None:
        """End a cycle: what came after ``refined`` is taken off the time of those to come."""
        end = self.clock()
        self.used = end - self._start
        if self._refined is not None:
            self._after.append(end - self._refined)

    def refining(self) -> None:
        """Mark the end of all that comes before the levels above OBB."""
        self._before.append(self.clock() - self._start)

    def refined(self) -> None:
        """Mark that the pairs of this cycle are decided."""
        self._refined = self.clock()

    def left(self) -> float:
        """Return the seconds that this cycle has left for deciding pairs; may be negative."""
        planned = PLANNED * self.seconds - _median(self._after)
        return self._start + planned - self.clock()

    def cost(self, level: Accuracy) -> float | None:
        """Return the seconds that a pair takes on a level, None before the first measurement."""
        costs = self._costs[level]
        return median_low(costs) if costs else None

    def overhead(self, level: Accuracy) -> float:
        """Return the seconds that a call without pairs takes."""
        return _median(self._calls[level])

    def is_due(self, level: Accuracy) -> bool:
        """Return whether to try a level now; one that takes too long is tried ever less often."""
        if self.left() >= (self.cost(level) or 0.0):
            self._pauses[level], self._gaps[level] = 0, 1
            return True
        if self._pauses[level] > 0:
            self._pauses[level] -= 1
            return False
        self._pauses[level] = self._gaps[level] - 1
        self._gaps[level] = min(2 * self._gaps[level], RAREST_TRIAL)
        return True

    def learn(self, level: Accuracy, pairs: int, seconds: float, calls: int = 1) -> None:
        """Record what pairs took on a level, in how many calls; no pairs: the calls alone."""
        if pairs:
            own = max(seconds - calls * self.overhead(level), LEAST_SHARE * seconds)
            self._costs[level].append(own / pairs)
        elif calls:
            self._calls[level].append(seconds / calls)

    def choose(self, counts: Counts) -> Accuracy:
        """Return the cap of this cycle; counts: pairs to be decided, by the level they ask for."""
        self.cycle += 1
        self._settled += 1
        loads = {level: self._load(level, counts) for level in ABOVE}
        for level, load in loads.items():
            self._roomy[level] = self._roomy[level] + 1 if load <= ROOMY else 0
        fitting = max((level for level in ABOVE if self._roomy[level]), default=Accuracy.OBB)
        ready = [level for level in ABOVE if self._roomy[level] >= self._waits[level]]
        if self._settled <= SETTLING:
            self.cap = fitting
        elif loads.get(self.cap, 0.0) > 1.0:
            self._fall(fitting)
        elif not any(counts.values()) and self.cap > Accuracy.OBB and self._room() <= 0.0:
            # effects come after, and may take less time below
            self._fall(max(level for level in (Accuracy.OBB, *ABOVE) if level < self.cap))
            self._after.clear()
        elif ready and max(ready) > self.cap:
            self.cap = max(ready)
            self._risen = self.cycle
            if not any(counts.values()):
                self._after.clear()  # of effects on a lower level
        return self.cap

    def _fall(self, cap: Accuracy) -> None:
        lasted = self.cycle - self._risen
        for level in ABOVE:
            if level > cap:
                wait = 2 * self._waits[level] if lasted < LASTING else WAIT
                self._waits[level] = min(wait, LONGEST_WAIT)
                self._roomy[level] = 0
        self.cap = cap

    def _room(self) -> float:
        """Return the seconds that a cycle has for deciding pairs; may be negative."""
        return PLANNED * self.seconds - _median(self._before) - _median(self._after)

    def _load(self, cap: Accuracy, counts: Counts) -> float:
        """Return the share of the time for pairs that a cap needs; infinite if not measured yet."""
        needed = 0.0
        for asked, count in counts.items():
            if count:
                cost = self.cost(min(asked, cap))
                if cost is None:
                    return float("inf")
                needed += count * cost + self.overhead(min(asked, cap))
        if needed == 0.0:
            return 0.0
        room = self._room()
        return needed / room if room > 0.0 else float("inf")


def _median(values: deque[float]) -> float:
    return median_low(values) if values else 0.0

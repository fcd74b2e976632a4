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
What is left when the time is up stays on OBB, which misses nothing; always the last ones, so that
the same pairs are left in every cycle. Pairs that wait, because nothing about them has changed
since they were left behind, get what time remains, on the level they ask for.
OBB is the minimum: levels below it are not quicker (find_pairs on 10,000 crowded boxes: 8.9 ms on
"aabb", 12.2 on "sphere", 8.9 on "obb"), they only report more pairs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from statistics import median_low
from time import perf_counter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from obb_collision.accuracy import Accuracy
from obb_collision.numerics.constants import MAX_MAGNITUDE
from obb_collision.queries.verdict.verdict import Verdicts
from obb_collision.typing import Rows
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


Levels = NDArray[np.int8]

#: Share of what fits that is decided at once; then the clock is looked at again. A cycle holds
#: though pairs take four times as long as they used to.
PORTION = 0.25
#: ... but no call is made for pairs worth less than so many times what any call takes.
LEAST_WORTH = 4.0
#: A level that isn't in use is tried once in this many cycles, to measure what it costs by now ...
TRIAL_CYCLES = 10
#: ... on at most this many pairs, and this share of the time left, which nothing else needs.
TRIAL_PAIRS = 64
TRIAL_SHARE = 0.5
#: ... or this one while the pairs of the cycle still wait for theirs, of each level.
FIRST_SHARE = 0.1
#: What a call takes besides its pairs is measured where that takes less than this of a trial.
CALL_SHARE = 0.25


class Job(Protocol):
    """The pairs of a cycle, as ``refine`` needs them."""

    def prepare(self, level: Accuracy, rows: Rows, budget: Budget | None) -> NDArray[np.bool_]:
        """Build what pairs need for a level while there is time; return (k,) which have it."""

    def decide(self, level: Accuracy, rows: Rows) -> Verdicts:
        """Return the verdicts (k,) of pairs on a level."""


def refine(
    job: Job,
    asked: Levels,
    waiting: NDArray[np.bool_],
    levels: Levels,
    verdicts: Verdicts,
    budget: Budget | None,
) -> None:
    """Decide pairs that OBB doesn't separate on the levels they ask for, or as the budget has it.

    asked (m,): above OBB; waiting (m,): see above; levels, verdicts (m,): as known, updated.
    """
    state = levels, verdicts
    if budget is None:
        for level in ABOVE:
            _decide(job, level, np.flatnonzero(asked == level), state, None)
        return
    budget.refining()
    for level in ABOVE:
        if budget.cost(level) is None:  # so it is measured with a few pairs
            _try(job, level, asked, budget, FIRST_SHARE)
    counts = {level: int(((asked == level) & ~waiting).sum()) for level in ABOVE}
    target = np.minimum(asked, budget.choose(counts))
    for level in ABOVE:
        _decide(job, level, np.flatnonzero((target == level) & ~waiting), state, budget)
    for level in ABOVE:
        _decide(job, level, np.flatnonzero((asked == level) & waiting), state, budget)
    number = budget.cycle % TRIAL_CYCLES - 1  # the cheapest in the very first cycle
    if 0 <= number < len(ABOVE) and ABOVE[number] != budget.cap and budget.is_due(ABOVE[number]):
        _try(job, ABOVE[number], asked, budget, TRIAL_SHARE)
    budget.refined()


def _decide(
    job: Job, level: Accuracy, rows: Rows, state: tuple[Levels, Verdicts], budget: Budget | None
) -> None:
    """Decide pairs on a level, portion by portion while there is time."""
    levels, verdicts = state
    if len(rows) == 0:
        return
    rows = rows[job.prepare(level, rows, budget)]
    if budget is None:
        levels[rows], verdicts[rows] = level, job.decide(level, rows)
        return
    done, calls, seconds = 0, 0, 0.0
    while done < len(rows):
        pace = max(budget.cost(level) or 0.0, seconds / max(done, 1))
        left = budget.left() - budget.overhead(level)
        if left < pace or left <= 0.0:
            break
        share = min(left, max(PORTION * left, LEAST_WORTH * budget.overhead(level)))
        count = int(share / pace) if pace > 0.0 else 1
        portion = rows[done : done + max(1, count)]
        start = budget.clock()
        levels[portion], verdicts[portion] = level, job.decide(level, portion)
        seconds += budget.clock() - start
        done, calls = done + len(portion), calls + 1
    if calls:
        budget.learn(level, done, seconds, calls)


def _try(job: Job, level: Accuracy, asked: Levels, budget: Budget, share: float) -> None:
    """Measure what a level costs with a few pairs from everywhere; their verdicts are not used.

    What the first call of a cycle, or of all, takes once is left out: loading machine code, and
    what all pairs of the cycle share. So is what every call takes, or a few pairs would seem to
    cost many times what they cost among hundreds, and the level would never be taken.
    """
    rows = np.flatnonzero(asked >= level)
    step = max(1, len(rows) // TRIAL_PAIRS)
    rows = rows[budget.cycle % step :: step][:TRIAL_PAIRS]
    if len(rows) == 0 or budget.left() <= 0.0:
        return
    rows = rows[job.prepare(level, rows, budget)]
    if len(rows) == 0:
        return
    job.decide(level, rows[:1])
    allowed = max(0.0, share * budget.left())
    seconds = total = _timed(job, level, rows[:1], budget)
    portions = [(1, seconds)]
    if seconds <= CALL_SHARE * allowed:
        twice = _timed(job, level, rows[[0, 0]], budget)
        budget.learn(level, 0, max(0.0, 2.0 * seconds - twice))
        total += twice
    done = 1
    while done < len(rows) and total + 2.0 * seconds <= allowed:
        portion = rows[done : 2 * done + 1]
        seconds = _timed(job, level, portion, budget)
        portions.append((len(portion), seconds))
        done, total = done + len(portion), total + seconds
    budget.learn(level, *max(portions))  # of the largest: the call itself has the least share


def _timed(job: Job, level: Accuracy, rows: Rows, budget: Budget) -> float:
    start = budget.clock()
    job.decide(level, rows)
    return budget.clock() - start

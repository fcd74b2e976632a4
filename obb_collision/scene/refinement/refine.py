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

"""Deciding pairs on the levels above OBB, all of them or what a budget has time for.

What is left when the time is up stays on OBB, which misses nothing; always the last ones, so that
the same pairs are left in every cycle. Pairs that wait, because nothing about them has changed
since they were left behind, get what time remains, on the level they ask for.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from obb_collision.accuracy import Accuracy
from obb_collision.queries.verdict.verdict import Verdicts
from obb_collision.scene.refinement.budget import ABOVE, Budget
from obb_collision.typing import Rows

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
    _meet_levels(job, asked, budget)
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


def _meet_levels(job: Job, asked: Levels, budget: Budget) -> None:
    """Measure with a few pairs what the levels cost that have no estimate yet."""
    for level in ABOVE:
        if budget.cost(level) is None:
            _try(job, level, asked, budget, FIRST_SHARE)


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

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


"""Times the full step of this library and its peers in turn, and compares their pairs.

All get the same poses in the same process, one step each before the next frame comes, so that
the ratios hold even on a noisy machine. The garbage collector waits meanwhile, as in timeit.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from obb_collision._threads import set_threads, threads
from obb_collision.benchmarks.contestants import (
    FIND_PAIRS,
    OURS,
    Contestant,
    Frame,
    Stepper,
    make_frames,
)
from obb_collision.benchmarks.measuring import Show, on_threads
from obb_collision.boxes import Boxes
from obb_collision.queries.questions import separations
from obb_collision.typing import Floats, Rows

#: Why a contestant is left out: its name and the reason, and the case.
Note = tuple[str, str]

#: Boxes that everybody is tried with first, and how time grows with more, to predict it.
TRIAL_BOXES, TIME_GROWTH = 2_000, 1.1
#: Steps that are timed at least, unless that takes longer than the limit; then these.
LEAST_STEPS, FEWEST_STEPS = 20, 3


class Case(NamedTuple):
    """A scene: its form, boxes, and the share of them that moves."""

    form: str = "uniform"
    boxes: int = 10_000
    moving: float = 1.0


class StepRow(NamedTuple):
    """The times of a contestant in a case, and how its pairs differ from ours."""

    name: str
    threads: int
    form: str
    boxes: int
    moving: float
    median_ms: float
    best_ms: float
    steps: int
    build_s: float
    pairs: int
    missed: int  #: pairs of ours that it does not report
    false: int  #: pairs that it reports and we do not
    off_m: float  #: how far from touching those that differ are at most, metres

    @property
    def case(self) -> Case:
        """The scene."""
        return Case(self.form, self.boxes, self.moving)


class StepPlan(NamedTuple):
    """How long to measure: seconds per case, the limit for one contestant, steps, the seed."""

    seconds: float = 2.0
    limit: float = 40.0
    steps: int = LEAST_STEPS
    seed: int = 0


class StepEntry(NamedTuple):
    """A contestant in a case, with a number of threads."""

    contestant: Contestant
    threads: int
    peer: Stepper
    build_s: float
    times: list[float]

    def step(self, frame: Frame) -> Any:
        """Do a step and note its time."""
        set_threads(self.threads)
        start = perf_counter()
        answer = self.peer.step(frame)
        self.times.append(perf_counter() - start)
        return answer


@contextmanager
def own_settings() -> Iterator[None]:
    """Restore the garbage collector and the number of threads at the end."""
    gc.collect()
    gc.disable()
    try:
        with on_threads(threads()):
            yield
    finally:
        gc.enable()


def _enter(contestant: Contestant, number: int, half_extents: Floats, poses: Floats) -> StepEntry:
    set_threads(number)
    start = perf_counter()
    peer = contestant.make(half_extents, poses)
    return StepEntry(contestant, number, peer, perf_counter() - start, [])


def _codes(pairs: Rows, count: int) -> Rows:
    """Return pairs as sorted unique numbers i * count + j, i < j."""
    ends = np.sort(pairs, axis=1)
    return np.unique(ends[:, 0] * count + ends[:, 1])


def choose(
    case: Case, contestants: Sequence[Contestant], plan: StepPlan
) -> tuple[list[Contestant], list[Note]]:
    """Return the contestants of a case, by a trial with few boxes, and notes about the others."""
    count = min(case.boxes, TRIAL_BOXES)
    half_extents, frames = make_frames(case.form, count, case.moving, plan.seed)
    chosen, notes = list[Contestant](), list[Note]()
    growth = (case.boxes / count) ** TIME_GROWTH
    for contestant in contestants:
        entry = _enter(contestant, threads(), half_extents, frames[0].poses)
        for frame in frames[:3]:
            entry.step(frame)
        needed = growth * (entry.build_s + plan.steps * min(entry.times))
        if contestant in OURS or needed <= plan.limit:
            chosen.append(contestant)
        else:
            what = f"{case.boxes:,} boxes ({case.form}: {needed:.0f} s)"
            notes.append((f"{contestant.name} would take too long for", what))
    return chosen, notes


def run_case(
    case: Case,
    contestants: Sequence[Contestant],
    numbers: Sequence[int],
    plan: StepPlan,
    show: Show,
) -> tuple[list[StepRow], list[Note]]:
    """Return a row per contestant, ours with each number of threads, and notes."""
    what = f"{case.boxes:,} boxes, {case.form}, {case.moving:.0%} moving"
    with own_settings():
        show(f"{what}: trial")
        chosen, notes = choose(case, [c for c in contestants if c.installed], plan)
        half_extents, frames = make_frames(case.form, case.boxes, case.moving, plan.seed)
        entries = []
        for contestant in chosen:
            show(f"{what}: {contestant.name}")
            several = numbers if contestant in OURS else (contestant.threads or max(numbers),)
            for number in several:
                entries.append(_enter(contestant, number, half_extents, frames[0].poses))
        answers, frame = _take_turns(entries, frames, plan, lambda n: show(f"{what}: step {n}"))
        return _rows(case, entries, answers, frame, half_extents), notes


def _take_turns(
    entries: Sequence[StepEntry],
    frames: Sequence[Frame],
    plan: StepPlan,
    show: Callable[[int], None],
) -> tuple[list[Any], Frame]:
    """Let all step until each has enough turns; return their last answers and that frame."""
    for entry in entries:
        entry.step(frames[0])  # fills caches
        entry.times.clear()
    start, turn, done = perf_counter(), 0, False
    answers: list[Any] = [None] * len(entries)
    order = np.random.default_rng(plan.seed)
    while not done:
        turn += 1
        frame = frames[turn % len(frames)]
        frame.rotations  # noqa: B018 - made before, and kept
        spent = perf_counter() - start
        done = spent >= plan.seconds and (
            turn > plan.steps or (turn > FEWEST_STEPS and spent > plan.limit)
        )
        for k in order.permutation(len(entries)).tolist():  # the predecessor matters
            answer = entries[k].step(frame)
            if done:
                answers[k] = answer
            del answer  # no report is in use during the next step
        show(turn)
    return answers, frame


def _rows(
    case: Case,
    entries: Sequence[StepEntry],
    answers: Sequence[Any],
    frame: Frame,
    half_extents: Floats,
) -> list[StepRow]:
    boxes = Boxes.from_poses(frame.poses, half_extents)
    truth = _codes(FIND_PAIRS.make(half_extents, frame.poses).step(frame), case.boxes)
    rows = []
    for entry, answer in zip(entries, answers, strict=True):
        codes = _codes(entry.peer.pairs(answer), case.boxes)
        missed, false = np.setdiff1d(truth, codes), np.setdiff1d(codes, truth)
        differing = np.stack(np.divmod(np.concatenate([missed, false]), case.boxes), axis=1)
        off = np.abs(separations(boxes, boxes, differing).separations).max(initial=0.0)
        times = 1e3 * np.array(entry.times)
        rows.append(
            StepRow(
                name=entry.contestant.name,
                threads=entry.threads,
                form=case.form,
                boxes=case.boxes,
                moving=case.moving,
                median_ms=float(np.median(times)),
                best_ms=float(times.min()),
                steps=len(times),
                build_s=entry.build_s,
                pairs=len(codes),
                missed=len(missed),
                false=len(false),
                off_m=float(off),
            )
        )
    return rows

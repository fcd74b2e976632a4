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
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from obb_collision._threads import set_threads, threads
from obb_collision.benchmarks.contestants import (
    OURS,
    PAIRS,
    PEERS,
    SCENE,
    SEPARATIONS,
    Contestant,
    Frame,
    Stepper,
    make_frames,
)
from obb_collision.benchmarks.tables import Table, as_markdown, digits
from obb_collision.benchmarks.timing import Show, on_threads
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.questions import separations
from obb_collision.typing import Floats, Rows

#: Why somebody is left out: who and why, and in which case.
Note = tuple[str, str]

#: Boxes that everybody is tried with first, and how time grows with more, to predict it.
TRIAL, GROWTH = 2_000, 1.1
#: Steps that are timed at least, unless that takes longer than the limit; then these.
STEPS, FEWEST = 20, 3
#: Peers of the small table, and shares of moving boxes in words.
SMALL = ("MuJoCo", "coal", "python-fcl")
SHARES = {1.0: "all moving", 0.0: "none moving"}
OWN = {one.name for one in OURS}
COAL_LINE = "coal, best broad phase"


class Case(NamedTuple):
    """A scene: its form, boxes, and the share of them that moves."""

    form: str = "uniform"
    boxes: int = 10_000
    moving: float = 1.0


class StepRow(NamedTuple):
    """What one contestant took in one case, and how its pairs differ from ours."""

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
    steps: int = STEPS
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
        found = self.peer.step(frame)
        self.times.append(perf_counter() - start)
        return found


@contextmanager
def own_settings() -> Iterator[None]:
    """Set the garbage collector and the threads back at the end."""
    gc.collect()
    gc.disable()
    try:
        with on_threads(threads()):
            yield
    finally:
        gc.enable()


def _enter(one: Contestant, number: int, half_extents: Floats, poses: Floats) -> StepEntry:
    set_threads(number)
    start = perf_counter()
    peer = one.make(half_extents, poses)
    return StepEntry(one, number, peer, perf_counter() - start, [])


def _codes(pairs: Rows, count: int) -> Rows:
    """Return pairs as sorted unique numbers i * count + j, i < j."""
    ends = np.sort(pairs, axis=1)
    return np.unique(ends[:, 0] * count + ends[:, 1])


def choose(
    case: Case, contestants: Sequence[Contestant], plan: StepPlan
) -> tuple[list[Contestant], list[Note]]:
    """Return who takes part in a case, after a trial with few boxes, and notes about the others."""
    count = min(case.boxes, TRIAL)
    half_extents, frames = make_frames(case.form, count, case.moving, plan.seed)
    chosen, notes = list[Contestant](), list[Note]()
    growth = (case.boxes / count) ** GROWTH
    for one in contestants:
        entry = _enter(one, threads(), half_extents, frames[0].poses)
        for frame in frames[:3]:
            entry.step(frame)
        needed = growth * (entry.build_s + plan.steps * min(entry.times))
        if one in OURS or needed <= plan.limit:
            chosen.append(one)
        else:
            what = f"{case.boxes:,} boxes ({case.form}: {needed:.0f} s)"
            notes.append((f"{one.name} would take too long for", what))
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
        chosen, notes = choose(case, [one for one in contestants if one.installed], plan)
        half_extents, frames = make_frames(case.form, case.boxes, case.moving, plan.seed)
        entries = []
        for one in chosen:
            show(f"{what}: {one.name}")
            several = numbers if one in OURS else (max(numbers),) if one.threads is None else (1,)
            for number in several:
                entries.append(_enter(one, number, half_extents, frames[0].poses))
        founds, frame = _take_turns(entries, frames, plan, lambda n: show(f"{what}: step {n}"))
        return _rows(case, entries, founds, frame, half_extents), notes


def _take_turns(
    entries: Sequence[StepEntry],
    frames: Sequence[Frame],
    plan: StepPlan,
    show: Callable[[int], None],
) -> tuple[list[Any], Frame]:
    """Let all step until each has enough; return what they found in the last frame, and that."""
    for entry in entries:
        entry.step(frames[0])  # what is made once
        entry.times.clear()
    start, turn, done = perf_counter(), 0, False
    founds: list[Any] = [None] * len(entries)
    order = np.random.default_rng(plan.seed)
    while not done:
        turn += 1
        frame = frames[turn % len(frames)]
        frame.rotations  # noqa: B018 - made before, and kept
        spent = perf_counter() - start
        done = spent >= plan.seconds and (
            turn > plan.steps or (turn > FEWEST and spent > plan.limit)
        )
        for k in order.permutation(len(entries)).tolist():  # the predecessor matters
            found = entries[k].step(frame)
            if done:
                founds[k] = found
            del found  # no report is in use during the next step
        show(turn)
    return founds, frame


def _rows(
    case: Case,
    entries: Sequence[StepEntry],
    founds: Sequence[Any],
    frame: Frame,
    half_extents: Floats,
) -> list[StepRow]:
    boxes = Boxes.from_poses(frame.poses, half_extents)
    truth = _codes(PAIRS.make(half_extents, frame.poses).step(frame), case.boxes)
    rows = []
    for entry, found in zip(entries, founds, strict=True):
        codes = _codes(entry.peer.pairs(found), case.boxes)
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


def label(row: StepRow) -> str:
    """Return the name of a contestant with its threads."""
    return f"{row.name}, {row.threads} thread{'s' * (row.threads > 1)}"


def share(moving: float) -> str:
    """Return a share of moving boxes in words."""
    return SHARES.get(moving, f"{100 * moving:g} % moving")


def reference(rows: Iterable[StepRow]) -> StepRow | None:
    """Return our row that others are compared with: separations, as many threads as there are."""
    ours = [row for row in rows if row.name == SEPARATIONS.name]
    return max(ours, key=lambda row: row.threads, default=None)


#: What a table has in its columns: the part of a case, and how that is written.
ACROSS: dict[str, tuple[Callable[[Case], object], Callable[[Case], str]]] = {
    "sizes": (lambda case: (case.form, case.moving), lambda case: f"{case.boxes:,}"),
    "forms": (lambda case: (case.boxes, case.moving), lambda case: case.form),
    "moving": (lambda case: (case.form, case.boxes), lambda case: share(case.moving)),
}


def tables(rows: Sequence[StepRow]) -> dict[str, Table]:
    """Return tables by title: a line per contestant, milliseconds in the columns.

    In brackets how many times as long as ours with separations it took.
    """
    found: dict[str, Table] = {}
    cases = list(dict.fromkeys(row.case for row in rows))
    for kind, (fixed, head) in ACROSS.items():
        for group in dict.fromkeys(map(fixed, cases)):
            own = [case for case in cases if fixed(case) == group]
            if len(own) > 1 or (len(cases) == 1 and kind == "sizes"):
                first = own[0]
                what = {
                    "sizes": f"sizes: {first.form}, {share(first.moving)}",
                    "forms": f"forms: {first.boxes:,} boxes, {share(first.moving)}",
                    "moving": f"moving: {first.form}, {first.boxes:,} boxes",
                }
                found[what[kind]] = _grid(rows, own, head)
    return found


def _grid(rows: Sequence[StepRow], cases: list[Case], head: Callable[[Case], str]) -> Table:
    """Return a line per contestant; coal has one, with the quickest that misses nothing."""
    own = [row for row in rows if row.case in cases]
    lines: dict[str, dict[Case, str]] = {}
    for row in sorted(own, key=_order):
        coal = row.name.startswith("coal ")
        cells = lines.setdefault(COAL_LINE if coal else label(row), {})
        if not coal or row == best_coal(rows, row.case):
            cells[row.case] = _cell(row, own)
    head_line = ["ms per step", *map(head, cases)]
    return [head_line, *([name, *(c.get(case, "") for case in cases)] for name, c in lines.items())]


def _order(row: StepRow) -> tuple[int, int]:
    names = [one.name for one in (*OURS, *PEERS)]
    return names.index(row.name) if row.name in names else len(names), row.threads


def best_coal(rows: Sequence[StepRow], case: Case) -> StepRow | None:
    """Return the quickest broad phase of coal in a case, of those that miss no pair in any."""
    coal = [row for row in rows if row.name.startswith("coal ")]
    bad = {row.name for row in coal if row.missed}
    own = [row for row in coal if row.case == case and row.name not in bad]
    return min(own, key=lambda row: row.median_ms, default=None)


def _cell(row: StepRow, rows: Sequence[StepRow]) -> str:
    mark = "*" if row.missed or row.false else ""
    which = row.name.removeprefix("coal") if row.name.startswith("coal ") else ""
    ours = reference(other for other in rows if other.case == row.case)
    ratio = f" ({digits(row.median_ms / ours.median_ms, 2)})" if ours and row is not ours else ""
    return f"{digits(row.median_ms)}{mark}{which}{ratio}"


def differences(rows: Iterable[StepRow]) -> list[str]:
    """Return a line for everybody whose pairs are not ours, and how near they are to touching."""
    return [
        f"* {row.name}, {row.boxes:,} boxes, {row.form}: {row.missed} of {row.pairs + row.missed} "
        f"pairs missed, {row.false} false, up to {row.off_m:.1e} m from touching"
        for row in rows
        if row.missed or row.false
    ]


def slopes(rows: Sequence[StepRow]) -> list[str]:
    """Return a line for each of ours: how time grows from size to size, and its exponent."""
    lines = []
    most = max(row.threads for row in rows)
    rows = [row for row in rows if row.name in OWN and row.threads == most]
    groups = dict.fromkeys((label(row), row.form, row.moving) for row in rows)
    for group in groups:
        own = [row for row in rows if (label(row), row.form, row.moving) == group]
        own.sort(key=lambda row: row.boxes)
        if len(own) < 2:
            continue
        steps = ", ".join(
            f"{b.boxes:,} / {a.boxes:,}: {b.median_ms / a.median_ms:.1f}" for a, b in pairwise(own)
        )
        logs = [np.log([getattr(row, key) for row in own[-3:]]) for key in ("boxes", "median_ms")]
        exponent = np.polyfit(logs[0], logs[1], 1)[0]
        lines.append(f"{group[0]}, {group[1]}: {steps}; exponent at the end {exponent:.2f}")
    return lines


def _small(table: Table, most: int) -> Table:
    """Return the head, ours with the most threads, and the best-known peers."""
    wanted = (*(f"{name}, {most} thread" for name in OWN - {SCENE.name}), *SMALL)
    return [table[0], *(line for line in table[1:] if line[0].startswith(wanted))]


def joined(notes: Iterable[Note]) -> list[str]:
    """Return a line per reason, with all its cases."""
    lines: dict[str, dict[str, None]] = {}
    for why, where in notes:
        lines.setdefault(why, {})[where] = None
    return [f"{why} {', '.join(where)}".strip() for why, where in lines.items()]


def blocks_of(rows: Sequence[StepRow], notes: Sequence[str]) -> dict[str, str]:
    """Return the blocks of a page by name: tables by their kind, and lists of lines."""
    blocks: dict[str, str] = {}
    for title, table in tables(rows).items():
        blocks.setdefault(title.split(":")[0], as_markdown(table))
        blocks.setdefault("small", as_markdown(_small(table, max(row.threads for row in rows))))
    lists = {"slopes": slopes(rows), "notes": [*differences(rows), *notes]}
    blocks |= {name: "\n".join(f"* {x.removeprefix('* ')}" for x in v) for name, v in lists.items()}
    return blocks


def best_rows(rows: Sequence[StepRow]) -> list[StepRow]:
    """Return what is drawn: ours with the most threads, and the quickest of each peer per case."""
    best: dict[tuple[object, str], StepRow] = {}
    for row in rows:
        name = row.name if row.name in OWN else row.name.split(" ")[0]
        if name == SCENE.name:
            continue
        key = row.case, name
        rival = best.get(key)
        if rival is None or (
            row.threads > rival.threads if name in OWN else row.median_ms < rival.median_ms
        ):
            best[key] = row
    return list(best.values())

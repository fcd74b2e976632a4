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


"""The full step beside the installed peers: the command ``obb_collision speed``.

A step brings new poses in and every colliding pair out. By default scenes of every size, of every
form, and with few boxes moving are measured, one after the other.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise, product
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from obb_collision.benchmarks.contestants import (
    FORMS,
    OUR_NAMES,
    OURS,
    PEERS,
    SCENE_SEPARATIONS,
    Contestant,
)
from obb_collision.benchmarks.effects import cost_table, off_lines, run_effects
from obb_collision.benchmarks.measuring import Show, Table, as_text, digits, machine, machine_line
from obb_collision.benchmarks.steps import Case, Note, StepPlan, StepRow, run_case

SIZES = (10, 100, 1_000, 10_000, 100_000, 1_000_000)
MOVING_SHARES = (0.1, 0.01, 0.0)
#: Seconds for the effects in all their scenes, at least.
EFFECTS_SECONDS = 20.0
#: Shares of moving boxes in words.
SHARE_WORDS = {1.0: "all moving", 0.0: "none moving"}
COAL_LINE = "coal, best broad phase"


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Return the scenes asked for: every combination, or the default."""
    if options.sizes or options.forms or options.moving:
        sizes, forms = options.sizes or [10_000], options.forms or ["uniform"]
        shares = options.moving or [1.0]
        return [Case(form, n, share) for form, share, n in product(forms, shares, sizes)]
    cases = [Case(boxes=n) for n in SIZES] + [Case(form) for form in FORMS if form != "uniform"]
    return cases + [Case(moving=share) for share in MOVING_SHARES]


class SpeedResult(NamedTuple):
    """A row per contestant and scene, or per effect and scene; the machine, and notes."""

    rows: Sequence[Any]
    machine: Mapping[str, Any] = MappingProxyType({})
    notes: Sequence[str] = ()


def measure(options: argparse.Namespace, peers: Sequence[Contestant], show: Show) -> SpeedResult:
    """Measure the full step of ours and of peers, or the effects; notes: peers left out."""
    if options.effects:
        return SpeedResult(run_effects(max(options.seconds, EFFECTS_SECONDS), show))
    wanted = [p for p in peers if any(part in p.name for part in options.peers or [""])]
    notes = [("not installed:", peer.name) for peer in wanted if not peer.installed]
    plan = StepPlan(options.seconds, options.limit, options.steps, options.seed)
    rows = list[StepRow]()
    for case in cases_of(options):
        case_rows, more = run_case(case, [*OURS, *wanted], options.threads, plan, show)
        rows += case_rows
        notes += more
    return SpeedResult(rows, machine(peer.distribution for peer in peers), joined_notes(notes))


def report(result: SpeedResult, options: argparse.Namespace) -> None:
    """Print and write what was measured."""
    from obb_collision.benchmarks import plots

    rows: Any = result.rows
    if options.effects:
        print("\n".join([as_text(cost_table(rows)), *off_lines(rows)]))
    else:
        print(machine_line(result.machine))
        for title, table in tables(rows).items():
            print(f"\n{title}\n{as_text(table)}")
        print("\n".join(["", *slopes(rows), *differences(rows), *result.notes]))
    if options.json:
        written = {"machine": dict(result.machine), "notes": result.notes}
        written["rows"] = [row._asdict() for row in rows]
        options.json.write_text(json.dumps(written, indent=1) + "\n")
    if options.picture:
        draw = plots.save_effect_costs if options.effects else plots.save_speed
        draw(rows, options.picture)


def label(row: StepRow) -> str:
    """Return the name of a contestant with its threads."""
    return f"{row.name}, {row.threads} thread{'s' * (row.threads > 1)}"


def share(moving: float) -> str:
    """Return a share of moving boxes in words."""
    return SHARE_WORDS.get(moving, f"{100 * moving:g} % moving")


def reference(rows: Iterable[StepRow]) -> StepRow | None:
    """Return the row that others are compared with: our separations, on the most threads."""
    ours = [row for row in rows if row.name == SCENE_SEPARATIONS.name]
    return max(ours, key=lambda row: row.threads, default=None)


#: What a table has in its columns: the part of a case, and how that is written.
TABLE_COLUMNS: dict[str, tuple[Callable[[Case], object], Callable[[Case], str]]] = {
    "sizes": (lambda case: (case.form, case.moving), lambda case: f"{case.boxes:,}"),
    "forms": (lambda case: (case.boxes, case.moving), lambda case: case.form),
    "moving": (lambda case: (case.form, case.boxes), lambda case: share(case.moving)),
}


def tables(rows: Sequence[StepRow]) -> dict[str, Table]:
    """Return tables by title: a line per contestant, milliseconds in the columns.

    In brackets: the ratio to our time with separations.
    """
    by_title: dict[str, Table] = {}
    cases = list(dict.fromkeys(row.case for row in rows))
    for kind, (fixed, head) in TABLE_COLUMNS.items():
        for group in dict.fromkeys(map(fixed, cases)):
            own = [case for case in cases if fixed(case) == group]
            if len(own) > 1 or (len(cases) == 1 and kind == "sizes"):
                first = own[0]
                what = {
                    "sizes": f"sizes: {first.form}, {share(first.moving)}",
                    "forms": f"forms: {first.boxes:,} boxes, {share(first.moving)}",
                    "moving": f"moving: {first.form}, {first.boxes:,} boxes",
                }
                by_title[what[kind]] = _grid(rows, own, head)
    return by_title


def _grid(rows: Sequence[StepRow], cases: list[Case], head: Callable[[Case], str]) -> Table:
    """Return a line per contestant; for coal only its quickest broad phase that misses no pair."""
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
    names = [contestant.name for contestant in (*OURS, *PEERS)]
    return names.index(row.name) if row.name in names else len(names), row.threads


def best_coal(rows: Sequence[StepRow], case: Case) -> StepRow | None:
    """Return the quickest broad phase of coal in a case, of those that never miss a pair."""
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
    """Return a line for each contestant whose pairs differ from ours, and by how much."""
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
    rows = [row for row in rows if row.name in OUR_NAMES and row.threads == most]
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


def joined_notes(notes: Iterable[Note]) -> list[str]:
    """Return a line per reason, with all its cases."""
    lines: dict[str, dict[str, None]] = {}
    for why, where in notes:
        lines.setdefault(why, {})[where] = None
    return [f"{why} {', '.join(where)}".strip() for why, where in lines.items()]

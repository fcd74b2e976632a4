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


"""Tables of what was measured, as text and as Markdown between marks in a page."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from pathlib import Path

import numpy as np

from obb_collision.benchmarks.peers.steps import OURS, PEERS, SCENE, SEPARATIONS
from obb_collision.benchmarks.step.measure import Case, Note, Row
from obb_collision.benchmarks.step.text import as_markdown

Table = list[list[str]]
OWN = {one.name for one in OURS}
ORDER = [one.name for one in (*OURS, *PEERS)]
#: Peers of the small table.
SMALL = ("MuJoCo", "coal", "python-fcl")
SHARES = {1.0: "all moving", 0.0: "none moving"}


def label(row: Row) -> str:
    """Return the name of a contestant with its threads."""
    return f"{row.name}, {row.threads} thread{'s' * (row.threads > 1)}"


def share(moving: float) -> str:
    """Return a share of moving boxes in words."""
    return SHARES.get(moving, f"{100 * moving:g} % moving")


def reference(rows: Iterable[Row]) -> Row | None:
    """Return our row that others are compared with: separations, as many threads as there are."""
    ours = [row for row in rows if row.name == SEPARATIONS.name]
    return max(ours, key=lambda row: row.threads, default=None)


#: What a table has in its columns: the part of a case, and how that is written.
ACROSS: dict[str, tuple[Callable[[Case], object], Callable[[Case], str]]] = {
    "sizes": (lambda case: (case.form, case.moving), lambda case: f"{case.boxes:,}"),
    "forms": (lambda case: (case.boxes, case.moving), lambda case: case.form),
    "moving": (lambda case: (case.form, case.boxes), lambda case: share(case.moving)),
}


def tables(rows: Sequence[Row]) -> dict[str, Table]:
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


def _grid(rows: Sequence[Row], cases: list[Case], head: Callable[[Case], str]) -> Table:
    """Return a line per contestant; coal has one, with the quickest that misses nothing."""
    own = [row for row in rows if row.case in cases]
    lines: dict[str, dict[Case, str]] = {}
    for row in sorted(own, key=lambda row: (ORDER.index(row.name), row.threads)):
        coal = row.name.startswith("coal ")
        cells = lines.setdefault("coal, best broad phase" if coal else label(row), {})
        if not coal or row == best_coal(rows, row.case):
            cells[row.case] = _cell(row, own)
    head_line = ["ms per step", *map(head, cases)]
    return [head_line, *([name, *(c.get(case, "") for case in cases)] for name, c in lines.items())]


def best_coal(rows: Sequence[Row], case: Case) -> Row | None:
    """Return the quickest broad phase of coal in a case, of those that miss no pair in any."""
    coal = [row for row in rows if row.name.startswith("coal ")]
    bad = {row.name for row in coal if row.missed}
    own = [row for row in coal if row.case == case and row.name not in bad]
    return min(own, key=lambda row: row.median_ms, default=None)


def digits(value: float, count: int = 3) -> str:
    """Return a number with that many digits."""
    return f"{value:#.{count}g}".rstrip(".") if value < 10**count else f"{value:,.0f}"


def _cell(row: Row, rows: Sequence[Row]) -> str:
    mark = "*" if row.missed or row.false else ""
    which = row.name.removeprefix("coal") if row.name.startswith("coal ") else ""
    ours = reference(other for other in rows if other.case == row.case)
    ratio = f" ({digits(row.median_ms / ours.median_ms, 2)})" if ours and row is not ours else ""
    return f"{digits(row.median_ms)}{mark}{which}{ratio}"


def differences(rows: Iterable[Row]) -> list[str]:
    """Return a line for everybody whose pairs are not ours, and how near they are to touching."""
    return [
        f"* {row.name}, {row.boxes:,} boxes, {row.form}: {row.missed} of {row.pairs + row.missed} "
        f"pairs missed, {row.false} false, up to {row.off_m:.1e} m from touching"
        for row in rows
        if row.missed or row.false
    ]


def slopes(rows: Sequence[Row]) -> list[str]:
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


def machine() -> dict[str, object]:
    """Return what the times depend on."""
    versions: dict[str, str | None] = {}
    for name in sorted({one.distribution for one in PEERS} | {"numpy", "numba"}):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None
    return {
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "versions": versions,
    }


def machine_line() -> str:
    """Return what the times depend on in a line."""
    facts = machine()
    versions = facts["versions"]
    assert isinstance(versions, dict)
    named = ", ".join(f"{name} {found or 'not installed'}" for name, found in versions.items())
    return f"{facts['machine']}, {facts['cores']} cores, Python {facts['python']}, {named}"


def write_into(page: Path, blocks: dict[str, str]) -> None:
    """Replace what stands between ``<!-- speed: NAME -->`` and ``<!-- end -->`` in a page.

    A page that is not there yet gets all blocks.
    """
    if not page.exists():
        page.write_text("".join(f"<!-- speed: {k} -->\n<!-- end -->\n\n" for k in blocks))
    text = page.read_text(encoding="utf-8")
    for name, block in blocks.items():
        start, mark, rest = text.partition(f"<!-- speed: {name} -->\n")
        if mark:
            text = f"{start}{mark}{block}\n{rest[rest.index('<!-- end -->') :]}"
    page.write_text(text, encoding="utf-8")


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


def blocks_of(rows: Sequence[Row], notes: Sequence[str]) -> dict[str, str]:
    """Return the blocks of a page by name: tables by their kind, and lists of lines."""
    blocks: dict[str, str] = {}
    for title, table in tables(rows).items():
        blocks.setdefault(title.split(":")[0], as_markdown(table))
        blocks.setdefault("small", as_markdown(_small(table, max(row.threads for row in rows))))
    lists = {"slopes": slopes(rows), "notes": [*differences(rows), *notes]}
    blocks |= {name: "\n".join(f"* {x.removeprefix('* ')}" for x in v) for name, v in lists.items()}
    blocks["machine"] = machine_line()
    return blocks

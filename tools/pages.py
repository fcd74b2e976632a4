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

"""Tables in Markdown, between marks in a page, and those of ``obb_collision speed``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from obb_collision.benchmarks.contestants import OUR_NAMES, SCENE_PAIRS, SCENE_SEPARATIONS
from obb_collision.benchmarks.measuring import Table
from obb_collision.benchmarks.speed import differences, slopes, tables
from obb_collision.benchmarks.steps import StepRow

#: Peers of the small table.
SMALL = ("MuJoCo", "coal", "python-fcl")


def as_markdown(lines: Table) -> str:
    """Return the table in Markdown."""
    rule = ["---"] * len(lines[0])
    return "\n".join(f"| {' | '.join(line)} |" for line in [lines[0], rule, *lines[1:]])


def table_of(rows: Sequence[Mapping[str, object]]) -> Table:
    """Return rows as text cells; the keys of the first one are the header."""
    heads = list(rows[0])
    return [heads, *([str(row.get(head, "")) for head in heads] for row in rows)]


def write_into(page: Path, blocks: dict[str, str]) -> None:
    """Replace the text between ``<!-- speed: NAME -->`` and ``<!-- end -->`` in a page.

    A new page gets all blocks.
    """
    if not page.exists():
        page.write_text("".join(f"<!-- speed: {k} -->\n<!-- end -->\n\n" for k in blocks))
    text = page.read_text(encoding="utf-8")
    for name, block in blocks.items():
        start, mark, rest = text.partition(f"<!-- speed: {name} -->\n")
        if mark:
            text = f"{start}{mark}{block}\n{rest[rest.index('<!-- end -->') :]}"
    page.write_text(text, encoding="utf-8")


def blocks_of(rows: Sequence[StepRow], notes: Sequence[str]) -> dict[str, str]:
    """Return the blocks of a page by name: tables by kind, without ratios, and lists of lines."""
    blocks: dict[str, str] = {}
    for title, with_ratios in tables(rows).items():
        table = [[cell.partition(" (")[0] for cell in row] for row in with_ratios]
        kind = title.split(":")[0]
        blocks.setdefault(kind, as_markdown(_drawn(table) if kind == "forms" else table))
        blocks.setdefault("small", as_markdown(_small(table, max(row.threads for row in rows))))
    lists = {"slopes": slopes(rows), "notes": [*differences(rows), *notes]}
    blocks |= {name: "\n".join(f"* {x.removeprefix('* ')}" for x in v) for name, v in lists.items()}
    return blocks


def _small(table: Table, most: int) -> Table:
    """Return the head, ours with one thread, one with the most, and the best-known peers."""
    quick = f"{SCENE_SEPARATIONS.name}, {most} thread"
    wanted = (*(f"{name}, 1 thread" for name in OUR_NAMES - {SCENE_PAIRS.name}), quick, *SMALL)
    return [table[0], *(line for line in table[1:] if line[0].startswith(wanted))]


def _drawn(table: Table) -> Table:
    """Return the rows of the picture: ours with one thread, and all peers."""
    ours = tuple(f"{name}, " for name in OUR_NAMES)
    wanted = tuple(f"{name}, 1 thread" for name in OUR_NAMES - {SCENE_PAIRS.name})
    return [row for row in table if row[0].startswith(wanted) or not row[0].startswith(ours)]

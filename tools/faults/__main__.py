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


"""The console script ``python -m tools.faults``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from obb_collision.cli import Parser, interruptible, new_file, option
from tools.faults.faults import BY_NAME, Outcome, attempt

LARGEST_DOMAIN = 100
BEGIN, END = "<!-- faults -->", "<!-- end of faults -->"
"""Marks in a page around the table."""
HEAD = ("| fault | what is done | expected | seen | seconds |", "|---|---|---|---|---|")


def _parser() -> Parser:
    parser = Parser(
        prog="python -m tools.faults",
        description="Make faults around a node, each with real processes, and see what it does: "
        "publishers and nodes that are killed, clocks that jump, caches that are damaged, few "
        "resources, too much to do. The exit code is 0 only if all went as expected.",
    )
    text = "fault to make, all if none is given; may be given several times"
    parser.add_argument("--only", action="append", choices=sorted(BY_NAME), help=text)
    parser.add_argument("--quick", action="store_true", help="leave out what compiles for minutes")
    option(parser, "--markdown", new_file(".md"), text="page whose table is written anew")
    return parser


@interruptible("python -m tools.faults")
def main(args: Sequence[str] | None = None) -> int:
    """Make faults; returns 0 only if a node did what was expected of it."""
    options = _parser().parse_args(args)
    chosen = [BY_NAME[name] for name in options.only or BY_NAME]
    domain = 1 + os.getpid() % LARGEST_DOMAIN
    outcomes = []
    for fault in chosen:
        if options.quick and fault.slow:
            continue
        outcomes.append(attempt(fault, domain))
        print(line_of(outcomes[-1]), flush=True)
    if options.markdown:
        write_table(options.markdown, outcomes)
    return 0 if all(outcome.held for outcome in outcomes) else 1


def line_of(outcome: Outcome) -> str:
    """Return a line about a fault."""
    held = "as expected" if outcome.held else "NOT AS EXPECTED"
    fault = outcome.fault
    return (
        f"{fault.name}: {held}, {outcome.seconds:.1f} s\n  fault: {fault.what}\n"
        f"  expected: {fault.expected}\n  seen: {outcome.seen}"
    )


def row_of(outcome: Outcome) -> str:
    """Return a row of a table in Markdown."""
    fault = outcome.fault
    seen = outcome.seen if outcome.held else f"**not as expected**: {outcome.seen}"
    cells = f"`{fault.name}`", fault.what, fault.expected, seen.replace("|", "/")
    return f"| {' | '.join(cells)} | {outcome.seconds:.0f} |"


def write_table(page: Path, outcomes: Sequence[Outcome]) -> None:
    """Write rows into the table of a page; those of other faults stay. A new page if there is none.

    The rows are in the order of the faults.
    """
    text = page.read_text(encoding="utf-8") if page.exists() else f"# Faults\n\n{BEGIN}\n{END}\n"
    if not (BEGIN in text and END in text):
        text += f"\n{BEGIN}\n{END}\n"
    before, table = text.split(BEGIN, 1)
    table, after = table.split(END, 1)
    rows = {line.split("`")[1]: line for line in table.splitlines() if line.startswith("| `")}
    rows |= {outcome.fault.name: row_of(outcome) for outcome in outcomes}
    lines = [*HEAD, *(rows[name] for name in BY_NAME if name in rows)]
    table = "\n".join(["", "", *lines, "", ""])
    page.write_text(before + BEGIN + table + END + after, encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())

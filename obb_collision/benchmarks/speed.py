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


"""Measures the full step beside the installed peers: console script ``obb_collision speed``.

A step brings new poses in and every colliding pair out. By default scenes of every size, of every
form, and with few boxes moving are measured, one after the other.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from itertools import product

from obb_collision.benchmarks.contestants import FORMS, OURS, PEERS, Contestant
from obb_collision.benchmarks.effects import cost_table, off_lines, run_effects
from obb_collision.benchmarks.steps import (
    STEPS,
    Case,
    StepPlan,
    StepRow,
    blocks_of,
    differences,
    joined,
    run_case,
    slopes,
    tables,
)
from obb_collision.benchmarks.tables import as_text, machine, machine_line, write_into
from obb_collision.benchmarks.timing import progress
from obb_collision.cli import MAX_SEED, Parser, interruptible, new_file, option, real, whole

SIZES = (10, 100, 1_000, 10_000, 100_000, 1_000_000)
SHARES = (0.1, 0.01, 0.0)
#: About how long a scene takes, for the bar.
SECONDS = 40.0
#: Seconds for the effects in all their scenes.
EFFECTS_SECONDS = 20.0


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Return the scenes asked for: every combination, or the default."""
    if options.sizes or options.forms or options.moving:
        sizes, forms = options.sizes or [10_000], options.forms or ["uniform"]
        shares = options.moving or [1.0]
        return [Case(form, n, share) for form, share, n in product(forms, shares, sizes)]
    cases = [Case(boxes=n) for n in SIZES] + [Case(form) for form in FORMS if form != "uniform"]
    return cases + [Case(moving=share) for share in SHARES]


def measure(
    options: argparse.Namespace, peers: Sequence[Contestant]
) -> tuple[list[StepRow], list[str]]:
    """Return a row per contestant and scene, and notes about those that are left out."""
    wanted = [one for one in peers if any(part in one.name for part in options.peers or [""])]
    notes = [("not installed:", one.name) for one in wanted if not one.installed]
    plan = StepPlan(options.seconds, options.limit, options.steps, options.seed)
    cases, rows = cases_of(options), list[StepRow]()
    with progress(SECONDS * len(cases)) as bar:
        for done, case in enumerate(cases):
            bar.leave(SECONDS * (len(cases) - done))
            found, more = run_case(case, [*OURS, *wanted], options.threads, plan, bar.show)
            rows += found
            notes += more
    return rows, joined(notes)


def parse(
    arguments: Sequence[str] | None, program: str = "obb_collision speed"
) -> argparse.Namespace:
    """Read the command line."""
    parser = Parser(
        prog=program,
        description="Measures the full step beside the installed peers: new poses in, every "
        "colliding pair out.",
    )
    add, cores = parser.add_argument, sorted({1, os.cpu_count() or 1})
    add("--sizes", type=whole(1, 10**7), nargs="+", help="numbers of boxes")
    add("--forms", choices=list(FORMS), nargs="+", help="forms of the scenes")
    add("--moving", type=real(0.0, 1.0), nargs="+", help="shares of the boxes that move")
    add("--threads", type=whole(1, 1024), nargs="+", default=cores, help="threads of ours, in turn")
    add("--peers", nargs="+", metavar="NAME", help="parts of the names of peers to compare with")
    option(parser, "--seconds", real(0.001, 1e6), 2.0, "minimum time per scene (s)")
    option(parser, "--steps", whole(1, 10**6), STEPS, "steps per scene, at least")
    option(parser, "--limit", real(0.001, 1e6), 40.0, "who would take longer is left out (s)")
    option(parser, "--seed", whole(0, MAX_SEED), 0, "seed of the random scenes")
    option(parser, "--json", new_file(), text="write the rows to a file")
    option(parser, "--plot", new_file(".png", ".svg"), text="draw the rows, PNG or SVG")
    pages = "pages that get the tables between their marks"
    add("--markdown", type=new_file(".md"), metavar="PAGE", nargs="+", help=pages)
    what = "measure what each effect costs in the scenes that come with the package instead"
    add("--effects", action="store_true", help=what)
    return parser.parse_args(arguments)


def _run_effects(options: argparse.Namespace) -> None:
    seconds = max(options.seconds, EFFECTS_SECONDS)
    rows = run_effects(seconds, lambda text: print(text, file=sys.stderr, flush=True))
    print("\n".join([as_text(cost_table(rows)), *off_lines(rows)]))
    if options.json:
        options.json.write_text(json.dumps([row._asdict() for row in rows], indent=1) + "\n")
    if options.plot:
        from obb_collision.benchmarks.plots import save_effect_costs

        save_effect_costs(rows, options.plot)


@interruptible("obb_collision speed")
def main(
    arguments: Sequence[str] | None = None,
    peers: Sequence[Contestant] = PEERS,
    program: str = "obb_collision speed",
) -> int:
    """Run the benchmark and print its tables."""
    options = parse(arguments, program)
    if options.effects:
        _run_effects(options)
        return 0
    rows, notes = measure(options, peers)
    facts = machine(one.distribution for one in peers)
    print(machine_line(facts))
    for title, table in tables(rows).items():
        print(f"\n{title}\n{as_text(table)}")
    print("\n".join(["", *slopes(rows), *differences(rows), *notes]))
    if options.json:
        result = {"machine": facts, "rows": [row._asdict() for row in rows], "notes": notes}
        options.json.write_text(json.dumps(result, indent=1) + "\n")
    if options.plot:
        from obb_collision.benchmarks.plots import save_speed

        save_speed(rows, options.plot)
    for page in options.markdown or ():
        write_into(page, blocks_of(rows, notes) | {"machine": machine_line(facts)})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

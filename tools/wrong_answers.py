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

"""Counts wrong answers per family of box pairs: this library, a textbook test, installed peers.

The truth is the library's integer arithmetic for *every* pair (`verdicts` uses it for undecided
pairs only). The tests check that arithmetic against an oracle that shares no code with it. Touching
counts as colliding for all.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from obb_collision import verdicts
from obb_collision.benchmarks.tables import as_markdown, as_text
from obb_collision.cli import MAX_SEED, Parser, interruptible, new_file, option, whole
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.verdict.verdict import Verdict, Verdicts, exact_verdict
from tools.cases.families import FAMILIES, generate
from tools.judges import (
    COLLIDING,
    FAILED,
    FREE,
    PEERS,
    Answers,
    Judge,
    textbook,
)

#: Pairs judged between two steps of the progress bar.
CHUNK = 2000

Row = dict[str, Any]
Step = Callable[[int], object]


def exact_verdicts(a: Boxes, b: Boxes) -> Verdicts:
    """Return the verdict of every row by integer arithmetic alone, (n,) int8."""
    return np.array([exact_verdict(a, n, b, n) for n in range(len(a))], dtype=np.int8)


def count_own(truth: Verdicts, given: Verdicts, exact: Verdicts) -> dict[str, int]:
    """Count wrong verdicts of the default and of the exact mode, and undecided pairs."""
    decided = given != Verdict.TOUCHING
    return {
        "default_false": int((decided & (given == Verdict.OVERLAP) & (truth != given)).sum()),
        "default_missed": int((decided & (given == Verdict.SEPARATE) & (truth != given)).sum()),
        "undecided": int((~decided & (truth != Verdict.TOUCHING)).sum()),
        "exact_wrong": int((exact != truth).sum()),
    }


def count_judge(truth: Verdicts, answers: Answers) -> dict[str, int]:
    """Count false collisions, missed ones, and exceptions of a peer."""
    apart = truth == Verdict.SEPARATE
    return {
        "false": int((apart & (answers == COLLIDING)).sum()),
        "missed": int((~apart & (answers == FREE)).sum()),
        "failed": int((answers == FAILED).sum()),
    }


def examine(name: str, n: int, seed: int, judges: dict[str, Judge], step: Step) -> Row:
    """Let all judge ``n`` pairs of one family."""
    arrays_a, arrays_b = generate(name, n, seed)
    all_a, all_b = Boxes(*arrays_a), Boxes(*arrays_b)
    row: Row = {"family": name, "pairs": n, "truth": Counter(), "own": Counter()}
    row["judges"] = {judge: Counter() for judge in judges}
    for start in range(0, n, CHUNK):
        rows = np.arange(start, min(start + CHUNK, n))
        a, b = all_a[rows], all_b[rows]
        truth = exact_verdicts(a, b)
        row["truth"].update({v.name.lower(): int((truth == v).sum()) for v in Verdict})
        row["own"].update(count_own(truth, verdicts(a, b), verdicts(a, b, exact=True)))
        stored = [(x.centers, x.rotations, x.half_extents) for x in (a, b)]
        for judge, ask in judges.items():
            with np.errstate(all="ignore"):
                row["judges"][judge].update(count_judge(truth, ask(*stored)))
        step(len(rows))
    return row


def installed_judges() -> tuple[dict[str, Judge], list[str]]:
    """Return the available judges by column title, and a line about each peer."""
    judges: dict[str, Judge] = {
        "textbook, 1e-6 added": textbook,
        "textbook, nothing added": partial(textbook, epsilon=0.0),
    }
    notes = []
    for peer in PEERS:
        judge = peer.judge()
        if judge is None:
            notes.append(f"{peer.name}: not installed, left out")
        else:
            judges[peer.name] = judge
            notes.append(f"{peer.name} {peer.version()}: {peer.how}")
    return judges, notes


def table(rows: Sequence[Row], judges: Iterable[str]) -> list[list[str]]:
    """Return header and lines, as text cells."""
    header = ["family", "apart / touching / overlapping", "this library", "undecided", "exact"]
    lines = [[*header, *judges]]
    for row in rows:
        own, truth = row["own"], row["truth"]
        line = [
            row["family"],
            f"{truth['separate']} / {truth['touching']} / {truth['overlap']}",
            f"{own['default_false']} / {own['default_missed']}",
            f"{own['undecided']}",
            f"{own['exact_wrong']}",
        ]
        for counts in row["judges"].values():
            failed = f" ({counts['failed']} failed)" if counts["failed"] else ""
            line.append(f"{counts['false']} / {counts['missed']}{failed}")
        lines.append(line)
    return lines


def _with_progress(names: Sequence[str], total: int) -> Iterator[tuple[str, Step]]:
    """Yield each family and a function to report finished pairs to."""
    try:
        bar = import_module("tqdm").tqdm(total=total, unit="pair", unit_scale=True)
    except ImportError:
        for k, name in enumerate(names):
            print(f"[{k + 1}/{len(names)}] {name}", file=sys.stderr, flush=True)
            yield name, lambda done: None
        return
    with bar:
        for name in names:
            bar.set_description(name)
            yield name, bar.update


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line; ``names`` are the families asked for."""
    summary = (__doc__ or "").splitlines()[0]
    parser = Parser(prog="python -m tools.wrong_answers", description=summary)
    option(parser, "--pairs", whole(1, 10**9), 10_000, "pairs per family")
    option(parser, "--seed", whole(0, MAX_SEED), 0, "seed of the random pairs")
    text = "part of the name of a family; may be repeated"
    parser.add_argument("--family", action="append", help=text)
    option(parser, "--json", new_file(), text="write all counts as JSON")
    parser.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    options = parser.parse_args(arguments)
    wanted = options.family or [""]
    options.names = [name for name in FAMILIES if any(part in name for part in wanted)]
    if not options.names:
        parser.error(f"--family matches none; there are: {'; '.join(FAMILIES)}")
    return options


@interruptible("python -m tools.wrong_answers")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the comparison; exit code 1 if this library gave a wrong verdict."""
    options = parse(arguments)
    judges, notes = installed_judges()
    total = options.pairs * len(options.names)
    rows = [
        examine(name, options.pairs, options.seed, judges, step)
        for name, step in _with_progress(options.names, total)
    ]
    lines = table(rows, judges)
    print(f"Wrong answers in {options.pairs} pairs of each family, seed {options.seed}.")
    print("a / b: a false collisions, b missed ones. Undecided pairs count as colliding.")
    print("\n".join(notes), end="\n\n")
    print(as_markdown(lines) if options.markdown else as_text(lines))
    if options.json:
        report = {
            "pairs": options.pairs,
            "seed": options.seed,
            "machine": platform.machine(),
            "python": platform.python_version(),
            "peers": {peer.name: peer.version() for peer in PEERS},
            "families": rows,
        }
        options.json.write_text(json.dumps(report, indent=1) + "\n")
    wrong = ("default_false", "default_missed", "exact_wrong")
    return int(any(row["own"][key] for row in rows for key in wrong))


if __name__ == "__main__":
    sys.exit(main())

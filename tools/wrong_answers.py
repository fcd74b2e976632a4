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
pairs only). The tests check that arithmetic against an oracle that shares no code with it.
Touching counts as colliding for all.

A judge takes two triples (centers (n, 3), rotations (n, 3, 3), half extents (n, 3)) and gives (n,)
int8: COLLIDING, FREE, or FAILED where it raised an exception. Every peer runs at its defaults and
gets the doubles as they are stored. A peer that is not installed is no error.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import json
import platform
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision import verdicts
from obb_collision.benchmarks.measuring import as_text
from obb_collision.cli import MAX_SEED, Parser, interruptible, new_file, option, whole
from obb_collision.geometry.boxes import BoxArrays, Boxes
from obb_collision.queries.verdict.pair_rows import RowPairs
from obb_collision.queries.verdict.verdict import Verdict, Verdicts, exact_verdict
from tools.cases.families import FAMILIES, generate
from tools.cases.placement import Arrays
from tools.certainty import EPSILON, plain_kernel
from tools.pages import as_markdown

FREE, COLLIDING, FAILED = 0, 1, -1

Answers = NDArray[np.int8]
Judge = Callable[[Arrays, Arrays], Answers]


@dataclass(frozen=True)
class Peer:
    """A library to compare with: its name for people, its distribution, and how it is called."""

    name: str
    distribution: str
    module: str
    make: Callable[[ModuleType], Judge]
    how: str

    def version(self) -> str | None:
        """Return the installed version, or None."""
        try:
            return importlib.metadata.version(self.distribution)
        except importlib.metadata.PackageNotFoundError:
            return None

    def judge(self) -> Judge | None:
        """Return the judge, or None where the peer can't be imported."""
        try:
            return self.make(importlib.import_module(self.module))
        except ImportError:
            return None


def textbook(a: Arrays, b: Arrays, epsilon: float = EPSILON) -> Answers:
    """Run the plain test of the textbooks in float64, ``epsilon`` added to abs(R)."""
    rows = np.arange(len(a[0]))
    out = np.empty(len(rows), np.int8)
    pairs = RowPairs(BoxArrays(*a), rows, BoxArrays(*b), rows)
    plain_kernel(pairs, epsilon, out, 0, len(rows))
    return np.where(out == Verdict.SEPARATE, FREE, COLLIDING).astype(np.int8)


def _rows(a: Arrays, b: Arrays) -> Iterator[tuple[Any, ...]]:
    return zip(*a, *b, strict=True)


def _one_by_one(ask: Callable[..., bool]) -> Judge:
    """Make a judge from a function of one pair; an exception is an answer too."""

    def judge(a: Arrays, b: Arrays) -> Answers:
        answers = np.empty(len(a[0]), np.int8)
        for n, row in enumerate(_rows(a, b)):
            try:
                answers[n] = COLLIDING if ask(*row) else FREE
            except Exception:  # peers raise any exception; the table counts it
                answers[n] = FAILED
        return answers

    return judge


def _fcl(fcl: ModuleType) -> Judge:
    def collides(ca: Any, ra: Any, ha: Any, cb: Any, rb: Any, hb: Any) -> bool:
        one = fcl.CollisionObject(fcl.Box(*(2.0 * ha)), fcl.Transform(ra, ca))
        two = fcl.CollisionObject(fcl.Box(*(2.0 * hb)), fcl.Transform(rb, cb))
        return bool(fcl.collide(one, two, fcl.CollisionRequest(), fcl.CollisionResult()))

    return _one_by_one(collides)


def _coal(coal: ModuleType) -> Judge:
    def collides(ca: Any, ra: Any, ha: Any, cb: Any, rb: Any, hb: Any) -> bool:
        one, two = coal.Box(*(2.0 * ha)), coal.Box(*(2.0 * hb))
        poses = coal.Transform3s(ra, ca), coal.Transform3s(rb, cb)
        result = coal.CollisionResult()
        coal.collide(one, poses[0], two, poses[1], coal.CollisionRequest(), result)
        return bool(result.isCollision())

    return _one_by_one(collides)


#: One explicit pair: mj_collision then goes to the two boxes without a broad phase in between.
_MUJOCO_MODEL = """
<mujoco>
  <worldbody>
    <body><freejoint/><geom name="a" type="box" size="1 1 1" contype="0" conaffinity="0"/></body>
    <body><freejoint/><geom name="b" type="box" size="1 1 1" contype="0" conaffinity="0"/></body>
  </worldbody>
  <contact><pair geom1="a" geom2="b"/></contact>
</mujoco>
"""


def _mujoco(mujoco: ModuleType) -> Judge:
    model = mujoco.MjModel.from_xml_string(_MUJOCO_MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)

    def collides(ca: Any, ra: Any, ha: Any, cb: Any, rb: Any, hb: Any) -> bool:
        # Written straight into the world poses, so that no conversion rounds anything.
        for k, (center, rotation, half) in enumerate(((ca, ra, ha), (cb, rb, hb))):
            data.geom_xpos[k], data.geom_xmat[k] = center, rotation.ravel()
            model.geom_size[k], model.geom_rbound[k] = half, np.sqrt((half * half).sum())
        mujoco.mj_collision(model, data)
        return bool(data.ncon > 0)

    return _one_by_one(collides)


PEERS = (
    Peer("python-fcl", "python-fcl", "fcl", _fcl, "fcl.collide"),
    Peer("coal", "coal", "coal", _coal, "coal.collide"),
    Peer("MuJoCo", "mujoco", "mujoco", _mujoco, "mj_collision, margin 0, contacts > 0"),
)


#: Pairs judged at once.
CHUNK = 2000

Row = dict[str, Any]


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


def examine(name: str, n: int, seed: int, judges: dict[str, Judge]) -> Row:
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
    header = ["family", "apart/touching/overlapping", "this library", "undecided", "exact"]
    lines = [[*header, *judges]]
    for row in rows:
        own, truth = row["own"], row["truth"]
        line = [
            row["family"],
            f"{truth['separate']}/{truth['touching']}/{truth['overlap']}",
            f"{own['default_false']}/{own['default_missed']}",
            f"{own['undecided']}",
            f"{own['exact_wrong']}",
        ]
        for counts in row["judges"].values():
            failed = f" ({counts['failed']} failed)" if counts["failed"] else ""
            line.append(f"{counts['false']}/{counts['missed']}{failed}")
        lines.append(line)
    return lines


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
    rows = []
    for number, name in enumerate(options.names, 1):
        print(f"[{number}/{len(options.names)}] {name}", file=sys.stderr, flush=True)
        rows.append(examine(name, options.pairs, options.seed, judges))
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

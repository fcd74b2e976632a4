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

The test of the textbooks (Ericson 2005, 4.4.1): the matrix of dot products and its absolute values
with a small epsilon added, against parallel edges; one axis after the other with an early exit.
``--seconds`` times it beside the certified test, in float64 and in float32, as on a graphics card.

A judge takes two triples (centers (n, 3), rotations (n, 3, 3), half extents (n, 3)) and gives (n,)
int8: COLLIDING, FREE, or FAILED where it raised an exception. Every peer runs at its defaults and
gets the doubles as they are stored. A peer that is not installed is no error.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision import verdicts
from obb_collision._jit import njit
from obb_collision.benchmarks.contestants import make_frames
from obb_collision.benchmarks.measuring import Show, as_text, take_turns
from obb_collision.boxes import Boxes
from obb_collision.cli import SEED, Parser, interruptible, option, real, whole
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.queries.verdict.pair_rows import RowPairs
from obb_collision.queries.verdict.verdict import (
    OVERLAP,
    SEPARATE,
    TOUCHING,
    Verdict,
    Verdicts,
    exact_verdict,
    pair_verdicts,
    verdict_kernel,
)
from obb_collision.scene.broad_phase.find_pairs import find_pairs
from obb_collision.typing import Floats, Rows
from tools.cases.families import FAMILIES, generate
from tools.cases.placement import Arrays
from tools.pages import as_markdown
from tools.peers.pairs import DOUBLES, PairPeer, PlacedBox

FREE, COLLIDING, FAILED = 0, 1, -1

Answers = NDArray[np.int8]
Judge = Callable[[Arrays, Arrays], Answers]


#: What textbooks add to every absolute value, against null cross products of parallel edges: they
#: say "an epsilon"; this is what implementations use most.
EPSILON = 1e-6


@njit
def plain_kernel(pairs: RowPairs, epsilon: float, out: np.ndarray, start: int, stop: int) -> None:
    """Write 0 (apart) or 2 (colliding) for pairs of rows; arrays as in ``separation``.

    Of float32 arrays everything is computed in float32. epsilon: added to every absolute value.
    """
    (ca, a, h), rows_a, (cb, b, f), rows_b = pairs
    for n in range(start, stop):
        out[n] = (
            2 if _collide(ca, a, h, rows_a[n], cb, b, f, rows_b[n], h.dtype.type(epsilon)) else 0
        )


@njit
def _collide(
    ca: Floats,
    a: Floats,
    h: Floats,
    i: int,
    cb: Floats,
    b: Floats,
    f: Floats,
    j: int,
    epsilon: float,  # of the type of the others: else float32 would turn into float64
) -> bool:
    dx, dy, dz = cb[j, 0] - ca[i, 0], cb[j, 1] - ca[i, 1], cb[j, 2] - ca[i, 2]
    h0, h1, h2 = h[i, 0], h[i, 1], h[i, 2]
    f0, f1, f2 = f[j, 0], f[j, 1], f[j, 2]
    t0 = dx * a[i, 0, 0] + dy * a[i, 1, 0] + dz * a[i, 2, 0]
    r00 = a[i, 0, 0] * b[j, 0, 0] + a[i, 1, 0] * b[j, 1, 0] + a[i, 2, 0] * b[j, 2, 0]
    r01 = a[i, 0, 0] * b[j, 0, 1] + a[i, 1, 0] * b[j, 1, 1] + a[i, 2, 0] * b[j, 2, 1]
    r02 = a[i, 0, 0] * b[j, 0, 2] + a[i, 1, 0] * b[j, 1, 2] + a[i, 2, 0] * b[j, 2, 2]
    q00, q01, q02 = abs(r00) + epsilon, abs(r01) + epsilon, abs(r02) + epsilon
    if abs(t0) > h0 + f0 * q00 + f1 * q01 + f2 * q02:
        return False
    t1 = dx * a[i, 0, 1] + dy * a[i, 1, 1] + dz * a[i, 2, 1]
    r10 = a[i, 0, 1] * b[j, 0, 0] + a[i, 1, 1] * b[j, 1, 0] + a[i, 2, 1] * b[j, 2, 0]
    r11 = a[i, 0, 1] * b[j, 0, 1] + a[i, 1, 1] * b[j, 1, 1] + a[i, 2, 1] * b[j, 2, 1]
    r12 = a[i, 0, 1] * b[j, 0, 2] + a[i, 1, 1] * b[j, 1, 2] + a[i, 2, 1] * b[j, 2, 2]
    q10, q11, q12 = abs(r10) + epsilon, abs(r11) + epsilon, abs(r12) + epsilon
    if abs(t1) > h1 + f0 * q10 + f1 * q11 + f2 * q12:
        return False
    t2 = dx * a[i, 0, 2] + dy * a[i, 1, 2] + dz * a[i, 2, 2]
    r20 = a[i, 0, 2] * b[j, 0, 0] + a[i, 1, 2] * b[j, 1, 0] + a[i, 2, 2] * b[j, 2, 0]
    r21 = a[i, 0, 2] * b[j, 0, 1] + a[i, 1, 2] * b[j, 1, 1] + a[i, 2, 2] * b[j, 2, 1]
    r22 = a[i, 0, 2] * b[j, 0, 2] + a[i, 1, 2] * b[j, 1, 2] + a[i, 2, 2] * b[j, 2, 2]
    q20, q21, q22 = abs(r20) + epsilon, abs(r21) + epsilon, abs(r22) + epsilon
    if abs(t2) > h2 + f0 * q20 + f1 * q21 + f2 * q22:
        return False
    if abs(t0 * r00 + t1 * r10 + t2 * r20) > f0 + h0 * q00 + h1 * q10 + h2 * q20:
        return False
    if abs(t0 * r01 + t1 * r11 + t2 * r21) > f1 + h0 * q01 + h1 * q11 + h2 * q21:
        return False
    if abs(t0 * r02 + t1 * r12 + t2 * r22) > f2 + h0 * q02 + h1 * q12 + h2 * q22:
        return False
    if abs(t2 * r10 - t1 * r20) > h1 * q20 + h2 * q10 + f1 * q02 + f2 * q01:
        return False
    if abs(t2 * r11 - t1 * r21) > h1 * q21 + h2 * q11 + f0 * q02 + f2 * q00:
        return False
    if abs(t2 * r12 - t1 * r22) > h1 * q22 + h2 * q12 + f0 * q01 + f1 * q00:
        return False
    if abs(t0 * r20 - t2 * r00) > h0 * q20 + h2 * q00 + f1 * q12 + f2 * q11:
        return False
    if abs(t0 * r21 - t2 * r01) > h0 * q21 + h2 * q01 + f0 * q12 + f2 * q10:
        return False
    if abs(t0 * r22 - t2 * r02) > h0 * q22 + h2 * q02 + f0 * q11 + f1 * q10:
        return False
    if abs(t1 * r00 - t0 * r10) > h0 * q10 + h1 * q00 + f1 * q22 + f2 * q21:
        return False
    if abs(t1 * r01 - t0 * r11) > h0 * q11 + h1 * q01 + f0 * q22 + f2 * q20:
        return False
    return not abs(t1 * r02 - t0 * r12) > h0 * q12 + h1 * q02 + f0 * q21 + f1 * q20


def textbook(a: Arrays, b: Arrays, epsilon: float = EPSILON) -> Answers:
    """Run the plain test of the textbooks in float64, ``epsilon`` added to abs(R)."""
    rows = np.arange(len(a[0]))
    out = np.empty(len(rows), np.int8)
    pairs = RowPairs(BoxArrays(*a), rows, BoxArrays(*b), rows)
    plain_kernel(pairs, epsilon, out, 0, len(rows))
    return np.where(out == Verdict.SEPARATE, FREE, COLLIDING).astype(np.int8)


def judge_of(peer: PairPeer) -> Judge:
    """Return the judge that asks a peer about one pair after the other."""

    def judge(a: Arrays, b: Arrays) -> Answers:
        answers = np.empty(len(a[0]), np.int8)
        for n, pair in enumerate(zip(map(PlacedBox, *a), map(PlacedBox, *b), strict=True)):
            try:
                answers[n] = COLLIDING if peer.answer(*pair, distance=False).collides else FREE
            except Exception:  # peers raise any exception; the table counts it
                answers[n] = FAILED
        return answers

    return judge


#: Columns in the order of the page.
PEERS = tuple(reversed(DOUBLES))
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
        version = peer.version()
        if version is None:
            notes.append(f"{peer.name}: not installed, left out")
        else:
            judges[peer.name] = judge_of(peer)
            notes.append(f"{peer.name} {version}: {peer.how}")
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


#: Offset of the scene along each axis, metres: the coordinates of a map.
FAR = 100_000.0


class FloatRow(NamedTuple):
    """A kernel on a set of pairs. Undecided ones are reported as such, and not wrong."""

    kernel: str
    pairs_of: str
    pairs: int
    pair_ns: float
    false: int
    missed: int
    undecided: int


class Set(NamedTuple):
    """Pairs of boxes, and whether they collide: exactly."""

    name: str
    boxes: Boxes
    first: Rows
    second: Rows


def pair_sets(hard: int, seed: int, count: int = 2000) -> list[Set]:
    """Return a scene near and far from the origin, and ``hard`` pairs of each family."""
    half_extents, (frame, *_) = make_frames("uniform", count, 1.0, seed)
    boxes = Boxes.from_poses(frame.poses, half_extents)
    near = np.ascontiguousarray(find_pairs(boxes, accuracy="aabb").T)
    far = Boxes(boxes.centers + FAR, boxes.rotations, boxes.half_extents)
    first, second = zip(*(generate(name, hard, seed) for name in FAMILIES), strict=True)
    both = Boxes(*map(np.concatenate, zip(*first, *second, strict=True)))
    rows = np.arange(len(both) // 2)
    return [
        Set("a scene", boxes, *near),
        Set("100 km off", far, *near),
        Set("hard pairs", both, rows, rows + len(rows)),
    ]


#: Each kernel and the type of its numbers.
KERNELS: dict[str, tuple[Callable[..., None], type]] = {
    "certified float64": (verdict_kernel, np.float64),
    "plain float64": (plain_kernel, np.float64),
    "plain float32": (plain_kernel, np.float32),
}


def measure_floats(sets: list[Set], seconds: float, show: Show) -> list[FloatRow]:
    """Time the three kernels on each set in turn, and count their wrong verdicts."""
    rows = []
    for pairs in sets:
        show(f"float64 and float32: {pairs.name}")
        truth = pair_verdicts(pairs.boxes, pairs.first, pairs.boxes, pairs.second, exact=True)
        out = {name: np.empty(len(truth), np.int8) for name in KERNELS}
        runs = {name: _run(*KERNELS[name], pairs, out[name]) for name in KERNELS}
        for run in runs.values():
            run()
        times = take_turns(runs, seconds / len(sets))
        for name, found in out.items():
            false = int(((found == OVERLAP) & (truth == SEPARATE)).sum())
            missed = int(((found == SEPARATE) & (truth != SEPARATE)).sum())
            pair_ns = 1e9 * times.best(name) / max(1, len(truth))
            undecided = int((found == TOUCHING).sum())
            rows.append(FloatRow(name, pairs.name, len(truth), pair_ns, false, missed, undecided))
    return rows


def _run(
    kernel: Callable[..., None], number: type, pairs: Set, out: NDArray[np.int8]
) -> Callable[[], None]:
    boxes = pairs.boxes
    with np.errstate(over="ignore", under="ignore"):
        arrays = BoxArrays(*(x.astype(number) for x in boxes.arrays))
    rows = RowPairs(arrays, pairs.first, arrays, pairs.second)
    more = () if kernel is verdict_kernel else (EPSILON,)
    return lambda: kernel(rows, *more, out, 0, len(out))


def cost_table(rows: list[FloatRow]) -> list[list[str]]:
    """Return the rows as text."""
    lines = [["", "", "pairs", "a pair, ns", "false", "missed", "undecided"]]
    return lines + [[f"{x:.1f}" if isinstance(x, float) else str(x) for x in row] for row in rows]


@interruptible("python -m tools.wrong_answers")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the comparison; exit code 1 if this library gave a wrong verdict."""
    summary = (__doc__ or "").splitlines()[0]
    parser = Parser(prog="python -m tools.wrong_answers", description=summary)
    option(parser, "--pairs", whole(1, 10**9), 10_000, "pairs per family")
    option(parser, "--seed", SEED, 0, "seed of the random pairs")
    text = "part of the name of a family; may be repeated"
    parser.add_argument("--family", action="append", help=text)
    text = "time the certified test beside the plain one for so long (s), in place of the peers"
    option(parser, "--seconds", real(0.001, 1e6), text=text)
    parser.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    options = parser.parse_args(arguments)
    wanted = options.family or [""]
    names = [name for name in FAMILIES if any(part in name for part in wanted)]
    if not names:
        parser.error(f"--family matches none; there are: {'; '.join(FAMILIES)}")
    if options.seconds:
        show = partial(print, file=sys.stderr)
        costs = measure_floats(pair_sets(options.pairs, options.seed), options.seconds, show)
        print(as_text(cost_table(costs)))
        ours = [row for row in costs if row.kernel.startswith("certified")]
        return int(any(row.false + row.missed for row in ours))
    judges, notes = installed_judges()
    rows = []
    for number, name in enumerate(names, 1):
        print(f"[{number}/{len(names)}] {name}", file=sys.stderr, flush=True)
        rows.append(examine(name, options.pairs, options.seed, judges))
    lines = table(rows, judges)
    print(f"Wrong answers in {options.pairs} pairs of each family, seed {options.seed}.")
    print("a / b: a false collisions, b missed ones. Undecided pairs count as colliding.")
    print("\n".join(notes), end="\n\n")
    print(as_markdown(lines) if options.markdown else as_text(lines))
    wrong = ("default_false", "default_missed", "exact_wrong")
    return int(any(row["own"][key] for row in rows for key in wrong))


if __name__ == "__main__":
    sys.exit(main())

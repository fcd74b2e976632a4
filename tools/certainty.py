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

"""The certified test of two boxes beside the plain one of the textbooks: time and wrong verdicts.

Ericson 2005, 4.4.1: the matrix of dot products and its absolute values with a small epsilon
added, against parallel edges; one axis after the other with an early exit. In float32 all its
numbers are float32, as on a graphics card. Wrong is a verdict that exact arithmetic contradicts.

    python -m tools.certainty [--seconds S] [--hard N]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.benchmarks.contestants import make_frames
from obb_collision.benchmarks.measuring import Show, as_text, take_turns
from obb_collision.cli import MAX_SEED, Parser, interruptible, option, real, whole
from obb_collision.geometry.boxes import BoxArrays, Boxes
from obb_collision.queries.verdict.pair_rows import RowPairs
from obb_collision.queries.verdict.verdict import (
    OVERLAP,
    SEPARATE,
    TOUCHING,
    pair_verdicts,
    verdict_kernel,
)
from obb_collision.scene.broad_phase.find_pairs import find_pairs
from obb_collision.typing import Floats, Rows
from tools.cases.families import FAMILIES, generate

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


def pair_sets(count: int, hard: int, seed: int) -> list[Set]:
    """Return a scene near and far from the origin, and ``hard`` pairs of each hard family."""
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


#: What textbooks add to every absolute value, against null cross products of parallel edges: they
#: say "an epsilon"; this is what implementations use most.
EPSILON = 1e-6


@njit
def plain_kernel(pairs: RowPairs, epsilon: float, out: np.ndarray, start: int, stop: int) -> None:
    """Write 0 (apart) or 2 (colliding) for some pairs of rows; arrays as in ``separation``.

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


def table(rows: list[FloatRow]) -> list[list[str]]:
    """Return the rows as text."""
    lines = [["", "", "pairs", "a pair, ns", "false", "missed", "undecided"]]
    for row in rows:
        counts = map(str, (row.false, row.missed, row.undecided))
        lines.append([row.kernel, row.pairs_of, str(row.pairs), f"{row.pair_ns:.1f}", *counts])
    return lines


@interruptible("python -m tools.certainty")
def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; exit code 1 if a certified verdict was wrong."""
    parser = Parser(prog="python -m tools.certainty", description="what certainty costs")
    option(parser, "--seconds", real(0.001, 1e6), 10.0, "approximate time (s)")
    option(parser, "--boxes", whole(2, 10**6), 2000, "boxes of the scene")
    option(parser, "--hard", whole(1, 10**6), 1000, "hard pairs of each family")
    option(parser, "--seed", whole(0, MAX_SEED), 0, "seed of the random poses")
    options = parser.parse_args(arguments)
    sets = pair_sets(options.boxes, options.hard, options.seed)
    rows = measure_floats(sets, options.seconds, partial(print, file=sys.stderr))
    print(as_text(table(rows)))
    return int(any(row.false + row.missed for row in rows if row.kernel.startswith("certified")))


if __name__ == "__main__":
    raise SystemExit(main())

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

"""What certainty costs: the certified test beside plain ones in float64 and in float32.

The plain test is that of the textbooks (see ``plain``); in float32 all its numbers are float32, as
on a graphics card. Wrong is a verdict that exact arithmetic contradicts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision.benchmarks.cases.families import FAMILIES, generate
from obb_collision.benchmarks.cases.plain import plain_kernel
from obb_collision.benchmarks.price.levels import Bodies
from obb_collision.benchmarks.price.scenes import Corpus
from obb_collision.benchmarks.price.turns import take_turns
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.verdict.verdict import (
    OVERLAP,
    SEPARATE,
    TOUCHING,
    pair_verdicts,
    verdict_kernel,
)
from obb_collision.typing import Rows

#: Offset of the scene along each axis, metres: the coordinates of a map.
FAR = 100_000.0


@dataclass(frozen=True)
class FloatRow:
    """A kernel on a set of pairs. Undecided ones are reported as such, and not wrong."""

    kernel: str
    pairs_of: str
    pairs: int
    pair_ns: float
    false: int
    missed: int
    undecided: int


@dataclass(frozen=True)
class Set:
    """Pairs of boxes, and whether they collide: exactly."""

    name: str
    boxes: Boxes
    first: Rows
    second: Rows


def pair_sets(corpus: Corpus, count: int, hard: int, seed: int) -> list[Set]:
    """Return a scene near and far from the origin, and ``hard`` pairs of each hard family."""
    throw = Bodies(corpus, count, seed).throw()
    boxes = throw.boxes
    far = Boxes(boxes.centers + FAR, boxes.rotations, boxes.half_extents)
    sides = [generate(name, hard, seed) for name in FAMILIES]
    a, b = (
        Boxes(*map(np.concatenate, zip(*side, strict=True))) for side in zip(*sides, strict=True)
    )
    both = Boxes.trusted(
        np.concatenate([a.centers, b.centers]),
        np.concatenate([a.rotations, b.rotations]),
        np.concatenate([a.half_extents, b.half_extents]),
    )
    rows = np.arange(len(a))
    return [
        Set("a scene", boxes, throw.first, throw.second),
        Set("100 km off", far, throw.first, throw.second),
        Set("hard pairs", both, rows, rows + len(a)),
    ]


#: Each kernel and the type of its numbers.
KERNELS: dict[str, tuple[Callable[..., None], type]] = {
    "certified float64": (verdict_kernel, np.float64),
    "plain float64": (plain_kernel, np.float64),
    "plain float32": (plain_kernel, np.float32),
}


def measure_floats(sets: list[Set], seconds: float, show: Callable[[str], None]) -> list[FloatRow]:
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
        sides: list[Any] = [
            x.astype(number) for x in (boxes.centers, boxes.rotations, boxes.half_extents)
        ]
    return lambda: kernel(*sides, pairs.first, *sides, pairs.second, out, 0, len(out))

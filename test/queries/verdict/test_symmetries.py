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

"""What holds bit for bit: swapping, relabelling, scaling, moving, batching, threads, JIT."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import permutations, product
from pathlib import Path

import numpy as np
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from support import family, row_of, stored, witnesses

from obb_collision import Boxes, verdicts
from obb_collision.queries.verdict.pair_frame import box_of, pair_of
from obb_collision.queries.verdict.verdict import UNDECIDED, careful_verdict, fast_verdict
from tools.cases.families import FAMILIES

ROWS = 300
SOME = np.arange(20)
names = st.sampled_from(sorted(FAMILIES))
seeds = st.integers(0, 3)
relabellings = st.tuples(
    st.sampled_from(list(permutations(range(3)))),
    st.sampled_from(list(product((-1.0, 1.0), repeat=3))),
)
cached_family = cache(family)
Relabelling = tuple[tuple[int, ...], tuple[float, ...]]


def check_same(
    first: tuple[Boxes, Boxes], second: tuple[Boxes, Boxes], factor: float = 1.0
) -> None:
    """Verdicts, gaps and axes agree bit for bit, gaps times a power of two.

    Axes may differ in sign where the centres agree along them: there the sign says nothing.
    """
    check_verdicts(first, second)
    gaps, axes = witnesses(*first)
    other_gaps, other_axes = witnesses(*second)
    np.testing.assert_array_equal(gaps * factor, other_gaps)
    np.testing.assert_array_equal(np.abs(axes), np.abs(other_axes))
    signed = centers_differ_along(axes, *first)
    np.testing.assert_array_equal(axes[signed], other_axes[signed])


def check_verdicts(first: tuple[Boxes, Boxes], second: tuple[Boxes, Boxes]) -> None:
    """Default verdicts of all rows, exact ones of a few."""
    np.testing.assert_array_equal(verdicts(*first), verdicts(*second))
    few, same_few = ((a[SOME], b[SOME]) for a, b in (first, second))
    np.testing.assert_array_equal(verdicts(*few, exact=True), verdicts(*same_few, exact=True))


def centers_differ_along(axes: np.ndarray, a: Boxes, b: Boxes) -> np.ndarray:
    """(n,) mask of the pairs whose centres differ along the axis by more than a rounding."""
    offset = b.centers - a.centers
    along = np.abs(np.einsum("ni,ni->n", axes, offset))
    mask: np.ndarray = along > 1e-15 * np.abs(offset).sum(axis=1)
    return mask


@settings(max_examples=60)
@given(names, seeds)
def test_swapping_the_boxes_reverses_the_axis(name: str, seed: int) -> None:
    a, b = cached_family(name, ROWS, seed)
    check_verdicts((a, b), (b, a))
    gaps, axes = witnesses(a, b)
    swapped_gaps, swapped_axes = witnesses(b, a)
    np.testing.assert_array_equal(gaps, swapped_gaps)
    np.testing.assert_array_equal(np.abs(axes), np.abs(swapped_axes))
    signed = centers_differ_along(axes, a, b)
    np.testing.assert_array_equal(axes[signed], -swapped_axes[signed])


def relabelled(boxes: Boxes, how: Relabelling) -> Boxes:
    order, signs = list(how[0]), np.array(how[1])
    return Boxes(boxes.centers, boxes.rotations[:, :, order] * signs, boxes.half_extents[:, order])


@settings(max_examples=100)
@given(names, seeds, relabellings, relabellings)
def test_relabelling_and_flipping_axes_changes_nothing(
    name: str, seed: int, how_a: Relabelling, how_b: Relabelling
) -> None:
    a, b = cached_family(name, ROWS, seed)
    check_same((a, b), (relabelled(a, how_a), relabelled(b, how_b)))


@settings(max_examples=60)
@given(names.filter(lambda name: not name.startswith("sizes")), seeds, st.integers(-400, 400))
def test_scaling_by_a_power_of_two_scales_the_gap(name: str, seed: int, power: int) -> None:
    a, b = cached_family(name, ROWS, seed)
    factor = 2.0**power
    check_same((a, b), (scaled(a, factor), scaled(b, factor)), factor)


def scaled(boxes: Boxes, factor: float) -> Boxes:
    return Boxes(boxes.centers * factor, boxes.rotations, boxes.half_extents * factor)


@settings(max_examples=60)
@given(names, seeds, st.lists(st.integers(-(2**40), 2**40), min_size=3, max_size=3))
def test_moving_both_by_the_same_offset_changes_nothing(
    name: str, seed: int, offset: list[int]
) -> None:
    """Centres on a grid of 2^-10 m, so that the moved ones are representable."""
    a, b = (on_grid(boxes) for boxes in cached_family(name, ROWS, seed))
    move = np.array(offset) / 1024.0
    moved = [Boxes(boxes.centers + move, boxes.rotations, boxes.half_extents) for boxes in (a, b)]
    for boxes, there in zip((a, b), moved, strict=True):
        np.testing.assert_array_equal(there.centers - move, boxes.centers)
    check_same((a, b), (moved[0], moved[1]))


def on_grid(boxes: Boxes) -> Boxes:
    centers = np.clip(np.round(boxes.centers * 1024.0), -(2**40), 2**40) / 1024.0
    return Boxes(centers, boxes.rotations, boxes.half_extents)


@each("name", FAMILIES)
def test_the_two_stages_never_contradict_each_other(name: str) -> None:
    """What the fast stage decides, the careful one decides too: hence the symmetries hold."""
    a, b = cached_family(name, 2000, 0)
    decided = 0
    for row in range(len(a)):
        first, second = box_of(*row_of(a, row)), box_of(*row_of(b, row))
        fast = fast_verdict(*pair_of(first, second))
        if fast != UNDECIDED:
            assert fast == careful_verdict(first, second)
            decided += 1
    assert decided > 50


@each("name", FAMILIES)
def test_batches_of_any_length_agree(name: str) -> None:
    a, b = cached_family(name, ROWS, 0)
    whole = verdicts(a, b)
    for size in (1, 7, 64):
        parts = [
            verdicts(a[rows], b[rows]) for rows in np.array_split(np.arange(ROWS), ROWS // size)
        ]
        np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_several_threads_at_once_agree_with_one() -> None:
    jobs = [cached_family(name, ROWS, seed) for name in FAMILIES for seed in range(4)]

    def answer(job: tuple[Boxes, Boxes]) -> list[np.ndarray]:
        return [verdicts(*job), *witnesses(*job)]

    alone = [answer(job) for job in jobs]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(answer, jobs))
    for first, second in zip(alone, together, strict=True):
        for x, y in zip(first, second, strict=True):
            np.testing.assert_array_equal(x, y)


WITHOUT_JIT = """
import sys
import numpy as np
from numba.core import config
from obb_collision import verdicts
from support import family, witnesses
assert config.DISABLE_JIT
out = {}
for k, name in enumerate(sys.argv[3:]):
    a, b = family(name, int(sys.argv[2]))
    out[f"verdicts{k}"] = verdicts(a, b)
    out[f"gaps{k}"], out[f"axes{k}"] = witnesses(a, b)
np.savez(sys.argv[1], **out)
"""


def test_the_compiler_changes_no_bit(tmp_path: Path) -> None:
    """The same functions run by the Python interpreter, in a process of their own."""
    rows = 40
    test = Path(__file__).parents[2]
    paths = [test / "oracles", test / "support", test.parent, os.environ.get("PYTHONPATH", "")]
    environment = {
        **os.environ,
        "NUMBA_DISABLE_JIT": "1",
        "PYTHONPATH": os.pathsep.join(map(str, paths)),
    }
    file = tmp_path / "interpreted.npz"
    command = [sys.executable, "-c", WITHOUT_JIT, str(file), str(rows), *FAMILIES]
    subprocess.run(command, env=environment, check=True, timeout=300)
    interpreted = np.load(file)
    for k, name in enumerate(FAMILIES):
        a, b = family(name, rows)
        np.testing.assert_array_equal(verdicts(a, b), interpreted[f"verdicts{k}"])
        gaps, axes = witnesses(a, b)
        np.testing.assert_array_equal(gaps, interpreted[f"gaps{k}"])
        np.testing.assert_array_equal(axes, interpreted[f"axes{k}"])


def test_stored_boxes_are_kept_bit_for_bit() -> None:
    """A rotation that is orthonormal to rounding is not touched on the way in."""
    for name in FAMILIES:
        a, _ = cached_family(name, ROWS, 0)
        again = Boxes(*stored(a))
        for x, y in zip(stored(a), stored(again), strict=True):
            np.testing.assert_array_equal(x, y)

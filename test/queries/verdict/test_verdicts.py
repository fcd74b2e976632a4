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

"""Verdicts and their witnesses: exact, certified, symmetric, the same alone and in blocks."""

from __future__ import annotations

import json
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np
import oracle
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from processes import run_python
from support import any_pairs, by_threads, family, loosened, row_of, sizes, stored, witnesses

import obb_collision as oc
from obb_collision import OBB, Boxes, Verdict, verdicts
from obb_collision.queries.verdict import UNDECIDED, careful_verdict, fast_verdict
from obb_collision.queries.verdict import verdict as verdict_module
from obb_collision.queries.verdict.sat import AXIS_COUNT, box_of, pair_of
from obb_collision.queries.verdict.witness import PAIR_BLOCK, box_witness, careful_gap, gap_bounds
from obb_collision.typing import Floats
from tools.cases.families import FAMILIES
from tools.cases.placement import random_rotations, turns

#: Promised width of what doubles leave undecided, relative to the sum of all half extents.
UNDECIDED_WIDTH = 1e-14

Pair = tuple[Boxes, Boxes]
#: Pairs at a time.
CHUNK = 20_000
#: 97 of them.
SHARED_PAIRS = json.loads((Path(__file__).parents[2] / "data" / "box_pairs.json").read_text())
LABELS = {"separate": Verdict.SEPARATE, "touch": Verdict.TOUCHING, "overlap": Verdict.OVERLAP}


def check_against_truth(a: Boxes, b: Boxes) -> float:
    """Assert the promise for every row; return the widest gap left open, relative to the size."""
    truth = oracle.verdicts(stored(a), stored(b))
    default = verdicts(a, b)
    decided = default != Verdict.TOUCHING
    np.testing.assert_array_equal(default[decided], truth[decided])
    np.testing.assert_array_equal(verdicts(a, b, exact=True), truth)
    open_rows = np.flatnonzero(~decided & (truth != Verdict.TOUCHING))
    a, b = a[open_rows], b[open_rows]
    gaps = oracle.relative_separations(stored(a), stored(b))
    widest = float(np.abs(gaps).max(initial=0.0))
    assert widest <= UNDECIDED_WIDTH
    return widest


@each("name", FAMILIES)
def test_no_verdict_is_wrong(name: str, pairs: int) -> None:
    """Made, judged and thrown away in chunks: a million pairs need no more memory than one."""
    starts = range(0, pairs, CHUNK)
    chunks = (family(name, min(CHUNK, pairs - n), seed) for seed, n in enumerate(starts))
    widest = max(check_against_truth(a, b) for a, b in chunks)
    print(f"{name}: {pairs} pairs, widest gap left open {widest:.2e} of the size")  # noqa: T201


@each("name", FAMILIES)
def test_what_the_oracle_decides_by_doubles_is_what_integers_say(name: str) -> None:
    a, b = (stored(side) for side in family(name, 40, seed=4))
    rows = zip(*a, *b, strict=True)
    assert oracle.verdicts(a, b).tolist() == [oracle.verdict(r[:3], r[3:]) for r in rows]


@each("name", FAMILIES)
def test_families_ask_both_questions(name: str) -> None:
    """A family in which every pair has the same answer would test nothing."""
    truth = verdicts(*family(name, 1000), exact=True)
    assert (truth == Verdict.SEPARATE).sum() > 20
    assert (truth == Verdict.OVERLAP).sum() > 20
    if name in ("exact resting contact", "zero extents"):
        assert (truth == Verdict.TOUCHING).sum() > 100


@each("name", FAMILIES)
def test_axes_may_be_off_by_64_roundoffs(name: str, pairs: int) -> None:
    """Products of kept rotations are a little further from orthonormal: the proof allows 64 u."""
    rng = np.random.default_rng(11)
    sides = family(name, max(pairs // 3, 100), seed=2)
    loose = [Boxes.trusted(s.centers, loosened(s.rotations, rng), s.half_extents) for s in sides]
    check_against_truth(loose[0], loose[1])


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@settings(max_examples=100)
@given(any_pairs())
def test_any_doubles_at_all(pair: Pair) -> None:
    """Whatever is accepted is answered rightly, from subnormal to 1e300, equal centres too."""
    a, b = pair
    truth = oracle.verdicts(stored(a), stored(b))
    default = verdicts(a, b)
    assert default[0] in (truth[0], Verdict.TOUCHING)
    np.testing.assert_array_equal(verdicts(a, b, exact=True), truth)
    gap, axis = witnesses(a, b)
    assert np.isfinite(gap).all()
    np.testing.assert_allclose(np.linalg.norm(axis), 1.0, rtol=0, atol=1e-15)


def test_every_one_of_the_15_axes_decides_alone() -> None:
    a, b = family("each of the 15 axes alone", 15 * 20)
    apart = verdicts(a, b) == Verdict.SEPARATE
    np.testing.assert_array_equal(apart, (np.arange(len(a)) // 15) % 2 == 0)
    for row in np.flatnonzero(apart):
        pair = oracle.ExactPair(row_of(a, row), row_of(b, row))
        gaps = [pair.gap(axis) for axis in pair.candidate_axes()]
        assert [k for k, gap in enumerate(gaps) if gap > 0] == [row % 15]


def test_ordinary_scenes_leave_nothing_open() -> None:
    a, b = family("ordinary scene", 50_000)
    assert (verdicts(a, b) != Verdict.TOUCHING).all()


@each("case", SHARED_PAIRS)
def test_shared_pairs(case: dict[str, Any]) -> None:
    """Pairs from public bug reports and test suites; the axes are listed row by row."""
    given = [
        (np.array(box["center"]), np.array(box["axes"]).T, np.array(box["half_extents"]))
        for box in (case["a"], case["b"])
    ]
    if case["family"] == "nonorthonormal":
        with pytest.raises(ValueError, match="rotations"):
            [Boxes(c[None], r[None], h[None]) for c, r, h in given]
        return
    a, b = (Boxes(c[None], r[None], h[None]) for c, r, h in given)
    check_against_truth(a, b)
    truth = oracle.verdict(row_of(a, 0), row_of(b, 0))
    kept = all(
        np.array_equal(box.rotations[0], r) for box, (_, r, _) in zip((a, b), given, strict=True)
    )
    # A label speaks about the doubles as given; made orthonormal, a pair moves by a rounding.
    clear = abs(oracle.ExactPair(row_of(a, 0), row_of(b, 0)).relative_separation()) > 1e-12
    if kept or clear:
        assert truth == LABELS[case["expected"]]


# --- sweeps: nothing flickers while two boxes turn from nearly parallel to parallel -------------

SWEEP = 10.0 ** -np.linspace(3.0, 17.0, 43)


@each("axis", range(3))
@each("other", range(3))
@each("gap", [0.0, -0.3, *np.outer([1, -1], [1e-15, 1e-13, 1e-10, 1e-7, 1e-2]).ravel()])
def test_no_flicker_in_a_sweep_of_angles(axis: int, other: int, gap: float) -> None:
    """Turning about the normal of the contact leaves the gap, about an edge it moves it."""
    half = np.array([0.5, 0.375, 0.25])
    offset = np.full(3, 0.03125)
    contact = (axis + other) % 3
    offset[contact] = 2.0 * half[contact] + gap
    n = len(SWEEP)
    a = Boxes(np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), np.tile(half, (n, 1)))
    turned = turns(np.tile(np.eye(3)[axis], (n, 1)), SWEEP)
    b = Boxes(np.tile(offset, (n, 1)), turned, a.half_extents)
    check_against_truth(a, b)
    if other == 0 and abs(gap) >= 1e-13:
        assert len(set(verdicts(a, b).tolist())) == 1


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


def check_same(first: Pair, second: Pair, factor: float = 1.0, sign: float = 1.0) -> None:
    """Verdicts, gaps and axes agree bit for bit, gaps times a power of two, axes times a sign.

    Not in sign where the centres agree along them to a rounding: there the sign says nothing.
    """
    np.testing.assert_array_equal(verdicts(*first), verdicts(*second))
    few, same_few = ((a[SOME], b[SOME]) for a, b in (first, second))
    np.testing.assert_array_equal(verdicts(*few, exact=True), verdicts(*same_few, exact=True))
    gaps, axes = witnesses(*first)
    other_gaps, other_axes = witnesses(*second)
    np.testing.assert_array_equal(gaps * factor, other_gaps)
    np.testing.assert_array_equal(np.abs(axes), np.abs(other_axes))
    offset = first[1].centers - first[0].centers
    along = np.abs(np.einsum("ni,ni->n", axes, offset))
    signed = along > 1e-15 * np.abs(offset).sum(axis=1)
    np.testing.assert_array_equal(axes[signed], sign * other_axes[signed])


@settings(max_examples=40)
@given(names, seeds)
def test_swapping_the_boxes_reverses_the_axis(name: str, seed: int) -> None:
    a, b = cached_family(name, ROWS, seed)
    check_same((a, b), (b, a), sign=-1.0)


def relabelled(boxes: Boxes, how: Relabelling) -> Boxes:
    order, signs = list(how[0]), np.array(how[1])
    return Boxes(boxes.centers, boxes.rotations[:, :, order] * signs, boxes.half_extents[:, order])


@settings(max_examples=50)
@given(names, seeds, relabellings, relabellings)
def test_relabelling_and_flipping_axes_changes_nothing(
    name: str, seed: int, how_a: Relabelling, how_b: Relabelling
) -> None:
    a, b = cached_family(name, ROWS, seed)
    check_same((a, b), (relabelled(a, how_a), relabelled(b, how_b)))


@settings(max_examples=40)
@given(names.filter(lambda name: not name.startswith("sizes")), seeds, st.integers(-400, 400))
def test_scaling_by_a_power_of_two_scales_the_gap(name: str, seed: int, power: int) -> None:
    pair, factor = cached_family(name, ROWS, seed), 2.0**power
    a, b = (Boxes(x.centers * factor, x.rotations, x.half_extents * factor) for x in pair)
    check_same(pair, (a, b), factor)


@settings(max_examples=40)
@given(names, seeds, st.lists(st.integers(-(2**40), 2**40), min_size=3, max_size=3))
def test_moving_both_by_the_same_offset_changes_nothing(
    name: str, seed: int, offset: list[int]
) -> None:
    """Centres on a grid of 2^-10 m, so that the moved ones are representable."""
    move, sides = np.array(offset) / 1024.0, []
    for boxes in cached_family(name, ROWS, seed):
        centers = np.clip(np.round(boxes.centers * 1024.0), -(2**40), 2**40) / 1024.0
        np.testing.assert_array_equal(centers + move - move, centers)
        places = centers, centers + move
        sides.append([Boxes(place, boxes.rotations, boxes.half_extents) for place in places])
    (a, c), (b, d) = sides
    check_same((a, b), (c, d))


@each("name", FAMILIES)
def test_the_two_stages_never_contradict_each_other(name: str) -> None:
    """What the fast stage decides, the careful one decides too: hence the symmetries hold."""
    a, b = cached_family(name, 500, 0)
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
    """Also those of blocks, one more, one fewer, and of each pair alone."""
    a, b = cached_family(name, 2 * PAIR_BLOCK + 1, 0)
    whole = verdicts(a, b)
    for size in (1, 7, PAIR_BLOCK - 1, PAIR_BLOCK, PAIR_BLOCK + 1):
        starts = range(0, len(a), size)
        parts = [verdicts(a[k : k + size], b[k : k + size]) for k in starts]
        np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_any_number_of_threads_gives_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("FEWEST_VERDICTS", "FEWEST_WITNESSES"):
        monkeypatch.setattr(verdict_module, name, 10)
    a, b = family("ordinary scene", 500)

    def ask() -> tuple[bytes, ...]:
        found = oc.separations(a, b)
        assert (found.verdicts == verdicts(a, b)).all()
        columns = found.verdicts, found.separations, found.normals, found.positions
        return tuple(column.tobytes() for column in columns)

    assert len(set(by_threads(ask, 1, 2, 3, 5))) == 1


def test_several_threads_at_once_agree_with_one() -> None:
    jobs = [cached_family(name, ROWS, seed) for name in FAMILIES for seed in range(4)]

    def answer(job: Pair) -> list[np.ndarray]:
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
    rows, file = 6, tmp_path / "interpreted.npz"
    more = {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    run_python("-c", WITHOUT_JIT, str(file), str(rows), *FAMILIES, **more)
    interpreted = np.load(file)
    for k, name in enumerate(FAMILIES):
        a, b = family(name, rows)
        np.testing.assert_array_equal(verdicts(a, b), interpreted[f"verdicts{k}"])
        gaps, axes = witnesses(a, b)
        np.testing.assert_array_equal(gaps, interpreted[f"gaps{k}"])
        np.testing.assert_array_equal(axes, interpreted[f"axes{k}"])


#: Promised accuracy of gap and depth, relative to the sum of all half extents.
DEPTH_ACCURACY = 1e-12
#: A unit vector of doubles is this close to length 1.
UNIT_ACCURACY = 1e-15


@each("name", FAMILIES)
def test_axis_of_separate_pairs_proves_it(name: str, pairs: int) -> None:
    """All of a lies on one side of a plane normal to the axis, all of b beyond: exactly."""
    a, b = family(name, max(pairs // 15, 50))
    _, axes = witnesses(a, b)
    for row in np.flatnonzero(verdicts(a, b) == Verdict.SEPARATE):
        assert oracle.gap_along(row_of(a, row), row_of(b, row), axes[row]) > 0


@each("name", FAMILIES)
def test_gap_is_the_largest_and_depth_the_least_over_15_axes(name: str, pairs: int) -> None:
    a, b = family(name, max(pairs // 3, 100))
    gaps, axes = witnesses(a, b)
    truth = oracle.separations(stored(a), stored(b))
    scale = np.maximum(sizes(a, b), np.abs(truth))
    assert (np.abs(gaps - truth) <= DEPTH_ACCURACY * scale).all()
    assert np.isfinite(axes).all()
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, rtol=0, atol=UNIT_ACCURACY)
    verdict = verdicts(a, b)
    assert (gaps[verdict == Verdict.SEPARATE] > 0.0).all()
    assert (gaps[verdict == Verdict.OVERLAP] < 0.0).all()


@each("name", FAMILIES)
def test_moving_by_the_depth_ends_the_overlap(name: str) -> None:
    """The axis points from a to b: b pushed along it by the depth, and a little, is free."""
    a, b = family(name, 200)
    rows = np.flatnonzero(verdicts(a, b) == Verdict.OVERLAP)
    a, b = a[rows], b[rows]
    gaps, axes = witnesses(a, b)
    coordinates = np.abs(b.centers).max(axis=1) + np.abs(a.centers).max(axis=1)
    little = 1e-9 * sizes(a, b) + 8.0 * np.finfo(float).eps * coordinates
    free = Boxes(b.centers + (little - gaps)[:, None] * axes, b.rotations, b.half_extents)
    assert (verdicts(a, free) == Verdict.SEPARATE).all()
    kept = Boxes(b.centers - (little + gaps)[:, None] * axes, b.rotations, b.half_extents)
    assert (verdicts(a, kept)[-gaps > 2.0 * little] == Verdict.OVERLAP).all()


def with_equal_axes(rotations: Floats) -> Pair:
    """Return pairs of boxes that have the same axes, and many equal gaps."""
    rng, count = np.random.default_rng(3), len(rotations)
    centers = rng.integers(-3, 4, (2, count, 3)) * 0.5
    extents = rng.integers(0, 3, (2, count, 3)) * 0.5
    a, b = (Boxes(c, rotations, h) for c, h in zip(centers, extents, strict=True))
    return a, b


@each("name", [*FAMILIES, "aligned", "turned alike"])
def test_the_witness_is_that_of_all_15_axes(name: str) -> None:
    """Those left out by a rough look could not have won; of equal axes only three are tried."""
    if name == "aligned":
        a, b = with_equal_axes(np.tile(np.eye(3), (100, 1, 1)))
    elif name == "turned alike":
        a, b = with_equal_axes(random_rotations(np.random.default_rng(3), 100))
    else:
        a, b = cached_family(name, 100, 0)
    for row in range(len(a)):
        boxes = box_of(*row_of(a, row)), box_of(*row_of(b, row))
        (gap, axis, number), _ = box_witness(*boxes)
        every = [careful_gap(*boxes, k) for k in range(AXIS_COUNT)]
        _, most = gap_bounds(*pair_of(*boxes))
        assert gap == max(found[0] for found in every) == every[number][0]
        assert all(found[0] <= bound for found, bound in zip(every, sum(most, ()), strict=True))
        if name in FAMILIES:
            assert every[number][1] == axis
        else:
            assert number == int(np.argmax([one for one, _ in every]))
            assert axis in [n for one, n in every if one == gap]


@given(st.sampled_from(sorted(FAMILIES)), st.integers(0, 39))
def test_single_boxes_answer_as_batches_do(name: str, row: int) -> None:
    a, b = cached_family(name, 40)
    one, other = OBB(*row_of(a, row)), OBB(*row_of(b, row))
    gaps, axes = witnesses(a, b)
    result = one.separation(other)
    assert result.gap == gaps[row]
    np.testing.assert_array_equal(result.axis, axes[row])
    assert result.verdict == verdicts(a, b)[row]
    assert one.intersects(other) == (result.verdict != Verdict.SEPARATE)
    exact = verdicts(a, b, exact=True)[row] != Verdict.SEPARATE
    assert one.intersects(other, exact=True) == exact

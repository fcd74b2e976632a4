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

"""Verdicts: exact, certified, the same alone and in blocks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import oracle
import pytest
from any_doubles import extents, quaternions, vectors
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from support import chunks, family, loosened, row_of, stored, witnesses

from obb_collision import Boxes, Verdict, verdicts
from tools.cases.families import FAMILIES

#: Promised width of what doubles leave undecided, relative to the sum of all half extents.
UNDECIDED_WIDTH = 1e-14

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
    widest = max(check_against_truth(a, b) for a, b in chunks(name, pairs))
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
@given(vectors, quaternions, extents, st.one_of(vectors, st.none()), quaternions, extents)
def test_any_doubles_at_all(
    center: Any, one: Any, half: Any, offset: Any, other: Any, other_half: Any
) -> None:
    """Whatever is accepted is answered rightly, from subnormal to 1e300, equal centres too."""
    a = Boxes.from_poses([(*center, *one)], [half])
    b = Boxes.from_poses([(*(offset or center), *other)], [other_half])
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


def turned_about(axis: int, angles: np.ndarray) -> np.ndarray:
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotations = np.tile(np.eye(3), (len(angles), 1, 1))
    rotations[:, i, i] = rotations[:, j, j] = np.cos(angles)
    rotations[:, j, i] = np.sin(angles)
    rotations[:, i, j] = -np.sin(angles)
    return rotations


def sweep(offset: np.ndarray, axis: int, half: np.ndarray) -> tuple[Boxes, Boxes]:
    n = len(SWEEP)
    a = Boxes(np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), np.tile(half, (n, 1)))
    b = Boxes(np.tile(offset, (n, 1)), turned_about(axis, SWEEP), np.tile(half, (n, 1)))
    return a, b


@each("axis", range(3))
@each("other", range(3))
@each("gap", [0.0, -0.3, *np.outer([1, -1], [1e-15, 1e-13, 1e-10, 1e-7, 1e-2]).ravel()])
def test_no_flicker_in_a_sweep_of_angles(axis: int, other: int, gap: float) -> None:
    """Turning about the normal of the contact leaves the gap, about an edge it moves it."""
    half = np.array([0.5, 0.375, 0.25])
    offset = np.full(3, 0.03125)
    contact = (axis + other) % 3
    offset[contact] = 2.0 * half[contact] + gap
    a, b = sweep(offset, axis, half)
    check_against_truth(a, b)
    if other == 0 and abs(gap) >= 1e-13:
        assert len(set(verdicts(a, b).tolist())) == 1

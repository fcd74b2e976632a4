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

"""Triangle against triangle: certified verdicts are never wrong, exact ones always right."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from triangle_oracle import triangle_verdict
from triangle_pairs import FAMILIES, Maker, Pair, coplanar, extreme_sizes

from obb_collision import Verdict
from obb_collision.queries.meshes.triangles import triangle_verdicts

PAIRS = 120


def _pairs(maker: Maker, count: int) -> Pair:
    rng = np.random.default_rng(FAMILIES.index(maker))
    made = [maker(rng) for _ in range(count)]
    return np.array([a for a, _ in made]), np.array([b for _, b in made])


@each("maker", FAMILIES)
def test_against_exact_linear_programming(maker: Maker) -> None:
    a, b = _pairs(maker, PAIRS)
    truth = np.array([triangle_verdict(x, y) for x, y in zip(a, b, strict=True)])
    certified = triangle_verdicts(a, b)
    decided = certified != Verdict.TOUCHING
    assert (certified[decided] == truth[decided]).all()
    assert (triangle_verdicts(a, b, exact=True) == truth).all()


@each("maker", FAMILIES)
def test_exact_verdicts_keep_the_symmetries(maker: Maker) -> None:
    a, b = _pairs(maker, 300)
    verdicts = triangle_verdicts(a, b, exact=True)
    assert (triangle_verdicts(b, a, exact=True) == verdicts).all()
    assert (triangle_verdicts(a[:, [2, 0, 1]], b[:, [1, 0, 2]], exact=True) == verdicts).all()
    if maker is not extreme_sizes:
        assert (triangle_verdicts(a * 0.25, b * 0.25, exact=True) == verdicts).all()


def test_ordinary_pairs_are_all_decided() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 20_000, 3, 3))
    assert (triangle_verdicts(a, b) != Verdict.TOUCHING).all()


def test_apart_in_one_plane_is_separate_without_integers() -> None:
    a, b = _pairs(coplanar, 2000)
    certified, truth = triangle_verdicts(a, b), triangle_verdicts(a, b, exact=True)
    assert (certified == truth).all()
    assert set(truth.tolist()) == {Verdict.SEPARATE, Verdict.TOUCHING}


def test_a_gap_below_rounding_is_seen() -> None:
    """Twice the digits: 1e-25 between parallel faces, edges and corners is SEPARATE."""
    face = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    above = face + np.array([0.0, 0.0, 1e-25])
    beside = np.array([[1.0, 1e-25, 0.0], [2.0, 0.0, 1.0], [2.0, 1.0, -1.0]])
    assert (triangle_verdicts([face, face], [above, beside]) == Verdict.SEPARATE).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused(bad: float) -> None:
    a = np.zeros((2, 3, 3))
    a[1, 0, 0] = bad
    with pytest.raises(ValueError, match="row 1"):
        triangle_verdicts(a, np.zeros((2, 3, 3)))


def test_lengths_must_agree() -> None:
    with pytest.raises(ValueError, match="same length"):
        triangle_verdicts(np.zeros((2, 3, 3)), np.zeros((3, 3, 3)))

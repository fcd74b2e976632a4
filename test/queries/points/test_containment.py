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

"""Points in boxes against exact arithmetic; clouds of millions; the surface belongs to the box."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st
from membership import holds
from support import family, row_of

from obb_collision import OBB
from tools.cases.families import FAMILIES

#: A point this near to the surface, relative to the size, may count as inside by default.
DOUBT = 1e-14


def points_near(obb: OBB, rng: np.random.Generator, n: int) -> np.ndarray:
    """Points on, just in and just out of the surface, corners among them, in equal shares."""
    places = rng.uniform(-1.0, 1.0, (n, 3))
    face = rng.integers(0, 3, n)
    places[np.arange(n), face] = rng.choice([-1.0, 1.0], n)
    places[: n // 4] = rng.choice([-1.0, 1.0], (n // 4, 3))
    places[n // 2 :] *= 1.0 + rng.choice([-1.0, 1.0], (n - n // 2, 1)) * 10.0 ** rng.uniform(
        -16.0, -1.0, (n - n // 2, 1)
    )
    points: np.ndarray = obb.center + (places * obb.half_extents) @ obb.rotation.T
    return points


@each("name", FAMILIES)
def test_points_near_the_surface(name: str) -> None:
    rng = np.random.default_rng(5)
    a, _ = family(name, 25)
    for row in range(len(a)):
        obb = OBB(*row_of(a, row))
        points = points_near(obb, rng, 40)
        truth = [holds(row_of(a, row), point[None]) for point in points]
        np.testing.assert_array_equal(obb.contains(points, exact=True), truth)
        default = np.asarray(obb.contains(points))
        assert default[truth].all(), "a point of the box may never be called outside"
        grown = (obb.center, obb.rotation, obb.half_extents + grown_by(obb))
        for point in points[default & ~np.array(truth)]:
            assert holds(grown, point[None])


def grown_by(obb: OBB) -> float:
    return float(DOUBT * obb.half_extents.sum())


def test_a_million_points_at_once() -> None:
    rng = np.random.default_rng(6)
    a, _ = family("ordinary scene", 1)
    obb = OBB(*row_of(a, 0))
    points = obb.center + rng.uniform(-1.5, 1.5, (1_000_000, 3)) * obb.half_extents.max()
    inside = np.asarray(obb.contains(points))
    assert inside.shape == (1_000_000,)
    assert inside.dtype == np.bool_
    local = np.abs((points - obb.center) @ obb.rotation) - obb.half_extents
    clear = np.abs(local).min(axis=1) > 1e-12
    np.testing.assert_array_equal(inside[clear], (local <= 0.0).all(axis=1)[clear])
    for k in rng.integers(0, len(points), 300):
        assert inside[k] == holds(row_of(a, 0), points[k : k + 1])


@given(st.sampled_from(sorted(FAMILIES)), st.integers(0, 49), st.integers(0, 2**32 - 1))
def test_one_point_is_answered_as_in_a_cloud(name: str, row: int, seed: int) -> None:
    a, _ = family(name, 50)
    obb = OBB(*row_of(a, row))
    points = points_near(obb, np.random.default_rng(seed), 8)
    for exact in (False, True):
        cloud = np.asarray(obb.contains(points, exact=exact))
        for k, point in enumerate(points):
            single = obb.contains(point, exact=exact)
            assert isinstance(single, bool)
            assert single == cloud[k]


def test_surface_belongs_to_the_box() -> None:
    box = OBB([1.0, 2.0, 3.0], np.eye(3), [0.5, 0.25, 0.0])
    assert np.all(box.contains(box.corners()))
    assert np.all(box.contains(box.corners(), exact=True))
    assert box.contains(box.center, exact=True)
    assert not box.contains([1.5000000000000002, 2.0, 3.0], exact=True)
    assert not box.contains([1.0, 2.0, 3.0000000000000004], exact=True)


def test_empty_cloud() -> None:
    assert np.shape(OBB().contains(np.empty((0, 3)))) == (0,)


def test_nan_is_no_point() -> None:
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match=r"points.*row 1"):
            OBB().contains([[0.0, 0.0, 0.0], [bad, 0.0, 0.0]])
        with pytest.raises(ValueError, match="points"):
            OBB().contains([bad, 0.0, 0.0])

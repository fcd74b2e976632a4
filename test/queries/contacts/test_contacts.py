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

"""Contacts: the exact least penetration, and points in both boxes."""

from __future__ import annotations

import membership
import numpy as np
import oracle
import pytest
from contact_pairs import between, colliding
from each import each
from hypothesis import given
from hypothesis import strategies as st
from one_set import contacts
from support import family, row_of, sizes, stored

from obb_collision import Boxes, Verdict, verdicts
from obb_collision.queries.contacts.patch import FEATURE_TIE, KEEP
from tools.cases.families import FAMILIES
from tools.cases.placement import random_rotations

#: Promised accuracy of depth and normal, and of points, relative to the sum of half extents.
DEPTH_ACCURACY = 1e-12
POINT_ACCURACY = 1e-9


def test_depth_and_normal_are_the_exact_least_penetration(pairs: int) -> None:
    """Exactly projected, the boxes overlap along the normal by the least depth of 15 axes."""
    a, b = colliding("ordinary scene", pairs)
    found = between(a, b)
    truth = -oracle.separations(stored(a), stored(b))
    size = sizes(a, b)
    assert (np.abs(found.depths - truth) <= DEPTH_ACCURACY * size).all()
    for row, normal in enumerate(found.normals):
        along = -float(oracle.gap_along(row_of(a, row), row_of(b, row), normal))
        assert abs(along - truth[row]) <= DEPTH_ACCURACY * size[row]
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, rtol=0, atol=1e-15)


@each("axis", range(15))
def test_each_of_the_15_axes_in_both_orders(axis: int) -> None:
    a, b = family("each of the 15 axes alone", 15 * 20)
    rows = np.arange(axis + 15, len(a), 30)  # odd laps overlap
    a, b = a[rows], b[rows]
    found, swapped = between(a, b), between(b, a)
    truth = -oracle.separations(stored(a), stored(b))
    mirrored = (axis + 3) % 6 if axis < 6 else 6 + 3 * ((axis - 6) % 3) + (axis - 6) // 3
    size = sizes(a, b)[:, None]
    assert (found.axes == axis).all()
    assert (swapped.axes == mirrored).all()
    assert (found.counts == 1).all()
    assert (swapped.counts == 1).all()
    assert (np.abs(found.depths - truth) <= DEPTH_ACCURACY * size[:, 0]).all()
    np.testing.assert_array_equal(found.normals, -swapped.normals)
    assert (np.abs(found.positions[:, 0] - swapped.positions[:, 0]) <= 1e-12 * size).all()
    # halfway between the surfaces: half the depth along the normal ends in each of them
    for box, side in ((a, 0.5), (b, -0.5)):
        surface = found.positions[:, 0] + side * found.depths[:, None] * found.normals
        local = np.einsum("nk,nki->ni", surface - box.centers, box.rotations)
        assert (np.abs((np.abs(local) - box.half_extents).max(axis=1)) <= 1e-12 * size[:, 0]).all()


@each("limit", [4, 8])
@each("name", FAMILIES)
def test_points_lie_in_both_boxes(name: str, limit: int, pairs: int) -> None:
    a, b = colliding(name, pairs // 15)
    found = between(a, b, limit)
    for row, count in enumerate(found.counts):
        # what doubles can't express at these coordinates is not asked for
        grain = 4.0 * np.spacing(np.abs(found.positions[row, :count]).max())
        allowed = POINT_ACCURACY * float(sizes(a, b)[row]) + grain
        points = [membership.fractions(point) for point in found.positions[row, :count]]
        for box in (row_of(a, row), row_of(b, row)):
            assert max(membership.outside(box, points)) <= allowed


@each("limit", [4, 8])
@each("name", FAMILIES)
def test_every_colliding_pair_has_points_and_no_other(name: str, limit: int) -> None:
    a, b = family(name, 1000)
    found = between(a, b, limit)
    hit = verdicts(a, b) != Verdict.SEPARATE
    assert ((found.counts >= 1) == hit).all()
    assert found.counts.max() <= limit
    used = np.arange(limit) < found.counts[:, None]
    for column in (found.position_depths, found.positions[:, :, 0], found.positions[:, :, 2]):
        np.testing.assert_array_equal(np.isfinite(column), used)
    assert np.isfinite(found.normals).all()
    assert (found.depths >= 0.0).all()
    # the first point has the depth of the pair, none has more
    depths, size = found.position_depths[hit], sizes(a, b)[hit]
    assert (np.abs(depths[:, 0] - found.depths[hit]) <= 2.0 * FEATURE_TIE * size).all()
    assert (np.nanmax(depths, axis=1) <= found.depths[hit] + DEPTH_ACCURACY * size).all()
    assert (depths[used[hit]] >= 0.0).all()
    assert (depths[:, 0] >= np.nanmax(depths, axis=1) - 1.001 * FEATURE_TIE * size).all()
    # none is there twice
    apart = np.linalg.norm(found.positions[:, :, None] - found.positions[:, None], axis=3)
    apart[:, np.arange(limit), np.arange(limit)] = np.inf
    grain = 4.0 * np.spacing(np.nanmax(np.abs(found.positions[hit]), axis=(1, 2)))
    assert (np.nanmin(apart[hit], axis=(1, 2)) >= 0.5 * FEATURE_TIE * size - grain).all()


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e-9, 1e-3, 1.0]))
def test_deep_flat_and_needle_boxes_have_points_too(seed: int, thin: float) -> None:
    rng = np.random.default_rng(seed)
    half = rng.uniform(0.1, 1.0, (2, 20, 3)) * rng.choice([1.0, thin], (2, 20, 3))
    centers = rng.uniform(-0.1, 0.1, (2, 20, 3)) * rng.choice([0.0, 1.0, 10.0], (2, 20, 1))
    a, b = (Boxes(centers[k], random_rotations(rng, 20), half[k]) for k in range(2))
    found = between(a, b, 8)
    assert ((found.counts > 0) == (verdicts(a, b) != Verdict.SEPARATE)).all()
    for box in (a, b):
        local = np.einsum("nlk,nki->nli", found.positions - box.centers[:, None], box.rotations)
        outside = (np.abs(local) - box.half_extents[:, None]).max(axis=2)
        allowed = POINT_ACCURACY * np.maximum(sizes(a, b), 1e-6)[:, None]
        assert not (outside > allowed).any()  # NaN past the count


def test_bad_input_is_refused_by_name() -> None:
    boxes = Boxes(np.zeros((2, 3)), [np.eye(3)] * 2, np.ones((2, 3)))
    with pytest.raises(ValueError, match="max_points must be 4 or 8, got 5"):
        contacts(boxes, [[0, 1]], 5)
    with pytest.raises(ValueError, match=r"pairs must be rows of 2 and 2, got \[0, 2\] in row 1"):
        contacts(boxes, [[0, 1], [0, 2]])
    with pytest.raises(ValueError, match=r"pairs must have shape \(m, 2\)"):
        contacts(boxes, [0, 1])
    with pytest.raises(ValueError, match="pairs must be whole numbers"):
        contacts(boxes, [[0.0, 1.0]])
    assert len(contacts(boxes, []).counts) == 0
    assert KEEP < POINT_ACCURACY

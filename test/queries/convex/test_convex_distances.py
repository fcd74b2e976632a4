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

"""Distances of convex bodies: never too long, and attained by points of both."""

from __future__ import annotations

from itertools import combinations_with_replacement

import hull_distances
import numpy as np
import pytest
from beyond_bodies import beyond
from convex_bodies import FAMILIES, KINDS, Pair, corners_of, family, hulls
from convex_planes import exact_gap
from each import each

from obb_collision.queries.convex.distances import ConvexDistances, convex_distances
from obb_collision.queries.convex.support import CORNERS, ConvexBodies
from obb_collision.typing import Floats

KIND_PAIRS = list(combinations_with_replacement(KINDS, 2))
POLYTOPES = list(combinations_with_replacement(("hull", "box", "capsule"), 2))
#: Promised: how close the bounds are, relative to the size or the distance of a pair.
CLOSE = 1e-9


def found_of(pair: Pair) -> ConvexDistances:
    rows = np.arange(len(pair[0]))
    return convex_distances(*pair, rows, rows)[0]


def reach(body: ConvexBodies) -> Floats:
    corners = np.array([body.hulls.radii[row] for row in body.rows])
    sizes = np.abs(body.sizes).sum(axis=1)
    return np.where(body.kinds == CORNERS, corners, sizes) + body.radii


@pytest.mark.parametrize("name", FAMILIES)
@each("kinds", POLYTOPES)
def test_distances_of_polytopes_are_those_of_fractions(
    name: str, kinds: tuple[str, str], pairs: int
) -> None:
    a, b = family(name, kinds, max(6, pairs // 1000), 1)
    found = found_of((a, b))
    for n in range(len(a)):
        sides = [
            hull_distances.placed(corners_of(x, n), x.centers[n], x.rotations[n]) for x in (a, b)
        ]
        square = hull_distances.squared_distance(*sides)
        radius = float(a.radii[n] + b.radii[n])
        truth = hull_distances.root(square)
        assert hull_distances.at_most(found.lower[n], square, radius)
        size = max(truth, float(reach(a)[n] + reach(b)[n]))
        if truth > radius:
            assert found.lower[n] >= truth - radius - CLOSE * size
            assert found.upper[n] <= truth - radius + CLOSE * size + world_rounding((a, b))[n]


def world_rounding(pair: Pair) -> Floats:
    a, b = pair
    return 1e-15 * (np.abs(a.centers).sum(axis=1) + np.abs(b.centers).sum(axis=1))


@pytest.mark.parametrize("name", FAMILIES)
@each("kinds", KIND_PAIRS)
def test_bounds_are_proved_by_the_normal_and_attained_by_the_points(
    name: str, kinds: tuple[str, str], pairs: int
) -> None:
    pair = family(name, kinds, max(100, pairs // 10), 2)
    found = found_of(pair)
    assert (found.lower <= exact_gap(pair, found.normals)).all()
    size = np.maximum(reach(pair[0]) + reach(pair[1]), found.upper)
    apart = found.lower > 0.0
    width = np.maximum(found.upper, 0.0) - found.lower
    assert (width[apart] <= (CLOSE * size + world_rounding(pair))[apart]).all()
    assert (found.upper[~apart] <= (CLOSE * size + world_rounding(pair))[~apart]).all()
    if name == "random":
        assert apart.any()
        assert not apart.all()
    slack = 1e-13 * size + world_rounding(pair)
    for body, points in zip(pair, (found.positions_a, found.positions_b), strict=True):
        assert (beyond(body, points)[apart] <= slack[apart]).all()


def test_hulls_are_those_of_their_corners() -> None:
    _, corners = hulls(np.ones(3))
    a, _ = family("random", ("hull", "hull"), 5, 0)
    for i in range(5):
        assert set(map(tuple, corners_of(a, i))) == set(map(tuple, corners[a.rows[i]]))

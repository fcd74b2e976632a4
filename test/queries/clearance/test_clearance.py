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

"""Clearance against all features tried in extended precision, and exact certificates."""

from __future__ import annotations

import zlib
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import oracle
import pytest
from any_doubles import extents, quaternions, vectors
from distances import box, root, squared_distance
from each import each
from exact_bodies import outside
from hypothesis import given, settings
from hypothesis import strategies as st
from support import clearances, family, joined, refused, row_of, sizes, stored, witnesses

import obb_collision as oc
from obb_collision import Boxes, Verdict, verdicts
from obb_collision.queries.clearance import Clearances
from tools.cases.families import FAMILIES
from tools.cases.placement import log_uniform, place, random_rotations, turns

#: Where longdouble is no wider than a double (Windows, some ARM) there is no such truth.
EXTENDED = np.finfo(np.longdouble).eps < 1e-18
#: Promised, relative to the sum of all half extents or the distance, whichever is larger.
ACCURACY = 1e-12
Sides = tuple[Boxes, Boxes]

KINDS = (
    "random",
    "parallel faces",
    "parallel edges",
    "vertex against face",
    "edge against edge",
    "nearly touching",
    "nearly parallel",
    "flat",
    "needles",
    "huge, tiny and far",
    "coaxial",
)


def apart(kind: str, n: int) -> Sides:
    """``n`` pairs that are SEPARATE, most of them; gaps from 1e-9 to thrice the size."""
    rng = np.random.default_rng(zlib.crc32(kind.encode()))
    rot_a, rot_b = random_rotations(rng, n), random_rotations(rng, n)
    half_a, half_b = rng.uniform(0.05, 1.0, (2, n, 3))
    index = rng.integers(0, 15, n)
    total = half_a.sum(axis=1) + half_b.sum(axis=1)
    gaps, spread = log_uniform(rng, -6.0, 0.5, n) * total, 3.0
    if kind == "parallel faces":
        rot_b = rot_a @ turns(np.tile([0.0, 0.0, 1.0], (n, 1)), rng.uniform(0.0, 3.0, n))
        index = np.full(n, 2)
    elif kind == "parallel edges":
        rot_b = rot_a @ turns(np.tile([0.0, 0.0, 1.0], (n, 1)), rng.uniform(0.0, 3.0, n))
        index = rng.choice([0, 1, 3, 4], n)
    elif kind == "vertex against face":
        index, spread = rng.integers(0, 6, n), 0.9
    elif kind == "edge against edge":
        index, spread = rng.integers(6, 15, n), 0.9
    elif kind == "nearly touching":
        gaps, spread = 1e-9 * total, 0.999
    elif kind == "nearly parallel":
        rot_b = turns(rng.normal(size=(n, 3)), log_uniform(rng, -17.0, -3.0, n)) @ rot_a
    elif kind == "flat":
        half_a[:, 0] = 0.0
        half_b[np.arange(3) < rng.integers(0, 4, (n, 1))] = 0.0
    elif kind == "needles":
        half_a[:, :2] *= log_uniform(rng, -6.0, -2.0, (n, 2))
        half_b[:, :2] *= log_uniform(rng, -6.0, -2.0, (n, 2))
    elif kind == "huge, tiny and far":
        half_a, half_b = half_a * log_uniform(rng, -9.0, 9.0, (n, 1)), half_b * 1e3
        gaps = gaps + log_uniform(rng, -3.0, 9.0, n)
    elif kind == "coaxial":
        rot_b, index, spread = rot_a, rng.integers(0, 3, n), 0.0
    a, b = place(rng, rot_a, half_a, rot_b, half_b, index=index, gaps=gaps, spread=spread)
    sides = Boxes(*a), Boxes(*b)
    rows = np.flatnonzero(verdicts(*sides) == Verdict.SEPARATE)
    assert len(rows) > 0.8 * n
    return sides[0][rows], sides[1][rows]


def between(a: Boxes, b: Boxes) -> Clearances:
    """Row against row."""
    return clearances(*joined(a, b))


def scale(a: Boxes, b: Boxes, found: Clearances) -> np.ndarray:
    return np.maximum(sizes(a, b), np.abs(found.distances))


@pytest.mark.skipif(not EXTENDED, reason="longdouble is a double here")
@each("kind", KINDS)
def test_distance_is_that_of_all_features_tried(kind: str, pairs: int) -> None:
    """11 kinds of 1,000 pairs as a rule."""
    a, b = apart(kind, max(pairs // 4, 100))
    found = between(a, b)
    error = np.abs(found.distances - distances(stored(a), stored(b))) / scale(a, b, found)
    assert error.max() <= ACCURACY
    print(f"{kind}: {len(a)} pairs, largest error {error.max():.1e} of the size")  # noqa: T201


@pytest.mark.skipif(not EXTENDED, reason="longdouble is a double here")
@each("name", FAMILIES)
def test_hard_families_too(name: str, pairs: int) -> None:
    a, b = family(name, max(pairs // 5, 60), seed=3)
    apart = np.flatnonzero(verdicts(a, b) == Verdict.SEPARATE)
    a, b = a[apart], b[apart]
    found = between(a, b)
    error = np.abs(found.distances - distances(stored(a), stored(b))) / scale(a, b, found)
    assert error.max() <= ACCURACY


@each("kind", sorted(set(KINDS) - {"nearly touching", "nearly parallel"}))
def test_normal_and_points_prove_the_distance(kind: str) -> None:
    """Exact fractions: no points are closer than the gap along the normal, ours hardly farther."""
    a, b = apart(kind, 30)
    found = between(a, b)
    for row in range(len(a)):
        n = found.normals[row]
        gap = oracle.gap_along(row_of(a, row), row_of(b, row), n)
        length = np.sqrt(float(sum(Fraction(x) ** 2 for x in n.tolist())))
        offset = [
            Fraction(y) - Fraction(x)
            for x, y in zip(
                found.positions_a[row].tolist(), found.positions_b[row].tolist(), strict=True
            )
        ]
        upper = np.sqrt(float(sum(x * x for x in offset)))
        coordinates = np.abs([a.centers[row], b.centers[row]]).max()
        allowed = ACCURACY * max(sizes(a, b)[row], coordinates)
        assert upper - float(gap) / length <= allowed
        assert abs(upper - found.distances[row]) <= allowed


@each("kind", KINDS)
def test_distance_is_the_exact_least_square(kind: str) -> None:
    """The convex quadratic programme over both boxes, solved by fractions: too slow for more."""
    a, b = (side[:1] for side in apart(kind, 20))
    found = between(a, b)
    truth = root(squared_distance(box(row_of(a, 0)), box(row_of(b, 0))))
    assert abs(found.distances[0] - truth) <= ACCURACY * scale(a, b, found)[0]


@each("name", FAMILIES)
def test_sign_of_the_distance_is_the_verdict(name: str) -> None:
    a, b = family(name, 1000)
    found, verdict = between(a, b), verdicts(a, b)
    np.testing.assert_array_equal(found.distances > 0.0, verdict == Verdict.SEPARATE)
    np.testing.assert_array_equal(found.distances == 0.0, verdict == Verdict.TOUCHING)
    overlap = verdict == Verdict.OVERLAP
    np.testing.assert_array_equal(found.distances[overlap], witnesses(a, b)[0][overlap])


@each("name", FAMILIES)
def test_points_lie_in_their_boxes_and_differ_by_the_distance(name: str) -> None:
    """Overlapping too: points deepest in the other box, as far apart as the boxes are deep."""
    a, b = family(name, 1000, seed=1)
    found = between(a, b)
    room = scale(a, b, found) + np.abs(a.centers).max(axis=1) + np.abs(b.centers).max(axis=1)
    for side, points in ((a, found.positions_a), (b, found.positions_b)):
        for row in range(0, len(a), 50):
            exact = [[Fraction(x) for x in points[row].tolist()]]
            assert outside(row_of(side, row), exact)[0] <= 1e-15 * room[row]
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, rtol=0.0, atol=1e-15)
    offset = found.positions_b - found.positions_a
    along = (offset * found.normals).sum(axis=1)
    assert (np.abs(along - found.distances) <= ACCURACY * room).all()
    length = np.hypot(np.hypot(offset[:, 0], offset[:, 1]), offset[:, 2])
    assert (np.abs(length - np.abs(found.distances)) <= ACCURACY * room).all()


@each("name", FAMILIES)
def test_swapped_boxes_give_the_same_bits(name: str) -> None:
    a, b = family(name, 500)
    boxes, rows = joined(a, b)
    there, back = clearances(boxes, rows), clearances(boxes, rows[:, ::-1])
    np.testing.assert_array_equal(there.distances, back.distances)
    same = [
        (x == y).reshape(len(a), -1).all(axis=1) for x, y in zip(stored(a), stored(b), strict=True)
    ]
    other = ~np.logical_and.reduce(same)
    np.testing.assert_array_equal(there.positions_a[other], back.positions_b[other])
    np.testing.assert_array_equal(there.positions_b[other], back.positions_a[other])
    np.testing.assert_array_equal(there.normals[other], -back.normals[other])


def test_only_the_offset_counts() -> None:
    a, b = apart("random", 300)
    grid = 2.0**-30
    centers = [np.round(x.centers / grid) * grid for x in (a, b)]
    moved = np.array([2.0**20, -3.0 * 2.0**19, 2.0**18])
    sides = [
        [Boxes(c + by, x.rotations, x.half_extents) for c, x in zip(centers, (a, b), strict=True)]
        for by in (0.0, moved)
    ]
    here, there = between(*sides[0]), between(*sides[1])
    np.testing.assert_array_equal(here.distances, there.distances)
    np.testing.assert_array_equal(here.normals, there.normals)


def test_mirrored_boxes_are_as_far_apart() -> None:
    """Where faces are parallel, also vertices beside edges decide, in every octant."""
    a, b = apart("parallel faces", 5000)
    found = between(a, b)
    for mirror in 1.0 - 2.0 * np.eye(3):
        sides = [
            Boxes(x.centers * mirror, mirror[:, None] * x.rotations * mirror, x.half_extents)
            for x in (a, b)
        ]
        error = np.abs(between(*sides).distances - found.distances)
        assert (error <= ACCURACY * scale(a, b, found)).all()


@each("name", ["ordinary scene", "sizes 1e-160 to 1e155"])
def test_within_a_limit_are_those_no_farther(name: str) -> None:
    boxes, rows = joined(*family(name, 1000))
    every = clearances(boxes, rows)
    for limit in (0.0, float(np.median(np.abs(every.distances))), np.inf):
        found = oc.clearances(boxes, boxes, rows, max_distance=limit)
        kept = np.flatnonzero(every.distances <= limit)
        np.testing.assert_array_equal(found.pairs, rows[kept])
        np.testing.assert_array_equal(found.distances, every.distances[kept])
        np.testing.assert_array_equal(found.positions_a, every.positions_a[kept])
        np.testing.assert_array_equal(found.positions_b, every.positions_b[kept])
        np.testing.assert_array_equal(found.normals, every.normals[kept])


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@settings(max_examples=120)
@given(vectors, quaternions, extents, st.one_of(vectors, st.none()), quaternions, extents)
def test_any_doubles_at_all(
    center: Any, one: Any, half: Any, offset: Any, other: Any, other_half: Any
) -> None:
    a = Boxes.from_poses([(*center, *one)], [half])
    b = Boxes.from_poses([(*(offset or center), *other)], [other_half])
    found = between(a, b)
    for array in (found.distances, found.positions_a, found.positions_b, found.normals):
        assert np.isfinite(array).all()
    np.testing.assert_allclose(np.linalg.norm(found.normals), 1.0, rtol=0.0, atol=1e-15)
    assert np.sign(found.distances[0]) == {0: 1.0, 1: 0.0, 2: -1.0}[int(verdicts(a, b)[0])]


def test_bad_input_is_refused_by_name() -> None:
    boxes, _ = joined(*family("ordinary scene", 2))
    for limit in (-1.0, np.nan):
        refused("max_distance", oc.clearances, boxes, boxes, [(0, 1)], max_distance=limit)


# The distance by trying all features, with nothing of the library: the closest points of two
# disjoint boxes lie on a vertex of one and anywhere on the other, or on two edges. 8 + 8 vertices
# and 144 pairs of edges are tried in ``numpy.longdouble``, in world axes about the centre of a.
Wide = Any  # arrays of longdouble

SIGNS = (-1, 1)


def dot(u: Wide, v: Wide) -> Wide:
    """Row by row."""
    return (u * v).sum(axis=-1)


def distances(a: Any, b: Any) -> Wide:
    """(n,) distances; a and b are (centers, rotations, half extents) of disjoint boxes."""
    (center_a, axes_a, half_a), (center_b, axes_b, half_b) = (
        tuple(np.asarray(part, np.longdouble) for part in box) for box in (a, b)
    )
    offset = center_b - center_a
    one, other = (np.zeros_like(offset), axes_a, half_a), (offset, axes_b, half_b)
    best = np.full(len(offset), np.inf, np.longdouble)
    for signs in product(SIGNS, repeat=3):
        best = np.minimum(best, point_to_box(corner(other, signs), one))
        best = np.minimum(best, point_to_box(corner(one, signs), other))
    for i, j in product(range(3), repeat=2):
        for p, q in product(product(SIGNS, repeat=2), repeat=2):
            start = corner(one, (*p[:i], 0, *p[i:])), corner(other, (*q[:j], 0, *q[j:]))
            edges = (axes_a[:, :, i], half_a[:, i]), (axes_b[:, :, j], half_b[:, j])
            best = np.minimum(best, edge_to_edge(*start, *edges))
    return best


def corner(box: Any, signs: tuple[int, ...]) -> Wide:
    """Return center + sum of signs * half extents * axes: corners, centres of edges (a 0)."""
    center, axes, half = box
    return center + (axes * (half * np.array(signs, np.longdouble))[:, None, :]).sum(axis=2)


def point_to_box(point: Wide, box: Any) -> Wide:
    """Coordinates one after another, again and again: axes are orthonormal to rounding only."""
    center, axes, half = box
    t = np.zeros_like(half)
    rest = point - center
    for _ in range(4):
        for i in range(3):
            axis = axes[:, :, i]
            moved = np.clip(t[:, i] + dot(rest, axis) / dot(axis, axis), -half[:, i], half[:, i])
            rest = rest - (moved - t[:, i])[:, None] * axis
            t[:, i] = moved
    return np.sqrt(dot(rest, rest))


def edge_to_edge(p: Wide, q: Wide, first: Any, second: Any) -> Wide:
    """Where the lines are closest, by Cramer's rule; then the closest point of the second edge."""
    (u, long_u), (v, long_v) = first, second
    between, normal = q - p, np.cross(u, v)
    square = dot(normal, normal)
    crossing = dot(np.cross(between, v), normal) / np.where(square > 0, square, 1)
    s = np.clip(np.where(square > 0, crossing, 0), -long_u, long_u)
    t = np.clip(dot(s[:, None] * u - between, v) / dot(v, v), -long_v, long_v)
    rest = between + t[:, None] * v - s[:, None] * u
    return np.sqrt(dot(rest, rest))

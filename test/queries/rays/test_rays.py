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

"""Rays and segments: never a miss, the nearest hit, and a point of the box; against fractions."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from distances import box, segment, squared_distance
from each import each
from exact_bodies import Box, determinant, fractions, outside
from hypothesis import given, settings
from hypothesis import strategies as st
from support import family, refused, row_of

from obb_collision import Boxes, cast_rays, cast_segments
from obb_collision.queries.rays.rays import RayHits
from tools.cases.families import FAMILIES

#: Hits are right to this, relative to the size of box and ray.
DOUBT = 2.0**-40


def exact_entry(stored: Box, origin: np.ndarray, direction: np.ndarray) -> Fraction | None:
    """Return the least t >= 0 at which origin + t direction is in the box, exactly."""
    center, rotation, half = stored
    a, b, c = (fractions(column) for column in rotation.T)
    volume = determinant(a, b, c)
    middle = fractions(center)
    o = [x - y for x, y in zip(fractions(origin), middle, strict=True)]
    d = fractions(direction)
    enter, leave = Fraction(0), None
    at = (determinant(o, b, c), determinant(a, o, c), determinant(a, b, o))
    way = (determinant(d, b, c), determinant(a, d, c), determinant(a, b, d))
    for h, top, slope in zip(fractions(half), at, way, strict=True):
        y, v = top / volume, slope / volume
        if v == 0:
            if abs(y) > h:
                return None
            continue
        near, far = sorted(((-h - y) / v, (h - y) / v))
        enter = max(enter, near)
        leave = far if leave is None else min(leave, far)
    return enter if leave is None or enter <= leave else None


def aimed(boxes: Boxes, rng: np.random.Generator, each: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays at corners, along edges and faces, from inside, from the surface, and past the box."""
    n = len(boxes)
    reach = boxes.half_extents.sum(axis=1)[:, None, None] + 1e-300
    shares = rng.choice([-1.0, 0.0, 1.0, 0.3, 1.0 + 1e-15, 1.1], (n, each, 3))
    target = shares * boxes.half_extents[:, None]
    way = rng.normal(size=(n, each, 3)) * rng.choice([0.0, 1.0], (n, each, 3), p=[0.3, 0.7])
    way[~way.any(axis=2)] = 1.0, 0.0, 0.0
    way *= reach
    start = target - way * rng.choice([0.0, 0.5, 3.0, 100.0], (n, each, 1))
    origins = boxes.centers[:, None] + np.einsum("nij,nkj->nki", boxes.rotations, start)
    directions = np.einsum("nij,nkj->nki", boxes.rotations, way)
    return origins.reshape(-1, 3), directions.reshape(-1, 3)


def check(boxes: Boxes, origins: np.ndarray, directions: np.ndarray, found: RayHits) -> None:
    for n in range(len(origins)):
        norm = math.hypot(*directions[n])
        entries = [
            exact_entry(row_of(boxes, b), origins[n], directions[n]) for b in range(len(boxes))
        ]
        true = [float(t) * norm for t in entries if t is not None]
        if found.boxes[n] < 0:
            assert not true, "no hit may be missed"
            assert found.distances[n] == np.inf
            assert np.isnan(found.positions[n]).all()
            continue
        b = int(found.boxes[n])
        size = np.abs(origins[n] - boxes.centers[b]).sum() + boxes.half_extents[b].sum()
        if true:
            assert found.distances[n] <= min(true) + DOUBT * size
        unit = [x / Fraction(norm) for x in fractions(directions[n])]
        t = Fraction(float(found.distances[n]))
        point = [x + t * u for x, u in zip(fractions(origins[n]), unit, strict=True)]
        assert outside(row_of(boxes, b), [point])[0] <= DOUBT * size
        if found.normals[n].any():
            assert found.normals[n] @ directions[n] <= DOUBT * norm
            assert np.linalg.norm(found.normals[n]) == pytest.approx(1.0, abs=1e-14)


@each("name", FAMILIES)
def test_rays_aimed_at_one_box(name: str) -> None:
    boxes, _ = family(name, 8)
    rng = np.random.default_rng(1)
    for b in range(len(boxes)):
        one = boxes[np.array([b])]
        origins, directions = aimed(one, rng, 15)
        check(one, origins, directions, cast_rays(one, origins, directions))


@settings(max_examples=50)
@given(st.sampled_from(sorted(FAMILIES)), st.integers(0, 2**32 - 1), st.integers(2, 12))
def test_the_nearest_of_several_boxes(name: str, seed: int, n: int) -> None:
    boxes, _ = family(name, n)
    origins, directions = aimed(boxes, np.random.default_rng(seed), 1)
    check(boxes, origins, directions, cast_rays(boxes, origins, directions))


def test_a_tree_of_many_boxes_changes_nothing() -> None:
    rng = np.random.default_rng(2)
    boxes, _ = family("ordinary scene", 400)
    boxes = Boxes(rng.uniform(-8.0, 8.0, (400, 3)), boxes.rotations, boxes.half_extents)
    origins = rng.uniform(-12.0, 12.0, (500, 3))
    directions = rng.normal(size=(500, 3))
    directions[::5] = np.eye(3)[rng.integers(0, 3, 100)]
    found = cast_rays(boxes, origins, directions)
    assert 0.1 < (found.boxes >= 0).mean() < 0.98
    nearest, rows = np.full(500, np.inf), np.full(500, -1)
    for b in range(len(boxes)):
        alone = cast_rays(boxes[np.array([b])], origins, directions)
        nearer = alone.distances < nearest
        nearest[nearer], rows[nearer] = alone.distances[nearer], b
    np.testing.assert_array_equal(found.boxes, rows)
    np.testing.assert_array_equal(found.distances, nearest)


def test_faces_and_distances() -> None:
    boxes = Boxes([[0, 0, 0], [5, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1], [1, 1, 0]])
    origins = np.array([[-3, 0, 0], [0, 0.5, 9], [0.5, 0, 0], [-3, 2, 0], [9, 1, 0], [5, 0, 4.0]])
    ways = np.array([[2, 0, 0], [0, 0, -3], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, -1.0]])
    found = cast_rays(boxes, origins, ways)
    assert found.boxes.tolist() == [0, 0, 0, -1, 1, 1]
    assert found.distances.tolist() == [2, 8, 0, np.inf, 3, 4]
    normals = [[-1, 0, 0], [0, 0, 1], [0, 0, 0], [1, 0, 0], [0, 0, 1]]
    assert found.normals[found.boxes >= 0].tolist() == normals
    assert found.positions[0].tolist() == [-1, 0, 0]
    near = cast_rays(boxes, origins, ways, [2.0, 7.9, 0.0, 9.0, 2.5, 9.0])
    assert near.boxes.tolist() == [0, -1, 0, -1, -1, 1]


@each("name", ["ordinary scene", "zero extents", "exact resting contact"])
def test_segments(name: str) -> None:
    boxes, _ = family(name, 15)
    rng = np.random.default_rng(3)
    starts, ways = aimed(boxes, rng, 4)
    ends = starts + ways * rng.choice([0.0, 0.4, 0.5, 1.0, 3.0], (len(starts), 1))
    truth = np.zeros(len(starts), np.bool_)
    for n in range(len(starts)):
        one = boxes[np.array([n // 4])]
        square = squared_distance(segment(starts[n], ends[n]), box(row_of(one, 0)))
        truth[n] = square == 0
        hit = cast_segments(one, starts[n : n + 1], ends[n : n + 1]).hits[0]
        size = np.abs(starts[n] - one.centers[0]).sum() + one.half_extents.sum()
        assert hit or not truth[n], "no hit may be missed"
        assert not hit or square <= Fraction(DOUBT * size) ** 2
    assert 0.1 < truth.mean() < 0.9
    found = cast_segments(boxes, starts, ends)
    hits = found.boxes >= 0
    np.testing.assert_array_equal(cast_segments(boxes, starts, ends).hits, hits)
    lengths = np.linalg.norm(ends - starts, axis=1)
    assert (found.distances[hits] <= lengths[hits] * (1 + 1e-15)).all()
    assert hits[truth].all()


def test_nothing_to_hit() -> None:
    none, one = family("ordinary scene", 0)[0], family("ordinary scene", 1)[0]
    found = cast_rays(none, [[0, 0, 0]], [[1, 0, 0]])
    assert found.boxes.tolist() == [-1]
    assert len(cast_rays(one, np.empty((0, 3)), np.empty((0, 3))).boxes) == 0


def test_bad_input() -> None:
    boxes = family("ordinary scene", 1)[0]
    zeros, ones = np.zeros((2, 3)), np.ones((2, 3))
    for reason, origins, directions, *most in (
        (r"directions must not be zero in row 1", zeros, [[1, 0, 0], [0, 0, 0]]),
        ("same length", zeros, ones[:1]),
        (r"origins must be finite in row 1", [[0, 0, 0], [np.nan, 0, 0]], ones),
        (r"max_distance must not be negative or NaN in row 1", zeros, ones, [1.0, np.nan]),
        ("max_distance must be one number or one for each ray", zeros, ones, [1.0, 2.0, 3.0]),
    ):
        refused(reason, cast_rays, boxes, origins, directions, *most)
    refused("same length", cast_segments, boxes, zeros, ones[:1])

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

"""Points in boxes, rays and segments at them: by exact arithmetic, and each box by itself."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from each import each
from exact_bodies import inside, outside
from exact_vectors import Box, along, corners, determinant, exact, minus
from hull_distances import squared_distance
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support import by_threads, family, refused, row_of

from obb_collision import OBB, Boxes, cast_rays, cast_segments, points_inside
from obb_collision.queries.points import CHUNK, PointsInside, contains
from obb_collision.queries.rays.rays import RayHits
from tools.cases.families import FAMILIES

#: A point this near to the surface, relative to the size, may count as inside by default.
SURFACE_DOUBT = 1e-14


def near(boxes: Boxes, rng: np.random.Generator, each: int) -> np.ndarray:
    """Points in, on and just off the surface of each box, shuffled."""
    n = len(boxes)
    places = rng.uniform(-1.2, 1.2, (n, each, 3))
    faces = rng.random((n, each, 3)) < 0.4
    off = rng.choice([-1.0, 0.0, 1.0], faces.sum()) * 10.0 ** rng.uniform(-16.0, -1.0, faces.sum())
    places[faces] = rng.choice([-1.0, 1.0], faces.sum()) * (1.0 + off)
    offsets = np.einsum("nij,nkj->nki", boxes.rotations, places * boxes.half_extents[:, None])
    points = (boxes.centers[:, None] + offsets).reshape(-1, 3)
    shuffled: np.ndarray = rng.permutation(points)
    return shuffled


@each("name", FAMILIES)
def test_points_near_the_surface(name: str) -> None:
    rng = np.random.default_rng(5)
    a, _ = family(name, 10)
    for row in range(len(a)):
        obb = OBB(*row_of(a, row))
        points = near(a[row : row + 1], rng, 40)
        truth = inside(row_of(a, row), points)
        np.testing.assert_array_equal(obb.contains(points, exact=True), truth)
        default = np.asarray(obb.contains(points))
        assert default[truth].all(), "a point of the box may never be called outside"
        grown = (obb.center, obb.rotation, obb.half_extents + grown_by(obb))
        assert inside(grown, points[default]).all()


def grown_by(obb: OBB) -> float:
    return float(SURFACE_DOUBT * obb.half_extents.sum())


@given(st.sampled_from(sorted(FAMILIES)), st.integers(0, 49), st.integers(0, 2**32 - 1))
def test_one_point_is_answered_as_in_a_cloud(name: str, row: int, seed: int) -> None:
    a, _ = family(name, 50)
    obb = OBB(*row_of(a, row))
    points = near(a[row : row + 1], np.random.default_rng(seed), 8)
    for exactly in (False, True):
        cloud = np.asarray(obb.contains(points, exact=exactly))
        for k, point in enumerate(points):
            single = obb.contains(point, exact=exactly)
            assert isinstance(single, bool)
            assert single == cloud[k]


def test_nan_is_no_point() -> None:
    for bad in (np.nan, np.inf):
        refused(r"points.*row 1", OBB().contains, [[0.0, 0.0, 0.0], [bad, 0.0, 0.0]])
        refused("points", OBB().contains, [bad, 0.0, 0.0])


#: By how much more than the margin a point may be away and still count, relative to its size.
DOUBT = 2.0**-44


def assert_as_each_box_by_itself(boxes: Boxes, points: np.ndarray, found: PointsInside) -> None:
    finite = np.isfinite(points).all(axis=1)
    assert found.ignored == (~finite).sum()
    assert found.boxes is not None
    lowest = np.full(len(points), -1)
    for b in range(len(boxes)):
        inside = np.zeros(len(points), np.bool_)
        inside[finite] = contains(*row_of(boxes, b), points[finite].astype(np.float64))
        lowest[inside & (lowest < 0)] = b
        rows = np.flatnonzero(inside)
        assert found.counts[b] == len(rows)
        if len(rows) == 0:
            assert found.first[b] == found.nearest[b] == -1
            assert found.distances[b] == np.inf
            continue
        assert found.first[b] == rows[0]
        away = points[rows].astype(np.float64) - boxes.centers[b]
        scale = max(float(np.abs(away).max()), 1e-300)
        lengths = np.linalg.norm(away / scale, axis=1) * scale
        nearest = np.flatnonzero(rows == found.nearest[b])
        assert lengths[nearest] <= lengths.min() * (1.0 + 1e-14)
        assert found.distances[b] == pytest.approx(lengths.min(), rel=1e-14)
    np.testing.assert_array_equal(found.boxes, lowest)


@each("name", FAMILIES)
def test_families(name: str) -> None:
    boxes, _ = family(name, 60)
    points = near(boxes, np.random.default_rng(1), 15)
    found = points_inside(boxes, points, each_point=True)
    assert_as_each_box_by_itself(boxes, points, found)


def crowded(kind: str, n: int, rng: np.random.Generator) -> Boxes:
    """Boxes spread as grids like it least."""
    centers = rng.uniform(-2.0, 2.0, (n, 3))
    half = rng.uniform(0.05, 0.5, (n, 3))
    if kind == "all overlap":
        centers, half = 0.05 * centers, half + 1.0
    elif kind == "one huge":
        half[0] = 50.0
    elif kind == "crowd in a hall":
        centers, half = 1e-3 * centers, 1e-3 * half
        half[0] = 5.0
    elif kind == "rods":
        half = np.tile([0.01, 0.01, 5.0], (n, 1))
    elif kind == "far":
        centers = centers + 1e8
    elif kind == "points and plates":
        half *= rng.choice([0.0, 1.0], (n, 3))
    elif kind == "one place":
        centers[:], half[:] = centers[0], half[0]
    elif kind == "in a plane":
        centers[:, 2] = 0.0
        half[:, 2] = 0.0
    rotations = Rotation.random(n, random_state=rng).as_matrix()
    rotations[: n // 2] = np.eye(3)
    return Boxes(centers, rotations, half)


KINDS = [
    "plain", "all overlap", "one huge", "crowd in a hall", "rods", "far", "points and plates",
    "one place", "in a plane",
]  # fmt: skip


@each("kind", KINDS)
@each("dtype", [np.float32, np.float64])
def test_crowds(kind: str, dtype: type) -> None:
    rng = np.random.default_rng(2)
    boxes = crowded(kind, 80, rng)
    low, high = boxes.world_bounds()
    cloud = [near(boxes, rng, 60), rng.uniform(low.min(), high.max(), (3000, 3)), low, high]
    points: np.ndarray = np.concatenate(cloud).astype(dtype)
    points[::97, rng.integers(0, 3)] = rng.choice([np.nan, np.inf, -np.inf])
    found = points_inside(boxes, points, each_point=True)
    assert found.counts.sum() > 0 or kind == "far"
    assert_as_each_box_by_itself(boxes, points, found)


@given(st.sampled_from(KINDS), st.integers(0, 9), st.integers(0, 400), st.integers(0, 2**32 - 1))
def test_few(kind: str, n: int, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = crowded(kind, n, rng) if n else family("ordinary scene", 0)[0]
    points: np.ndarray = rng.uniform(-1.0, 1.0, (count, 3)) * 10.0 ** rng.uniform(-3, 9)
    if n:
        points[: count // 2] = near(boxes, rng, count)[: count // 2]
    assert_as_each_box_by_itself(boxes, points, points_inside(boxes, points, each_point=True))


@each("scale", [1.0, 1e-200, 1e250])
def test_margins(scale: float) -> None:
    rng = np.random.default_rng(3)
    boxes = crowded("points and plates", 12, rng)
    boxes = Boxes(scale * boxes.centers, boxes.rotations, scale * boxes.half_extents)
    margin = 0.25 * scale
    local = rng.uniform(-1.0, 1.0, (12, 2, 3)) * (boxes.half_extents + 1.2 * margin)[:, None]
    on_face = local[:, ::2]  # at the margin from a face, as well as doubles can say
    on_face[..., 0] = boxes.half_extents[:, None, 0] + margin
    points = boxes.centers[:, None] + np.einsum("nij,nkj->nki", boxes.rotations, local)
    points = points.reshape(-1, 3)
    found = points_inside(boxes, points, margin)
    margins = set()
    for b in range(len(boxes)):
        held = 0
        for point in points:
            square = squared_distance([exact(point)], corners(row_of(boxes, b)))
            alone = points_inside(boxes[b : b + 1], point[None], margin).counts[0]
            held += alone
            size = np.abs(point - boxes.centers[b]).sum() + boxes.half_extents[b].sum() + margin
            truth = square <= Fraction(margin) ** 2
            assert alone or not truth, "a point within the margin may never be left out"
            assert not alone or square <= Fraction(margin + DOUBT * size) ** 2
            margins.add((bool(alone), truth))
        assert found.counts[b] == held
    assert {(True, True), (False, False)} <= margins


def same(a: PointsInside, b: PointsInside) -> bool:
    return a.ignored == b.ignored and all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("counts", "first", "nearest", "distances", "boxes")
    )


def test_any_number_of_threads_gives_the_same_bits() -> None:
    rng = np.random.default_rng(4)
    boxes = crowded("plain", 100, rng)
    points = rng.uniform(-2.5, 2.5, (5 * CHUNK + 123, 3))
    points[3 * CHUNK + 7 :] = points[: 2 * CHUNK + 116]  # equally near ones in several parts
    counts = 1, 2, 3, None
    alone, *others = by_threads(lambda: points_inside(boxes, points, each_point=True), *counts)
    assert all(same(other, alone) for other in others)
    for b in np.flatnonzero(alone.counts):
        twice = np.flatnonzero((points == points[alone.nearest[b]]).all(axis=1))
        assert alone.nearest[b] == twice[0]


def test_clouds_are_taken_as_they_come() -> None:
    rng = np.random.default_rng(5)
    boxes = crowded("plain", 30, rng)
    points = rng.uniform(-2.5, 2.5, (2000, 3)).astype(np.float32)
    want = points_inside(boxes, points.astype(np.float64), each_point=True)
    padded = np.zeros(2000, np.dtype({"names": ["xyz"], "formats": ["3f4"], "itemsize": 32}))
    padded["xyz"] = points
    packed = np.zeros(2000, np.dtype([("flag", "u1"), ("xyz", "f4", 3)]))
    packed["xyz"] = points
    read_only = points.copy()
    read_only.setflags(write=False)
    clouds = [
        points, padded["xyz"], packed["xyz"], read_only, np.asfortranarray(points),
        points.astype(">f4"), points.tolist(),
    ]  # fmt: skip
    for cloud in clouds:
        assert same(points_inside(boxes, cloud, each_point=True), want)
    assert_as_each_box_by_itself(boxes, points, want)
    whole = points_inside(boxes, np.array([[0, 0, 0], [1, 1, 1]]))
    assert same(whole, points_inside(boxes, np.array([[0.0, 0, 0], [1, 1, 1]])))


def test_nothing_to_look_at() -> None:
    none, one = family("ordinary scene", 0)[0], family("ordinary scene", 1)[0]
    found = points_inside(none, np.array([[0.0, 0, 0], [np.nan, 0, 0]]), each_point=True)
    assert found.counts.shape == found.distances.shape == (0,)
    assert found.ignored == 1
    assert found.boxes is not None
    assert found.boxes.tolist() == [-1, -1]
    for boxes in (none, one):
        empty = points_inside(boxes, np.empty((0, 3)), each_point=True)
        assert (empty.counts == 0).all()
        assert (empty.first == -1).all()
        assert empty.ignored == 0


def test_bad_input() -> None:
    boxes = family("ordinary scene", 1)[0]
    for points in (np.zeros(3), np.zeros((2, 4)), np.zeros((1, 2, 3))):
        refused("points must have shape", points_inside, boxes, points)
    refused("points must be numbers", points_inside, boxes, [["a", "b", "c"]])
    refused("margin must not be negative", points_inside, boxes, np.zeros((1, 3)), -1.0)
    refused("margin must be finite", points_inside, boxes, np.zeros((1, 3)), np.nan)


#: Hits are right to this, relative to the size of box and ray.
HIT_DOUBT = 2.0**-40


def exact_entry(stored: Box, origin: np.ndarray, direction: np.ndarray) -> Fraction | None:
    """Return the least t >= 0 at which origin + t direction is in the box, exactly."""
    center, rotation, half = stored
    a, b, c = map(exact, rotation.T)
    volume = determinant(a, b, c)
    o, d = minus(exact(origin), exact(center)), exact(direction)
    enter, leave = Fraction(0), None
    at = (determinant(o, b, c), determinant(a, o, c), determinant(a, b, o))
    way = (determinant(d, b, c), determinant(a, d, c), determinant(a, b, d))
    for h, top, slope in zip(exact(half), at, way, strict=True):
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
            assert found.distances[n] <= min(true) + HIT_DOUBT * size
        time = Fraction(found.distances[n]) / Fraction(norm)
        point = along(exact(origins[n]), time, exact(directions[n]))
        assert outside(row_of(boxes, b), [point])[0] <= HIT_DOUBT * size
        if found.normals[n].any():
            assert found.normals[n] @ directions[n] <= HIT_DOUBT * norm
            assert np.linalg.norm(found.normals[n]) == pytest.approx(1.0, abs=1e-14)


@each("name", FAMILIES)
def test_rays_aimed_at_one_box(name: str) -> None:
    boxes, _ = family(name, 8)
    rng = np.random.default_rng(1)
    for b in range(len(boxes)):
        one = boxes[b : b + 1]
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
        alone = cast_rays(boxes[b : b + 1], origins, directions)
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
        square = squared_distance([exact(starts[n]), exact(ends[n])], corners(row_of(one, 0)))
        truth[n] = square == 0
        hit = cast_segments(one, starts[n : n + 1], ends[n : n + 1]).hits[0]
        size = np.abs(starts[n] - one.centers[0]).sum() + one.half_extents.sum()
        assert hit or not truth[n], "no hit may be missed"
        assert not hit or square <= Fraction(HIT_DOUBT * size) ** 2
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


def test_bad_rays_are_refused() -> None:
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

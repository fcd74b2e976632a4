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

"""Clearance of boxes, and capsules, spheres and half-spaces, against exact arithmetic."""

from __future__ import annotations

import zlib
from fractions import Fraction

import numpy as np
import pytest
from each import each
from exact_bodies import outside
from exact_vectors import corners, dot, exact, minus, norm, root
from hull_distances import squared_distance
from hypothesis import given, settings
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from support import any_pairs, family, joined, refused, row_of, sizes, stored, witnesses

import obb_collision as oc
from obb_collision import Boxes, Capsules, HalfSpaces, Verdict, verdicts
from obb_collision.queries.clearance.clearance import Clearances
from tools.cases.families import FAMILIES
from tools.cases.placement import log_uniform, place, random_rotations, turns

#: Promised, relative to the sum of all half extents or the distance, whichever is larger.
ACCURACY = 1e-12
Sides = tuple[Boxes, Boxes]

#: Parallel edges and faces at any angle about them.
PARALLEL = "turned about an axis"


def apart(name: str, n: int) -> Sides:
    """Return pairs that are SEPARATE, of every other one with gaps of 1e-9 to 1e9 of the size."""
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    if name == PARALLEL:
        half, rotations = rng.uniform(0.05, 1.0, (2, n, 3)), random_rotations(rng, n)
        turned = rotations @ turns(np.tile([0.0, 0.0, 1.0], (n, 1)), rng.uniform(0.0, 3.0, n))
        index = rng.integers(0, 6, n)
        a, b = (Boxes(*x) for x in place(rng, rotations, half[0], turned, half[1], index=index))
    else:
        a, b = family(name, n, seed=3)
    depths, axes = witnesses(a, b)
    away = sizes(a, b) * log_uniform(rng, -9.0, 9.0, n) - depths
    away *= rng.integers(0, 2, n)
    b = Boxes(b.centers + away[:, None] * axes, b.rotations, b.half_extents)
    rows = np.flatnonzero(verdicts(a, b) == Verdict.SEPARATE)
    assert len(rows) > 0.4 * n
    return a[rows], b[rows]


def scale(a: Boxes, b: Boxes, found: Clearances) -> np.ndarray:
    return np.maximum(sizes(a, b), np.abs(found.distances))


@each("name", [*FAMILIES, PARALLEL])
def test_distance_is_the_exact_one(name: str, pairs: int) -> None:
    a, b = apart(name, max(pairs // 5, 60))
    found = oc.clearances(a, b)
    sides = ([corners(row_of(side, n)) for n in range(len(side))] for side in (a, b))
    truth = np.array([root(squared_distance(*pair)) for pair in zip(*sides, strict=True)], float)
    error = np.abs(found.distances - truth) / scale(a, b, found)
    assert error.max() <= ACCURACY
    print(f"{name}: {len(a)} pairs, largest error {error.max():.1e} of the size")  # noqa: T201


@each("name", FAMILIES)
def test_sign_of_the_distance_is_the_verdict(name: str) -> None:
    a, b = family(name, 1000)
    found, verdict = oc.clearances(a, b), verdicts(a, b)
    np.testing.assert_array_equal(found.distances > 0.0, verdict == Verdict.SEPARATE)
    np.testing.assert_array_equal(found.distances == 0.0, verdict == Verdict.TOUCHING)
    overlap = verdict == Verdict.OVERLAP
    np.testing.assert_array_equal(found.distances[overlap], witnesses(a, b)[0][overlap])


@each("name", FAMILIES)
def test_points_lie_in_their_boxes_and_differ_by_the_distance(name: str) -> None:
    """Overlapping too: points deepest in the other box, as far apart as the boxes are deep."""
    a, b = family(name, 1000, seed=1)
    found = oc.clearances(a, b)
    room = scale(a, b, found) + np.abs(a.centers).max(axis=1) + np.abs(b.centers).max(axis=1)
    for side, points in ((a, found.positions_a), (b, found.positions_b)):
        for row in range(0, len(a), 50):
            assert outside(row_of(side, row), [exact(points[row])])[0] <= 1e-15 * room[row]
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, rtol=0.0, atol=1e-15)
    offset = found.positions_b - found.positions_a
    along = (offset * found.normals).sum(axis=1)
    assert (np.abs(along - found.distances) <= ACCURACY * room).all()
    length = np.hypot(np.hypot(offset[:, 0], offset[:, 1]), offset[:, 2])
    assert (np.abs(length - np.abs(found.distances)) <= ACCURACY * room).all()


@each("name", FAMILIES)
def test_swapped_boxes_give_the_same_bits(name: str) -> None:
    a, b = family(name, 500)
    there, back = oc.clearances(a, b), oc.clearances(b, a)
    np.testing.assert_array_equal(there.distances, back.distances)
    same = [
        (x == y).reshape(len(a), -1).all(axis=1) for x, y in zip(stored(a), stored(b), strict=True)
    ]
    other = ~np.logical_and.reduce(same)
    np.testing.assert_array_equal(there.positions_a[other], back.positions_b[other])
    np.testing.assert_array_equal(there.positions_b[other], back.positions_a[other])
    np.testing.assert_array_equal(there.normals[other], -back.normals[other])


def test_only_the_offset_counts() -> None:
    a, b = family("ordinary scene", 300)
    grid = 2.0**-30
    centers = [np.round(x.centers / grid) * grid for x in (a, b)]
    moved = np.array([2.0**20, -3.0 * 2.0**19, 2.0**18])
    sides = [
        [Boxes(c + by, x.rotations, x.half_extents) for c, x in zip(centers, (a, b), strict=True)]
        for by in (0.0, moved)
    ]
    here, there = (oc.clearances(one, other) for one, other in sides)
    np.testing.assert_array_equal(here.distances, there.distances)
    np.testing.assert_array_equal(here.normals, there.normals)


def test_mirrored_boxes_are_as_far_apart() -> None:
    """Where faces are parallel, also vertices beside edges decide, in every octant."""
    a, b = apart(PARALLEL, 5000)
    found = oc.clearances(a, b)
    for mirror in 1.0 - 2.0 * np.eye(3):
        one, other = (
            Boxes(x.centers * mirror, mirror[:, None] * x.rotations * mirror, x.half_extents)
            for x in (a, b)
        )
        error = np.abs(oc.clearances(one, other).distances - found.distances)
        assert (error <= ACCURACY * scale(a, b, found)).all()


@each("name", ["ordinary scene", "sizes 1e-160 to 1e155"])
def test_within_a_limit_are_those_no_farther(name: str) -> None:
    boxes, rows = joined(*family(name, 1000))
    every = oc.clearances(boxes, boxes, rows)
    for limit in (0.0, float(np.median(np.abs(every.distances))), np.inf):
        found = oc.clearances(boxes, boxes, rows, max_distance=limit)
        kept = np.flatnonzero(every.distances <= limit)
        np.testing.assert_array_equal(found.pairs, rows[kept])
        for column in ("distances", "positions_a", "positions_b", "normals"):
            np.testing.assert_array_equal(getattr(found, column), getattr(every, column)[kept])


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@settings(max_examples=120)
@given(any_pairs())
def test_any_doubles_at_all(pair: Sides) -> None:
    found = oc.clearances(*pair)
    for array in (found.distances, found.positions_a, found.positions_b, found.normals):
        assert np.isfinite(array).all()
    np.testing.assert_allclose(np.linalg.norm(found.normals), 1.0, rtol=0.0, atol=1e-15)
    assert np.sign(found.distances[0]) == {0: 1.0, 1: 0.0, 2: -1.0}[int(verdicts(*pair)[0])]


SEPARATE, TOUCHING, OVERLAP = Verdict
#: What isn't told from touching is this near to it, relative to the size of the pair.
DOUBT = 2.0**-44
#: Lengths of a scene, and those whose squares leave the range of doubles.
SCALES = (1.0, 1e-170, 1e-30, 1e6, 1e200)


def scene(n: int, seed: int) -> tuple[Boxes, np.ndarray, np.ndarray]:
    """Boxes, plain and flat, and segments of which many lie along edges, on faces, in corners."""
    rng = np.random.default_rng(seed)
    rotations = Rotation.random(n, random_state=rng).as_matrix()
    rotations[: n // 4] = np.eye(3)
    half = rng.uniform(0.1, 1.0, (n, 3)) * rng.choice([0.0, 1e-9, 1.0], (n, 3), p=[0.1, 0.1, 0.8])
    boxes = Boxes(rng.choice([0.0, 1.0, 1e4], (n, 1)) * rng.uniform(-1, 1, (n, 3)), rotations, half)
    local = rng.uniform(-2.5, 2.5, (2, n, 3))
    corner = rng.choice([-1.0, 1.0], (n, 3)) * half
    kind = rng.integers(0, 6, n)
    local[1, kind == 1] = local[0, kind == 1]  # a sphere
    turned = kind == 2  # parallel to a face or an edge, up to rounding
    local[1, turned] = np.where(
        rng.random((n, 3)) < 0.5, local[0], local[1] + rng.choice([0.0, 1e-9], (n, 1))
    )[turned]
    local[0, kind == 3] = 1.7 * corner[kind == 3]  # towards a corner
    local[0, kind == 4] = (corner * rng.choice([1.0, 1.5], (n, 3)))[kind == 4]
    ends = boxes.centers + np.einsum("nij,snj->sni", rotations, local)
    return boxes, ends[0], ends[1]


def near_radii(separations: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Radii that make pairs touch, nearly touch or overlap, given distances without a radius."""
    noise = rng.choice([0.0, 1e-16, 1e-14, 1e-9, 0.3], len(separations))
    factors = 1.0 + noise * rng.choice([-1.0, 1.0], len(separations))
    return np.maximum(separations, 0.0) * factors * (rng.random(len(separations)) < 0.9)


def check(verdict: int, separation: float, square: Fraction, radius: Fraction, size: float) -> None:
    """Hold verdict and separation to the exact squared distance of the cores, and the radii."""
    excess = square - radius * radius
    if verdict == SEPARATE:
        assert excess > 0
    elif verdict == OVERLAP:
        assert excess < 0 or square == 0
    else:
        assert abs(root(square) - float(radius)) <= DOUBT * size
    if square > 0:
        assert abs(separation - (root(square) - float(radius))) <= DOUBT * size
    else:
        assert separation <= DOUBT * size - float(radius)


@each("scale", SCALES)
def test_capsules_against_boxes(scale: float) -> None:
    boxes, p, q = scene(30, 1)
    boxes = Boxes(boxes.centers * scale, boxes.rotations, boxes.half_extents * scale)
    p, q = p * scale, q * scale
    bare = oc.separations(Capsules(p, q, np.zeros(len(p))), boxes).separations
    radii = near_radii(bare, np.random.default_rng(2))
    found = oc.separations(Capsules(p, q, radii), boxes)
    assert set(found.verdicts) == {SEPARATE, TOUCHING, OVERLAP}
    size = np.abs(p - boxes.centers).sum(axis=1) + np.abs(q - boxes.centers).sum(axis=1)
    size += boxes.half_extents.sum(axis=1) + radii
    for n in range(len(boxes)):
        square = squared_distance([exact(p[n]), exact(q[n])], corners(row_of(boxes, n)))
        check(found.verdicts[n], found.separations[n], square, Fraction(radii[n]), size[n])


@each("scale", SCALES)
def test_capsules_against_capsules(scale: float) -> None:
    rng = np.random.default_rng(3)
    n = 300
    ends = rng.uniform(-1.0, 1.0, (4, n, 3)) * scale
    ends[1, :40] = ends[0, :40]  # spheres
    ends[3, 20:60] = ends[2, 20:60]
    way = (ends[1] - ends[0]) * rng.uniform(0.1, 2.0, (n, 1))
    lean = rng.choice([0.0, 1e-16, 1e-12, 1e-8, 1e-4], (n, 1)) * scale
    ends[3, 60:200] = (ends[2] + way + lean * rng.uniform(-1, 1, (n, 3)))[60:200]
    ends[2, 200:220] = 0.5 * ends[0, 200:220] + 0.5 * ends[1, 200:220]  # they cross, or nearly
    bare = oc.separations(
        Capsules(ends[0], ends[1], np.zeros(n)), Capsules(ends[2], ends[3], np.zeros(n))
    )
    share = rng.uniform(0.0, 1.0, n)
    radii = near_radii(bare.separations, rng)
    a = Capsules(ends[0], ends[1], share * radii)
    b = Capsules(ends[2], ends[3], (1.0 - share) * radii)
    found = oc.separations(a, b)
    assert set(found.verdicts) == {SEPARATE, TOUCHING, OVERLAP}
    np.testing.assert_array_equal(found.verdicts, oc.verdicts(b, a))
    for k in range(0, n, 3):
        one, other = ([exact(end[k]) for end in pair] for pair in (ends[:2], ends[2:]))
        square = squared_distance(one, other)
        radius = Fraction(a.radii[k]) + Fraction(b.radii[k])
        check(found.verdicts[k], found.separations[k], square, radius, 6.0 * scale)


def test_depth_of_a_segment_in_a_box_is_the_least_way_out() -> None:
    rng = np.random.default_rng(4)
    boxes, p, q = scene(400, 5)
    solid = boxes.half_extents.min(axis=1) > 1e-3
    boxes, p, q = boxes[solid], p[solid], q[solid]
    p = boxes.centers + 0.3 * (p - boxes.centers)
    radii = rng.uniform(0.0, 0.3, len(p))
    found = oc.separations(Capsules(p, q, radii), boxes)
    inside = np.flatnonzero((found.separations + radii < -1e-6) & (p != q).any(axis=1))
    assert len(inside) > 50
    for n in inside:
        box = np.array(corners(row_of(boxes, n)), float)
        hull = ConvexHull(np.concatenate([box - p[n], box - q[n]]), qhull_options="QJ")
        depth = -hull.equations[:, 3].max()
        assert found.separations[n] + radii[n] == pytest.approx(-depth, abs=1e-7)


def test_points_and_normals() -> None:
    boxes, p, q = scene(400, 6)
    radii = np.random.default_rng(7).uniform(0.0, 0.5, len(p))
    capsules = Capsules(p, q, radii)
    for other in (boxes, capsules[np.arange(len(p))[::-1]]):
        found = oc.clearances(capsules, other)
        reach = 1e-12 * (1.0 + np.abs(boxes.centers).max())
        np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, atol=1e-14)
        step = found.distances[:, None] * found.normals
        np.testing.assert_allclose(found.positions_a + step, found.positions_b, atol=reach)
        core = found.positions_a - radii[:, None] * found.normals
        np.testing.assert_allclose(_from_segments(core, p, q), 0.0, atol=reach)
        if isinstance(other, Boxes):
            y = np.einsum("nij,ni->nj", boxes.rotations, found.positions_b - boxes.centers)
            depth = (np.abs(y) - boxes.half_extents).max(axis=1)
            np.testing.assert_allclose(depth, 0.0, atol=reach)  # on the surface


def test_a_push_by_the_separation_along_the_normal_parts_them_by_no_less() -> None:
    # Above all where the cores touch or nearly do: flat boxes pierced, ends at corners, crossings.
    boxes, p, q = scene(2000, 10)
    rng = np.random.default_rng(11)
    n = len(p)
    place = rng.choice([-1.0, 1.0, 0.4], (n, 3)) * boxes.half_extents
    place = boxes.centers + np.einsum("nij,nj->ni", boxes.rotations, place)
    place += rng.normal(size=(n, 3)) * rng.choice([0.0, 1e-16, 1e-13, 1e-9, 1e-5], (n, 1))
    share = rng.choice([0.0, 0.3, 1.0], (n, 1)) * (q - p)
    capsules = Capsules(place - share, place + (q - p) - share, rng.choice([0.0, 0.2], n))
    size = np.abs(q - p).sum(axis=1) + np.abs(boxes.centers).sum(axis=1) + 3.0
    axes = boxes.rotations * boxes.half_extents[:, None]
    turned = Capsules(place + 0.3 * axes[:, :, 0], place - 0.7 * axes[:, :, 0], capsules.radii)
    for other in (boxes, turned):
        found = oc.separations(capsules, other)
        top = _reach(capsules, found.normals)
        if isinstance(other, Boxes):
            across = np.abs(np.einsum("nij,ni->nj", axes, found.normals)).sum(axis=1)
            bottom = (found.normals * boxes.centers).sum(axis=1) - across
        else:
            bottom = -_reach(other, -found.normals)
        assert (bottom - top - found.separations >= -DOUBT * size).all()


def _reach(capsules: Capsules, normals: np.ndarray) -> np.ndarray:
    ends = np.stack([capsules.starts, capsules.ends])
    return np.asarray((ends * normals).sum(axis=2).max(axis=0) + capsules.radii)


def _from_segments(points: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    way = q - p
    square = np.maximum((way * way).sum(axis=1), 1e-300)
    t = np.clip(((points - p) * way).sum(axis=1) / square, 0.0, 1.0)
    return np.linalg.norm(points - p - t[:, None] * way, axis=1)


#: The same for planes.
DOUBT_PLANES = 1e-14


@each("name", ["ordinary scene", "far away, 1e6 to 1e9 m", "zero extents"])
def test_planes(name: str) -> None:
    boxes, _ = family(name, 100)
    rng = np.random.default_rng(10)
    n = len(boxes)
    normals = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-9, 9, (n, 1))
    normals[: n // 2] = boxes.rotations[: n // 2, :, 0]  # a face lies on the plane
    reach = np.abs(np.einsum("nk,nki->ni", normals, boxes.rotations)) * boxes.half_extents
    squares = (normals * normals).sum(axis=1, keepdims=True)
    shift = rng.choice([-1.0, -0.5, 0.0, 1.0, 1.0 + 1e-15, 1.5], (n, 1))
    points = boxes.centers + shift * normals * reach.sum(axis=1, keepdims=True) / squares
    below, above = HalfSpaces(points, normals), HalfSpaces(points, -normals)
    found, turned = oc.separations(boxes, below), oc.separations(boxes, above)
    for k in range(n):
        m, at = exact(normals[k]), exact(points[k])
        ends = [dot(m, minus(corner, at)) for corner in corners(row_of(boxes, k))]
        low, high, length = min(ends), max(ends), norm(m)
        size = np.abs(points[k] - boxes.centers[k]).sum() + boxes.half_extents[k].sum()
        assert abs(low / length - found.separations[k]) <= DOUBT_PLANES * size
        assert abs(high / length + turned.separations[k]) <= DOUBT_PLANES * size
        for answer, gap in ((found, low), (turned, -high)):
            truth = SEPARATE if gap > 0 else OVERLAP if gap < 0 else TOUCHING
            near = abs(gap) <= DOUBT_PLANES * size * length
            assert answer.verdicts[k] in (truth, TOUCHING if near else truth)
            unit = normals[k] / float(length) * (-1 if answer is found else 1)
            np.testing.assert_allclose(answer.normals[k], unit, atol=1e-15)
            lowest = answer.positions[k] - 0.5 * answer.separations[k] * answer.normals[k]
            height = np.dot(lowest - points[k], -answer.normals[k])
            rounding = 1e-9 * size + 1e-15 * np.abs(points[k]).max()
            assert abs(height - answer.separations[k]) <= rounding
            assert boxes[k].padded(rounding).contains(lowest)


def test_bad_input_is_refused_by_name() -> None:
    box, zero = Boxes([[0, 0, 0]], [np.eye(3)], [[1, 1, 1]]), [[0, 0, 0]]
    bad = [[0.0, 0, 0], [0, np.nan, 0]]
    refused(r"starts must be finite in row 1", Capsules, bad, np.zeros((2, 3)), [1, 1])
    refused(r"radii must not be negative in row 0", Capsules.spheres, zero, [-1])
    refused("same length", Capsules, zero, zero * 2, [1])
    refused("same length", Capsules.spheres, zero, [1, 2])
    refused("same length", oc.verdicts, Capsules.spheres(zero * 2, [1, 1]), box)
    refused("normals must not be zero in row 0", HalfSpaces, zero, zero)
    refused("same length", oc.verdicts, box, HalfSpaces(zero * 2, [[1, 0, 0]] * 2))
    for limit in (-1.0, np.nan):
        refused("max_distance", oc.clearances, box, box, [(0, 0)], max_distance=limit)

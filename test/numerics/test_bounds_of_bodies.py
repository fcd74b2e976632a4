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

"""Error bounds of points, rays, capsules and planes: observed error over bound."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

import numpy as np
from error_bounds import (
    Moved,
    Record,
    check_flips,
    check_ratios,
    extents,
    flips,
    normals,
    observed_at_flip,
)
from exact_vectors import Box, Vector, corners, dot, exact, minus, norm, root, taxicab
from hull_distances import squared_distance
from support import row_of

import obb_collision as oc
from obb_collision import Capsules, Verdict, cast_rays, points_inside
from obb_collision.numerics.constants import CAREFUL_BOUND
from obb_collision.numerics.vec3 import vector
from obb_collision.queries.points import INSIDE_BOUND, contains
from obb_collision.queries.primitives.capsules import FAR_BOUND, NEAR_BOUND
from obb_collision.queries.rays.boxes import (
    DISTANCE_SLACK,
    HIT_BOUND,
    Ray,
    enters_bounds,
    moved_ahead,
)
from obb_collision.queries.rays.rays import as_rays
from obb_collision.typing import Floats

PAIRS = 6
#: Bodies of ordinary sizes, for what takes Fractions milliseconds.
FEW = ("ordinary scene", "thin plates and rods", "far away, 1e6 to 1e9 m")


def test_containment(record_property: Record) -> None:
    moved = Moved(PAIRS, loose=True)
    boxes = moved.a

    def outside(distances: Floats) -> np.ndarray:
        points = boxes.centers + distances[:, None] * moved.directions
        return np.array(
            [not contains(*row_of(boxes, n), points[n : n + 1])[0] for n in range(len(boxes))]
        )

    def quantity(n: int, distance: float) -> Fraction:
        stored = row_of(boxes, n)
        offset = minus(exact(stored[0] + distance * moved.directions[n]), exact(stored[0]))
        columns, ratios = [exact(column) for column in stored[1].T], []
        for normal, column, half in zip(normals(columns), columns, exact(stored[2]), strict=True):
            excess = abs(dot(normal, offset)) - abs(dot(normal, column)) * half
            bound = Fraction(CAREFUL_BOUND) * (norm(offset) + half) * norm(normal)
            ratios.append(excess / (bound + Fraction(2) ** -1060))
        return max(ratios)

    check_flips(record_property, outside, quantity, moved.farthest)


def test_points_within_a_margin(record_property: Record) -> None:
    moved, margin = Moved(PAIRS, FEW, loose=True), 0.25
    boxes = moved.a

    def outside(distances: Floats) -> np.ndarray:
        points = boxes.centers + distances[:, None] * moved.directions
        rows = [slice(n, n + 1) for n in range(len(boxes))]
        counts = [points_inside(boxes[n], points[n], margin).counts[0] for n in rows]
        return np.array(counts) == 0

    def quantity(n: int, distance: float) -> Fraction:
        stored = row_of(boxes, n)
        point = stored[0] + distance * moved.directions[n]
        gap = root(squared_distance([exact(point)], corners(stored))) - Fraction(margin)
        size = taxicab(minus(exact(point), exact(stored[0]))) + extents(stored)
        return gap / (Fraction(INSIDE_BOUND) * (size + Fraction(margin)))

    check_flips(record_property, outside, quantity, moved.farthest + 2.0)


class Capsule:
    """Capsules that move away from the boxes, or capsules, of the other side."""

    def __init__(self, count: int, loose: bool) -> None:
        self.moved = Moved(count, FEW, loose)
        rng = np.random.default_rng(4)
        n = len(self.moved.a)
        self.ways = 0.3 * rng.normal(size=(n, 3))
        self.radii = rng.uniform(0.05, 0.3, n)
        self.other = Capsules(
            self.moved.a.centers, self.moved.a.centers + 0.3 * rng.normal(size=(n, 3)), self.radii
        )

    def at(self, distances: Floats) -> Capsules:
        starts = self.moved.a.centers + distances[:, None] * self.moved.directions
        return Capsules(starts, starts + self.ways, self.radii)


def check_capsules(record_property: Record, verdict: Verdict, limit: float, pair: bool) -> None:
    """Check where SEPARATE or OVERLAP ends; what is left open is up to NEAR_BOUND wide."""
    sign = 1 if verdict == Verdict.SEPARATE else -1
    moving = Capsule(2 * PAIRS, loose=sign < 0)
    fixed = moving.other if pair else moving.moved.a

    def decide(distances: Floats) -> np.ndarray:
        found = oc.verdicts(moving.at(distances), fixed) == verdict
        return found if sign > 0 else ~found

    def quantity(n: int, distance: float) -> Fraction:
        one = moving.at(np.full(len(moving.radii), distance))
        start, end = exact(one.starts[n]), exact(one.ends[n])
        radii = Fraction(one.radii[n])
        if pair:
            p, q = exact(moving.other.starts[n]), exact(moving.other.ends[n])
            other = [p, q]
            size = taxicab(minus(p, start)) + taxicab(minus(q, p))
            size += taxicab(minus(end, start)) + 2 * radii
            radii *= 2
        else:
            stored = row_of(moving.moved.a, n)
            other, center = corners(stored), exact(stored[0])
            size = taxicab(minus(start, center)) + taxicab(minus(end, center))
            size += extents(stored) + radii
        gap = root(squared_distance([start, end], other)) - radii
        return sign * gap / (Fraction(limit) * size)

    low, high = flips(decide, moving.moved.farthest + 4.0)
    if sign < 0:
        low, high = high, low
    ratios = []
    for n in range(len(low)):
        unsure, certain = quantity(n, float(low[n])), quantity(n, float(high[n]))
        assert unsure <= 2 * Fraction(NEAR_BOUND / limit)
        # a gap is along some direction, not the best: less than the distance, whatever the error
        ratios.append(observed_at_flip(unsure if sign < 0 else Fraction(0), certain))
    check_ratios(record_property, ratios)


def test_capsules_apart_from_boxes(record_property: Record) -> None:
    check_capsules(record_property, Verdict.SEPARATE, FAR_BOUND, pair=False)


def test_capsules_overlapping_boxes(record_property: Record) -> None:
    check_capsules(record_property, Verdict.OVERLAP, NEAR_BOUND, pair=False)


def test_capsules_apart(record_property: Record) -> None:
    check_capsules(record_property, Verdict.SEPARATE, FAR_BOUND, pair=True)


def test_capsules_overlapping(record_property: Record) -> None:
    check_capsules(record_property, Verdict.OVERLAP, FAR_BOUND, pair=True)


def test_planes(record_property: Record) -> None:
    moved = Moved(PAIRS, loose=True)
    points, boxes = moved.a.centers, moved.at(0.3 * moved.farthest)[1]
    low, high = (
        oc.separations(boxes, oc.HalfSpaces(points, way)).separations
        for way in (moved.directions, -moved.directions)
    )
    ratios = []
    for n in range(len(boxes)):
        stored, normal = row_of(boxes, n), exact(moved.directions[n])
        offset = minus(exact(stored[0]), exact(points[n]))
        heights = [dot(normal, minus(c, exact(points[n]))) for c in corners(stored)]
        bound = Fraction(CAREFUL_BOUND) * (norm(offset) + extents(stored)) + Fraction(2) ** -1060
        for value, height in ((low[n], min(heights)), (-high[n], max(heights))):
            ratios.append(abs(Fraction(value) - height / norm(normal)) / bound)
    check_ratios(record_property, ratios)


def least_growth(stored: Box, origin: Vector, direction: Vector) -> Fraction:
    """Return by how much a box must grow, negative to shrink, for a ray to touch it, exactly."""
    columns, lines = [exact(column) for column in stored[1].T], []
    for normal, column, half in zip(normals(columns), columns, exact(stored[2]), strict=True):
        scale = dot(normal, column)
        place = dot(normal, minus(origin, exact(stored[0]))) / scale
        speed = dot(normal, direction) / scale
        lines += [(place - half, speed), (-place - half, -speed)]
    times = [Fraction(0)]
    for (p, v), (q, w) in combinations(lines, 2):
        if v != w:
            times.append(max((q - p) / (v - w), Fraction(0)))
    return min(max(p + t * v for p, v in lines) for t in times)


def test_rays_that_miss(record_property: Record) -> None:
    moved = Moved(PAIRS, FEW, loose=True)
    boxes = moved.a
    rng = np.random.default_rng(6)
    along = np.cross(moved.directions, rng.normal(size=moved.directions.shape))
    along += 0.1 * moved.directions

    def origins(distances: Floats) -> Floats:
        places: Floats = boxes.centers + distances[:, None] * moved.directions - 2.0 * along
        return places

    def misses(distances: Floats) -> np.ndarray:
        starts = origins(distances)
        rows = [slice(n, n + 1) for n in range(len(boxes))]
        hits = [cast_rays(boxes[n], starts[n], along[n]).boxes[0] for n in rows]
        return np.array(hits) < 0

    def quantity(n: int, distance: float) -> Fraction:
        stored, origin = row_of(boxes, n), exact(origins(np.full(len(boxes), distance))[n])
        size = taxicab(minus(origin, exact(stored[0]))) + extents(stored)
        growth = least_growth(stored, origin, exact(along[n]))
        return growth / (Fraction(HIT_BOUND) * size)

    check_flips(record_property, misses, quantity, moved.farthest + 2.0)


def test_rays_moved_ahead(record_property: Record) -> None:
    """How far the point is from the line of the ray, with its direction as it was given."""
    rng = np.random.default_rng(8)
    ratios = []
    for origin, direction, center in rng.normal(size=(200, 3, 3)):
        start, units, _ = as_rays(1e3 * origin[None], direction[None], np.inf)
        ray = Ray(vector(start[0]), vector(units[0]), np.inf)
        found, ahead, bound = moved_ahead(ray, vector(center), 0.5)
        if ahead <= 0.0:
            continue
        offset, line = minus(exact(start[0]), exact(center)), exact(direction)
        rest = minus(exact(found), offset)
        share = dot(rest, line) / dot(line, line)
        ratios.append(norm(minus(rest, [share * x for x in line])) / Fraction(bound))
    assert len(ratios) > 50
    check_ratios(record_property, ratios)


def test_rays_down_the_tree(record_property: Record) -> None:
    """Where a ray enters the bounds of a node: earlier by the slack, but for the error."""
    rng = np.random.default_rng(7)
    ratios = []
    for origin, direction in rng.normal(size=(200, 2, 3)):
        unit = direction / np.linalg.norm(direction)
        start = origin - 5.0 * unit
        limits = np.concatenate([origin - 0.3, origin + 0.3])
        ray = Ray(vector(start), vector(unit), np.inf)
        found = enters_bounds(limits[None], 0, ray, np.inf)
        near = max(
            min((Fraction(limits[k + side]) - Fraction(start[k])) / Fraction(unit[k])
                for side in (0, 3))
            for k in range(3)
        )  # fmt: skip
        slack = Fraction(DISTANCE_SLACK) * near
        ratios.append(abs(near - Fraction(found) - slack) / slack)
    check_ratios(record_property, ratios)

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

"""Error bounds of boxes, points, rays, capsules and planes: see ``error_bounds``."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
from error_bounds import (
    Moved,
    check_flips,
    check_ratios,
    edge_lengths,
    exact_gaps,
    extents,
    flips,
    normals,
    observed_at_flip,
)
from exact_vectors import Box, Point, Vector, corners, dot, exact, minus, norm, root, taxicab
from hull_distances import squared_distance
from hypothesis import given, settings
from oracle import overlap_volume
from support import any_pairs, family, joined, row_of, witnesses

import obb_collision as oc
from obb_collision import Boxes, Capsules, Verdict, cast_rays, points_inside
from obb_collision.geometry.poses import matrices_from_quaternions, unit_quaternions
from obb_collision.numerics.constants import (
    BOUND_SLACK,
    CAREFUL_BOUND,
    FAST_BOUND,
    ORTHONORMAL_ROUNDING,
    UNDERFLOW,
)
from obb_collision.numerics.intrinsics import LANES
from obb_collision.numerics.vec3 import vector
from obb_collision.queries.clearance.clearance import CERTAINLY_APART, PROVEN
from obb_collision.queries.points import INSIDE_BOUND, contains
from obb_collision.queries.points.near_points import BLOCK_BOUND, block_gap
from obb_collision.queries.primitives.capsules import FAR_BOUND, NEAR_BOUND
from obb_collision.queries.rays.boxes import (
    DISTANCE_SLACK,
    HIT_BOUND,
    Ray,
    enters_bounds,
    moved_ahead,
)
from obb_collision.queries.rays.hidden import middle_from, sight_of
from obb_collision.queries.rays.rays import as_rays
from obb_collision.queries.verdict import VOLUME_BOUND, fast_verdict
from obb_collision.queries.verdict.coarse import (
    MEETING_SLACK,
    SPHERE_SLACK,
    meeting_bounds,
    spheres_may_collide,
)
from obb_collision.queries.verdict.sat import best_face, box_of, enter_frame, pair_of
from obb_collision.queries.verdict.witness import gap_bounds
from obb_collision.typing import Floats, Mask
from tools.cases.families import FAMILIES
from tools.cases.placement import random_rotations

PAIRS = 8
FEWER = 6
#: Bodies of ordinary sizes, for what takes Fractions milliseconds.
FEW = ("ordinary scene", "thin plates and rods", "far away, 1e6 to 1e9 m")


def offset(a: Box, b: Box) -> Point:
    return minus(exact(b[0]), exact(a[0]))


def fast_bound(a: Box, b: Box) -> Fraction:
    size = taxicab(offset(a, b)) + extents(a, b)
    return Fraction(FAST_BOUND) * size + Fraction(UNDERFLOW)


def careful_bound(a: Box, b: Box) -> Fraction:
    size = norm(offset(a, b)) + extents(a, b)
    return Fraction(CAREFUL_BOUND) * size + Fraction(UNDERFLOW)


def test_fast_verdicts() -> None:
    """Edge axes are not normalised there: a gap counts times the length of its axis."""

    def decide(a: Boxes, b: Boxes) -> Mask:
        boxes = [(box_of(*row_of(a, n)), box_of(*row_of(b, n))) for n in range(len(a))]
        fast = [fast_verdict(*pair_of(*pair)) for pair in boxes]
        return np.array(fast) == Verdict.SEPARATE

    def quantity(a: Box, b: Box) -> Fraction:
        gaps, lengths = exact_gaps(a, b), edge_lengths(a, b)
        if len(gaps) < 15:  # parallel edges: these gaps are zero at most
            lengths = [length for length in lengths if length > 1e-20]
        edges = [g * Fraction(x) for g, x in zip(gaps[6:], lengths, strict=False)]
        return max([*gaps[:6], *edges]) / fast_bound(a, b)

    Moved(PAIRS, loose=True).check(decide, quantity)


def test_careful_verdicts_apart() -> None:
    Moved(PAIRS, loose=True).check(
        lambda a, b: oc.verdicts(a, b) == Verdict.SEPARATE,
        lambda a, b: max(exact_gaps(a, b)) / careful_bound(a, b),
    )


def test_careful_verdicts_overlapping() -> None:
    moved = Moved(PAIRS, families=("ordinary scene", "edge against edge", "thin plates and rods"))

    def quantity(a: Box, b: Box) -> Fraction:
        return max(exact_gaps(a, b)) / careful_bound(a, b) + 2  # certain at -1, unsure beyond

    moved.check(lambda a, b: oc.verdicts(a, b) != Verdict.OVERLAP, quantity)


def test_coarse_spheres() -> None:
    def quantity(a: Box, b: Box) -> Fraction:
        distance, radii = norm(offset(a, b)), norm(exact(a[2])) + norm(exact(b[2]))
        bound = Fraction(SPHERE_SLACK) * (distance + radii) + Fraction(UNDERFLOW)
        return (distance - radii) / bound

    Moved(PAIRS).check(lambda a, b: ~spheres_may_collide(*_rows(a, b)), quantity)


def _rows(a: Boxes, b: Boxes) -> tuple[Boxes, np.ndarray, np.ndarray]:
    boxes, pairs = joined(a, b)
    return boxes, pairs[:, 0], pairs[:, 1]


def turned_boxes() -> Boxes:
    """Return boxes none of which is aligned with an axis: those have bounds without slack."""
    names = ("ordinary scene", "aspect ratio to 1e9", "far away, 1e6 to 1e9 m")
    return Moved(PAIRS, names).a


def test_world_bounds() -> None:
    boxes = turned_boxes()
    minimum, maximum = boxes.world_bounds()
    ratios = []
    for n in range(len(boxes)):
        places = list(zip(*corners(row_of(boxes, n)), strict=True))
        for k in range(3):
            center = Fraction(float(boxes.centers[n, k]))
            slack = Fraction(BOUND_SLACK) * (abs(center) + max(places[k]) - center)
            low, high = Fraction(minimum[n, k]), Fraction(maximum[n, k])
            ratios += [abs(min(places[k]) - low - slack) / slack]
            ratios += [abs(high - max(places[k]) - slack) / slack]
    check_ratios(ratios)


def test_overlap_volumes() -> None:
    ratios = []
    for a, b in (family(name, 8) for name in FAMILIES):
        volumes = oc.overlap_volumes(a, b)
        for k in np.flatnonzero(np.minimum(a.volumes, b.volumes) > 1e-250):
            sides = row_of(a, k), row_of(b, k)
            smaller = a if a.volumes[k] < b.volumes[k] else b
            x, y, z = exact(smaller.half_extents[k])
            surface = 8 * (x * y + y * z + z * x)
            size = taxicab(minus(exact(sides[1][0]), exact(sides[0][0])))
            size += extents(*sides)
            error = abs(Fraction(volumes[k]) - overlap_volume(*sides))
            ratios.append(error / (Fraction(VOLUME_BOUND) * size * surface))
    check_ratios(ratios)


def test_meeting_bounds() -> None:
    boxes = turned_boxes()
    minimum, _ = meeting_bounds(boxes)
    ratios = []
    for n in range(len(boxes)):
        row = row_of(boxes, n)
        places = list(zip(*corners(row), strict=True))
        grown = Fraction(MEETING_SLACK) * (taxicab(exact(row[0])) + extents(row))
        for k in range(3):
            center = Fraction(float(row[0][k]))
            inner = Fraction(BOUND_SLACK) * (abs(center) + max(places[k]) - center)
            ratios.append(abs(min(places[k]) - Fraction(minimum[n, k]) - inner - grown) / grown)
    check_ratios(ratios)


def test_witnesses() -> None:
    """The signed separation of a pair: the largest gap, or minus the least penetration."""
    moved = Moved(PAIRS, loose=True)
    a, b = moved.at(np.linspace(0.05, 0.9, len(moved.a)) * moved.farthest)
    gaps, _ = witnesses(a, b)
    pairs = [(row_of(a, n), row_of(b, n)) for n in range(len(a))]
    errors = [
        abs(Fraction(gap) - max(exact_gaps(*pair))) / careful_bound(*pair)
        for gap, pair in zip(gaps.tolist(), pairs, strict=True)
    ]
    check_ratios(errors)


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@settings(max_examples=200)
@given(any_pairs())
def test_witnesses_of_any_doubles(pair: tuple[Boxes, Boxes]) -> None:
    """From subnormal sizes to 1e300, where numbers over- or underflow first."""
    (gap,), _ = witnesses(*pair)
    row = row_of(pair[0], 0), row_of(pair[1], 0)
    assert abs(Fraction(float(gap)) - max(exact_gaps(*row))) <= careful_bound(*row)


def test_gap_bounds_and_best_faces() -> None:
    """Upper bounds of all 15 gaps: by as much above them as their bound, but for the error."""
    moved = Moved(PAIRS, loose=True)
    a, b = moved.at(np.linspace(0.05, 0.9, len(moved.a)) * moved.farthest)
    ratios = []
    for n in range(len(a)):
        row = row_of(a, n), row_of(b, n)
        gaps, lengths = exact_gaps(*row), edge_lengths(*row)
        pair, size, scale = enter_frame(box_of(*row[0]), box_of(*row[1]))
        if len(gaps) == 15:
            _, most = gap_bounds(pair, size)
            for gap, length, value in zip(gaps, [1.0] * 6 + lengths, sum(most, ()), strict=True):
                if np.isfinite(value):
                    bound = (Fraction(FAST_BOUND * size) + Fraction(UNDERFLOW)) / Fraction(length)
                    error = Fraction(value) - gap * Fraction(scale) - bound
                    ratios.append(abs(error) / bound)
        face = Fraction(best_face(pair)[0]) / Fraction(scale)
        near = Fraction(CERTAINLY_APART) * Fraction(size) / Fraction(scale)
        ratios.append(abs(face - max(gaps[:6])) / near)
    check_ratios(ratios)


def test_clearances() -> None:
    moved = Moved(2, families=("ordinary scene", "edge against edge", "thin plates and rods"))
    a, b = moved.at(0.5 * moved.farthest)
    found = oc.clearances(a, b).distances
    ratios = []
    for n, distance in enumerate(found.tolist()):
        row = row_of(a, n), row_of(b, n)
        expected = root(squared_distance(corners(row[0]), corners(row[1])))
        size = taxicab(offset(*row)) + extents(*row)
        ratios.append(abs(Fraction(distance) - expected) / (Fraction(PROVEN) * size))
    check_ratios(ratios)


def test_contact_depths() -> None:
    moved = Moved(PAIRS)
    a, b = moved.at(np.linspace(0.01, 0.2, len(moved.a)) * moved.farthest)
    found = oc.contacts(a, b)
    ratios = []
    for n in np.flatnonzero(found.counts):
        row = row_of(a, n), row_of(b, n)
        depth = max(-max(exact_gaps(*row)), Fraction(0))
        ratios.append(abs(Fraction(found.depths[n]) - depth) / careful_bound(*row))
    assert len(ratios) > 20
    check_ratios(ratios)


def test_rotations_of_quaternions() -> None:
    quaternions = np.random.default_rng(3).normal(size=(500, 4))
    matrices = matrices_from_quaternions(unit_quaternions(quaternions))
    ratios = []
    for matrix in matrices:
        columns = [exact(column) for column in matrix.T]
        defect = max(abs(dot(u, v) - (u is v)) for u in columns for v in columns)
        ratios.append(defect / Fraction(ORTHONORMAL_ROUNDING))
    check_ratios(ratios)


def test_containment() -> None:
    moved = Moved(FEWER, loose=True)
    boxes = moved.a

    def outside(distances: Floats) -> Mask:
        points = enumerate(moved.points(distances))
        return np.array([not contains(*row_of(boxes, n), p[None])[0] for n, p in points])

    def quantity(n: int, distance: float) -> Fraction:
        stored = row_of(boxes, n)
        offset = minus(exact(stored[0] + distance * moved.directions[n]), exact(stored[0]))
        columns, ratios = [exact(column) for column in stored[1].T], []
        for normal, column, half in zip(normals(columns), columns, exact(stored[2]), strict=True):
            excess = abs(dot(normal, offset)) - abs(dot(normal, column)) * half
            bound = Fraction(CAREFUL_BOUND) * (norm(offset) + half) * norm(normal)
            ratios.append(excess / (bound + Fraction(2) ** -1060))
        return max(ratios)

    check_flips(outside, quantity, moved.farthest)


def test_points_within_a_margin() -> None:
    moved, margin = Moved(FEWER, FEW, loose=True), 0.25
    boxes = moved.a

    def outside(distances: Floats) -> Mask:
        points = enumerate(moved.points(distances))
        return np.array(
            [not points_inside(boxes[[n]], p[None], margin).counts[0] for n, p in points]
        )

    def quantity(n: int, distance: float) -> Fraction:
        stored = row_of(boxes, n)
        point = stored[0] + distance * moved.directions[n]
        gap = root(squared_distance([exact(point)], corners(stored))) - Fraction(margin)
        size = taxicab(minus(exact(point), exact(stored[0]))) + extents(stored)
        return gap / (Fraction(INSIDE_BOUND) * (size + Fraction(margin)))

    check_flips(outside, quantity, moved.farthest + 2.0)


@pytest.mark.parametrize("verdict", [Verdict.SEPARATE, Verdict.OVERLAP])
@pytest.mark.parametrize("pair", [False, True])
def test_capsules(verdict: Verdict, pair: bool) -> None:
    """Where SEPARATE or OVERLAP ends; what is left open is up to NEAR_BOUND wide."""
    sign = 1 if verdict == Verdict.SEPARATE else -1
    limit = NEAR_BOUND if sign < 0 and not pair else FAR_BOUND
    moved, rng = Moved(2 * FEWER, FEW, loose=sign < 0), np.random.default_rng(4)
    boxes, n = moved.a, len(moved.a)
    ways, widths = 0.3 * rng.normal(size=(n, 3)), rng.uniform(0.05, 0.3, n)
    capsules = Capsules(boxes.centers, boxes.centers + 0.3 * rng.normal(size=(n, 3)), widths)

    def at(distances: Floats) -> Capsules:
        starts = moved.points(distances)
        return Capsules(starts, starts + ways, widths)

    def decide(distances: Floats) -> Mask:
        found = oc.verdicts(at(distances), capsules if pair else boxes) == verdict
        return found if sign > 0 else ~found

    def quantity(n: int, distance: float) -> Fraction:
        one = at(np.full(len(widths), distance))
        start, end = exact(one.starts[n]), exact(one.ends[n])
        radii = Fraction(one.radii[n])
        if pair:
            p, q = exact(capsules.starts[n]), exact(capsules.ends[n])
            other = [p, q]
            size = taxicab(minus(p, start)) + taxicab(minus(q, p))
            size += taxicab(minus(end, start)) + 2 * radii
            radii *= 2
        else:
            stored = row_of(boxes, n)
            other, center = corners(stored), exact(stored[0])
            size = taxicab(minus(start, center)) + taxicab(minus(end, center))
            size += extents(stored) + radii
        gap = root(squared_distance([start, end], other)) - radii
        return sign * gap / (Fraction(limit) * size)

    low, high = flips(decide, moved.farthest + 4.0)
    if sign < 0:
        low, high = high, low
    ratios = []
    for n in range(len(low)):
        unsure, certain = quantity(n, float(low[n])), quantity(n, float(high[n]))
        assert unsure <= 2 * Fraction(NEAR_BOUND / limit)
        # a gap is along some direction, not the best: less than the distance, whatever the error
        ratios.append(observed_at_flip(unsure if sign < 0 else Fraction(0), certain))
    check_ratios(ratios)


def test_planes() -> None:
    moved = Moved(FEWER, loose=True)
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
    check_ratios(ratios)


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


def test_rays_that_miss() -> None:
    moved = Moved(FEWER, FEW, loose=True)
    boxes = moved.a
    rng = np.random.default_rng(6)
    along = np.cross(moved.directions, rng.normal(size=moved.directions.shape))
    along += 0.1 * moved.directions

    def origins(distances: Floats) -> Floats:
        return moved.points(distances) - 2.0 * along

    def misses(distances: Floats) -> Mask:
        starts = enumerate(origins(distances)[:, None])
        return np.array([not cast_rays(boxes[[n]], p, along[[n]]).hits[0] for n, p in starts])

    def quantity(n: int, distance: float) -> Fraction:
        stored, origin = row_of(boxes, n), exact(origins(np.full(len(boxes), distance))[n])
        size = taxicab(minus(origin, exact(stored[0]))) + extents(stored)
        growth = least_growth(stored, origin, exact(along[n]))
        return growth / (Fraction(HIT_BOUND) * size)

    check_flips(misses, quantity, moved.farthest + 2.0)


def test_rays_moved_ahead() -> None:
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
    check_ratios(ratios)


def test_blocks_of_points() -> None:
    """How far the bounds of points are from a box, less the slack, along its own axes."""
    rng, ratios = np.random.default_rng(10), []
    for rotation in random_rotations(rng, 200):
        center, half = rng.normal(size=3), rng.uniform(0.01, 1.0, 3)
        box, nodes = box_of(center, rotation, half), np.zeros((1, 6, LANES))
        low = center + rng.normal(size=3) * 3.0
        nodes[0, :3, 0], nodes[0, 3:, 0] = low, low + rng.uniform(0.0, 0.5, 3)
        sides = (
            vector(abs(rotation[:, 0])),
            vector(abs(rotation[:, 1])),
            vector(abs(rotation[:, 2])),
        )
        found = block_gap(box, sides, nodes, 0, 0)
        first, last = exact(nodes[0, :3, 0]), exact(nodes[0, 3:, 0])
        width = [x / 2 for x in minus(last, first)]
        offset = minus([x + y for x, y in zip(first, width, strict=True)], exact(center))
        slack = Fraction(BLOCK_BOUND) * (taxicab(offset) + sum(width) + sum(exact(half)))
        beyond = [
            abs(dot(axis, offset)) - reach - dot([abs(x) for x in axis], width) - slack
            for axis, reach in zip(map(exact, rotation.T), exact(half), strict=True)
        ]
        wanted = norm([max(x, Fraction(0)) for x in beyond])
        ratios.append(abs(Fraction(found) - wanted) / slack)
    check_ratios(ratios)


def test_ends_of_segments() -> None:
    """Where a segment from a sensor ends, computed from its middle, direction and length."""
    rng, ratios = np.random.default_rng(9), []
    for eye, point, center in rng.normal(size=(200, 3, 3)) * [[1e3], [1.0], [1.0]]:
        sight = sight_of(vector(eye), vector(point))
        middle, half = exact(middle_from(sight, vector(center))), Fraction(sight.length) / 2
        for side, end in ((-1, eye), (1, point)):
            found = [m + side * half * u for m, u in zip(middle, exact(sight.unit), strict=True)]
            off = minus(found, minus(exact(end), exact(center)))
            ratios.append(norm(off) / Fraction(sight.error))
    check_ratios(ratios)


def test_rays_down_the_tree() -> None:
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
    check_ratios(ratios)

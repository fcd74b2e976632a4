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

"""Error bounds of the kernels of two boxes: observed error over bound, see ``error_bounds``."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from error_bounds import Moved, Record, check_ratios, exact_gaps, extents
from exact_vectors import Box, Point, corners, dot, exact, minus, norm, root, taxicab
from hull_distances import squared_distance
from hypothesis import given, settings
from overlap_oracle import overlap_volume
from support import extents as any_extents
from support import family, joined, quaternions, row_of, vectors, witnesses

from obb_collision import Boxes, Verdict, clearances, contacts, overlap_volumes, verdicts
from obb_collision.geometry.poses import matrices_from_quaternions, unit_quaternions
from obb_collision.numerics.constants import (
    BOUND_SLACK,
    CAREFUL_BOUND,
    FAST_BOUND,
    ORTHONORMAL_ROUNDING,
    UNDERFLOW,
)
from obb_collision.queries.clearance import NEAR, PROVEN
from obb_collision.queries.verdict import VOLUME_BOUND, fast_verdict
from obb_collision.queries.verdict.coarse import (
    MEETING_SLACK,
    SPHERE_SLACK,
    meeting_bounds,
    spheres_may_collide,
)
from obb_collision.queries.verdict.sat import best_face, box_of, enter_frame, pair_of
from obb_collision.queries.verdict.witness import gap_bounds
from obb_collision.typing import Mask
from tools.cases.families import FAMILIES

PAIRS = 8


def offset(a: Box, b: Box) -> Point:
    return minus(exact(b[0]), exact(a[0]))


def fast_bound(a: Box, b: Box) -> Fraction:
    size = taxicab(offset(a, b)) + extents(a, b)
    return Fraction(FAST_BOUND) * size + Fraction(UNDERFLOW)


def careful_bound(a: Box, b: Box) -> Fraction:
    size = norm(offset(a, b)) + extents(a, b)
    return Fraction(CAREFUL_BOUND) * size + Fraction(UNDERFLOW)


def edge_lengths(a: Box, b: Box) -> list[float]:
    """Return the lengths of the nine cross products of edges, those of null ones left out."""
    lengths = np.linalg.norm(np.cross(a[1].T[:, None], b[1].T[None]), axis=2).ravel()
    return [float(length) for length in lengths]


def test_fast_verdicts(record_property: Record) -> None:
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

    Moved(PAIRS, loose=True).check(record_property, decide, quantity)


def test_careful_verdicts_apart(record_property: Record) -> None:
    Moved(PAIRS, loose=True).check(
        record_property,
        lambda a, b: verdicts(a, b) == Verdict.SEPARATE,
        lambda a, b: max(exact_gaps(a, b)) / careful_bound(a, b),
    )


def test_careful_verdicts_overlapping(record_property: Record) -> None:
    moved = Moved(PAIRS, families=("ordinary scene", "edge against edge", "thin plates and rods"))

    def quantity(a: Box, b: Box) -> Fraction:
        return max(exact_gaps(a, b)) / careful_bound(a, b) + 2  # certain at -1, unsure beyond

    moved.check(record_property, lambda a, b: verdicts(a, b) != Verdict.OVERLAP, quantity)


def test_coarse_spheres(record_property: Record) -> None:
    def quantity(a: Box, b: Box) -> Fraction:
        distance, radii = norm(offset(a, b)), norm(exact(a[2])) + norm(exact(b[2]))
        bound = Fraction(SPHERE_SLACK) * (distance + radii) + Fraction(UNDERFLOW)
        return (distance - radii) / bound

    Moved(PAIRS).check(record_property, lambda a, b: ~spheres_may_collide(*_rows(a, b)), quantity)


def _rows(a: Boxes, b: Boxes) -> tuple[Boxes, np.ndarray, np.ndarray]:
    boxes, pairs = joined(a, b)
    return boxes, pairs[:, 0], pairs[:, 1]


def turned_boxes() -> Boxes:
    """Return boxes none of which is aligned with an axis: those have bounds without slack."""
    names = ("ordinary scene", "aspect ratio to 1e9", "far away, 1e6 to 1e9 m")
    return Moved(PAIRS, names).a


def test_world_bounds(record_property: Record) -> None:
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
    check_ratios(record_property, ratios)


def test_overlap_volumes(record_property: Record) -> None:
    ratios = []
    for a, b in (family(name, 8) for name in FAMILIES):
        volumes = overlap_volumes(a, b)
        for k in np.flatnonzero(np.minimum(a.volumes, b.volumes) > 1e-250):
            sides = row_of(a, k), row_of(b, k)
            smaller = a if a.volumes[k] < b.volumes[k] else b
            x, y, z = exact(smaller.half_extents[k])
            surface = 8 * (x * y + y * z + z * x)
            size = taxicab(minus(exact(sides[1][0]), exact(sides[0][0])))
            size += extents(*sides)
            error = abs(Fraction(volumes[k]) - overlap_volume(*sides))
            ratios.append(error / (Fraction(VOLUME_BOUND) * size * surface))
    check_ratios(record_property, ratios)


def test_meeting_bounds(record_property: Record) -> None:
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
    check_ratios(record_property, ratios)


def test_witnesses(record_property: Record) -> None:
    """The signed separation of a pair: the largest gap, or minus the least penetration."""
    moved = Moved(PAIRS, loose=True)
    a, b = moved.at(np.linspace(0.05, 0.9, len(moved.a)) * moved.farthest)
    gaps, _ = witnesses(a, b)
    pairs = [(row_of(a, n), row_of(b, n)) for n in range(len(a))]
    errors = [
        abs(Fraction(gap) - max(exact_gaps(*pair))) / careful_bound(*pair)
        for gap, pair in zip(gaps.tolist(), pairs, strict=True)
    ]
    check_ratios(record_property, errors)


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@settings(max_examples=200)
@given(*2 * [vectors, quaternions, any_extents])
def test_witnesses_of_any_doubles(
    center: Any, one: Any, half: Any, place: Any, other: Any, other_half: Any
) -> None:
    """From subnormal sizes to 1e300, where numbers over- or underflow first."""
    a = Boxes.from_poses([(*center, *one)], [half])
    b = Boxes.from_poses([(*place, *other)], [other_half])
    (gap,), _ = witnesses(a, b)
    row = row_of(a, 0), row_of(b, 0)
    assert abs(Fraction(float(gap)) - max(exact_gaps(*row))) <= careful_bound(*row)


def test_gap_bounds_and_best_faces(record_property: Record) -> None:
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
        near = Fraction(NEAR) * Fraction(size) / Fraction(scale)
        ratios.append(abs(face - max(gaps[:6])) / near)
    check_ratios(record_property, ratios)


def test_clearances(record_property: Record) -> None:
    moved = Moved(2, families=("ordinary scene", "edge against edge", "thin plates and rods"))
    a, b = moved.at(0.5 * moved.farthest)
    found = clearances(a, b).distances
    ratios = []
    for n, distance in enumerate(found.tolist()):
        row = row_of(a, n), row_of(b, n)
        expected = root(squared_distance(corners(row[0]), corners(row[1])))
        size = taxicab(offset(*row)) + extents(*row)
        ratios.append(abs(Fraction(distance) - expected) / (Fraction(PROVEN) * size))
    check_ratios(record_property, ratios)


def test_contact_depths(record_property: Record) -> None:
    moved = Moved(PAIRS)
    a, b = moved.at(np.linspace(0.01, 0.2, len(moved.a)) * moved.farthest)
    found = contacts(a, b)
    ratios = []
    for n in np.flatnonzero(found.counts):
        row = row_of(a, n), row_of(b, n)
        depth = max(-max(exact_gaps(*row)), Fraction(0))
        ratios.append(abs(Fraction(found.depths[n]) - depth) / careful_bound(*row))
    assert len(ratios) > 20
    check_ratios(record_property, ratios)


def test_rotations_of_quaternions(record_property: Record) -> None:
    quaternions = np.random.default_rng(3).normal(size=(500, 4))
    matrices = matrices_from_quaternions(unit_quaternions(quaternions))
    ratios = []
    for matrix in matrices:
        columns = [exact(column) for column in matrix.T]
        defect = max(abs(dot(u, v) - (u is v)) for u in columns for v in columns)
        ratios.append(defect / Fraction(ORTHONORMAL_ROUNDING))
    check_ratios(record_property, ratios)

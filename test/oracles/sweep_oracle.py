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

"""The slow, independent truth about moving boxes.

Without turning, in fractions: the corners of both boxes at the start and at the end are projected
on each of the 15 exact axes (`oracle.ExactPair`), and the times at which the intervals meet are
solved for exactly. Turning ones are sampled densely, poses by scipy's rotations or, for twists, in
extended precision, every sample judged by the certified verdicts. ``certain_overlap`` needs nothing
of the package: quaternions and separating axes in extended precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from convex_bodies import CORNER_SIGNS
from exact_vectors import dot, norm
from oracle import ExactPair
from scipy.spatial.transform import Rotation
from support import witnesses
from sweep_motions import places_at, turned_by

from obb_collision import Boxes, Verdict, verdicts
from obb_collision.queries.sweep import TOLERANCE, BodyMotion, Sweeps
from obb_collision.queries.sweep.rigid import TOLERANCE_FLOOR

Pair = tuple[Any, Any]
Rows = np.ndarray
#: Pairs at a time that are sampled at once: arrays that fit a processor's cache.
CHUNK = 2000
#: Depth (m) of an overlap that no rounding makes, of boxes of a metre: parallel edges whose cross
#: product is shorter than PARALLEL, and so no axis, hide less than a hundredth of it.
CERTAIN_DEPTH = 1e-6
PARALLEL = 1e-8


@dataclass
class ExactMotion:
    """Two boxes that move without turning: exactly when they meet, and how far apart they are."""

    spans: list[tuple[Fraction, Fraction, Fraction, Fraction, Fraction]]
    size: float

    @classmethod
    def of(cls, start: Pair, end: Pair) -> ExactMotion:
        """Both pairs of boxes (center, rotation, half extents) with equal rotations."""
        first, last = ExactPair(*start), ExactPair(*end)
        unit_first, unit_last = (Fraction(2) ** p.exponent for p in (first, last))
        spans = []
        for axis in first.candidate_axes():
            edges = [*_sides(first, axis), *_sides(last, axis)]
            values = [x * u for x, u in zip(edges, 2 * [unit_first] + 2 * [unit_last], strict=True)]
            spans.append((values[0], values[1], values[2], values[3], norm(axis)))
        size = float(sum(np.abs(p[1][0] - p[0][0]).sum() for p in (start, end)))
        size += float(start[0][2].sum() + start[1][2].sum())
        return cls(spans, size)

    def first_contact(self) -> Fraction | None:
        """Exact time in [0, 1] of the first common point, None if there is none."""
        enter, leave = Fraction(0), Fraction(1)
        for low_0, high_0, low_1, high_1, _ in self.spans:
            # apart while low > 0 (b beyond a) or high < 0 (b before a); both linear in time
            for x, y in ((low_0, low_1), (-high_0, -high_1)):
                if x > 0 and y > 0:
                    return None
                if x > 0:
                    enter = max(enter, x / (x - y))
                elif y > 0:
                    leave = min(leave, x / (x - y))
        return enter if enter <= leave else None

    def way(self, contact: Fraction) -> float:
        """How far along the axis entered last at that contact: its gap at the start, of `size`.

        The less it is, the more of a rounding shows in the time.
        """
        entered = [
            x / length
            for low_0, high_0, low_1, high_1, length in self.spans
            for x, y in ((low_0, low_1), (-high_0, -high_1))
            if x > 0 and x / (x - y) == contact
        ]
        return float(min(entered) / Fraction(self.size)) if entered else 0.0

    def gap(self, time: float) -> float:
        """Largest gap over the 15 unit axes at a time, relative to `size`."""
        t = Fraction(time)
        gaps = []
        for low_0, high_0, low_1, high_1, length in self.spans:
            low = low_0 + t * (low_1 - low_0)
            high = high_0 + t * (high_1 - high_0)
            gaps.append(max(low, -high) / length)
        return float(max(gaps) / Fraction(self.size)) if self.size else float(max(gaps))


def _sides(pair: ExactPair, axis: Any) -> tuple[int, int]:
    """Least and greatest of (point of b) - (point of a) along the axis."""
    a, b = ([dot(axis, p) for p in side] for side in (pair.corners_a, pair.corners_b))
    return min(b) - max(a), max(b) - min(a)


@dataclass(frozen=True)
class PoseCourse:
    """From poses at time 0 to poses at time 1: linear centre, shortest turn at constant speed.

    As all courses, it says where pairs are at a time, in a frame that goes with the first one.
    """

    start: Boxes
    end: Boxes

    @property
    def half_extents(self) -> Rows:
        """(n, 3) of the boxes."""
        return self.start.half_extents

    def pair_at(self, rows: Rows, times: Rows) -> tuple[Boxes, Boxes]:
        """Both boxes of pairs (m, 2) at times (m,)."""
        a, b = (self.boxes_at(rows[:, side], times) for side in (0, 1))
        return a, b

    def boxes_at(self, rows: Rows, times: Rows) -> Boxes:
        """Box rows[k] at times[k] of its motion: linear centre, shortest turn at constant speed."""
        start, end = self.start, self.end
        first = Rotation.from_matrix(start.rotations[rows])
        turn = (Rotation.from_matrix(end.rotations[rows]) * first.inv()).as_rotvec()
        rotations = (Rotation.from_rotvec(turn * times[:, None]) * first).as_matrix()
        centers = start.centers[rows] + times[:, None] * (end.centers[rows] - start.centers[rows])
        return Boxes(centers, rotations, start.half_extents[rows])

    def window(self, rows: Rows) -> tuple[Rows, Rows]:
        """(m,), (m,) times between which the spheres round both boxes meet."""
        offset, later = (b.centers[rows[:, 1]] - b.centers[rows[:, 0]]
                         for b in (self.start, self.end))  # fmt: skip
        reach = np.linalg.norm(self.half_extents, axis=1)[rows].sum(axis=1)
        return _meeting_window(offset, later - offset, reach, 1.0)


@dataclass(frozen=True)
class TwistCourse:
    """Boxes that keep twists (n, 6) of their origins (n, 3), in extended precision, relative.

    Only the place of b relative to a is computed: nothing far away is ever added up.
    """

    boxes: Boxes
    twists: Rows
    origins: Rows
    horizon: float

    @property
    def half_extents(self) -> Rows:
        """(n, 3) of the boxes."""
        return self.boxes.half_extents

    def pair_at(self, rows: Rows, times: Rows) -> tuple[Boxes, Boxes]:
        """Both boxes of pairs (m, 2) at times (m,)."""
        i, j = rows.T
        wide = times.astype(np.longdouble)[:, None]
        centers, speeds = (x.astype(np.longdouble) for x in (self.boxes.centers, self.twists))
        offset = centers[j] - centers[i] + (speeds[j, :3] - speeds[i, :3]) * wide
        turns = [turned_by(speeds[k, 3:] * wide) for k in (i, j)]
        arms = centers - self.origins.astype(np.longdouble)
        for sign, k, turn in ((-1, i, turns[0]), (1, j, turns[1])):
            offset += sign * (np.einsum("nij,nj->ni", turn, arms[k]) - arms[k])
        a, b = (
            Boxes(
                place.astype(np.float64),
                np.einsum("nij,njk->nik", turn, self.boxes.rotations[k]).astype(np.float64),
                self.half_extents[k],
            )
            for k, turn, place in ((i, turns[0], 0 * offset), (j, turns[1], offset))
        )
        return a, b

    def window(self, rows: Rows) -> tuple[Rows, Rows]:
        """(m,), (m,) times between which the spheres about the origins meet that hold the boxes."""
        arms = np.where(self.twists[:, 3:].any(axis=1, keepdims=True),
                        self.boxes.centers - self.origins, 0.0)  # fmt: skip
        i, j = rows.T
        offset = self.boxes.centers[j] - self.boxes.centers[i] - (arms[j] - arms[i])
        reach = np.linalg.norm(self.half_extents, axis=1) + np.linalg.norm(arms, axis=1)
        way = (self.twists[j, :3] - self.twists[i, :3]) * self.horizon
        first, last = _meeting_window(offset, way, reach[rows].sum(axis=1), 1.0)
        return first * self.horizon, last * self.horizon


Course = PoseCourse | TwistCourse


def first_sampled_contact(course: Course, rows: Rows, samples: int = 160) -> np.ndarray:
    """(m,) a time at which each pair certainly overlaps, near the first; infinity if none seen.

    Samples fill the time during which the boxes may meet. Where none overlaps,
    finer ones go between the neighbours of the one with the least gap, three times over. Then
    bisection between the first hit and the free sample before it.
    """
    first, last = course.window(rows)
    free, hit = first.copy(), np.full(len(rows), np.inf)
    for n in (samples, 24, 24, 24):
        unseen = np.flatnonzero(~np.isfinite(hit) & (first <= last))
        grid = np.linspace(first[unseen], last[unseen], n)
        gaps = _gaps_on(course, rows[unseen], grid)
        best = gaps.argmin(axis=0)
        every = np.arange(len(unseen))
        first[unseen] = grid[np.maximum(best - 1, 0), every]
        last[unseen] = grid[np.minimum(best + 1, n - 1), every]
        overlaps = gaps < -1e-13 * course.half_extents[rows[unseen]].sum(axis=(1, 2))
        seen = overlaps.any(axis=0)
        index = overlaps.argmax(axis=0)
        hit[unseen[seen]] = grid[index, every][seen]
        free[unseen[seen]] = grid[np.maximum(index - 1, 0), every][seen]
    found = np.flatnonzero(np.isfinite(hit))
    found = found[_overlap(course, rows[found], hit[found])]
    result = np.full(len(rows), np.inf)
    low, high = free[found], hit[found]
    for _ in range(40):
        middle = 0.5 * (low + high)
        colliding = _overlap(course, rows[found], middle)
        high = np.where(colliding, middle, high)
        low = np.where(colliding, low, middle)
    result[found] = high
    return result


def check_promises(
    course: Course,
    found: Sweeps,
    rows: Rows,
    samples: int = 160,
    tolerance: float = TOLERANCE,
) -> int:
    """Assert all that is promised of each pair; return how many certainly overlap at some time."""
    truth = first_sampled_contact(course, rows, samples)
    seen = np.isfinite(truth)
    assert (found.free_until[seen] <= truth[seen]).all(), "never late"
    assert (found.hits | found.undecided)[seen].all(), "none missed"
    assert (found.hits == np.isfinite(found.times)).all()
    assert not (found.hits & found.undecided).any()
    assert np.isnan(found.times[found.undecided]).all()
    assert np.isfinite(found.free_until[found.undecided]).all()
    assert np.isnan(found.positions[~found.hits]).all()
    hits = np.flatnonzero(found.hits)
    np.testing.assert_allclose(np.linalg.norm(found.normals[hits], axis=1), 1.0, atol=1e-14)
    assert np.isfinite(found.positions[hits]).all()
    times, early = found.times[hits], found.times[hits] > 0.0
    radii = np.linalg.norm(course.half_extents, axis=1)[rows[hits]] * (1.0 + 1e-14)
    near = np.maximum(tolerance * radii.min(axis=1), TOLERANCE_FLOOR * radii.max(axis=1))
    if isinstance(course, PoseCourse):
        ways = np.abs(course.end.centers - course.start.centers) + np.abs(course.start.centers)
        near += 1e-12 * ways[rows[hits]].sum(axis=(1, 2))
        early[:] = True
        for side in (0, 1):
            box = course.boxes_at(rows[hits, side], times)
            local = np.einsum("nji,nj->ni", box.rotations, found.positions[hits] - box.centers)
            # of thin boxes that overlap at the start it may be outside of one: see common_point
            reach = 3.0 * near + np.where(times == 0.0, 0.1 * radii.max(axis=1), 0.0)
            assert ((np.abs(local) - box.half_extents).max(axis=1) <= reach).all()
    assert (gaps_at(course, rows[hits], times) <= near)[early].all(), "never too early"
    return int(seen.sum())


def gaps_at(course: Course, rows: Rows, times: np.ndarray) -> np.ndarray:
    """(m,) largest gap of the 15 axes of each pair at its time, metres."""
    return witnesses(*course.pair_at(rows, times))[0]


def _gaps_on(course: Course, rows: Rows, grid: np.ndarray) -> np.ndarray:
    """Return gaps (samples, m) of each pair at the times of its column, many samples at once."""
    at_once = max(1, CHUNK // max(1, len(rows)))
    gaps = [
        gaps_at(course, np.tile(rows, (len(some), 1)), some.ravel()).reshape(some.shape)
        for some in np.split(grid, range(at_once, len(grid), at_once))
    ]
    return np.concatenate(gaps)


def _overlap(course: Course, rows: Rows, times: np.ndarray) -> np.ndarray:
    return np.asarray(verdicts(*course.pair_at(rows, times)) == Verdict.OVERLAP)


def _meeting_window(offset: Rows, way: Rows, reach: Rows, end: float) -> tuple[Rows, Rows]:
    square = np.maximum((way * way).sum(axis=1), 1e-300)
    middle = -(offset * way).sum(axis=1) / square
    nearest = np.linalg.norm(offset + middle[:, None] * way, axis=1)
    half = np.sqrt(np.maximum(reach**2 - nearest**2, 0.0) / square) * 1.001
    low, high = np.clip(middle - half, 0.0, end), np.clip(middle + half, 0.0, end)
    beyond = (nearest > reach) | (middle - half > end) | (middle + half < 0.0)
    return np.where(beyond, end, low), np.where(beyond, 0.0, high)


def certain_overlap(motion: BodyMotion, half: Rows, rows: Rows, rng: Any, samples: int) -> Rows:
    """(m,) a time at which boxes of half extents (n, 3) are deep in each other, else infinity.

    The last moment, then any moments, most of them late.
    """
    hit = np.full(len(rows), np.inf)
    for n in range(samples):
        left = np.flatnonzero(np.isinf(hit))
        times = 1.0 - rng.random(len(left)) ** 2 * (n > 0)
        deep = _depths(motion, half, rows[left], times) > CERTAIN_DEPTH
        hit[left[deep]] = times[deep]
    return hit


def _depths(motion: BodyMotion, half: Rows, rows: Rows, times: Rows) -> Rows:
    """(m,) least overlap of the corners of both boxes along the 15 axes."""
    (p, r), (q, s) = (places_at(motion, side, times) for side in rows.T)
    sides = r.transpose(0, 2, 1), s.transpose(0, 2, 1)
    edges = np.cross(sides[0][:, :, None], sides[1][:, None]).reshape(-1, 9, 3)
    lengths = np.sqrt((edges * edges).sum(axis=2))[..., None]
    edges = np.where(lengths > PARALLEL, edges / np.maximum(lengths, PARALLEL), sides[0][:, :1])
    axes = np.concatenate([*sides, edges], axis=1)
    a, b = (
        np.einsum("mki,mai->mak", np.einsum("mij,kmj->mki", turn, CORNER_SIGNS[:, None] * h), axes)
        for turn, h in ((r, half[rows[:, 0]]), (s, half[rows[:, 1]]))
    )
    b += np.einsum("mi,mai->ma", q - p, axes)[..., None]
    depths: Rows = np.minimum(a.max(axis=2) - b.min(axis=2), b.max(axis=2) - a.min(axis=2))
    return depths.min(axis=1)

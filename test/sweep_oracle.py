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
solved for exactly. Turning ones are sampled densely, poses by scipy's rotations, every sample
judged by the certified verdicts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from oracle import ExactPair
from scipy.spatial.transform import Rotation
from support import sizes, witnesses

from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.separation import Verdict, verdicts

Pair = tuple[Any, Any]
Rows = np.ndarray


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
            norm = Fraction(math.isqrt(sum(k * k for k in axis) << 128), 1 << 64)
            spans.append((values[0], values[1], values[2], values[3], norm))
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
            x / norm
            for low_0, high_0, low_1, high_1, norm in self.spans
            for x, y in ((low_0, low_1), (-high_0, -high_1))
            if x > 0 and x / (x - y) == contact
        ]
        return float(min(entered) / Fraction(self.size)) if entered else 0.0

    def gap(self, time: float) -> float:
        """Largest gap over the 15 unit axes at a time, relative to `size`."""
        t = Fraction(time)
        gaps = []
        for low_0, high_0, low_1, high_1, norm in self.spans:
            low = low_0 + t * (low_1 - low_0)
            high = high_0 + t * (high_1 - high_0)
            gaps.append(max(low, -high) / norm)
        return float(max(gaps) / Fraction(self.size)) if self.size else float(max(gaps))


def _sides(pair: ExactPair, axis: Any) -> tuple[int, int]:
    """Least and greatest of (point of b) - (point of a) along the axis."""
    a, b = ([sum(n * x for n, x in zip(axis, p, strict=True)) for p in side]
            for side in (pair.corners_a, pair.corners_b))  # fmt: skip
    return min(b) - max(a), max(b) - min(a)


def poses_at(start: Boxes, end: Boxes, rows: np.ndarray, times: np.ndarray) -> Boxes:
    """Box rows[k] at times[k] of its motion: linear centre, shortest turn at constant speed."""
    first = Rotation.from_matrix(start.rotations[rows])
    turn = (Rotation.from_matrix(end.rotations[rows]) * first.inv()).as_rotvec()
    rotations = (Rotation.from_rotvec(turn * times[:, None]) * first).as_matrix()
    way = end.centers[rows] - start.centers[rows]
    return Boxes(start.centers[rows] + times[:, None] * way, rotations, start.half_extents[rows])


def first_sampled_contact(start: Boxes, end: Boxes, rows: Rows, samples: int = 160) -> np.ndarray:
    """(m,) a time at which each pair certainly overlaps, near the first; infinity if none seen.

    Samples fill the time during which the spheres round both boxes meet. Where none overlaps,
    finer ones go between the neighbours of the one with the least gap, three times over. Then
    bisection between the first hit and the free sample before it.
    """
    first, last = _meeting_window(start, end, rows)
    free, hit = first.copy(), np.full(len(rows), np.inf)
    for n in (samples, 24, 24, 24):
        unseen = np.flatnonzero(~np.isfinite(hit) & (first <= last))
        grid = np.linspace(first[unseen], last[unseen], n)
        gaps = np.array([_gaps(start, end, rows[unseen], times)[0] for times in grid])
        best = gaps.argmin(axis=0)
        every = np.arange(len(unseen))
        first[unseen] = grid[np.maximum(best - 1, 0), every]
        last[unseen] = grid[np.minimum(best + 1, n - 1), every]
        overlaps = gaps < -1e-13 * sizes(start.take(rows[unseen, 0]), start.take(rows[unseen, 1]))
        seen = overlaps.any(axis=0)
        index = overlaps.argmax(axis=0)
        hit[unseen[seen]] = grid[index, every][seen]
        free[unseen[seen]] = grid[np.maximum(index - 1, 0), every][seen]
    found = np.flatnonzero(np.isfinite(hit))
    found = found[_overlap(start, end, rows[found], hit[found])]
    result = np.full(len(rows), np.inf)
    low, high = free[found], hit[found]
    for _ in range(40):
        middle = 0.5 * (low + high)
        colliding = _overlap(start, end, rows[found], middle)
        high = np.where(colliding, middle, high)
        low = np.where(colliding, low, middle)
    result[found] = high
    return result


def gaps_at(start: Boxes, end: Boxes, rows: Rows, times: np.ndarray) -> np.ndarray:
    """(m,) largest gap of the 15 axes of each pair at its time, metres."""
    return _gaps(start, end, rows, times)[0]


def _gaps(start: Boxes, end: Boxes, rows: Rows, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a, b = (poses_at(start, end, rows[:, side], times) for side in (0, 1))
    return witnesses(a, b)


def _overlap(start: Boxes, end: Boxes, rows: Rows, times: np.ndarray) -> np.ndarray:
    a, b = (poses_at(start, end, rows[:, side], times) for side in (0, 1))
    result: np.ndarray = verdicts(a, b) == Verdict.OVERLAP
    return result


def _meeting_window(start: Boxes, end: Boxes, rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    offset, later = (b.centers[rows[:, 1]] - b.centers[rows[:, 0]] for b in (start, end))
    way = later - offset
    reach = np.linalg.norm(start.half_extents, axis=1)[rows].sum(axis=1)
    square = np.maximum((way * way).sum(axis=1), 1e-300)
    middle = -(offset * way).sum(axis=1) / square
    nearest = np.linalg.norm(offset + middle[:, None] * way, axis=1)
    half = np.sqrt(np.maximum(reach**2 - nearest**2, 0.0) / square) * 1.001
    low, high = np.clip(middle - half, 0.0, 1.0), np.clip(middle + half, 0.0, 1.0)
    beyond = (nearest > reach) | (middle - half > 1.0) | (middle + half < 0.0)
    return np.where(beyond, 1.0, low), np.where(beyond, 0.0, high)

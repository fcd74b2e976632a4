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

from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.separation import Verdict, verdicts

Pair = tuple[Any, Any]


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

    def gap(self, time: float) -> float:
        """Largest gap over the 15 unit axes at a time, relative to `size`."""
        t = Fraction(time)
        gaps = []
        for low_0, high_0, low_1, high_1, norm in self.spans:
            low = low_0 + t * (low_1 - low_0)
            high = high_0 + t * (high_1 - high_0)
            gaps.append(max(low, -high) / norm)
        return float(max(gaps) / Fraction(self.size))


def _sides(pair: ExactPair, axis: Any) -> tuple[int, int]:
    """Least and greatest of (point of b) - (point of a) along the axis."""
    a, b = ([sum(n * x for n, x in zip(axis, p, strict=True)) for p in side]
            for side in (pair.corners_a, pair.corners_b))  # fmt: skip
    return min(b) - max(a), max(b) - min(a)


def poses_at(start: Boxes, end: Boxes, times: np.ndarray) -> Boxes:
    """Box k at times[k] of its motion: linear centre, shortest turn at constant speed."""
    first = Rotation.from_matrix(start.rotations)
    turn = (Rotation.from_matrix(end.rotations) * first.inv()).as_rotvec()
    rotations = (Rotation.from_rotvec(turn * times[:, None]) * first).as_matrix()
    centers = start.centers + times[:, None] * (end.centers - start.centers)
    return Boxes(centers, rotations, start.half_extents)


def first_sampled_contact(
    start: tuple[Boxes, Boxes], end: tuple[Boxes, Boxes], samples: int
) -> np.ndarray:
    """(n,) a time at which each pair certainly overlaps, near the first; infinity if none seen.

    ``samples`` times in [0, 1], then bisection between the last free one and the first hit.
    """
    n = len(start[0])
    free, hit = np.zeros(n), np.full(n, np.inf)
    for time in np.linspace(0.0, 1.0, samples):
        unseen = np.flatnonzero(~np.isfinite(hit))
        colliding = _overlap(start, end, unseen, np.full(len(unseen), time))
        hit[unseen[colliding]] = time
        free[unseen[~colliding]] = time
    rows = np.flatnonzero(np.isfinite(hit) & (hit > 0.0))
    for _ in range(40):
        middle = 0.5 * (free[rows] + hit[rows])
        colliding = _overlap(start, end, rows, middle)
        hit[rows[colliding]] = middle[colliding]
        free[rows[~colliding]] = middle[~colliding]
    return hit


def _overlap(
    start: tuple[Boxes, Boxes], end: tuple[Boxes, Boxes], rows: np.ndarray, times: np.ndarray
) -> np.ndarray:
    a, b = (poses_at(s.take(rows), e.take(rows), times) for s, e in zip(start, end, strict=True))
    return verdicts(a, b) == Verdict.OVERLAP

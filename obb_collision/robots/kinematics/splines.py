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

"""Splines of joints, approximated by short straight motions.

Between two points joints move as ``joint_trajectory_controller`` interpolates: linearly by
positions, by cubic polynomials with velocities, by quintic ones with accelerations, too. A function
whose second derivative is at most m deviates from the chord of an interval h by at most m h^2 / 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from obb_collision.typing import Floats, Integers, Mask, Rows

LINEAR, CUBIC, QUINTIC = "linear", "cubic", "quintic"
DEVIATION_GROWTH = 1.0 + 1e-6
"""Relative growth of deviations: more than the roundings of polynomials."""


class Point(NamedTuple):
    """Joints (j,) at a time (s); velocities and accelerations are None if a message has none."""

    time: float
    positions: Floats
    velocities: Floats | None = None
    accelerations: Floats | None = None


class Pieces(NamedTuple):
    """Straight motions (p,): joints (p, j) and times (p,) at both ends, and their segments (p,)."""

    starts: Floats
    ends: Floats
    begins: Floats
    finishes: Floats
    segments: Integers

    def take(self, rows: Mask | Rows) -> Pieces:
        """Return the pieces of some rows."""
        return Pieces._make(column[rows] for column in self)


class SplineSegments(NamedTuple):
    """Polynomials in the time since the start: coefficients (n, 6, j), durations (n,) in s."""

    coefficients: Floats
    durations: Floats

    def at(self, rows: Rows, times: Floats) -> Floats:
        """Return the joints (m, j) at times (m,) of segments (m,)."""
        powers = times[:, None] ** np.arange(6)
        values: Floats = np.einsum("mk,mkj->mj", powers, self.coefficients[rows])
        return values

    def deviations(self) -> Floats:
        """Return bounds (n, j) of how far each joint is from the chord of a segment."""
        k = np.arange(2, 6)
        scales = k * (k - 1) * self.durations[:, None] ** (k - 2.0)
        most = (scales[..., None] * np.abs(self.coefficients[:, 2:])).sum(axis=1)
        bounds: Floats = most * (self.durations[:, None] ** 2 / 8.0) * DEVIATION_GROWTH
        return bounds


def interpolation(first: Point, last: Point) -> str:
    """Return the kind of polynomial between two points."""
    if first.velocities is None or last.velocities is None:
        return LINEAR
    return CUBIC if first.accelerations is None or last.accelerations is None else QUINTIC


def segments_between(points: Sequence[Point]) -> SplineSegments:
    """Return the polynomials between consecutive points, at ascending times."""
    times = np.array([point.time for point in points])
    positions = np.array([point.positions for point in points])
    t, step = np.diff(times)[:, None], np.diff(positions, axis=0)
    zero = np.zeros(positions.shape[1])
    velocities, accelerations = (
        np.array([zero if values is None else values for values in column])
        for column in ([p.velocities for p in points], [p.accelerations for p in points])
    )
    (v, w), (a, b) = ((rates[:-1], rates[1:]) for rates in (velocities, accelerations))
    c = np.zeros((len(t), 6, positions.shape[1]))
    c[:, 0] = positions[:-1]
    kinds = np.array([interpolation(*pair) for pair in pairwise(points)])[:, None]
    linear, cubic, quintic = (kinds == kind for kind in (LINEAR, CUBIC, QUINTIC))
    c[:, 1] = np.where(linear, step / t, v)
    c[:, 2] = np.where(
        cubic, 3.0 * step / t**2 - (2.0 * v + w) / t, np.where(quintic, 0.5 * a, 0.0)
    )
    fast = (20.0 * step - (8.0 * w + 12.0 * v) * t - (3.0 * a - b) * t**2) / (2.0 * t**3)
    c[:, 3] = np.where(quintic, fast, np.where(cubic, -2.0 * step / t**3 + (v + w) / t**2, 0.0))
    fast = (-30.0 * step + (14.0 * w + 16.0 * v) * t + (3.0 * a - 2.0 * b) * t**2) / (2.0 * t**4)
    c[:, 4] = np.where(quintic, fast, 0.0)
    fast = (12.0 * step - 6.0 * (w + v) * t + (b - a) * t**2) / (2.0 * t**5)
    c[:, 5] = np.where(quintic, fast, 0.0)
    return SplineSegments(c, t[:, 0])


def straight_pieces(points: Sequence[Point], counts: Integers) -> Pieces:
    """Return chords of the segments between points; segment k is divided into counts[k] parts."""
    segments, rows = segments_between(points), np.repeat(np.arange(len(counts)), counts)
    numbers = np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)
    times = np.array([point.time for point in points])
    positions = np.array([point.positions for point in points])
    steps = segments.durations / counts
    befores, afters = numbers * steps[rows], (numbers + 1) * steps[rows]
    starts, ends = segments.at(rows, befores), segments.at(rows, afters)
    first, last = numbers == 0, numbers == counts[rows] - 1
    afters[last] = segments.durations
    starts[first], ends[last] = positions[:-1], positions[1:]
    begins = times[:-1][rows]
    return Pieces(starts, ends, begins + befores, begins + afters, rows)


def state_at(points: Sequence[Point], time: float) -> Floats:
    """Return joint positions (j,) at a time after the first point; beyond the last they rest."""
    for first, last in pairwise(points):
        if time < last.time:
            since = np.array([time - first.time])
            return segments_between((first, last)).at(np.array([0]), since)[0]
    return points[-1].positions


def with_jump(pieces: Pieces, here: Floats, points: Sequence[Point], time: float) -> Pieces:
    """Return pieces and a jump at a time, from the joints ``here`` to those of the points."""
    times, segment = np.array([time]), np.array([0])
    jump = Pieces(here[None], state_at(points, time)[None], times, times, segment)
    return Pieces(*(np.concatenate(pair) for pair in zip(pieces, jump, strict=True)))


def distances_from(pieces: Pieces, state: Floats) -> Floats:
    """Return the largest distance (p,) of a joint of a state (j,) from each piece.

    It is measured at the point of the piece that is nearest by the sum of squares.
    """
    ways = pieces.ends - pieces.starts
    lengths = (ways * ways).sum(axis=1)
    along = ((state - pieces.starts) * ways).sum(axis=1) / np.where(lengths > 0.0, lengths, 1.0)
    nearest = pieces.starts + np.clip(along, 0.0, 1.0)[:, None] * ways
    distances: Floats = np.abs(nearest - state).max(axis=1, initial=0.0)
    return distances

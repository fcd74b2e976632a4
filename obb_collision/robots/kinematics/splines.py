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

"""Splines of joints as short straight motions that they stay near to.

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
    """Joints (j,) at a time (s); velocities and accelerations None where they are not given."""

    time: float
    positions: Floats
    velocities: Floats | None = None
    accelerations: Floats | None = None


class Pieces(NamedTuple):
    """Straight motions (p): starts, ends (p, j), their times (p,), the segment (p,) of each."""

    starts: Floats
    ends: Floats
    begins: Floats
    finishes: Floats
    segments: Integers

    def take(self, rows: Mask | Rows) -> Pieces:
        """Return some of them."""
        starts, ends, begins, finishes, segments = self
        return Pieces(starts[rows], ends[rows], begins[rows], finishes[rows], segments[rows])


class Segment(NamedTuple):
    """Coefficients (6, j) of polynomials in the time since the start, and the duration (s)."""

    coefficients: Floats
    duration: float

    def at(self, times: Floats) -> Floats:
        """Return the joints (n, j) at times (n,)."""
        powers = times[:, None] ** np.arange(6)
        values: Floats = powers @ self.coefficients
        return values

    def deviations(self) -> Floats:
        """Return how far each joint (j,) can be from the chord of the whole segment."""
        k = np.arange(2, 6)
        scales = k * (k - 1) * self.duration ** (k - 2.0)
        most = (scales[:, None] * np.abs(self.coefficients[2:])).sum(axis=0)
        bounds: Floats = most * (self.duration**2 / 8.0) * DEVIATION_GROWTH
        return bounds


def interpolation(first: Point, last: Point) -> str:
    """Return how joints move between two points."""
    if first.velocities is None or last.velocities is None:
        return LINEAR
    return CUBIC if first.accelerations is None or last.accelerations is None else QUINTIC


def segment_between(first: Point, last: Point) -> Segment:
    """Return the polynomials between two points at different times."""
    t, step = last.time - first.time, last.positions - first.positions
    c = np.zeros((6, len(step)))
    c[0] = first.positions
    kind = interpolation(first, last)
    if kind == LINEAR:
        c[1] = step / t
        return Segment(c, t)
    v, w = first.velocities, last.velocities
    assert v is not None
    assert w is not None
    c[1] = v
    if kind == CUBIC:
        c[2] = 3.0 * step / t**2 - (2.0 * v + w) / t
        c[3] = -2.0 * step / t**3 + (v + w) / t**2
        return Segment(c, t)
    a, b = first.accelerations, last.accelerations
    assert a is not None
    assert b is not None
    c[2] = 0.5 * a
    c[3] = (20.0 * step - (8.0 * w + 12.0 * v) * t - (3.0 * a - b) * t**2) / (2.0 * t**3)
    c[4] = (-30.0 * step + (14.0 * w + 16.0 * v) * t + (3.0 * a - 2.0 * b) * t**2) / (2.0 * t**4)
    c[5] = (12.0 * step - 6.0 * (w + v) * t + (b - a) * t**2) / (2.0 * t**5)
    return Segment(c, t)


def straight_pieces(points: Sequence[Point], counts: Sequence[int]) -> Pieces:
    """Return the chords of segments between points, each divided into a number of parts."""
    starts, ends, begins, finishes, segments = [], [], [], [], []
    pairs = zip(points[:-1], points[1:], counts, strict=True)
    for number, (first, last, count) in enumerate(pairs):
        segment = segment_between(first, last)
        times = np.linspace(0.0, segment.duration, count + 1)
        states = segment.at(times)
        states[0], states[-1] = first.positions, last.positions
        starts.append(states[:-1])
        ends.append(states[1:])
        begins.append(first.time + times[:-1])
        finishes.append(first.time + times[1:])
        segments.append(np.full(count, number))
    return Pieces(*(np.concatenate(part) for part in (starts, ends, begins, finishes, segments)))


def state_at(points: Sequence[Point], time: float) -> Floats:
    """Return the joints (j,) at a time not before the first point; those of the last after it."""
    for first, last in pairwise(points):
        if time < last.time:
            return segment_between(first, last).at(np.array([time - first.time]))[0]
    return points[-1].positions


def with_jump(pieces: Pieces, here: Floats, points: Sequence[Point], time: float) -> Pieces:
    """Return pieces with a jump at a time: from joints that are here to where the points are."""
    times, segment = np.array([time]), np.array([0])
    jump = Pieces(here[None], state_at(points, time)[None], times, times, segment)
    return Pieces(*(np.concatenate(pair) for pair in zip(pieces, jump, strict=True)))


def distances_from(pieces: Pieces, state: Floats) -> Floats:
    """Return how far the joints of a state (j,) are from each piece (p,): the farthest of them.

    From the point of the piece that is nearest by the sum of squares.
    """
    ways = pieces.ends - pieces.starts
    lengths = (ways * ways).sum(axis=1)
    along = ((state - pieces.starts) * ways).sum(axis=1) / np.where(lengths > 0.0, lengths, 1.0)
    nearest = pieces.starts + np.clip(along, 0.0, 1.0)[:, None] * ways
    distances: Floats = np.abs(nearest - state).max(axis=1, initial=0.0)
    return distances

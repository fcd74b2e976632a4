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

"""Checks of motions: by kernels with hulls, and by meshes where the hulls of meshes may collide.

The intervals of pairs that hulls leave open are checked in their middle, many at once. The distance
of the meshes there proves the part of the interval free in which the pair moves less.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import Held
from obb_collision._threads import run
from obb_collision.accuracy import Accuracy
from obb_collision.robots.checks.distances import hull_distances
from obb_collision.robots.checks.meshes import set_mesh_distances
from obb_collision.robots.checks.model import Prepared
from obb_collision.robots.checks.motion_room import MotionHits, MovingPairs
from obb_collision.robots.checks.motions import PROBES, motions_kernel, moves_kernel
from obb_collision.robots.checks.reports import MotionReport
from obb_collision.robots.checks.states import check_states
from obb_collision.typing import Floats, Integers, Mask, Rows

#: Maximum number of rounds; motions that are open then are undecided.
MOST_ROUNDS = 2000
#: Intervals of a motion in one round: the earliest; later ones may lie behind a collision.
AT_ONCE = 4
#: Relative shrinkage of times, for roundings.
SHORTER = 1.0 - 1e-9
#: Minimum number of motions for a second thread.
FEWEST_MOTIONS = 16
#: No room for pairs and intervals, see ``OpenSpans``.
NO_SPANS: tuple[Integers, Floats] = np.empty((0, 3), np.int64), np.empty((0, 2))


class Motions(NamedTuple):
    """Motions as kernels take them; question: the fields of ``MotionQuestion`` after the first."""

    held: Held
    question: tuple[int, bool, float, Floats, Floats]


class Spans(NamedTuple):
    """Open intervals of pairs, which are candidates of ``MotionRoom``."""

    motions: Rows  #: (m,)
    pairs: Integers  #: (m, 3)
    times: Floats  #: (m, 2)
    collide: Mask  #: (m,) whether the meshes collide at the end

    def take(self, rows: Rows | Mask) -> Spans:
        """Return the intervals of some rows."""
        return Spans._make(column[rows] for column in self)

    def joined(self, others: Spans) -> Spans:
        """Return these intervals and others."""
        return Spans._make(map(np.concatenate, zip(self, others, strict=True)))


def check_motions(
    prepared: Prepared,
    accuracy: Accuracy,
    starts: Floats,
    ends: Floats,
    resolution: float,
    first: bool,
) -> MotionReport:
    """Return which motions from starts to ends (n, joints) are valid.

    first: whether to find the first collision of each motion, instead of any.
    """
    count, held = len(starts), prepared.moving(accuracy)
    motions = Motions(held, (int(accuracy), first, resolution, starts, ends))
    hits = np.empty(count), np.empty(count, np.bool_), np.empty((count, 2), np.int64)
    counts = np.zeros(count, np.int64)
    run(motions_kernel, count, FEWEST_MOTIONS, *motions, hits, (counts, counts, *NO_SPANS))
    total = int(counts.sum()) if accuracy == Accuracy.MESH else 0
    if total:
        pairs, times = np.empty((total, 3), np.int64), np.empty((total, 2))
        spans = counts, np.cumsum(counts), pairs, times
        run(motions_kernel, count, FEWEST_MOTIONS, *motions, hits, spans)
        rows = np.repeat(np.arange(count), counts)
        open_ = Spans(rows, pairs, times, np.zeros(total, bool))
        _decide_meshes(prepared, motions, MotionHits(*hits), open_)
    out = prepared.limits.exceeded(starts, ends)
    fractions, undecided, bodies = hits
    pairs, joints = prepared.owners_of(bodies), prepared.joint_names
    return MotionReport(fractions, undecided, out, pairs, prepared.names, joints)


def displacements(prepared: Prepared, states: Floats, deviations: Floats) -> Floats:
    """Return bounds (n,) of how far a point of a body moves if joints move by deviations (n, j).

    states (m, joints): joints stay between them; no joint may be planar or floating.
    """
    begin = np.tile(np.abs(states).max(axis=0, initial=0.0), (len(deviations), 1))
    question = int(Accuracy.HULL), False, 0.0, begin, begin + np.abs(deviations)
    motions, rows = Motions(prepared.moving(Accuracy.HULL), question), np.arange(len(deviations))
    return _moves(motions, rows, np.full((len(rows), 3), -1), np.zeros((len(rows), 2)))[:, 0]


def _moves(motions: Motions, rows: Rows, pairs: Integers, times: Floats) -> Floats:
    """Return (k, 2) how far pairs (k, 3) move between times (k, 2), and how far off the line."""
    moving = MovingPairs(rows, pairs, times, np.empty((len(rows), 2)))
    run(moves_kernel, len(rows), FEWEST_MOTIONS, *motions, moving)
    return moving.moves


def _decide_meshes(prepared: Prepared, motions: Motions, hits: MotionHits, spans: Spans) -> None:
    """Decide open intervals by meshes; write where motions collide."""
    limits = np.where(np.isnan(hits.fractions), np.inf, hits.fractions)
    first = motions.question[1]
    for step in range(MOST_ROUNDS):
        open_ = spans.times[:, 0] < limits[spans.motions]
        if not first:
            open_ &= np.isinf(limits[spans.motions])
        spans = spans.take(open_)
        if len(spans.motions) == 0:
            break
        order = np.lexsort([spans.times[:, 0], spans.motions])
        ranks = np.arange(len(order)) - np.searchsorted(spans.motions[order], spans.motions[order])
        earliest, later = spans.take(order[ranks < AT_ONCE]), spans.take(order[ranks >= AT_ONCE])
        ended, rest = _halved(prepared, motions, earliest, step == MOST_ROUNDS - 1)
        ended = ended.take(np.argsort(-ended.times))  # the earliest overwrites the others
        limits[ended.motions], hits.undecided[ended.motions] = ended.times, ~ended.collide
        hits.pairs[ended.motions] = ended.pairs[:, :2]
        spans = later.joined(rest)
    hits.fractions[:] = np.where(np.isinf(limits), np.nan, limits)
    unsure = np.flatnonzero(hits.undecided)
    hits.undecided[unsure] = ~_collide_after(prepared, motions, unsure, limits[unsure])


def _halved(
    prepared: Prepared, motions: Motions, spans: Spans, is_last: bool
) -> tuple[Spans, Spans]:
    """Return collisions and undecided times (instead of intervals), and the intervals left."""
    rows, pairs, (first, last) = spans.motions, spans.pairs, spans.times.T
    _, where, resolution, starts, ends = motions.question
    count, middle = len(rows), 0.5 * (first + last)
    starts, ends = starts[rows], ends[rows]
    states = np.ascontiguousarray(starts + middle[:, None] * (ends - starts))
    times = np.column_stack([np.append(first, middle), np.append(middle, last)])
    moves = _moves(motions, np.tile(rows, 2), np.tile(pairs, (2, 1)), times)
    way, bend = moves.reshape(2, count, 2).max(axis=0).T
    limit = float((way + bend).max())
    bodies = np.where(pairs[:, 2:] < 0, pairs[:, 1::-1], pairs[:, :2])
    near = hull_distances(prepared, states, bodies, limit)
    set_mesh_distances(prepared, states, bodies, near, limit, depths=False)
    collide, free = near.upper <= 0.0, near.lower > way + bend
    ended = (way + bend <= resolution) | ~((first < middle) & (middle < last)) | is_last
    stop = ~free & (ended | (collide & (not where)))
    at = np.where(ended, first, middle)
    hits = Spans(rows, pairs, at, collide | spans.collide).take(stop)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(way > 0.0, (near.lower - bend) / way, 0.0)
    room = SHORTER * 0.5 * (last - first) * np.clip(share, 0.0, 1.0)
    left = np.column_stack([first, np.where(collide, middle, middle - room)])
    right = np.column_stack([middle + room, last])
    before = Spans(rows, pairs, left, collide).take(~free & ~stop)
    after = Spans(rows, pairs, right, spans.collide).take(~free & ~stop & ~collide)
    return hits, before.joined(after)


def _collide_after(prepared: Prepared, motions: Motions, rows: Rows, times: Floats) -> Mask:
    """Return whether motions (k,) collide soon after times (k,)."""
    collide, (*_, starts, ends) = np.zeros(len(rows), np.bool_), motions.question
    for probe in range(PROBES):
        after = times + 2.0 ** (probe - PROBES - 4)
        left = np.flatnonzero(~collide & (after <= 1.0))
        k = rows[left]
        states = starts[k] + after[left, None] * (ends[k] - starts[k])
        collide[left] = check_states(prepared, Accuracy.MESH, states, False).colliding
    return collide

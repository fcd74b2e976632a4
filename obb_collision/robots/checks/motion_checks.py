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

"""Checks of motions: by kernels, and where hulls of meshes may collide by the meshes.

Intervals of pairs that hulls leave open are looked at in their middle, many at once: the distance
of the meshes there is a proof for the part around in which the pair moves less.
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

#: Rounds after which what is not free is undecided.
MOST_ROUNDS = 2000
#: Intervals of a motion in one round: the earliest ones; others may lie behind a collision.
AT_ONCE = 4
#: What is left of a time when it is rounded.
SHORTER = 1.0 - 1e-9
#: Motions below which a second thread does not pay.
FEWEST_MOTIONS = 16
#: No room for pairs and intervals.
NO_SPANS: tuple[Integers, Floats] = np.empty((0, 3), np.int64), np.empty((0, 2))


class Motions(NamedTuple):
    """Motions as kernels take them; asked: the fields of ``MotionQuestion`` but the first."""

    held: Held
    asked: tuple[int, bool, float, Floats, Floats]


class Spans(NamedTuple):
    """Intervals (m, 2) of pairs (m, 3), candidates of ``MotionRoom``, that are not decided."""

    motions: Rows
    pairs: Integers
    times: Floats
    collide: Mask  #: whether the meshes collide at the end

    def take(self, rows: Rows | Mask) -> Spans:
        """Return some of them."""
        return Spans._make(column[rows] for column in self)

    def joined(self, others: Spans) -> Spans:
        """Return others behind these."""
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

    first: whether where each first collides is asked for, or anywhere.
    """
    count, held = len(starts), prepared.moving(accuracy)
    question = Motions(held, (int(accuracy), first, resolution, starts, ends))
    found = np.empty(count), np.empty(count, np.bool_), np.empty((count, 2), np.int64)
    counts = np.zeros(count, np.int64)
    spans = counts, counts, *NO_SPANS
    run(motions_kernel, count, FEWEST_MOTIONS, *question, found, spans)
    total = int(counts.sum()) if accuracy == Accuracy.MESH else 0
    if total:
        pairs, times = np.empty((total, 3), np.int64), np.empty((total, 2))
        spans = counts, np.cumsum(counts), pairs, times
        run(motions_kernel, count, FEWEST_MOTIONS, *question, found, spans)
        motions = np.repeat(np.arange(count), counts)
        open_ = Spans(motions, pairs, times, np.zeros(total, bool))
        _decide_meshes(prepared, question, MotionHits(*found), open_)
    out = prepared.limits.exceeded(starts, ends)
    fractions, undecided, bodies = found
    pairs, joints = prepared.owners_of(bodies), prepared.joint_names
    return MotionReport(fractions, undecided, out, pairs, prepared.names, joints)


def displacements(prepared: Prepared, states: Floats, deviations: Floats) -> Floats:
    """Return (n,) how far any point of a body moves at most if joints do by deviations (n, j).

    states (m, joints): between which joints are; no joint may be planar or floating.
    """
    begin = np.tile(np.abs(states).max(axis=0, initial=0.0), (len(deviations), 1))
    asked = int(Accuracy.HULL), False, 0.0, begin, begin + np.abs(deviations)
    question = Motions(prepared.moving(Accuracy.HULL), asked)
    rows = np.arange(len(deviations))
    return _moves(question, rows, np.full((len(rows), 3), -1), np.zeros((len(rows), 2)))[:, 0]


def _moves(question: Motions, motions: Rows, pairs: Integers, times: Floats) -> Floats:
    """Return (k, 2) how far pairs (k, 3) move between times (k, 2), and how far off the line."""
    moving = MovingPairs(motions, pairs, times, np.empty((len(motions), 2)))
    run(moves_kernel, len(motions), FEWEST_MOTIONS, *question, moving)
    return moving.moves


def _decide_meshes(prepared: Prepared, question: Motions, hits: MotionHits, spans: Spans) -> None:
    """Decide intervals by meshes, and write where motions collide by these."""
    limits = np.where(np.isnan(hits.fractions), np.inf, hits.fractions)
    first = question.asked[1]
    for step in range(MOST_ROUNDS):
        open_ = spans.times[:, 0] < limits[spans.motions]
        if not first:
            open_ &= np.isinf(limits[spans.motions])
        spans = spans.take(open_)
        if len(spans.motions) == 0:
            break
        order = np.lexsort([spans.times[:, 0], spans.motions])
        ranks = np.arange(len(order)) - np.searchsorted(spans.motions[order], spans.motions[order])
        some, later = spans.take(order[ranks < AT_ONCE]), spans.take(order[ranks >= AT_ONCE])
        found, rest = _halved(prepared, question, some, step == MOST_ROUNDS - 1)
        latest_first = np.argsort(-found.times)
        for values, new in ((limits, found.times), (hits.undecided, ~found.collide)):
            values[found.motions[latest_first]] = new[latest_first]
        hits.pairs[found.motions[latest_first]] = found.pairs[latest_first, :2]
        spans = later.joined(rest)
    hits.fractions[:] = np.where(np.isinf(limits), np.nan, limits)
    unsure = np.flatnonzero(hits.undecided)
    hits.undecided[unsure] = ~_collide_after(prepared, question, unsure, limits[unsure])


def _halved(
    prepared: Prepared, question: Motions, spans: Spans, is_last: bool
) -> tuple[Spans, Spans]:
    """Return where motions certainly collide or are undecided, and the intervals that are left."""
    motions, pairs, (first, last) = spans.motions, spans.pairs, spans.times.T
    _, where, resolution, starts, ends = question.asked
    count, middle = len(motions), 0.5 * (first + last)
    starts, ends = starts[motions], ends[motions]
    states = np.ascontiguousarray(starts + middle[:, None] * (ends - starts))
    times = np.column_stack([np.append(first, middle), np.append(middle, last)])
    moves = _moves(question, np.tile(motions, 2), np.tile(pairs, (2, 1)), times)
    way, bend = moves.reshape(2, count, 2).max(axis=0).T
    limit = float((way + bend).max())
    bodies = np.where(pairs[:, 2:] < 0, pairs[:, 1::-1], pairs[:, :2])
    found = hull_distances(prepared, states, bodies, limit)
    set_mesh_distances(prepared, states, bodies, found, limit, depths=False)
    collide, free = found.upper <= 0.0, found.lower > way + bend
    ended = (way + bend <= resolution) | ~((first < middle) & (middle < last)) | is_last
    stop = ~free & (ended | (collide & (not where)))
    at = np.where(ended, first, middle)
    hits = Spans(motions, pairs, at, collide | spans.collide).take(stop)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(way > 0.0, (found.lower - bend) / way, 0.0)
    room = SHORTER * 0.5 * (last - first) * np.clip(share, 0.0, 1.0)
    left = np.column_stack([first, np.where(collide, middle, middle - room)])
    right = np.column_stack([middle + room, last])
    before = Spans(motions, pairs, left, collide).take(~free & ~stop)
    after = Spans(motions, pairs, right, spans.collide).take(~free & ~stop & ~collide)
    return hits, before.joined(after)


def _collide_after(prepared: Prepared, question: Motions, rows: Rows, times: Floats) -> Mask:
    """Return whether states of motions (k,) collide soon after times."""
    collide, (*_, starts, ends) = np.zeros(len(rows), np.bool_), question.asked
    for probe in range(PROBES):
        after = times + 2.0 ** (probe - PROBES - 4)
        left = np.flatnonzero(~collide & (after <= 1.0))
        some = rows[left]
        states = starts[some] + after[left, None] * (ends[some] - starts[some])
        collide[left] = check_states(prepared, Accuracy.MESH, states, False).colliding
    return collide

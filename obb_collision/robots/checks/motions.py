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

"""Checks of motions of robots from state to state, including all states between.

All joints move linearly with the time t from 0 to 1. A pair of bodies is seen from one of them, or
from the world. In an interval of length T, each point of the other body is within a bend of the
straight line between its places at both ends of the interval:

    bend = T^2 / 8 sum_k l_k w_k^2.

The sum bounds the second derivative: l_k are the lengths of the segments of the chain to the point,
and w_k the sums of the angular speeds of the joints that turn them. So the pair is certainly free
in the interval if the convex hull of the other body at both ends is farther away than the bend. An
interval without such a proof is halved, until the state in its middle collides, or the pair moves
by less than the resolution in it: then the motion is undecided. So is a motion that takes more than
MOST_STATES, as one in which a joint turns a million times.

Kernels do this with hulls. Intervals in which the hulls of meshes may collide are then checked in
their middle by the meshes, many at once: their distance proves the part of the interval free in
which the pair moves less.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import Held, njit
from obb_collision._threads import run
from obb_collision.accuracy import Accuracy
from obb_collision.robots.checks.arrays import with_own_clouds
from obb_collision.robots.checks.distances import hull_distances
from obb_collision.robots.checks.meshes import set_mesh_distances
from obb_collision.robots.checks.model import Prepared
from obb_collision.robots.checks.motion_pairs import (
    collides,
    moves_of,
    stays_apart,
    sweep_candidates,
)
from obb_collision.robots.checks.motion_room import (
    BOUND_GROWTH,
    DEPTH,
    Bends,
    MotionHits,
    MotionQuestion,
    MotionRoom,
    MovingPairs,
    OpenSpans,
    free_slot,
    new_room,
    place,
    set_bends,
    set_joints,
)
from obb_collision.robots.checks.reports import MotionReport
from obb_collision.robots.checks.states import check_states
from obb_collision.typing import Floats, Integers, Mask, Rows

#: Maximum number of states of a motion that is not undecided. Usual motions take ten.
MOST_STATES = 20_000
#: Number of states tried after an undecided interval, each twice as far away as the last one.
PROBES = 12
#: A motion is first divided into pieces in which the tip bends by at most this share of the largest
#: sphere around a link: longer pieces leave too many pairs open, shorter ones take too many states.
PIECE_BEND = 0.25
MOST_PIECES = 32
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


@njit
def motions_kernel(
    held: Held,
    question: tuple[int, bool, float, Floats, Floats],
    hits: tuple[Floats, Mask, Integers],
    spans: tuple[Integers, Integers, Integers, Floats],
    start: int,
    stop: int,
) -> None:
    """Write where motions collide, and the intervals of pairs that hulls do not decide.

    Without room for intervals, their numbers are written; with room, motions of number 0 are
    skipped. question, hits, spans: ``MotionQuestion``, ``MotionHits`` and ``OpenSpans`` as plain
    tuples, which arrive from Python faster.
    """
    asked = MotionQuestion(with_own_clouds(held.value), *question)
    open_ = OpenSpans(*spans)
    room = new_room(asked)
    for n in range(start, stop):
        if len(open_.pairs) == 0 or open_.counts[n] > 0:
            _check_motion(asked, MotionHits(*hits), open_, n, room)


@njit
def moves_kernel(
    held: Held,
    question: tuple[int, bool, float, Floats, Floats],
    moving: MovingPairs,
    start: int,
    stop: int,
) -> None:
    """Write bounds of how far pairs move between two times, and how far off the line."""
    asked = MotionQuestion(with_own_clouds(held.value), *question)
    room = new_room(asked)
    bends, candidates = room.bends, room.placed.candidates
    for k in range(start, stop):
        n = moving.motions[k]
        blur = set_joints(asked.checked.tree, asked.starts, asked.ends, n, bends.joints)
        set_bends(asked, bends)
        if moving.pairs[k, 0] < 0:
            moving.moves[k, 0] = moving.moves[k, 1] = 0.0
            for i in range(len(bends.bodies)):
                moving.moves[k, 0] = max(moving.moves[k, 0], BOUND_GROWTH * bends.bodies[i, 2])
            continue
        room.times[0] = room.times[1] = np.nan
        place(asked, n, moving.times[k, 0], 0, room)
        place(asked, n, moving.times[k, 1], 1, room)
        for m in range(3):
            candidates[0, m] = moving.pairs[k, m]
        moving.moves[k, 0], moving.moves[k, 1] = moves_of(asked, room, blur, 0, 0, 1)


@njit(inline=True, refcount=False)
def _check_motion(
    question: MotionQuestion, hits: MotionHits, spans: OpenSpans, n: int, room: MotionRoom
) -> None:
    """Check motion n piece by piece; without ``first`` from the end, where most collisions are."""
    candidates, times, result = room.placed.candidates, room.times, room.result
    joints, first = room.bends.joints, question.first
    blur = set_joints(question.checked.tree, question.starts, question.ends, n, joints)
    set_bends(question, room.bends)
    result.limits[0], result.certain[0], result.tried[0], result.written[0] = np.inf, True, 0, 0
    hits.pairs[n, 0] = hits.pairs[n, 1] = -1
    times[:] = np.nan
    pieces = _pieces(question, room.bends)
    for piece in range(pieces):
        number = piece if first else pieces - 1 - piece
        low, high = number / pieces, (number + 1) / pieces
        slot_a, slot_b = number % 2, (number + 1) % 2  # neighbours share a state
        for k in range(2 if first else 3):
            at, slot = (
                (low, slot_a) if k == 0 else (high, slot_b) if k == 1 else (0.5 * (low + high), 2)
            )
            place(question, n, at, slot, room)
        count = _open_candidates(question, room, blur, slot_a, slot_b)
        best = _first_colliding(question, room, count, slot_b) if not first else -1
        for c in range(count if best < 0 else 0):
            if _search(question, spans, n, c, blur, (low, high), (slot_a, slot_b), room):
                best = c
                if not first:
                    break
        if best >= 0:
            hits.pairs[n, 0], hits.pairs[n, 1] = candidates[best, 0], candidates[best, 1]
            break
    spans.counts[n] = result.written[0]
    hits.fractions[n] = np.nan if result.limits[0] == np.inf else result.limits[0]
    hits.undecided[n] = not result.certain[0]


@njit(merge=True)
def _pieces(question: MotionQuestion, bends: Bends) -> int:
    """Return the number of pieces of a motion."""
    spheres, pieces, bend, size = question.checked.tests.spheres, 1, 0.0, 0.0
    for group in range(len(spheres)):
        size = max(size, spheres[group])
    for i in range(len(bends.bodies)):
        bend = max(bend, 0.125 * bends.bodies[i, 3])
    while pieces < MOST_PIECES and bend > PIECE_BEND * size * pieces * pieces:
        pieces += 1
    return pieces


@njit(merge=True)
def _open_candidates(
    question: MotionQuestion, room: MotionRoom, blur: float, slot_a: int, slot_b: int
) -> int:
    """Write the candidates that are not certainly free between two slots; return their number."""
    candidates, directions = room.placed.candidates, room.directions
    kept = 0
    for c in range(sweep_candidates(question, room, blur, slot_a, slot_b)):
        if not stays_apart(question, room, blur, c, slot_a, slot_b):
            for k in range(3):
                candidates[kept, k], directions[kept, k] = candidates[c, k], directions[c, k]
            kept += 1
    return kept


@njit(merge=True)
def _first_colliding(question: MotionQuestion, room: MotionRoom, count: int, last: int) -> int:
    """Return a candidate that collides in the state of the last slot or of slot 2, or -1."""
    for k in range(2 * count):
        c, slot = k % count, last if k < count else 2
        if not _by_meshes(question, room, c) and collides(question, room, c, slot, 0.0):
            room.result.limits[0] = room.times[slot]
            return c
    return -1


@njit(merge=True)
def _by_meshes(question: MotionQuestion, room: MotionRoom, c: int) -> bool:
    """Return whether candidate c needs meshes to be decided."""
    meshes, candidates = question.checked.meshes, room.placed.candidates
    fixed, moving = candidates[c, 0], candidates[c, 1]
    return (fixed < len(meshes) and meshes[fixed]) or meshes[moving]  # a ball is no mesh


@njit(merge=True)
def _search(
    question: MotionQuestion,
    spans: OpenSpans,
    n: int,
    c: int,
    blur: float,
    span: tuple[float, float],
    ends: tuple[int, int],
    room: MotionRoom,
) -> bool:
    """Halve an open interval of candidate c, the earlier half first, until it is decided.

    Return whether it collides, or is undecided, before the limit; the limit becomes that time.
    """
    result, times, stack, slots = room.result, room.times, room.stack, room.slots
    meshes, resolution = _by_meshes(question, room, c), question.resolution
    stack[0, 0], stack[0, 1], slots[0, 0], slots[0, 1] = *span, *ends
    depth, hit = 1, np.inf
    while depth > 0:
        depth -= 1
        (first, last), (a, b) = (
            (stack[depth, 0], stack[depth, 1]),
            (slots[depth, 0], slots[depth, 1]),
        )
        if first >= result.limits[0]:
            continue
        result.tried[0] += 1
        middle = 0.5 * (first + last)
        s = free_slot(times, middle, a, b)
        for k in range(3):
            at, slot = (first, a) if k == 0 else (last, b) if k == 1 else (middle, s)
            place(question, n, at, slot, room)
        touches = collides(question, room, c, s, 0.0)
        ended = not first < middle < last or depth + 2 > DEPTH or result.tried[0] >= MOST_STATES
        if not ended:
            way, bend = moves_of(question, room, blur, c, a, b)
            ended = way + bend <= 2.0 * resolution
        if meshes and (touches or ended):
            _write_span(spans, n, c, (first, last), room)
            continue
        if touches:
            hit = middle
            if not question.first or ended:
                result.limits[0], result.certain[0] = middle if not ended else first, True
                return True
            depth = 0  # waiting intervals are later
        elif ended:
            result.limits[0], result.certain[0] = first, hit < np.inf
            for k in range(PROBES):
                at = last + (2.0**k - 1.0) * (last - first)
                if result.certain[0] or at > 1.0:
                    break
                place(question, n, at, s, room)
                result.certain[0] = collides(question, room, c, s, 0.0)
            return True
        for half in range(1 if touches else 0, 2):
            x, y = (s, b) if half == 0 else (a, s)
            if not stays_apart(question, room, blur, c, x, y):
                stack[depth, 0], stack[depth, 1] = times[x], times[y]
                slots[depth, 0], slots[depth, 1] = x, y
                depth += 1
    if not hit < result.limits[0]:
        return False
    result.limits[0], result.certain[0] = hit, True
    return True


@njit(merge=True)
def _write_span(
    spans: OpenSpans, n: int, c: int, span: tuple[float, float], room: MotionRoom
) -> None:
    """Count an open interval of candidate c of motion n; write it unless ``spans`` is empty."""
    written, candidates = room.result.written, room.placed.candidates
    if len(spans.pairs):
        row = spans.ends[n] - spans.counts[n] + written[0]
        spans.spans[row, 0], spans.spans[row, 1] = span
        for k in range(3):
            spans.pairs[row, k] = candidates[c, k]
    written[0] += 1


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
    """Return whether motions ``rows`` (k,) collide in a state soon after times (k,).

    Times are parts of the motion, 0 to 1; the last state tried is 1/32 later.
    """
    collide, (*_, starts, ends) = np.zeros(len(rows), np.bool_), motions.question
    for probe in range(PROBES):
        after = times + 2.0 ** (probe - PROBES - 4)
        left = np.flatnonzero(~collide & (after <= 1.0))
        k = rows[left]
        states = starts[k] + after[left, None] * (ends[k] - starts[k])
        collide[left] = check_states(prepared, Accuracy.MESH, states, False).colliding
    return collide

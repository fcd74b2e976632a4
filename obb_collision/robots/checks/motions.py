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

"""Kernels that check motions of robots from state to state, between the two as well.

All joints move linearly in the parameter t from 0 to 1. A pair of bodies is looked at in the frame
of one of them, or the world's. In an interval of length T, each point of the other is within a bend
of the straight line between where it is at both ends of the interval:

    bend = T^2 / 8 sum_k l_k w_k^2,

the second derivative being at most the sum over the segments of the chain to the point of their
lengths l_k times the squared sum w_k of the angular speeds of the joints that turn them. So the
pair is free in the interval if the hull of the other body at both ends, as one body, is farther
away than the bend: that is a proof for all states in it. Pairs for which there is none are looked
at in both halves of their interval, until their state in the middle collides, or they move less
than the resolution: that is undecided. What takes more than MOST_STATES, as a joint that turns a
million times, is undecided, too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.numerics.constants import MESH_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.intrinsics import farthest
from obb_collision.numerics.simplex import no_simplex, with_corner
from obb_collision.numerics.vec3 import (
    axes_of,
    clamped,
    combined,
    components,
    dot,
    max_abs,
    minus,
    negated,
    norm,
    plus,
    rows_at,
    scaled,
    sum_abs,
    vector_at,
)
from obb_collision.queries.meshes.convex import (
    GAP_BOUND,
    HULL_CONVERGED,
    HULL_DIRECTIONS,
    HullCorners,
    beyond,
)
from obb_collision.queries.meshes.placed import Pose, moved, place_at, relative_pose
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.queries.verdict.sat import BoxAt, box_at
from obb_collision.robots.checks.arrays import (
    LINK_PLACING,
    Checked,
    LinkBodies,
    Placed,
    place_state,
    placed_box,
    slack_of,
)
from obb_collision.robots.checks.chains import Chains
from obb_collision.robots.checks.states import HULL, SPHERE, may_collide, square_distance
from obb_collision.robots.kinematics.kinematics import FIXED, FLOATING, PLANAR, PRISMATIC, Tree
from obb_collision.scene.broad_phase.bounds_tree import LANES, STACK, lowest, overlaps
from obb_collision.typing import Floats, Integers, Mask, Vector

#: Relative growth of bounds: more than the roundings of all that goes into them.
BOUND_GROWTH = 1.0 + 1e-9
#: Intervals of a pair that may wait: each halving leaves one, and doubles end after as many.
DEPTH = 64
#: States of one motion; what is open after so many is undecided. Usual motions take ten.
MOST_STATES = 20_000
#: States tried after an undecided interval, each twice as far away as the one before.
PROBES = 12
#: Angular speeds above which all that counts is how far bodies reach: squares must be finite.
FASTEST = 1e100
#: A motion begins as pieces in which the tip bends by at most this share of the largest sphere
#: around a link: with fewer of them too many pairs stay open, with more too many states are placed.
PIECE_BEND = 0.25
MOST_PIECES = 32
#: States that are kept: the ends of a piece, and those that halve intervals.
SLOTS = 8


class MotionQuestion(NamedTuple):
    """Motions from starts to ends (n, joints) that are checked on a level."""

    checked: Checked
    meshes: Mask  #: (b,) bodies whose pairs hulls do not decide
    chains: Chains
    level: int
    first: bool  #: whether the first collision is asked for, or any
    resolution: float
    starts: Floats
    ends: Floats


class MotionHits(NamedTuple):
    """Where each motion collides (n,), NaN for free, if it is undecided, the pair (n, 2)."""

    parameters: Floats
    undecided: Mask
    pairs: Integers


class OpenSpans(NamedTuple):
    """Pairs with meshes and intervals in which their hulls may collide.

    Those of motion n up to row ``ends[n]``, as many as ``counts[n]``.
    """

    counts: Integers
    ends: Integers
    pairs: Integers  #: (m, 3) as candidates of ``MotionRoom``
    spans: Floats  #: (m, 2)


class MovingPairs(NamedTuple):
    """Pairs of motions (k,) at two times (k, 2), and how far they move."""

    motions: Integers
    pairs: Integers  #: (k, 3) as candidates; -1: the body that moves farthest, in all the motion
    times: Floats
    moves: Floats  #: (k, 2) on a line at most, and off it


class Findings(NamedTuple):
    """What is found of one motion: arrays of one number, as kernels that are inlined set them."""

    limits: Floats  #: up to where nothing collides; infinite for nothing yet
    certain: Mask
    tried: Integers  #: intervals halved
    written: Integers  #: spans


class Bends(NamedTuple):
    """Bounds of one motion, for each chain a row of five numbers.

    The angular speed of its end, the same without its last joint, its speed, its second
    derivative, and its length.
    """

    joints: Floats  #: (links, 3) angular speed, linear speed, farthest slide
    links: Floats  #: (links, 5) up to links, in the world
    bodies: Floats  #: (robots' bodies, 5) up to the farthest corner
    pairs: Floats  #: (u, 5) from links to links


class MotionRoom(NamedTuple):
    """Where one motion is examined."""

    placed: Placed  #: SLOTS states; candidates (c, 3): the body in whose frame the other one
    #: moves, that one, and the row of the tested pair, -1: the first body is one of the world
    times: Floats  #: (SLOTS,) of these states, NaN for none
    bends: Bends
    state: Floats  #: (1, joints)
    directions: Floats  #: (c, 3) from the second body of each candidate to the first
    stack: Floats  #: (DEPTH + 2, 2) intervals of a pair to halve, the earliest last
    slots: Integers  #: (DEPTH + 2, 2) of their ends
    found: Findings


@njit(inline=True, refcount=False)
def _add_segment(bounds: Floats, row: int, along: float, across: float) -> None:
    """Add a segment to a chain; what is along the axis of the last joint is not turned by it."""
    w, inner = bounds[row, 0], bounds[row, 1]
    bounds[row, 2] += w * across + inner * along
    bounds[row, 3] += w * w * across + inner * inner * along
    bounds[row, 4] += across + along


@njit(inline=True, refcount=False)
def _add_joint(bounds: Floats, row: int, joints: Floats, link: int) -> None:
    """Add a joint to a chain, which slides, and turns what comes behind it."""
    w, speed, far = bounds[row, 0], joints[link, 1], joints[link, 2]
    bounds[row, 2] += w * far + speed
    bounds[row, 3] += w * (w * far + 2.0 * speed)
    bounds[row, 4] += far
    bounds[row, 0], bounds[row, 1] = w + joints[link, 0], w


@njit(inline=True, refcount=False)
def _set_joints(tree: Tree, starts: Floats, ends: Floats, n: int, joints: Floats) -> float:
    """Write what joints do in motion n; return by how much roundings may turn or move a link.

    A quaternion that moves linearly turns at most at a speed w, and no faster changes it than by
    w^2: together with other joints that is as much as turning evenly at 2^(1/2) w.
    """
    blur = 0.0
    for link in range(len(tree.parents)):
        joints[link, 0] = joints[link, 1] = joints[link, 2] = 0.0
        kind, column, factor = tree.kinds[link], tree.columns[link], abs(tree.multipliers[link])
        if kind == FIXED:
            continue
        speed = factor * abs(ends[n, column] - starts[n, column])
        far = factor * max(abs(starts[n, column]), abs(ends[n, column]))
        if kind < PRISMATIC:
            joints[link, 0] = min(speed, FASTEST)
        elif kind == PRISMATIC:
            joints[link, 1], joints[link, 2] = speed, far + abs(tree.offsets[link])
        else:
            far = 0.0
            for k in range(3 if kind == FLOATING else 2):
                a, b = starts[n, column + k], ends[n, column + k]
                joints[link, 1] += abs(b - a)
                far += max(abs(a), abs(b))
            joints[link, 2] = far
            if kind == PLANAR:
                a, b = starts[n, column + 2], ends[n, column + 2]
                joints[link, 0] = min(abs(b - a), FASTEST)
                far += max(abs(a), abs(b))
            else:
                turn = math.sqrt(2.0) * _turning_speed(starts, ends, n, column + 3)
                joints[link, 0] = min(turn, FASTEST)
                far += 4.0
        blur += 8.0 * ROUNDOFF * far
    return blur


@njit(refcount=False)
def _turning_speed(starts: Floats, ends: Floats, n: int, column: int) -> float:
    """Return the angular speed of a quaternion that moves linearly and is made a unit one.

    Twice its speed over its least length on the way; infinite if that may be zero.
    """
    square = along = length = 0.0
    for k in range(4):
        step = ends[n, column + k] - starts[n, column + k]
        square += step * step
        along -= step * starts[n, column + k]
    if square == 0.0:
        return 0.0
    t = min(max(along / square, 0.0), 1.0)
    for k in range(4):
        part = starts[n, column + k] + t * (ends[n, column + k] - starts[n, column + k])
        length += part * part
    return 2.0 * math.sqrt(square / length) if length > 1e-20 * square else np.inf


@njit(inline=True, refcount=False)
def _set_bends(question: MotionQuestion, bends: Bends) -> None:
    """Write the bounds of links and bodies in the world, and of pairs."""
    parents, frames = question.checked.tree.parents, question.checked.bodies.frames
    chains, bodies = question.chains, bends.bodies
    joints, links, pairs = bends.joints, bends.links, bends.pairs
    for link in range(len(parents)):
        for k in range(5):
            links[link, k] = links[parents[link], k] if parents[link] >= 0 else 0.0
        _add_segment(links, link, chains.links[link, 0], chains.links[link, 1])
        _add_joint(links, link, joints, link)
    for i in range(len(bodies)):
        for k in range(5):
            bodies[i, k] = links[frames[i], k]
        _add_segment(bodies, i, chains.bodies[i, 0], chains.bodies[i, 1])
    for u in range(len(pairs)):
        for k in range(5):
            pairs[u, k] = 0.0
        for step in range(chains.starts[u], chains.starts[u + 1]):
            _add_segment(pairs, u, chains.segments[step, 0], chains.segments[step, 1])
            if chains.joints[step] >= 0:
                _add_joint(pairs, u, joints, chains.joints[step])


@njit(inline=True, refcount=False)
def _bend(span: float, second: float, length: float, blur: float) -> float:
    """Return how far a point is off the line between its ends in an interval at most.

    It is no farther off than twice the length of its chain, however often that turns.
    """
    bend = min(0.125 * span * span * second, 2.0 * length)
    return BOUND_GROWTH * bend + blur * (1.0 + length)


@njit(inline=True, refcount=False)
def _pair_bend(question: MotionQuestion, bends: Bends, m: int, span: float, blur: float) -> float:
    """Return the bend of the second body of pair m in the frame of the first."""
    u, j = question.chains.rows[m], question.checked.tests.pairs[m, 1]
    along, across = question.chains.bodies[j, 0], question.chains.bodies[j, 1]
    w, inner = bends.pairs[u, 0], bends.pairs[u, 1]
    second = bends.pairs[u, 3] + w * w * across + inner * inner * along
    return _bend(span, second, bends.pairs[u, 4] + along + across, blur)


@njit
def _new_room(question: MotionQuestion) -> MotionRoom:
    checked, joints = question.checked, question.starts.shape[1]
    links, first = len(checked.tree.parents), checked.tests.first
    count, pairs = len(checked.bodies.frames), len(question.chains.starts) - 1
    most = len(checked.tests.pairs) + first * (count - first)
    placed = Placed(
        np.empty((SLOTS, links, 7)),
        np.zeros((SLOTS, links + 1, 3)),
        np.zeros((SLOTS, links + 1, 3, 3)),
        np.empty((SLOTS, count, 3)),
        np.empty((SLOTS, count, 3, 3)),
        np.zeros((SLOTS, count), np.bool_),
        np.empty((2, STACK), np.int64),
        np.empty((most, 3), np.int64),
        np.empty(most),
    )
    for slot in range(SLOTS):
        for k in range(3):
            placed.rotations[slot, links, k, k] = 1.0
    bends = Bends(
        np.empty((links, 3)), np.empty((links, 5)), np.empty((first, 5)), np.empty((pairs, 5))
    )
    return MotionRoom(
        placed,
        np.full(SLOTS, np.nan),
        bends,
        np.empty((1, joints)),
        np.empty((most, 3)),
        np.empty((DEPTH + 2, 2)),
        np.empty((DEPTH + 2, 2), np.int64),
        Findings(np.empty(1), np.empty(1, np.bool_), np.empty(1, np.int64), np.empty(1, np.int64)),
    )


@njit(inline=True, refcount=False)
def _slot(placed: Placed, slot: int) -> Placed:
    """Return one of the states that are kept."""
    return Placed(
        placed.poses[slot : slot + 1],
        placed.positions[slot],
        placed.rotations[slot],
        placed.centers[slot],
        placed.axes[slot],
        placed.ready[slot],
        placed.waiting,
        placed.candidates,
        placed.grown,
    )


@njit(inline=True, refcount=False)
def _place(question: MotionQuestion, n: int, time: float, slot: int, room: MotionRoom) -> None:
    """Place the state of motion n at a time in a slot, if it is not there."""
    if room.times[slot] == time:
        return
    starts, ends, state = question.starts, question.ends, room.state
    for k in range(state.shape[1]):
        part = starts[n, k] + time * (ends[n, k] - starts[n, k])
        state[0, k] = ends[n, k] if time == 1.0 else part
    place_state(question.checked, state, 0, _slot(room.placed, slot))
    room.times[slot] = time


@njit(refcount=False)
def _free_slot(times: Floats, time: float, one: int, other: int) -> int:
    """Return the slot that has a time, or one of the others than two that may be overwritten."""
    slot = 2
    for k in range(2, SLOTS):
        if times[k] == time:
            return k
        if k != one and k != other and (slot in (one, other) or math.isnan(times[k])):
            slot = k
    return slot


@njit(inline=True, refcount=False)
def _passes(box: BoxAt, start: Vector, end: Vector, reach: float) -> tuple[bool, Vector]:
    """Return whether a ball that moves straight may touch a box, and a direction to the box.

    start, end: of its centre, from that of the box.
    """
    a, b = components(box.axes, start), components(box.axes, end)
    middle = scaled(plus(a, b), 0.5)
    near = clamped(middle, box.half_extents)
    n = minus(middle, near)
    offset = dot(n, near)
    gap = min(dot(n, a), dot(n, b)) - offset
    apart = gap > 0.0 and gap * gap > reach * reach * dot(n, n) * (1.0 + LINK_PLACING)
    if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
        n = middle
    return not apart, negated(combined(box.axes, n))


@njit(inline=True, refcount=False)
def _sweep_candidates(
    question: MotionQuestion, room: MotionRoom, blur: float, one: int, other: int
) -> int:
    """Write the pairs that may collide between the times of two slots; return their number.

    The world's body comes first, in whose frame the other one moves.
    """
    checked, bends, times = question.checked, room.bends, room.times
    bodies, tests, tree = checked.bodies, checked.tests, room.placed
    nodes, starts, order = tests.nodes, tests.levels, tests.order
    p, q = _slot(room.placed, one), _slot(room.placed, other)
    candidates, directions, limits = tree.candidates, room.directions, tree.grown
    allowed, ruled = tests.allowed, len(tests.allowed) > 0
    blocks, levels = tree.waiting[0], tree.waiting[1]
    world = BoxArrays(bodies.centers, bodies.rotations, bodies.half_extents)
    span = times[other] - times[one]
    count = 0
    for k in range(len(tests.links) if len(order) else 0):
        group = len(tests.links) - 1 - k
        frame, first, last = tests.links[group], tests.starts[group], tests.starts[group + 1]
        radius = 0.0
        for i in range(first, last):
            bend = _bend(span, bends.bodies[i, 3], bends.bodies[i, 4], blur)
            slack = max(
                slack_of(bodies, i, vector_at(p.centers, i)),
                slack_of(bodies, i, vector_at(q.centers, i)),
            )
            limits[i] = bend + 2.0 * slack
            radius = max(radius, limits[i])
        radius += tests.spheres[group]
        middle = vector_at(tests.centers, group)
        x, y, z = plus(
            vector_at(p.positions, frame), components(rows_at(p.rotations, frame), middle)
        )
        u, v, w = plus(
            vector_at(q.positions, frame), components(rows_at(q.rotations, frame), middle)
        )
        x, u, y, v, z, w = min(x, u), max(x, u), min(y, v), max(y, v), min(z, w), max(z, w)
        levels[0], blocks[0] = len(starts) - 2, 0
        depth = 1
        while depth > 0:
            depth -= 1
            level, block = levels[depth], blocks[depth]
            mask = overlaps(
                nodes,
                starts[level] + block,
                x - radius,
                y - radius,
                z - radius,
                u + radius,
                v + radius,
                w + radius,
            )
            while mask != 0:
                child = LANES * block + lowest(mask)
                mask &= mask - 1
                if level > 0:
                    levels[depth], blocks[depth] = level - 1, child
                    depth += 1
                    continue
                j = tests.first + order[child]
                b = box_at(world, j)
                for i in range(first, last):
                    if ruled and allowed[i, order[child]]:
                        continue
                    reach = bodies.spheres[i] + limits[i] + LINK_PLACING * bodies.reaches[j]
                    start = minus(vector_at(p.centers, i), b.center)
                    end = minus(vector_at(q.centers, i), b.center)
                    near, n = _passes(b, start, end, reach)
                    if near:
                        candidates[count, 0], candidates[count, 1] = j, i
                        candidates[count, 2] = -1
                        directions[count, 0], directions[count, 1], directions[count, 2] = n
                        count += 1
    pairs, chains = tests.pairs, question.chains
    for m in range(len(pairs)):
        i, j = pairs[m, 0], pairs[m, 1]
        slack = 2.0 * LINK_PLACING * (bodies.reaches[i] + bodies.reaches[j])
        reach = bodies.spheres[i] + bodies.spheres[j] + slack
        u = chains.rows[m]
        along, across = chains.bodies[j, 0], chains.bodies[j, 1]
        speed = bends.pairs[u, 2] + bends.pairs[u, 0] * (along + across)
        far = reach + 0.5 * span * speed * BOUND_GROWTH + blur * (1.0 + bends.pairs[u, 4])
        d = minus(vector_at(p.centers, j), vector_at(p.centers, i))
        e = minus(vector_at(q.centers, j), vector_at(q.centers, i))
        if min(dot(d, d), dot(e, e)) > far * far * (1.0 + LINK_PLACING):
            continue
        bend = _pair_bend(question, bends, m, span, blur)
        frame = bodies.frames[i]
        d = minus(vector_at(p.centers, j), vector_at(p.positions, frame))
        e = minus(vector_at(q.centers, j), vector_at(q.positions, frame))
        b = box_at(world, i)
        start = minus(components(axes_of(p.rotations, frame), d), b.center)
        end = minus(components(axes_of(q.rotations, frame), e), b.center)
        near, n = _passes(b, start, end, bodies.spheres[j] + slack + bend)
        if near or question.level == SPHERE:  # states have no boxes of links there
            candidates[count, 0], candidates[count, 1], candidates[count, 2] = i, j, m
            directions[count, 0], directions[count, 1], directions[count, 2] = n
            count += 1
    return count


@njit(inline=True, refcount=False)
def _pose_in(bodies: LinkBodies, placed: Placed, fixed: int, moving: int, in_world: bool) -> Pose:
    """Return where the frame of one body is in that of another, or in the world."""
    reach = bodies.radii[fixed] + bodies.radii[moving]
    b = place_at(placed.positions, placed.rotations, bodies.frames[moving])
    if in_world:
        return Pose(b.axes, b.center, sum_abs(b.center) + reach, 0.0, 0.0)
    return relative_pose(
        place_at(placed.positions, placed.rotations, bodies.frames[fixed]), b, reach
    )


@njit
def _swept_apart(
    a: HullCorners, b: HullCorners, start: Pose, end: Pose, first: Vector, reach: float
) -> tuple[bool, Vector]:
    """Return whether a is certainly farther than reach from b at both poses and in between.

    And the direction that was tried last. As ``apart``, of the hull of b at both poses.
    """
    size = max(start.size, end.size)
    bound, unit = GAP_BOUND * size + MESH_UNDERFLOW, unit_scale(size)[0]
    near = (unit * reach) * (unit * reach)
    n, simplex = first, no_simplex()
    for _ in range(HULL_DIRECTIONS):
        largest = max_abs(n)
        if not largest > 0.0:
            n, largest = (1.0, n[1], n[2]), 1.0
        n = n[0] / largest, n[1] / largest, n[2] / largest
        p = farthest(a.blocks, a.first, a.last, negated(n))
        m, o = components(start.axes, n), components(end.axes, n)
        q, r = farthest(b.blocks, b.first, b.last, m), farthest(b.blocks, b.first, b.last, o)
        s, t = dot(m, q) + dot(n, start.offset), dot(o, r) + dot(n, end.offset)
        gap = dot(n, p) - max(s, t)
        if gap > beyond(n, bound, reach):
            return True, n
        if simplex.size > 0:
            reached = dot(n, simplex.nearest)
            if not reached - unit * gap > HULL_CONVERGED * reached:
                return False, n
        corner = moved(start, q) if s >= t else moved(end, r)
        simplex = with_corner(simplex, scaled(minus(p, corner), unit))
        if simplex.size == 4 or not dot(simplex.nearest, simplex.nearest) > near:
            return False, n
        n = simplex.nearest
    return False, n


@njit(inline=True, refcount=False)
def _use_world(bodies: LinkBodies, placed: Placed, j: int) -> None:
    """Place a body of the world in a state."""
    placed.ready[j] = True
    for k in range(3):
        placed.centers[j, k] = bodies.centers[j, k]
        for m in range(3):
            placed.axes[j, k, m] = bodies.rotations[j, k, m]


@njit(inline=True, refcount=False)
def _collides(question: MotionQuestion, room: MotionRoom, c: int, slot: int, grown: float) -> bool:
    """Return whether candidate c may be within a distance in the state of a slot.

    With the tests that ``states`` has, in its order of the bodies.
    """
    bodies, placed = question.checked.bodies, _slot(room.placed, slot)
    i, j = placed.candidates[c, 0], placed.candidates[c, 1]
    if placed.candidates[c, 2] < 0:
        i, j = j, i
        _use_world(bodies, placed, j)
        center = vector_at(placed.centers, i)
        reach = bodies.spheres[i] + grown + 2.0 * slack_of(bodies, i, center)
        reach += LINK_PLACING * bodies.reaches[j]
        box = placed_box(bodies, placed, j)
        square = square_distance(box, minus(box.center, center))
        if square > reach * reach * (1.0 + LINK_PLACING):
            return False
    return may_collide(bodies, placed, i, j, grown, question.level)


@njit(inline=True, refcount=False)
def _moves(
    question: MotionQuestion, room: MotionRoom, blur: float, c: int, one: int, other: int
) -> tuple[float, float]:
    """Return how far a point of candidate c moves between two slots at most, and its bend."""
    bodies, bends = question.checked.bodies, room.bends
    p, q = _slot(room.placed, one), _slot(room.placed, other)
    i, j, m = p.candidates[c, 0], p.candidates[c, 1], p.candidates[c, 2]
    span = abs(room.times[other] - room.times[one])
    if m < 0:
        bend = _bend(span, bends.bodies[j, 3], bends.bodies[j, 4], blur)
    else:
        bend = _pair_bend(question, bends, m, span, blur)
    a, b = _pose_in(bodies, p, i, j, m < 0), _pose_in(bodies, q, i, j, m < 0)
    center, turn = vector_at(bodies.centers, j), 0.0
    way = norm(minus(moved(b, center), moved(a, center)))
    for k in range(3):
        change = minus(b.axes[k], a.axes[k])
        turn += dot(change, change)
    radius = max(bodies.spheres[j], norm(vector_at(bodies.half_extents, j)))
    return BOUND_GROWTH * (way + math.sqrt(turn) * radius), bend


@njit(inline=True, refcount=False)
def _slack_in(bodies: LinkBodies, i: int, p: Placed, q: Placed) -> float:
    """Return the slack of a robot's body in two states."""
    one, other = vector_at(p.centers, i), vector_at(q.centers, i)
    return max(slack_of(bodies, i, one), slack_of(bodies, i, other))


@njit(inline=True, refcount=False)
def _stays_apart(
    question: MotionQuestion, room: MotionRoom, blur: float, c: int, one: int, other: int
) -> bool:
    """Return whether candidate c is certainly free between the times of two slots.

    Below "hull" what stands for bodies is not one convex body, but what all tests of states have in
    common: they are repeated with all that the pair moves.
    """
    if question.level < HULL:
        way, bend = _moves(question, room, blur, c, one, other)
        return not _collides(question, room, c, one, way + bend)
    bodies, bends = question.checked.bodies, room.bends
    p, q = _slot(room.placed, one), _slot(room.placed, other)
    i, j, m = p.candidates[c, 0], p.candidates[c, 1], p.candidates[c, 2]
    span, slack = room.times[other] - room.times[one], _slack_in(bodies, j, p, q)
    if m < 0:
        bend = _bend(span, bends.bodies[j, 3], bends.bodies[j, 4], blur)
        slack += LINK_PLACING * bodies.reaches[i]
    else:
        bend = _pair_bend(question, bends, m, span, blur)
        slack += _slack_in(bodies, i, p, q)
    a, b = _pose_in(bodies, p, i, j, m < 0), _pose_in(bodies, q, i, j, m < 0)
    box = box_at(BoxArrays(bodies.centers, bodies.rotations, bodies.half_extents), i)
    center = vector_at(bodies.centers, j)
    start, end = moved(a, center), moved(b, center)
    free = not _passes(
        box, minus(start, box.center), minus(end, box.center), bodies.spheres[j] + bend + slack
    )[0]
    if not free:
        own = HullCorners(bodies.blocks, bodies.starts[i], bodies.starts[i + 1])
        body = HullCorners(bodies.blocks, bodies.starts[j], bodies.starts[j + 1])
        reach = bodies.rounds[i] + bodies.rounds[j] + bend + 2.0 * slack
        free, n = _swept_apart(own, body, a, b, vector_at(room.directions, c), reach)
        if not free and n == n:
            room.directions[c, 0], room.directions[c, 1], room.directions[c, 2] = n
    return free


@njit
def motions_kernel(
    question: MotionQuestion, hits: MotionHits, spans: OpenSpans, start: int, stop: int
) -> None:
    """Write where motions collide, and the intervals of pairs that hulls do not decide.

    Without room for these, their numbers; motions whose number is 0 are left out if there is room.
    """
    room = _new_room(question)
    for n in range(start, stop):
        if len(spans.pairs) == 0 or spans.counts[n] > 0:
            _check_motion(question, hits, spans, n, room)


@njit
def moves_kernel(question: MotionQuestion, moving: MovingPairs, start: int, stop: int) -> None:
    """Write how far pairs move between two times, and how far off the line."""
    room = _new_room(question)
    bends, candidates = room.bends, room.placed.candidates
    for k in range(start, stop):
        n = moving.motions[k]
        blur = _set_joints(question.checked.tree, question.starts, question.ends, n, bends.joints)
        _set_bends(question, bends)
        if moving.pairs[k, 0] < 0:
            moving.moves[k, 0] = moving.moves[k, 1] = 0.0
            for i in range(len(bends.bodies)):
                moving.moves[k, 0] = max(moving.moves[k, 0], BOUND_GROWTH * bends.bodies[i, 2])
            continue
        room.times[0] = room.times[1] = np.nan
        _place(question, n, moving.times[k, 0], 0, room)
        _place(question, n, moving.times[k, 1], 1, room)
        for m in range(3):
            candidates[0, m] = moving.pairs[k, m]
        moving.moves[k, 0], moving.moves[k, 1] = _moves(question, room, blur, 0, 0, 1)


@njit(inline=True, refcount=False)
def _check_motion(
    question: MotionQuestion, hits: MotionHits, spans: OpenSpans, n: int, room: MotionRoom
) -> None:
    """Check motion n, piece by piece: the last one first, where most of those that collide do."""
    candidates, times, found = room.placed.candidates, room.times, room.found
    joints, first = room.bends.joints, question.first
    blur = _set_joints(question.checked.tree, question.starts, question.ends, n, joints)
    _set_bends(question, room.bends)
    found.limits[0], found.certain[0], found.tried[0], found.written[0] = np.inf, True, 0, 0
    hits.pairs[n, 0] = hits.pairs[n, 1] = -1
    times[:] = np.nan
    pieces = _pieces(question, room.bends)
    for piece in range(pieces):
        number = piece if first else pieces - 1 - piece
        low, high = number / pieces, (number + 1) / pieces
        one, other = number % 2, (number + 1) % 2  # neighbours share a state
        for k in range(2 if first else 3):
            at, slot = (
                (low, one) if k == 0 else (high, other) if k == 1 else (0.5 * (low + high), 2)
            )
            _place(question, n, at, slot, room)
        count = _open_candidates(question, room, blur, one, other)
        best = _first_colliding(question, room, count, other) if not first else -1
        for c in range(count if best < 0 else 0):
            if _search(question, spans, n, c, blur, (low, high), (one, other), room):
                best = c
                if not first:
                    break
        if best >= 0:
            hits.pairs[n, 0], hits.pairs[n, 1] = candidates[best, 0], candidates[best, 1]
            break
    spans.counts[n] = found.written[0]
    hits.parameters[n] = np.nan if found.limits[0] == np.inf else found.limits[0]
    hits.undecided[n] = not found.certain[0]


@njit(inline=True, refcount=False)
def _pieces(question: MotionQuestion, bends: Bends) -> int:
    """Return in how many pieces a motion is looked at."""
    spheres, pieces, bend, size = question.checked.tests.spheres, 1, 0.0, 0.0
    for group in range(len(spheres)):
        size = max(size, spheres[group])
    for i in range(len(bends.bodies)):
        bend = max(bend, 0.125 * bends.bodies[i, 3])
    while pieces < MOST_PIECES and bend > PIECE_BEND * size * pieces * pieces:
        pieces += 1
    return pieces


@njit(inline=True, refcount=False)
def _open_candidates(
    question: MotionQuestion, room: MotionRoom, blur: float, one: int, other: int
) -> int:
    """Write the candidates that are not certainly free between two slots; return their number."""
    candidates, directions = room.placed.candidates, room.directions
    kept = 0
    for c in range(_sweep_candidates(question, room, blur, one, other)):
        if not _stays_apart(question, room, blur, c, one, other):
            for k in range(3):
                candidates[kept, k], directions[kept, k] = candidates[c, k], directions[c, k]
            kept += 1
    return kept


@njit(inline=True, refcount=False)
def _first_colliding(question: MotionQuestion, room: MotionRoom, count: int, last: int) -> int:
    """Return a candidate that collides in the state of the last slot or of slot 2, or -1."""
    for k in range(2 * count):
        c, slot = k % count, last if k < count else 2
        if not _by_meshes(question, room, c) and _collides(question, room, c, slot, 0.0):
            room.found.limits[0] = room.times[slot]
            return c
    return -1


@njit(inline=True, refcount=False)
def _by_meshes(question: MotionQuestion, room: MotionRoom, c: int) -> bool:
    """Return whether hulls do not decide whether candidate c collides."""
    meshes, candidates = question.meshes, room.placed.candidates
    return meshes[candidates[c, 0]] or meshes[candidates[c, 1]]


@njit(inline=True, refcount=False)
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

    Return whether it collides, or is undecided, before the limit, which is then where.
    """
    found, times, stack, slots = room.found, room.times, room.stack, room.slots
    meshes, resolution = _by_meshes(question, room, c), question.resolution
    stack[0, 0], stack[0, 1], slots[0, 0], slots[0, 1] = *span, *ends
    depth, hit = 1, np.inf
    while depth > 0:
        depth -= 1
        (first, last), (a, b) = (
            (stack[depth, 0], stack[depth, 1]),
            (slots[depth, 0], slots[depth, 1]),
        )
        if first >= found.limits[0]:
            continue
        found.tried[0] += 1
        middle = 0.5 * (first + last)
        s = _free_slot(times, middle, a, b)
        for k in range(3):
            at, slot = (first, a) if k == 0 else (last, b) if k == 1 else (middle, s)
            _place(question, n, at, slot, room)
        collides = _collides(question, room, c, s, 0.0)
        ended = not first < middle < last or depth + 2 > DEPTH or found.tried[0] >= MOST_STATES
        if not ended:
            way, bend = _moves(question, room, blur, c, a, b)
            ended = way + bend <= 2.0 * resolution
        if meshes and (collides or ended):
            _write_span(spans, n, c, (first, last), room)
            continue
        if collides:
            hit = middle
            if not question.first or ended:
                found.limits[0], found.certain[0] = middle if not ended else first, True
                return True
            depth = 0  # what waits comes later
        elif ended:
            found.limits[0], found.certain[0] = first, hit < np.inf
            for k in range(PROBES):
                at = last + (2.0**k - 1.0) * (last - first)
                if found.certain[0] or at > 1.0:
                    break
                _place(question, n, at, s, room)
                found.certain[0] = _collides(question, room, c, s, 0.0)
            return True
        for half in range(1 if collides else 0, 2):
            x, y = (s, b) if half == 0 else (a, s)
            if not _stays_apart(question, room, blur, c, x, y):
                stack[depth, 0], stack[depth, 1] = times[x], times[y]
                slots[depth, 0], slots[depth, 1] = x, y
                depth += 1
    if not hit < found.limits[0]:
        return False
    found.limits[0], found.certain[0] = hit, True
    return True


@njit(inline=True, refcount=False)
def _write_span(
    spans: OpenSpans, n: int, c: int, span: tuple[float, float], room: MotionRoom
) -> None:
    """Count an interval of a pair that hulls do not decide, and write it if there is room."""
    written, candidates = room.found.written, room.placed.candidates
    if len(spans.pairs):
        row = spans.ends[n] - spans.counts[n] + written[0]
        spans.spans[row, 0], spans.spans[row, 1] = span
        for k in range(3):
            spans.pairs[row, k] = candidates[c, k]
    written[0] += 1

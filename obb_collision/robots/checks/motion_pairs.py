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

"""Pairs of bodies in an interval of a motion: candidates, and proofs that they stay apart.

``motions`` explains the method.
"""

from __future__ import annotations

import math

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.geometry.trees.bounds_tree import lowest, overlaps
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.numerics.intrinsics import LANES, farthest
from obb_collision.numerics.simplex import BARE_CORNER, no_simplex, with_corner
from obb_collision.numerics.vec3 import (
    ZERO,
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
from obb_collision.queries.meshes.hull_hull import (
    GAP_BOUND,
    HULL_CONVERGED,
    HULL_DIRECTIONS,
    HullCorners,
    beyond,
)
from obb_collision.queries.meshes.placed import PairPose, moved, place_at, relative_pose
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.queries.verdict.sat import BoxAt, box_at
from obb_collision.robots.checks.arrays import (
    LINK_PLACING,
    LinkBodies,
    Placed,
    placed_box,
    slack_of,
)
from obb_collision.robots.checks.balls import ball_center, balls_near, body_at, find_balls
from obb_collision.robots.checks.motion_room import (
    BOUND_GROWTH,
    MotionQuestion,
    MotionRoom,
    bend_of,
    pair_bend,
    slot_of,
)
from obb_collision.robots.checks.states import FEW_BALLS, HULL, SPHERE, may_collide, square_distance
from obb_collision.typing import Vector


@njit(inline=True, refcount=False)
def _passes(box: BoxAt, start: Vector, end: Vector, reach: float) -> tuple[bool, Vector]:
    """Return whether a ball that moves straight may touch a box, and a direction to the box.

    start, end: positions of the ball's centre relative to that of the box.
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


#: Of bodies that move farther, relative to their spheres, spheres leave out as many balls as boxes.
FAR_MOVED = 0.5


@njit(refcount=False)
def _moved_at_most(bodies: LinkBodies, p: Placed, q: Placed, i: int) -> float:
    """Return how far a point of the box of body i moves at most from one place of it to another.

    What is between both, their hull, is within that distance of each.
    """
    a, b = placed_box(bodies, p, i), placed_box(bodies, q, i)
    (u, v, w), (x, y, z), half = a.axes, b.axes, a.half_extents
    turned = norm(minus(x, u)) * half[0] + norm(minus(y, v)) * half[1]
    return norm(minus(b.center, a.center)) + turned + norm(minus(z, w)) * half[2]


@njit(merge=True)
def sweep_candidates(
    question: MotionQuestion, room: MotionRoom, blur: float, slot_a: int, slot_b: int
) -> int:
    """Write the pairs that may collide between the times of two slots; return their number.

    In a pair with the world, its body is the first, in whose frame the second one moves.
    """
    checked, bends, times = question.checked, room.bends, room.times
    bodies, tests, tree, clouds = checked.bodies, checked.tests, room.placed, checked.clouds
    nodes, starts, order = tests.nodes, tests.levels, tests.order
    p, q = slot_of(room.placed, slot_a), slot_of(room.placed, slot_b)
    candidates, directions, limits = tree.candidates, room.directions, tree.grown
    allowed, ruled = tests.allowed, len(tests.allowed) > 0
    blocks, levels = tree.waiting[0], tree.waiting[1]
    world = BoxArrays(bodies.centers, bodies.rotations, bodies.half_extents)
    span = times[slot_b] - times[slot_a]
    count = 0
    for k in range(len(tests.links) if len(order) or len(clouds.bodies) else 0):
        group = len(tests.links) - 1 - k
        frame, first, last = tests.links[group], tests.starts[group], tests.starts[group + 1]
        radius = 0.0
        for i in range(first, last):
            bend = bend_of(span, bends.bodies[i, 3], bends.bodies[i, 4], blur)
            slack = max(
                slack_of(bodies, i, vector_at(p.centers, i)),
                slack_of(bodies, i, vector_at(q.centers, i)),
            )
            limits[i] = bend + 2.0 * slack
            radius = max(radius, limits[i])
        radius += tests.spheres[group]
        middle = vector_at(tests.centers, group)
        place_a = plus(
            vector_at(p.positions, frame), components(rows_at(p.rotations, frame), middle)
        )
        place_b = plus(
            vector_at(q.positions, frame), components(rows_at(q.rotations, frame), middle)
        )
        (x, y, z), (u, v, w) = place_a, place_b
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
        for c in range(len(clouds.bodies)):
            j = clouds.bodies[c]
            far, balls = radius + bodies.spheres[j], tree.balls
            most = FEW_BALLS if question.level > SPHERE else len(balls)
            found = find_balls(clouds, c, place_a, place_b, far, tree.waiting, balls, most)
            few = found < FEW_BALLS or question.level == SPHERE
            for i in range(first if not few else last, last):
                few |= _moved_at_most(bodies, p, q, i) > FAR_MOVED * bodies.spheres[i]
            if few and found >= most:
                most = len(balls)
                found = find_balls(clouds, c, place_a, place_b, far, tree.waiting, balls, most)
            for i in range(first, last):
                if ruled and allowed[i, j - tests.first]:
                    continue
                near_ball = bodies.spheres[j] + limits[i] + LINK_PLACING * bodies.reaches[j]
                if not few:  # its box leaves most of them out before they are looked at
                    far = _moved_at_most(bodies, p, q, i) + near_ball
                    far = (far + LINK_PLACING * bodies.reaches[j]) * BOUND_GROWTH
                    box = placed_box(bodies, p, i)
                    wide = tree.waiting, balls, ZERO, math.inf
                    found = balls_near(clouds, c, box, far, False, *wide)
                for m in range(found):
                    center = ball_center(clouds, c, balls[m])
                    b = BoxAt(center, box_at(world, j).axes, (0.0, 0.0, 0.0))
                    near, n = _passes(
                        b,
                        minus(vector_at(p.centers, i), center),
                        minus(vector_at(q.centers, i), center),
                        bodies.spheres[i] + near_ball,
                    )
                    if near:
                        candidates[count, 0] = len(bodies.frames) + balls[m]
                        candidates[count, 1], candidates[count, 2] = i, -1
                        directions[count, 0], directions[count, 1], directions[count, 2] = n
                        count += 1
    pairs, chains = tests.pairs, question.checked.chains
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
        bend = pair_bend(question, bends, m, span, blur)
        frame = bodies.frames[i]
        d = minus(vector_at(p.centers, j), vector_at(p.positions, frame))
        e = minus(vector_at(q.centers, j), vector_at(q.positions, frame))
        b = box_at(world, i)
        start = minus(components(axes_of(p.rotations, frame), d), b.center)
        end = minus(components(axes_of(q.rotations, frame), e), b.center)
        near, n = _passes(b, start, end, bodies.spheres[j] + slack + bend)
        if near or question.level == SPHERE:  # a level without boxes of links
            candidates[count, 0], candidates[count, 1], candidates[count, 2] = i, j, m
            directions[count, 0], directions[count, 1], directions[count, 2] = n
            count += 1
    return count


@njit(inline=True, refcount=False)
def _pose_in(
    bodies: LinkBodies, placed: Placed, fixed: int, moving: int, in_world: bool
) -> PairPose:
    """Return the pose of a body's frame in the frame of a fixed body, or in the world."""
    reach = bodies.radii[fixed] + bodies.radii[moving]
    b = place_at(placed.positions, placed.rotations, bodies.frames[moving])
    if in_world:
        return PairPose(b.axes, b.center, sum_abs(b.center) + reach, 0.0, 0.0)
    return relative_pose(
        place_at(placed.positions, placed.rotations, bodies.frames[fixed]), b, reach
    )


@njit
def _swept_apart(
    a: HullCorners, b: HullCorners, start: PairPose, end: PairPose, first: Vector, reach: float
) -> tuple[bool, Vector]:
    """Return whether a is certainly farther than reach from b at both poses and in between.

    The second result is the last direction. The method is that of ``apart``, with the hull of b at
    both poses together.
    """
    size = max(start.size, end.size)
    bound, unit = GAP_BOUND * size + MESH_UNDERFLOW, unit_scale(size)[0]
    near = (unit * reach) * (unit * reach)
    n, simplex = first, no_simplex(BARE_CORNER)
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
        simplex = with_corner(simplex, (scaled(minus(p, corner), unit),))
        if simplex.size == 4 or not dot(simplex.nearest, simplex.nearest) > near:
            return False, n
        n = simplex.nearest
    return False, n


@njit(inline=True, refcount=False)
def collides(question: MotionQuestion, room: MotionRoom, c: int, slot: int, grown: float) -> bool:
    """Return whether candidate c may be within a distance in the state of a slot.

    Tests and order of bodies are those of ``states``, so that answers agree.
    """
    bodies, placed = question.checked.bodies, slot_of(room.placed, slot)
    i, j = (
        body_at(bodies, question.checked.clouds, placed.candidates[c, 0]),
        placed.candidates[c, 1],
    )
    if placed.candidates[c, 2] < 0:
        i, j = j, i  # the body of the world has the same place in every state
        placed.ready[j] = True
        for k in range(3):
            placed.centers[j, k] = bodies.centers[j, k]
            for m in range(3):
                placed.axes[j, k, m] = bodies.rotations[j, k, m]
        center = vector_at(placed.centers, i)
        reach = bodies.spheres[i] + grown + 2.0 * slack_of(bodies, i, center)
        reach += LINK_PLACING * bodies.reaches[j]
        box = placed_box(bodies, placed, j)
        square = square_distance(box, minus(box.center, center))
        if square > reach * reach * (1.0 + LINK_PLACING):
            return False
    return may_collide(bodies, placed, i, j, grown, question.level)


@njit(inline=True, refcount=False)
def moves_of(
    question: MotionQuestion, room: MotionRoom, blur: float, c: int, slot_a: int, slot_b: int
) -> tuple[float, float]:
    """Return bounds of the way of a point of candidate c between two slots, and of its bend."""
    bodies, bends = question.checked.bodies, room.bends
    p, q = slot_of(room.placed, slot_a), slot_of(room.placed, slot_b)
    i, j, m = p.candidates[c, 0], p.candidates[c, 1], p.candidates[c, 2]
    i = body_at(bodies, question.checked.clouds, i)
    span = abs(room.times[slot_b] - room.times[slot_a])
    if m < 0:
        bend = bend_of(span, bends.bodies[j, 3], bends.bodies[j, 4], blur)
    else:
        bend = pair_bend(question, bends, m, span, blur)
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
    """Return the larger slack of a body in two states."""
    start, end = vector_at(p.centers, i), vector_at(q.centers, i)
    return max(slack_of(bodies, i, start), slack_of(bodies, i, end))


@njit(inline=True, refcount=False)
def stays_apart(
    question: MotionQuestion, room: MotionRoom, blur: float, c: int, slot_a: int, slot_b: int
) -> bool:
    """Return whether candidate c is certainly free between the times of two slots.

    Below "hull" bodies are not convex: they are all that passes the tests of states. These tests
    are repeated with a distance of all that the pair moves.
    """
    if question.level < HULL:
        way, bend = moves_of(question, room, blur, c, slot_a, slot_b)
        return not collides(question, room, c, slot_a, way + bend)
    bodies, bends = question.checked.bodies, room.bends
    p, q = slot_of(room.placed, slot_a), slot_of(room.placed, slot_b)
    i, j, m = p.candidates[c, 0], p.candidates[c, 1], p.candidates[c, 2]
    i = body_at(bodies, question.checked.clouds, i)
    span, slack = room.times[slot_b] - room.times[slot_a], _slack_in(bodies, j, p, q)
    if m < 0:
        bend = bend_of(span, bends.bodies[j, 3], bends.bodies[j, 4], blur)
        slack += LINK_PLACING * bodies.reaches[i]
    else:
        bend = pair_bend(question, bends, m, span, blur)
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

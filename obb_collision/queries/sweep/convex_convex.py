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

"""Time at which two convex bodies that turn as they move first touch: conservative advancement.

At each time a search gives a direction n along which the bodies are apart (``queries.convex``). For
how long is that so? Body a turns at w about a point from which its core reaches r. With n where it
is, how far a point of it reaches along n after a time s is its product with n + s (n x w), but for
s^2 r abs(w) abs(n x w) / 2. So is the whole body, and the gap along n is at least

    n.(d + s v) - h_a(n + s (n x w_a)) - h_b(-n - s (n x w_b)) - radii - K s^2 / 2

for h how far a core reaches, K the sum of both. That is concave in s, as h is convex: where it is
not negative at a time, it was not before, and a chord to its root never steps too far. Without
turning it is a ray against the difference of the bodies, and a step goes to the end of a face (van
den Bergen 2004); with turning steps converge as Newton's do.

Rounding of the gap is at most CONVEX_ROUNDING of the factors of its products, and ``blur``. It
grows with the square of s at most and keeps the bound concave.

Each pair is looked at from the first of the two points that its bodies turn about, so that neither
a way that both share nor being far away costs digits.

Rounding is that of ``rigid``: places and rotations that are off shift a gap by ``blur_at`` or less.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.numerics.vec3 import (
    ZERO,
    axes_of,
    combined,
    components,
    cross,
    dot,
    minus,
    negated,
    norm,
    plus,
    scaled,
    sum_abs,
    vector_at,
)
from obb_collision.queries.convex.distance import CONVEX_ROUNDING, rounding, search
from obb_collision.queries.convex.distances import in_world
from obb_collision.queries.convex.support import (
    HULL_CORE,
    ConvexBodies,
    Core,
    Cores,
    core_at,
    support,
)
from obb_collision.queries.meshes.placed import Place, relative_pose
from obb_collision.queries.sweep.bounds import NARROW_BRACKET, ROOT_ROUNDS, parabola_root
from obb_collision.queries.sweep.motion import (
    OUTWARD,
    center_at,
    offset_and_way,
    rotated,
    turned_by,
)
from obb_collision.queries.sweep.rigid import (
    ANGLE_ROUNDING,
    POSITION_ROUNDING,
    ROTATION_ROUNDING,
    TOLERANCE_FLOOR,
    WHOLE_TURN,
    meeting_window,
)
from obb_collision.queries.sweep.sweep import (
    SweepArrays,
    Sweeps,
    sweep_arrays,
    sweeps_of,
    write_sweep,
)
from obb_collision.typing import Floats, Integers, Vector

#: Maximum number of steps: beyond, the pair is undecided. Ordinary pairs take up to ten.
MAX_STEPS = 1000
#: Of bodies that do not turn: nearer than this counts as touching, relative to both radii. A
#: distance has an error of less than 1e-9 of both sizes.
FINE_TOLERANCE = 1e-8


class BodyMotion(NamedTuple):
    """The motion of n bodies during times 0 to 1, as arrays.

    A body turns about its pivot, which moves straight.
    """

    starts: Floats  #: (n, 3) pivots at time 0
    ends: Floats  #: (n, 3) pivots at time 1, or with ``seconds`` their velocities
    seconds: float  #: how long the velocities last; 0: they are places
    rotations: Floats  #: (n, 3, 3) at time 0
    turns: Floats  #: (n, 3) rotation vectors over the whole time
    arms: Floats  #: (n, 3) from the pivot to the body's origin at time 0
    radii: Floats  #: (n,) sizes of the bodies, of which tolerances are fractions
    reaches: Floats  #: (n,) of the spheres about the pivots that hold the bodies at all times


class RelativeMotion(NamedTuple):
    """The motion of a pair, seen from the pivot of the first body."""

    pivot: Vector  #: of the second body at time 0
    way: Vector  #: displacement of the pivot until time 1
    turns: tuple[Vector, Vector]  #: rotation vectors until time 1
    arms: tuple[Vector, Vector]  #: from the pivots to the origins at time 0
    reach: float  #: of both bodies about their pivots
    begin: float  #: from when to
    last: float  #: when they may touch
    near: float  #: a distance that counts as touching
    fine: float  #: the distance at which the search ends
    stray: tuple[float, float]  #: by how much gaps are off at time 0, and more per unit of time


@njit
def relative_motion(
    motion: BodyMotion, i: int, j: int, begin: float, tolerance: float
) -> RelativeMotion:
    """Return the motion of a pair from a time on."""
    p, _, way = offset_and_way(motion.starts, motion.ends, motion.seconds, i, j)
    u, v = vector_at(motion.turns, i), vector_at(motion.turns, j)
    reach = motion.reaches[i] + motion.reaches[j]
    first, last = meeting_window(p, way, reach)
    slower, faster = min(norm(u), norm(v)), max(norm(u), norm(v))
    if way == ZERO and slower == 0.0:
        last = min(last, first + WHOLE_TURN / faster) if faster > 0.0 else first
    r, s = motion.radii[i], motion.radii[j]
    near = max(tolerance * min(r, s), TOLERANCE_FLOOR * max(r, s))
    fine = min(near, FINE_TOLERANCE * (r + s)) if faster == 0.0 else near
    drift = POSITION_ROUNDING * norm(way) + ANGLE_ROUNDING * (slower + faster) * reach
    stray = POSITION_ROUNDING * norm(p) + 2.0 * ROTATION_ROUNDING * reach, drift
    arms = vector_at(motion.arms, i), vector_at(motion.arms, j)
    begin = max(begin, first)
    return RelativeMotion(p, way, (u, v), arms, reach, begin, last, near, fine, stray)


@njit
def blur_at(relative: RelativeMotion, time: float) -> float:
    """Return a bound on the error of a gap at a time, from the errors of places and rotations."""
    return relative.stray[0] + relative.stray[1] * time


@njit
def places_at(
    motion: BodyMotion, i: int, j: int, relative: RelativeMotion, time: float
) -> tuple[Place, Place]:
    """Return the poses of two bodies at a time, seen from the pivot of the first."""
    turn, other = relative.turns
    arm, far = turned_by(relative.arms[0], turn, time), turned_by(relative.arms[1], other, time)
    far = plus(plus(relative.pivot, scaled(relative.way, time)), far)
    return (
        Place(arm, rotated(axes_of(motion.rotations, i), turn, time)),
        Place(far, rotated(axes_of(motion.rotations, j), other, time)),
    )


#: Pairs below which a second thread does not pay: 0.1 ms.
FEWEST_CONVEX_SWEEPS = 32


class MovingSupport(NamedTuple):
    """How far a body reaches along a direction n, and how that changes as it turns."""

    core: Core
    place: Place  #: seen from its pivot
    n: Vector  #: outward
    change: Vector  #: n x w
    bend: float  #: of its reach, the second derivative at most


class MovingGap(NamedTuple):
    """The gap along a direction at a time, and how it changes."""

    a: MovingSupport
    b: MovingSupport
    gap: float  #: of the pivots, less the radii
    rate: float
    bend: float
    slack: Vector  #: bound of rounding: a constant, a factor of s, a factor of s^2


def convex_sweeps(
    bodies: ConvexBodies, motion: BodyMotion, pairs: Integers, begin: Floats, tolerance: float
) -> Sweeps:
    """Return when pairs (m, 2) of moving bodies first touch; times from 0 to 1.

    motion: of the bodies; it replaces their poses. begin (m,): times until which each pair is
    certainly apart. At the time of a hit, bodies that turn are as near as ``sweeps`` promises for
    boxes; others are nearer than 1e-8 of both radii and 1e-9 of S (``queries.convex.distance``), if
    that is less.
    """
    out = sweep_arrays(len(pairs))
    arguments = bodies.arrays, motion, pairs, begin, tolerance, out
    run(_convex_kernel, len(pairs), FEWEST_CONVEX_SWEEPS, *arguments)
    return sweeps_of(pairs, out)


@njit
def _convex_kernel(
    bodies: Cores, motion: BodyMotion, pairs: np.ndarray, begin: Floats, tolerance: float,
    out: SweepArrays, start: int, stop: int,
) -> None:  # fmt: skip
    for row in range(start, stop):
        i, j = pairs[row, 0], pairs[row, 1]
        relative = relative_motion(motion, i, j, begin[row], tolerance)
        time, decided, point, normal = _walk(bodies, motion, i, j, relative)
        write_sweep(out, row, time, decided, point, normal)


@njit(merge=True)
def _walk(
    bodies: Cores, motion: BodyMotion, i: int, j: int, relative: RelativeMotion
) -> tuple[float, bool, Vector, Vector]:
    """Return the time of contact, infinity if none, True, and the point and normal of contact.

    Or the time until which the bodies are certainly apart, and False.
    """
    a, b = core_at(bodies, i), core_at(bodies, j)
    nowhere, n, time = (np.nan, np.nan, np.nan), ZERO, relative.begin
    for _ in range(MAX_STEPS):
        if not time <= relative.last:
            return np.inf, True, nowhere, nowhere
        place, other = places_at(motion, i, j, relative, time)
        pose = relative_pose(place, other, a.reach + b.reach)
        apart = search(a, b, pose, components(place.axes, n), np.inf)
        off = a.radius + b.radius
        error = rounding(pose) + blur_at(relative, time)
        n = combined(place.axes, apart.normal)
        upper = max(apart.distance - off, 0.0) + error
        lower = apart.gap - off - error
        if upper <= relative.fine or not lower > 0.25 * relative.fine:
            if not upper <= relative.near:
                return time, False, nowhere, nowhere
            p = plus(in_world(place, apart.p), scaled(n, a.radius))
            q = minus(in_world(other, apart.q), scaled(n, b.radius))
            origin = center_at(motion.starts, motion.ends, motion.seconds, i, time)
            return time, True, plus(origin, scaled(plus(p, q), 0.5)), n
        moving = _moving_gap(motion, i, j, relative, PlacedCores(a, b, place, other), n, time)
        step = _free_for(moving, relative.last - time)
        if not step > 0.0:
            break
        time += step
    return time, False, nowhere, nowhere


class PlacedCores(NamedTuple):
    """Two cores and their poses."""

    a: Core
    b: Core
    place: Place
    other: Place


@njit
def _moving_gap(
    motion: BodyMotion,
    i: int,
    j: int,
    relative: RelativeMotion,
    pair: PlacedCores,
    n: Vector,
    time: float,
) -> MovingGap:
    """Return the gap of two bodies along n from a time on."""
    pivots = plus(relative.pivot, scaled(relative.way, time))
    other = Place(minus(pair.other.center, pivots), pair.other.axes)
    a = _moving_support(motion.reaches[i], pair.a, pair.place, relative.turns[0], n)
    b = _moving_support(motion.reaches[j], pair.b, other, relative.turns[1], negated(n))
    gap = dot(n, pivots) - pair.a.radius - pair.b.radius
    speed, turning = norm(relative.way), norm(relative.turns[0]) + norm(relative.turns[1])
    size = sum_abs(pivots) + relative.reach + pair.a.reach + pair.b.reach
    size += sum_abs(a.place.center) + sum_abs(b.place.center)
    fixed = CONVEX_ROUNDING * size + blur_at(relative, time) + MESH_UNDERFLOW
    growing = CONVEX_ROUNDING * (size * turning + 2.0 * speed) + relative.stray[1]
    square = CONVEX_ROUNDING * 2.0 * speed * turning
    bend = a.bend + b.bend
    return MovingGap(a, b, gap, dot(n, relative.way), bend, (fixed, growing, square))


@njit
def _moving_support(
    reach: float, core: Core, place: Place, turn: Vector, n: Vector
) -> MovingSupport:
    """Return the support of a body; place: seen from its pivot, reach: about that."""
    change = cross(n, turn)
    (x, y, z), half = core.size, core.half
    own = core.reach - 2.0 * core.radius if core.kind == HULL_CORE else norm((x, y, z + half))
    reach = min(reach, (own + norm(place.center)) * OUTWARD)
    return MovingSupport(core, place, n, change, norm(turn) * norm(change) * reach)


@njit
def _reach(moving: MovingSupport, time: float) -> tuple[float, float]:
    """Return how far a core reaches after a time, but for ``bend``, and how that changes."""
    m = plus(moving.n, scaled(moving.change, time))
    axes = moving.place.axes
    u = components(axes, m)
    p = support(moving.core, u)
    return (
        dot(u, p) + dot(m, moving.place.center),
        dot(components(axes, moving.change), p) + dot(moving.change, moving.place.center),
    )


@njit
def _gap_after(moving: MovingGap, time: float) -> tuple[float, float]:
    """Return a lower bound of the gap along the direction after a time, and its derivative."""
    a, b = _reach(moving.a, time), _reach(moving.b, time)
    fixed, growing, square = moving.slack
    slack = fixed + (growing + square * time) * time
    value = moving.gap + (moving.rate - 0.5 * moving.bend * time) * time - a[0] - b[0] - slack
    return value, moving.rate - moving.bend * time - a[1] - b[1]


@njit
def _free_for(moving: MovingGap, horizon: float) -> float:
    """Return for how long the gap certainly is not negative; infinity if until the horizon.

    As in ``bounds``: each round takes the tangent's parabola at the left end for a new right end,
    and the chord for a new left end.
    """
    left, right = 0.0, horizon
    value, slope = _gap_after(moving, 0.0)
    if not value > 0.0:
        return 0.0
    for _ in range(ROOT_ROUNDS):
        right = min(right, left + parabola_root(value, slope, moving.bend))
        at_right, _ = _gap_after(moving, right)
        if at_right >= 0.0:
            return np.inf if right >= horizon else right
        left += (right - left) * (value / (value - at_right))
        value, slope = _gap_after(moving, left)
        if value <= 0.0 or right - left <= NARROW_BRACKET * right:
            break
    return left

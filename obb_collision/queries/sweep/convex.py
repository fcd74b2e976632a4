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

What rounding may take from the gap, CONVEX_ROUNDING of what the products are made of, and ``blur``,
grows with the square of s at most and keeps it concave.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.numerics.vec3 import (
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
)
from obb_collision.queries.convex.distance import CONVEX_ROUNDING, rounding, search
from obb_collision.queries.convex.distances import in_world
from obb_collision.queries.convex.support import (
    CORNERS,
    ConvexBodies,
    Core,
    Cores,
    core_at,
    support,
)
from obb_collision.queries.meshes.tree_boxes import Place, relative_pose
from obb_collision.queries.sweep.bounds import NARROW, ROOT_ROUNDS, parabola_root
from obb_collision.queries.sweep.course import (
    MAX_STEPS,
    BodyMotion,
    Course,
    blur_at,
    course_of,
    places_at,
)
from obb_collision.queries.sweep.motion import OUTWARD, place_at
from obb_collision.queries.sweep.sweep import Sweeps
from obb_collision.typing import Floats, Integers, Vector

#: Pairs below which a second thread does not pay: 0.1 ms.
FEWEST_PAIRS = 32


class Turner(NamedTuple):
    """What a body adds to the gap along a direction n, and how that changes as it turns."""

    core: Core
    place: Place  #: seen from its pivot
    n: Vector  #: outward
    change: Vector  #: n x w
    bend: float  #: of its reach, the second derivative at most


class Slab(NamedTuple):
    """The gap along a direction at a time, and how it changes."""

    a: Turner
    b: Turner
    gap: float  #: of the pivots, less the radii
    rate: float
    bend: float
    slack: Vector  #: what rounding may take: a constant, times s, times s^2


def convex_sweeps(
    bodies: ConvexBodies, motion: BodyMotion, pairs: Integers, begin: Floats, tolerance: float
) -> Sweeps:
    """Return when pairs (m, 2) of moving bodies first touch; times from 0 to 1.

    motion: of the bodies, whose own places are not read; begin (m,): until when each
    pair is certainly apart. Promised is what ``sweeps`` promises of boxes that turn; nearer than
    1e-8 of both radii and 1e-9 of S (``queries.convex.distance``), if less, where neither does.
    """
    count = len(pairs)
    free, undecided = np.empty(count), np.empty(count, np.bool_)
    points, normals = np.empty((2, count, 3))
    run(
        *(_convex_kernel, count, FEWEST_PAIRS, bodies.arrays, motion, pairs, begin, tolerance),
        *(free, undecided, points, normals),
    )
    times = np.where(undecided, np.nan, free)
    return Sweeps(pairs, np.isfinite(times), undecided, times, free, points, normals)


@njit
def _convex_kernel(
    bodies: Cores, motion: BodyMotion, pairs: np.ndarray, begin: Floats, tolerance: float,
    free: Floats, undecided: np.ndarray, points: Floats, normals: Floats, start: int, stop: int,
) -> None:  # fmt: skip
    for row in range(start, stop):
        i, j = pairs[row, 0], pairs[row, 1]
        course = course_of(motion, i, j, begin[row], tolerance)
        time, known, point, normal = _walk(bodies, motion, i, j, course)
        free[row], undecided[row] = time, not known
        for k in range(3):
            points[row, k], normals[row, k] = point[k], normal[k]


@njit
def _walk(
    bodies: Cores, motion: BodyMotion, i: int, j: int, course: Course
) -> tuple[float, bool, Vector, Vector]:
    """Return the time of contact, infinity for none, True, a point and the normal of contact.

    Or the time until which the bodies are certainly apart, and False.
    """
    a, b = core_at(bodies, i), core_at(bodies, j)
    nowhere, n, time = (np.nan, np.nan, np.nan), (0.0, 0.0, 0.0), course.begin
    for _ in range(MAX_STEPS):
        if not time <= course.last:
            return np.inf, True, nowhere, nowhere
        place, other = places_at(motion, i, j, course, time)
        pose = relative_pose(place, other, a.reach + b.reach)
        found = search(a, b, pose, components(place.axes, n), np.inf)
        off = a.radius + b.radius
        error = rounding(pose) + blur_at(course, time)
        n = combined(place.axes, found.normal)
        upper = max(found.distance - off, 0.0) + error
        lower = found.gap - off - error
        if upper <= course.fine or not lower > 0.25 * course.fine:
            if not upper <= course.near:
                return time, False, nowhere, nowhere
            p = plus(in_world(place, found.p), scaled(n, a.radius))
            q = minus(in_world(other, found.q), scaled(n, b.radius))
            origin = place_at(motion.starts, motion.ends, motion.seconds, i, time)
            return time, True, plus(origin, scaled(plus(p, q), 0.5)), n
        slab = _slab(motion, i, j, course, PlacedCores(a, b, place, other), n, time)
        step = _free_for(slab, course.last - time)
        if not step > 0.0:
            break
        time += step
    return time, False, nowhere, nowhere


class PlacedCores(NamedTuple):
    """Two cores and where they are."""

    a: Core
    b: Core
    place: Place
    other: Place


@njit
def _slab(
    motion: BodyMotion, i: int, j: int, course: Course, pair: PlacedCores, n: Vector, time: float
) -> Slab:
    """Return the gap along n of the bodies at a time, and from then on."""
    pivots = plus(course.pivot, scaled(course.way, time))
    other = Place(minus(pair.other.center, pivots), pair.other.axes)
    a = _turner(motion.reaches[i], pair.a, pair.place, course.turns[0], n)
    b = _turner(motion.reaches[j], pair.b, other, course.turns[1], negated(n))
    gap = dot(n, pivots) - pair.a.radius - pair.b.radius
    speed, turning = norm(course.way), norm(course.turns[0]) + norm(course.turns[1])
    size = sum_abs(pivots) + course.reach + pair.a.reach + pair.b.reach
    size += sum_abs(a.place.center) + sum_abs(b.place.center)
    fixed = CONVEX_ROUNDING * size + blur_at(course, time) + MESH_UNDERFLOW
    growing = CONVEX_ROUNDING * (size * turning + 2.0 * speed) + course.stray[1]
    square = CONVEX_ROUNDING * 2.0 * speed * turning
    bend = a.bend + b.bend
    return Slab(a, b, gap, dot(n, course.way), bend, (fixed, growing, square))


@njit
def _turner(reach: float, core: Core, place: Place, turn: Vector, n: Vector) -> Turner:
    """Return what a body adds; place: seen from its pivot, reach: about that."""
    change = cross(n, turn)
    (x, y, z), half = core.size, core.half
    own = core.reach - 2.0 * core.radius if core.kind == CORNERS else norm((x, y, z + half))
    reach = min(reach, (own + norm(place.center)) * OUTWARD)
    return Turner(core, place, n, change, norm(turn) * norm(change) * reach)


@njit
def _reach(turner: Turner, time: float) -> tuple[float, float]:
    """Return how far a core reaches after a time, but for ``bend``, and how that changes."""
    m = plus(turner.n, scaled(turner.change, time))
    axes = turner.place.axes
    u = components(axes, m)
    p = support(turner.core, u)
    return (
        dot(u, p) + dot(m, turner.place.center),
        dot(components(axes, turner.change), p) + dot(turner.change, turner.place.center),
    )


@njit
def _gap_after(slab: Slab, time: float) -> tuple[float, float]:
    """Return what the gap along the direction is at least after a time, and its derivative."""
    a, b = _reach(slab.a, time), _reach(slab.b, time)
    fixed, growing, square = slab.slack
    slack = fixed + (growing + square * time) * time
    value = slab.gap + (slab.rate - 0.5 * slab.bend * time) * time - a[0] - b[0] - slack
    return value, slab.rate - slab.bend * time - a[1] - b[1]


@njit
def _free_for(slab: Slab, horizon: float) -> float:
    """Return for how long the gap certainly is not negative; infinity if until the horizon.

    As ``bounds``: each round takes the tangent's parabola at the left end for a new right end, and
    the chord for a new left end.
    """
    left, right = 0.0, horizon
    value, slope = _gap_after(slab, 0.0)
    if not value > 0.0:
        return 0.0
    for _ in range(ROOT_ROUNDS):
        right = min(right, left + parabola_root(value, slope, slab.bend))
        at_right, _ = _gap_after(slab, right)
        if at_right >= 0.0:
            return np.inf if right >= horizon else right
        left += (right - left) * (value / (value - at_right))
        value, slope = _gap_after(slab, left)
        if value <= 0.0 or right - left <= NARROW * right:
            break
    return left

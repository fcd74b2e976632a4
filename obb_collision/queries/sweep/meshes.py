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

"""Times at which meshes that turn as they move first touch: conservative advancement.

No two points of bodies that are apart by d meet before one has moved by d as seen from the other.
Seen from the world, from a and from b, points move at most as fast as

    |v| + |w_a| r_a + |w_b| r_b,  |v| + |w_b - w_a| r_b + |w_a| p,  |v| + |w_b - w_a| r_a + |w_b| p

for v the speed between the points that they turn about, w the turns, r how far bodies reach from
these points and p how far the points are from each other at most. The distance is a certified
one (``queries.meshes.mesh_clearance``), and the least of the three decides (Mirtich 1996).

Conservative advancement as in ``sweep.meshes``, on the certified distance of a mesh and the body
itself (``queries.convex.distances``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.trees.build import HALF
from obb_collision.geometry.validation import as_array, check_magnitude
from obb_collision.numerics.constants import MESH_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.vec3 import combined, minus, norm, plus, scaled
from obb_collision.queries.convex.distance import rounding
from obb_collision.queries.convex.distances import NOWHERE, core_room, mesh_apart, towards
from obb_collision.queries.convex.support import ConvexBodies, Cores, core_at
from obb_collision.queries.meshes.mesh_clearance import as_radii, surfaces_apart
from obb_collision.queries.meshes.placed import (
    MeshAt,
    Meshes,
    PlacedMeshes,
    mesh_pair,
    moved,
    relative_pose,
)
from obb_collision.queries.meshes.two_trees import DISTANCE_BOUND, TreeRoom, tree_room
from obb_collision.queries.sweep.convex import (
    MAX_STEPS,
    BodyMotion,
    Course,
    blur_at,
    course_of,
    places_at,
)
from obb_collision.queries.sweep.motion import OUTWARD, bounding_radii, place_at
from obb_collision.queries.sweep.sweep import (
    TOLERANCE,
    SweepArrays,
    Sweeps,
    as_tolerance,
    sweep_arrays,
    sweeps_of,
    write_sweep,
)
from obb_collision.queries.verdict.pair_rows import as_sides
from obb_collision.typing import Floats, Integers

#: Pairs below which a second thread does not pay: 0.2 ms.
FEWEST_PAIRS = 4
#: Meshes and their radii, of both sides.
MeshSides = tuple[Meshes, Floats, Meshes, Floats]


def mesh_sweeps(
    a: PlacedMeshes,
    b: PlacedMeshes,
    pairs: ArrayLike | None = None,
    *,
    duration: float,
    twists_a: ArrayLike = 0.0,
    twists_b: ArrayLike = 0.0,
    radii_a: ArrayLike = 0.0,
    radii_b: ArrayLike = 0.0,
    tolerance: float = TOLERANCE,
) -> Sweeps:
    """Return when meshes, with radii, that keep their twists (n, 6) first touch."""
    i, j = as_sides(a, b, pairs)
    seconds = float(as_array(duration, "duration", ()))
    near = as_tolerance(tolerance)
    if seconds <= 0.0:
        raise ValueError(f"duration must be positive, got {seconds:g}")
    sides = ((a, i, twists_a, radii_a, "a"), (b, j, twists_b, radii_b, "b"))
    radii = [as_radii(r, f"radii_{name}", len(x))[rows] for x, rows, _, r, name in sides]
    motions = [
        _motion(x, _twists(t, f"twists_{name}", len(x)), as_radii(r, "", len(x)), seconds, rows)
        for x, rows, t, r, name in sides
    ]
    first, second, motion = _taken(a, i), _taken(b, j), join_motions(*motions)
    found = swept_meshes(first, radii[0], second, radii[1], motion, np.zeros(len(i)), near)
    free = found.free_until * seconds
    times = np.where(found.undecided, np.nan, free)
    return replace(found, pairs=np.stack([i, j], axis=1), times=times, free_until=free)


def _twists(given: ArrayLike, name: str, count: int) -> Floats:
    try:
        rows = np.broadcast_to(np.asarray(given, np.float64), (count, 6))
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} must be one number, one row of six or (n, 6)") from None
    return as_array(rows, name, (count, 6))


def _taken(bodies: PlacedMeshes, rows: Integers) -> PlacedMeshes:
    return PlacedMeshes.trusted(
        bodies.trees, bodies.meshes[rows], bodies.centers[rows], bodies.rotations[rows]
    )


def _motion(
    bodies: PlacedMeshes, twists: Floats, radii: Floats, seconds: float, rows: Integers
) -> BodyMotion:
    """Return the motion of rows of bodies that keep their twists (n, 6)."""
    trees = bodies.trees
    boxes = trees.nodes[trees.roots[bodies.meshes]]
    sizes = bounding_radii(boxes[:, HALF : HALF + 3].copy()) + radii
    reaches = (bounding_radii(boxes[:, :3].copy()) + sizes) * OUTWARD
    with np.errstate(over="ignore"):
        moved = twists * seconds
    check_magnitude(moved, "twists times duration", by_row=True)
    starts, rotations = bodies.centers[rows], bodies.rotations[rows]
    turns, arms = moved[rows, 3:], np.zeros((len(rows), 3))
    speeds, sizes, reaches = twists[rows, :3], sizes[rows], reaches[rows]
    return BodyMotion(starts, speeds, seconds, rotations, turns, arms, sizes, reaches)


def join_motions(a: BodyMotion, b: BodyMotion) -> BodyMotion:
    """Return the motion of both sets, during the same times: that of b behind that of a."""
    columns = zip(a, b, strict=True)
    both = (x if isinstance(x, float) else np.concatenate([x, y]) for x, y in columns)
    return BodyMotion._make(both)


def swept_meshes(
    a: PlacedMeshes,
    radii_a: Floats,
    b: PlacedMeshes,
    radii_b: Floats,
    motion: BodyMotion,
    begin: Floats,
    tolerance: float,
) -> Sweeps:
    """Return when bodies of a first touch those of b in the same rows (m,); times from 0 to 1.

    motion: of a and, behind, of b, whose own places are not read; begin (m,): until when each pair
    is certainly apart.
    """
    out, rows = sweep_arrays(len(a)), np.arange(len(a))
    given = (a.arrays, radii_a, b.arrays, radii_b), motion, begin, tolerance, out
    run(_mesh_kernel, len(a), FEWEST_PAIRS, *given)
    return sweeps_of(np.stack([rows, rows], axis=1), out)


@njit
def _mesh_kernel(
    bodies: MeshSides,
    motion: BodyMotion,
    begin: Floats,
    tolerance: float,
    out: SweepArrays,
    start: int,
    stop: int,
) -> None:
    _mesh_range(bodies, motion, begin, tolerance, out, tree_room(1), start, stop)


@njit(refcount=False)
def _mesh_range(
    bodies: MeshSides, motion: BodyMotion, begin: Floats, tolerance: float, out: SweepArrays,
    room: TreeRoom, start: int, stop: int,
) -> None:  # fmt: skip
    a, radii_a, b, radii_b = bodies
    trees_a, trees_b, count = a.trees, b.trees, len(begin)
    for n in range(start, stop):
        course = course_of(motion, n, count + n, begin[n], tolerance)
        i, j, radius, other = a.meshes[n], b.meshes[n], radii_a[n], radii_b[n]
        speed = speed_of(trees_a.radii[i], trees_b.radii[j], motion, n, count + n, course)
        time, known = course.begin, False
        point = normal = np.nan, np.nan, np.nan
        for _ in range(MAX_STEPS):
            if not time <= course.last:
                time, known = np.inf, True
                break
            place, far = places_at(motion, n, count + n, course, time)
            pair = mesh_pair(trees_a, MeshAt(i, place), trees_b, MeshAt(j, far))
            found = surfaces_apart(pair, np.inf, room)
            error = DISTANCE_BOUND * (pair.pose.size + radius + other) + MESH_UNDERFLOW
            error += blur_at(course, time)
            lower = found.lower - radius - other - error
            upper = max(found.upper - radius - other, 0.0) + error
            if upper <= course.near or not lower > 0.25 * course.near:
                known = upper <= course.near
                if known:
                    x = plus(found.x, scaled(found.n, radius))
                    y = minus(found.y, scaled(found.n, other))
                    point = plus(place.center, combined(place.axes, scaled(plus(x, y), 0.5)))
                    origin = place_at(motion.starts, motion.ends, motion.seconds, n, time)
                    point, normal = plus(origin, point), combined(place.axes, found.n)
                break
            step = lower / speed * (1.0 - 4.0 * ROUNDOFF)
            if not step > 0.0:
                break
            time += step
        write_sweep(out, n, time, known, point, normal)


@njit
def speed_of(
    size: float, other_size: float, motion: BodyMotion, i: int, j: int, course: Course
) -> float:
    """Return how fast points of two bodies move at most, one seen from the other.

    Their sizes: how far they reach from their origins.
    """
    (u, v), (arm, other), way = course.turns, course.arms, norm(course.way)
    r = min(motion.reaches[i], norm(arm) + size)
    s = min(motion.reaches[j], norm(other) + other_size)
    first = plus(course.pivot, scaled(course.way, course.begin))
    last = plus(course.pivot, scaled(course.way, course.last))
    far, both = max(norm(first), norm(last)), norm(minus(v, u))
    turning = min(norm(u) * r + norm(v) * s, both * s + norm(u) * far, both * r + norm(v) * far)
    return (way + turning) * OUTWARD


def swept_mesh_bodies(
    meshes: PlacedMeshes,
    radii: Floats,
    bodies: ConvexBodies,
    motion: BodyMotion,
    begin: Floats,
    tolerance: float,
) -> Sweeps:
    """Return when meshes, with radii (m,), first touch the bodies in the same rows (m,).

    Times are from 0 to 1. motion: of the meshes and, behind, of the bodies, whose own places are
    not read; begin (m,): until when each pair is certainly apart. Bodies have no corners.
    """
    out, rows = sweep_arrays(len(meshes)), np.arange(len(meshes))
    given = (meshes.arrays, radii, bodies.arrays), motion, begin, tolerance, out
    run(_body_kernel, len(meshes), FEWEST_PAIRS, *given)
    return sweeps_of(np.stack([rows, rows], axis=1), out)


@njit
def _body_kernel(
    bodies: tuple[Meshes, Floats, Cores],
    motion: BodyMotion,
    begin: Floats,
    tolerance: float,
    out: SweepArrays,
    start: int,
    stop: int,
) -> None:
    a, radii, b = bodies
    trees, count, room = a.trees, len(begin), core_room()
    for row in range(start, stop):
        course = course_of(motion, row, count + row, begin[row], tolerance)
        i, radius, core = a.meshes[row], radii[row], core_at(b, row)
        speed = speed_of(trees.radii[i], core.reach, motion, row, count + row, course)
        reach, both = 2.0 * (trees.radii[i] + radius) + core.reach, radius + core.radius
        time, known = course.begin, False
        point = normal = np.nan, np.nan, np.nan
        for _ in range(MAX_STEPS):
            if not time <= course.last:
                time, known = np.inf, True
                break
            place, far = places_at(motion, row, count + row, course, time)
            pose = relative_pose(place, far, reach)
            found = mesh_apart(trees, i, core, pose, np.inf, room)
            error = rounding(pose) + blur_at(course, time)
            lower, upper = found.lower - both - error, max(found.upper - both, 0.0) + error
            if upper <= course.near or not lower > 0.25 * course.near:
                known = upper <= course.near
                if known:
                    p, q = found.p, moved(pose, found.q)
                    n = found.normal if found.lower > error else towards(p, q, found.normal)
                    n = n if found.upper > 0.0 else NOWHERE
                    x, y = plus(p, scaled(n, radius)), minus(q, scaled(n, core.radius))
                    point = plus(place.center, combined(place.axes, scaled(plus(x, y), 0.5)))
                    origin = place_at(motion.starts, motion.ends, motion.seconds, row, time)
                    point, normal = plus(origin, point), combined(place.axes, n)
                break
            step = lower / speed * (1.0 - 4.0 * ROUNDOFF)
            if not step > 0.0:
                break
            time += step
        write_sweep(out, row, time, known, point, normal)

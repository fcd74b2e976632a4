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
these points and p how far the points are from each other at most. The least of the three decides
(Mirtich 1996). The distance is a certified one, of two meshes (``queries.meshes.mesh_mesh``)
or of a mesh and the body itself (``queries.convex.distances``).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.trees.build import HALF
from obb_collision.geometry.validation import as_array, check_magnitude
from obb_collision.numerics.constants import MESH_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.vec3 import ZERO, combined, minus, norm, plus, scaled
from obb_collision.queries.convex.distance import rounding
from obb_collision.queries.convex.distances import CoreRoom, core_room, mesh_apart, towards
from obb_collision.queries.convex.support import ConvexBodies, Solids, borrowed_core, solids_of
from obb_collision.queries.meshes.mesh_mesh import as_radii, surfaces_apart
from obb_collision.queries.meshes.placed import (
    MeshAt,
    Meshes,
    Place,
    PlacedMeshes,
    mesh_pair,
    moved,
    relative_pose,
)
from obb_collision.queries.meshes.trees import DISTANCE_BOUND, TreeRoom, tree_room
from obb_collision.queries.sweep.convex_convex import (
    MAX_STEPS,
    BodyMotion,
    RelativeMotion,
    blur_at,
    places_at,
    relative_motion,
)
from obb_collision.queries.sweep.motion import OUTWARD, bounding_radii, center_at, joined_motions
from obb_collision.queries.sweep.sweep import (
    TOLERANCE,
    SweepArrays,
    Sweeps,
    as_tolerance,
    sweep_arrays,
    sweeps_of,
    write_sweep,
)
from obb_collision.queries.verdict.pair_rows import as_each, as_sides
from obb_collision.typing import Floats, Vector

#: Pairs below which a second thread does not pay: 0.2 ms.
FEWEST_MESH_SWEEPS = 4


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
    taken, radii, motions = [], [], list[BodyMotion]()
    for side, rows, twists, padding_of, name in (
        (a, i, twists_a, radii_a, "a"),
        (b, j, twists_b, radii_b, "b"),
    ):
        padding = as_radii(padding_of, f"radii_{name}", len(side))
        motion = _twisting(side, twists, f"twists_{name}", padding, seconds)
        motions.append(BodyMotion._make(x if isinstance(x, float) else x[rows] for x in motion))
        radii.append(padding[rows])
        places = side.centers[rows], side.rotations[rows]
        taken.append(PlacedMeshes.trusted(side.trees, side.meshes[rows], *places))
    begin = np.zeros(len(i))
    sweeps = swept_meshes(
        taken[0], radii[0], taken[1], radii[1], joined_motions(*motions), begin, near
    )
    free = sweeps.free_until * seconds
    times = np.where(sweeps.undecided, np.nan, free)
    return replace(sweeps, pairs=np.stack([i, j], axis=1), times=times, free_until=free)


def _twisting(
    bodies: PlacedMeshes, values: ArrayLike, name: str, radii: Floats, seconds: float
) -> BodyMotion:
    """Return the motion of bodies, with radii (n,), that keep their twists (n, 6)."""
    what, trees = "a number, a row of six numbers, or rows (n, 6)", bodies.trees
    twists = as_each(values, name, what, (len(bodies), 6))
    check_magnitude(twists, name, by_row=False)
    boxes = trees.nodes[trees.roots[bodies.meshes]]
    sizes = bounding_radii(boxes[:, HALF : HALF + 3].copy()) + radii
    reaches = (bounding_radii(boxes[:, :3].copy()) + sizes) * OUTWARD
    with np.errstate(over="ignore"):
        moved = twists * seconds
    check_magnitude(moved, "twists times duration", by_row=True)
    places, arms = (bodies.arrays.centers, twists[:, :3]), np.zeros((len(bodies), 3))
    return BodyMotion(*places, seconds, bodies.arrays.rotations, moved[:, 3:], arms, sizes, reaches)


class SweptBodies(NamedTuple):
    """Meshes, and in the same rows other meshes, or convex bodies that are not hulls."""

    a: Meshes
    radii: Floats
    b: Solids


def swept_meshes(
    a: PlacedMeshes,
    radii_a: Floats,
    b: PlacedMeshes | ConvexBodies,
    radii_b: Floats | None,
    motion: BodyMotion,
    begin: Floats,
    tolerance: float,
) -> Sweeps:
    """Return when meshes of a first touch the bodies of b in the same rows (m,).

    Times are from 0 to 1. radii_a, radii_b (m,): of meshes, metres; convex bodies have radii of
    their own, and must not be hulls. motion: rows of a, then those of b; it replaces the poses.
    begin (m,): times until which each pair is certainly apart. tolerance: as of ``sweeps``.
    """
    out, rows = sweep_arrays(len(a)), np.arange(len(a))
    others = solids_of(b, np.empty(0) if radii_b is None else radii_b)
    arguments = SweptBodies(a.arrays, radii_a, others), motion, begin, tolerance, out
    run(_sweep_kernel, len(a), FEWEST_MESH_SWEEPS, *arguments)
    return sweeps_of(np.stack([rows, rows], axis=1), out)


@njit
def _sweep_kernel(
    pairs: SweptBodies, motion: BodyMotion, begin: Floats, tolerance: float, out: SweepArrays,
    start: int, stop: int,
) -> None:  # fmt: skip
    trees, b = pairs.a.trees, pairs.b
    count, tree, core = len(begin), tree_room(1), core_room()
    for n in range(start, stop):
        relative = relative_motion(motion, n, count + n, begin[n], tolerance)
        sizes = trees.radii[pairs.a.meshes[n]], _size_of(b, n)
        speed = _speed_of(sizes[0], sizes[1], motion, n, count + n, relative)
        time, decided = relative.begin, False
        point = normal = np.nan, np.nan, np.nan
        for _ in range(MAX_STEPS):
            if not time <= relative.last:
                time, decided = np.inf, True
                break
            place, far = places_at(motion, n, count + n, relative, time)
            blur = blur_at(relative, time)
            apart = _distance(pairs, n, place, far, blur, tree, core)
            lower, upper, middle, across = apart
            if upper <= relative.near or not lower > 0.25 * relative.near:
                decided = upper <= relative.near
                if decided:
                    point = plus(place.center, combined(place.axes, middle))
                    origin = center_at(motion.starts, motion.ends, motion.seconds, n, time)
                    point, normal = plus(origin, point), combined(place.axes, across)
                break
            step = lower / speed * (1.0 - 4.0 * ROUNDOFF)
            if not step > 0.0:
                break
            time += step
        write_sweep(out, n, time, decided, point, normal)


@njit(refcount=False)
def _size_of(b: Solids, n: int) -> float:
    """Return how far the second body of a pair reaches from its origin."""
    meshes = b.meshes
    if len(meshes.meshes) > 0:
        return meshes.trees.radii[meshes.meshes[n]]
    return borrowed_core(b.cores, n).reach


@njit(refcount=False)
def _distance(
    pairs: SweptBodies,
    n: int,
    place: Place,
    far: Place,
    off: float,
    tree: TreeRoom,
    core: CoreRoom,
) -> tuple[float, float, Vector, Vector]:
    """Return bounds of the distance of a pair, the point halfway between, and the direction.

    Point and direction are in the frame of the mesh; off: the error of places.
    """
    trees, i, radius = pairs.a.trees, pairs.a.meshes[n], pairs.radii[n]
    meshes = pairs.b.meshes
    if len(meshes.meshes) > 0:
        other, second = pairs.b.radii[n], MeshAt(meshes.meshes[n], far)
        pair = mesh_pair(trees, MeshAt(i, place), meshes.trees, second)
        near = surfaces_apart(pair, np.inf, tree)
        error = DISTANCE_BOUND * (pair.pose.size + radius + other) + MESH_UNDERFLOW
        error += off
        lower = near.lower - radius - other - error
        upper = max(near.upper - radius - other, 0.0) + error
        x, y = plus(near.x, scaled(near.n, radius)), minus(near.y, scaled(near.n, other))
        return lower, upper, scaled(plus(x, y), 0.5), near.n
    body = borrowed_core(pairs.b.cores, n)
    both = radius + body.radius
    pose = relative_pose(place, far, 2.0 * (trees.radii[i] + radius) + body.reach)
    apart = mesh_apart(trees, i, body, pose, np.inf, core)
    error = rounding(pose) + off
    lower, upper = apart.lower - both - error, max(apart.upper - both, 0.0) + error
    p, q = apart.p, moved(pose, apart.q)
    normal = apart.normal if apart.lower > error else towards(p, q, apart.normal)
    normal = normal if apart.upper > 0.0 else ZERO
    x, y = plus(p, scaled(normal, radius)), minus(q, scaled(normal, body.radius))
    return lower, upper, scaled(plus(x, y), 0.5), normal


@njit
def _speed_of(
    size: float, other_size: float, motion: BodyMotion, i: int, j: int, relative: RelativeMotion
) -> float:
    """Return the maximum speed of points of two bodies, seen from each other.

    Sizes: how far the bodies reach from their origins.
    """
    (u, v), (arm, other), way = relative.turns, relative.arms, norm(relative.way)
    r = min(motion.reaches[i], norm(arm) + size)
    s = min(motion.reaches[j], norm(other) + other_size)
    first = plus(relative.pivot, scaled(relative.way, relative.begin))
    last = plus(relative.pivot, scaled(relative.way, relative.last))
    far, both = max(norm(first), norm(last)), norm(minus(v, u))
    turning = min(norm(u) * r + norm(v) * s, both * s + norm(u) * far, both * r + norm(v) * far)
    return (way + turning) * OUTWARD

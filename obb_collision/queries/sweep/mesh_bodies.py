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

"""When a mesh and a convex body with a formula, such as a cylinder, first touch as they move.

Conservative advancement as in ``sweep.meshes``, on the certified distance of a mesh and the body
itself (``queries.convex.mesh_distances``).
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.lanes import LANES
from obb_collision.numerics.vec3 import combined, minus, plus, scaled
from obb_collision.queries.convex.distance import rounding
from obb_collision.queries.convex.distances import towards
from obb_collision.queries.convex.mesh_distances import NOWHERE, Room, mesh_apart
from obb_collision.queries.convex.support import Bodies, ConvexBodies, core_at
from obb_collision.queries.meshes.meshes import PlacedMeshes
from obb_collision.queries.meshes.tree_boxes import moved, relative_pose
from obb_collision.queries.meshes.tree_descent import STACK
from obb_collision.queries.meshes.tree_descent import Bodies as MeshBodies
from obb_collision.queries.sweep.course import (
    MAX_STEPS,
    BodyMotion,
    blur_at,
    course_of,
    places_at,
)
from obb_collision.queries.sweep.meshes import FEWEST_PAIRS, speed_of, sweeps_of
from obb_collision.queries.sweep.poses import place_at
from obb_collision.queries.sweep.sweep import Sweeps
from obb_collision.typing import Floats


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
    count = len(meshes)
    free, undecided = np.empty(count), np.empty(count, np.bool_)
    points, normals = np.empty((2, count, 3))
    run(
        *(_kernel, count, FEWEST_PAIRS, meshes.arrays, radii, bodies.arrays),
        *(motion, begin, tolerance, free, undecided, points, normals),
    )
    return sweeps_of(free, undecided, points, normals)


@njit
def _kernel(
    a: MeshBodies, radii: Floats, b: Bodies, motion: BodyMotion, begin: Floats, tolerance: float,
    free: Floats, undecided: np.ndarray, points: Floats, normals: Floats, start: int, stop: int,
) -> None:  # fmt: skip
    trees, count = a.trees, len(begin)
    room = Room(np.empty((STACK, 2), np.int64), np.empty(STACK), np.empty((1, 3, LANES)))
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
        free[row], undecided[row] = time, not known
        for k in range(3):
            points[row, k], normals[row, k] = point[k], normal[k]

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
"""Points that lie in robots, or behind them as seen from a sensor, by the hulls of their bodies."""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.poses import as_poses
from obb_collision.numerics.intrinsics import LANES
from obb_collision.numerics.vec3 import dot, minus, plus, scaled, sum_abs, vector_at
from obb_collision.queries.meshes.hull_hull import HullCorners, apart
from obb_collision.queries.meshes.placed import PairPose
from obb_collision.robots.checks.arrays import LINK_PLACING, LinkBodies
from obb_collision.robots.checks.model import OwnBodies
from obb_collision.robots.kinematics.kinematics import Tree, link_poses
from obb_collision.typing import Floats, Mask, Vector

#: Points for which a second thread pays.
FEWEST_POINTS = 4096
#: The axes of the scene.
UPRIGHT = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def own_points(
    own: OwnBodies, tree: Tree, state: Floats, points: Floats, padding: float, sensor: Floats
) -> Mask:
    """Return which points (n, 3), relative to the origin of bodies, lie in bodies, or behind them.

    state (1, joints); padding: metres around all bodies; sensor: (1, 3), or (0, 3) for none.
    Points that are not finite lie nowhere.
    """
    result = np.zeros(len(points), np.bool_)
    bodies = _placed(own.bodies, link_poses(tree, state)[0])
    reaches = bodies.rounds + padding
    reaches = reaches + LINK_PLACING * (bodies.reaches + bodies.radii + reaches)
    low, high = np.zeros((1, 3)), np.zeros((1, 3))
    if len(reaches):
        far = (bodies.spheres + padding + LINK_PLACING * (bodies.reaches + bodies.radii))[:, None]
        low, high = (
            (bodies.centers - far).min(axis=0)[None],
            (bodies.centers + far).max(axis=0)[None],
        )
    question = bodies, reaches, padding, (low, high), points, sensor
    run(_own_kernel, len(points) if len(reaches) else 0, FEWEST_POINTS, *question, result)
    return result


def _placed(bodies: LinkBodies, links: Floats) -> LinkBodies:
    """Return robots' bodies placed in the scene, by the poses (l, 7) of links."""
    positions, rotations = as_poses(links[bodies.frames], warn=False)
    centers = np.einsum("nij,nj->ni", rotations, bodies.centers) + positions
    turns = np.einsum("nij,njk->nik", rotations, bodies.rotations)
    rows = np.repeat(np.arange(len(centers)), np.diff(bodies.starts))
    blocks = np.einsum("nij,njk->nik", rotations[rows], bodies.blocks) + positions[rows, :, None]
    radii = bodies.radii + np.abs(positions).sum(axis=1)
    return bodies._replace(
        centers=centers, rotations=turns, blocks=np.ascontiguousarray(blocks), radii=2.0 * radii
    )


@njit
def _own_kernel(
    bodies: LinkBodies, reaches: Floats, padding: float, bounds: tuple[Floats, Floats],
    points: Floats, sensor: Floats, out: Mask, start: int, stop: int,
) -> None:  # fmt: skip
    """Write which points lie in bodies, or behind those that the sensor is not in."""
    seen, count = len(sensor) > 0, len(reaches)
    casts, corner = np.zeros(count, np.bool_), np.empty((1, 3, LANES))
    eye = vector_at(sensor, 0) if seen else (0.0, 0.0, 0.0)
    low, high = vector_at(bounds[0], 0), vector_at(bounds[1], 0)
    for k in range(count if seen else 0):
        casts[k] = not _meets(bodies, reaches, padding, k, eye, eye, corner)
    for n in range(start, stop):
        p = vector_at(points, n)
        near = low[0] <= p[0] <= high[0] and low[1] <= p[1] <= high[1] and low[2] <= p[2] <= high[2]
        if not (near or (seen and _may_pass(low, high, eye, p))):
            continue
        for k in range(count):
            begin = eye if casts[k] else p
            if (casts[k] or near) and _meets(bodies, reaches, padding, k, begin, p, corner):
                out[n] = True
                break


@njit
def _may_pass(low: Vector, high: Vector, a: Vector, b: Vector) -> bool:
    """Return whether the bounds of two points meet bounds; False for what is not finite."""
    if not abs(b[0]) + abs(b[1]) + abs(b[2]) < math.inf:
        return False
    meets = True
    for k in range(3):
        meets &= min(a[k], b[k]) <= high[k] and low[k] <= max(a[k], b[k])
    return meets


@njit(inline=True, refcount=False)
def _meets(
    bodies: LinkBodies, reaches: Floats, padding: float, k: int, a: Vector, b: Vector,
    corner: Floats,
) -> bool:  # fmt: skip
    """Return whether the segment from a to b is not certainly out of reach of body k."""
    center = vector_at(bodies.centers, k)
    way, d = minus(b, a), minus(center, a)
    length, t = dot(way, way), 1.0
    if length > 0.0:
        t = min(max(dot(d, way) / length, 0.0), 1.0)
    d = minus(center, plus(a, scaled(way, t)))
    square, size = dot(d, d), sum_abs(a) + sum_abs(b)
    far = bodies.spheres[k] + padding + LINK_PLACING * (size + bodies.radii[k])
    if square > far * far:
        return False
    if square <= bodies.inner[k] * bodies.inner[k]:
        return True
    if length == 0.0:
        h = vector_at(bodies.half_extents, k)
        for m in range(3):
            turn = bodies.rotations[k, 0, m], bodies.rotations[k, 1, m], bodies.rotations[k, 2, m]
            if abs(dot(turn, d)) > h[m] + padding + LINK_PLACING * (size + bodies.radii[k]):
                return False
    for m in range(LANES):
        for axis in range(3):
            corner[0, axis, m] = a[axis] if m < LANES // 2 else b[axis]
    own = HullCorners(bodies.blocks, bodies.starts[k], bodies.starts[k + 1])
    pose = PairPose(UPRIGHT, (0.0, 0.0, 0.0), bodies.radii[k] + size, 0.0, 0.0)
    reach = reaches[k] + LINK_PLACING * size
    return not apart(own, HullCorners(corner, 0, 1), pose, d, reach)

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

"""Arrays for kernels: bodies of robots and of the world, and their places in one state.

Error analysis, with u = 2^-53: a chain of k joints moves a point by at most 24 k u L from where
real arithmetic has it, L being the lengths of the chain and the body, summed; rotations are
orthonormal to 16 u. LINK_PLACING is 2^14 u, so that both stay below it for chains of 200 joints,
with the bounds of ``verdict`` and ``convex`` for bodies that are where they are said to be.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.geometry.poses import rotation_of
from obb_collision.numerics.constants import MESH_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.vec3 import axes_of, components, rows_at, sum_abs, vector_at
from obb_collision.queries.verdict.sat import BoxAt, box_at
from obb_collision.robots.kinematics.kinematics import Tree, place_links
from obb_collision.scene.broad_phase.bounds_tree import STACK
from obb_collision.typing import Floats, Integers, Mask, Vector

#: Distance within which bodies count as colliding, relative to the lengths of their chains.
LINK_PLACING = 2**14 * ROUNDOFF


class LinkBodies(NamedTuple):
    """Convex bodies (b,): those of the robots first, then those of the world.

    Each is a hull with a ball around every point of it, of radius ``rounds``; and a box and a
    sphere around its centre that contain that. All in the frames of links; the last frame is that
    of the world.
    """

    frames: Integers  #: (b,) the frame
    centers: Floats  #: (b, 3) of its box
    rotations: Floats  #: (b, 3, 3)
    half_extents: Floats  #: (b, 3)
    spheres: Floats  #: (b,) radius of the sphere
    inner: Floats  #: (b,) radius of a ball around the same centre within the hull
    boxes: Mask  #: (b,) whether the hull is the box
    rounds: Floats  #: (b,)
    radii: Floats  #: (b,) largest sum of magnitudes of the coordinates of a corner
    reaches: Floats  #: (b,) lengths of the chain up to the frame, and of the body
    excess: Floats  #: (b,) how far the hull may reach beyond a curved shape
    blocks: Floats  #: (m, 3, LANES) corners of all hulls, as in ``Hulls``
    starts: Integers  #: (b + 1,)


class Tests(NamedTuple):
    """Which bodies are tested against each other: pairs of robots' bodies, and those of the world.

    allowed (robots' bodies, world's bodies): pairs that do not count; (0, 0) for none. nodes,
    levels, order: the tree of the world's bounds, as in ``BoundsTree``. It is asked once for all
    bodies of a link, by a sphere around them.
    """

    links: Integers  #: (l,) the frames that bodies of robots are in ...
    starts: Integers  #: (l + 1,) ... of each the first of its bodies, which are in a row ...
    centers: Floats  #: (l, 3) ... and the sphere around them
    spheres: Floats  #: (l,)
    pairs: Integers  #: (p, 2)
    allowed: Mask
    first: int  #: the first body of the world
    nodes: Floats
    levels: Integers
    order: Integers


class Checked(NamedTuple):
    """Robots and the world: kinematics, bodies, and which of them are tested."""

    tree: Tree
    bodies: LinkBodies
    tests: Tests


class PairValues(NamedTuple):
    """A number of each body against the world, and of each pair: by state (k,), or one for all."""

    bodies: Floats  #: (k, robots' bodies)
    pairs: Floats  #: (k, p)


class Placed(NamedTuple):
    """Where frames and bodies are in one state; axes of boxes are computed where needed."""

    poses: Floats  #: (1, links, 7)
    positions: Floats  #: (f, 3) of the frames
    rotations: Floats  #: (f, 3, 3)
    centers: Floats  #: (b, 3) of the bodies' boxes
    axes: Floats  #: (b, 3, 3)
    ready: Mask  #: (b,) whether axes are computed
    waiting: Integers  #: (2, STACK) blocks of the tree to visit
    candidates: Integers  #: (c, 2) pairs whose spheres overlap
    grown: Floats  #: (c,) distance within which they count as colliding, metres


@njit
def new_placed(checked: Checked) -> Placed:
    """Return room for one state, in which the bodies of the world are placed."""
    bodies, tests, links = checked.bodies, checked.tests, len(checked.tree.parents)
    count, first = len(bodies.frames), tests.first
    most = len(tests.pairs) + first * (count - first)
    placed = Placed(
        np.empty((1, links, 7)),
        np.zeros((links + 1, 3)),
        np.zeros((links + 1, 3, 3)),
        np.empty((count, 3)),
        np.empty((count, 3, 3)),
        np.zeros(count, np.bool_),
        np.empty((2, STACK), np.int64),
        np.empty((most, 2), np.int64),
        np.empty(most),
    )
    for k in range(3):
        placed.rotations[links, k, k] = 1.0
    for i in range(first, count):
        placed.ready[i] = True
        for k in range(3):
            placed.centers[i, k] = bodies.centers[i, k]
            for m in range(3):
                placed.axes[i, k, m] = bodies.rotations[i, k, m]
    return placed


@njit(inline=True, refcount=False)
def place_state(checked: Checked, states: Floats, n: int, placed: Placed) -> None:
    """Place links and the robots' bodies in state n."""
    poses, positions, rotations = placed.poses, placed.positions, placed.rotations
    place_links(checked.tree, states, n, poses, 0)
    for frame in checked.tests.links:
        rows = rotation_of(
            (poses[0, frame, 3], poses[0, frame, 4], poses[0, frame, 5], poses[0, frame, 6])
        )
        for k in range(3):
            positions[frame, k] = poses[0, frame, k]
            for m in range(3):
                rotations[frame, k, m] = rows[k][m]
    frames, middles, centers = checked.bodies.frames, checked.bodies.centers, placed.centers
    for i in range(checked.tests.first):
        frame = frames[i]
        center = components(rows_at(rotations, frame), vector_at(middles, i))
        for k in range(3):
            centers[i, k] = positions[frame, k] + center[k]
        placed.ready[i] = False


@njit(inline=True, refcount=False)
def slack_of(bodies: LinkBodies, i: int, center: Vector) -> float:
    """Return what body i may be off from where it is said to be, with its tests, metres."""
    return LINK_PLACING * (bodies.reaches[i] + sum_abs(center)) + MESH_UNDERFLOW


@njit(inline=True, refcount=False)
def placed_box(bodies: LinkBodies, placed: Placed, i: int) -> BoxAt:
    """Return the box of body i, whose axes are computed when it is first asked for."""
    axes = placed.axes
    if not placed.ready[i]:
        placed.ready[i] = True
        turn = rows_at(placed.rotations, bodies.frames[i])
        x, y, z = axes_of(bodies.rotations, i)
        x, y, z = components(turn, x), components(turn, y), components(turn, z)
        for k in range(3):
            axes[i, k, 0], axes[i, k, 1], axes[i, k, 2] = x[k], y[k], z[k]
    return box_at(BoxArrays(placed.centers, axes, bodies.half_extents), i)

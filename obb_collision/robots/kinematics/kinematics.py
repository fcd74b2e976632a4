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

"""Forward kinematics: from states of joints to poses of links, many states at once."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.poses import Quaternion
from obb_collision.geometry.validation import as_array, is_single, refuse_where
from obb_collision.numerics.vec3 import cross, plus, scaled, vector_at
from obb_collision.typing import Floats, Integers, Vector

#: The kinds of joints, as ``urdf.JointKind`` numbers them.
FIXED, PRISMATIC, PLANAR, FLOATING = 0, 3, 4, 5
#: Minimum number of states for a second thread: below, it takes longer.
FEWEST_STATES = 256


class Tree(NamedTuple):
    """Links by row, parents before children, each with the joint between it and its parent.

    parents: rows, -1 for a root. kinds: ``urdf.JointKind``. columns: the first variable of the
    joint in a state, -1 for a fixed one; its value is multiplier times the variable plus offset.
    translations (n, 3), rotations (n, 4): the origin of the joint, in the parent's frame. turned
    (n, 4): rotation times (axis, 0); a turn by an angle is then cos(angle / 2) rotation +
    sin(angle / 2) turned. directions (n, 3): the axis of the joint, in the parent's frame; of a
    planar or floating joint its first axis, and across (n, 3) its second one.
    """

    parents: Integers
    kinds: Integers
    columns: Integers
    multipliers: Floats
    offsets: Floats
    translations: Floats
    rotations: Floats
    turned: Floats
    directions: Floats
    across: Floats


def checked_states(
    tree: Tree, states: ArrayLike, count: int, name: str = "states"
) -> tuple[Floats, bool]:
    """Return states as (n, count), and whether ``states`` is a single one (count,).

    Raises ValueError for other shapes, and, naming the row, for numbers that are not finite and
    quaternions of zeros.
    """
    single = is_single(states)
    array = as_array(states, name, (count,) if single else (None, count))
    checked = array[None] if single else array
    for column in tree.columns[tree.kinds == FLOATING]:
        zeros = ~np.any(checked[:, column + 3 : column + 7], axis=1)
        refuse_where(zeros, f"{name} must not have a zero quaternion", by_row=not single)
    return checked, single


def link_poses(tree: Tree, states: Floats) -> Floats:
    """Return the poses (n, links, 7) of links in the root's frame, for checked states (n, m)."""
    poses = np.empty((len(states), len(tree.parents), 7))
    run(fill_link_poses, len(states), FEWEST_STATES, tree, states, poses)
    return poses


@njit
def fill_link_poses(tree: Tree, states: Floats, poses: Floats, start: int, stop: int) -> None:
    """Write the poses of all links for states ``start`` to ``stop``."""
    for n in range(start, stop):
        place_links(tree, states, n, poses, n)


@njit(inline=True, refcount=False)
def place_links(tree: Tree, states: Floats, n: int, poses: Floats, m: int) -> None:
    """Write the poses of all links in state n to ``poses[m]``.

    Inlined, as passing a tree to a function takes longer than placing a link.
    """
    parents, kinds = tree.parents, tree.kinds
    for link in range(len(parents)):
        kind, parent = kinds[link], parents[link]
        place, turn = vector_at(tree.translations, link), _quaternion_at(tree.rotations, link)
        if kind >= PLANAR:
            place, turn = _moved_freely(tree, states, n, link)
        elif kind != FIXED:
            value = tree.multipliers[link] * states[n, tree.columns[link]] + tree.offsets[link]
            if kind == PRISMATIC:
                place = plus(place, scaled(vector_at(tree.directions, link), value))
            else:
                turn = _turned(turn, _quaternion_at(tree.turned, link), value)
        if parent >= 0:
            place, turn = _composed(
                (poses[m, parent, 0], poses[m, parent, 1], poses[m, parent, 2]),
                (
                    poses[m, parent, 3],
                    poses[m, parent, 4],
                    poses[m, parent, 5],
                    poses[m, parent, 6],
                ),
                place,
                turn,
            )
        poses[m, link, 0], poses[m, link, 1], poses[m, link, 2] = place
        poses[m, link, 3], poses[m, link, 4], poses[m, link, 5], poses[m, link, 6] = turn


@njit(inline=True, refcount=False)
def _quaternion_at(quaternions: Floats, i: int) -> Quaternion:
    return quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3]


@njit(inline=True, refcount=False)
def _turned(turn: Quaternion, turned: Quaternion, angle: float) -> Quaternion:
    """Return the rotation of a joint's origin after a turn by an angle; turned: see ``Tree``."""
    s, c = math.sin(0.5 * angle), math.cos(0.5 * angle)
    return (
        c * turn[0] + s * turned[0],
        c * turn[1] + s * turned[1],
        c * turn[2] + s * turned[2],
        c * turn[3] + s * turned[3],
    )


@njit
def _moved_freely(tree: Tree, states: Floats, n: int, link: int) -> tuple[Vector, Quaternion]:
    """Return position and rotation of the link of a planar or floating joint, in its parent."""
    column, kind = tree.columns[link], tree.kinds[link]
    a, b = vector_at(tree.directions, link), vector_at(tree.across, link)
    turn = _quaternion_at(tree.rotations, link)
    place = plus(vector_at(tree.translations, link), scaled(a, states[n, column]))
    place = plus(place, scaled(b, states[n, column + 1]))
    if kind == PLANAR:
        return place, _turned(turn, _quaternion_at(tree.turned, link), states[n, column + 2])
    place = plus(place, scaled(cross(a, b), states[n, column + 2]))
    inner = (
        states[n, column + 3],
        states[n, column + 4],
        states[n, column + 5],
        states[n, column + 6],
    )
    return place, _turned_freely(turn, inner)


@njit
def _turned_freely(outer: Quaternion, inner: Quaternion) -> Quaternion:
    """Return the product of outer and the normalised inner quaternion."""
    x, y, z, w = inner
    largest = max(max(abs(x), abs(y)), max(abs(z), abs(w)))
    x, y, z, w = x / largest, y / largest, z / largest, w / largest
    length = math.sqrt(x * x + y * y + z * z + w * w)
    return _product(outer, (x / length, y / length, z / length, w / length))


@njit(inline=True, refcount=False)
def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


@njit(inline=True, refcount=False)
def _composed(
    position: Vector, outer: Quaternion, place: Vector, turn: Quaternion
) -> tuple[Vector, Quaternion]:
    """Return the pose (position, outer) times the pose (place, turn)."""
    x, y, z = place
    ux, uy, uz, w = outer
    tx, ty, tz = 2.0 * (uy * z - uz * y), 2.0 * (uz * x - ux * z), 2.0 * (ux * y - uy * x)
    moved = (
        position[0] + x + w * tx + (uy * tz - uz * ty),
        position[1] + y + w * ty + (uz * tx - ux * tz),
        position[2] + z + w * tz + (ux * ty - uy * tx),
    )
    qx, qy, qz, qw = _product(outer, turn)
    # one Newton step normalises, so that roundings of long chains do not add up
    scale = 1.5 - 0.5 * (qx * qx + qy * qy + qz * qz + qw * qw)
    return moved, (qx * scale, qy * scale, qz * scale, qw * scale)

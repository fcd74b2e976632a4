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

"""From states of joints to poses of links, many states at once."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.validation import as_array, is_single, refuse_where
from obb_collision.typing import Floats, Integers

#: The kinds of joints, as ``urdf.JointKind`` numbers them.
FIXED, PRISMATIC, PLANAR, FLOATING = 0, 3, 4, 5
#: States below which a second thread does not pay.
FEWEST_STATES = 256


class Tree(NamedTuple):
    """Links by row, parents first, each with the joint between it and its parent.

    parents: rows, -1 for a root. kinds: ``urdf.JointKind``. columns: the first variable of the
    joint in a state, -1 for a fixed one; its value is multiplier times the variable plus offset.
    translations (n, 3), rotations (n, 4): the origin of the joint, in the parent's frame. turned
    (n, 4): rotation times (axis, 0), so that a turn by an angle is cos(angle / 2) rotation +
    sin(angle / 2) turned. directions, across (n, 3): along which the joint moves, and of a planar
    or floating one the second of its axes, in the parent's frame.
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
    """Return states as (n, count), and whether one state (count,) was given.

    Raises ValueError, naming the row, for anything else and for quaternions of zeros.
    """
    single = is_single(states)
    given = as_array(states, name, (count,) if single else (None, count))
    checked = given[None] if single else given
    for column in tree.columns[tree.kinds == FLOATING]:
        zeros = ~checked[:, column + 3 : column + 7].any(axis=1)
        refuse_where(zeros, f"{name} must have no quaternion of zeros", by_row=not single)
    return checked, single


def link_poses(tree: Tree, states: Floats) -> Floats:
    """Return the poses (n, links, 7) of links in the frame of the root, of valid states (n, m)."""
    poses = np.empty((len(states), len(tree.parents), 7))
    run(fill_link_poses, len(states), FEWEST_STATES, tree, states, poses)
    return poses


@njit
def fill_link_poses(tree: Tree, states: Floats, poses: Floats, start: int, stop: int) -> None:
    """Write the poses of all links for states ``start`` to ``stop``."""
    for n in range(start, stop):
        for link in range(len(tree.parents)):
            _place_link(tree, states, poses, n, link)


@njit
def _place_link(tree: Tree, states: Floats, poses: Floats, n: int, link: int) -> None:
    kind, column, parent = tree.kinds[link], tree.columns[link], tree.parents[link]
    x, y, z = tree.translations[link]
    qx, qy, qz, qw = tree.rotations[link]
    if kind != FIXED:
        value = tree.multipliers[link] * states[n, column] + tree.offsets[link]
        if kind == FLOATING:
            qx, qy, qz, qw = _turned_freely(
                (qx, qy, qz, qw),
                (states[n, column + 3], states[n, column + 4], states[n, column + 5],
                 states[n, column + 6]),
            )  # fmt: skip
        elif kind != PRISMATIC:
            half = 0.5 * (states[n, column + 2] if kind == PLANAR else value)
            s, c = math.sin(half), math.cos(half)
            turned = tree.turned[link]
            qx, qy = c * qx + s * turned[0], c * qy + s * turned[1]
            qz, qw = c * qz + s * turned[2], c * qw + s * turned[3]
        if kind >= PRISMATIC:
            a = tree.directions[link]
            x, y, z = x + value * a[0], y + value * a[1], z + value * a[2]
        if kind >= PLANAR:
            b, value = tree.across[link], states[n, column + 1]
            x, y, z = x + value * b[0], y + value * b[1], z + value * b[2]
        if kind == FLOATING:
            a, b, value = tree.directions[link], tree.across[link], states[n, column + 2]
            x += value * (a[1] * b[2] - a[2] * b[1])
            y += value * (a[2] * b[0] - a[0] * b[2])
            z += value * (a[0] * b[1] - a[1] * b[0])
    if parent >= 0:
        _compose(poses[n, parent], (x, y, z), (qx, qy, qz, qw), poses[n, link])
    else:
        _compose_with_nothing((x, y, z), (qx, qy, qz, qw), poses[n, link])


@njit
def _turned_freely(
    outer: tuple[float, float, float, float], inner: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    """Return outer times inner, which is made a unit quaternion."""
    x, y, z, w = inner
    largest = max(max(abs(x), abs(y)), max(abs(z), abs(w)))
    x, y, z, w = x / largest, y / largest, z / largest, w / largest
    length = math.sqrt(x * x + y * y + z * z + w * w)
    return _product(outer, (x / length, y / length, z / length, w / length))


@njit
def _product(
    a: tuple[float, float, float, float], b: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


@njit
def _compose_with_nothing(
    place: tuple[float, float, float], turn: tuple[float, float, float, float], out: Floats
) -> None:
    out[0], out[1], out[2] = place
    out[3], out[4], out[5], out[6] = turn


@njit
def _compose(
    outer: Floats, place: tuple[float, float, float], turn: tuple[float, float, float, float],
    out: Floats,
) -> None:  # fmt: skip
    """Write the pose that is given in the frame of another one."""
    x, y, z = place
    ux, uy, uz, w = outer[3], outer[4], outer[5], outer[6]
    tx, ty, tz = 2.0 * (uy * z - uz * y), 2.0 * (uz * x - ux * z), 2.0 * (ux * y - uy * x)
    out[0] = outer[0] + x + w * tx + (uy * tz - uz * ty)
    out[1] = outer[1] + y + w * ty + (uz * tx - ux * tz)
    out[2] = outer[2] + z + w * tz + (ux * ty - uy * tx)
    qx, qy, qz, qw = _product((ux, uy, uz, w), turn)
    # one step of Newton's, so that roundings of long chains do not add up
    scale = 1.5 - 0.5 * (qx * qx + qy * qy + qz * qz + qw * qw)
    out[3], out[4], out[5], out[6] = qx * scale, qy * scale, qz * scale, qw * scale

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

"""Gradients of distances by the values of joints.

A distance along a direction n changes as n times the difference of the velocities of the closest
points, taken as fixed to their links: where the points are on these does not matter to first order.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.poses import multiply_quaternions, rotate_vectors, rotation_of
from obb_collision.numerics.vec3 import components, cross, dot, vector_at
from obb_collision.robots.kinematics.kinematics import (
    PLANAR,
    PRISMATIC,
    Tree,
    link_poses,
    place_links,
)
from obb_collision.typing import Floats, Mask, Rows

#: Distances below which a second thread does not pay.
FEWEST_GRADIENTS = 256


def distance_gradients(
    tree: Tree, states: Floats, driven: Mask, frames: Rows, points: Floats, directions: Floats
) -> Floats:
    """Return (m, joints) how distances change with the joints of states (m, joints).

    driven: as ``driving_joints``; frames (m, 2): the links of the points (m, 2, 3), or how many
    links there are for the world's; directions (m, 3): from the first to the second, NaN for none.
    """
    gradients = np.zeros(states.shape)
    asked = tree, driven, states, frames, points, directions
    run(_fill_gradients, len(states), FEWEST_GRADIENTS, *asked, gradients)
    for link in np.flatnonzero(tree.kinds >= PLANAR).tolist():
        _add_free(*asked, link, gradients)
    return gradients


@njit
def _fill_gradients(
    tree: Tree, driven: Mask, states: Floats, frames: Rows, points: Floats, directions: Floats,
    gradients: Floats, start: int, stop: int,
) -> None:  # fmt: skip
    """Write gradients by the first variable of each joint."""
    poses, identity = np.empty((1, len(tree.parents), 7)), (0.0, 0.0, 0.0, 1.0)
    for n in range(start, stop):
        along = vector_at(directions, n)
        if np.isnan(along[0]):
            gradients[n] = np.nan
            continue
        place_links(tree, states, n, poses, 0)
        for link in range(len(tree.parents)):
            first, second = driven[frames[n, 0], link], driven[frames[n, 1], link]
            if first == second:  # both points move as one, or none does
                continue
            parent, turn = tree.parents[link], identity
            if parent >= 0:
                x, y = poses[0, parent, 3], poses[0, parent, 4]
                turn = x, y, poses[0, parent, 5], poses[0, parent, 6]
            rate = along
            if tree.kinds[link] < PRISMATIC:
                p, q = points[n, 1 if second else 0], poses[0, link]
                rate = cross((p[0] - q[0], p[1] - q[1], p[2] - q[2]), along)
            change = dot(components(rotation_of(turn), vector_at(tree.directions, link)), rate)
            sign = 1.0 if second else -1.0
            gradients[n, tree.columns[link]] += sign * tree.multipliers[link] * change


def _add_free(
    tree: Tree, driven: Mask, states: Floats, frames: Rows, points: Floats, directions: Floats,
    link: int, gradients: Floats,
) -> None:  # fmt: skip
    """Add the gradients by all but the first variable of a planar or floating joint."""
    poses, parent, column = link_poses(tree, states), tree.parents[link], tree.columns[link]
    moved = driven[frames, link].astype(np.float64) * (-1.0, 1.0)  # (m, 2)
    force = moved[:, :, None] * directions[:, None]
    turning = np.cross(points - poses[:, link, None, :3], force).sum(axis=1)
    along = force.sum(axis=1)
    still = np.tile((0.0, 0.0, 0.0, 1.0), (len(states), 1))
    outer = poses[:, parent, 3:] if parent >= 0 else still
    axis = rotate_vectors(outer, np.broadcast_to(tree.directions[link], along.shape))
    across = rotate_vectors(outer, np.broadcast_to(tree.across[link], along.shape))
    third = np.cross(axis, across)
    gradients[:, column + 1] += (across * along).sum(axis=1)
    if tree.kinds[link] == PLANAR:
        gradients[:, column + 2] += (third * turning).sum(axis=1)
        return
    gradients[:, column + 2] += (third * along).sum(axis=1)
    frame = multiply_quaternions(outer, np.broadcast_to(tree.rotations[link], outer.shape))
    _add_turns(states[:, column + 3 : column + 7], frame, turning, gradients[:, column + 3 :])


def _add_turns(quaternions: Floats, frame: Floats, turning: Floats, out: Floats) -> None:
    """Add the gradients by quaternions (m, 4), in frames (m, 4), which are made unit ones."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    units = quaternions / lengths
    back = units * (-1.0, -1.0, -1.0, 1.0)
    for k in range(4):
        change = (np.eye(4)[k] - units * units[:, k : k + 1]) / lengths
        rate = 2.0 * multiply_quaternions(change, back)[:, :3]
        out[:, k] += (rotate_vectors(frame, rate) * turning).sum(axis=1)

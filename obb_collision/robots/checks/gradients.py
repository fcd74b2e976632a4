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

from obb_collision.geometry.poses import multiply_quaternions, rotate_vectors
from obb_collision.robots.kinematics.kinematics import FIXED, PLANAR, PRISMATIC, Tree, link_poses
from obb_collision.typing import Floats, Rows


def distance_gradients(
    tree: Tree, states: Floats, frames: Rows, points: Floats, directions: Floats
) -> Floats:
    """Return (m, joints) how distances change with the joints of states (m, joints).

    frames (m, 2): the links of the points (m, 2, 3), or how many links there are for the world's;
    directions (m, 3): from the first to the second.
    """
    poses, gradients = link_poses(tree, states), np.zeros(states.shape)
    above = _links_above(tree)
    for link in np.flatnonzero(tree.kinds != FIXED).tolist():
        parent, column, factor = tree.parents[link], tree.columns[link], tree.multipliers[link]
        moved = above[frames, link].astype(np.float64) * (-1.0, 1.0)  # (m, 2)
        force = moved[:, :, None] * directions[:, None]
        arms = points - poses[:, link, None, :3]
        turning, along = np.cross(arms, force).sum(axis=1), force.sum(axis=1)
        still = np.tile((0.0, 0.0, 0.0, 1.0), (len(states), 1))
        outer = poses[:, parent, 3:] if parent >= 0 else still
        axis = rotate_vectors(outer, np.broadcast_to(tree.directions[link], along.shape))
        kind = tree.kinds[link]
        if kind < PRISMATIC:
            gradients[:, column] += factor * (axis * turning).sum(axis=1)
            continue
        gradients[:, column] += factor * (axis * along).sum(axis=1)
        if kind < PLANAR:
            continue
        across = rotate_vectors(outer, np.broadcast_to(tree.across[link], along.shape))
        third = np.cross(axis, across)
        gradients[:, column + 1] += (across * along).sum(axis=1)
        if kind == PLANAR:
            gradients[:, column + 2] += (third * turning).sum(axis=1)
            continue
        gradients[:, column + 2] += (third * along).sum(axis=1)
        frame = multiply_quaternions(outer, np.broadcast_to(tree.rotations[link], outer.shape))
        _add_turns(states[:, column + 3 : column + 7], frame, turning, gradients[:, column + 3 :])
    return gradients


def _add_turns(quaternions: Floats, frame: Floats, turning: Floats, out: Floats) -> None:
    """Add the gradients by quaternions (m, 4), in frames (m, 4), which are made unit ones."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    units = quaternions / lengths
    back = units * (-1.0, -1.0, -1.0, 1.0)
    for k in range(4):
        change = (np.eye(4)[k] - units * units[:, k : k + 1]) / lengths
        rate = 2.0 * multiply_quaternions(change, back)[:, :3]
        out[:, k] += (rotate_vectors(frame, rate) * turning).sum(axis=1)


def _links_above(tree: Tree) -> np.ndarray:
    """Return (links + 1, links) whether the joint of a link moves another one; none the world."""
    count = len(tree.parents)
    above = np.zeros((count + 1, count), np.bool_)
    for link, parent in enumerate(tree.parents.tolist()):
        if parent >= 0:
            above[link] = above[parent]
        above[link, link] = True
    return above

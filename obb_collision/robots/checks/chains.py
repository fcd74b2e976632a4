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

"""Chains of joints between links, as kernels of motions take them."""

from __future__ import annotations

import numpy as np

from obb_collision.geometry.poses import rotate_vectors
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.robots.checks.arrays import Chains, LinkBodies
from obb_collision.robots.kinematics.kinematics import FIXED, PRISMATIC, Tree
from obb_collision.typing import Floats, Integers

#: Relative growth of lengths: more than their roundings.
LENGTH_GROWTH = 1.0 + 2.0**12 * ROUNDOFF
NO_PARTS, NO_LENGTHS = np.empty(0, np.int64), np.empty((0, 2))
#: For what does not ask how bodies move.
NO_CHAINS = Chains(NO_LENGTHS, NO_LENGTHS, NO_PARTS, np.zeros(1, np.int64), NO_LENGTHS, NO_PARTS)


def chains_of(tree: Tree, bodies: LinkBodies, pairs: Integers, first: int, boxes: bool) -> Chains:
    """Return the chains to the first bodies, those of robots, and between pairs (p, 2).

    boxes: whether to the spheres and boxes around bodies; else to their hulls.
    """
    turning = (tree.kinds != FIXED) & (tree.kinds < PRISMATIC)
    back = tree.rotations * (-1.0, -1.0, -1.0, 1.0)
    axes = rotate_vectors(back, tree.directions) * turning[:, None]  # in the frames of links
    roots = tree.parents[:, None] < 0
    links = _split(tree.translations, np.where(roots, 0.0, axes[tree.parents]))
    extents = np.empty((first, 2))
    for i, frame in enumerate(bodies.frames[:first].tolist()):
        blocks = bodies.blocks[bodies.starts[i] : bodies.starts[i + 1]]
        corners = _split(blocks.transpose(0, 2, 1).reshape(-1, 3), axes[frame])
        extents[i] = corners.max(axis=0) + bodies.rounds[i] * LENGTH_GROWTH
        if boxes:
            radius = max(bodies.spheres[i], np.linalg.norm(bodies.half_extents[i]))
            extents[i] = 0.0, (np.linalg.norm(bodies.centers[i]) + radius) * LENGTH_GROWTH
    unique, rows = np.unique(bodies.frames[pairs], axis=0, return_inverse=True)
    paths = [_path(tree, links, a, b) for a, b in unique.tolist()]
    steps = [step for path in paths for step in path]
    lengths = np.array([step[:2] for step in steps]).reshape(-1, 2)
    joints = np.array([step[2] for step in steps], np.int64)
    starts = np.cumsum([0, *map(len, paths)])
    return Chains(links, extents, rows.reshape(-1), starts, lengths, joints)


def _split(vectors: Floats, axes: Floats) -> Floats:
    """Return (n, 2) the lengths of vectors (n, 3) along unit axes, or zeros, and across them."""
    along = (vectors * axes).sum(axis=1)
    across = vectors - along[:, None] * axes
    lengths = np.column_stack([np.abs(along), np.linalg.norm(across, axis=1)])
    room = LENGTH_GROWTH - 1.0  # what is orthogonal is so but for roundings
    return lengths * LENGTH_GROWTH + room * np.linalg.norm(vectors, axis=1)[:, None]


def _path(tree: Tree, links: Floats, a: int, b: int) -> list[tuple[float, float, int]]:
    """Return segments, along and across, and the joints behind them, from link a to link b."""
    up, down = [a], [b]
    while up[-1] != down[-1]:  # parents come first
        chain = up if up[-1] > down[-1] else down
        chain.append(int(tree.parents[chain[-1]]))
    steps, place = [], np.zeros(3)  # from the origin of the link that we are at
    for link in up[:-1]:
        steps.append((0.0, float(np.linalg.norm(place)) * LENGTH_GROWTH, link))
        place = -tree.translations[link]
    for number, link in enumerate(down[-2::-1]):
        along, across = links[link].tolist()
        if number == 0:  # the joint of the link that both hang on does not count
            place = place + tree.translations[link]
            along, across = 0.0, float(np.linalg.norm(place)) * LENGTH_GROWTH
            place = np.zeros(3)
        steps.append((along, across, link))
    steps.append((0.0, float(np.linalg.norm(place)) * LENGTH_GROWTH, -1))
    return steps

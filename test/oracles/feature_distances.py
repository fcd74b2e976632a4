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

"""The distance of two boxes by trying all features, in extended precision: nothing of the library.

The closest points of two disjoint boxes lie on a vertex of one and anywhere on the other, or on two
edges: 8 + 8 vertices against a box and 144 pairs of edges are tried for every pair, in
``numpy.longdouble`` and in world axes about the centre of a. Where that is no wider than a double
(Windows, some ARM) there is no such truth: ``EXTENDED`` tells.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

Wide = Any  # arrays of longdouble

EXTENDED = np.finfo(np.longdouble).eps < 1e-18
SIGNS = (-1, 1)


def dot(u: Wide, v: Wide) -> Wide:
    """Row by row."""
    return (u * v).sum(axis=-1)


def distances(a: Any, b: Any) -> Wide:
    """(n,) distances; a and b are (centers, rotations, half extents) of disjoint boxes."""
    (center_a, axes_a, half_a), (center_b, axes_b, half_b) = (
        tuple(np.asarray(part, np.longdouble) for part in box) for box in (a, b)
    )
    offset = center_b - center_a
    one, other = (np.zeros_like(offset), axes_a, half_a), (offset, axes_b, half_b)
    best = np.full(len(offset), np.inf, np.longdouble)
    for signs in product(SIGNS, repeat=3):
        best = np.minimum(best, point_to_box(corner(other, signs), one))
        best = np.minimum(best, point_to_box(corner(one, signs), other))
    for i, j in product(range(3), repeat=2):
        for p, q in product(product(SIGNS, repeat=2), repeat=2):
            start = corner(one, (*p[:i], 0, *p[i:])), corner(other, (*q[:j], 0, *q[j:]))
            edges = (axes_a[:, :, i], half_a[:, i]), (axes_b[:, :, j], half_b[:, j])
            best = np.minimum(best, edge_to_edge(*start, *edges))
    return best


def corner(box: Any, signs: tuple[int, ...]) -> Wide:
    """Return center + sum of signs * half extents * axes: corners, centres of edges (a 0)."""
    center, axes, half = box
    return center + (axes * (half * np.array(signs, np.longdouble))[:, None, :]).sum(axis=2)


def point_to_box(point: Wide, box: Any) -> Wide:
    """Coordinates one after another, again and again: axes are orthonormal to rounding only."""
    center, axes, half = box
    t = np.zeros_like(half)
    rest = point - center
    for _ in range(4):
        for i in range(3):
            axis = axes[:, :, i]
            moved = np.clip(t[:, i] + dot(rest, axis) / dot(axis, axis), -half[:, i], half[:, i])
            rest = rest - (moved - t[:, i])[:, None] * axis
            t[:, i] = moved
    return np.sqrt(dot(rest, rest))


def edge_to_edge(p: Wide, q: Wide, first: Any, second: Any) -> Wide:
    """Where the lines are closest, by Cramer's rule; then the closest point of the second edge."""
    (u, long_u), (v, long_v) = first, second
    between, normal = q - p, np.cross(u, v)
    square = dot(normal, normal)
    crossing = dot(np.cross(between, v), normal) / np.where(square > 0, square, 1)
    s = np.clip(np.where(square > 0, crossing, 0), -long_u, long_u)
    t = np.clip(dot(s[:, None] * u - between, v) / dot(v, v), -long_v, long_v)
    rest = between + t[:, None] * v - s[:, None] * u
    return np.sqrt(dot(rest, rest))

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

"""A binary tree over axis-aligned bounds, for rays: halves along the longest axis.

Bounds are only merged, never rounded. A node is a run of the order of boxes; a leaf has no child.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.typing import Floats

#: Boxes in a leaf.
LEAF = 2
#: Halving leaves one node a level behind: enough for 2^62 leaves.
STACK = 64
#: Columns of a node: first box in the order, number of boxes, first of its two children or -1.
START, COUNT, CHILD = 0, 1, 2


@njit
def build_tree(bounds: Floats) -> tuple[Floats, np.ndarray, np.ndarray]:
    """Return bounds (k, 6) and numbers (k, 3) of nodes, the root first, and the order (n,).

    bounds (n, 6): least and largest corner of each box.
    """
    n = len(bounds)
    order = np.arange(n)
    limits = np.empty((max(2 * n, 1), 6))
    nodes = np.empty((max(2 * n, 1), 3), np.int64)
    _fill(nodes, 0, 0, n)
    used = 1
    node = 0
    while node < used:  # children come after their parents: the array is the queue
        start, count = nodes[node, START], nodes[node, COUNT]
        rows = order[start : start + count]
        longest = _merge(bounds, rows, limits[node])
        if count > LEAF:
            middles = np.empty(count)
            for m in range(count):
                row = rows[m]
                middles[m] = 0.5 * bounds[row, longest] + 0.5 * bounds[row, 3 + longest]
            sorted_rows = rows[np.argsort(middles, kind="mergesort")]
            for m in range(count):
                rows[m] = sorted_rows[m]
            half = count // 2
            nodes[node, CHILD] = used
            _fill(nodes, used, start, half)
            _fill(nodes, used + 1, start + half, count - half)
            used += 2
        node += 1
    return limits[:used], nodes[:used], order


@njit
def _fill(nodes: np.ndarray, node: int, start: int, count: int) -> None:
    """Write a leaf; an assignment of rows takes two seconds to compile."""
    nodes[node, START], nodes[node, COUNT], nodes[node, CHILD] = start, count, -1


@njit
def _merge(bounds: Floats, rows: np.ndarray, out: Floats) -> int:
    """Write the bounds of all rows, and return the axis along which the middles spread most."""
    out[:3], out[3:] = np.inf, -np.inf
    best, widest = 0, -1.0
    for k in range(3):
        least, most = np.inf, -np.inf
        for row in rows:
            out[k] = min(out[k], bounds[row, k])
            out[3 + k] = max(out[3 + k], bounds[row, 3 + k])
            middle = 0.5 * bounds[row, k] + 0.5 * bounds[row, 3 + k]
            least, most = min(least, middle), max(most, middle)
        if most - least > widest:
            best, widest = k, most - least
    return best

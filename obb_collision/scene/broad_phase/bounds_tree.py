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

"""A hierarchy over axis-aligned bounds: blocks of neighbours in Morton order.

As Karras 2012 without the pointers: blocks of neighbouring boxes are the leaves, and every inner
node has the same number of children, so a tree is one array of bounds per level. Bounds are only
ever merged, never rounded.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.typing import Floats

#: Boxes in a leaf; fewer make a deeper tree, more test too many pairs (tuned at n = 1e3 to 1e5).
LEAF = 4
#: Children of a node.
FANOUT = 4
#: Cells of the Morton grid along each axis: 10 bits, three of them in a 32-bit number.
MORTON_CELLS = 1024
#: Depth-first traversal leaves at most FANOUT - 1 nodes a level behind: enough for 4^24 leaves.
STACK = 24 * FANOUT


class BoundsTree(NamedTuple):
    """Bounds (n, 3) to (n, 3) and a hierarchy over them; see ``_build_tree``."""

    minimum: Floats
    maximum: Floats
    order: NDArray[np.int64]
    nodes: Floats
    starts: NDArray[np.int64]

    @classmethod
    def build(cls, minimum: Floats, maximum: Floats) -> BoundsTree:
        """Return the tree of bounds, of which there must be two at least."""
        order = np.argsort(_morton_codes(minimum, maximum))
        return cls(minimum, maximum, order, *_build_tree(minimum[order], maximum[order]))


@njit
def _spread_bits(x: int) -> int:
    """Put two zero bits between the ten lowest bits."""
    x = (x | (x << 16)) & 0x030000FF
    x = (x | (x << 8)) & 0x0300F00F
    x = (x | (x << 4)) & 0x030C30C3
    return (x | (x << 2)) & 0x09249249


@njit
def _morton_codes(minimum: Floats, maximum: Floats) -> np.ndarray:
    """Return (n,) the cells of the box centres along a Z-order curve."""
    count = len(minimum)
    low = np.empty(3)
    scale = np.empty(3)
    for k in range(3):
        smallest = np.inf
        largest = -np.inf
        for n in range(count):
            middle = 0.5 * minimum[n, k] + 0.5 * maximum[n, k]
            smallest = min(smallest, middle)
            largest = max(largest, middle)
        low[k] = smallest
        extent = largest - smallest
        scale[k] = (MORTON_CELLS - 1) / extent if extent > 1e-280 else 0.0
    codes = np.empty(count, np.uint32)
    for n in range(count):
        code = 0
        for k in range(3):
            middle = 0.5 * minimum[n, k] + 0.5 * maximum[n, k]
            cell = int(min((middle - low[k]) * scale[k], MORTON_CELLS - 1.0))
            code |= _spread_bits(max(cell, 0)) << k
        codes[n] = code
    return codes


@njit
def _build_tree(minimum: Floats, maximum: Floats) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds of all nodes (k, 6) and where each level starts in them.

    Level 0 are the boxes in order, level 1 the leaves over LEAF boxes, and each further one the
    nodes over FANOUT of the last, up to the root.
    """
    count = len(minimum)
    starts = np.zeros(66, np.int64)
    size = count
    levels = 0
    total = 0
    while True:
        starts[levels] = total
        total += size
        levels += 1
        if size == 1 and levels > 1:
            break
        group = LEAF if levels == 1 else FANOUT
        size = (size + group - 1) // group
    starts[levels] = total
    nodes = np.empty((total, 6))
    for n in range(count):
        for k in range(3):
            nodes[n, k] = minimum[n, k]
            nodes[n, 3 + k] = maximum[n, k]
    for level in range(1, levels):
        group = LEAF if level == 1 else FANOUT
        below = starts[level - 1]
        for n in range(starts[level + 1] - starts[level]):
            first = below + n * group
            last = min(first + group, starts[level])
            node = starts[level] + n
            for k in range(6):
                nodes[node, k] = nodes[first, k]
            for child in range(first + 1, last):
                for k in range(3):
                    nodes[node, k] = min(nodes[node, k], nodes[child, k])
                    nodes[node, 3 + k] = max(nodes[node, 3 + k], nodes[child, 3 + k])
    return nodes, starts[: levels + 1].copy()

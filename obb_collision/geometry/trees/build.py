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

"""Building an OBB tree: triangles sorted in place into runs, and a box for every run.

A node is split in two along its longest axis at the mean of its triangles' centroids (Gottschalk,
Lin, Manocha 1996), or in halves where that is too lopsided.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.node_fit import HALF, NODE, fit_node
from obb_collision.typing import Floats, Integers

#: Minimum share of triangles on either side of a split, else a node is halved: limits the depth to
#: 75 for 2^31 triangles.
MIN_SHARE = 0.25
#: Rows of the stack of a build: one per level.
LEVELS = 128
#: Maximum number of rounds of a selection; typically 2 log2 n.
SELECTION_ROUNDS = 100


def build_tree(
    triangles: Floats, leaf: int
) -> tuple[Integers, Floats, Integers, Integers, Integers]:
    """Return order (f,), nodes (m, 16), children (m,), starts (m, 2), levels (m,)."""
    # Scaled by a power of two, exactly, so that squares and cubes neither over- nor underflow.
    largest = np.abs(triangles).max()
    power = -int(np.frexp(largest)[1]) if largest > 0.0 else 0
    rows = np.ldexp(triangles, power)
    count = len(rows)
    order = np.arange(count)
    nodes = np.empty((2 * count, NODE))
    children = np.full(2 * count, -1)
    starts = np.empty((2 * count, 2), np.int64)
    levels = np.zeros(2 * count, np.int64)
    used = _build_kernel(rows, order, nodes, children, starts, levels, leaf)
    nodes = nodes[:used].copy()
    for part in (slice(0, 3), slice(HALF, NODE)):
        nodes[:, part] = np.ldexp(nodes[:, part], -power)
    half_extents = nodes[:, HALF : HALF + 3]
    # scaling back rounds where it reaches subnormal numbers
    half_extents[:] = np.nextafter(half_extents, np.inf)
    return order, nodes, children[:used].copy(), starts[:used].copy(), levels[:used].copy()


@njit
def _build_kernel(
    triangles: Floats,
    order: np.ndarray,
    nodes: Floats,
    children: np.ndarray,
    starts: np.ndarray,
    levels: np.ndarray,
    leaf: int,
) -> int:
    """Sort the triangles into a tree, write its nodes; return their number."""
    work = np.empty((3, 3, 3))
    keys = np.empty(len(triangles))
    stack = np.empty(LEVELS, np.int64)
    stack[0] = 0
    waiting = 1
    used = 1
    starts[0, 0], starts[0, 1] = 0, len(triangles)
    while waiting > 0:
        waiting -= 1
        node = stack[waiting]
        first, last = starts[node, 0], starts[node, 1]
        fit_node(triangles, first, last, nodes[node], work)
        if last - first <= leaf:
            continue
        middle = _split(triangles, order, keys, first, last, nodes[node])
        children[node] = used
        starts[used, 0], starts[used, 1] = first, middle
        starts[used + 1, 0], starts[used + 1, 1] = middle, last
        levels[used] = levels[used + 1] = levels[node] + 1
        stack[waiting], stack[waiting + 1] = used + 1, used
        waiting += 2
        used += 2
    return used


@njit
def _split(
    triangles: Floats, order: np.ndarray, keys: Floats, first: int, last: int, row: Floats
) -> int:
    """Split the triangles of a node along its longest axis; return where the second part starts."""
    axis = 0
    for k in range(1, 3):
        if row[HALF + k] > row[HALF + axis]:
            axis = k
    x, y, z = row[3 + axis], row[6 + axis], row[9 + axis]
    mean = 0.0
    for n in range(first, last):
        keys[n] = (
            x * (triangles[n, 0] + triangles[n, 3] + triangles[n, 6])
            + y * (triangles[n, 1] + triangles[n, 4] + triangles[n, 7])
            + z * (triangles[n, 2] + triangles[n, 5] + triangles[n, 8])
        )
        mean += keys[n]
    mean /= last - first
    i = first
    for n in range(first, last):
        if keys[n] < mean:
            _swap(triangles, order, keys, i, n)
            i += 1
    share = MIN_SHARE * (last - first)
    if i - first >= share and last - i >= share:
        return i
    middle = (first + last) // 2
    _select(triangles, order, keys, first, last, middle)
    return middle


@njit
def _select(
    triangles: Floats, order: np.ndarray, keys: Floats, first: int, last: int, middle: int
) -> None:
    """Move the triangles with the smaller keys before ``middle`` (Hoare 1961, "Find").

    Ends after SELECTION_ROUNDS even if keys in a hostile order need more: any halves make a
    valid tree.
    """
    low, high = first, last - 1
    for _ in range(SELECTION_ROUNDS):
        if low >= high:
            return
        pivot = keys[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while keys[i] < pivot:
                i += 1
            while keys[j] > pivot:
                j -= 1
            if i <= j:
                _swap(triangles, order, keys, i, j)
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@njit
def _swap(triangles: Floats, order: np.ndarray, keys: Floats, i: int, j: int) -> None:
    if i == j:
        return
    order[i], order[j] = order[j], order[i]
    keys[i], keys[j] = keys[j], keys[i]
    for k in range(9):
        triangles[i, k], triangles[j, k] = triangles[j, k], triangles[i, k]

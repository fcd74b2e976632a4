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
Lin, Manocha 1996), or in halves where that is too lopsided. The area-weighted covariance of its
triangles gives its axes (section 4), independent of the tessellation. For the few triangles of a
low node the plane and the longest edge of the largest one are often better; the box of smaller
surface is taken. Both are widened by more than the rounding errors, so that a box certainly
contains its triangles.
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import DEPENDENT, ROUNDOFF, UNDERFLOW
from obb_collision.typing import Floats, Integers

#: Numbers in the row of a node: centre, rotation row by row (columns are axes), half extents, size.
NODE = 16
#: Column at which the half extents of a row start.
HALF = 12
#: Column of the size, the sum of the half extents, by which a descent chooses the node to split.
SIZE = 15
#: A box is widened by this fraction of its triangles' distance from its first vertex and of its
#: centre. Projections are off by 5 roundoffs, the frame by 8, the centre by 4.
WIDENING = 64 * ROUNDOFF
#: Sweeps of Jacobi's method: cubic convergence leaves roundoffs after 4 to 6 on every matrix tried.
SWEEPS = 8
#: Off-diagonal entries below this fraction of the diagonal ones do not change those.
NEGLIGIBLE = 1e-18
#: Weight of squared edges, so that triangles without area count where there are no others.
EDGE_WEIGHT = 1e-6


@njit
def fit_node(triangles: Floats, first: int, last: int, row: Floats, work: Floats) -> None:
    """Write the box of triangles ``first`` to ``last - 1`` (n, 9) into row (16,).

    work: (3, 3, 3) scratch space.
    """
    covariance, frame, other = work[0], work[1], work[2]
    largest = _moments(triangles, first, last, covariance)
    _eigenvectors(covariance, frame)
    _orthonormalize_frame(frame)
    _triangle_frame(triangles, largest, other)
    area = _measure(triangles, first, last, frame, row)
    if _measure(triangles, first, last, other, row) > area:
        _measure(triangles, first, last, frame, row)


@njit
def _moments(triangles: Floats, first: int, last: int, covariance: Floats) -> int:
    """Write the covariance (3, 3) about the mean, by area; return the largest triangle.

    The integral of x x^T over a triangle is area / 12 (sum v v^T + 9 c c^T), c its centroid.
    """
    ox, oy, oz = triangles[first, 0], triangles[first, 1], triangles[first, 2]
    covariance[:] = 0.0
    total = sx = sy = sz = 0.0
    largest, largest_area = first, -1.0
    for n in range(first, last):
        ax, ay, az = triangles[n, 0] - ox, triangles[n, 1] - oy, triangles[n, 2] - oz
        bx, by, bz = triangles[n, 3] - ox, triangles[n, 4] - oy, triangles[n, 5] - oz
        cx, cy, cz = triangles[n, 6] - ox, triangles[n, 7] - oy, triangles[n, 8] - oz
        ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
        wx, wy, wz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        area = math.sqrt(wx * wx + wy * wy + wz * wz)
        if area > largest_area:
            largest, largest_area = n, area
        # slivers and points have a small weight, for nodes that contain nothing else
        square = ux * ux + uy * uy + uz * uz + vx * vx + vy * vy + vz * vz
        area += EDGE_WEIGHT * square + UNDERFLOW
        mx, my, mz = ax + bx + cx, ay + by + cy, az + bz + cz
        total += area
        sx, sy, sz = sx + area * mx, sy + area * my, sz + area * mz
        covariance[0, 0] += area * (ax * ax + bx * bx + cx * cx + mx * mx)
        covariance[1, 1] += area * (ay * ay + by * by + cy * cy + my * my)
        covariance[2, 2] += area * (az * az + bz * bz + cz * cz + mz * mz)
        covariance[0, 1] += area * (ax * ay + bx * by + cx * cy + mx * my)
        covariance[0, 2] += area * (ax * az + bx * bz + cx * cz + mx * mz)
        covariance[1, 2] += area * (ay * az + by * bz + cy * cz + my * mz)
    sx, sy, sz = sx / (3.0 * total), sy / (3.0 * total), sz / (3.0 * total)
    for i in range(3):
        for k in range(3):
            covariance[i, k] /= 12.0 * total
    covariance[0, 0] -= sx * sx
    covariance[1, 1] -= sy * sy
    covariance[2, 2] -= sz * sz
    covariance[0, 1] -= sx * sy
    covariance[0, 2] -= sx * sz
    covariance[1, 2] -= sy * sz
    return largest


@njit
def _eigenvectors(a: Floats, vectors: Floats) -> None:
    """Write the eigenvectors of a symmetric (3, 3) as columns (Jacobi); reads its upper half."""
    vectors[:] = 0.0
    for k in range(3):
        vectors[k, k] = 1.0
    for _ in range(SWEEPS):
        if a[0, 1] == 0.0 and a[0, 2] == 0.0 and a[1, 2] == 0.0:
            return
        for turn in range(3):
            p, q = (0, 1) if turn == 0 else ((0, 2) if turn == 1 else (1, 2))
            if abs(a[p, q]) <= NEGLIGIBLE * (abs(a[p, p]) + abs(a[q, q])):
                a[p, q] = 0.0
                continue
            theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
            t = math.copysign(1.0, theta) / (abs(theta) + math.hypot(theta, 1.0))
            c = 1.0 / math.sqrt(t * t + 1.0)
            s = t * c
            a[p, p] -= t * a[p, q]
            a[q, q] += t * a[p, q]
            a[p, q] = 0.0
            r = 3 - p - q
            pr, qr = (min(p, r), max(p, r)), (min(q, r), max(q, r))
            x, y = a[pr], a[qr]
            a[pr] = c * x - s * y
            a[qr] = s * x + c * y
            for k in range(3):
                x, y = vectors[k, p], vectors[k, q]
                vectors[k, p] = c * x - s * y
                vectors[k, q] = s * x + c * y


@njit
def _triangle_frame(triangles: Floats, n: int, frame: Floats) -> None:
    """Write a frame along the longest edge of a triangle and within its plane."""
    longest = -1.0
    for k in range(3):
        a, b, c = 3 * k, 3 * ((k + 1) % 3), 3 * ((k + 2) % 3)
        square = 0.0
        for i in range(3):
            square += (triangles[n, b + i] - triangles[n, a + i]) ** 2
        if square > longest:
            longest = square
            for i in range(3):
                frame[i, 0] = triangles[n, b + i] - triangles[n, a + i]
                frame[i, 1] = triangles[n, c + i] - triangles[n, a + i]
    _orthonormalize_frame(frame)


@njit
def _orthonormalize_frame(frame: Floats) -> None:
    """Complete the first two columns to a frame: orthonormal to 4 roundoffs, determinant +1."""
    if not _make_unit(frame, 0):
        frame[:, 0] = 0.0
        frame[0, 0] = 1.0
    if not _make_unit(frame, 1) or not _make_orthogonal(frame):
        least = 0
        for k in range(1, 3):
            if abs(frame[k, 0]) < abs(frame[least, 0]):
                least = k
        frame[:, 1] = 0.0
        frame[least, 1] = 1.0
        _make_orthogonal(frame)
    _make_orthogonal(frame)  # "twice is enough" (Kahan, in Parlett 1980, 6.9)
    frame[0, 2] = frame[1, 0] * frame[2, 1] - frame[2, 0] * frame[1, 1]
    frame[1, 2] = frame[2, 0] * frame[0, 1] - frame[0, 0] * frame[2, 1]
    frame[2, 2] = frame[0, 0] * frame[1, 1] - frame[1, 0] * frame[0, 1]


@njit
def _make_unit(frame: Floats, k: int) -> bool:
    largest = max(abs(frame[0, k]), abs(frame[1, k]), abs(frame[2, k]))
    if not 0.0 < largest < np.inf:
        return False
    x, y, z = frame[0, k] / largest, frame[1, k] / largest, frame[2, k] / largest
    norm = math.sqrt(x * x + y * y + z * z)
    frame[0, k], frame[1, k], frame[2, k] = x / norm, y / norm, z / norm
    return True


@njit
def _make_orthogonal(frame: Floats) -> bool:
    """Make the second column orthogonal to the first; False where they were parallel."""
    along = frame[0, 0] * frame[0, 1] + frame[1, 0] * frame[1, 1] + frame[2, 0] * frame[2, 1]
    for i in range(3):
        frame[i, 1] -= along * frame[i, 0]
    parallel = frame[0, 1] ** 2 + frame[1, 1] ** 2 + frame[2, 1] ** 2 < DEPENDENT**2
    return _make_unit(frame, 1) and not parallel


@njit
def _measure(triangles: Floats, first: int, last: int, frame: Floats, row: Floats) -> float:
    """Write the box of the triangles in a frame into a row; return a quarter of its surface."""
    ox, oy, oz = triangles[first, 0], triangles[first, 1], triangles[first, 2]
    low0 = low1 = low2 = high0 = high1 = high2 = reach = 0.0
    f00, f01, f02 = frame[0, 0], frame[0, 1], frame[0, 2]
    f10, f11, f12 = frame[1, 0], frame[1, 1], frame[1, 2]
    f20, f21, f22 = frame[2, 0], frame[2, 1], frame[2, 2]
    for n in range(first, last):
        for k in (0, 3, 6):
            x = triangles[n, k] - ox
            y = triangles[n, k + 1] - oy
            z = triangles[n, k + 2] - oz
            s0, s1, s2 = x * f00 + y * f10 + z * f20, x * f01 + y * f11 + z * f21, 0.0
            s2 = x * f02 + y * f12 + z * f22
            low0, high0 = min(low0, s0), max(high0, s0)
            low1, high1 = min(low1, s1), max(high1, s1)
            low2, high2 = min(low2, s2), max(high2, s2)
            reach = max(reach, abs(x) + abs(y) + abs(z))
    m0, m1, m2 = 0.5 * (low0 + high0), 0.5 * (low1 + high1), 0.5 * (low2 + high2)
    row[0] = ox + (f00 * m0 + f01 * m1 + f02 * m2)
    row[1] = oy + (f10 * m0 + f11 * m1 + f12 * m2)
    row[2] = oz + (f20 * m0 + f21 * m1 + f22 * m2)
    slack = WIDENING * (reach + max(abs(row[0]), abs(row[1]), abs(row[2]))) + UNDERFLOW
    for i in range(3):
        for k in range(3):
            row[3 + 3 * i + k] = frame[i, k]
    h0, h1, h2 = 0.5 * (high0 - low0), 0.5 * (high1 - low1), 0.5 * (high2 - low2)
    row[HALF], row[HALF + 1], row[HALF + 2] = h0 + slack, h1 + slack, h2 + slack
    row[SIZE] = h0 + h1 + h2
    return h0 * h1 + h1 * h2 + h2 * h0


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
    """Return the order (f,) of triangles; nodes, children, starts, levels as in ``MeshTrees``."""
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

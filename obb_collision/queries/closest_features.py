"""Candidates for the closest points of two boxes: face, edge and vertex of either.

Every function writes a point of each box, s and t of ``Pair``, and returns the square of their
distance: what rounding does to a choice can make points less close, never wrong.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.validation import Floats

#: An extent counts as level with a face if it rises by no more than this on its way: 128 unit
#: roundoffs, what 64 of them in the axes can add up to. Either of its ends is then as close.
LEVEL = 2.0**-46


class Pair(NamedTuple):
    """Two boxes in the frame of the first, a, and what is found about them: (3,), r (3, 3).

    A point of a is s, one of b is d + r t, with abs(s) <= h and abs(t) <= f.
    """

    d: Floats  #: centre of b
    r: Floats  #: axes of b as columns
    h: Floats  #: half extents of a
    f: Floats  #: half extents of b
    s: Floats  #: found: point of a
    t: Floats  #: found: point of b, along its axes
    n: Floats  #: unit vector from a to b that is looked along


@njit
def empty_pair() -> Pair:
    """Return room for a pair."""
    return Pair(
        np.empty(3), np.empty((3, 3)), np.empty(3), np.empty(3),
        np.empty(3), np.empty(3), np.empty(3),
    )  # fmt: skip


@njit
def face_points(pair: Pair, number: int) -> float:
    """Face ``number`` (3 to 5: of b) with normal n, from a to b, against the other box.

    The other box is in its vertex closest to the face, or anywhere along an extent level with it.
    """
    d, r, h, f, s, t, n = pair.d, pair.r, pair.h, pair.f, pair.s, pair.t, pair.n
    for i in range(3):
        s[i] = min(max(d[i], -h[i]), h[i])
    _project_on_b(pair)
    if number < 3:
        for j in range(3):
            along = n[0] * r[0, j] + n[1] * r[1, j] + n[2] * r[2, j]
            if abs(along) > LEVEL:
                t[j] = -math.copysign(f[j], along)
        return _project_on_a(pair)
    _project_on_a(pair)
    for i in range(3):
        if abs(n[i]) > LEVEL:
            s[i] = math.copysign(h[i], n[i])
    _project_on_b(pair)
    return squared_distance(pair)


@njit
def edge_points(pair: Pair, i: int, j: int) -> float:
    """Those edges i of a and j of b that are foremost along n, the unit vector normal to both."""
    r, h, f, s, t, n = pair.r, pair.h, pair.f, pair.s, pair.t, pair.n
    for k in range(3):
        along = n[0] * r[0, k] + n[1] * r[1, k] + n[2] * r[2, k]
        s[k] = math.copysign(h[k], n[k])
        t[k] = -math.copysign(f[k], along)
    return _cross_edges(pair, i, j)


@njit
def vertex_points(pair: Pair, best: float) -> float:
    """Each vertex against the other box; s and t stay where none is closer than ``best``."""
    d, r, h, f, s, t = pair.d, pair.r, pair.h, pair.f, pair.s, pair.t
    of_a, vertex = False, -1
    for code in range(8):
        t0, t1, t2 = _corner(f, code)
        square = 0.0
        for i in range(3):
            excess = abs(d[i] + ((r[i, 0] * t0 + r[i, 1] * t1) + r[i, 2] * t2)) - h[i]
            square += max(excess, 0.0) * max(excess, 0.0)
        if square < best:
            best, vertex = square, code
    for code in range(8):
        x, y, z = _corner(h, code)
        x, y, z = x - d[0], y - d[1], z - d[2]
        square = 0.0
        for j in range(3):
            excess = abs(r[0, j] * x + r[1, j] * y + r[2, j] * z) - f[j]
            square += max(excess, 0.0) * max(excess, 0.0)
        if square < best:
            best, vertex, of_a = square, code, True
    if vertex >= 0 and of_a:
        s[0], s[1], s[2] = _corner(h, vertex)
        _project_on_b(pair)
    elif vertex >= 0:
        t[0], t[1], t[2] = _corner(f, vertex)
        _project_on_a(pair)
    return best


@njit
def all_edge_points(pair: Pair, best: float) -> float:
    """Each of the 144 pairs of edges; s and t stay where none is closer than ``best``."""
    s, t = pair.s, pair.t
    before = (s[0], s[1], s[2], t[0], t[1], t[2])
    found = -1
    for code in range(144):
        square = _numbered_edges(pair, code)
        if square < best:
            best, found = square, code
    if found >= 0:
        _numbered_edges(pair, found)
    else:
        s[0], s[1], s[2], t[0], t[1], t[2] = before
    return best


@njit
def _numbered_edges(pair: Pair, code: int) -> float:
    """Pair of edges ``code`` of 144: direction in a, direction in b, one of 4 x 4."""
    h, f, s, t = pair.h, pair.f, pair.s, pair.t
    i, j = code // 48, code // 16 % 3
    s[(i + 1) % 3] = h[(i + 1) % 3] if code & 1 else -h[(i + 1) % 3]
    s[(i + 2) % 3] = h[(i + 2) % 3] if code & 2 else -h[(i + 2) % 3]
    t[(j + 1) % 3] = f[(j + 1) % 3] if code & 4 else -f[(j + 1) % 3]
    t[(j + 2) % 3] = f[(j + 2) % 3] if code & 8 else -f[(j + 2) % 3]
    return _cross_edges(pair, i, j)


@njit
def _cross_edges(pair: Pair, i: int, j: int) -> float:
    """Slide along edge i of a and edge j of b to where the lines are closest, within the edges.

    Seen along edge i, where the two other components are left, t[j] is a projection on a line:
    no determinant near zero however parallel the edges. Where the lines are closest beyond an end,
    a vertex is closer (``vertex_points``).
    """
    d, r, h, f, s, t = pair.d, pair.r, pair.h, pair.f, pair.s, pair.t
    k, m = (i + 1) % 3, (i + 2) % 3
    t[j] = 0.0
    x = d[k] + ((r[k, 0] * t[0] + r[k, 1] * t[1]) + r[k, 2] * t[2]) - s[k]
    y = d[m] + ((r[m, 0] * t[0] + r[m, 1] * t[1]) + r[m, 2] * t[2]) - s[m]
    square = r[k, j] * r[k, j] + r[m, j] * r[m, j]
    if square > 0.0:
        t[j] = min(max(-(x * r[k, j] + y * r[m, j]) / square, -f[j]), f[j])
    z = d[i] + ((r[i, 0] * t[0] + r[i, 1] * t[1]) + r[i, 2] * t[2])
    s[i] = min(max(z, -h[i]), h[i])
    x += r[k, j] * t[j]
    y += r[m, j] * t[j]
    return x * x + y * y + (z - s[i]) * (z - s[i])


@njit
def squared_distance(pair: Pair) -> float:
    """Return the squared distance of s and t."""
    d, r, s, t = pair.d, pair.r, pair.s, pair.t
    square = 0.0
    for i in range(3):
        x = d[i] + ((r[i, 0] * t[0] + r[i, 1] * t[1]) + r[i, 2] * t[2]) - s[i]
        square += x * x
    return square


@njit
def _project_on_a(pair: Pair) -> float:
    """Write the point of a closest to t."""
    d, r, h, s, t = pair.d, pair.r, pair.h, pair.s, pair.t
    square = 0.0
    for i in range(3):
        x = d[i] + ((r[i, 0] * t[0] + r[i, 1] * t[1]) + r[i, 2] * t[2])
        s[i] = min(max(x, -h[i]), h[i])
        square += (x - s[i]) * (x - s[i])
    return square


@njit
def _project_on_b(pair: Pair) -> None:
    """Write the point of b closest to s."""
    d, r, f, s, t = pair.d, pair.r, pair.f, pair.s, pair.t
    x, y, z = s[0] - d[0], s[1] - d[1], s[2] - d[2]
    for j in range(3):
        t[j] = min(max(r[0, j] * x + r[1, j] * y + r[2, j] * z, -f[j]), f[j])


@njit
def _corner(extents: Floats, code: int) -> tuple[float, float, float]:
    """Return one of the eight corners: bit k of the code set means the positive end."""
    return (
        extents[0] if code & 1 else -extents[0],
        extents[1] if code & 2 else -extents[1],
        extents[2] if code & 4 else -extents[2],
    )

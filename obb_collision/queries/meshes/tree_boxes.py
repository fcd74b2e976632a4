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

"""Are two nodes of mesh trees apart? The separating axis test in the frame of the first mesh.

The offset and rotation between the meshes are computed once a pair of poses (``relative_pose``),
with one bound on all errors, so that a node test is little more than the products it needs.

Error analysis, u = 2^-53, S = abs(offset) + the reach of both meshes: a stored rotation R has
abs(R^T R - I) <= 64 u, so taking R_a^T for the inverse of R_a moves a point by at most 64 u S, and
the products of poses add 12 u S. A node's axes are orthonormal to 16 u, those of b in the frame of
a to 160 u. A gap of the test is then off by at most 1200 u S (the terms of the analysis in
``separation`` with these figures); ``BOX_BOUND`` is 4096 u.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.typing import Floats

#: Bound on the error of a gap relative to S (derivation above).
BOX_BOUND = 4096 * ROUNDOFF
#: Bound on the error of a moved corner relative to S: 256 unit roundoffs (derivation above).
POINT_BOUND = 256 * ROUNDOFF


@njit
def relative_pose(
    ca: Floats, ra: Floats, i: int, cb: Floats, rb: Floats, j: int, reach: float, pose: Floats
) -> float:
    """Write the pose (12,) of b in the frame of a, rotation row by row, offset; return S."""
    x, y, z = cb[j, 0] - ca[i, 0], cb[j, 1] - ca[i, 1], cb[j, 2] - ca[i, 2]
    for k in range(3):
        a0, a1, a2 = ra[i, 0, k], ra[i, 1, k], ra[i, 2, k]
        for n in range(3):
            pose[3 * k + n] = a0 * rb[j, 0, n] + a1 * rb[j, 1, n] + a2 * rb[j, 2, n]
        pose[9 + k] = a0 * x + a1 * y + a2 * z
    return abs(x) + abs(y) + abs(z) + reach


@njit
def box_gap(a: Floats, i: int, b: Floats, j: int, m: Floats, bound: float) -> float:
    """Return infinity where nodes i and j are certainly apart, else the largest face gap.

    a, b: rows of nodes (n, 16); m: pose (12,) of b in the frame of a. The six faces first.
    """
    c0, c1, c2 = b[j, 0], b[j, 1], b[j, 2]
    dx = m[0] * c0 + m[1] * c1 + m[2] * c2 + m[9] - a[i, 0]
    dy = m[3] * c0 + m[4] * c1 + m[5] * c2 + m[10] - a[i, 1]
    dz = m[6] * c0 + m[7] * c1 + m[8] * c2 + m[11] - a[i, 2]
    h0, h1, h2 = a[i, 12], a[i, 13], a[i, 14]
    f0, f1, f2 = b[j, 12], b[j, 13], b[j, 14]

    # the axes of a, taken into the frame of mesh b: rows of (R_a^T M)
    g00 = a[i, 3] * m[0] + a[i, 6] * m[3] + a[i, 9] * m[6]
    g01 = a[i, 3] * m[1] + a[i, 6] * m[4] + a[i, 9] * m[7]
    g02 = a[i, 3] * m[2] + a[i, 6] * m[5] + a[i, 9] * m[8]
    r00 = g00 * b[j, 3] + g01 * b[j, 6] + g02 * b[j, 9]
    r01 = g00 * b[j, 4] + g01 * b[j, 7] + g02 * b[j, 10]
    r02 = g00 * b[j, 5] + g01 * b[j, 8] + g02 * b[j, 11]
    t0 = a[i, 3] * dx + a[i, 6] * dy + a[i, 9] * dz
    q00, q01, q02 = abs(r00), abs(r01), abs(r02)
    gap = abs(t0) - (h0 + (f0 * q00 + f1 * q01 + f2 * q02))
    if gap > bound:
        return np.inf
    g10 = a[i, 4] * m[0] + a[i, 7] * m[3] + a[i, 10] * m[6]
    g11 = a[i, 4] * m[1] + a[i, 7] * m[4] + a[i, 10] * m[7]
    g12 = a[i, 4] * m[2] + a[i, 7] * m[5] + a[i, 10] * m[8]
    r10 = g10 * b[j, 3] + g11 * b[j, 6] + g12 * b[j, 9]
    r11 = g10 * b[j, 4] + g11 * b[j, 7] + g12 * b[j, 10]
    r12 = g10 * b[j, 5] + g11 * b[j, 8] + g12 * b[j, 11]
    t1 = a[i, 4] * dx + a[i, 7] * dy + a[i, 10] * dz
    q10, q11, q12 = abs(r10), abs(r11), abs(r12)
    gap = max(gap, abs(t1) - (h1 + (f0 * q10 + f1 * q11 + f2 * q12)))
    if gap > bound:
        return np.inf
    g20 = a[i, 5] * m[0] + a[i, 8] * m[3] + a[i, 11] * m[6]
    g21 = a[i, 5] * m[1] + a[i, 8] * m[4] + a[i, 11] * m[7]
    g22 = a[i, 5] * m[2] + a[i, 8] * m[5] + a[i, 11] * m[8]
    r20 = g20 * b[j, 3] + g21 * b[j, 6] + g22 * b[j, 9]
    r21 = g20 * b[j, 4] + g21 * b[j, 7] + g22 * b[j, 10]
    r22 = g20 * b[j, 5] + g21 * b[j, 8] + g22 * b[j, 11]
    t2 = a[i, 5] * dx + a[i, 8] * dy + a[i, 11] * dz
    q20, q21, q22 = abs(r20), abs(r21), abs(r22)
    gap = max(gap, abs(t2) - (h2 + (f0 * q20 + f1 * q21 + f2 * q22)))
    if gap > bound:
        return np.inf
    gap = max(
        gap,
        abs(t0 * r00 + t1 * r10 + t2 * r20) - (f0 + (h0 * q00 + h1 * q10 + h2 * q20)),
        abs(t0 * r01 + t1 * r11 + t2 * r21) - (f1 + (h0 * q01 + h1 * q11 + h2 * q21)),
        abs(t0 * r02 + t1 * r12 + t2 * r22) - (f2 + (h0 * q02 + h1 * q12 + h2 * q22)),
    )
    if gap > bound:
        return np.inf
    edges = max(
        abs(t2 * r10 - t1 * r20) - (h1 * q20 + h2 * q10 + f1 * q02 + f2 * q01),
        abs(t2 * r11 - t1 * r21) - (h1 * q21 + h2 * q11 + f0 * q02 + f2 * q00),
        abs(t2 * r12 - t1 * r22) - (h1 * q22 + h2 * q12 + f0 * q01 + f1 * q00),
        abs(t0 * r20 - t2 * r00) - (h0 * q20 + h2 * q00 + f1 * q12 + f2 * q11),
        abs(t0 * r21 - t2 * r01) - (h0 * q21 + h2 * q01 + f0 * q12 + f2 * q10),
        abs(t0 * r22 - t2 * r02) - (h0 * q22 + h2 * q02 + f0 * q11 + f1 * q10),
        abs(t1 * r00 - t0 * r10) - (h0 * q10 + h1 * q00 + f1 * q22 + f2 * q21),
        abs(t1 * r01 - t0 * r11) - (h0 * q11 + h1 * q01 + f0 * q22 + f2 * q20),
        abs(t1 * r02 - t0 * r12) - (h0 * q12 + h1 * q02 + f0 * q21 + f1 * q20),
    )
    return np.inf if edges > bound else gap

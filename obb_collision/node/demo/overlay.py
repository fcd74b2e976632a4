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

"""What is drawn over a rendered image: translucent faces and lines that know what hides them.

Points on the image are as in ``raster``: (x, y, closeness).
"""

from __future__ import annotations

from obb_collision._jit import njit
from obb_collision.node.demo.raster import FloatArray, Pixels

#: Relative closeness by which what lies on a surface, such as a box's edge, is seen before it.
ON_SURFACE = 0.002


@njit
def blend_triangles(
    corners: FloatArray, colors: FloatArray, alphas: FloatArray, closest: Pixels, image: Pixels
) -> None:
    """Tint what is seen through triangles (m, 3, 3), the furthest first; colors (m, 3)."""
    height, width = closest.shape
    for t in range(len(corners)):
        ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
        bx, by, bz = corners[t, 1, 0], corners[t, 1, 1], corners[t, 1, 2]
        cx, cy, cz = corners[t, 2, 0], corners[t, 2, 1], corners[t, 2, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        for y in range(max(0, int(min(ay, by, cy))), min(height, int(max(ay, by, cy)) + 2)):
            for x in range(max(0, int(min(ax, bx, cx))), min(width, int(max(ax, bx, cx)) + 2)):
                px, py = x + 0.5, y + 0.5
                u = ((bx - px) * (cy - py) - (by - py) * (cx - px)) / area
                v = ((cx - px) * (ay - py) - (cy - py) * (ax - px)) / area
                # half open, so that the diagonal of a face is not tinted twice
                if u > 0.0 and v >= 0.0 and u + v < 1.0:
                    z = u * az + v * bz + (1.0 - u - v) * cz
                    if z * (1.0 + ON_SURFACE) > closest[y, x]:
                        for k in range(3):
                            image[y, x, k] += alphas[t] * (colors[t, k] - image[y, x, k])


@njit
def blend_lines(
    ends: FloatArray,
    colors: FloatArray,
    radii: FloatArray,
    hidden: float,
    closest: Pixels,
    image: Pixels,
) -> None:
    """Draw lines (n, 2, 3) with round ends, ``radii`` (n,) pixels; opaque where seen.

    hidden: the opacity of what lies behind something.
    """
    height, width = closest.shape
    for n in range(len(ends)):
        ax, ay, az = ends[n, 0, 0], ends[n, 0, 1], ends[n, 0, 2]
        dx, dy, dz = ends[n, 1, 0] - ax, ends[n, 1, 1] - ay, ends[n, 1, 2] - az
        r, square = radii[n], dx * dx + dy * dy
        top, left = min(ay, ay + dy) - r, min(ax, ax + dx) - r
        bottom, right = max(ay, ay + dy) + r, max(ax, ax + dx) + r
        for y in range(max(0, int(top)), min(height, int(bottom) + 2)):
            for x in range(max(0, int(left)), min(width, int(right) + 2)):
                px, py = x + 0.5 - ax, y + 0.5 - ay
                share = 0.0
                if square > 0.0:
                    share = min(1.0, max(0.0, (px * dx + py * dy) / square))
                px, py = px - share * dx, py - share * dy
                if px * px + py * py <= r * r:
                    seen = (az + share * dz) * (1.0 + ON_SURFACE) > closest[y, x]
                    alpha = 1.0 if seen else hidden
                    for k in range(3):
                        image[y, x, k] += alpha * (colors[n, k] - image[y, x, k])

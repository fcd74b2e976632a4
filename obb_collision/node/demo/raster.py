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

"""A small renderer for the demo's picture: depth buffer and one light with soft shadows.

Points on the image are (x, y, closeness): pixels from the top left, and a number that is larger
the closer the point is to the eye and linear on the image, so interpolating it is exact.
The kernels are written with scalars: array expressions in them take seconds more to compile.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, sqrt

import numpy as np
import numpy.typing as npt

from obb_collision._jit import njit

FloatArray = npt.NDArray[np.float64]
Pixels = npt.NDArray[np.float32]
FaceMap = npt.NDArray[np.int32]

#: Metres that a point is lifted off its surface before asking whether it is in shadow.
SHADOW_LIFT = 0.025
#: Half the width of the soft edge of shadows, in pixels of the shadow map.
SHADOW_SOFTNESS = 3
#: How bright what the light does not reach is, on the floor and elsewhere; the sky's share of
#: what faces upwards; the light's share of what faces it.
FLOOR_SHADE, AMBIENT, SKY, LIGHT = 0.70, 0.62, 0.10, 0.42
#: Floor: tile edge, half the joint's width, from where and over what distance it fades, metres.
TILE, JOINT, FADE_FROM, FADE_OVER = 1.0, 0.012, 6.0, 9.0
#: Floor: brightness of joints and tiles.
JOINT_LEVEL, TILE_LEVEL = 0.86, 0.925


@dataclass(frozen=True)
class View:
    """A camera at ``eye`` (3,): ``matrix`` (3, 4) takes world points to image x, y and depth."""

    eye: FloatArray
    matrix: FloatArray
    perspective: bool

    def project(self, points: FloatArray) -> FloatArray:
        """Return image points (..., 3) of world points (..., 3)."""
        placed: FloatArray = points @ self.matrix[:, :3].T + self.matrix[:, 3]
        if self.perspective:
            placed[..., :2] /= placed[..., 2:]
            placed[..., 2] = 1.0 / placed[..., 2]
        else:
            placed[..., 2] *= -1.0
        return placed


def look(
    eye: FloatArray, target: FloatArray, focal: float, size: tuple[int, int], perspective: bool
) -> View:
    """Return a view from ``eye`` to ``target``, both (3,), with z upwards on the image.

    size: width and height in pixels. focal: pixels per unit of slope, or pixels per metre where
    it is not a perspective.
    """
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    axes = np.array((right, np.cross(ahead, right), ahead))
    matrix = np.column_stack((axes, -axes @ eye))
    middle = np.array(size) / 2.0
    matrix[:2] *= focal
    if perspective:
        matrix[:2] += middle[:, None] * matrix[2]
    else:
        matrix[:2, 3] += middle
    return View(eye, matrix, perspective)


@njit
def fill(corners: FloatArray, closest: Pixels, face: FaceMap) -> None:
    """Write where each triangle (m, 3, 3) is the closest: its closeness and index, per pixel."""
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
                if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                    z = u * az + v * bz + (1.0 - u - v) * cz
                    if z > closest[y, x]:
                        closest[y, x] = z
                        face[y, x] = t


@njit
def lit_share(px: float, py: float, pz: float, light: FloatArray, shadow_map: Pixels) -> float:
    """Return which share of the light reaches a point, by the closest things the light sees."""
    x = int(light[0, 0] * px + light[0, 1] * py + light[0, 2] * pz + light[0, 3])
    y = int(light[1, 0] * px + light[1, 1] * py + light[1, 2] * pz + light[1, 3])
    z = light[2, 0] * px + light[2, 1] * py + light[2, 2] * pz + light[2, 3]
    height, width = shadow_map.shape
    dark = 0
    for j in range(max(0, y - SHADOW_SOFTNESS), min(height, y + SHADOW_SOFTNESS + 1)):
        for i in range(max(0, x - SHADOW_SOFTNESS), min(width, x + SHADOW_SOFTNESS + 1)):
            if shadow_map[j, i] > -z:
                dark += 1
    return 1.0 - dark / (2 * SHADOW_SOFTNESS + 1) ** 2


@njit
def floor_level(x: float, y: float) -> float:
    """Return the brightness of the floor at a place: tiles, fading to white far off."""
    gap = min(abs(x / TILE - floor(x / TILE + 0.5)), abs(y / TILE - floor(y / TILE + 0.5)))
    level = JOINT_LEVEL if gap * TILE < JOINT else TILE_LEVEL
    fade = min(1.0, max(0.0, (sqrt(x * x + y * y) - FADE_FROM) / FADE_OVER))
    return level + (1.0 - level) * fade * fade * (3.0 - 2.0 * fade)


@njit
def shade_floor(
    image: Pixels,
    face: FaceMap,
    eye: FloatArray,
    rays: FloatArray,
    light: FloatArray,
    shadow_map: Pixels,
) -> None:
    """Write the floor, z = 0, to the pixels of ``image`` (h, w, 3) that no triangle has.

    rays (3, 3) takes (x, y, 1) on the image to the direction of sight; light (3, 4): its view.
    """
    height, width = face.shape
    for y in range(height):
        for x in range(width):
            if face[y, x] >= 0:
                continue
            down = rays[2, 0] * (x + 0.5) + rays[2, 1] * (y + 0.5) + rays[2, 2]
            bright = 1.0
            if down < -1e-9:  # else the sky
                way = -eye[2] / down
                px = eye[0] + way * (rays[0, 0] * (x + 0.5) + rays[0, 1] * (y + 0.5) + rays[0, 2])
                py = eye[1] + way * (rays[1, 0] * (x + 0.5) + rays[1, 1] * (y + 0.5) + rays[1, 2])
                lit = lit_share(px, py, SHADOW_LIFT, light, shadow_map)
                bright = floor_level(px, py) * (FLOOR_SHADE + (1.0 - FLOOR_SHADE) * lit)
            for k in range(3):
                image[y, x, k] = bright


@njit
def shade_faces(
    image: Pixels,
    face: FaceMap,
    screen: FloatArray,
    world: FloatArray,
    normals: FloatArray,
    colors: FloatArray,
    to_light: FloatArray,
    light: FloatArray,
    shadow_map: Pixels,
) -> None:
    """Write the triangles to the pixels of ``image`` (h, w, 3) that have one.

    screen, world, normals (m, 3, 3): of their corners; colors (m, 3). to_light: unit (3,).
    """
    height, width = face.shape
    for y in range(height):
        for x in range(width):
            t = face[y, x]
            if t < 0:
                continue
            ax, ay = screen[t, 0, 0] - x - 0.5, screen[t, 0, 1] - y - 0.5
            bx, by = screen[t, 1, 0] - x - 0.5, screen[t, 1, 1] - y - 0.5
            cx, cy = screen[t, 2, 0] - x - 0.5, screen[t, 2, 1] - y - 0.5
            # weights of the corners, right in space: those on the image times the closeness
            u = (bx * cy - by * cx) * screen[t, 0, 2]
            v = (cx * ay - cy * ax) * screen[t, 1, 2]
            w = (ax * by - ay * bx) * screen[t, 2, 2]
            u, v, w = u / (u + v + w), v / (u + v + w), w / (u + v + w)
            nx = u * normals[t, 0, 0] + v * normals[t, 1, 0] + w * normals[t, 2, 0]
            ny = u * normals[t, 0, 1] + v * normals[t, 1, 1] + w * normals[t, 2, 1]
            nz = u * normals[t, 0, 2] + v * normals[t, 1, 2] + w * normals[t, 2, 2]
            size = sqrt(nx * nx + ny * ny + nz * nz)
            nx, ny, nz = nx / size, ny / size, nz / size
            facing = nx * to_light[0] + ny * to_light[1] + nz * to_light[2]
            bright = AMBIENT + SKY * nz
            if facing > 0.0:
                px = u * world[t, 0, 0] + v * world[t, 1, 0] + w * world[t, 2, 0]
                py = u * world[t, 0, 1] + v * world[t, 1, 1] + w * world[t, 2, 1]
                pz = u * world[t, 0, 2] + v * world[t, 1, 2] + w * world[t, 2, 2]
                px, py, pz = px + SHADOW_LIFT * nx, py + SHADOW_LIFT * ny, pz + SHADOW_LIFT * nz
                bright += LIGHT * facing * lit_share(px, py, pz, light, shadow_map)
            for k in range(3):
                image[y, x, k] = min(1.0, colors[t, k] * bright)

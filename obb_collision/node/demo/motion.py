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

"""Motions of the demo: poses as functions of time, seconds, built from a few simple ones."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, fmod, pi, sin

Pose = tuple[float, float, float, float, float, float, float]
Motion = Callable[[float], Pose]
Place = tuple[float, float, float]


def pose(x: float, y: float, z: float, yaw: float = 0.0, roll: float = 0.0) -> Pose:
    """Return a pose turned by ``roll`` about its own x axis, then by ``yaw`` about z, radians."""
    cy, sy, cr, sr = cos(yaw / 2), sin(yaw / 2), cos(roll / 2), sin(roll / 2)
    return float(x), float(y), float(z), cy * sr, sy * sr, sy * cr, cy * cr


def compose(outer: Pose, inner: Pose) -> Pose:
    """Return ``inner``, given in the frame ``outer``, in the frame ``outer`` is given in."""
    x, y, z, w = outer[3:]
    px, py, pz, bx, by, bz, bw = inner
    tx, ty, tz = 2 * (y * pz - z * py), 2 * (z * px - x * pz), 2 * (x * py - y * px)
    return (
        outer[0] + px + w * tx + y * tz - z * ty,
        outer[1] + py + w * ty + z * tx - x * tz,
        outer[2] + pz + w * tz + x * ty - y * tx,
        w * bx + x * bw + y * bz - z * by,
        w * by - x * bz + y * bw + z * bx,
        w * bz + x * by - y * bx + z * bw,
        w * bw - x * bx - y * by - z * bz,
    )


def resting(place: Pose) -> Motion:
    """Return the motion of what stays where it is."""
    return lambda time: place


def attached(motion: Motion, place: Pose) -> Motion:
    """Return the motion of what is fixed at ``place`` on a moving thing."""
    return lambda time: compose(motion(time), place)


def shuttling(
    start: Place, end: Place, period: float, phase: float, yaw: float = 0.0, jumps: bool = False
) -> Motion:
    """Return a motion between two places: to and fro softly, or at one speed and ``jumps`` back."""

    def at(time: float) -> Pose:
        part = fmod(time / period + phase, 1.0)
        share = part if jumps else 0.5 - 0.5 * cos(2 * pi * part)
        x, y, z = (a + share * (b - a) for a, b in zip(start, end, strict=True))
        return pose(x, y, z, yaw)

    return at


def travelling(
    center: tuple[float, float],
    half: tuple[float, float],
    radius: float,
    speed: float,
    phase: float,
) -> Motion:
    """Return a drive round a rectangle with round corners, anticlockwise, nose ahead.

    half: half its edge lengths; speed in m/s; phase in rounds.
    """
    straight_x, straight_y, arc = 2 * (half[0] - radius), 2 * (half[1] - radius), radius * pi / 2
    total = 2 * (straight_x + straight_y) + 4 * arc

    def at(time: float) -> Pose:
        way = fmod(speed * time + phase * total, total)
        # each side starts at (x, y) heading ``yaw``: a straight, then a corner to the left
        x, y, yaw = center[0] - half[0] + radius, center[1] - half[1], 0.0
        for straight in (straight_x, straight_y, straight_x, straight_y):
            step = min(way, straight)
            x, y, way = x + step * cos(yaw), y + step * sin(yaw), way - step
            turn = min(way, arc) / radius
            x += radius * (sin(yaw + turn) - sin(yaw))
            y -= radius * (cos(yaw + turn) - cos(yaw))
            yaw, way = yaw + turn, way - radius * turn
            if way <= 0.0:
                break
        return pose(x, y, 0.0, yaw)

    return at


def joint(frame: Motion, reach: float, period: float, phase: float, rest: float = 0.0) -> Motion:
    """Return a joint that turns about z of ``frame``, by up to ``reach`` radians from ``rest``."""

    def at(time: float) -> Pose:
        angle = rest + reach * sin(2 * pi * (time / period + phase))
        return compose(frame(time), pose(0.0, 0.0, 0.0, angle))

    return at


def swinging(pivot: Place, reach: float, period: float, phase: float) -> Motion:
    """Return a pendulum's frame, by up to ``reach`` radians about an axis that turns slowly."""

    def at(time: float) -> Pose:
        angle = reach * sin(2 * pi * (time / period + phase))
        plane = 0.1 * time
        return (*pivot, sin(angle / 2) * cos(plane), sin(angle / 2) * sin(plane), 0, cos(angle / 2))

    return at


def hovering(center: Place, half: Place, period: float, phase: float) -> Motion:
    """Return a flight on a Lissajous curve that leans into its turns, nose ahead."""

    def at(time: float) -> Pose:
        a = 2 * pi * (time / period + phase)
        x, y, z = (
            c + h * wave
            for c, h, wave in zip(center, half, (cos(a), sin(2 * a), sin(3 * a)), strict=True)
        )
        return compose(pose(x, y, z, a + pi / 2), pose(0, 0, 0, 0, 0.35 * sin(2 * a)))

    return at


def around(center: Place, radius: float, period: float) -> Motion:
    """Return a motion on a level circle, turning with it."""

    def at(time: float) -> Pose:
        a = 2 * pi * fmod(time / period, 1.0)
        return pose(center[0] + radius * cos(a), center[1] + radius * sin(a), center[2], a)

    return at

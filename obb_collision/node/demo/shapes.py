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

"""Bodies of the demo's warehouse, as shapes of the library."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import trimesh
from trimesh import creation
from trimesh.transformations import rotation_matrix, translation_matrix

from obb_collision.geometry.shapes import Mesh

#: Corners of a round body's polygon: round to the eye, few enough for a marker of triangles.
SECTIONS = 24


def _mesh(*parts: Any) -> Mesh:
    body: Any = trimesh.util.concatenate(parts)
    return Mesh(body.vertices, body.faces)


def _flats(body: Any) -> Any:
    """Turn a body about z so that flats, not corners, of its polygon face along x and y.

    Its tightest box is then upright, and stands where the body stands.
    """
    return body.apply_transform(rotation_matrix(np.pi / SECTIONS, (0, 0, 1)))


def _block(size: Sequence[float], at: Sequence[float]) -> Any:
    return creation.box(extents=size, transform=translation_matrix(at))


@cache
def rack_frame(height: float, depth: float, width: float) -> Mesh:
    """Side of a rack in the y z plane, its foot at z = 0: two posts with rungs and braces."""
    post = 0.09
    inside = depth - 2 * post
    posts = [
        _block((width, post, height), (0, s * (depth - post) / 2, height / 2)) for s in (-1, 1)
    ]
    levels = np.linspace(0.25, height - 0.15, 4)
    rungs = [_block((width / 2, inside, 0.05), (0, 0, z)) for z in levels]
    braces = []
    for k, (low, high) in enumerate(pairwise(levels)):
        slope = np.arctan2(high - low, inside) * (-1) ** k
        turn = rotation_matrix(slope, (1, 0, 0))
        length = np.hypot(high - low, inside) - 0.05
        place = translation_matrix((0, 0, (low + high) / 2)) @ turn
        braces.append(creation.box(extents=(width / 3, length, 0.035), transform=place))
    return _mesh(*posts, *rungs, *braces)


@cache
def pallet() -> Mesh:
    """Wooden pallet, 1.25 x 1 x 0.125 m, its underside at z = 0."""
    boards = [_block((0.15, 1.0, 0.03125), (x, 0, 0.109375)) for x in np.linspace(-0.55, 0.55, 6)]
    runners = [_block((1.25, 0.125, 0.09375), (0, y, 0.046875)) for y in (-0.4375, 0, 0.4375)]
    return _mesh(*boards, *runners)


@cache
def vehicle(length: float, width: float, height: float) -> Mesh:
    """Body of a driverless vehicle from z = 0 to ``height``, its corners cut off, nose at +x."""
    x, y, cut = length / 2, width / 2, width / 5
    left = [(x, y - 2 * cut), (x - cut, y), (cut - x, y), (-x, y - cut)]
    outline = np.array([*left, *((a, -b) for a, b in reversed(left))])
    fan = np.array([(0, k, k + 1) for k in range(1, len(outline) - 1)])
    clearance = 0.0625
    body = creation.extrude_triangulation(outline, fan, height - clearance)
    body.apply_translation((0, 0, clearance))
    turn = rotation_matrix(np.pi / 2, (1, 0, 0))
    wheels = [
        creation.cylinder(0.09375, 0.06, sections=SECTIONS, transform=turn).apply_translation(at)
        for at in ((sx * x * 0.55, sy * (y - 0.04), 0.09375) for sx in (-1, 1) for sy in (-1, 1))
    ]
    return _mesh(body, *wheels)


@cache
def conveyor(length: float, width: float, height: float) -> Mesh:
    """Roller conveyor along x, from the floor at z = 0 to the top of its rollers."""
    radius = 0.045
    turn = rotation_matrix(np.pi / 2, (1, 0, 0))
    rollers = [
        creation.cylinder(radius, width - 0.1, sections=10, transform=turn).apply_translation(
            (x, 0, height - radius)
        )
        for x in np.linspace(-length / 2 + 0.08, length / 2 - 0.08, int(length / 0.16))
    ]
    rails = [
        _block((length, 0.05, 0.14), (0, s * (width - 0.05) / 2, height - 0.1)) for s in (-1, 1)
    ]
    legs = [
        _block((0.07, 0.05, height - 0.17), (x, s * (width - 0.05) / 2, (height - 0.17) / 2))
        for x in (-0.42 * length, 0.0, 0.42 * length)
        for s in (-1, 1)
    ]
    return _mesh(*rollers, *rails, *legs)


@cache
def jug() -> Mesh:
    """Jug 0.5 m tall about z = 0 with a wall, a floor and a handle."""
    outer = [(0, -0.25), (0.15, -0.25), (0.2, -0.1), (0.18, 0.08), (0.13, 0.17), (0.15, 0.25)]
    inner = [(0.13, 0.25), (0.11, 0.17), (0.16, 0.07), (0.18, -0.1), (0.13, -0.22), (0, -0.22)]
    body = creation.revolve(np.array(outer + inner), sections=SECTIONS)
    handle = creation.torus(0.11, 0.022, major_sections=SECTIONS, minor_sections=8)
    handle.apply_transform(rotation_matrix(np.pi / 2, (1, 0, 0))).apply_translation((0.22, 0, 0.03))
    return _mesh(body, handle)


@cache
def bottle() -> Mesh:
    """Gas bottle 1.2 m tall, its foot at z = 0."""
    shape = [
        (0, 0),
        (0.14, 0),
        (0.15, 0.02),
        (0.15, 0.85),
        (0.12, 0.97),
        (0.05, 1.03),
        (0.05, 1.06),
    ]
    valve = [(0.08, 1.07), (0.08, 1.19), (0.05, 1.2), (0, 1.2)]
    return _mesh(_flats(creation.revolve(np.array(shape + valve), sections=SECTIONS)))


@cache
def tyre() -> Mesh:
    """Tyre of 0.8 m, lying about z = 0."""
    return _mesh(_flats(creation.torus(0.29, 0.11, major_sections=SECTIONS, minor_sections=12)))


@cache
def reel() -> Mesh:
    """Cable reel standing on its edge about z = 0, axis along y: two flanges and a hollow hub."""
    flange = [creation.annulus(0.06, 0.32, 0.05, sections=SECTIONS) for _ in range(2)]
    for body, z in zip(flange, (-0.2, 0.2), strict=True):
        body.apply_translation((0, 0, z))
    hub = creation.annulus(0.06, 0.22, 0.4, sections=SECTIONS)
    body = _flats(trimesh.util.concatenate([*flange, hub]))
    return _mesh(body.apply_transform(rotation_matrix(np.pi / 2, (1, 0, 0))))


@cache
def capsule(radius: float, length: float) -> Mesh:
    """Tank along x about the origin; ``length`` is that of its cylinder."""
    body = creation.capsule(height=length, radius=radius, count=(SECTIONS, SECTIONS))
    _flats(body).apply_translation(-body.bounds.mean(axis=0))
    return _mesh(body.apply_transform(rotation_matrix(np.pi / 2, (0, 1, 0))))


@cache
def traffic_cone() -> Mesh:
    """Traffic cone 0.6 m tall, its foot plate at z = 0."""
    cone = creation.cone(0.17, 0.57, sections=SECTIONS).apply_translation((0, 0, 0.03))
    return _mesh(cone, _block((0.42, 0.42, 0.03), (0, 0, 0.015)))


@cache
def drone() -> Mesh:
    """Quadrotor of 0.8 m about the origin: body, arms, guard rings."""
    body = creation.icosphere(subdivisions=2).apply_scale((0.16, 0.12, 0.07))
    arms = [
        creation.box(extents=(0.62, 0.03, 0.02), transform=rotation_matrix(angle, (0, 0, 1)))
        for angle in (np.pi / 4, -np.pi / 4)
    ]
    rings = [
        creation.annulus(0.145, 0.17, 0.05, sections=SECTIONS).apply_translation((x, y, 0.02))
        for x in (-0.22, 0.22)
        for y in (-0.22, 0.22)
    ]
    return _mesh(body, *arms, *rings)


def rock(random: np.random.Generator, size: float) -> Mesh:
    """Boulder about the origin: an icosphere of ``size`` metres, dented by seeded waves."""
    body = creation.icosphere(subdivisions=3)
    directions = random.normal(size=(7, 3))
    waves = np.sin(body.vertices @ directions.T * 1.3 + random.uniform(0, 6.28, 7)).sum(axis=1)
    stretch = np.array((0.5, 0.42, 0.33)) * size
    return Mesh(body.vertices * (1.0 + 0.055 * waves[:, None]) * stretch, body.faces)

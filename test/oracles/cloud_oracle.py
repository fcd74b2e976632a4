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

"""Signed distances of points from shapes, by formulas, in the precision of the points.

Below zero inside. They share nothing with the package but the parameters of shapes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

import obb_collision as oc

Array = np.ndarray[Any, Any]
#: Signed distances (n,) of points (n, 3) in the frame of a shape.
Distance = Callable[[Array], Array]


class Solid(NamedTuple):
    """A shape with its distances at each level; convex: whether its depths are least ones."""

    shape: oc.shapes.Shape
    distances: dict[str, Distance]
    convex: bool


def box_distance(half: Array, center: Array | float = 0.0) -> Distance:
    """Return the distance from a box."""

    def distance(points: Array) -> Array:
        excess = np.abs(points - center) - half
        outside = np.sqrt((np.maximum(excess, 0.0) ** 2).sum(axis=1))
        return np.where(outside > 0.0, outside, excess.max(axis=1))

    return distance


def capsule_distance(radius: float, length: float) -> Distance:
    """Return the distance from a capsule along z, without length a sphere."""

    def distance(points: Array) -> Array:
        z = points[:, 2] - np.clip(points[:, 2], -length / 2, length / 2)
        return np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2 + z**2) - radius

    return distance


def cylinder_distance(radius: float, length: float) -> Distance:
    """Return the distance from a cylinder along z."""
    profile = box_distance(np.array([radius, length / 2]))
    return lambda points: profile(
        np.stack([np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2), points[:, 2]], 1)
    )


def solid_distance(corners: Array, faces: Array, parts: list[Array]) -> Distance:
    """Return the distance from a closed surface; parts: corners of convex parts of the inside."""
    triangles = corners[faces]
    planes = [ConvexHull(part).equations for part in parts]

    def distance(points: Array) -> Array:
        inside = np.zeros(len(points), np.bool_)
        for part in planes:
            inside |= (points @ part[:, :3].T + part[:, 3] <= 0.0).all(axis=1)
        surface = triangle_distances(triangles, points)
        return np.where(inside, -surface, surface)

    return distance


def triangle_distances(triangles: Array, points: Array) -> Array:
    """Return the distances (n,) from the nearest of triangles (t, 3, 3): of a plane or an edge."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normals = np.cross(b - a, c - a)
    ways = points[:, None] - a
    height = np.abs((ways * normals).sum(-1)) / np.sqrt((normals**2).sum(-1))
    within, best = np.ones(height.shape, np.bool_), np.full(height.shape, np.inf, points.dtype)
    for p, q in ((a, b), (b, c), (c, a)):
        edge, off = q - p, points[:, None] - p
        within &= (off * np.cross(normals, edge)).sum(-1) >= 0.0
        share = np.clip((off * edge).sum(-1) / (edge**2).sum(-1), 0.0, 1.0)
        best = np.minimum(best, np.sqrt(((off - share[..., None] * edge) ** 2).sum(-1)))
    return np.where(within, height, best).min(axis=1)


def _outward(corners: Array) -> Array:
    """Return the faces of a hull, outwards."""
    hull = ConvexHull(corners)
    faces = hull.simplices.copy()
    normals = np.cross(*(corners[faces[:, k]] - corners[faces[:, 0]] for k in (1, 2)))
    turned = (normals * hull.equations[:, :3]).sum(axis=1) < 0.0
    faces[turned] = faces[turned][:, ::-1]
    return faces


def _angle_iron() -> tuple[Array, Array, list[Array]]:
    """Return corners, faces and convex parts of an L, 0.6 by 0.5 by 0.3 m."""
    outline = np.array([[0, 0], [0.6, 0], [0.6, 0.2], [0.2, 0.2], [0.2, 0.5], [0, 0.5]])
    corners = np.vstack([np.column_stack([outline, np.full(6, z)]) for z in (0.0, 0.3)])
    caps = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    sides = [[[k, j, j + 6], [k, j + 6, k + 6]] for k, j in ((k, (k + 1) % 6) for k in range(6))]
    faces = np.vstack([caps[:, ::-1], caps + 6, np.reshape(sides, (-1, 3))])
    parts = [corners[[0, 1, 2, 3, 6, 7, 8, 9]], corners[[0, 3, 4, 5, 6, 9, 10, 11]]]
    parts[0][[3, 7], 0] = 0.0  # as far as the first leg goes
    return corners, faces, parts


def _solids() -> dict[str, Solid]:
    tip = np.array([[0.0, 0, 0], [0.5, 0, 0], [0, 0.4, 0], [0, 0, 0.3]])
    iron, faces, parts = _angle_iron()
    exact: dict[str, tuple[oc.shapes.Shape, Distance]] = {
        "box": (oc.shapes.Box([0.5, 0.3, 0.2]), box_distance(np.array([0.25, 0.15, 0.1]))),
        "sphere": (oc.shapes.Sphere(0.2), capsule_distance(0.2, 0.0)),
        "capsule": (oc.shapes.Capsule(0.1, 0.4), capsule_distance(0.1, 0.4)),
        "cylinder": (oc.shapes.Cylinder(0.15, 0.5), cylinder_distance(0.15, 0.5)),
        "mesh": (oc.shapes.Mesh(tip, _outward(tip)), solid_distance(tip, _outward(tip), [tip])),
    }
    solids = {
        name: Solid(shape, {"hull": distance, "mesh": distance}, convex=True)
        for name, (shape, distance) in exact.items()
    }
    levels = {
        "hull": solid_distance(iron, _outward(iron), [iron]),
        "mesh": solid_distance(iron, faces, parts),
    }
    solids["iron"] = Solid(oc.shapes.Mesh(iron, faces), levels, convex=False)
    for solid in solids.values():
        center, rotation, half = solid.shape.local_box
        own = box_distance(half)
        solid.distances["obb"] = lambda p, c=center, r=rotation, d=own: d((p - c) @ r)  # type: ignore[misc]
    return solids


SOLIDS = _solids()


def placed(points: Array, pose: Array, inverse: bool = False) -> Array:
    """Return points (n, 3) of a frame at a pose (7,) in the world, or the other way."""
    (x, y, z, w), at = pose[3:] / np.sqrt((pose[3:] ** 2).sum()), pose[:3]
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    moved = points - at if inverse else points
    return np.asarray((moved[:, None] * (turn.T if inverse else turn)).sum(-1) + (not inverse) * at)

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

"""Sample data for steps: boxes, shapes of every kind, a mesh, clouds, an arm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import obb_collision as oc
from obb_collision import shapes
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.queries.convex.support import BOX_CORE, ConvexBodies

FEW_OBJECTS, OBJECTS = 8, 256
"""Numbers of objects: few, for which there is a separate kernel, and enough for a tree."""
TETRAHEDRON = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
TETRAHEDRON_FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
TURNED = (0.0, 0.0, 0.0, 0.0, 0.0, 0.6, 0.8)


def row_of_boxes(count: int = OBJECTS) -> oc.Scene:
    """Return a scene of turned boxes in a row, each of which collides with the next."""
    scene = oc.Scene()
    poses = [(0.75 * number, 0, 0, 0, 0, 0.6, 0.8) for number in range(count)]
    scene.add_boxes([str(number) for number in range(count)], np.ones((count, 3)), poses)
    return scene


def batch() -> oc.Boxes:
    """Return four turned boxes in a row."""
    poses = np.tile((0.0, 0.0, 0.0, 0.0, 0.0, 0.6, 0.8), (4, 1))
    poses[:, 0] = 0.75 * np.arange(4)
    return oc.Boxes.from_poses(poses, np.full((4, 3), 0.5))


def zoo() -> dict[str, tuple[shapes.Shape, ...]]:
    """Return shapes of every kind that levels distinguish, without fitting boxes to them."""
    box, points = (np.full(3, 0.5), np.eye(3), np.full(3, 0.5)), np.array(TETRAHEDRON)
    faces, scale = np.array(TETRAHEDRON_FACES), np.ones(3)
    return {
        "box": (shapes.Box((0.5, 0.5, 0.5)), shapes.Box((0.5, 0.4, 0.3))),
        "round": (shapes.Sphere(0.3), shapes.Capsule(0.2, 0.4)),
        "convex": (
            *(shapes.Ellipsoid((0.3, 0.2, 0.1)), shapes.Cylinder(0.2, 0.4), shapes.Cone(0.2, 0.4)),
            shapes.Hull.fitted(points, box),
        ),
        "mesh": tuple(shapes.Mesh.fitted(points, faces, scale, box) for _ in range(2)),
    }


def convex_bodies() -> ConvexBodies:
    """Return one convex body, without building a hull."""
    radii, centers = np.ones(1), np.zeros((1, 3))
    hulls, row = Hulls.of(np.array(TETRAHEDRON)), np.zeros(1, np.int64)
    kinds, sizes = np.full(1, BOX_CORE, np.int8), np.ones((1, 4))
    return ConvexBodies(kinds, sizes, radii, hulls, row, centers, np.eye(3)[None])


def triangle_tree() -> oc.MeshTrees:
    """Return the tree of one triangle, without building it."""
    row, zero = np.array([*(0.0,) * 3, *np.eye(3).ravel(), *(1.0,) * 3, 3.0]), np.zeros(1, np.int64)
    return oc.MeshTrees.trusted(
        triangles=np.arange(9.0)[None],
        nodes=row[None],
        children=zero - 1,
        starts=np.array([[0, 1]]),
        radii=np.array([20.0]),
        pieces=np.zeros((1, 6, 3)),
        piece_starts=np.array([0, 1]),
        **dict.fromkeys(("faces", "levels", "roots"), zero),
        **dict.fromkeys(("counted", "solid", "winding"), zero == 0),
    )


def clouds() -> list[NDArray[np.floating]]:
    """Return points of both floating point types, contiguous and not."""
    return [np.zeros((4, size), kind)[:, :3] for size in (3, 4) for kind in ("f4", "f8")]


_BODY = """<collision><geometry><cylinder radius="0.05" length="0.2"/></geometry></collision>
<collision><geometry><sphere radius="0.1"/></geometry></collision>
<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>"""
_LINKS = "".join(f'<link name="{name}">{_BODY}</link>' for name in "abcd")
_JOINTS = "".join(
    f'<joint name="{a}{b}" type="revolute"><parent link="{a}"/><child link="{b}"/>'
    '<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><limit lower="-2" upper="2"/></joint>'
    for a, b in ("ab", "bc", "cd")
)
ARM = f'<robot name="arm">{_LINKS}{_JOINTS}</robot>'
"""An arm whose links are cylinders, spheres and boxes."""

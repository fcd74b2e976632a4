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


"""Shapes as triangles to draw: within their boxes, and outwards all around."""

import numpy as np
import pytest

import obb_collision as oc
from obb_collision.demo.snapshot import triangles_of

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3], [0.5, 0.5, 0.5]])


@pytest.mark.parametrize(
    "shape",
    [
        oc.shapes.Box((1.0, 2.0, 3.0), (2, 1, 1)),
        oc.shapes.Sphere(0.5),
        oc.shapes.Ellipsoid((0.5, 1.0, 0.25)),
        oc.shapes.Cylinder(0.5, 2.0),
        oc.shapes.Cone(0.5, 2.0, (1, 2, 1)),
        oc.shapes.Capsule(0.25, 1.0),
        oc.shapes.Hull(POINTS, (1, 1, 2)),
        oc.shapes.Hull(POINTS[:3]),
        oc.shapes.Hull(POINTS[:1]),
    ],
    ids=lambda shape: type(shape).__name__,
)
def test_triangles_fill_the_box(shape: oc.shapes.Shape) -> None:
    vertices, faces, scale, closed = triangles_of(shape)
    corners = (vertices * scale)[faces]
    center, rotation, half_extents = shape.local_box
    local = (corners.reshape(-1, 3) - center) @ rotation
    assert (np.abs(local) <= half_extents + 1e-9).all()
    assert (np.abs(local).max(axis=0) >= 0.97 * half_extents - 1e-9).all()
    if closed:
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        out = np.einsum("nk,nk->n", normals, corners.mean(axis=1) - center)
        assert (out > 0.0).all()

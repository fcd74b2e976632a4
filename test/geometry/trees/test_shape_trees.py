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

"""Trees of hulls hold all points of their shape, with a margin, and are closed."""

from __future__ import annotations

import numpy as np
import pytest
from mesh_zoo import zoo
from numpy.typing import ArrayLike
from plane_depths import least_depth

from obb_collision.geometry.fitting.convex_hull import hull_volume
from obb_collision.geometry.shapes.meshes import Hull, Mesh
from obb_collision.geometry.trees.convex_proxy import HULL_MARGIN, MAX_HULL_CORNERS, box_corners
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.geometry.trees.pool import box_tree, hull_tree, mesh_tree

ZOO = zoo()


def least_distance(tree: MeshTrees, points: ArrayLike) -> float:
    """Return how far inside the planes of all faces the points lie, relative to their size."""
    return least_depth(tree.triangles.reshape(-1, 3, 3), points) / float(np.abs(points).max())


@pytest.mark.parametrize("size", [1e-150, 1.0, 1e150])
def test_hulls_hold_their_meshes_with_a_margin_and_no_more(size: float) -> None:
    for name, (vertices, faces) in ZOO.items():
        mesh = Mesh(vertices * size, faces, scale=[0.5, 1.0, 2.0])
        points = mesh.vertices[np.unique(faces)] * [0.5, 1.0, 2.0]
        tree = hull_tree(mesh)
        assert tree.solid[0], name
        assert tree.winding[0], name
        assert least_distance(tree, points) > 0.99 * HULL_MARGIN, name
        loose = 1.03 if len(np.unique(points, axis=0)) > MAX_HULL_CORNERS else 1.0 + 1e-8
        assert np.abs(tree.triangles).max() < loose * np.abs(points).max(), name


@pytest.mark.parametrize(
    "points",
    [
        [[1.0, 2.0, 3.0]],
        [[0.0, 0, 0], [1, 2, 3]],
        [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]],
        [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1e-12]],
    ],
)
def test_flat_shapes_get_a_solid(points: list[list[float]]) -> None:
    tree = hull_tree(Hull(points))
    assert tree.solid[0]
    assert len(tree.faces) <= 12
    largest = np.abs(points).max()
    for first in range(3):  # whichever corner a face begins with
        corners = np.roll(tree.triangles.reshape(-1, 3, 3), first, axis=1)
        assert least_depth(corners, points) > 0.99 * HULL_MARGIN * largest


def test_repeated_corners_and_corners_amid_edges_still_get_a_hull() -> None:
    # As files of single triangles have them; flat faces with fine rims give Qhull's facets of
    # no area, above all where it joggles: from a thousand corners on.
    rng = np.random.default_rng(2)
    wedge = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0.7], [1, 0, 0.7], [0, 1, 0.7]])
    edges = np.array([[0, 1], [1, 2], [2, 0], [3, 4], [4, 5], [5, 3], [0, 3], [1, 4], [2, 5]])
    shares = rng.random((9, 300, 1))
    rims = wedge[edges[:, :1]] * shares + wedge[edges[:, 1:]] * (1.0 - shares)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for points in (np.repeat(rims.reshape(-1, 3), 3, axis=0) @ turn, ZOO["bumpy2"][0].repeat(6, 0)):
        points = points.astype(np.float32).astype(np.float64)
        tree = hull_tree(Hull(points))
        assert least_distance(tree, points) > 0.99 * HULL_MARGIN
        corners = tree.triangles.reshape(-1, 3, 3)
        volume = np.linalg.det(corners - corners.mean(axis=(0, 1))).sum() / 6.0
        assert volume == pytest.approx(hull_volume(np.unique(points, axis=0)), rel=1e-3)


def test_scales_and_boxes() -> None:
    vertices, faces = ZOO["torus1"]
    tree = mesh_tree(Mesh(vertices, faces, scale=[1.0, 2.0, 3.0]))
    assert np.abs(tree.triangles).max() == np.abs(vertices * [1.0, 2.0, 3.0]).max()
    half_extents = np.array([1.0, 0.0, 2.0])
    assert np.abs(box_tree(half_extents).triangles).max() == 2.0
    assert np.abs(box_corners(half_extents)).max() - 2.0 == 2.0 * HULL_MARGIN
    with pytest.raises(ValueError, match="faces must not be empty"):
        mesh_tree(Mesh(vertices, []))

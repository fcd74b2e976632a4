"""Trees of hulls hold all points of their shape, with a margin, and are closed."""

from __future__ import annotations

import numpy as np
import pytest
from mesh_zoo import zoo
from numpy.typing import ArrayLike

from obb_collision.geometry.mesh_tree import MeshTrees
from obb_collision.geometry.meshes import Hull, Mesh
from obb_collision.geometry.shape_trees import HULL_MARGIN, box_tree, hull_tree, mesh_tree

ZOO = zoo()


def least_distance(tree: MeshTrees, points: ArrayLike) -> float:
    """Return how far inside the planes of all faces the points lie, relative to their size."""
    largest = np.abs(points).max()
    corners = tree.triangles.reshape(-1, 3, 3) / largest
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    offsets = np.einsum("ij,ij->i", normals, corners[:, 0])
    return float((offsets[:, None] - normals @ (np.asarray(points) / largest).T).min())


@pytest.mark.parametrize("size", [1e-150, 1.0, 1e150])
def test_hulls_hold_their_meshes_with_a_margin_and_no_more(size: float) -> None:
    for name, (vertices, faces) in ZOO.items():
        mesh = Mesh(vertices * size, faces, scale=[0.5, 1.0, 2.0])
        points = mesh.vertices[np.unique(faces)] * [0.5, 1.0, 2.0]
        tree = hull_tree(mesh)
        assert tree.solid[0], name
        assert tree.winding[0], name
        assert least_distance(tree, points) > 0.99 * HULL_MARGIN, name
        if name != "triangle":  # which gets its box
            assert np.abs(tree.triangles).max() < (1.0 + 1e-8) * np.abs(points).max(), name


@pytest.mark.parametrize(
    "points",
    [
        [[1.0, 2.0, 3.0]],
        [[0.0, 0, 0], [1, 2, 3]],
        [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]],
        [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1e-12]],
    ],
)
def test_flat_shapes_get_a_box(points: list[list[float]]) -> None:
    tree = hull_tree(Hull(points))
    assert tree.solid[0]
    assert len(tree.faces) == 12
    assert least_distance(tree, points) > 0.99 * HULL_MARGIN


def test_scales_and_boxes() -> None:
    vertices, faces = ZOO["torus1"]
    tree = mesh_tree(Mesh(vertices, faces, scale=[1.0, 2.0, 3.0]))
    assert np.abs(tree.triangles).max() == np.abs(vertices * [1.0, 2.0, 3.0]).max()
    half_extents = np.array([1.0, 0.0, 2.0])
    assert np.abs(box_tree(half_extents).triangles).max() == 2.0
    assert (np.abs(box_tree(half_extents, hull=True).triangles).max() - 2.0) == 2.0 * HULL_MARGIN
    with pytest.raises(ValueError, match="at least one triangle"):
        mesh_tree(Mesh(vertices, []))

"""Trees of shapes: of their triangles, or of a convex mesh about them."""

from __future__ import annotations

import numpy as np

from obb_collision.geometry.hull_mesh import hull_mesh
from obb_collision.geometry.mesh_tree import MeshTrees
from obb_collision.geometry.meshes import Mesh
from obb_collision.geometry.shapes import Shape
from obb_collision.geometry.validation import Floats


def mesh_tree(mesh: Mesh) -> MeshTrees:
    """Return the tree of a mesh's triangles, scaled; its first node has the mesh's local box.

    ValueError for a mesh without faces.
    """
    vertices = mesh.vertices * np.array(mesh.scale)
    return MeshTrees.build(vertices, mesh.faces, root=mesh.local_box if len(mesh.faces) else None)


def box_tree(half_extents: Floats) -> MeshTrees:
    """Return the tree of a box (3,) about the origin."""
    return MeshTrees.from_half_extents(half_extents)


def hull_tree(shape: Shape) -> MeshTrees:
    """Return the tree of a convex mesh that certainly holds a shape (see ``hull_mesh``)."""
    return MeshTrees.build(*hull_mesh(shape))

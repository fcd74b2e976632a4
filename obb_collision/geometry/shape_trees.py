"""Trees of shapes made of points: of their triangles, or of their convex hull."""

from __future__ import annotations

import numpy as np

from obb_collision.geometry.hulls import convex_hull
from obb_collision.geometry.mesh_topology import Integers
from obb_collision.geometry.mesh_tree import BOX_CORNERS, BOX_FACES, MeshTrees
from obb_collision.geometry.meshes import Hull, Mesh
from obb_collision.geometry.validation import Floats

#: Hulls are larger than their points by this, relative to the largest coordinate: more than Qhull
#: rounds by, and more than two meshes may be apart that are not told from touching.
HULL_MARGIN = 2.0**-36
#: What would have to grow by more to get that margin is too thin: its box takes its place.
LARGEST_GROWTH = 2.0**-10
#: A facet less high than this times its longest side may have a corner too many, on that side.
SLIVER = 2.0**-20
#: Rounds of leaving out such corners; real meshes needed three at most.
ROUNDS = 8
#: Largest number of faces times points of a hull: some 2 s. Larger ones get their box.
LARGEST_WORK = 2_000_000_000
#: Products held at once while the farthest points are sought: 32 MB.
BLOCK = 1 << 22


def mesh_tree(mesh: Mesh) -> MeshTrees:
    """Return the tree of a mesh's triangles, scaled. ValueError for a mesh without faces."""
    return MeshTrees.build(mesh.vertices * np.array(mesh.scale), mesh.faces)


def box_tree(half_extents: Floats, hull: bool = False) -> MeshTrees:
    """Return the tree of a box (3,) about the origin; ``hull``: with the margin of a hull."""
    grown = half_extents + (HULL_MARGIN * half_extents.max() if hull else 0.0)
    return MeshTrees.from_half_extents(grown)


def hull_tree(shape: Mesh | Hull) -> MeshTrees:
    """Return the tree of a closed mesh that certainly holds the convex hull of a shape.

    The hull itself, larger by HULL_MARGIN; for a shape so flat that Qhull or that margin fails,
    and for hulls of tens of thousands of faces, its local box.
    """
    # Each corner once: files of single triangles repeat them, and Qhull makes facets of copies.
    points = np.unique(shape._points() * np.array(shape.scale), axis=0)
    largest = float(np.abs(points).max())
    margin = HULL_MARGIN * largest
    # By a power of two, exactly, so that products neither overflow nor vanish.
    power = int(np.frexp(largest)[1])
    grown = _grown_hull(np.ldexp(points, -power), float(np.ldexp(margin, -power)))
    if grown is not None:
        tree = MeshTrees.build(np.ldexp(grown[0], power), grown[1])
        if tree.solid[0] and tree.winding[0]:
            return tree
    center, rotation, half_extents = shape.local_box
    corners = center + (BOX_CORNERS * (half_extents + margin)) @ rotation.T
    return MeshTrees.build(corners, BOX_FACES)


def _grown_hull(points: Floats, margin: float) -> tuple[Floats, Integers] | None:
    """Return vertices and outward faces of a hull that holds the points with a margin; or None.

    Facets of no height, which flat faces with many corners get, have any normal at all; where
    they forbid it, their needless corners are left out. Growing covers those like all others.
    """
    corners = points
    for _ in range(ROUNDS):
        hull = convex_hull(corners)
        if hull is None or len(hull.simplices) * len(points) > LARGEST_WORK:
            return None
        used, faces = np.unique(hull.simplices, return_inverse=True)
        faces = faces.reshape(-1, 3).astype(np.int64)
        corners = corners[used]
        grown = _grown(corners, faces, points, margin)
        if grown is not None:
            return grown
        needless = _needless(corners[faces], faces)
        if len(needless) == 0:
            return None
        corners = np.delete(corners, needless, axis=0)
    return None


def _needless(corners: Floats, faces: Integers) -> Integers:
    """Return the vertices that lie about on the longest side of a face (m, 3, 3), opposite it."""
    sides = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]  # each opposite its corner
    lengths = np.linalg.norm(sides, axis=2)
    doubled = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    thin = doubled <= SLIVER * lengths.max(axis=1) ** 2
    return faces[thin, lengths[thin].argmax(axis=1)]


def _grown(
    vertices: Floats, faces: Integers, points: Floats, margin: float
) -> tuple[Floats, Integers] | None:
    """Return vertices and outward faces of the hull, stretched about an inner point; or None.

    The surface is star-shaped about that point if all faces have it on their inner side. Then it
    holds all that is behind every face's plane; so each plane is moved past the farthest point.
    """
    middle = vertices.mean(axis=0)
    a, b, c = (vertices - middle)[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    if not (lengths > 0.0).all():
        return None
    normals /= lengths[:, None]
    offsets = np.einsum("ij,ij->i", normals, a)
    inward = offsets < 0.0
    faces[inward] = faces[inward][:, ::-1]
    normals[inward] *= -1.0
    reach = _farthest(points - middle, normals)
    offsets = np.abs(offsets)
    if not (offsets > 0.0).all():
        return None
    growth = float(((reach - offsets + 2.0 * margin) / offsets).max())
    if not growth <= LARGEST_GROWTH:
        return None
    return middle + (vertices - middle) * (1.0 + growth), faces


def _farthest(points: Floats, normals: Floats) -> Floats:
    """Return (m,) how far points (n, 3) reach along each normal (m, 3)."""
    step = max(1, BLOCK // len(points))
    parts = [(normals[k : k + step] @ points.T).max(axis=1) for k in range(0, len(normals), step)]
    result: Floats = np.concatenate(parts)
    return result

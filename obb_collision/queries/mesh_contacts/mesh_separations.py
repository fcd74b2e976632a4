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

"""Signed separations of meshes: the distance of those that are apart, the depth of the others."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._threads import run
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.numerics.lanes import in_blocks
from obb_collision.queries.convex.distances import convex_distances
from obb_collision.queries.convex.support import CORNERS, ConvexBodies
from obb_collision.queries.mesh_contacts.depths import depth_kernel
from obb_collision.queries.meshes.mesh_clearance import as_radii, clearances_of
from obb_collision.queries.meshes.meshes import PlacedMeshes, mesh_rows
from obb_collision.queries.verdict.separations import Separations
from obb_collision.typing import Floats, Integers

#: Pairs below which a second thread does not pay: 1 ms.
FEWEST_PAIRS = 4


def mesh_separations(
    a: PlacedMeshes,
    b: PlacedMeshes,
    pairs: ArrayLike | None = None,
    *,
    radii_a: ArrayLike = 0.0,
    radii_b: ArrayLike = 0.0,
) -> Separations:
    """Return how far apart meshes are, or how deep they overlap, along which direction.

    Of meshes that are apart that is the distance of ``mesh_clearances``. Of others it is minus a
    depth: moving b along the normal by the depth certainly parts them. No push along the normal of
    their hulls is shorter, nor is the depth of their hulls but by 1e-9 of the size of the pair. For
    convex meshes it is the least of all; for others a shorter one may exist along a direction that
    was not tried.

    Parameters
    ----------
    a, b : PlacedMeshes
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.
    radii_a, radii_b : float or (n,) array_like
        Metres; a body is everything within its radius of its mesh.

    Returns
    -------
    Separations
        pairs (m, 2); separations (m,) metres, negative where they overlap; normals (m, 3) unit,
        from a to b; positions (m, 3) metres, between the closest points, or those that touch last.

    Raises
    ------
    ValueError
        For pairs that are no rows, and without pairs for different lengths; for a negative radius.
    TypeError
        For anything but placed meshes.

    References
    ----------
    Je, Tang, Lee, Lin, Kim, PolyDepth: real-time penetration depth computation (2012).

    Examples
    --------
    >>> tree = oc.MeshTrees.from_half_extents([1, 1, 1])
    >>> poses = [[0, 0, 0, 0, 0, 0, 1], [0, 0.1, 1.75, 0, 0, 0, 1]]
    >>> bodies = oc.PlacedMeshes.from_poses(tree, [0, 0], poses)
    >>> found = oc.mesh_separations(bodies, bodies, [[0, 1]])
    >>> found.separations.round(6).tolist(), found.normals.round(6).tolist()
    ([-0.25], [[0.0, 0.0, 1.0]])
    """
    i, j = mesh_rows(a, b, pairs)
    first, second = as_radii(radii_a, "radii_a", len(a)), as_radii(radii_b, "radii_b", len(b))
    convex_a, convex_b = hulls_of(a, i, first), hulls_of(b, j, second)
    found, _ = convex_distances(convex_a, convex_b, i, j)
    middles = 0.5 * (found.positions_a + found.positions_b)
    outer = Separations(np.stack([i, j], axis=1), found.lower, found.normals, middles)
    return within(outer, a, first, b, second)


def within(
    outer: Separations, a: PlacedMeshes, radii_a: Floats, b: PlacedMeshes, radii_b: Floats
) -> Separations:
    """Return the separations of meshes, given those (m,) of convex bodies that contain them.

    outer.pairs: rows of a and of b. The arrays given are written to.
    """
    i, j = np.ascontiguousarray(outer.pairs.T)
    values, normals, positions = outer.separations, outer.normals, outer.positions
    near, _ = clearances_of(a, radii_a, b, radii_b, i, j, np.inf)
    apart = near.upper > 0.0
    farther = apart & ~(values > near.distances)
    values[farther], normals[farther] = near.distances[farther], near.normals[farther]
    positions[farther] = 0.5 * (near.positions_a + near.positions_b)[farther]
    deep = np.flatnonzero(~apart & (values <= 0.0))
    depths, n, middles = np.maximum(-values[deep], 0.0), normals[deep], positions[deep]
    run(
        *(depth_kernel, len(deep), FEWEST_PAIRS),
        *(a.arrays, i[deep], radii_a, b.arrays, j[deep], radii_b, depths, n, middles),
    )
    values[deep], normals[deep], positions[deep] = -depths, n, middles
    return outer


def hulls_of(bodies: PlacedMeshes, rows: Integers, radii: Floats) -> ConvexBodies:
    """Return the convex bodies about meshes, with radii; only those of rows are there."""
    trees = bodies.trees
    used, where = np.unique(bodies.meshes[rows], return_inverse=True)
    blocks = [np.zeros((1, 3, 8))]
    for mesh in used.tolist():
        first, last = trees.starts[trees.roots[mesh]]
        blocks.append(in_blocks(np.unique(trees.triangles[first:last].reshape(-1, 3), axis=0)))
    starts = np.cumsum([0, *map(len, blocks)])
    reach = [np.abs(block).sum(axis=1).max() for block in blocks]
    own = np.zeros(len(bodies), np.int64)
    own[rows] = where.ravel() + 1
    kinds, sizes = np.full(len(bodies), CORNERS, np.int8), np.zeros((len(bodies), 4))
    hulls = Hulls(np.concatenate(blocks), starts, np.array(reach))
    return ConvexBodies(kinds, sizes, radii, hulls, own, bodies.centers, bodies.rotations)

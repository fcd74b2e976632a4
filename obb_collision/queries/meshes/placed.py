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

"""Placed meshes with their trees, as kernels see them, and boxes of trees in other frames.

Separating axis test of two nodes of mesh trees, in the frame of the first mesh.

The offset and rotation between the meshes are computed once per pair of poses (``relative_pose``),
with one bound on all errors, so that a node test is little more than the products it needs.

Error analysis, u = 2^-53, S = abs(offset) + the reach of both meshes: a stored rotation R has
abs(R^T R - I) <= 64 u, so taking R_a^T for the inverse of R_a moves a point by at most 64 u S, and
the products of poses add 12 u S. A node's axes are orthonormal to 16 u, those of b in the frame of
a to 160 u. A gap of the test is then off by at most 1200 u S (the terms of the analysis in
``verdict`` with these figures), and by 400 u S more where a is moved to the frame of b by the
transposed pose; ``BOX_BOUND`` is 4096 u.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.trees.build import HALF
from obb_collision.geometry.trees.obb_tree import MeshTrees, TreeArrays
from obb_collision.geometry.validation import as_array, as_rotations, as_rows, check_lengths
from obb_collision.geometry.values import ForKernels
from obb_collision.numerics.constants import MESH_UNDERFLOW, ROUNDOFF
from obb_collision.numerics.vec3 import (
    axes_of,
    combined,
    components,
    dot,
    max_of,
    minus,
    negated,
    plus,
    sum_abs,
    vector_at,
)
from obb_collision.queries.verdict.pair_rows import RowPairs
from obb_collision.queries.verdict.sat import (
    BoxPair,
    all_edge_axes,
    edge_gaps,
    face_gap,
    face_gaps_of_b,
    rows_of,
)
from obb_collision.typing import Axes, Floats, Integers, Vector

#: Bound on the error of a gap relative to S (derivation above).
BOX_BOUND = 4096 * ROUNDOFF
#: Bound on the error of a moved corner relative to S: 256 unit roundoffs (derivation above).
POINT_BOUND = 256 * ROUNDOFF


class Place(NamedTuple):
    """The pose of a body in the world frame."""

    center: Vector
    axes: Axes


class PairPose(NamedTuple):
    """Body b in the frame of body a, and bounds of the errors (derivations above)."""

    axes: Axes
    offset: Vector
    size: float  #: S
    gap_bound: float  #: of a gap of two nodes
    point_bound: float  #: of a component of a point moved


@njit
def place_at(centers: Floats, rotations: Floats, i: int) -> Place:
    """Return place i of arrays (n, 3), (n, 3, 3)."""
    return Place(vector_at(centers, i), axes_of(rotations, i))


@njit
def relative_pose(a: Place, b: Place, reach: float) -> PairPose:
    """Return the pose of b in the frame of a; reach: of both bodies."""
    d = minus(b.center, a.center)
    x, y, z = b.axes
    axes = components(a.axes, x), components(a.axes, y), components(a.axes, z)
    size = sum_abs(d) + reach
    gap_bound = BOX_BOUND * size + MESH_UNDERFLOW
    point_bound = POINT_BOUND * size + MESH_UNDERFLOW
    return PairPose(axes, components(a.axes, d), size, gap_bound, point_bound)


@njit
def moved(pose: PairPose, p: Vector) -> Vector:
    """Return a point of b in the frame of a."""
    return plus(combined(pose.axes, p), pose.offset)


@njit
def moved_back(pose: PairPose, p: Vector) -> Vector:
    """Return a point of a in the frame of b: by the transposed rotation, orthonormal to 160 u."""
    return components(pose.axes, minus(p, pose.offset))


@njit
def node_gap(nodes_a: Floats, i: int, nodes_b: Floats, j: int, pose: PairPose) -> float:
    """Return infinity where nodes i and j are certainly apart, else the largest face gap.

    nodes: rows (n, 16). Faces of a come first, one by one: most nodes are apart along these.
    """
    center, (a0, a1, a2), h = node_at(nodes_a, i)
    c, b, f = node_at(nodes_b, j)
    d = minus(moved(pose, c), center)
    u, p = components(b, components(pose.axes, a0)), dot(a0, d)
    gap = face_gap(p, h[0], f, u)
    if gap > pose.gap_bound:
        return np.inf
    v, q = components(b, components(pose.axes, a1)), dot(a1, d)
    gap = max(gap, face_gap(q, h[1], f, v))
    if gap > pose.gap_bound:
        return np.inf
    w, r = components(b, components(pose.axes, a2)), dot(a2, d)
    gap = max(gap, face_gap(r, h[2], f, w))
    if gap > pose.gap_bound:
        return np.inf
    pair = BoxPair((p, q, r), rows_of((u, v, w)), h, f)
    gap = max(gap, max_of(face_gaps_of_b(pair)))
    if gap > pose.gap_bound:
        return np.inf
    x, y, z = all_edge_axes(pair)
    edges = max(max_of(edge_gaps(x)), max_of(edge_gaps(y)), max_of(edge_gaps(z)))
    return np.inf if edges > pose.gap_bound else gap


class NodeBox(NamedTuple):
    """The box of a node, in the frame of its body or of another."""

    center: Vector
    axes: Axes
    half: Vector


@njit
def back_of(pose: PairPose) -> PairPose:
    """Return the pose of body a in the frame of body b, by the transposed rotation."""
    axes = rows_of(pose.axes)
    offset = negated(components(pose.axes, pose.offset))
    return PairPose(axes, offset, pose.size, pose.gap_bound, pose.point_bound)


@njit
def moved_node(pose: PairPose, nodes: Floats, i: int) -> NodeBox:
    """Return the box of node i of b in the frame of a."""
    center, (x, y, z), half = node_at(nodes, i)
    axes = combined(pose.axes, x), combined(pose.axes, y), combined(pose.axes, z)
    return NodeBox(moved(pose, center), axes, half)


@njit
def faces_gap(nodes: Floats, i: int, other: NodeBox, bound: float) -> float:
    """Return the largest gap of node i and a moved one along a face, infinity if certainly apart.

    Without the nine axes of edges: few nodes are apart only along these, and they take half of the
    time of ``node_gap``.
    """
    of_node, of_other = node_face_gaps(nodes, i, other)
    gap = max(max_of(of_node), max_of(of_other))
    return np.inf if gap > bound else gap


@njit(inline=True)
def node_face_gaps(nodes: Floats, i: int, other: NodeBox) -> tuple[Vector, Vector]:
    """Return the gaps of node i and a moved one along the faces of each."""
    center, a, h = node_at(nodes, i)
    b, f = other.axes, other.half
    d = minus(other.center, center)
    turned = components(b, a[0]), components(b, a[1]), components(b, a[2])
    return _face_gaps(components(a, d), h, f, turned), _face_gaps(
        components(b, d), f, h, rows_of(turned)
    )


@njit(inline=True)
def _face_gaps(d: Vector, own: Vector, extents: Vector, axes: Axes) -> Vector:
    return (
        face_gap(d[0], own[0], extents, axes[0]),
        face_gap(d[1], own[1], extents, axes[1]),
        face_gap(d[2], own[2], extents, axes[2]),
    )


@njit
def node_at(nodes: Floats, i: int) -> tuple[Vector, Axes, Vector]:
    """Return centre, axes and half extents of the box of a node."""
    x = nodes[i, 3], nodes[i, 6], nodes[i, 9]
    y = nodes[i, 4], nodes[i, 7], nodes[i, 10]
    z = nodes[i, 5], nodes[i, 8], nodes[i, 11]
    return vector_at(nodes, i), (x, y, z), (nodes[i, 12], nodes[i, 13], nodes[i, 14])


def root_boxes(bodies: PlacedMeshes) -> Boxes:
    """Return boxes (n,) that certainly contain placed meshes.

    Larger by ``BOX_BOUND`` of the reach of a mesh and of its centre. This is more than the errors
    of products of poses and of axes that are orthonormal to 80 u.
    """
    trees, meshes = bodies.trees, bodies.meshes
    nodes = trees.nodes[trees.roots[meshes]]
    axes = nodes[:, 3:HALF].reshape(-1, 3, 3)
    centers = bodies.centers + np.einsum("nij,nj->ni", bodies.rotations, nodes[:, :3])
    sizes = np.abs(bodies.centers).sum(axis=1) + trees.radii[meshes]
    half_extents = nodes[:, HALF : HALF + 3] + (BOX_BOUND * sizes + MESH_UNDERFLOW)[:, None]
    return Boxes.trusted(centers, bodies.rotations @ axes, half_extents)


@dataclass(frozen=True, eq=False)
class PlacedMeshes(ForKernels):
    """n bodies: body i is mesh ``meshes[i]`` of the trees at centers (n, 3), rotations (n, 3, 3).

    Metres; raises ValueError naming the argument and the row for anything else.

    Parameters
    ----------
    trees : MeshTrees
    meshes : (n,) array_like of int
        Rows of trees.
    centers : (n, 3) array_like
        Metres.
    rotations : (n, 3, 3) array_like
        Orthonormal.

    Examples
    --------
    >>> tree = oc.MeshTrees.build([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> len(oc.PlacedMeshes(tree, [0, 0], np.zeros((2, 3)), [np.eye(3)] * 2))
    2
    """

    trees: MeshTrees
    meshes: Integers
    centers: Floats
    rotations: Floats
    arrays: Meshes = field(init=False, repr=False)
    """All of it, for kernels."""

    def __init__(
        self, trees: MeshTrees, meshes: ArrayLike, centers: ArrayLike, rotations: ArrayLike
    ) -> None:
        if not isinstance(trees, MeshTrees):
            raise ValueError(f"trees must be MeshTrees, got {type(trees).__name__}")
        rows = as_rows(meshes, "meshes", len(trees))
        c = as_array(centers, "centers", (None, 3))
        r = as_rotations(rotations, "rotations", (None, 3, 3))
        check_lengths(meshes=rows, centers=c, rotations=r)
        self._store(trees, rows, c.copy(), r.copy())

    def _store(
        self, trees: MeshTrees, meshes: Integers, centers: Floats, rotations: Floats
    ) -> None:
        vars(self).update(trees=trees, arrays=Meshes(trees.arrays, meshes, centers, rotations))

    @classmethod
    def from_poses(cls, trees: MeshTrees, meshes: ArrayLike, poses: ArrayLike) -> PlacedMeshes:
        """Return bodies at poses (n, 7), x y z qx qy qz qw.

        Parameters
        ----------
        trees : MeshTrees
        meshes : (n,) array_like of int
            Rows of trees.
        poses : (n, 7) array_like
            x y z (metres) qx qy qz qw.

        Examples
        --------
        >>> tree = oc.MeshTrees.build([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        >>> len(oc.PlacedMeshes.from_poses(tree, [0], [[0, 0, 0, 0, 0, 0, 1]]))
        1
        """
        return cls(trees, meshes, *as_poses(poses))

    @classmethod
    def trusted(
        cls, trees: MeshTrees, meshes: Integers, centers: Floats, rotations: Floats
    ) -> PlacedMeshes:
        """Return bodies of arrays that are valid, unchecked and not copied."""
        bodies = object.__new__(cls)
        bodies._store(trees, meshes, centers, rotations)
        return bodies

    def __len__(self) -> int:
        return len(self.arrays.meshes)

    def place(self, row: int) -> tuple[Floats, Floats]:
        """Return centre (3,) and rotation (3, 3) of a body."""
        return self.arrays.centers[row], self.arrays.rotations[row]


class Meshes(NamedTuple):
    """Placed meshes, for kernels: body i is mesh ``meshes[i]``."""

    trees: TreeArrays
    meshes: np.ndarray
    centers: Floats
    rotations: Floats


class MeshAt(NamedTuple):
    """A placed mesh without its trees: arrays in here would be counted per pair."""

    mesh: int
    place: Place


class MeshPair(NamedTuple):
    """Two placed meshes with their trees, for kernels that count no references."""

    trees_a: TreeArrays
    a: MeshAt
    trees_b: TreeArrays
    b: MeshAt
    pose: PairPose  #: of b in the frame of a


@njit(refcount=False)
def body_at(bodies: Meshes, i: int) -> MeshAt:
    """Return body i."""
    return MeshAt(bodies.meshes[i], place_at(bodies.centers, bodies.rotations, i))


@njit(merge=True)
def mesh_pair(trees_a: TreeArrays, a: MeshAt, trees_b: TreeArrays, b: MeshAt) -> MeshPair:
    """Return two bodies and their pose."""
    pose = relative_pose(a.place, b.place, trees_a.radii[a.mesh] + trees_b.radii[b.mesh])
    return MeshPair(trees_a, a, trees_b, b, pose)


@njit(merge=True)
def mesh_pair_at(pairs: RowPairs, n: int) -> MeshPair:
    """Return pair n of rows of ``Meshes``."""
    a, b = body_at(pairs.a, pairs.rows_a[n]), body_at(pairs.b, pairs.rows_b[n])
    return mesh_pair(pairs.a.trees, a, pairs.b.trees, b)

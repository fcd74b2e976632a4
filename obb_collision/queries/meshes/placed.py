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

"""Placed meshes: bodies of triangles with trees, as kernels see them, and boxes about them."""

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
from obb_collision.geometry.validation import (
    as_array,
    as_rotations,
    as_rows,
    check_lengths,
)
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.queries.meshes.tree_boxes import BOX_BOUND, Place, place_at
from obb_collision.typing import Floats, Integers


def root_boxes(bodies: PlacedMeshes) -> Boxes:
    """Return boxes (n,) that certainly contain placed meshes.

    Larger by ``BOX_BOUND`` of the reach of a mesh and of its centre: more than the products of
    poses are off by, and than axes do that are orthonormal to 80 u.
    """
    trees, meshes = bodies.trees, bodies.meshes
    nodes = trees.nodes[trees.roots[meshes]]
    axes = nodes[:, 3:HALF].reshape(-1, 3, 3)
    centers = bodies.centers + np.einsum("nij,nj->ni", bodies.rotations, nodes[:, :3])
    sizes = np.abs(bodies.centers).sum(axis=1) + trees.radii[meshes]
    half_extents = nodes[:, HALF : HALF + 3] + (BOX_BOUND * sizes + MESH_UNDERFLOW)[:, None]
    return Boxes.trusted(centers, bodies.rotations @ axes, half_extents)


@dataclass(frozen=True, eq=False)
class PlacedMeshes:
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

    Raises
    ------
    ValueError
        Naming the argument and the row.

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
        """Store arrays for kernels, which follow the rows in them, and a view to look at those."""
        shown = meshes.view()
        shown.setflags(write=False)
        vars(self).update(trees=trees, meshes=shown, centers=centers, rotations=rotations)
        vars(self)["arrays"] = Meshes(trees.arrays, meshes, centers, rotations)

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

        Raises
        ------
        ValueError
            Naming the argument and the row.

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
        return len(self.meshes)

    def place(self, row: int) -> tuple[Floats, Floats]:
        """Return centre (3,) and rotation (3, 3) of a body."""
        return self.centers[row], self.rotations[row]


class Meshes(NamedTuple):
    """Placed meshes, for kernels: body i is mesh ``meshes[i]``."""

    trees: TreeArrays
    meshes: np.ndarray
    centers: Floats
    rotations: Floats


class MeshAt(NamedTuple):
    """One placed mesh of the trees that come with it: arrays in here would be counted per pair."""

    mesh: int
    place: Place


@njit
def body_at(bodies: Meshes, i: int) -> MeshAt:
    """Return body i."""
    return MeshAt(bodies.meshes[i], place_at(bodies.centers, bodies.rotations, i))

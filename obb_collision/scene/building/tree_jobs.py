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

"""Jobs that build trees and hulls of shapes, and put them on a shelf."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np

from obb_collision.geometry.trees.convex_proxy import hull_mesh
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.geometry.trees.pool import TREE_ARRAYS, Hulls
from obb_collision.geometry.trees.shape_trees import hull_tree, mesh_tree
from obb_collision.scene.building.shelf import Added, Shelf
from obb_collision.shapes import Hull, Mesh


@dataclass(frozen=True, eq=False)
class TreeJob:
    """The tree of a mesh's triangles, or of a hull."""

    shape: Mesh | Hull
    shelf: Shelf[MeshTrees, MeshTrees]

    @property
    def size(self) -> int:
        """Bytes that the job holds while it waits: the shape is there anyway."""
        return 0

    def message(self) -> dict[str, Any]:
        """Return what is sent."""
        return {"job": "tree"} | _sent(self.shape)

    def finish(self, reply: dict[str, Any]) -> Added[MeshTrees, MeshTrees]:
        """Return the tree on the shelf."""
        trees = MeshTrees.trusted(**{name: reply[name] for name in TREE_ARRAYS})
        return self.shelf.add(self.shape, trees)


@dataclass(frozen=True, eq=False)
class HullJob:
    """The hull of a mesh or hull."""

    shape: Mesh | Hull
    shelf: Shelf[Hulls, Hulls]

    @property
    def size(self) -> int:
        """Bytes that the job holds while it waits: the shape is there anyway."""
        return 0

    def message(self) -> dict[str, Any]:
        """Return what is sent."""
        return {"job": "hull"} | _sent(self.shape)

    def finish(self, reply: dict[str, Any]) -> Added[Hulls, Hulls]:
        """Return the hull on the shelf."""
        return self.shelf.add(self.shape, Hulls.of(reply["corners"]))


@dataclass(frozen=True, eq=False)
class CompactJob:
    """A new pool of the items in use; nothing is sent."""

    items: dict[Hashable, Any]
    shelf: Shelf[Any, Any]

    @property
    def size(self) -> int:
        """Bytes that the job holds while it waits: the items are there anyway."""
        return 0

    def message(self) -> None:
        """Return None: there is nothing to send."""

    def finish(self, reply: dict[str, Any]) -> Added[Any, Any]:
        """Return the new pool."""
        return self.shelf.compacted(self.items)


def _sent(shape: Mesh | Hull) -> dict[str, Any]:
    center, rotation, half_extents = shape.local_box
    box = {"center": center, "rotation": rotation, "half_extents": half_extents}
    scale = np.array(shape.scale)
    if isinstance(shape, Mesh):
        return box | {"vertices": shape.vertices, "faces": shape.faces, "scale": scale}
    return box | {"points": shape.points, "scale": scale}


def _received(message: dict[str, Any]) -> Mesh | Hull:
    box = message["center"], message["rotation"], message["half_extents"]
    if "vertices" in message:
        return Mesh.fitted(message["vertices"], message["faces"], message["scale"], box)
    return Hull.fitted(message["points"], box, message["scale"])


def perform_tree(message: dict[str, Any]) -> dict[str, Any]:
    """Build a tree."""
    shape = _received(message)
    trees = mesh_tree(shape) if isinstance(shape, Mesh) else hull_tree(shape)
    return {name: getattr(trees, name) for name in TREE_ARRAYS}


def perform_hull(message: dict[str, Any]) -> dict[str, Any]:
    """Build a hull."""
    return {"corners": hull_mesh(_received(message))[0]}

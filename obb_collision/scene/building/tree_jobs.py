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

"""Jobs that build trees and hulls of shapes, and add them to a pool."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from obb_collision.geometry.shapes.meshes import Hull, Mesh
from obb_collision.geometry.trees.pool import HullPool, Pool, TreePool

if TYPE_CHECKING:  # the process that builds needs none of these
    from obb_collision.scene.building.shape_cache import Entry, Packed, PerShape

#: Names of jobs, and where what they build goes to.
POOLS: dict[str, type[Pool[Any]]] = {"tree": TreePool, "hull": HullPool}


@dataclass(frozen=True, eq=False)
class BuildJob:
    """The tree or hull of a shape."""

    shape: Mesh | Hull
    per_shape: PerShape[Any]

    @property
    def size(self) -> int:
        """Bytes that the job holds while it waits: the shape is there anyway."""
        return 0

    def message(self) -> dict[str, Any]:
        """Return what is sent."""
        (name,) = (name for name, kind in POOLS.items() if isinstance(self.per_shape.pool, kind))
        return {"job": name} | _sent(self.shape)

    def finish(self, reply: dict[str, Any]) -> tuple[Pool[Any], Any, int]:
        """Return the pool that what was built is in, itself, and its row."""
        pool = self.per_shape.pool
        item = pool.made(reply)
        with pool.lock:
            return pool, item, pool.append(item)


@dataclass(frozen=True, eq=False)
class PackJob:
    """A new pool of the items in use; nothing is sent."""

    built: dict[Entry[Any], Any]
    per_shape: PerShape[Any]

    @property
    def size(self) -> int:
        """Bytes that the job holds while it waits: the items are there anyway."""
        return 0

    def message(self) -> None:
        """Return None: there is nothing to send."""

    def finish(self, reply: dict[str, Any]) -> Packed[Any]:
        """Return the new pool."""
        return self.per_shape.packed(self.built)


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


def perform_build(message: dict[str, Any]) -> dict[str, Any]:
    """Build a tree or hull."""
    pool = POOLS[message["job"]]
    return pool.arrays(pool.built(_received(message)))

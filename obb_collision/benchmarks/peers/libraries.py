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


"""Collision libraries doing the full step: coal, python-fcl, and trimesh on top of that."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from obb_collision.benchmarks.cases.forms import Frame
from obb_collision.typing import Floats, Rows

#: More contacts than there are: the searches of coal and python-fcl end at a maximum.
MOST_CONTACTS = 10**8
#: Share of the boxes below which those that moved are given to the broad phase one by one.
FEW = 0.5
#: The broad phases of coal by a short name.
COAL_MANAGERS = {
    "tree": "DynamicAABBTreeCollisionManager",
    "tree array": "DynamicAABBTreeArrayCollisionManager",
    "SSaP": "SSaPCollisionManager",
    "SaP": "SaPCollisionManager",
    "interval tree": "IntervalTreeCollisionManager",
    "hashing": "SpatialHashingCollisionManager",
    "naive": "NaiveCollisionManager",
}


def as_rows(pairs: Any) -> Rows:
    """Return pairs (m, 2) from an iterable of them."""
    return np.array(list(pairs), np.int64).reshape(-1, 2)


class PythonFcl:
    """python-fcl: dynamic AABB tree, box-box collision without contacts."""

    def __init__(self, half_extents: Floats, poses: Floats) -> None:
        self._fcl = importlib.import_module("fcl")
        geometries = [self._fcl.Box(*edges) for edges in 2.0 * half_extents]
        self._number = {id(geometry): k for k, geometry in enumerate(geometries)}
        rotations = Rotation.from_quat(poses[:, 3:]).as_matrix()
        transforms = map(self._fcl.Transform, rotations, poses[:, :3])
        self._objects = list(map(self._fcl.CollisionObject, geometries, transforms))
        self._manager = self._fcl.DynamicAABBTreeCollisionManager()
        self._manager.registerObjects(self._objects)
        self._manager.setup()

    def step(self, frame: Frame) -> Any:
        """Set the transforms, update the tree, collide."""
        moved = [self._objects[row] for row in frame.rows]
        transform = self._fcl.Transform
        for item, rotation, center in zip(moved, frame.rotations, frame.moved[:, :3], strict=True):
            item.setTransform(transform(rotation, center))
        if len(moved) < FEW * len(self._objects):
            self._manager.update(moved)
        else:
            self._manager.update()
        request = self._fcl.CollisionRequest(num_max_contacts=MOST_CONTACTS)
        data = self._fcl.CollisionData(request=request)
        self._manager.collide(data, self._fcl.defaultCollisionCallback)
        return data.result.contacts

    def pairs(self, found: Any) -> Rows:
        """Return the pairs of the contacts."""
        return as_rows((self._number[id(c.o1)], self._number[id(c.o2)]) for c in found)


class Coal:
    """coal: one of its broad phases, and a contact per pair."""

    def __init__(self, manager: str, half_extents: Floats, poses: Floats) -> None:
        self._coal = importlib.import_module("coal")
        shapes = [self._coal.Box(*edges) for edges in 2.0 * half_extents]
        for number, shape in enumerate(shapes):
            shape.cost_density = number  # contacts refer to their shapes by value only
        rotations = Rotation.from_quat(poses[:, 3:]).as_matrix()
        transforms = map(self._coal.Transform3s, rotations, poses[:, :3])
        self._objects = list(map(self._coal.CollisionObject, shapes, transforms))
        arguments: tuple[Any, ...] = ()
        if manager == COAL_MANAGERS["hashing"]:  # cells that hold a box on average
            low, high = poses[:, :3].min(axis=0) - 1.0, poses[:, :3].max(axis=0) + 1.0
            arguments = (float(np.prod(high - low) / len(poses)) ** (1 / 3), low, high)
        self._manager = getattr(self._coal, manager)(*arguments)
        for item in self._objects:
            self._manager.registerObject(item)
        self._manager.setup()

    def step(self, frame: Frame) -> Any:
        """Set the transforms, update the broad phase, collide."""
        moved = [self._objects[row] for row in frame.rows]
        transform = self._coal.Transform3s
        for item, rotation, center in zip(moved, frame.rotations, frame.moved[:, :3], strict=True):
            item.setTransform(transform(rotation, center))
            item.computeAABB()
        if len(moved) < FEW * len(self._objects):
            for item in moved:
                self._manager.update(item)
        else:
            self._manager.update()
        callback = self._coal.CollisionCallBackDefault()
        callback.data.request.num_max_contacts = MOST_CONTACTS
        self._manager.collide(callback)
        return callback.data.result

    def pairs(self, found: Any) -> Rows:
        """Return the pairs of the contacts."""
        contacts = (found.getContact(k) for k in range(found.numContacts()))
        return as_rows((c.o1.cost_density, c.o2.cost_density) for c in contacts)


class Trimesh:
    """trimesh: its manager of meshes of twelve triangles, which is python-fcl's tree.

    Only surfaces collide: a box within another one does not.
    """

    def __init__(self, half_extents: Floats, poses: Floats) -> None:
        self._manager = importlib.import_module("trimesh.collision").CollisionManager()
        self._number = {str(k): k for k in range(len(poses))}
        self._names = list(self._number)
        places = _matrices(poses)
        for name, edges, place in zip(self._names, 2.0 * half_extents, places, strict=True):
            self._manager.add_object(name, trimesh.creation.box(edges), place)

    def step(self, frame: Frame) -> Any:
        """Set the transforms and collide."""
        for row, place in zip(frame.rows, _matrices(frame.moved), strict=True):
            self._manager.set_transform(self._names[row], place)
        return self._manager.in_collision_internal(return_names=True)[1]

    def pairs(self, found: Any) -> Rows:
        """Return the pairs of the names."""
        return as_rows((self._number[a], self._number[b]) for a, b in found)


def _matrices(poses: Floats) -> Floats:
    """Return matrices (n, 4, 4)."""
    matrices = np.tile(np.eye(4), (len(poses), 1, 1))
    matrices[:, :3, :3] = Rotation.from_quat(poses[:, 3:]).as_matrix()
    matrices[:, :3, 3] = poses[:, :3]
    return matrices

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

"""Peers that do the same full step: set every pose, update, find every colliding pair.

Each peer is built once from half extents and first poses, because a tree is only as good as the
poses it is built from. ``step`` takes centres (n, 3) and rotations (n, 3, 3) and returns the
colliding pairs in the peer's own fastest form; ``pairs`` turns that into (i, j) tuples outside the
timing.
"""

from __future__ import annotations

import importlib
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from obb_collision.geometry.boxes import Boxes
from obb_collision.scene.broad_phase.find_pairs import find_pairs
from obb_collision.scene.scene import Scene
from obb_collision.shapes import Box
from obb_collision.typing import Floats


class Peer(Protocol):
    """One way to do the step."""

    def step(self, centers: Floats, rotations: Floats) -> Any:
        """Set all poses and find the pairs."""

    def pairs(self, found: Any) -> set[tuple[int, int]]:
        """Turn what ``step`` returned into pairs i < j."""


def _ordered(pairs: Any) -> set[tuple[int, int]]:
    return {(min(i, j), max(i, j)) for i, j in pairs}


class OurPairs:
    """``find_pairs`` of this package, with the boxes validated as always."""

    def __init__(self, half_extents: Floats, centers: Floats, rotations: Floats) -> None:
        self._half_extents = half_extents

    def step(self, centers: Floats, rotations: Floats) -> Any:
        """Build the boxes and find the pairs."""
        return find_pairs(Boxes(centers, rotations, self._half_extents))

    def pairs(self, found: Any) -> set[tuple[int, int]]:
        """Turn rows into tuples."""
        return _ordered(found.tolist())


class OurScene:
    """``Scene`` of this package: named objects, with separations, normals and points."""

    def __init__(self, half_extents: Floats, centers: Floats, rotations: Floats) -> None:
        self._scene = Scene()
        self._indices = np.array(
            [self._scene.add(f"box/{k}", Box(2.0 * h)) for k, h in enumerate(half_extents)]
        )
        self._poses = np.empty((len(half_extents), 7))

    def step(self, centers: Floats, rotations: Floats) -> Any:
        """Move all objects and check."""
        self._poses[:, :3] = centers
        self._poses[:, 3:] = Rotation.from_matrix(rotations).as_quat()
        self._scene.move_indices(self._indices, self._poses)
        return self._scene.check(effects=["separations"])

    def pairs(self, found: Any) -> set[tuple[int, int]]:
        """Turn rows into tuples."""
        return _ordered(found.pairs.tolist())


class PythonFcl:
    """python-fcl: dynamic AABB tree, box-box collision without contacts."""

    def __init__(self, half_extents: Floats, centers: Floats, rotations: Floats) -> None:
        self._fcl = importlib.import_module("fcl")
        geometries = [self._fcl.Box(*(2.0 * h)) for h in half_extents]
        self._number = {id(geometry): k for k, geometry in enumerate(geometries)}
        transforms = map(self._fcl.Transform, rotations, centers)
        self._objects = list(map(self._fcl.CollisionObject, geometries, transforms))
        self._manager = self._fcl.DynamicAABBTreeCollisionManager()
        self._manager.registerObjects(self._objects)
        self._manager.setup()

    def step(self, centers: Floats, rotations: Floats) -> Any:
        """Set all transforms, update the tree, collide."""
        for item, rotation, center in zip(self._objects, rotations, centers, strict=True):
            item.setTransform(self._fcl.Transform(rotation, center))
        self._manager.update()
        request = self._fcl.CollisionRequest(num_max_contacts=10**7)
        data = self._fcl.CollisionData(request=request)
        self._manager.collide(data, self._fcl.defaultCollisionCallback)
        return data.result.contacts

    def pairs(self, found: Any) -> set[tuple[int, int]]:
        """Turn contacts into pairs."""
        return _ordered((self._number[id(c.o1)], self._number[id(c.o2)]) for c in found)


class Coal:
    """coal: dynamic AABB tree, one contact per pair."""

    def __init__(self, half_extents: Floats, centers: Floats, rotations: Floats) -> None:
        self._coal = importlib.import_module("coal")
        shapes = [self._coal.Box(*(2.0 * h)) for h in half_extents]
        self._half_extents = [shape.halfSide for shape in shapes]
        transforms = map(self._coal.Transform3s, rotations, centers)
        self._objects = list(map(self._coal.CollisionObject, shapes, transforms))
        self._manager = self._coal.DynamicAABBTreeCollisionManager()
        for item in self._objects:
            self._manager.registerObject(item)
        self._manager.setup()

    def step(self, centers: Floats, rotations: Floats) -> Any:
        """Set all transforms, update the tree, collide."""
        for item, rotation, center in zip(self._objects, rotations, centers, strict=True):
            item.setTransform(self._coal.Transform3s(rotation, center))
            item.computeAABB()
        self._manager.update()
        callback = self._coal.CollisionCallBackDefault()
        callback.data.request.num_max_contacts = 10**7
        self._manager.collide(callback)
        return callback.data.result

    def pairs(self, found: Any) -> set[tuple[int, int]]:
        """Turn contacts into pairs; contacts refer to their geometries by value only."""
        number = {tuple(h): k for k, h in enumerate(self._half_extents)}
        contacts = [found.getContact(k) for k in range(found.numContacts())]
        return _ordered(
            (number[tuple(c.o1.halfSide)], number[tuple(c.o2.halfSide)]) for c in contacts
        )


class Mujoco:
    """MuJoCo: free bodies, kinematics and collision only; makes contact manifolds."""

    def __init__(self, half_extents: Floats, centers: Floats, rotations: Floats) -> None:
        self._mujoco = importlib.import_module("mujoco")
        bodies = "".join(
            f'<body><freejoint/><geom type="box" size="{h[0]} {h[1]} {h[2]}"/></body>'
            for h in half_extents
        )
        xml = f'<mujoco><size memory="1G"/><worldbody>{bodies}</worldbody></mujoco>'
        self._model = self._mujoco.MjModel.from_xml_string(xml)
        self._data = self._mujoco.MjData(self._model)
        self._poses = self._data.qpos.reshape(-1, 7)

    def step(self, centers: Floats, rotations: Floats) -> Any:
        """Set all poses, update, collide."""
        self._poses[:, :3] = centers
        self._poses[:, 3:] = Rotation.from_matrix(rotations).as_quat(scalar_first=True)
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_collision(self._model, self._data)
        return self._data.contact.geom.copy()

    def pairs(self, found: Any) -> set[tuple[int, int]]:
        """Turn contacts into pairs."""
        return _ordered(found.tolist())


#: Name shown, module needed, class.
PEERS: list[tuple[str, str, type]] = [
    ("find_pairs", "numba", OurPairs),
    ("Scene", "numba", OurScene),
    ("python-fcl", "fcl", PythonFcl),
    ("coal", "coal", Coal),
    ("MuJoCo", "mujoco", Mujoco),
]

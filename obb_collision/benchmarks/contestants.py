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

"""Contestants of the full step, this library and its peers: new poses in, colliding pairs out.

Each is built once from half extents and first poses, because a tree is only as good as the poses
it is built from. ``step`` takes a frame in the form that suits it, sets the poses of what moved,
updates, and returns what it found as it comes; ``pairs`` turns that into rows outside the timing.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from obb_collision.benchmarks.forms import Frame
from obb_collision.geometry.boxes import Boxes
from obb_collision.scene.broad_phase.find_pairs import find_pairs
from obb_collision.scene.scene import Scene
from obb_collision.typing import Floats, Rows

#: More contacts than there are: the searches of coal and python-fcl end at a maximum.
MOST_CONTACTS = 10**8
#: Share of the boxes below which those that moved are given to the broad phase one by one.
FEW = 0.5
#: The broad phases of coal by a short name: those that miss no pair, and are best somewhere.
COAL_MANAGERS = {
    "tree": "DynamicAABBTreeCollisionManager",
    "SSaP": "SSaPCollisionManager",
    "naive": "NaiveCollisionManager",
}
#: Columns of a pose as MuJoCo has them.
WXYZ = [0, 1, 2, 6, 3, 4, 5]


class Stepper(Protocol):
    """One way to do the step."""

    def step(self, frame: Frame) -> Any:
        """Set the poses and find the pairs."""

    def pairs(self, found: Any) -> Rows:
        """Return the pairs (m, 2) of what ``step`` returned, in any order."""


class OurPairs:
    """``find_pairs`` of this package from poses, validated as always."""

    def __init__(self, half_extents: Floats, poses: Floats) -> None:
        self._half_extents = half_extents

    def step(self, frame: Frame) -> Any:
        """Build the boxes and find the pairs."""
        return find_pairs(Boxes.from_poses(frame.poses, self._half_extents))

    def pairs(self, found: Any) -> Rows:
        """Return what was found."""
        return found


class OurScene:
    """``Scene`` of this package: named objects, with the effects asked for."""

    def __init__(self, effects: tuple[str, ...], half_extents: Floats, poses: Floats) -> None:
        self._effects = effects
        self._scene = Scene()
        names = [f"box/{k}" for k in range(len(poses))]
        self._indices = self._scene.add_boxes(names, 2.0 * half_extents, poses)

    def step(self, frame: Frame) -> Any:
        """Move what moved and check."""
        if len(frame.rows):
            self._scene.move_indices(self._indices[frame.rows], frame.moved)
        return self._scene.check(self._effects)

    def pairs(self, found: Any) -> Rows:
        """Return the pairs of the report."""
        return found.pairs


class Contestant(NamedTuple):
    """Somebody who does the step: a name, the module and distribution, and how it is built.

    threads: those it uses, None for as many as this library is set to.
    """

    name: str
    module: str
    make: Callable[[Floats, Floats], Stepper]
    distribution: str = ""
    threads: int | None = 1

    @property
    def installed(self) -> bool:
        """Whether its module is there."""
        return importlib.util.find_spec(self.module) is not None


class Mujoco:
    """MuJoCo: free bodies, kinematics and collision only; makes contact manifolds."""

    def __init__(self, half_extents: Floats, poses: Floats) -> None:
        self._mujoco = importlib.import_module("mujoco")
        bodies = "".join(
            f'<body><freejoint/><geom type="box" size="{x!r} {y!r} {z!r}"/></body>'
            for x, y, z in half_extents.tolist()
        )
        xml = f'<mujoco><size memory="1G"/><worldbody>{bodies}</worldbody></mujoco>'
        self._model = self._mujoco.MjModel.from_xml_string(xml)
        self._data = self._mujoco.MjData(self._model)
        self._poses = self._data.qpos.reshape(-1, 7)
        self._poses[:] = poses[:, WXYZ]

    def step(self, frame: Frame) -> Any:
        """Set the poses, update, collide."""
        self._poses[frame.rows] = frame.moved[:, WXYZ]
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_collision(self._model, self._data)
        return self._data.contact.geom.copy()

    def pairs(self, found: Any) -> Rows:
        """Return the pairs of the contacts."""
        return as_rows(found)


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
        self._manager = getattr(self._coal, manager)()
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


def _ours(name: str, make: Callable[[Floats, Floats], Stepper]) -> Contestant:
    return Contestant(name, "numba", make, threads=None)


PAIRS = _ours("find_pairs", OurPairs)
SCENE = _ours("Scene", partial(OurScene, ()))
SEPARATIONS = _ours("Scene, separations", partial(OurScene, ("separations",)))
CONTACTS = _ours("Scene, contacts", partial(OurScene, ("contacts",)))
OURS = (PAIRS, SCENE, SEPARATIONS, CONTACTS)

MUJOCO = Contestant("MuJoCo", "mujoco", Mujoco, "mujoco")
COAL = tuple(
    Contestant(f"coal {short}", "coal", partial(Coal, manager), "coal")
    for short, manager in COAL_MANAGERS.items()
)
PEERS = (MUJOCO, *COAL, Contestant("python-fcl", "fcl", PythonFcl, "python-fcl"))

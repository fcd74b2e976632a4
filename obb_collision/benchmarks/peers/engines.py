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


"""Physics engines doing the full step, of which only the collision detection is called."""

from __future__ import annotations

import importlib
import io
from contextlib import redirect_stdout
from typing import Any

import numpy as np

from obb_collision._threads import threads
from obb_collision.benchmarks.cases.forms import Frame
from obb_collision.benchmarks.peers.libraries import as_rows
from obb_collision.typing import Floats, Rows


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
        self._set(slice(None), poses)

    def _set(self, rows: Rows | slice, poses: Floats) -> None:
        self._poses[rows] = poses[:, [0, 1, 2, 6, 3, 4, 5]]

    def step(self, frame: Frame) -> Any:
        """Set the poses, update, collide."""
        self._set(frame.rows, frame.moved)
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_collision(self._model, self._data)
        return self._data.contact.geom.copy()

    def pairs(self, found: Any) -> Rows:
        """Return the pairs of the contacts."""
        return as_rows(found)


class Pybullet:
    """pybullet, in single precision: free bodies, collision detection only, contact points."""

    def __init__(self, half_extents: Floats, poses: Floats) -> None:
        with redirect_stdout(io.StringIO()):
            self._bullet = importlib.import_module("pybullet")
        bullet = self._bullet
        self._client = bullet.connect(bullet.DIRECT)
        options = {"physicsClientId": self._client}
        shapes = [
            bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half, **options)
            for half in half_extents.tolist()
        ]
        self._bodies = [
            bullet.createMultiBody(1.0, shape, -1, pose[:3], pose[3:], **options)
            for shape, pose in zip(shapes, poses.tolist(), strict=True)
        ]

    def __del__(self) -> None:
        if hasattr(self, "_client"):
            self._bullet.disconnect(self._client)

    def step(self, frame: Frame) -> Any:
        """Set the poses, update, collide."""
        put, client = self._bullet.resetBasePositionAndOrientation, self._client
        for row, pose in zip(frame.rows.tolist(), frame.moved.tolist(), strict=True):
            put(self._bodies[row], pose[:3], pose[3:], client)
        self._bullet.performCollisionDetection(client)
        return self._bullet.getContactPoints(physicsClientId=client)

    def pairs(self, found: Any) -> Rows:
        """Return the pairs of the points that are not apart: it reports those near, too."""
        number = {body: k for k, body in enumerate(self._bodies)}
        return as_rows((number[p[1]], number[p[2]]) for p in found if p[8] <= 0.0)


class Rapier:
    """rapier3d, in single precision: colliders without bodies, collision detection only."""

    def __init__(self, half_extents: Floats, poses: Floats) -> None:
        rapier = self._rapier = importlib.import_module("rapier3d")
        self._world = rapier.PhysicsWorld()
        self._world.set_num_threads(threads())
        every = rapier.ActiveCollisionTypes.all()
        handles = [
            self._world.add_collider(rapier.Collider.cuboid(*half, active_collision_types=every))
            for half in half_extents.tolist()
        ]
        self._number = {handle.index: k for k, handle in enumerate(handles)}
        self._items = [self._world.colliders.get(handle) for handle in handles]
        self.step(Frame(poses, np.arange(len(poses))))

    def step(self, frame: Frame) -> Any:
        """Set the positions, update, collide."""
        place, vector, turn = self._rapier.Isometry3, self._rapier.Vec3, self._rapier.Rotation3
        items = self._items
        for row, (x, y, z, i, j, k, w) in zip(
            frame.rows.tolist(), frame.moved.tolist(), strict=True
        ):
            items[row].position = place(vector(x, y, z), turn(w, i, j, k))
        self._world.detect_collisions()
        return self._world.narrow_phase.contact_pairs()

    def pairs(self, found: Any) -> Rows:
        """Return the pairs with a point that is not apart: it reports those near, too."""
        touching = (
            pair
            for pair in found
            if any(point.dist <= 0.0 for m in pair.manifolds for point in m.points)
        )
        number = self._number
        return as_rows((number[p.collider1.index], number[p.collider2.index]) for p in touching)

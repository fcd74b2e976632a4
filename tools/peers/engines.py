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

"""Physics engines in single precision as further contestants of ``obb_collision speed``.

Only their collision detection is called. Arguments and output are those of that command, and pages
that get the tables:

    python -m tools.peers.engines [...] [--markdown PAGE ...]
"""

from __future__ import annotations

import importlib
import io
from collections.abc import Sequence
from contextlib import redirect_stdout
from typing import Any

import numpy as np

from obb_collision._threads import threads
from obb_collision.benchmarks.command import speed_parser
from obb_collision.benchmarks.contestants import PEERS, Contestant, Frame, pair_array
from obb_collision.benchmarks.measuring import machine_line
from obb_collision.benchmarks.speed import measure, report
from obb_collision.cli import Progress, interruptible, new_file
from obb_collision.typing import Floats, Rows
from tools.pages import blocks_of, write_into


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
        return pair_array((number[p[1]], number[p[2]]) for p in found if p[8] <= 0.0)


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
        """Return the pairs with a point in contact: it reports near pairs, too."""
        touching = (
            pair
            for pair in found
            if any(point.dist <= 0.0 for m in pair.manifolds for point in m.points)
        )
        number = self._number
        return pair_array((number[p.collider1.index], number[p.collider2.index]) for p in touching)


ENGINES = (
    Contestant("rapier3d", "rapier3d", Rapier, "rapier3d", threads=None),
    Contestant("pybullet", "pybullet", Pybullet, "pybullet"),
)


@interruptible("python -m tools.peers.engines")
def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the full step with them."""
    peers = (*PEERS, *ENGINES)
    parser = speed_parser("python -m tools.peers.engines", [one.name for one in peers])
    text = "pages that get the tables between their marks"
    parser.add_argument("--markdown", type=new_file(".md"), metavar="PAGE", nargs="+", help=text)
    options = parser.parse_args(arguments)
    with Progress() as progress:
        result = measure(options, peers, progress.show)
    report(result, options)
    for page in options.markdown or ():
        blocks = blocks_of(result.rows, result.notes)
        write_into(page, blocks | {"machine": machine_line(result.machine)})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

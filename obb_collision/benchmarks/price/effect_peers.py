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

"""Peers computing distances, depths and times of impact of the same pairs, one by one from Python.

Shapes, transforms and requests are made beforehand, as in ``peers``. Where a peer cannot be loaded
or has no such shape, it is left out.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from obb_collision.benchmarks.price.peers import coal_hull, coal_mesh, fcl_hull, fcl_mesh
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.shapes import Shape
from obb_collision.typing import Floats, Rows

Ask = Callable[[], Floats]
#: Metres beyond which MuJoCo need not search.
FARTHEST = 3.0


@dataclass(frozen=True)
class PlacedPairs:
    """Pairs (m, 2) of bodies and the shape of each (m, 2); centers (n, 3), rotations (n, 3, 3)."""

    shapes: Sequence[Shape]
    rows: Rows
    centers: Floats
    rotations: Floats
    pairs: Rows


def coal_distances(make: Callable[[Any, Shape], Any]) -> Callable[[Any, PlacedPairs], Ask]:
    """Return what asks coal for distances with closest points; negative ones are depths."""

    def load(coal: Any, query: PlacedPairs) -> Ask:
        made = [make(coal, shape) for shape in query.shapes]
        calls = [
            (made[r], coal.Transform3s(query.rotations[i], query.centers[i]),
             made[s], coal.Transform3s(query.rotations[j], query.centers[j]))
            for (i, j), (r, s) in zip(query.pairs, query.rows, strict=True)
        ]  # fmt: skip
        request, result = coal.DistanceRequest(True), coal.DistanceResult()

        def run() -> Floats:
            values = []
            for call in calls:
                result.clear()
                values.append(coal.distance(*call, request, result))
            return np.array(values)

        return run

    return load


def fcl_distances(make: Callable[[Any, Shape], Any]) -> Callable[[Any, PlacedPairs], Ask]:
    """Return what asks python-fcl for distances with closest points."""

    def load(fcl: Any, query: PlacedPairs) -> Ask:
        objects = _fcl_objects(fcl, make, query)
        request = fcl.DistanceRequest(enable_nearest_points=True)
        return lambda: np.array(
            [fcl.distance(a, b, request, fcl.DistanceResult()) for a, b in objects]
        )

    return load


def coal_depths(coal: Any, query: PlacedPairs) -> Ask:
    """Return what asks coal for depths of hulls."""
    run = coal_distances(coal_hull)(coal, query)
    return lambda: -run()


def fcl_depths(fcl: Any, query: PlacedPairs) -> Ask:
    """Return what asks python-fcl for contacts of hulls."""
    objects = _fcl_objects(fcl, fcl_hull, query)
    request = fcl.CollisionRequest(num_max_contacts=4, enable_contact=True)

    def run() -> Floats:
        values = []
        for a, b in objects:
            result = fcl.CollisionResult()
            fcl.collide(a, b, request, result)
            depths = [contact.penetration_depth for contact in result.contacts]
            values.append(max(depths, default=0.0))
        return np.array(values)

    return run


def _fcl_objects(
    fcl: Any, make: Callable[[Any, Shape], Any], query: PlacedPairs
) -> list[tuple[Any, Any]]:
    made = [make(fcl, shape) for shape in query.shapes]

    def placed(row: int, body: int) -> Any:
        where = fcl.Transform(query.rotations[body], query.centers[body])
        return fcl.CollisionObject(made[row], where)

    return [
        (placed(r, i), placed(s, j)) for (i, j), (r, s) in zip(query.pairs, query.rows, strict=True)
    ]


def mujoco_distances(mujoco: Any, query: PlacedPairs) -> Ask:
    """Return what asks MuJoCo for distances of hulls, negative where they overlap."""
    spec = mujoco.MjSpec()
    for row, shape in enumerate(query.shapes):
        assert isinstance(shape, Mesh)
        spec.add_mesh(
            name=f"{row}", uservert=shape.vertices.ravel(), userface=shape.faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )  # fmt: skip
        for end in "ab":
            body = spec.worldbody.add_body(name=f"{row}{end}")
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{row}", name=f"{row}{end}")
    model = spec.compile()
    data = mujoco.MjData(model)
    calls = []
    for (i, j), (r, s) in zip(query.pairs.tolist(), query.rows.tolist(), strict=True):
        ends = []
        for row, body, end in ((r, i, "a"), (s, j, "b")):
            geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, f"{row}{end}")
            mesh = model.geom_dataid[geom]
            turn = Rotation.from_quat(np.roll(model.mesh_quat[mesh], -1)).as_matrix()
            rotation = query.rotations[body]
            center = query.centers[body] + rotation @ model.mesh_pos[mesh]
            ends.append((geom, center, (rotation @ turn).ravel()))
        calls.append(ends)

    def run() -> Floats:
        values, segment = [], np.zeros((6, 1))
        places, turns = data.geom_xpos, data.geom_xmat
        for (a, p, m), (b, q, n) in calls:
            places[a], turns[a], places[b], turns[b] = p, m, q, n
            values.append(mujoco.mj_geomDistance(model, data, a, b, FARTHEST, segment))
        return np.array(values)

    return run


def mujoco_depths(mujoco: Any, query: PlacedPairs) -> Ask:
    """Return what asks MuJoCo for depths of hulls."""
    run = mujoco_distances(mujoco, query)
    return lambda: -run()


@dataclass(frozen=True)
class EffectPeer:
    """A peer: its name, its module, what stands for a shape, and how it is asked."""

    name: str
    module: str
    shape: str
    ask: Callable[[Any, PlacedPairs], Ask]

    @property
    def label(self) -> str:
        """The name of the peer and of what stands for a shape."""
        return f"{self.name} {self.shape}"

    def load(self, query: PlacedPairs) -> Ask | None:
        """Return what asks for all pairs; None where it is not installed."""
        try:
            return self.ask(importlib.import_module(self.module), query)
        except ImportError:
            return None


EFFECT_PEERS: dict[str, tuple[EffectPeer, ...]] = {
    "clearance": (
        EffectPeer("coal", "coal", "hull", coal_distances(coal_hull)),
        EffectPeer("coal", "coal", "mesh", coal_distances(coal_mesh)),
        EffectPeer("python-fcl", "fcl", "hull", fcl_distances(fcl_hull)),
        EffectPeer("python-fcl", "fcl", "mesh", fcl_distances(fcl_mesh)),
        EffectPeer("MuJoCo", "mujoco", "hull", mujoco_distances),
    ),
    "contacts": (
        EffectPeer("coal", "coal", "hull", coal_depths),
        EffectPeer("python-fcl", "fcl", "hull", fcl_depths),
        EffectPeer("MuJoCo", "mujoco", "hull", mujoco_depths),
    ),
}
"""By effect; none of them has times of impact of shapes that can be compared."""

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

"""Other libraries about one pair: whether it collides, and its signed distance.

Every peer runs at its defaults and gets the doubles as they are stored.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from obb_collision.benchmarks.contestants import Frame
from obb_collision.typing import Floats
from tools.peers.engines import Pybullet, Rapier


class PlacedBox(NamedTuple):
    """Centre (3,), rotation (3, 3) whose columns are the axes, half extents (3,)."""

    center: Floats
    rotation: Floats
    half_extents: Floats


#: A box, or the convex hull of corners (n, 3).
Body = PlacedBox | Floats
#: Metres up to which distances are asked for.
FARTHEST = 1000.0


class Answer(NamedTuple):
    """Whether a pair collides, and its distance: negative if so, NaN where none is given."""

    collides: bool
    distance: float


@dataclass(frozen=True)
class PairPeer:
    """A library: its distribution, its module, and how it is asked about a pair."""

    name: str
    distribution: str
    module: str
    ask: Callable[[ModuleType, Body, Body], Answer]

    def version(self) -> str | None:
        """Return the installed version, None where it can't be imported."""
        try:
            importlib.import_module(self.module)
            return importlib.metadata.version(self.distribution)
        except (ImportError, importlib.metadata.PackageNotFoundError):
            return None

    def answer(self, a: Body, b: Body) -> Answer:
        """Return the answer about a pair; whatever the library raises."""
        return self.ask(importlib.import_module(self.module), a, b)


def _fcl_object(fcl: Any, body: Body) -> Any:
    if isinstance(body, PlacedBox):
        shape = fcl.Box(*(2.0 * body.half_extents))
        return fcl.CollisionObject(shape, fcl.Transform(body.rotation, body.center))
    faces = outward_faces(body)
    flat = np.column_stack([np.full(len(faces), 3), faces]).ravel()
    return fcl.CollisionObject(fcl.Convex(body, len(faces), flat), fcl.Transform())


def _fcl(fcl: Any, a: Body, b: Body) -> Answer:
    one, two = _fcl_object(fcl, a), _fcl_object(fcl, b)
    collides = fcl.collide(one, two, fcl.CollisionRequest(), fcl.CollisionResult())
    request = fcl.DistanceRequest(enable_signed_distance=True)
    return Answer(bool(collides), float(fcl.distance(one, two, request, fcl.DistanceResult())))


def _coal_shape(coal: Any, body: Body) -> tuple[Any, Any]:
    if isinstance(body, PlacedBox):
        shape = coal.Box(*(2.0 * body.half_extents))
        return shape, coal.Transform3s(body.rotation, body.center)
    points = coal.StdVec_Vec3s()
    for point in body:
        points.append(point)
    triangles = coal.StdVec_Triangle()
    for face in outward_faces(body).tolist():
        triangles.append(coal.Triangle(*face))
    return coal.Convex(points, triangles), coal.Transform3s.Identity()


def _coal(coal: Any, a: Body, b: Body) -> Answer:
    pair = (*_coal_shape(coal, a), *_coal_shape(coal, b))
    result = coal.CollisionResult()
    coal.collide(*pair, coal.CollisionRequest(), result)
    distance = coal.distance(*pair, coal.DistanceRequest(), coal.DistanceResult())
    return Answer(bool(result.isCollision()), float(distance))


def _mujoco(mujoco: Any, a: Body, b: Body) -> Answer:
    assets, geoms = "", ""
    for name, body in (("a", a), ("b", b)):
        if isinstance(body, PlacedBox):
            kind = f'type="box" size="{_numbers(body.half_extents)}"'
        else:
            assets += f'<mesh name="{name}" vertex="{_numbers(body.ravel())}"/>'
            kind = f'type="mesh" mesh="{name}"'
        geoms += f'<body><freejoint/><geom name="{name}" {kind}/></body>'
    xml = f"<mujoco><asset>{assets}</asset><worldbody>{geoms}</worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for number, body in enumerate((a, b)):
        if isinstance(body, PlacedBox):  # into the world poses, so that no conversion rounds
            data.geom_xpos[number] = body.center
            data.geom_xmat[number] = body.rotation.ravel()
    mujoco.mj_collision(model, data)
    if data.ncon:
        return Answer(True, float(data.contact.dist.min()))
    return Answer(False, float(mujoco.mj_geomDistance(model, data, 0, 1, FARTHEST, None)))


def _engine(engine: type[Pybullet] | type[Rapier], a: Body, b: Body) -> Answer:
    if not (isinstance(a, PlacedBox) and isinstance(b, PlacedBox)):
        raise NotImplementedError("only boxes")
    turns = Rotation.from_matrix([a.rotation, b.rotation]).as_quat()
    poses = np.column_stack([[a.center, b.center], turns])
    world = engine(np.array([a.half_extents, b.half_extents]), poses)
    found = world.step(Frame(poses, np.arange(2)))
    return Answer(len(world.pairs(found)) > 0, float("nan"))


def _numbers(values: Floats) -> str:
    return " ".join(map(repr, values.tolist()))


def outward_faces(corners: Floats) -> np.ndarray:
    """Return the faces (m, 3) of the convex hull of corners (n, 3), counter-clockwise."""
    hull = ConvexHull(corners)
    faces = hull.simplices.copy()
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return faces


PAIR_PEERS = (
    PairPeer("MuJoCo", "mujoco", "mujoco", _mujoco),
    PairPeer("coal", "coal", "coal", _coal),
    PairPeer("python-fcl", "python-fcl", "fcl", _fcl),
    PairPeer("pybullet", "pybullet", "pybullet", lambda _, a, b: _engine(Pybullet, a, b)),
    PairPeer("rapier3d", "rapier3d", "rapier3d", lambda _, a, b: _engine(Rapier, a, b)),
)

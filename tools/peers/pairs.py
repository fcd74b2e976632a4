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

"""Peers asked about a pair of boxes or convex hulls, by the doubles as they are, at defaults."""

from __future__ import annotations

import importlib
import importlib.metadata
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import nan
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
    """Whether a pair collides, and its distance: negative if so, NaN if unknown."""

    collides: bool
    distance: float = nan


@dataclass(frozen=True)
class PairPeer:
    """A library: distribution, module, and the function that asks it about a pair.

    ask: takes the module, two bodies, and whether their distance is wanted. how: what it calls.
    """

    name: str
    distribution: str
    module: str
    ask: Callable[[ModuleType, Body, Body, bool], Answer]
    how: str = ""

    def version(self) -> str | None:
        """Return the installed version, None if it cannot be imported."""
        try:
            importlib.import_module(self.module)
            return importlib.metadata.version(self.distribution)
        except (ImportError, importlib.metadata.PackageNotFoundError):
            return None

    def answer(self, a: Body, b: Body, distance: bool = True) -> Answer:
        """Return the answer about a pair; whatever the library raises."""
        return self.ask(importlib.import_module(self.module), a, b, distance)


def _fcl_object(fcl: Any, body: Body) -> Any:
    if isinstance(body, PlacedBox):
        shape = fcl.Box(*(2.0 * body.half_extents))
        return fcl.CollisionObject(shape, fcl.Transform(body.rotation, body.center))
    faces = outward_faces(body)
    flat = np.column_stack([np.full(len(faces), 3), faces]).ravel()
    return fcl.CollisionObject(fcl.Convex(body, len(faces), flat), fcl.Transform())


def _fcl(fcl: Any, a: Body, b: Body, distance: bool) -> Answer:
    pair = _fcl_object(fcl, a), _fcl_object(fcl, b)
    collides = bool(fcl.collide(*pair, fcl.CollisionRequest(), fcl.CollisionResult()))
    if not distance:
        return Answer(collides)
    request = fcl.DistanceRequest(enable_signed_distance=True)
    return Answer(collides, float(fcl.distance(*pair, request, fcl.DistanceResult())))


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


def _coal(coal: Any, a: Body, b: Body, distance: bool) -> Answer:
    pair = (*_coal_shape(coal, a), *_coal_shape(coal, b))
    result = coal.CollisionResult()
    coal.collide(*pair, coal.CollisionRequest(), result)
    collides = bool(result.isCollision())
    if not distance:
        return Answer(collides)
    return Answer(
        collides, float(coal.distance(*pair, coal.DistanceRequest(), coal.DistanceResult()))
    )


@lru_cache(maxsize=1)
def _mujoco_world(mujoco: Any, assets: str, *kinds: str) -> tuple[Any, Any]:
    """Return model and data of two free bodies.

    They are an explicit pair: mj_collision goes to it without a broad phase in between.
    """
    bodies = "".join(
        f'<body><freejoint/><geom name="{name}" {kind} contype="0" conaffinity="0"/></body>'
        for name, kind in zip("ab", kinds, strict=True)
    )
    contact = '<contact><pair geom1="a" geom2="b"/></contact>'
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><asset>{assets}</asset><worldbody>{bodies}</worldbody>{contact}</mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def _mujoco(mujoco: Any, a: Body, b: Body, distance: bool) -> Answer:
    assets, kinds = "", ['type="box" size="1 1 1"'] * 2
    for number, body in enumerate((a, b)):
        if not isinstance(body, PlacedBox):
            vertices = " ".join(map(repr, body.ravel().tolist()))
            assets += f'<mesh name="{number}" vertex="{vertices}"/>'
            kinds[number] = f'type="mesh" mesh="{number}"'
    model, data = _mujoco_world(mujoco, assets, *kinds)
    for number, body in enumerate((a, b)):
        if isinstance(body, PlacedBox):  # into the world poses, so that no conversion rounds
            half = body.half_extents
            data.geom_xpos[number], data.geom_xmat[number] = body.center, body.rotation.ravel()
            model.geom_size[number], model.geom_rbound[number] = half, np.sqrt((half * half).sum())
    mujoco.mj_collision(model, data)
    if not distance:
        return Answer(bool(data.ncon > 0))
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
    return Answer(len(world.pairs(found)) > 0)


def outward_faces(corners: Floats) -> np.ndarray:
    """Return the faces (m, 3) of the convex hull of corners (n, 3), counter-clockwise."""
    hull = ConvexHull(corners)
    faces = hull.simplices.copy()
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return faces


DOUBLES = (
    PairPeer("MuJoCo", "mujoco", "mujoco", _mujoco, "mj_collision, margin 0, contacts > 0"),
    PairPeer("coal", "coal", "coal", _coal, "coal.collide"),
    PairPeer("python-fcl", "python-fcl", "fcl", _fcl, "fcl.collide"),
)
"""Peers that compute in double precision."""
PAIR_PEERS = (
    *DOUBLES,
    PairPeer("pybullet", "pybullet", "pybullet", lambda _, a, b, d: _engine(Pybullet, a, b)),
    PairPeer("rapier3d", "rapier3d", "rapier3d", lambda _, a, b, d: _engine(Rapier, a, b)),
)

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

"""python-fcl and coal on pairs of boxes, hulls and meshes, asked one by one from Python.

That is how they are used: shapes and transforms are made beforehand, and a query sets poses where a
peer stores them in objects. A peer that is not installed is left out.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from trimesh.convex import convex_hull

from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.shapes import Box, Shape
from obb_collision.typing import Floats, Mask, Rows

Ask = Callable[[], Mask]


class Query(NamedTuple):
    """Pairs (m, 2) of bodies: body k has shape ``rows[k]`` at a pose.

    centers (n, 3), rotations (n, 3, 3).
    """

    rows: Rows
    centers: Floats
    rotations: Floats
    pairs: Rows


def _hull(shape: Shape) -> Any:
    assert isinstance(shape, Mesh)
    return convex_hull(np.unique(shape._points(), axis=0))


def peer_box(peer: Any, shape: Shape) -> Any:
    """Return the box of python-fcl or coal."""
    assert isinstance(shape, Box)
    return peer.Box(*shape.size)


def fcl_hull(fcl: Any, shape: Shape) -> Any:
    """Return python-fcl's convex body, with the hull that trimesh finds."""
    hull = _hull(shape)
    faces = np.column_stack([np.full(len(hull.faces), 3), hull.faces]).ravel()
    return fcl.Convex(np.asarray(hull.vertices), len(hull.faces), faces)


def fcl_mesh(fcl: Any, shape: Shape) -> Any:
    """Return python-fcl's triangle tree."""
    assert isinstance(shape, Mesh)
    model = fcl.BVHModel()
    model.beginModel(len(shape.vertices), len(shape.faces))
    model.addSubModel(shape.vertices, shape.faces)
    model.endModel()
    return model


def ask_fcl(fcl: Any, made: list[Any], query: Query) -> Ask:
    """Return a function that queries python-fcl for all pairs; each body is an object of it."""
    places = map(fcl.Transform, query.rotations, query.centers)
    items = [fcl.CollisionObject(made[row], t) for row, t in zip(query.rows, places, strict=True)]
    pairs, request = query.pairs.tolist(), fcl.CollisionRequest()

    def run() -> Mask:
        collide, result = fcl.collide, fcl.CollisionResult
        hits = [collide(items[i], items[j], request, result()) > 0 for i, j in pairs]
        return np.array(hits, np.bool_)

    return run


def coal_mesh(coal: Any, shape: Shape) -> Any:
    """Return coal's triangle tree."""
    assert isinstance(shape, Mesh)
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(shape.faces), len(shape.vertices))
    model.addVertices(shape.vertices)
    model.addTriangles(shape.faces)
    model.endModel()
    return model


def coal_hull(coal: Any, shape: Shape) -> Any:
    """Return coal's convex body, with the hull that coal finds."""
    hull = _hull(shape)
    model = coal_mesh(coal, Mesh(hull.vertices, hull.faces))
    model.buildConvexHull(True, "Qt")
    return model.convex


def ask_coal(coal: Any, made: list[Any], query: Query) -> Ask:
    """Return a function that queries coal for all pairs, without contact points."""
    shapes = [made[row] for row in query.rows]
    places = list(map(coal.Transform3s, query.rotations, query.centers))
    pairs = query.pairs.tolist()
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    request.enable_contact = False

    def run() -> Mask:
        collide, clear, hits = coal.collide, result.clear, []
        for i, j in pairs:
            hit = collide(shapes[i], places[i], shapes[j], places[j], request, result) > 0
            if hit:
                clear()  # a full result would end the next search
            hits.append(hit)
        return np.array(hits, np.bool_)

    return run


class Peer(NamedTuple):
    """A peer: its distribution, what stands for a shape, its module, how it is called."""

    name: str
    shape: str
    module: str
    make: Callable[[Any, Shape], Any]
    ask: Callable[[Any, list[Any], Query], Ask]

    @property
    def label(self) -> str:
        """The name of the peer and of what stands for a shape."""
        return f"{self.name} {self.shape}"

    def load(self, shapes: Iterable[Shape]) -> Callable[[Query], Ask]:
        """Make the shapes and return what prepares a query; ImportError if not installed."""
        module = importlib.import_module(self.module)
        return partial(self.ask, module, [self.make(module, shape) for shape in shapes])


BOX_PEERS = (
    Peer("python-fcl", "box", "fcl", peer_box, ask_fcl),
    Peer("coal", "box", "coal", peer_box, ask_coal),
)
MESH_PEERS = (
    Peer("python-fcl", "hull", "fcl", fcl_hull, ask_fcl),
    Peer("coal", "hull", "coal", coal_hull, ask_coal),
    Peer("python-fcl", "mesh", "fcl", fcl_mesh, ask_fcl),
    Peer("coal", "mesh", "coal", coal_mesh, ask_coal),
)

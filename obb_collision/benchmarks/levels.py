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

"""The levels of accuracy on bodies thrown into a room, and peers on the same pairs.

A level is used as in a ``Scene``: those above ``obb`` decide only the pairs that ``obb`` reports.
Peers are asked one by one from Python, as they are used: shapes and transforms are made
beforehand, and a query sets poses where a peer stores them in objects. A peer that is not
installed is left out.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from functools import cached_property, partial
from time import thread_time
from typing import Any, NamedTuple

import numpy as np
from trimesh.convex import convex_hull

from obb_collision._jit import njit
from obb_collision.benchmarks.corpora import Corpus, random_poses
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.fitting.fit import fit_points
from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.trees.convex_proxy import hull_mesh
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.geometry.trees.pool import HullPool, Hulls, mesh_tree
from obb_collision.queries.meshes.convex import PlacedHulls, hulls_may_collide
from obb_collision.queries.meshes.meshes import mesh_collisions
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.verdict.coarse import sphere_bounds, spheres_may_collide
from obb_collision.queries.verdict.verdict import SEPARATE, pair_verdicts
from obb_collision.scene.broad_phase.broad_phase import find_candidates
from obb_collision.scene.scene import Scene
from obb_collision.shapes import Box, Shape
from obb_collision.typing import Floats, Mask, Rows

#: Cubic metres per body of one metre diagonal: gives about two candidate pairs per body.
VOLUME_PER_BODY = 0.3


class Throw:
    """Bodies at their poses, and their pairs, first (m,) and second (m,), whose AABBs overlap.

    Body k has shape ``rows[k]`` at centers (n, 3), rotations (n, 3, 3).
    """

    def __init__(
        self,
        rows: Rows,
        poses: Floats,
        boxes: Boxes,
        meshes: Any = None,
        hulls: Any = None,
    ) -> None:
        self.rows = rows
        self.centers, self.rotations = as_poses(poses)
        self.boxes = boxes
        self.meshes, self.hulls = meshes, hulls
        self.low, self.high = boxes.world_bounds()
        pairs = find_candidates(self.low, self.high)
        self.first = np.ascontiguousarray(pairs[:, 0])
        self.second = np.ascontiguousarray(pairs[:, 1])

    @cached_property
    def sphere_counts(self) -> tuple[int, int]:
        """How many candidates the broad phase for spheres gives, and how many spheres collide.

        Spheres may collide where AABBs do not, so there are more than the pairs above.
        """
        pairs = find_candidates(*sphere_bounds(self.boxes))
        first, second = (np.ascontiguousarray(column) for column in pairs.T)
        return len(pairs), int(spheres_may_collide(self.boxes, first, second).sum())


class Crowd:
    """Bodies of a corpus in a ``Scene``, thrown anew again and again."""

    def __init__(self, corpus: Corpus, count: int, seed: int) -> None:
        self.corpus = corpus
        self._rng = np.random.default_rng(seed)
        shapes = list(corpus.shapes.values())
        self.rows = np.arange(count, dtype=np.int64) % len(shapes)
        self.scene = Scene()
        for k, row in enumerate(self.rows):
            self.scene.add(f"{k}", shapes[row])
        self._trees: tuple[MeshTrees, Hulls] | None = None

    def use_trees(self, meshes: list[MeshTrees], hulls: list[Hulls]) -> None:
        """Use these trees and hulls, one per shape, for the levels above ``obb``."""
        pool = HullPool()
        for hull in hulls:
            pool.append(hull)
        self._trees = MeshTrees.join(meshes), pool.all

    def poses(self) -> Floats:
        """Return fresh random poses (n, 7)."""
        return random_poses(len(self.rows), VOLUME_PER_BODY, self._rng)

    def throw(self) -> Throw:
        """Move all bodies to random poses."""
        where = self.poses()
        self.scene.move_indices(self.scene.indices, where)
        if self._trees is None:
            return Throw(self.rows, where, self.scene.boxes)
        meshes = PlacedMeshes.from_poses(self._trees[0], self.rows, where)
        hulls = PlacedHulls(self._trees[1], self.rows, meshes.centers, meshes.rotations)
        return Throw(self.rows, where, self.scene.boxes, meshes, hulls)


@njit
def _aabb_kernel(
    low: Floats, high: Floats, rows_a: np.ndarray, rows_b: np.ndarray, out: np.ndarray
) -> None:
    for n in range(len(rows_a)):
        i, j = rows_a[n], rows_b[n]
        out[n] = (
            low[i, 0] <= high[j, 0]
            and low[j, 0] <= high[i, 0]
            and low[i, 1] <= high[j, 1]
            and low[j, 1] <= high[i, 1]
            and low[i, 2] <= high[j, 2]
            and low[j, 2] <= high[i, 2]
        )


def _ask_aabb(throw: Throw, first: Rows, second: Rows) -> Mask:
    out = np.empty(len(first), np.bool_)
    _aabb_kernel(throw.low, throw.high, first, second, out)
    return out


def _ask_obb(throw: Throw, first: Rows, second: Rows) -> Mask:
    return np.asarray(pair_verdicts(throw.boxes, first, throw.boxes, second) != SEPARATE)


def _refine(ask: Callable[[Throw, Rows, Rows], Mask]) -> Callable[[Throw, Rows, Rows], Mask]:
    def refined(throw: Throw, first: Rows, second: Rows) -> Mask:
        met = _ask_obb(throw, first, second)
        rows = np.flatnonzero(met)
        met[rows] = ask(throw, first[rows], second[rows])
        return met

    return refined


def _ask_meshes(throw: Throw, i: Rows, j: Rows) -> Mask:
    return mesh_collisions(throw.meshes, throw.meshes, np.stack([i, j], axis=1))


class Level(NamedTuple):
    """The name of an accuracy, and the function that decides pairs at it."""

    name: str
    ask: Callable[[Throw, Rows, Rows], Mask]


BOX_LEVELS = (
    Level("sphere", lambda t, i, j: spheres_may_collide(t.boxes, i, j)),
    Level("aabb", _ask_aabb),
    Level("obb", _ask_obb),
)
LEVELS = (
    *BOX_LEVELS,
    Level("hull", _refine(lambda t, i, j: hulls_may_collide(t.hulls, t.hulls, i, j))),
    Level("mesh", _refine(_ask_meshes)),
)


def levels_of(corpus: Corpus) -> tuple[Level, ...]:
    """Return the levels that a corpus has, from coarse to exact: boxes have none above ``obb``."""
    return BOX_LEVELS if corpus.boxes_only else LEVELS


class PreparedMesh(NamedTuple):
    """What is made of a mesh once: its trees, and the milliseconds each took."""

    mesh: MeshTrees
    hull: Hulls
    box_ms: float
    mesh_ms: float
    hull_ms: float


def prepare(mesh: Mesh) -> PreparedMesh:
    """Fit the box and build the trees of a mesh, timed."""
    start = thread_time()
    fit_points(mesh._points())
    box_ms = 1e3 * (thread_time() - start)
    _ = mesh.local_box  # the same again, kept: trees begin with it
    start = thread_time()
    triangles = mesh_tree(mesh)
    built = thread_time()
    hull = Hulls.of(hull_mesh(mesh)[0])
    mesh_ms, hull_ms = 1e3 * np.diff([start, built, thread_time()])
    return PreparedMesh(triangles, hull, box_ms, float(mesh_ms), float(hull_ms))


def prepare_ms(level: str, prepared: list[PreparedMesh]) -> float:
    """Return the mean milliseconds that a level needs once for a shape; boxes need none."""
    extra = {"mesh": "mesh_ms", "hull": "hull_ms"}.get(level)
    times = [p.box_ms + (getattr(p, extra) if extra else 0.0) for p in prepared]
    return float(np.mean(times)) if times else 0.0


def memory(level: str, boxes: Boxes, prepared: list[PreparedMesh]) -> float:
    """Return the bytes that a level reads of one object, float64, the mean over the shapes.

    A hull or mesh is stored once for all objects of one shape.
    """
    if level in ("hull", "mesh"):
        stored = [p.hull if level == "hull" else p.mesh.arrays for p in prepared]
        return float(np.mean([sum(array.nbytes for array in arrays) for arrays in stored]))
    read = {
        "sphere": (boxes.centers, boxes.half_extents[:, 0]),
        "aabb": boxes.world_bounds(),
        "obb": (boxes.centers, boxes.rotations, boxes.half_extents),
    }
    return sum(array.nbytes for array in read[level]) / len(boxes)


Ask = Callable[[], Mask]


class Query(NamedTuple):
    """Pairs (m,) and (m,) of bodies: body k has shape ``rows[k]`` at a pose.

    centers (n, 3), rotations (n, 3, 3).
    """

    rows: Rows
    centers: Floats
    rotations: Floats
    first: Rows
    second: Rows

    def pairs(self) -> list[tuple[int, int]]:
        """Return the pairs as plain integers, which Python loops over faster."""
        return list(zip(self.first.tolist(), self.second.tolist(), strict=True))


def _hull(shape: Shape) -> Any:
    assert isinstance(shape, Mesh)
    return convex_hull(np.unique(shape._points(), axis=0))


def fcl_box(fcl: Any, shape: Shape) -> Any:
    """Return python-fcl's box."""
    assert isinstance(shape, Box)
    return fcl.Box(*shape.size)


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
    pairs, request = query.pairs(), fcl.CollisionRequest()

    def run() -> Mask:
        collide, result = fcl.collide, fcl.CollisionResult
        hits = [collide(items[i], items[j], request, result()) > 0 for i, j in pairs]
        return np.array(hits, np.bool_)

    return run


def coal_box(coal: Any, shape: Shape) -> Any:
    """Return coal's box."""
    assert isinstance(shape, Box)
    return coal.Box(*shape.size)


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
    assert isinstance(shape, Mesh)
    hull = _hull(shape)
    model = coal_mesh(coal, Mesh(hull.vertices, hull.faces))
    model.buildConvexHull(True, "Qt")
    return model.convex


def ask_coal(coal: Any, made: list[Any], query: Query) -> Ask:
    """Return a function that queries coal for all pairs, without contact points."""
    shapes = [made[row] for row in query.rows]
    places = list(map(coal.Transform3s, query.rotations, query.centers))
    pairs, request, result = query.pairs(), coal.CollisionRequest(), coal.CollisionResult()
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
    """A peer: its name, what stands for a shape, its distribution, its module, how it is called."""

    name: str
    shape: str
    distribution: str
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
    Peer("python-fcl", "box", "python-fcl", "fcl", fcl_box, ask_fcl),
    Peer("coal", "box", "coal", "coal", coal_box, ask_coal),
)
MESH_PEERS = (
    Peer("python-fcl", "hull", "python-fcl", "fcl", fcl_hull, ask_fcl),
    Peer("coal", "hull", "coal", "coal", coal_hull, ask_coal),
    Peer("python-fcl", "mesh", "python-fcl", "fcl", fcl_mesh, ask_fcl),
    Peer("coal", "mesh", "coal", "coal", coal_mesh, ask_coal),
)

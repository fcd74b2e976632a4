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

"""The price on one corpus: the reports of every level and peer, and their times.

A level is used as in a ``Scene``: those above ``obb`` decide only the pairs that ``obb`` reports.

Peers are python-fcl and coal on pairs of boxes, hulls and meshes, called one pair at a time from
Python, as they are used: shapes and transforms are made beforehand, and a query sets poses where a
peer stores them in objects. A peer that is not installed is left out.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from time import perf_counter, thread_time
from typing import Any, NamedTuple

import numpy as np
from trimesh.convex import convex_hull

from obb_collision.accuracy import ALL_LEVELS, BOX_LEVELS
from obb_collision.benchmarks.corpora import Corpus, random_poses
from obb_collision.benchmarks.measuring import Show, take_turns
from obb_collision.geometry.fitting.fit import fit_points
from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.trees.convex_proxy import hull_mesh
from obb_collision.geometry.trees.pool import Hulls, mesh_tree
from obb_collision.scene.refinement.ladder import decide_pairs
from obb_collision.scene.scene import Scene
from obb_collision.shapes import Box, Shape
from obb_collision.typing import Floats, Mask, Rows

#: Cubic metres per body of one metre diagonal: gives about two candidate pairs per body.
VOLUME_PER_BODY = 0.3
#: Poses that the steps go through in turn.
CONTEST_FRAMES = 4
#: Shares of preparing shapes, deciding and timing pairs in the time of a corpus; the steps get the
#: rest.
PREPARING, ASKING, TIMING = 0.4, 0.25, 0.2
#: Pairs of levels: the first must report all pairs of the second.
NESTED = (("sphere", "obb"), ("aabb", "obb"), ("obb", "hull"), ("hull", "mesh"))
#: Our level that a peer's shape is compared with.
OUR_LEVELS = {"box": "obb", "hull": "hull", "mesh": "mesh"}
#: Bytes of one object that a level reads, float64; a hull or mesh is stored once per shape.
LEVEL_BYTES = {"sphere": 8.0 * 4, "aabb": 8.0 * 6, "obb": 8.0 * 15}


@dataclass
class ContestRow:
    """The cost and the errors of a level or peer; None where not measured."""

    name: str
    peer: bool
    pair_ns: float = 0.0
    step_ms: float | None = None
    bytes: float | None = None
    prepare_ms: float | None = None
    reports: int = 0
    false: int = 0  #: reports of bodies whose triangles do not collide
    missed: int = 0  #: bodies whose triangles collide, not reported

    def count(self, reported: Rows, truth: Rows) -> None:
        """Add the pairs that were reported, as sorted numbers."""
        self.reports += len(reported)
        self.false += len(np.setdiff1d(reported, truth))
        self.missed += len(np.setdiff1d(truth, reported))

    @property
    def false_of_reports(self) -> float:
        """Share of the reports that are false."""
        return self.false / max(1, self.reports)


@dataclass
class Price:
    """The rows of a corpus, and ratios between them."""

    corpus: str
    note: str
    shapes: int
    bodies: int
    pairs: int = 0
    colliding: int = 0
    rows: list[ContestRow] = field(default_factory=list)
    out_of_order: int = 0  #: pairs that a more exact level reports and a coarser one doesn't
    ratios: dict[str, float] = field(default_factory=dict)  #: peer's time over that of our level
    missing: list[str] = field(default_factory=list)  #: peers that are not installed

    @property
    def missed(self) -> int:
        """Pairs that a level of ours must report and does not: none, or there is a defect."""
        return self.out_of_order + sum(row.missed for row in self.rows if not row.peer)

    def row(self, name: str) -> ContestRow:
        """Return the row of a name."""
        return next(row for row in self.rows if row.name == name)


class ContestPlan(NamedTuple):
    """Bodies in the room, pairs decided, pairs timed, and seconds for all of it."""

    bodies: int
    pairs: int
    timed: int
    seconds: float


def report_pairs(scene: Scene, level: str) -> Rows:
    """Return the pairs (m, 2) that a scene reports on a level."""
    scene.accuracy = level
    return scene.check().pairs


class Contest:
    """Our levels and the installed peers, on the same pairs of the same bodies."""

    def __init__(self, corpus: Corpus, plan: ContestPlan, seed: int) -> None:
        shapes = list(corpus.shapes.values())
        self.levels = BOX_LEVELS if corpus.boxes_only else ALL_LEVELS
        self.price = Price(corpus.name, corpus.note, len(shapes), plan.bodies)
        self.price.rows = [ContestRow(level, peer=False) for level in self.levels]
        self._rng = np.random.default_rng(seed)
        self._shapes = np.arange(plan.bodies) % len(shapes)
        self._poses: Floats = np.empty((0, 7))
        self.scene = Scene()
        for k, row in enumerate(self._shapes):
            self.scene.add(f"{k}", shapes[row])
        self.peers: dict[str, Callable[[Query], Ask]] = {}
        for peer in BOX_PEERS if corpus.boxes_only else MESH_PEERS:
            try:
                self.peers[peer.label] = peer.load(shapes)
            except ImportError:
                self.price.missing.append(peer.label)
        self.price.rows += [ContestRow(label, peer=True) for label in self.peers]

    def _ask_peers(self, pairs: Rows) -> dict[str, Ask]:
        """Return, by the names of the peers, functions that decide pairs (m, 2)."""
        query = Query(self._shapes, *as_poses(self._poses), pairs)
        return {label: load(query) for label, load in self.peers.items()}

    def count(self, pairs: int, end: float) -> Rows:
        """Count false and missed reports for random poses; return the last candidates."""
        price = self.price
        while True:
            self._poses = random_poses(len(self._shapes), VOLUME_PER_BODY, self._rng)
            self.scene.move_indices(self.scene.indices, self._poses)
            reports = {level: report_pairs(self.scene, level) for level in self.levels}
            candidates = reports["aabb"]
            reports |= {
                name: candidates[ask()] for name, ask in self._ask_peers(candidates).items()
            }
            codes: dict[str, Rows] = {
                name: len(self._shapes) * rows[:, 0] + rows[:, 1] for name, rows in reports.items()
            }
            truth = codes[self.levels[-1]]
            price.pairs += len(candidates)
            price.colliding += len(truth)
            for row in price.rows:
                row.count(codes[row.name], truth)
            price.out_of_order += sum(
                len(np.setdiff1d(codes[exact], codes[coarse]))
                for coarse, exact in NESTED
                if exact in codes
            )
            if price.pairs >= pairs or perf_counter() > end:
                return candidates

    def time_pairs(self, candidates: Rows, count: int, seconds: float) -> None:
        """Time all contestants on the same random candidates, in their order.

        Before its turn each level decides as many other pairs of the same bodies: in a scene the
        bodies are in the caches as well, and the processor would predict the branches of repeated
        pairs.
        """
        order = self._rng.permutation(len(candidates))
        chosen, others = (
            candidates[np.sort(rows)] for rows in (order[:count], order[count : 2 * count])
        )
        objects = self.scene.objects

        def deciding(pairs: Rows) -> Callable[[], object]:
            return partial(decide_pairs, objects.store, objects.cache, pairs, False)

        def choose(level: str) -> None:
            self.scene.accuracy = level
            decide_others()

        decide_others = deciding(others)
        asked: dict[str, Callable[[], object]] = dict.fromkeys(self.levels, deciding(chosen))
        asked |= self._ask_peers(chosen)
        times = take_turns(asked, seconds, {level: partial(choose, level) for level in self.levels})
        for row in self.price.rows:
            row.pair_ns = 1e9 * times.best(row.name) / max(1, len(chosen))
        ours = {label: OUR_LEVELS[label.split()[-1]] for label in self.peers}
        self.price.ratios = {label: times.ratio(label, level) for label, level in ours.items()}

    def time_steps(self, seconds: float) -> None:
        """Time setting every pose and finding every pair in a ``Scene``, on each level in turn."""
        scene, steps = self.scene, 0
        frames = [
            random_poses(len(self._shapes), VOLUME_PER_BODY, self._rng)
            for _ in range(CONTEST_FRAMES)
        ]

        def choose(level: str) -> None:
            scene.accuracy = level

        def step() -> None:
            nonlocal steps
            scene.move_indices(scene.indices, frames[steps // len(self.levels) % CONTEST_FRAMES])
            scene.check()
            steps += 1

        for level in self.levels:
            choose(level)
            step()
        before = {level: partial(choose, level) for level in self.levels}
        times = take_turns(dict.fromkeys(self.levels, step), seconds, before)
        for level in self.levels:
            self.price.row(level).step_ms = 1e3 * times.best(level)


def measure(corpus: Corpus, plan: ContestPlan, seed: int, show: Show) -> Price:
    """Measure all levels and the installed peers on a corpus, in about ``plan.seconds``.

    Only shapes prepared in their share of the time take part, but at least one.
    """
    start = perf_counter()
    shapes = dict(corpus.shapes)
    once: list[dict[str, tuple[float, float]]] = []
    for k, (name, shape) in enumerate(corpus.shapes.items()):
        if isinstance(shape, Mesh):
            if once and perf_counter() > start + PREPARING * plan.seconds:
                del shapes[name]
                continue
            show(f"{corpus.name}: trees {k + 1}/{len(corpus.shapes)}")
            once.append(_prepare(shape))
    show(f"{corpus.name}: what each level and peer reports")
    contest = Contest(Corpus(corpus.name, shapes, corpus.note), plan, seed)
    candidates = contest.count(plan.pairs, perf_counter() + ASKING * plan.seconds)
    show(f"{corpus.name}: time per pair, in turn")
    contest.time_pairs(candidates, plan.timed, TIMING * plan.seconds)
    show(f"{corpus.name}: time per step, in turn")
    contest.time_steps(start + plan.seconds - perf_counter())
    for level in contest.levels:
        row, (size, ms) = contest.price.row(level), (LEVEL_BYTES.get(level, 0.0), 0.0)
        if once:
            size, ms = np.mean([costs[level] for costs in once], axis=0).tolist()
        row.bytes, row.prepare_ms = size, ms
    return contest.price


def _prepare(shape: Mesh) -> dict[str, tuple[float, float]]:
    """Return, by level, the bytes of a mesh and the milliseconds to prepare its data once."""
    start = thread_time()
    fit_points(shape._points())
    box_ms = 1e3 * (thread_time() - start)
    _ = shape.local_box  # the same again, kept: trees begin with it
    costs = {level: (size, box_ms) for level, size in LEVEL_BYTES.items()}
    for level, make in (
        ("hull", lambda: Hulls.of(hull_mesh(shape)[0])),
        ("mesh", lambda: mesh_tree(shape).arrays),
    ):
        start = thread_time()
        arrays: Any = make()
        took = 1e3 * (thread_time() - start)
        costs[level] = float(sum(array.nbytes for array in arrays)), box_ms + took
    return costs


Ask = Callable[[], Mask]


class Query(NamedTuple):
    """Pairs (m, 2) of bodies, their poses, and the shape ``rows[k]`` of body k."""

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
    """A peer: its distribution, the kind of shape, its module, and functions to call it."""

    name: str
    shape: str
    module: str
    make: Callable[[Any, Shape], Any]
    ask: Callable[[Any, list[Any], Query], Ask]

    @property
    def label(self) -> str:
        """The name of the peer and the kind of shape."""
        return f"{self.name} {self.shape}"

    def load(self, shapes: Iterable[Shape]) -> Callable[[Query], Ask]:
        """Make the shapes and return the function that prepares a query."""
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

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

"""The price on one corpus: what every level and peer reports, and the time it takes.

A level is used as in a ``Scene``: those above ``obb`` decide only the pairs that ``obb`` reports.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from time import perf_counter, thread_time
from typing import Any, NamedTuple

import numpy as np

from obb_collision.accuracy import ALL_LEVELS, BOX_LEVELS
from obb_collision.benchmarks.corpora import Corpus, random_poses
from obb_collision.benchmarks.measuring import Show, take_turns
from obb_collision.benchmarks.peers import BOX_PEERS, MESH_PEERS, Ask, Query
from obb_collision.geometry.fitting.fit import fit_points
from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.trees.convex_proxy import hull_mesh
from obb_collision.geometry.trees.pool import Hulls, mesh_tree
from obb_collision.scene.refinement.ladder import decide_pairs
from obb_collision.scene.scene import Scene
from obb_collision.typing import Floats, Rows

#: Cubic metres per body of one metre diagonal: gives about two candidate pairs per body.
VOLUME_PER_BODY = 0.3
#: Poses that the steps go through in turn.
FRAMES = 4
#: Shares of preparing shapes, deciding and timing pairs in the time of a corpus; the steps get the
#: rest.
PREPARING, ASKING, TIMING = 0.4, 0.25, 0.2
#: Levels that must report all that the next one does, each.
NESTED = (("sphere", "obb"), ("aabb", "obb"), ("obb", "hull"), ("hull", "mesh"))
#: Our level that a peer's shape is compared with.
OURS = {"box": "obb", "hull": "hull", "mesh": "mesh"}
#: Bytes of one object that a level reads, float64; a hull or mesh is stored once per shape.
BYTES = {"sphere": 8.0 * 4, "aabb": 8.0 * 6, "obb": 8.0 * 15}


@dataclass
class ContestRow:
    """A level or peer: what it costs and how often it is wrong; None if not measured."""

    name: str
    peer: bool
    pair_ns: float = 0.0
    step_ms: float | None = None
    bytes: float | None = None
    prepare_ms: float | None = None
    reports: int = 0
    false: int = 0  #: reports of bodies whose triangles do not collide
    missed: int = 0  #: bodies whose triangles collide, not reported

    def count(self, found: Rows, truth: Rows) -> None:
        """Add the pairs that were found, as sorted numbers."""
        self.reports += len(found)
        self.false += len(np.setdiff1d(found, truth))
        self.missed += len(np.setdiff1d(truth, found))

    @property
    def false_of_reports(self) -> float:
        """Share of the reports that are false."""
        return self.false / max(1, self.reports)

    def as_dict(self) -> dict[str, Any]:
        """Return all numbers, the share included."""
        return asdict(self) | {"false_of_reports": self.false_of_reports}


@dataclass
class Price:
    """The rows of a corpus and what compares two of them."""

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

    def _throw(self) -> None:
        """Move all bodies to random poses."""
        self._poses = random_poses(len(self._shapes), VOLUME_PER_BODY, self._rng)
        self.scene.move_indices(self.scene.indices, self._poses)

    def _ask_peers(self, pairs: Rows) -> dict[str, Ask]:
        """Return by name what asks a peer for pairs (m, 2)."""
        query = Query(self._shapes, *as_poses(self._poses), pairs)
        return {label: load(query) for label, load in self.peers.items()}

    def count(self, pairs: int, end: float) -> Rows:
        """Count false and missed reports in throw after throw; return the last candidates."""
        price = self.price
        while True:
            self._throw()
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
        """Time all on the same random candidates, in the order in which they come.

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
        ours = {label: OURS[label.split()[-1]] for label in self.peers}
        self.price.ratios = {label: times.ratio(label, level) for label, level in ours.items()}

    def time_steps(self, seconds: float) -> None:
        """Time setting every pose and finding every pair in a ``Scene``, on each level in turn."""
        scene, steps = self.scene, 0
        frames = [
            random_poses(len(self._shapes), VOLUME_PER_BODY, self._rng) for _ in range(FRAMES)
        ]

        def choose(level: str) -> None:
            scene.accuracy = level

        def step() -> None:
            nonlocal steps
            scene.move_indices(scene.indices, frames[steps // len(self.levels) % FRAMES])
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

    Of its shapes those that are prepared in their share of the time, one at least.
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
        row, (size, ms) = contest.price.row(level), (BYTES.get(level, 0.0), 0.0)
        if once:
            size, ms = np.mean([one[level] for one in once], axis=0).tolist()
        row.bytes, row.prepare_ms = size, ms
    return contest.price


def _prepare(shape: Mesh) -> dict[str, tuple[float, float]]:
    """Return by level the bytes of a mesh, and the milliseconds that what it needs takes once."""
    start = thread_time()
    fit_points(shape._points())
    box_ms = 1e3 * (thread_time() - start)
    _ = shape.local_box  # the same again, kept: trees begin with it
    found = {level: (size, box_ms) for level, size in BYTES.items()}
    for level, make in (
        ("hull", lambda: Hulls.of(hull_mesh(shape)[0])),
        ("mesh", lambda: mesh_tree(shape).arrays),
    ):
        start = thread_time()
        arrays: Any = make()
        took = 1e3 * (thread_time() - start)
        found[level] = float(sum(array.nbytes for array in arrays)), box_ms + took
    return found

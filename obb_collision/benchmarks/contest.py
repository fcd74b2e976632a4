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

"""The price on one corpus: what every level and peer reports, and the time it takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import islice
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from obb_collision.benchmarks.corpora import Corpus
from obb_collision.benchmarks.levels import (
    BOX_PEERS,
    MESH_PEERS,
    Ask,
    Crowd,
    Level,
    PreparedMesh,
    Query,
    Throw,
    levels_of,
    memory,
    prepare,
    prepare_ms,
)
from obb_collision.benchmarks.timing import Show, take_turns
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.typing import Mask, Rows

#: Poses that the steps go through in turn.
FRAMES = 4
#: Shares of preparing shapes, deciding and timing pairs in the time of a corpus; the steps get the
#: rest.
PREPARING, ASKING, TIMING = 0.4, 0.25, 0.2
#: Levels that must report all that the next one does, each.
NESTED = (("sphere", "obb"), ("aabb", "obb"), ("obb", "hull"), ("hull", "mesh"))
#: Our level that a peer's shape is compared with.
OURS = {"box": "obb", "hull": "hull", "mesh": "mesh"}


@dataclass
class ContestRow:
    """A level or peer: what it costs and how often it is wrong; None if not measured."""

    name: str
    peer: bool
    pair_ns: float = 0.0
    step_ms: float | None = None
    bytes: float | None = None
    prepare_ms: float | None = None
    pairs: int = 0  #: candidates decided
    reports: int = 0
    false: int = 0  #: reports of bodies whose triangles do not collide
    missed: int = 0  #: bodies whose triangles collide, not reported

    def count(self, answers: Mask, truth: Mask) -> None:
        """Add the results for pairs."""
        self.pairs += len(truth)
        self.reports += int(answers.sum())
        self.false += int((answers & ~truth).sum())
        self.missed += int((truth & ~answers).sum())

    @property
    def false_of_reports(self) -> float:
        """Share of the reports that are false."""
        return self.false / max(1, self.reports)

    @property
    def false_of_pairs(self) -> float:
        """Share of the candidates that are falsely reported."""
        return self.false / max(1, self.pairs)

    def as_dict(self) -> dict[str, Any]:
        """Return all numbers, the shares included."""
        shares = {name: getattr(self, name) for name in ("false_of_reports", "false_of_pairs")}
        return asdict(self) | shares


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


class Contest:
    """Our levels and the installed peers, on the same pairs of the same bodies."""

    def __init__(
        self, corpus: Corpus, prepared: list[PreparedMesh], plan: ContestPlan, seed: int
    ) -> None:
        self.prepared = prepared
        self.accuracies = levels_of(corpus)
        self.price = Price(corpus.name, corpus.note, len(corpus.shapes), plan.bodies)
        self.price.rows = [ContestRow(level.name, peer=False) for level in self.accuracies]
        self._rng = np.random.default_rng(seed)
        self.bodies = Crowd(corpus, plan.bodies, seed)
        if prepared:
            self.bodies.use_trees([p.mesh for p in prepared], [p.hull for p in prepared])
        self.peers: dict[str, Callable[[Query], Ask]] = {}
        for peer in BOX_PEERS if corpus.boxes_only else MESH_PEERS:
            try:
                self.peers[peer.label] = peer.load(corpus.shapes.values())
            except ImportError:
                self.price.missing.append(peer.label)
        self.price.rows += [ContestRow(label, peer=True) for label in self.peers]

    def ask_all(self, throw: Throw, first: Rows, second: Rows) -> dict[str, Ask]:
        """Return by name the function that decides the pairs of a throw."""
        asks: dict[str, Ask] = {}
        for level in self.accuracies:
            asks[level.name] = partial(level.ask, throw, first, second)
        query = Query(throw.rows, throw.centers, throw.rotations, first, second)
        return asks | {label: load(query) for label, load in self.peers.items()}

    def count(self, pairs: int, end: float) -> Throw:
        """Count false and missed reports in throw after throw; return the last one."""
        while True:
            throw = self.bodies.throw()
            asks = self.ask_all(throw, throw.first, throw.second)
            answers = {name: ask() for name, ask in asks.items()}
            truth = answers[self.accuracies[-1].name]
            self.price.pairs += len(truth)
            self.price.colliding += int(truth.sum())
            for row in self.price.rows:
                row.count(answers[row.name], truth)
            _count_far_spheres(self.price.row("sphere"), throw, answers["sphere"])
            self.price.out_of_order += sum(
                int((answers[exact] & ~answers[coarse]).sum())
                for coarse, exact in NESTED
                if exact in answers
            )
            if self.price.pairs >= pairs or perf_counter() > end:
                return throw

    def time_pairs(self, throw: Throw, count: int, seconds: float) -> None:
        """Time all on the same random pairs, in the order in which they come.

        Before its turn each level decides as many other pairs of the same bodies: in a scene the
        bodies are in the caches as well, and the processor would predict the branches of repeated
        pairs.
        """
        order = self._rng.permutation(len(throw.first))
        chosen, others = np.sort(order[:count]), np.sort(order[count : 2 * count])
        contestants = self.ask_all(throw, throw.first[chosen], throw.second[chosen])
        before: dict[str, Callable[[], Any]] = dict.fromkeys(contestants, lambda: None)
        for level in self.accuracies:
            rows = throw.first[others], throw.second[others]
            before[level.name] = partial(level.ask, throw, *rows)
        times = take_turns(contestants, seconds, before)
        for row in self.price.rows:
            row.pair_ns = 1e9 * times.best(row.name) / max(1, len(chosen))
        ours = {label: OURS[label.split()[-1]] for label in self.peers}
        self.price.ratios = {label: times.ratio(label, level) for label, level in ours.items()}

    def time_steps(self, seconds: float) -> None:
        """Time setting every pose and finding every pair in a ``Scene``, on each level in turn."""
        scene, indices = self.bodies.scene, self.bodies.scene.indices
        frames = [self.bodies.poses() for _ in range(FRAMES)]
        steps = 0

        def choose(level: Level) -> None:
            scene.accuracy = level.name

        def step() -> None:
            nonlocal steps
            scene.move_indices(indices, frames[steps // len(self.accuracies) % FRAMES])
            scene.check()
            steps += 1

        for level in self.accuracies:  # builds trees, compiles what is new
            choose(level)
            step()
        before = {level.name: partial(choose, level) for level in self.accuracies}
        times = take_turns({level.name: step for level in self.accuracies}, seconds, before)
        for level in self.accuracies:
            self.price.row(level.name).step_ms = 1e3 * times.best(level.name)

    def weigh(self, throw: Throw) -> None:
        """Measure the memory of each level, and its time of preparation."""
        for level in self.accuracies:
            row = self.price.row(level.name)
            row.bytes = memory(level.name, throw.boxes, self.prepared)
            row.prepare_ms = prepare_ms(level.name, self.prepared)


def measure(corpus: Corpus, plan: ContestPlan, seed: int, show: Show) -> Price:
    """Measure all levels and the installed peers on a corpus, in about ``plan.seconds``."""
    start = perf_counter()
    end = start + plan.seconds
    corpus, prepared = _prepared(corpus, start + PREPARING * plan.seconds, show)
    show(f"{corpus.name}: what each level and peer reports")
    contest = Contest(corpus, prepared, plan, seed)
    throw = contest.count(plan.pairs, perf_counter() + ASKING * plan.seconds)
    show(f"{corpus.name}: time per pair, in turn")
    contest.time_pairs(throw, plan.timed, TIMING * plan.seconds)
    show(f"{corpus.name}: time per step, in turn")
    contest.time_steps(end - perf_counter())
    contest.weigh(throw)
    return contest.price


def _prepared(corpus: Corpus, end: float, show: Show) -> tuple[Corpus, list[PreparedMesh]]:
    """Return the meshes that were prepared before ``end``, one at least, and their trees."""
    prepared: list[PreparedMesh] = []
    for k, shape in enumerate(corpus.shapes.values()):
        if isinstance(shape, Mesh) and (k == 0 or perf_counter() < end):
            show(f"{corpus.name}: trees {k + 1}/{len(corpus.shapes)}")
            prepared.append(prepare(shape))
    if prepared:
        corpus = replace(corpus, shapes=dict(islice(corpus.shapes.items(), len(prepared))))
    return corpus, prepared


def _count_far_spheres(row: ContestRow, throw: Throw, near: Mask) -> None:
    """Count the spheres that collide though the AABBs do not, and their candidates."""
    pairs, meet = throw.sphere_counts
    far = meet - int(near.sum())
    row.pairs += pairs - len(near)
    row.reports += far
    row.false += far

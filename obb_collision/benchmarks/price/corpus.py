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

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, product
from time import perf_counter
from typing import Any

import numpy as np

from obb_collision.benchmarks.price.levels import Bodies, Level, Throw, levels_of
from obb_collision.benchmarks.price.peers import BOX_PEERS, MESH_PEERS, Ask, Query
from obb_collision.benchmarks.price.rows import Price, Row
from obb_collision.benchmarks.price.scenes import Corpus
from obb_collision.benchmarks.price.turns import Times, take_turns
from obb_collision.benchmarks.price.upkeep import Prepared, memory, prepare, prepare_ms
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.queries.meshes.meshes import mesh_collisions
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.typing import Mask, Rows

#: Poses that the steps go through in turn.
FRAMES = 4
#: Shares of preparing shapes, deciding and timing pairs in the time of a corpus; the steps get the
#: rest.
PREPARING, ASKING, TIMING = 0.4, 0.25, 0.2
#: Levels that must report all that others do.
WIDER = {
    "sphere": ("obb",),
    "aabb": ("obb",),
    "obb_faces": ("obb",),
    "obb": ("obb_tree", "hull"),
    "obb_tree": ("mesh",),
    "hull": ("mesh",),
}
#: Our level that a peer's shape is compared with.
OURS = {"box": "obb", "hull": "hull", "mesh": "mesh"}
#: The peer whose triangles are compared with ours.
SURFACES = "python-fcl mesh"

Show = Callable[[str], None]


@dataclass(frozen=True)
class Plan:
    """Bodies in the room, pairs decided, pairs timed, and seconds for all of it."""

    bodies: int
    pairs: int
    timed: int
    seconds: float


class Contest:
    """Our levels and the installed peers, on the same pairs of the same bodies."""

    def __init__(self, corpus: Corpus, prepared: list[Prepared], plan: Plan, seed: int) -> None:
        self.prepared = prepared
        self.accuracies = levels_of(corpus)
        self.price = Price(corpus.name, corpus.note, len(corpus.shapes), plan.bodies)
        self.price.rows = [Row(level.name, peer=False) for level in self.accuracies]
        self._rng = np.random.default_rng(seed)
        self.bodies = Bodies(corpus, plan.bodies, seed)
        if prepared:
            self.bodies.use_trees([p.mesh for p in prepared], [p.hull for p in prepared])
        self.peers: dict[str, Callable[[Query], Ask]] = {}
        for peer in BOX_PEERS if corpus.boxes_only else MESH_PEERS:
            try:
                self.peers[peer.label] = peer.load(corpus.shapes.values())
            except ImportError:
                self.price.missing.append(peer.label)
        self.price.rows += [Row(label, peer=True) for label in self.peers]

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
                int((answers[exact.name] & ~answers[coarse.name]).sum())
                for coarse, exact in _ordered(self.accuracies)
            )
            if SURFACES in answers:
                _compare_surfaces(self.price, throw, answers[SURFACES])
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
        self.price.ratios = self._ratios(times)

    def _ratios(self, times: Times) -> dict[str, float]:
        """Return how many times longer each peer takes than our level of the same shape."""
        return {label: times.ratio(label, OURS[label.split()[-1]]) for label in self.peers}

    def time_steps(self, seconds: float) -> None:
        """Time setting every pose and finding every pair in a ``Scene``, on each level in turn."""
        scene, indices = self.bodies.scene, self.bodies.scene.indices
        frames = [self.bodies.poses() for _ in range(FRAMES)]
        steps = 0

        def choose(level: Level) -> None:
            scene.accuracy = level.accuracy
            if level.depth is not None:
                scene.tree_depth = level.depth

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
            row.bytes = memory(level, throw.boxes, self.prepared)
            row.prepare_ms = prepare_ms(level, self.prepared)


def measure(corpus: Corpus, plan: Plan, seed: int, show: Show) -> Price:
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


def _prepared(corpus: Corpus, end: float, show: Show) -> tuple[Corpus, list[Prepared]]:
    """Return the meshes that were prepared before ``end``, one at least, and their trees."""
    prepared: list[Prepared] = []
    for k, shape in enumerate(corpus.shapes.values()):
        if isinstance(shape, Mesh) and (k == 0 or perf_counter() < end):
            show(f"{corpus.name}: trees {k + 1}/{len(corpus.shapes)}")
            prepared.append(prepare(shape))
    if prepared:
        corpus = replace(corpus, shapes=dict(islice(corpus.shapes.items(), len(prepared))))
    return corpus, prepared


def _ordered(levels: tuple[Level, ...]) -> Iterator[tuple[Level, Level]]:
    """Yield pairs of levels of which the first must report all that the second does."""
    for coarse, exact in product(levels, levels):
        deeper = coarse.depth is not None and exact.depth is not None and coarse.depth < exact.depth
        if exact.accuracy in WIDER.get(coarse.accuracy, ()) or deeper:
            yield coarse, exact


def _count_far_spheres(row: Row, throw: Throw, near: Mask) -> None:
    """Count the spheres that collide though the AABBs do not, and their candidates."""
    pairs, meet = throw.sphere_counts
    far = meet - int(near.sum())
    row.pairs += pairs - len(near)
    row.reports += far
    row.false += far


def _compare_surfaces(price: Price, throw: Throw, answers: Mask) -> None:
    """Count where a peer's triangles disagree with ours, ours as surfaces like the peer's."""
    placed = throw.meshes
    arrays = placed.trees.arrays._asdict()
    hollow = MeshTrees(**arrays | {"solid": np.zeros_like(placed.trees.solid)})
    bodies = PlacedMeshes(hollow, placed.meshes, placed.centers, placed.rotations)
    ours = mesh_collisions(bodies, bodies, np.stack([throw.first, throw.second], axis=1))
    price.surface_pairs += len(ours)
    price.surface_differ += int((ours != answers).sum())

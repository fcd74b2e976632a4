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


"""What this library is meant to reach, measured in one run: ``obb_collision speed --goals``.

Ours uses as many threads as there are cores, MuJoCo, coal and python-fcl one each, and MuJoCo makes
contacts where we may compute less: the tables beside say what each does. All take turns on the
same poses; what is compared are medians of at least 20 steps.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from time import perf_counter
from typing import Any

import numpy as np

from obb_collision._threads import threads
from obb_collision.benchmarks.cases.forms import FORMS, make_frames
from obb_collision.benchmarks.peers.steps import (
    COAL,
    CONTACTS,
    MUJOCO,
    PAIRS,
    SCENE,
    SEPARATIONS,
    Contestant,
)
from obb_collision.benchmarks.price import corpus, scenes
from obb_collision.benchmarks.step.measure import Case, Note, Plan, Row, own_settings, run_case
from obb_collision.benchmarks.step.tables import best_coal, digits
from obb_collision.benchmarks.step.wanted import Goal, below, missing, node_goals, ratio
from obb_collision.scene.scene import Scene

Show = Callable[[str], None]
#: Returns a row per way of sending objects to the node: the way, objects, milliseconds.
MeasureNode = Callable[[Show], list[dict[str, Any]]]

#: How many times as fast as MuJoCo, at these sizes.
SIZES = (1_000, 10_000)
BESIDE_MUJOCO = {PAIRS: (4.0, 8.0), SEPARATIONS: (3.0, 6.0), CONTACTS: (2.0, 4.0)}
#: How many times as fast as coal, in every form; and at most, from one size to one ten times that.
BESIDE_COAL, GROWTH = 8.0, 12.0
FORM_BOXES, LARGE = 10_000, (10_000, 100_000, 1_000_000)
#: How much quicker when 1 % moves; microseconds of an unchanged scene, and of ten boxes.
FEW_MOVE, UNCHANGED_US, TEN_US = 10.0, 20.0, 40.0
#: Per pair of meshes and of hulls, how many times as fast as each peer.
PER_PAIR = {"mesh": {"python-fcl": 3.0, "coal": 4.0}, "hull": {"python-fcl": 6.0, "coal": 8.0}}
#: Seconds for those pairs; and turns of what takes microseconds.
PAIR_SECONDS, SHORT_TURNS, BOXES_TURNS = 30.0, 2_000, 100


class Goals:
    """Measures the goals, and holds the rows and notes of the scenes on the way.

    node: what measures the node, which needs ROS; None where it is not installed.
    """

    def __init__(self, plan: Plan, show: Show, node: MeasureNode | None) -> None:
        self._node = node
        self.node_rows: list[dict[str, Any]] = []
        self.rows: list[Row] = []
        self.notes: list[Note] = []
        self._plan, self._show = plan, show

    def _run(self, case: Case, contestants: Sequence[Contestant]) -> dict[str, Row]:
        rows, notes = run_case(case, contestants, [threads()], self._plan, self._show)
        self.rows += rows
        self.notes += notes
        return {row.name: row for row in rows}

    def beside_mujoco(self) -> Iterator[Goal]:
        """Measure all moving boxes beside MuJoCo, with what it makes and less."""
        for k, boxes in enumerate(SIZES):
            found = self._run(Case(boxes=boxes), [*BESIDE_MUJOCO, MUJOCO])
            for ours, wanted in BESIDE_MUJOCO.items():
                what = f"{ours.name}, {boxes:,} boxes"
                if MUJOCO.name not in found:
                    yield missing(what, MUJOCO.name, "not installed")
                    continue
                row, theirs = found[ours.name], found[MUJOCO.name]
                beside = f"{MUJOCO.name} (contacts)"
                yield ratio(what, beside, wanted[k], row.median_ms, theirs.median_ms, "ms")

    def beside_coal(self) -> Iterator[Goal]:
        """Measure every form beside the best broad phase of coal."""
        for form in FORMS:
            case = Case(form, FORM_BOXES)
            found = self._run(case, [SEPARATIONS, *COAL])
            what, best = f"{SEPARATIONS.name}, {form}", best_coal(self.rows, case)
            if best is None:
                yield missing(what, "coal", "not installed")
                continue
            ours = found[SEPARATIONS.name].median_ms
            yield ratio(what, best.name, BESIDE_COAL, ours, best.median_ms, "ms")

    def growth(self) -> Iterator[Goal]:
        """Measure how time grows from ten thousand boxes to a million."""
        sizes = [self._run(Case(boxes=n), [PAIRS, SEPARATIONS]) for n in LARGE]
        for one in (PAIRS, SEPARATIONS):
            for k in (1, 2):
                a, b = (sizes[j][one.name].median_ms for j in (k - 1, k))
                what = f"{one.name}, {LARGE[k]:,} boxes"
                text = f"{b / a:.1f} times: {digits(a)} and {digits(b)} ms"
                wanted = f"at most {GROWTH:g} times"
                yield Goal(what, f"{LARGE[k - 1]:,}", wanted, text, b / a <= GROWTH)

    def few_move(self) -> Iterator[Goal]:
        """Measure a scene of which 1 % moves, beside one in which all do."""
        scenes = []
        for moving in (1.0, 0.01):
            half_extents, frames = make_frames("uniform", LARGE[0], moving, self._plan.seed)
            scenes.append((SCENE.make(half_extents, frames[0].poses), frames))
        times = np.empty((BOXES_TURNS, 2))
        with own_settings():
            for turn in range(BOXES_TURNS):
                for k, (scene, frames) in enumerate(scenes):
                    frame = frames[turn % len(frames)]
                    start = perf_counter()
                    scene.step(frame)
                    times[turn, k] = perf_counter() - start
        all_move, few = 1e3 * np.median(times, axis=0)
        what = f"Scene, 1 % of {LARGE[0]:,} moving"
        yield ratio(what, "ours, all moving", FEW_MOVE, few, all_move, "ms")

    def small(self) -> Iterator[Goal]:
        """Measure an unchanged scene, and one of ten boxes that all move."""
        half_extents, frames = make_frames("uniform", LARGE[0], 0.0, self._plan.seed)
        scene = _scene(half_extents, frames[0].poses)
        what = f"{LARGE[0]:,} boxes unchanged, the last report"
        held = [scene.check()]
        yield below(f"{what} held", UNCHANGED_US, _microseconds(scene.check), "µs")
        held.clear()
        yield below(f"{what} not held", UNCHANGED_US, _microseconds(scene.check), "µs")
        half_extents, frames = make_frames("uniform", 10, 1.0, self._plan.seed)
        ten, indices, turn = _scene(half_extents, frames[0].poses), np.arange(10), [0]

        def step() -> object:
            turn[0] += 1
            ten.move_indices(indices, frames[turn[0] % len(frames)].poses)
            return ten.check().pairs

        yield below("10 boxes: move_indices, check, pairs read", TEN_US, _microseconds(step), "µs")

    def per_pair(self) -> Iterator[Goal]:
        """Measure hulls and meshes per pair, on meshes that trimesh makes."""
        plan = corpus.Plan(2_000, 20_000, 2_000, PAIR_SECONDS)
        made = scenes.generated_corpus(self._plan.seed)
        price = corpus.measure(made, plan, self._plan.seed, self._show)
        found = {row.name: row for row in price.rows}
        for level, peers in PER_PAIR.items():
            for peer, wanted in peers.items():
                theirs = found.get(f"{peer} {level}")
                if theirs is None:
                    yield missing(f"{level} per pair", peer, "not installed")
                    continue
                ours = found[level].pair_ns
                yield ratio(f"{level} per pair", peer, wanted, ours, theirs.pair_ns, "ns")

    def node(self) -> Iterator[Goal]:
        """Measure the node from message to message."""
        if self._node is None:
            yield missing("node", "", "ROS is not installed here")
        else:
            self.node_rows = self._node(self._show)
            yield from node_goals(self.node_rows)

    def starts(self) -> Iterator[Goal]:
        """Measure what an empty cache costs."""
        from obb_collision.benchmarks.step.starts import measure_starts

        for what, wanted, seconds in measure_starts(self._show):
            yield below(what, wanted, seconds, "s")

    def all(self) -> Iterator[Goal]:
        """Measure everything; what fails is a goal that was not measured, and the others go on."""
        for part in (
            *(self.beside_mujoco, self.beside_coal, self.growth, self.few_move, self.small),
            *(self.node, self.starts, self.per_pair),
        ):
            try:
                yield from part()
            except Exception as error:
                print(f"{part.__name__}: {error!r}", file=sys.stderr)
                yield missing(part.__name__.replace("_", " "), "", repr(error))


def _scene(half_extents: Any, poses: Any) -> Scene:
    scene = Scene()
    scene.add_boxes([f"box/{k}" for k in range(len(poses))], 2.0 * half_extents, poses)
    return scene


def _microseconds(run: Callable[[], object]) -> float:
    """Return the median of many turns; what each returns is released outside of its time."""
    times = []
    with own_settings():
        for _ in range(SHORT_TURNS):
            start = perf_counter()
            result = run()
            times.append(perf_counter() - start)
            del result
    return 1e6 * float(np.median(times))

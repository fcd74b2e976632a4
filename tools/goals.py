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

"""Goals of the step, the node and the first start, measured in one run: what is met, and what not.

Ours uses as many threads as there are cores, MuJoCo, coal and python-fcl one each, and MuJoCo
makes contacts where we may compute less: the tables beside say what each does. All take turns on
the same poses; what is compared are medians of at least 20 steps. Starts have an empty kernel
cache: seconds until the node is ready, and until all is compiled.

    python -m tools.goals [--markdown PAGE]
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from obb_collision._threads import threads
from obb_collision.benchmarks import contest
from obb_collision.benchmarks.contestants import (
    COAL,
    FIND_PAIRS,
    FORMS,
    MUJOCO,
    PEERS,
    SCENE_CONTACTS,
    SCENE_PAIRS,
    SCENE_SEPARATIONS,
    Contestant,
    make_frames,
)
from obb_collision.benchmarks.corpora import generated_corpus
from obb_collision.benchmarks.measuring import Show, as_text, digits, machine, machine_line
from obb_collision.benchmarks.speed import best_coal, differences, joined_notes, slopes
from obb_collision.benchmarks.steps import (
    LEAST_STEPS,
    Case,
    Note,
    StepPlan,
    StepRow,
    own_settings,
    run_case,
)
from obb_collision.cli import SEED, Parser, Progress, interruptible, new_file, option, real
from obb_collision.scene.scene import Scene
from obb_collision.warm_up.steps import BOXES
from tools.pages import as_markdown, write_into

#: How many times as fast as MuJoCo, at these sizes.
SIZES = (1_000, 10_000)
BESIDE_MUJOCO = {FIND_PAIRS: (4.0, 8.0), SCENE_SEPARATIONS: (3.0, 6.0), SCENE_CONTACTS: (2.0, 4.0)}
#: How many times as fast as coal, in every form; and at most, from one size to one ten times that.
BESIDE_COAL, GROWTH = 8.0, 12.0
FORM_BOXES, LARGE = 10_000, (10_000, 100_000, 1_000_000)
#: How much quicker when 1 % moves; microseconds of an unchanged scene, and of ten boxes.
FEW_MOVE, UNCHANGED_US, TEN_US = 10.0, 20.0, 40.0
#: Per pair of meshes and of hulls, how many times as fast as each peer.
PER_PAIR = {"mesh": {"python-fcl": 3.0, "coal": 4.0}, "hull": {"python-fcl": 6.0, "coal": 8.0}}
#: Seconds for those pairs; and turns of what takes microseconds.
PAIR_SECONDS, SHORT_TURNS, BOXES_TURNS = 30.0, 2_000, 100


#: Ways to send objects to the node, how many, milliseconds: the median, and what 99 % are below.
NODE = (
    ("object_poses", 1_000, 1.0, 3.0),
    ("object_poses", 10_000, 8.0, None),
    ("objects, other ids by DELETEALL", 500, 40.0, None),
    ("objects, other ids by differences", 500, 40.0, None),
    ("objects, other ids by lifetime", 500, 40.0, None),
    ("object_boxes, other ids", 500, 3.0, None),
)


class Goal(NamedTuple):
    """A figure: its name, the peer, the goal and the measured value, None if not measured."""

    what: str
    beside: str
    wanted: str
    measured: str
    met: bool | None


def ratio(
    what: str, beside: str, wanted: float, ours: float, theirs: float | None, unit: str
) -> Goal:
    """Return how many times as fast ours is; times in the unit, None if not installed."""
    if theirs is None:
        return missing(what, beside, "not installed")
    times = theirs / ours
    text = f"{digits(times)} times: {digits(ours)} and {digits(theirs)} {unit}"
    return Goal(what, beside, f"{wanted:g} times", text, bool(times >= wanted))


def below(what: str, wanted: float, measured: float, unit: str) -> Goal:
    """Return whether a time is below the goal."""
    text = f"{digits(measured)} {unit}"
    return Goal(what, "", f"below {wanted:g} {unit}", text, bool(measured < wanted))


def missing(what: str, beside: str, why: str) -> Goal:
    """Return a goal that could not be measured."""
    return Goal(what, beside, "", f"not measured: {why}", None)


def node_goals(rows: Sequence[dict[str, Any]]) -> Iterator[Goal]:
    """Return the goals of the node, from a row per input."""
    by_input = {(row["way"], row["objects"]): row for row in rows}
    for way, objects, most, most_99 in NODE:
        row, late = by_input[way, objects], f", 99 % below {most_99:g} ms" if most_99 else ""
        what, wanted = f"node, {objects:,} by {way}", f"median below {most:g} ms{late}"
        if "median" not in row:
            yield Goal(what, "", wanted, "a frame has no answer", False)
            continue
        text = f"median {row['median']:.2f} ms, 99 % {row['99 %']:.2f} ms"
        met = row["median"] < most and (most_99 is None or row["99 %"] < most_99)
        yield Goal(what, "", wanted, text, met)


def node_table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Return the rows of the node as a table, in milliseconds."""
    columns = ("median", "95 %", "99 %", "longest")
    lines = [["by", "objects", *columns]]
    for row in rows:
        times = [digits(row[key]) if key in row else "no answer" for key in columns]
        lines.append([row["way"], f"{row['objects']:,}", *times])
    return lines


def goal_table(goals: Sequence[Goal]) -> list[list[str]]:
    """Return the goals as a table."""
    words = {True: "met", False: "not met", None: "?"}
    lines = [["", "beside", "wanted", "measured", ""]]
    return lines + [[g.what, g.beside, g.wanted, g.measured, words[g.met]] for g in goals]


class Goals:
    """Measures the goals, and holds the rows and notes of the scenes on the way."""

    def __init__(self, plan: StepPlan, show: Show) -> None:
        self.node_rows: list[dict[str, Any]] = []
        self.rows: list[StepRow] = []
        self.notes: list[Note] = []
        self._plan, self._show = plan, show

    def _run(self, case: Case, contestants: Sequence[Contestant]) -> dict[str, StepRow]:
        rows, notes = run_case(case, contestants, [threads()], self._plan, self._show)
        self.rows += rows
        self.notes += notes
        return {row.name: row for row in rows}

    def beside_mujoco(self) -> Iterator[Goal]:
        """Measure moving boxes beside MuJoCo, with and without contacts."""
        for k, boxes in enumerate(SIZES):
            by_name = self._run(Case(boxes=boxes), [*BESIDE_MUJOCO, MUJOCO])
            for ours, wanted in BESIDE_MUJOCO.items():
                what, beside = f"{ours.name}, {boxes:,} boxes", f"{MUJOCO.name} (contacts)"
                theirs = by_name[MUJOCO.name].median_ms if MUJOCO.name in by_name else None
                yield ratio(what, beside, wanted[k], by_name[ours.name].median_ms, theirs, "ms")

    def beside_coal(self) -> Iterator[Goal]:
        """Measure every form beside the best broad phase of coal."""
        for form in FORMS:
            case = Case(form, FORM_BOXES)
            by_name = self._run(case, [SCENE_SEPARATIONS, *COAL])
            what, best = f"{SCENE_SEPARATIONS.name}, {form}", best_coal(self.rows, case)
            name, theirs = (best.name, best.median_ms) if best else ("coal", None)
            ours = by_name[SCENE_SEPARATIONS.name].median_ms
            yield ratio(what, name, BESIDE_COAL, ours, theirs, "ms")

    def growth(self) -> Iterator[Goal]:
        """Measure how time grows from ten thousand boxes to a million."""
        sizes = [self._run(Case(boxes=n), [FIND_PAIRS, SCENE_SEPARATIONS]) for n in LARGE]
        for contestant in (FIND_PAIRS, SCENE_SEPARATIONS):
            for k in (1, 2):
                a, b = (sizes[j][contestant.name].median_ms for j in (k - 1, k))
                what = f"{contestant.name}, {LARGE[k]:,} boxes"
                text = f"{b / a:.1f} times: {digits(a)} and {digits(b)} ms"
                wanted = f"at most {GROWTH:g} times"
                yield Goal(what, f"{LARGE[k - 1]:,}", wanted, text, b / a <= GROWTH)

    def few_move(self) -> Iterator[Goal]:
        """Measure a scene of which 1 % moves, beside one in which all do."""
        scenes = []
        for moving in (1.0, 0.01):
            half_extents, frames = make_frames("uniform", LARGE[0], moving, self._plan.seed)
            scenes.append((SCENE_PAIRS.make(half_extents, frames[0].poses), frames))
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
        """Measure an unchanged scene, and a scene of ten moving boxes."""
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
        plan = contest.ContestPlan(2_000, 20_000, 2_000, PAIR_SECONDS)
        made = generated_corpus(self._plan.seed)
        price = contest.measure(made, plan, self._plan.seed, self._show)
        by_name = {row.name: row for row in price.rows}
        for level, peers in PER_PAIR.items():
            for peer, wanted in peers.items():
                row, ours = by_name.get(f"{peer} {level}"), by_name[level].pair_ns
                theirs = row.pair_ns if row else None
                yield ratio(f"{level} per pair", peer, wanted, ours, theirs, "ns")

    def node(self) -> Iterator[Goal]:
        """Measure the node from message to message."""
        if not find_spec("rclpy"):
            yield missing("node", "", "ROS is not installed here")
            return
        from tools.latency import measure_all

        self.node_rows = measure_all(self._show)
        yield from node_goals(self.node_rows)

    def starts(self) -> Iterator[Goal]:
        """Measure starts with an empty cache."""
        for what, wanted, seconds in measure_starts(self._show):
            yield below(what, wanted, seconds, "s")

    def all(self) -> Iterator[Goal]:
        """Measure everything; a failure is a goal without a measurement, and others continue."""
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
    """Return the median time of many calls; results are released outside of it."""
    times = []
    with own_settings():
        for _ in range(SHORT_TURNS):
            start = perf_counter()
            result = run()
            times.append(perf_counter() - start)
            del result
    return 1e6 * float(np.median(times))


@interruptible("python -m tools.goals")
def main(arguments: Sequence[str] | None = None) -> int:
    """Measure all goals and print whether they are met."""
    parser = Parser(prog="python -m tools.goals", description="goals, and what was measured")
    option(parser, "--seconds", real(0.001, 1e6), 2.0, "minimum time per scene (s)")
    text = "maximum time per scene (s); slower peers are left out"
    option(parser, "--limit", real(0.001, 1e6), 40.0, text)
    option(parser, "--seed", SEED, 0, "seed of the random scenes")
    option(parser, "--markdown", new_file(".md"), text="page that gets the tables")
    options = parser.parse_args(arguments)
    print(machine_line(machine(one.distribution for one in PEERS)))
    with Progress() as bar:
        run = Goals(StepPlan(options.seconds, options.limit, LEAST_STEPS, options.seed), bar.show)
        goals = list(run.all())
    print(as_text(goal_table(goals)))
    print("\n".join(["", *slopes(run.rows), *differences(run.rows), *joined_notes(run.notes)]))
    if options.markdown:
        blocks = {"goals": as_markdown(goal_table(goals))}
        if run.node_rows:
            blocks["node"] = as_markdown(node_table(run.node_rows))
        write_into(options.markdown, blocks)
    return 0


#: Seconds until a node of an accuracy is ready first, with all effects that its parameters allow,
#: until the default node is once more, and until everything is compiled.
STARTED, WARM, EVERYTHING = {"obb": 25.0, "hull": 45.0, "mesh": 60.0}, {"obb": 2.5}, 60.0
#: How a program compiles steps, as the node does.
COMPILE = "from obb_collision.warm_up.processes import compile_steps; import sys; "
COMPILE += "progress = compile_steps(sys.argv[1:]); sys.exit(bool(progress.failed))"


def measure_starts(show: Callable[[str], None]) -> Iterator[tuple[str, float, float]]:
    """Yield name, goal (s) and measured seconds."""
    with TemporaryDirectory() as folder:
        home = Path(folder)
        for level, wanted in STARTED.items() if find_spec("rclpy") else ():
            show(f"empty cache: node with accuracy {level}")
            yield f"node with accuracy {level} ready", wanted, _node(home / level, level)
            if level in WARM:
                yield "the same, kernels cached", WARM[level], _node(home / level, level)
        if not find_spec("rclpy"):
            show("empty cache: default scene")
            seconds = _run(home / "default", "-c", COMPILE, BOXES, "effect separations")
            yield "kernels of a default scene", STARTED["obb"], seconds
        show("empty cache: everything")
        seconds = _run(home / "all", "-m", "obb_collision.warm_up.command", "--quiet")
        yield "everything by obb_collision warm-up", EVERYTHING, seconds


def _command(cache: Path, *words: str) -> dict[str, Any]:
    """Return the command of Python with a cache of kernels and bytecode, and this package."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPYCACHEPREFIX": str(cache)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # where it is installed, it has bytecode
    return {"args": [sys.executable, *words], "env": environment, "cwd": Path(__file__).parents[1]}


def _run(cache: Path, *words: str) -> float:
    """Return the seconds that a program takes."""
    start = perf_counter()
    subprocess.run(**_command(cache, *words), check=True, capture_output=True)
    return perf_counter() - start


def _node(cache: Path, accuracy: str) -> float:
    """Return the seconds from the start of a node until it reports that it is ready."""
    start, code = perf_counter(), "from obb_collision.commands import node; node()"
    output: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    words = "--ros-args", "-p", f"accuracy:={accuracy}"
    with subprocess.Popen(**_command(cache, "-c", code, *words), **output) as process:
        try:
            if any("ready: " in line for line in process.stdout or ()):
                return perf_counter() - start
        finally:
            process.kill()
    raise RuntimeError("the node ended before it was ready")


if __name__ == "__main__":
    raise SystemExit(main())

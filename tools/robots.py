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

"""Measures states of a robot per second beside pinocchio with coal, and MuJoCo."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from obb_collision._threads import set_threads, threads
from obb_collision.accuracy import ALL_LEVELS
from obb_collision.benchmarks import plots
from obb_collision.benchmarks.measuring import Show
from obb_collision.cli import SEED, Parser, Progress, interruptible, new_file, option, real, whole
from obb_collision.robots.robot import Robot
from obb_collision.robots.robot_scene import RobotScene
from obb_collision.scene.scene import Scene
from obb_collision.scene_files import find_scene, load_scene
from obb_collision.scene_files.description import SceneObject
from obb_collision.typing import Floats
from tools.pages import as_markdown, table_of, write_into
from tools.peers.robots import (
    PEERS,
    TRUTH,
    Case,
    CheckStates,
    pinocchio_kinematics,
)
from tools.robot_motions import CLEAR_OF_BASE, box_at, least_times, motion_rows, scene_of

OURS = "this library"
#: Rounds in which all take their turn; the least time of each counts.
ROUNDS = 5
Row = dict[str, Any]
#: Before the path of a mesh file beside the URDF.
RELATIVE = re.compile(r'filename="(?!/|\w+://)')
#: Boxes around the robot of a node.
BOXES_OF_CHUNKS = 30


def default_robot() -> tuple[Path, Path | None, Path]:
    """Return URDF, SRDF and folder of packages: the Panda where it is installed, or our arm."""
    for place in map(Path, sys.path):
        share = place / "cmeel.prefix/share"
        panda = share / "example-robot-data/robots/panda_description"
        if panda.is_dir():
            return panda / "urdf/panda.urdf", panda / "srdf/panda.srdf", share
    config = find_scene("tabletop").parent
    return config / "arm.urdf", config / "arm.srdf", config


def random_boxes(count: int, rng: np.random.Generator) -> list[SceneObject]:
    """Return boxes around a robot, the smaller the more there are."""
    boxes: list[SceneObject] = []
    largest = 0.4 if count <= 10 else 0.3 if count <= 30 else 0.2
    while len(boxes) < count:
        size, turn = rng.uniform(0.25 * largest, largest, 3), rng.normal(size=4)
        place = rng.uniform((-0.9, -0.9, 0.0), (0.9, 0.9, 1.2))
        if np.hypot(*place[:2]) > CLEAR_OF_BASE + 0.5 * float(np.linalg.norm(size)):
            boxes.append(box_at(len(boxes), size, place, turn))
    return boxes


def worlds(options: argparse.Namespace) -> Iterator[tuple[str, list[SceneObject], Scene]]:
    """Yield name, objects and scene of all worlds to measure in."""
    rng = np.random.default_rng(options.seed)
    for count in options.boxes:
        objects = random_boxes(count, rng)
        yield f"{count} boxes", objects, scene_of(objects)
    for file in sorted(options.scenes.glob("*.yaml")) if options.scenes else ():
        description = load_scene(file)
        yield file.stem, list(description.objects), description.build()


def case_of(robot: Robot, file: str, objects: Sequence[SceneObject], checker: RobotScene) -> Case:
    """Return the case for peers, with the pairs that are checked here."""
    tests = checker._prepared.checked.tests
    count, order = tests.first, checker._prepared.world.names
    columns = [order.index(one.name) for one in objects]
    allowed = np.zeros((count, len(objects)), np.bool_)
    if len(tests.allowed):
        allowed = tests.allowed[:, columns]
    return Case(robot, file, objects, tests.pairs, allowed)


def random_states(robot: Robot, count: int, rng: np.random.Generator) -> Floats:
    """Return states within the limits; a joint without limits makes a turn each way."""
    low = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    high = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    return np.asarray(rng.uniform(low, high, (count, len(low))))


def times_of(
    checkers: Mapping[str, Callable[[Floats], object]], states: Floats
) -> dict[str, float]:
    """Return the processor time per state of each, seconds, in turns."""
    for check in checkers.values():
        check(states[:5])
    times = least_times([partial(check, states) for check in checkers.values()], ROUNDS)
    return {name: time / len(states) for name, time in zip(checkers, times, strict=True)}


def compared(name: str, check: CheckStates, states: Floats, truth: np.ndarray | None) -> Row:
    """Return how many states were compared with triangles, missed, and the share of false ones.

    Of the states that a checker calls free, and of those that it calls colliding.
    """
    if truth is None or name == TRUTH:
        return {}
    colliding = check(states)
    return {
        "compared": len(states),
        "missed": int((truth & ~colliding).sum()),
        "false_alarms": float((colliding & ~truth).sum() / max(1, colliding.sum())),
    }


def timed(seconds: float) -> Row:
    """Return the time of a state in both ways."""
    return {"microseconds": 1e6 * seconds, "states_per_second": 1.0 / seconds}


def kinematics_rows(robot: Robot, options: argparse.Namespace) -> list[Row]:
    """Measure kinematics, beside pinocchio if it is installed."""
    ways: dict[str, Callable[[Floats], object]] = {OURS: robot.link_poses}
    if find_spec("pinocchio") is not None:
        nothing = Case(
            robot, str(options.robot), [], np.empty((0, 2), np.int64), np.empty((0, 0), np.bool_)
        )
        ways["pinocchio"] = pinocchio_kinematics(nothing)
    states = random_states(robot, options.states, np.random.default_rng(options.seed))
    times = times_of(ways, states)
    return [{"checker": name} | timed(time) for name, time in times.items()]


def texts_of(options: argparse.Namespace) -> tuple[str, str | None]:
    """Return URDF and SRDF for topics, which have no folder."""
    here = f'filename="{options.robot.resolve().parent}/'
    urdf = RELATIVE.sub(here, options.robot.read_text(encoding="utf-8"))
    return urdf, None if options.srdf is None else options.srdf.read_text(encoding="utf-8")


def chunk_row(robot: Robot, options: argparse.Namespace) -> Row:
    """Measure chunks of states through a node; FoundError where it does not answer."""
    from tools import robot_latency as node

    rng = np.random.default_rng(options.seed)
    boxes = random_boxes(BOXES_OF_CHUNKS, rng)
    states = random_states(robot, node.CHUNK * (options.latency + node.WARM_CHUNKS), rng)
    chunks = states.reshape(-1, node.CHUNK, states.shape[1])
    return node.measure_chunks(robot, texts_of(options), options.packages, boxes, chunks)


def camera_rows(robot: Robot, options: argparse.Namespace) -> list[Row]:
    """Measure a node with a camera; FoundError where it does not answer."""
    from tools.robot_latency import measure_camera

    texts, words = texts_of(options), options.parameters
    return measure_camera(robot, texts, options.packages, options.camera, *words)


def run(robot: Robot, options: argparse.Namespace, show: Show) -> list[Row]:
    """Measure states in all worlds; print omissions with reasons."""
    rows = []
    for world, objects, scene in worlds(options):
        show(f"states among {world}")
        rng = np.random.default_rng([options.seed, 1])
        checker = RobotScene([robot], scene, options.accuracy)
        case = case_of(robot, str(options.robot), objects, checker)
        checkers: dict[str, CheckStates] = {OURS: lambda q, c=checker: c.check(q).colliding}  # type: ignore[misc]
        for name, (make, package) in PEERS.items():
            if find_spec({"pin": "pinocchio"}.get(package, package)) is None:
                continue
            try:
                checkers[name] = make(case)
            except Exception as error:  # peers raise any exception
                print(f"{world}: {name} is left out: {error}")
        states = random_states(robot, options.states, rng)
        times = times_of(checkers, states)
        many = random_states(robot, options.compared, rng)
        truth = checkers[TRUTH](many) if TRUTH in checkers and options.compared else None
        here = {"world": world, "objects": len(objects)}
        for name, check in checkers.items():
            row = here | {"checker": name} | timed(times[name])
            row["colliding"] = float(check(states).mean())
            rows.append(row | compared(name, check, many, truth))
    return rows


COLUMNS = {
    "world": ("world", "{}"), "length": ("length (rad)", "{}"), "checker": ("checker", "{}"),
    "microseconds": ("us per state", "{:.2f}"), "us_per_state": ("us per state", "{:.2f}"),
    "us_per_motion": ("us per motion", "{:.1f}"), "in_states": ("in states", "{:.1f}"),
    "us_of_free": ("free", "{:.1f}"), "us_of_colliding": ("colliding", "{:.1f}"),
    "us_of_call": ("one call (us)", "{:.1f}"), "compared": ("compared", "{:,}"),
    "missed": ("missed", "{}"), "not_called_free": ("not called free", "{:,}"),
    "states": ("states", "{}"), "chunks": ("chunks", "{:,}"), "median": ("median (ms)", "{:.2f}"),
    "p99": ("99 % (ms)", "{:.2f}"), "longest": ("longest (ms)", "{:.2f}"),
    "valid": ("valid", "{:.0%}"),
}  # fmt: skip
"""Heads and formats of figures, in the order of the columns."""


def table(rows: Sequence[Row]) -> list[list[str]]:
    """Return header and lines, as text cells."""
    shown = [name for name in COLUMNS if any(name in row for row in rows)]
    cells = [[COLUMNS[n][1].format(row[n]) if n in row else "" for n in shown] for row in rows]
    return [[COLUMNS[name][0] for name in shown], *cells]


def state_table(rows: Sequence[Row]) -> list[list[str]]:
    """Return a line per checker: its time in each world, how many it misses, the most false."""
    worlds = list(dict.fromkeys(row["world"] for row in rows))
    lines = [["us per state", *worlds, "missed", "false alarms"]]
    for checker in dict.fromkeys(row["checker"] for row in rows):
        own = {row["world"]: row for row in rows if row["checker"] == checker}
        times = [f"{own[w]['microseconds']:.2f}" if w in own else "" for w in worlds]
        wrong = [row for row in own.values() if "missed" in row]
        missed = str(sum(row["missed"] for row in wrong)) if wrong else ""
        false = f"{max(row['false_alarms'] for row in wrong):.2%}" if wrong else ""
        lines.append([checker, *times, missed, false])
    return lines


TABLES = {"states": state_table, "camera": table_of}
"""How rows are shown that have columns of their own."""


def save_plot(rows: Sequence[Row], path: Path) -> None:
    """Draw states per second by world and checker."""
    worlds = list(dict.fromkeys(row["world"] for row in rows))
    with plots.picture(path, (9.0, 4.2)) as (figure, panels):
        axes = panels["a"]
        for name in dict.fromkeys(row["checker"] for row in rows):
            own = [row for row in rows if row["checker"] == name]
            ours = "obb_collision" if name == OURS else name
            style = plots.look(ours) | ({"linestyle": ":"} if "triangles" in name else {})
            points = [(worlds.index(r["world"]), r["states_per_second"]) for r in own]
            axes.semilogy(*zip(*points, strict=True), label=ours, **style)
        axes.set_xticks(range(len(worlds)), worlds)
        axes.set(xlabel="world", ylabel="states per second, one core")
        axes.set_title("States of a Panda, checked against each other and the world")
        plots.name_values(axes.yaxis, plots.number)
        figure.legend(loc="outside right center")


def parser() -> Parser:
    """Return the parser of the command."""
    urdf, srdf, packages = default_robot()
    made = Parser(
        prog="python -m tools.robots", description=__doc__.splitlines()[0] if __doc__ else None
    )
    option(made, "--robot", Path, urdf, "URDF")
    option(made, "--srdf", Path, srdf, "SRDF")
    option(made, "--packages", Path, packages, "folder in which packages of meshes are")
    boxes = "numbers of random boxes"
    made.add_argument("--boxes", nargs="+", type=whole(1, 10000), default=[10, 30, 100], help=boxes)
    option(made, "--scenes", Path, text="folder of scene files (YAML) to measure in, too")
    option(made, "--states", whole(1, 10**7), 2000, "states that are timed")
    option(made, "--compared", whole(0, 10**7), 20000, "states compared with triangles")
    text = "motions per world and length compared with 1,000 samples each"
    option(made, "--motions", whole(0, 10**6), 200, text)
    made.add_argument("--accuracy", choices=ALL_LEVELS, default="hull", help="of this library")
    made.add_argument("--only-motions", action="store_true", help="measure motions alone")
    option(made, "--seed", SEED, 0, "of states and boxes")
    text = "measure a node instead: by as many chunks of 50 states, among 30 boxes"
    option(made, "--latency", whole(1, 10**6), text=text)
    text = "measure a node with a camera of 4.9 MB at 15 Hz instead, for as many seconds each"
    option(made, "--camera", real(1.0, 86400.0), text=text)
    text = "NAME:=VALUE: parameters of that node"
    made.add_argument("--parameters", nargs="+", default=["camera.voxel:=0.02"], help=text)
    option(made, "--json", new_file(), text="write all figures")
    option(made, "--markdown", new_file(".md"), text="page whose tables are written anew")
    option(made, "--plot", new_file(".png", ".svg"), text="draw states per second")
    return made


def measure(options: argparse.Namespace, show: Show) -> dict[str, list[Row]]:
    """Measure a node, or the library beside others; return rows by name of the table."""
    robot = Robot.from_urdf(options.robot, options.srdf, options.packages)
    if options.latency:
        show("chunks of states through a node")
        return {"latency": [chunk_row(robot, options)]}
    if options.camera:
        show("a camera")
        return {"camera": camera_rows(robot, options)}
    show("motions")
    given = options.accuracy, options.boxes, options.motions, options.seed
    motions = list(motion_rows(robot, *given))
    if options.only_motions:
        return {"motions": motions}
    show("kinematics")
    kinematics = kinematics_rows(robot, options)
    rows = run(robot, options, show)
    if options.plot:
        save_plot(rows, options.plot)
    return {"states": rows, "motions": motions, "kinematics": kinematics}


@interruptible("python -m tools.robots")
def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    made = parser()
    options = made.parse_args(args)
    if options.srdf is not None and options.robot != made.get_default("robot"):
        options.srdf = None if options.srdf == made.get_default("srdf") else options.srdf
    if (options.latency or options.camera) and find_spec("rclpy") is None:
        made.error("a node needs ROS 2: source its setup file, or install the wheels")
    before = threads()
    set_threads(1)
    try:
        with Progress() as progress:
            report = measure(options, progress.show)
    except (ValueError, OSError, RuntimeError) as error:
        made.error(str(error))
    finally:
        set_threads(before)
    blocks = {
        f"robots {name}": as_markdown(TABLES.get(name, table)(rows))
        for name, rows in report.items()
    }
    print(*blocks.values(), sep="\n\n")
    if options.json:
        options.json.write_text(json.dumps(report, indent=1) + "\n")
    if options.markdown:
        write_into(options.markdown, blocks)
    return 0


if __name__ == "__main__":
    sys.exit(main())

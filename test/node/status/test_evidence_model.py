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

"""Any sequence of messages, faults and silences: the node claims what a slow model knows.

The node is the real one, with its clocks in the hand of the test; the model shares no code with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from math import nan
from random import Random
from typing import Any
from unittest.mock import patch

import pytest
from each import each
from evidence_things import CHANGES, KINDS, ORDER
from evidence_world import BEGIN, PLACES, SIZES, World, rule
from sensor_machine import SensorMachine
from walks import Rules, Step, check, draw_all, one_of, repeated

from obb_collision.node.status import evidence

TICK: Step = "tick", {}
STEPS_OF_A_WALK, MOST_FAILURES = 60, 10


@pytest.fixture(autouse=True, scope="module")
def nodes() -> Iterator[None]:
    with patch.object(evidence, "LOOK", 0.0):
        yield
    World.end_all()


def walk(number: int, length: int) -> None:
    """Go through the walk of this number."""
    random = Random(number)
    begin: Step = "begin", draw_all(BEGIN, random)
    steps = [begin, *rule.walk(random, length), TICK]
    check(SensorMachine.go, steps, f"walk {number}")


@each("number", range(100))
def test_anything(number: int) -> None:
    walk(number, 15)


@pytest.mark.slow
def test_hours_of_anything(request: pytest.FixtureRequest) -> None:
    """An hour by default, ``--hours 12`` if asked; ``--hours 0 --walk N`` goes one walk again."""
    hours, first = (request.config.getoption(name) for name in ("--hours", "--walk"))
    World.lived, walks, failures = 0.0, 0, list[str]()
    World.reached.clear()
    while walks == 0 or (World.lived < 3600.0 * hours and len(failures) < MOST_FAILURES):
        try:
            walk(first + walks, STEPS_OF_A_WALK)
        except AssertionError as error:
            failures.append(str(error))
            print(error, flush=True)  # noqa: T201
        walks += 1
        if walks % 50 == 0:
            print(f"{walks} walks, {World.lived / 3600.0:.2f} hours", flush=True)  # noqa: T201
    text = f"{walks} walks of {STEPS_OF_A_WALK} steps, {World.lived / 3600.0:.2f} hours"
    print(text, *World.reached.most_common(), sep="\n")  # noqa: T201  # what was reached, how often
    assert not failures, "\n".join(failures)
    rare = {*ORDER[1:], *KINDS} - World.reached.keys()  # no walk looks before the first cycle
    assert hours < 1.0 or not (rare and find_spec("lxml")), rare


SILENT: dict[str, Any] = {"joint_timeout": 0.6, "object_timeout_overrides": ["arm*: 0.9"]}
LIMITED: dict[str, Any] = {"object_timeout": 0.5, "object_timeout_overrides": ["a/*: 0.3"]}
GOOD, REFUSED = [(0.0, 1.0, "")], [(0.0, 1.0, "scale")]
FOUND: dict[str, Callable[[Any], Any]] = {
    "clear before a cycle": lambda m: (m.markers(), m.clear()),
    "set cleared before a cycle": lambda m: (m.boxes(GOOD), m.clear()),
    "ignored": lambda m: (m.configure(ignored_objects=["z/*"]), m.transform()),
    "policies": lambda m: m.configure(stale_policy_overrides=["b/*: keep"]),
    "deleted at once": lambda m: (m.markers(), m.delete(["b/0"])),
    "newcomer deleted": lambda m: (m.markers(fault="scale"), m.tick(), m.delete(["b/0"])),
    "newcomer ended": lambda m: (
        m.clear(), m.markers(fault="scale", life=1.0), m.tick(0.7117), m.tick(0.4703)),
    "bulk after delete": lambda m: (m.delete(["a/0"]), m.poses(["a/0"])),
    "refused box": lambda m: (m.boxes(REFUSED), m.tick(), m.delete_all("")),
    "refused box alone": lambda m: (m.clear(), m.boxes(REFUSED)),
    "empty after cut": lambda m: (m.markers(cut=True), m.delete([])),
    "refused for longer": lambda m: (
        m.markers(life=1.0), m.tick(0.7117), m.markers(life=1.0, fault="scale"), m.tick(0.4703)),
    "named by a number": lambda m: (m.poses(["b/0"]), m.markers()),
    "error in a jump": lambda m: (m.transform(), m.markers(life=1.0), m.jump(fails=True)),
    "robot: joint not finite": lambda m: m.joints([nan, 1.4]),
    "robot: joint missing": lambda m: (m.clear(), m.joints([None, 1.4])),
    "robot: joints silent": lambda m: (m.configure(**SILENT), m.tick(0.7117)),
    "robot: base not finite": lambda m: (m.base(fault="pose"), m.joints()),
    "robot: base silent": lambda m: (
        m.configure(**SILENT), m.tick(0.7117), m.joints(), m.tick(0.2311), m.joints()),
    "robot: clock set back": lambda m: (
        m.configure(**SILENT), m.jump(), m.tick(0.7117), m.tick(0.2311)),
    "older set refused": lambda m: (
        m.boxes(GOOD, ahead=0.0), m.tick(), m.boxes(GOOD, ahead=-0.3), m.tick()),
    "two senders, one cut": lambda m: (
        m.markers(), m.turn(2), m.poses(["b/0"], broken="cut"), m.turn(1), m.poses(["b/0"])),
    "one of two is gone": lambda m: (
        m.poses(["a/0"], broken="cut"), m.turn(2), m.end(1), m.tick(), m.poses(["a/0"])),
    "lost, then all deleted": lambda m: (
        m.turn(1, CHANGES), m.markers(), m.transform("b/0"), m.tick(), m.delete_all("")),
    "sets by turns": lambda m: (
        m.boxes(GOOD), m.turn(2), m.boxes(GOOD), m.turn(1), m.boxes(GOOD), m.tick(), m.end(2)),
    "clock stopped": lambda m: (m.markers(), m.stand_still(), m.tick(), m.stand_still(says=False)),
    "old truth": lambda m: (m.configure(**LIMITED), m.markers(["a/0"], ahead=-30.0), m.tick()),
    "followed a dead frame": lambda m: (
        m.configure(**LIMITED), m.markers(frame="odom", locked=True), m.tick(0.7117)),
    "newer set refused": lambda m: (
        m.boxes(GOOD), m.boxes([(0.7, 1.0, "")], frame="lost"), m.tick(0.4703)),
    "refused in a set, marked by that name": lambda m: (
        m.markers(["boxes/9"]), m.tick(), m.boxes(REFUSED), m.tick(), m.markers(["boxes/0"]),
        m.tick(), m.boxes([])),
    "refused in a set, and by a marker": lambda m: (
        m.markers(["boxes/9"]), m.tick(), m.boxes(REFUSED), m.tick(),
        m.markers(["boxes/0"], fault="scale"), m.tick(), m.delete(["boxes/0"]), m.tick()),
    "bad marker of a set's box": lambda m: (
        m.boxes(GOOD), m.tick(), m.markers(["boxes/0"], fault="pose")),
    "older marker of a set's box": lambda m: (
        m.boxes(GOOD), m.tick(), m.boxes(GOOD), m.tick(), m.markers(["boxes/0"], ahead=-0.3)),
    "refused with another size": lambda m: (
        m.markers(), m.tick(), m.markers(size=2.0, fault="pose"), m.tick(), m.transform("b/0")),
    "refused in a set with another size": lambda m: (
        m.boxes(GOOD), m.tick(), m.boxes([(0.0, 2.0, "pose")]), m.tick(), m.transform("boxes/0")),
    "older one right after": lambda m: (m.markers(), m.markers(ahead=-30.0), m.tick(0.7117)),
    "refused, and an older one": lambda m: (
        m.markers(), m.tick(), m.markers(fault="pose"), m.markers(ahead=-30.0)),
    "older than one that was superseded": lambda m: (
        m.markers(), m.markers(ahead=5.0), m.poses(x=0.7, ahead=-30.0)),
    "older than one without a stamp": lambda m: (
        m.markers(), m.tick(), m.markers(x=0.7, ahead=None), m.markers(ahead=-30.0)),
    "older once all are deleted": lambda m: (
        m.markers(), m.tick(), m.delete_all(), m.markers(x=0.7, ahead=-0.3), m.tick(0.7117)),
    "cut, readable and cut before a cycle": lambda m: (
        m.markers(cut=True), m.markers(), m.markers(cut=True)),
    "twice before a cycle": lambda m: (
        m.configure(**LIMITED), m.markers(), m.markers(), m.tick(0.7117)),
    "sensors: watched, by turns": lambda m: (
        m.watch(), m.turn(2), m.watch(), m.turn(1), m.watch(), m.tick()),
    "sensors: watched, while the clock stands still": lambda m: (
        m.configure(**{"seen.timeout": 0.1}), m.stand_still(0.2311)),
    "sensors: another input lost changes": lambda m: (
        m.markers(), m.turn(loses=["object_transform"]), m.transform("b/0"), m.tick(),
        m.transform("b/0")),
    "sensors alone": lambda m: m.see([0.0]),
    "sensors: two senders, one cut": lambda m: (
        m.markers(), m.see(fault="cut"), m.turn(2), m.see(), m.tick(), m.end(1)),
    "sensors: by turns": lambda m: (
        m.markers(), m.see(), m.turn(2), m.see(), m.turn(1), m.see(), m.tick(), m.end(2)),
    "sensors: refused, and then an earlier one": lambda m: (
        m.markers(), m.transforms(known=False), m.see(frame="odom"),
        m.see(frame="odom", ahead=None, fault="content"), m.tick(), m.transforms()),
    "robot and sensors: left out after the clock was set back": lambda m: (
        m.configure(joint_timeout=5.0), m.joints([0.0, 3.0]), m.tick(0.1103), m.joints([1.4, 3.0]),
        m.tick(), m.jump(-0.3), m.joints([0.0, 1.4]), m.see([1.4])),
    "robot and sensors: grown by its age": lambda m: (
        m.configure(object_timeout_overrides=["arm/*: 0.9"], stale_policy="collide"),
        m.tick(1.3017), m.see([0.4], ahead=None)),
    "robot and sensors: a robot that is not known": lambda m: (
        m.joints([nan, 1.4]), m.see([0.7]), m.tick(), m.joints(), m.tick(), m.see([0.7])),
    "robot and sensors: a state that comes later": lambda m: (
        m.configure(joint_timeout=5.0), m.tick(0.1103), m.see([0.0, 1.4]), m.tick(), m.joints(),
        m.tick(), m.see([0.0]), m.tick(0.4703)),
}  # fmt: skip
"""Sequences after which the node claimed something else, and what is rare of robots."""


def run(steps: Callable[[Any], Any], has_robot: bool, has_sensors: bool) -> None:
    """Let the machine go through some steps."""
    machine = SensorMachine()
    machine.begin(has_robot=has_robot, has_sensors=has_sensors)
    try:
        steps(machine)
        machine.tick()
    finally:
        machine.teardown()


@each("what", FOUND)
def test_what_the_machine_found(what: str) -> None:
    has_robot = what.startswith("robot")
    if has_robot:
        pytest.importorskip("lxml")
    run(FOUND[what], has_robot, "sensors" in what)


BOX_STEPS = Rules()
SHARED = one_of([["boxes/0"], ["boxes/1"], ["a/0", "boxes/0"]])
ROWS = repeated(one_of([(0.0, 1.0, ""), (0.7, 2.0, ""), (1.4, 1.0, "scale")]), 0, 2)
BOX_STEPS.add("boxes", 2.0, rows=ROWS, first=one_of([0, 1]))
BOX_STEPS.add("markers", names=SHARED, x=PLACES, size=SIZES, fault=one_of(["", "", "scale"]))
BOX_STEPS.add("poses", names=SHARED, x=PLACES)
BOX_STEPS.add("delete", names=SHARED)
BOX_STEPS.add("delete_all", namespace=one_of(["", "a", "boxes"]))


@each("number", range(80))
def test_sets_of_boxes_and_markers_of_equal_names(number: int) -> None:
    random = Random(number)
    start: list[Step] = [("begin", {}), ("markers", {"names": ["boxes/9"]}), TICK]
    # the name that sets have a number of
    drawn = BOX_STEPS.walk(random, random.randint(3, 10))
    check(SensorMachine.go, [*start, *(one for step in drawn for one in (step, TICK))], "boxes")

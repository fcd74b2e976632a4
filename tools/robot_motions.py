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

"""Motions of a robot among random boxes: their times beside those of states, and samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from time import thread_time
from typing import Any

import numpy as np

from obb_collision.robots.kinematics.kinematics import PRISMATIC
from obb_collision.robots.robot import Robot
from obb_collision.robots.robot_scene import RobotScene
from obb_collision.scene.scene import Scene
from obb_collision.scene_files.description import SceneObject
from obb_collision.shapes import Box
from obb_collision.typing import Floats, Mask

#: Lengths of motions, the root of the sum of squares of what all joints move.
LENGTHS = 0.3, 1.5
#: States that each motion is compared with, and motions that are sampled at once.
SAMPLES, AT_ONCE = 1000, 50
#: Rounds in which all take their turn, and motions that are timed; the least time counts.
ROUNDS, TIMED = 7, 1500
#: Single calls that are timed.
CALLS = 200
#: Boxes keep this far from the axis of the base, metres.
CLEAR_OF_BASE = 0.35
Row = dict[str, Any]


def boxes_of(count: int, rng: np.random.Generator) -> list[SceneObject]:
    """Return boxes of 4 to 24 cm around a robot."""
    boxes: list[SceneObject] = []
    while len(boxes) < count:
        place = rng.uniform((-1.0, -1.0, -0.1), (1.0, 1.0, 1.2))
        size, turn = 2.0 * rng.uniform(0.02, 0.12, 3), rng.normal(size=4)
        if np.hypot(*place[:2]) >= CLEAR_OF_BASE:
            boxes.append(box_at(len(boxes), size, place, turn))
    return boxes


def box_at(number: int, size: Floats, place: Floats, turn: Floats) -> SceneObject:
    """Return a box at a place (3,), turned by a quaternion of any length (4,)."""
    x, y, z = place.tolist()
    qx, qy, qz, qw = (turn / np.linalg.norm(turn)).tolist()
    return SceneObject(f"box{number}", Box(size), (x, y, z, qx, qy, qz, qw))


def scene_of(objects: Sequence[SceneObject]) -> Scene:
    """Return a scene of objects."""
    scene = Scene()
    for box in objects:
        scene.add(box.name, box.shape, box.pose)
    return scene


def free_states(checker: RobotScene, count: int, rng: np.random.Generator) -> Floats:
    """Return valid states with prismatic joints, such as fingers, at zero."""
    robot = checker.robots[0]
    low = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    high = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    still = np.isin(np.arange(len(low)), robot.tree.columns[robot.tree.kinds == PRISMATIC])
    valid = np.empty((0, len(low)))
    while len(valid) < count:
        states = rng.uniform(low, high, (count, len(low)))
        states[:, still] = np.clip(0.0, low, high)[still]
        valid = np.concatenate([valid, states[checker.check(states).valid]])
    return valid[:count]


def ends_of(robot: Robot, starts: Floats, length: float, rng: np.random.Generator) -> Floats:
    """Return ends of motions in random directions, clipped to the limits."""
    ways = rng.normal(size=starts.shape) * (np.ptp(starts, axis=0) > 0.0)
    ways *= length / np.linalg.norm(ways, axis=1, keepdims=True)
    return np.clip(starts + ways, robot.lower, robot.upper)


def sampled(checker: RobotScene, starts: Floats, ends: Floats) -> Mask:
    """Return (n,) which motions collide at one of many states."""
    times, collides = np.linspace(0.0, 1.0, SAMPLES)[:, None], []
    for first in range(0, len(starts), AT_ONCE):
        a, b = (states[first : first + AT_ONCE, None] for states in (starts, ends))
        states = (a + times * (b - a)).reshape(-1, starts.shape[1])
        collides.append(checker.check(states).colliding.reshape(-1, SAMPLES).any(axis=1))
    return np.concatenate(collides)


def least_times(calls: Sequence[Callable[[], object]], rounds: int = ROUNDS) -> list[float]:
    """Return the least processor time of each call (s), measured in turns."""
    best = [np.inf] * len(calls)
    for _ in range(rounds):
        for n, call in enumerate(calls):
            begin = thread_time()
            call()
            best[n] = min(best[n], thread_time() - begin)
    return best


def motion_rows(
    robot: Robot, accuracy: str, boxes: Sequence[int], compared: int, seed: int
) -> Iterator[Row]:
    """Yield a row per number of boxes and length of motions."""
    for count in boxes:
        rng = np.random.default_rng([seed, count])
        objects = boxes_of(count, rng)
        checker = RobotScene([robot], scene_of(objects), accuracy)
        for length in LENGTHS:
            starts = free_states(checker, max(compared, TIMED), rng)
            ends = ends_of(robot, starts, length, rng)
            sides = starts[:compared], ends[:compared]
            collides = sampled(checker, *sides) if compared else np.empty(0, np.bool_)
            here = {"world": f"{count} boxes", "length": length, "checker": "this library"}
            yield here | _row(checker, starts, ends, collides)


def _row(checker: RobotScene, starts: Floats, ends: Floats, collides: Mask) -> Row:
    a, b = starts[:TIMED], ends[:TIMED]
    free = checker.check_motions(a, b).valid
    parts = (np.ones(len(a), np.bool_), free, ~free)
    motions = [partial(checker.check_motions, a[part], b[part]) for part in parts]
    state, each, of_free, of_others = least_times([lambda: checker.check(a), *motions])
    (single,) = least_times([lambda: [checker.check_motions(a[:1], b[:1]) for _ in range(CALLS)]])
    compared = len(collides)
    report = checker.check_motions(starts[:compared], ends[:compared])
    return {
        "us_per_state": 1e6 * state / len(a),
        "us_per_motion": 1e6 * each / len(a),
        "in_states": each / state,
        "us_of_free": 1e6 * of_free / max(1, int(free.sum())),
        "us_of_colliding": 1e6 * of_others / max(1, int((~free).sum())),
        "us_of_call": 1e6 * single / CALLS,
        "compared": compared,
        "missed": int((collides & report.valid).sum()),
        "not_called_free": int((~collides & ~report.valid).sum()),
    }

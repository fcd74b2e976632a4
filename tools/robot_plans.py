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

"""The planner of a tutorial on a robot among boxes: motions proved here, and sampled by coal.

python -m tools.robot_plans [pairs]    pairs of free states, 50 by default
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import thread_time
from typing import Any

import numpy as np

from obb_collision import Robot, RobotScene, set_threads
from obb_collision.typing import Floats, Mask
from tools.peers.robots import CheckStates, coal_checker
from tools.robot_motions import boxes_of, free_states, scene_of
from tools.robots import case_of, default_robot

PAGE = Path(__file__).parents[1] / "docs/tutorials/planner_states_without_ros.md"
BOXES, PAIRS = 30, 50
#: States per radian at which motions are sampled.
DENSITY = 32
#: Whether motions from starts to ends (n, joints) are free, (n,).
AreFree = Callable[[Floats, Floats], Mask]


def planner() -> Callable[..., Floats | None]:
    """Return the planner that the tutorial has."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    (block,) = (text for text in blocks if "def rrt_connect" in text)
    names: dict[str, Any] = {"np": np}
    exec(block[: block.index("\ndef sample(")], names)
    plan: Callable[..., Floats | None] = names["rrt_connect"]
    return plan


def sampling(collide: CheckStates) -> AreFree:
    """Return a check of motions by samples, which ends at the first collision."""

    def is_free(start: Floats, end: Floats) -> bool:
        count = int(np.ceil(DENSITY * float(np.linalg.norm(end - start)))) + 1
        states = start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)
        return not any(collide(state[None])[0] for state in states)

    def are_free(starts: Floats, ends: Floats) -> Mask:
        return np.array([is_free(*pair) for pair in zip(starts, ends, strict=True)], np.bool_)

    return are_free


def main(pairs: int = PAIRS) -> int:
    """Plan between pairs of free states in both ways, and print a table."""
    set_threads(1)
    urdf, srdf, packages = default_robot()
    robot = Robot.from_urdf(urdf, srdf, [packages])
    objects = boxes_of(BOXES, np.random.default_rng(0))
    checker, plan = RobotScene([robot], scene_of(objects)), planner()
    coal = coal_checker(case_of(robot, str(urdf), objects, checker), False)
    states = free_states(checker, 2 * pairs, np.random.default_rng(1))
    low, high = states.min(axis=0), states.max(axis=0)

    def uniform(rng: np.random.Generator, count: int) -> Floats:
        return rng.uniform(low, high, (count, len(low)))

    ways: dict[str, AreFree] = {
        "this library, proved": lambda a, b: checker.check_motions(a, b).valid,
        "pinocchio + coal, sampled": sampling(coal),
    }
    print(
        "| motions | solved | median (ms) | mean (ms) | paths not free |",
        "|---" * 5 + "|",
        sep="\n",
    )
    for name, are_free in ways.items():
        are_free(states[:1], states[:1])
        times, paths = [], []
        for n in range(pairs):
            rng = np.random.default_rng([2, n])
            begin = thread_time()
            path = plan(states[n], states[pairs + n], partial(uniform, rng), are_free)
            times.append(1e3 * (thread_time() - begin))
            paths += [] if path is None else [path]
        wrong = sum(not checker.check_path(path).valid.all() for path in paths)
        cells = f"{np.median(times):.1f} | {np.mean(times):.1f} | {wrong}"
        print(f"| {name} | {len(paths)} of {pairs} | {cells} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))

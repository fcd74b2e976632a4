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

"""Does a time budget hold? Moving meshes that take ten times as long at the level "mesh".

Every mesh moves in every cycle. Printed are the share of cycles within the budget, how often the
cap changed, and what decided the pairs; some cycles are repeated without a budget, to verify that
all collisions of triangles are among those reported.

Use the processor's clock if others use the machine: their time is not the fault of the budget.

    python -m tools.budget [--meshes N] [--cycles N] [--times X] [--processor]
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from trimesh import creation

from obb_collision.accuracy import Accuracy
from obb_collision.cli import Parser, interruptible, new_file, option, real, whole
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.scene.refinement.budget import Budget
from obb_collision.scene.scene import Scene

Clock = Callable[[], float]

#: Cycles before counting: the cap is free for the first ones, and estimates fill.
WARM_UP = 20
#: One in this many cycles is repeated without a budget.
COMPARED = 25
#: Seconds between two poses.
STEP = 0.02
#: Crates in a stack.
STACK = 5


def build(meshes: int) -> tuple[Scene, NDArray[np.int64]]:
    """Return a scene of stacked crates, rings and balls, of thousands of triangles; indices."""
    crate = creation.box((0.5, 0.5, 0.5))
    for _ in range(5):
        crate = crate.subdivide()
    shapes = [
        creation.torus(0.35, 0.05, 96, 24),
        creation.annulus(0.38, 0.45, 0.1, sections=128),
        creation.icosphere(subdivisions=4, radius=0.25),
    ]
    parts = [Mesh(part.vertices, part.faces) for part in (crate, *shapes)]
    scene = Scene(accuracy="mesh")
    stacked = _stacked(meshes)
    slots = [
        scene.add(f"mesh/{k}", parts[0 if k < stacked else 1 + k % len(shapes)])
        for k in range(meshes)
    ]
    scene.prepare()
    return scene, np.array(slots)


def _stacked(meshes: int) -> int:
    return meshes // (2 * STACK) * STACK


class Motion:
    """Stacks that move on circles, crates face to face; the others circle and turn individually.

    Crates that rest on one another take triangles longest to decide.
    """

    def __init__(self, count: int, rng: np.random.Generator) -> None:
        reach = 0.45 * count ** (1.0 / 3.0)
        stacked = _stacked(count)
        stacks = stacked // STACK
        self._centers = rng.uniform(-reach, reach, (count, 3))
        self._phases, self._speeds = rng.uniform([[0.0], [0.2]], [[6.28], [1.0]], (2, count))
        self._turns = rng.normal(size=(count, 3)) * 0.5
        self._starts = Rotation.random(count, rng).as_quat()
        side = int(np.ceil(np.sqrt(stacks)))
        for stack in range(stacks):
            rows = slice(stack * STACK, (stack + 1) * STACK)
            self._centers[rows, :2] = np.array(divmod(stack, side)) - 0.5 * side
            self._centers[rows, 2] = 0.5 * np.arange(STACK)
            self._phases[rows], self._speeds[rows] = self._phases[stack], self._speeds[stack]
        self._turns[:stacked], self._starts[:stacked] = 0.0, [0.0, 0.0, 0.0, 1.0]
        self._rise = np.where(np.arange(count) < stacked, 0.0, 0.15)

    def poses(self, seconds: float) -> NDArray[np.float64]:
        """Return poses (n, 7)."""
        angles = self._phases + self._speeds * seconds
        heights = self._rise * np.sin(2.0 * angles)
        circle = np.stack([0.3 * np.cos(angles), 0.3 * np.sin(angles), heights], axis=1)
        rotations = Rotation.from_rotvec(self._turns * seconds) * Rotation.from_quat(self._starts)
        return np.concatenate([self._centers + circle, rotations.as_quat()], axis=1)


def run(meshes: int, cycles: int, times: float, clock: Clock, seed: int = 0) -> dict[str, Any]:
    """Return what happened, as numbers by name."""
    rng = np.random.default_rng(seed)
    scene, slots = build(meshes)
    motion = Motion(meshes, rng)
    free = []
    for k in range(WARM_UP):
        scene.move_indices(slots, motion.poses(-k * STEP))
        start = clock()
        scene.check()
        free.append(clock() - start)
    budget = float(np.median(free)) / times
    scene.time_budget = Budget(budget, clock)
    twin, _ = build(meshes)
    seconds, caps, shares, missed = [], [], np.zeros(len(Accuracy)), 0
    for k in range(WARM_UP + cycles):
        poses = motion.poses(k * STEP)
        scene.move_indices(slots, poses)
        start = clock()
        report = scene.check()
        end = clock()
        if k < WARM_UP:
            continue
        seconds.append(end - start)
        caps.append(report.cap)
        shares += np.bincount(report.accuracies, minlength=len(Accuracy))
        if k % COMPARED == 0:
            twin.move_indices(slots, poses)
            missed += len(set(twin.check().names()) - set(report.names()))
    taken = np.array(seconds)
    return {
        "meshes": meshes,
        "cycles": cycles,
        "budget_ms": 1e3 * budget,
        "free_ms": 1e3 * float(np.median(free)),
        "pairs": float(shares.sum() / cycles),
        "within": float((taken <= budget).mean()),
        "percentiles_ms": (1e3 * np.percentile(taken, [50, 95, 99, 100])).tolist(),
        "changes": sum(a != b for a, b in pairwise(caps)),
        "caps": {level.name.lower(): caps.count(level) for level in Accuracy if level in caps},
        "accuracies": {
            r.name.lower(): float(shares[r] / shares.sum()) for r in Accuracy if shares[r]
        },
        "missed": missed,
    }


@interruptible("budget")
def main(arguments: list[str] | None = None) -> None:
    """Print what happened; ``--json FILE`` writes it too."""
    parser = Parser(description="does the time budget of a scene hold?")
    option(parser, "--meshes", whole(1, 10**6), 400, "moving meshes")
    option(parser, "--cycles", whole(1, 10**9), 500, "cycles that count")
    option(parser, "--times", real(1e-3, 1e6), 10.0, "factor by which 'mesh' exceeds the budget")
    option(parser, "--json", new_file(), text="write the figures to a file")
    parser.add_argument("--processor", action="store_true", help="measure processor time")
    options = parser.parse_args(arguments)
    clock = time.process_time if options.processor else time.perf_counter
    row = run(options.meshes, options.cycles, options.times, clock)
    median, most, worst, longest = row["percentiles_ms"]
    print(
        f"{row['meshes']} moving meshes, {row['pairs']:.0f} pairs reported; "
        f"on mesh {row['free_ms']:.1f} ms a cycle, budget {row['budget_ms']:.2f} ms\n"
        f"within budget {row['within']:.1%} of {row['cycles']} cycles; median {median:.2f} ms, "
        f"95 % {most:.2f}, 99 % {worst:.2f}, longest {longest:.2f}\n"
        f"cap changed {row['changes']} times; cycles by cap: {row['caps']}\n"
        f"reported pairs by level: { {k: f'{v:.1%}' for k, v in row['accuracies'].items()} }\n"
        f"collisions of triangles missed: {row['missed']}"
    )
    if options.json:
        options.json.write_text(json.dumps(row, indent=1))


if __name__ == "__main__":
    raise SystemExit(main())

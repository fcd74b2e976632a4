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

"""Costs of each effect beside the step without: ``obb_collision speed --effects``.

The scenes that come with the package move as their files say, and every variant makes the same
steps in turn: the pairs alone, the scene with every effect off, with each effect that its file has
alone, and with all of these. What an effect costs is how much longer the same step took with it.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision.benchmarks.tables import Table
from obb_collision.benchmarks.timing import Show
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.report import Report
from obb_collision.scene.scene import Scene
from obb_collision.scene_files import READY, SceneDescription, load_scene
from obb_collision.typing import Floats

#: Of the scenes of the package those whose objects are all in the file: links come by topics.
SCENES = tuple(name for name in READY if name != "arm_cell")
#: Poses are published at this rate (Hz) and a step is one of them.
RATE = 30.0
#: States that every turn goes through, ten seconds, and as many to warm up with.
FRAMES = 300
PAIRS, OFF, ALL = "pairs alone", "effects off", "all"


class CostRow(NamedTuple):
    """Steps of one variant of one scene; times in microseconds."""

    scene: str
    variant: str
    objects: int
    step_us: float  #: median
    extra_us: float  #: median of what the same step took beyond the one with the effects off
    ratio: float  #: median of step to step with the effects off
    ran_on: float  #: pairs or points that the effects ran on, mean of a step


class Moment(NamedTuple):
    """The state of a scene at one moment."""

    poses: Floats
    twists: Floats
    points: NDArray[Any] | None


class Variant:
    """A scene of a description in which some effects are on and all others off."""

    def __init__(self, description: SceneDescription, effects: tuple[str, ...]) -> None:
        self.scene: Scene = description.build()
        self.scene.time_budget = None  # it would compensate effects by a lower accuracy
        self.rows = np.array([self.scene.index(name) for name in description.names])
        for name in EFFECTS:
            self.scene.set_effect(name, "on" if name in effects else "off")

    def set(self, frame: Moment) -> None:
        """Bring the scene to a state."""
        self.scene.move_indices(self.rows, frame.poses)
        self.scene.set_twists(self.rows, frame.twists)
        if frame.points is not None:
            self.scene.obstacle_points = frame.points

    def step(self, frame: Moment) -> Report | None:
        """Set a state and check."""
        self.set(frame)
        return self.scene.check()


class PairsOnly(Variant):
    """The same without the machinery of effects: only what finds the pairs."""

    def step(self, frame: Moment) -> None:
        """Set a state and find the pairs."""
        self.set(frame)
        self.scene._find()


def frames_of(description: SceneDescription) -> list[Moment]:
    """Return the states of a scene that all variants go through."""
    scene = description.build()
    frames = []
    for number in range(FRAMES):
        poses, twists = description.states(number / RATE)
        points = None
        if description.lidar is not None:
            scene.move_many(description.names, poses)
            points = description.lidar.scan(scene, number / RATE)
        frames.append(Moment(poses, twists, points))
    return frames


def effects_of(description: SceneDescription) -> tuple[str, ...]:
    """Return the effects of a file, and ``separations``, which every user of pairs has."""
    choices = description.effects
    named = [name for name in EFFECTS if name in choices and choices[name].mode != "off"]
    return tuple(dict.fromkeys(["separations", *named]))


def run_scene(name: str, seconds: float) -> list[CostRow]:
    """Measure a scene file for about ``seconds``."""
    description = load_scene(name)
    names, frames = effects_of(description), frames_of(description)
    variants: dict[str, Variant] = {
        PAIRS: PairsOnly(description, ()),
        OFF: Variant(description, ()),
    }
    variants |= {effect: Variant(description, (effect,)) for effect in names}
    if len(names) > 1:
        variants[ALL] = Variant(description, names)
    for frame in frames:
        for variant in variants.values():
            variant.step(frame)
    times: dict[str, list[float]] = {key: [] for key in variants}
    counts = dict.fromkeys(variants, 0)
    rng = np.random.default_rng(0)
    end, turn = perf_counter() + seconds, 0
    while turn < 2 or perf_counter() < end:
        for frame in frames:
            for key in rng.permutation(list(variants)).tolist():  # the predecessor matters
                start = perf_counter()
                report = variants[key].step(frame)
                times[key].append(perf_counter() - start)
                if report is not None:
                    counts[key] += sum(cost.count for cost in report.costs.values())
                    del report  # a report in use makes the scene copy its boxes
        turn += 1
    return [_row(description, key, times, counts[key]) for key in variants]


def _row(
    description: SceneDescription, key: str, times: dict[str, list[float]], count: int
) -> CostRow:
    steps, base = 1e6 * np.array(times[key]), 1e6 * np.array(times[OFF])
    return CostRow(
        scene=description.name,
        variant=key,
        objects=len(description.objects),
        step_us=float(np.median(steps)),
        extra_us=float(np.median(steps - base)),
        ratio=float(np.median(steps / base)),
        ran_on=count / len(steps),
    )


def run_effects(seconds: float, show: Show) -> list[CostRow]:
    """Measure all scenes that come with the package."""
    rows: list[CostRow] = []
    for name in SCENES:
        show(f"{name} ...")
        rows += run_scene(name, seconds / len(SCENES))
    return rows


def cost_table(rows: list[CostRow]) -> Table:
    """Return the table."""
    lines = [["scene", "step with", "µs", "more, µs", "ratio", "ran on"]]
    for r in rows:
        figures = [f"{r.step_us:.1f}", f"{r.extra_us:.1f}", f"{r.ratio:.3f}", f"{r.ran_on:.1f}"]
        lines.append([r.scene, r.variant, *figures])
    return lines


def off_lines(rows: list[CostRow]) -> list[str]:
    """Return what a step with all effects off takes, beside the pairs alone."""
    return [
        f"{row.scene}: effects off / pairs alone {1.0 / row.ratio:.3f}"
        for row in rows
        if row.variant == PAIRS
    ]

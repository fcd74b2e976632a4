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

"""Costs of effects beside the step without, and their errors by accuracy.

Costs (``obb_collision speed --effects``): the scenes that come with the package move as their
files say, and every variant makes the same steps in turn: the pairs alone, the scene with every
effect off, with each effect that its file has alone, and with all of these. An effect costs how
much longer the same step took with it.

Errors: pairs of the shapes of a corpus, each pair alone, at distances at which they are apart,
collide, or come nearer with 1 m/s. Every effect computes them on every level that it has; the
error is the difference to its finest level, and for times the way that is covered in it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision.benchmarks.corpora import Corpus
from obb_collision.benchmarks.measuring import Show, Table, on_threads, take_turns
from obb_collision.demo.motion import Motions, read_motions
from obb_collision.demo.sensors import World
from obb_collision.geometry.poses import as_poses
from obb_collision.scene.effects import EFFECTS, LEVELS
from obb_collision.scene.effects.sweep import SweptPairs
from obb_collision.scene.report import Report
from obb_collision.scene.scene import Scene
from obb_collision.scene_files import READY, SceneDescription, find_scene, load_scene
from obb_collision.shapes import Shape
from obb_collision.typing import Floats, Rows

#: Of the scenes of the package those whose objects are all in the file: links come by topics.
COST_SCENES = tuple(name for name in READY if name not in ("arm_cell", "camera"))
#: Poses are published at this rate (Hz) and a step is one of them.
FRAME_RATE = 30.0
#: States that every turn goes through, ten seconds, and as many to warm up with.
SCENE_FRAMES = 300
PAIRS_ALONE, EFFECTS_OFF, ALL_EFFECTS = "pairs alone", "effects off", "all"


class CostRow(NamedTuple):
    """Steps of one variant of one scene; times in microseconds."""

    scene: str
    variant: str
    objects: int
    step_us: float  #: median
    extra_us: float  #: median of the extra time over the same step with the effects off
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
        self.scene.objects.set_twists(self.rows, frame.twists)
        if frame.points is not None:
            self.scene.obstacle_points = frame.points

    def step(self, frame: Moment) -> Report | None:
        """Set a state and check."""
        self.set(frame)
        return self.scene.check()


class PairsOnly(Variant):
    """A scene without effects: each step only finds the pairs."""

    def step(self, frame: Moment) -> None:
        """Set a state and find the pairs."""
        self.set(frame)
        self.scene._checks.checker.find(exact=False)


def frames_of(motions: Motions) -> list[Moment]:
    """Return the states of a scene that all variants go through."""
    world = World(motions)
    frames = []
    for number in range(SCENE_FRAMES):
        time = number / FRAME_RATE
        world.place(time)
        points = [world.see(sensor, time).points.astype("f4") for sensor in motions.sensors]
        frames.append(Moment(*motions.states(time), np.concatenate(points) if points else None))
    return frames


def run_scene(name: str, seconds: float) -> list[CostRow]:
    """Measure a scene file for about ``seconds``."""
    description = load_scene(name)
    choices = description.effects
    frames = frames_of(read_motions(description, find_scene(name)))
    on = [name for name in EFFECTS if name in choices and choices[name].mode != "off"]
    names = tuple(dict.fromkeys(["separations", *on]))  # which every user of pairs has
    variants: dict[str, Variant] = {
        PAIRS_ALONE: PairsOnly(description, ()),
        EFFECTS_OFF: Variant(description, ()),
    }
    variants |= {effect: Variant(description, (effect,)) for effect in names}
    if len(names) > 1:
        variants[ALL_EFFECTS] = Variant(description, names)
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
    steps, base = 1e6 * np.array(times[key]), 1e6 * np.array(times[EFFECTS_OFF])
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
    for name in COST_SCENES:
        show(f"{name} ...")
        rows += run_scene(name, seconds / len(COST_SCENES))
    return rows


def cost_table(rows: list[CostRow]) -> Table:
    """Return the costs of effects as a table."""
    lines = [["scene", "step with", "µs", "more, µs", "ratio", "ran on"]]
    for r in rows:
        figures = [f"{r.step_us:.1f}", f"{r.extra_us:.1f}", f"{r.ratio:.3f}", f"{r.ran_on:.1f}"]
        lines.append([r.scene, r.variant, *figures])
    return lines


def off_lines(rows: list[CostRow]) -> list[str]:
    """Return lines that compare a step with all effects off with the pairs alone."""
    return [
        f"{row.scene}: effects off / pairs alone {1.0 / row.ratio:.3f}"
        for row in rows
        if row.variant == PAIRS_ALONE
    ]


#: What is measured, and how far the centres of a pair are apart (m; shapes measure 1 m across).
CENTER_DISTANCES = {"clearance": (0.5, 1.3), "contacts": (0.05, 0.4), "sweep": (1.0, 1.6)}
#: What is read of each: a distance, a depth (m), a time (s) at 1 m/s.
EFFECT_VALUES = {"clearance": "distances", "contacts": "depths", "sweep": "times"}
#: Metres between pairs, each of which is alone; speed of approach, m/s, and for how long, s.
CELL_SIZE, SPEED, HORIZON = 6.0, 1.0, 1.5
EFFECT_OPTIONS = {"clearance": {"max_distance": 3.0}, "sweep": {"horizon": HORIZON}}


@dataclass
class EffectRow:
    """An effect on a level, or a peer's: time per pair, errors (m) to the finest level."""

    effect: str
    name: str
    peer: bool
    pairs: int
    pair_ns: float = 0.0
    mean_error: float = 0.0
    worst_error: float = 0.0
    unsafe: int = 0  #: of ours: distances too long, depths too small, times too late
    differ: float | None = None  #: of peers: at most, from our level of the same shapes


class PlacedPairs(NamedTuple):
    """Pairs (m, 2) of bodies and the shape of each (m, 2); centers (n, 3), rotations (n, 3, 3)."""

    shapes: Sequence[Shape]
    rows: Rows
    centers: Floats
    rotations: Floats
    pairs: Rows


#: What peers answer about pairs, by their names: a value of each pair (m,).
Peers = Mapping[str, Callable[[], Floats]]


Values = dict[tuple[int, int], float]
"""A value of each pair (i, j)."""


def measure_effects(
    corpus: Corpus,
    pairs: int,
    seconds: float,
    seed: int,
    show: Show,
    peers: Callable[[str, PlacedPairs], Peers] = lambda effect, query: {},
) -> list[EffectRow]:
    """Measure all effects on pairs of a corpus in about ``seconds``.

    peers: what to compare with; only developers' tools have any.
    """
    rows: list[EffectRow] = []
    shapes = list(corpus.shapes.values())
    for number, effect in enumerate(CENTER_DISTANCES):
        show(f"{corpus.name}: {effect} on every level")
        rng = np.random.default_rng([seed, number])
        chosen = rng.integers(0, len(shapes), (pairs, 2))
        with on_threads(1):
            scene, poses = _scene_of_pairs(effect, shapes, chosen, rng)
            runs: dict[str, Callable[[], Any]] = {
                level: partial(_values, scene, effect, level)
                for level in ("obb", *(level.label for level in LEVELS[effect]))
            }
            by_level = {level: run() for level, run in runs.items()}
            kept = _comparable(effect, list(by_level.values()))
            values = {k: np.array([own[pair] for pair in kept]) for k, own in by_level.items()}
            both = np.array(kept, np.int64).reshape(-1, 2)
            query = PlacedPairs(shapes, chosen.ravel()[both], *as_poses(poses), both)
            asked = peers(effect, query)
            values |= {label: ask() for label, ask in asked.items()}
            times = take_turns(runs | dict(asked), seconds / len(CENTER_DISTANCES))
        for name in values:
            count = len(by_level[name]) if name in by_level else len(kept)
            pair_ns = 1e9 * times.best(name) / max(1, count)
            rows.append(_row_of(effect, name, values, list(by_level)[-1], pair_ns))
    return rows


def _scene_of_pairs(
    effect: str, shapes: Sequence[Shape], chosen: np.ndarray, rng: np.random.Generator
) -> tuple[Scene, Floats]:
    """Return a scene of pairs of shapes (m, 2), each pair alone, and poses (2m, 7)."""
    scene = Scene(accuracy="mesh")
    offsets = _unit(rng.normal(size=(len(chosen), 3)))
    side = int(np.ceil(len(chosen) ** (1 / 3)))
    cells = CELL_SIZE * np.stack(np.unravel_index(np.arange(len(chosen)), (side,) * 3), axis=1)
    far = rng.uniform(*CENTER_DISTANCES[effect], (len(chosen), 1))
    centers = np.stack([cells, cells + far * offsets], axis=1).reshape(-1, 3)
    poses = np.column_stack([centers, _unit(rng.normal(size=(len(centers), 4)))])
    for n, row in enumerate(chosen.ravel().tolist()):
        scene.add(f"{n}", shapes[row], poses[n])
    if effect == "sweep":
        twists = np.zeros((len(chosen), 6))
        twists[:, :3] = -SPEED * offsets
        scene.objects.set_twists(scene.indices[1::2], twists)
    return scene, poses


def _values(scene: Scene, effect: str, level: str) -> Values:
    """Return the values of an effect on a level."""
    options: dict[str, Any] = EFFECT_OPTIONS.get(effect, {})
    scene.set_effect(effect, accuracy=level, **options)
    result: Any = scene.check(effect).result(effect)
    arrays = result.predicted if isinstance(result, SweptPairs) else result
    values = getattr(arrays, EFFECT_VALUES[effect]).tolist()
    return dict(zip(map(tuple, arrays.pairs.tolist()), values, strict=True))


def _comparable(effect: str, levels: Sequence[Values]) -> list[tuple[int, int]]:
    """Return the pairs that all levels decide; of distances, those apart on the finest level."""
    return [
        pair
        for pair in sorted(set.intersection(*map(set, levels)))
        if np.isfinite([values[pair] for values in levels]).all()
        and (effect != "clearance" or levels[-1][pair] > 0.0)
    ]


def _row_of(
    effect: str, name: str, values: Mapping[str, Floats], finest: str, pair_ns: float
) -> EffectRow:
    value, truth = values[name], values[finest]
    row = EffectRow(effect, name, " " in name, len(truth), pair_ns)
    errors = np.abs(value - truth)
    row.mean_error = float(errors.mean()) if len(truth) else 0.0
    row.worst_error = float(errors.max(initial=0.0))
    if row.peer:  # hulls that overlap have the least distance if the shapes are apart
        same = values[name.split()[-1]]
        apart = (same > np.finfo(np.float64).tiny) | (effect != "clearance")
        row.differ = float(np.abs(value - same)[apart].max(initial=0.0))
    else:
        sign = -1.0 if effect == "contacts" else 1.0
        row.unsafe = int((sign * (value - truth) > 1e-9).sum())
    return row


def _unit(v: Floats) -> Floats:
    return v / np.linalg.norm(v, axis=1, keepdims=True)

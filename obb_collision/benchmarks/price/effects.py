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

"""What accuracy costs the effects: clearance, contacts and time of impact per level.

Pairs of the shapes of a corpus, each pair alone, at distances at which they are apart, collide, or
come nearer with 1 m/s. Every effect computes them on every level that it has; the error is the
difference to its finest level, and for times the way that is covered in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from obb_collision.benchmarks.price.effect_peers import EFFECT_PEERS, PlacedPairs
from obb_collision.benchmarks.price.scenes import Corpus
from obb_collision.benchmarks.price.turns import on_threads, take_turns
from obb_collision.geometry.poses import as_poses
from obb_collision.scene.effects import EFFECTS, LEVELS
from obb_collision.scene.effects.base import ACCURACY, Cycle, Setting
from obb_collision.scene.effects.sweep import SweptPairs
from obb_collision.scene.scene import Scene
from obb_collision.shapes import Shape
from obb_collision.typing import Floats

#: What is measured, and how far the centres of a pair are apart (m; shapes measure 1 m across).
SPREADS = {"clearance": (0.5, 1.3), "contacts": (0.05, 0.4), "sweep": (1.0, 1.6)}
#: What is read of each: a distance, a depth (m), a time (s) at 1 m/s.
VALUES = {"clearance": "distances", "contacts": "depths", "sweep": "times"}
#: Metres between pairs, each of which is alone; speed of approach, m/s, and for how long, s.
CELL, SPEED, HORIZON = 6.0, 1.0, 1.5
OPTIONS = {"clearance": {"max_distance": 3.0}, "sweep": {"horizon": HORIZON}}


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


@dataclass
class Stage:
    """Pairs of an effect: those of which every level has a value, and how to compute them."""

    effect: str
    cycle: Cycle
    settings: dict[str, Setting]
    values: dict[str, Floats] = field(default_factory=dict)

    def run(self, level: str) -> dict[tuple[int, int], float]:
        """Return the value of each pair (i, j) on a level."""
        result = EFFECTS[self.effect].run(self.cycle, self.settings[level]).result
        found = result.predicted if isinstance(result, SweptPairs) else result
        values = getattr(found, VALUES[self.effect]).tolist()
        return dict(zip(map(tuple, found.pairs.tolist()), values, strict=True))


def measure_effects(
    corpus: Corpus, pairs: int, seconds: float, seed: int, show: Callable[[str], None]
) -> list[EffectRow]:
    """Measure all effects on pairs of a corpus in about ``seconds``, beside the installed peers."""
    rows: list[EffectRow] = []
    shapes = list(corpus.shapes.values())
    for number, effect in enumerate(SPREADS):
        show(f"{corpus.name}: {effect} on every level")
        rng = np.random.default_rng([seed, number])
        chosen = rng.integers(0, len(shapes), (pairs, 2))
        with on_threads(1):
            rows += _measure(effect, shapes, chosen, rng, seconds / len(SPREADS))
    return rows


def _measure(
    effect: str,
    shapes: Sequence[Shape],
    chosen: np.ndarray,
    rng: np.random.Generator,
    seconds: float,
) -> list[EffectRow]:
    scene = Scene(accuracy="mesh")
    offsets = _unit(rng.normal(size=(len(chosen), 3)))
    side = int(np.ceil(len(chosen) ** (1 / 3)))
    cells = CELL * np.stack(np.unravel_index(np.arange(len(chosen)), (side,) * 3), axis=1)
    far = rng.uniform(*SPREADS[effect], (len(chosen), 1))
    centers = np.stack([cells, cells + far * offsets], axis=1).reshape(-1, 3)
    poses = np.column_stack([centers, _unit(rng.normal(size=(len(centers), 4)))])
    for n, row in enumerate(chosen.ravel().tolist()):
        scene.add(f"{n}", shapes[row], poses[n])
    if effect == "sweep":
        twists = np.zeros((len(chosen), 6))
        twists[:, :3] = -SPEED * offsets
        scene.set_twists(scene.indices[1::2], twists)
    levels = ["obb", *(level.name.lower() for level in LEVELS[effect])]
    stage = _stage(scene, effect, levels)
    found = {level: stage.run(level) for level in levels}
    common = sorted(set.intersection(*(set(values) for values in found.values())))
    common = [
        pair
        for pair in common
        if np.isfinite([found[level][pair] for level in levels]).all()  # decided
        and (effect != "clearance" or found[levels[-1]][pair] > 0.0)
    ]
    values = {level: np.array([found[level][pair] for pair in common]) for level in levels}
    kept = np.array(common, np.int64).reshape(-1, 2)
    query = PlacedPairs(shapes, chosen.ravel()[kept], *as_poses(poses), kept)
    peers = {
        peer.label: asked for peer in EFFECT_PEERS.get(effect, ()) if (asked := peer.load(query))
    }
    values |= {label: ask() for label, ask in peers.items()}
    runs: dict[str, Callable[[], object]] = {level: partial(stage.run, level) for level in levels}
    times = take_turns(runs | peers, seconds, dict.fromkeys(runs | peers, partial(_forget, stage)))
    counts = dict.fromkeys(peers, len(common)) | {level: len(found[level]) for level in levels}
    truth, sign = values[levels[-1]], -1.0 if effect == "contacts" else 1.0
    rows = []
    for name, value in values.items():
        row = EffectRow(effect, name, name in peers, len(common))
        row.pair_ns = 1e9 * times.best(name) / max(1, counts[name])
        if len(common):
            errors = np.abs(value - truth)
            row.mean_error, row.worst_error = float(errors.mean()), float(errors.max())
        if row.peer:
            same = values.get(name.split()[-1])
            if same is not None:  # clearance: depths are compared as those of contacts
                # hulls that overlap have the least distance if the shapes are apart
                apart = (same > np.finfo(np.float64).tiny) | (effect != "clearance")
                row.differ = float(np.abs(value - same)[apart].max(initial=0.0))
        else:
            row.unsafe = int((sign * (value - truth) > 1e-9).sum())
        rows.append(row)
    return rows


def _stage(scene: Scene, effect: str, levels: list[str]) -> Stage:
    """Return a check of a scene, and the settings of an effect on each level."""
    options: dict[str, Any] = {
        "clearance": {"max_distance": 3.0},
        "sweep": {"horizon": HORIZON},
    }.get(effect, {})
    scene.set_effect(effect, accuracy=levels[-1], **options)
    report = scene.check()
    values = {key: option.default for key, option in EFFECTS[effect].options.items()} | options
    settings = {level: Setting(values=values | {ACCURACY: level}) for level in levels}
    return Stage(effect, report.cycle, settings)


def _forget(stage: Stage) -> None:
    """Let the next turn compute what a turn before may have left behind."""
    if stage.cycle.shapes is not None:
        stage.cycle.shapes.forget()


def _unit(v: Floats) -> Floats:
    return v / np.linalg.norm(v, axis=1, keepdims=True)

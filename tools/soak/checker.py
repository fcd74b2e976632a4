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

"""Compares answers of the node with the truth, whichever changes of a step they have.

The truth: all pairs, by the corners of both boxes on 15 axes. It shares no code and no formula
with the library, which projects radii and searches by bounds. Doubles decide but for gaps below
``SURE``. Boxes on the grid are exact: their coordinates are multiples of 1/8 and their axes those
of the frame, so nothing is rounded, and touching is a collision.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from obb_collision.node.messages.names import namespace_number
from obb_collision.typing import Floats, Integers
from tools.cases.placement import rotations_of
from tools.fuzz.process import Usage, Usages
from tools.soak.world import GRID, TRANSFORM, Bodies, Change, Key, World, anchor, beacon, rows_of

MB = 1e6
WINDOW = 0.1
"""Share of the samples after the warm-up at each end that are compared: their medians."""

HELD = {
    "memory": "memory of the node (MB)",
    "children": "memory of the process that builds shapes (MB)",
}
LEVELS = (50, 95, 99)
FEW = 2
"""Descriptors or threads more at the end than after the warm-up are no growth up to this many."""


@dataclass
class Result:
    """What was sent, checked and measured.

    growth: MB that the node may grow between warm-up and end.
    """

    growth: float
    steps: int = 0
    seconds: float = 0.0
    sent: Counter[str] = field(default_factory=Counter)
    bodies: Counter[str] = field(default_factory=Counter)
    checked: int = 0
    """Answers."""
    pairs: int = 0
    """Colliding pairs in them."""
    unsure: int = 0
    """Pairs too close to call."""
    wrong: int = 0
    failure: dict[str, Any] = field(default_factory=dict)
    """The first wrong answer."""
    stopped: str = ""
    """Why the run ended early."""
    latencies: list[float] = field(default_factory=list)
    usages: Usages = field(default_factory=lambda: Usages(0.0, WINDOW))
    """Since the warm-up."""
    refused: dict[str, int] = field(default_factory=dict)

    def faults(self) -> list[str]:
        """Return the goals that were missed."""
        texts = [self.stopped] if self.stopped else []
        if self.wrong:
            texts.append(f"{self.wrong} wrong answers")
        if not self.checked:
            texts.append("nothing was checked")
        texts += [f"refused: {reason} {count}" for reason, count in self.refused.items()]
        for name, (first, last) in self._held().items():
            limit, unit = (FEW, "") if name in ("descriptors", "threads") else (self.growth, " MB")
            if last - first > limit:
                texts.append(f"{name} grew by {last - first:.3g}{unit}")
        return texts

    def _held(self) -> dict[str, tuple[float, float]]:
        """Return the resources of the process after warm-up and at the end; memory in MB."""
        if not self.usages.samples:
            return {}
        pairs = zip(Usage._fields, *self.usages.ends(), strict=True)
        return {
            name: (first / MB, last / MB) if name in ("memory", "children") else (first, last)
            for name, first, last in pairs
        }

    def lines(self) -> list[str]:
        """Return the lines to print."""
        sent = ", ".join(f"{topic} {count}" for topic, count in sorted(self.sent.items()))
        bodies = ", ".join(f"{count} {name}" for name, count in sorted(self.bodies.items()))
        rate = self.checked / self.seconds if self.seconds else 0.0
        lines = [
            f"{self.seconds:.0f} s, {self.steps} steps; messages: {sent}",
            f"bodies: {bodies}",
            f"answers checked: {self.checked} ({rate:.0f} per second), wrong: {self.wrong}; "
            f"colliding pairs in them: {self.pairs}, too close to call: {self.unsure}",
        ]
        if self.latencies:
            figures = ", ".join(f"{name} {value:.1f}" for name, value in self.latency().items())
            lines.append(f"from the publication of a step to its answer (ms): {figures}")
        for name, (first, last) in self._held().items():
            what = HELD.get(name, name)
            lines.append(f"{what}: {first:.10g} after the warm-up, {last:.10g} at the end")
        return lines

    def latency(self) -> dict[str, float]:
        """Return percentiles of the latency, and the longest (ms)."""
        if not self.latencies:
            return {}
        times = 1e3 * np.array(self.latencies)
        values = np.percentile(times, LEVELS).round(3).tolist()
        named = dict(zip((f"{level} %" for level in LEVELS), values, strict=True))
        return named | {"longest": round(float(times.max()), 3)}

    def summary(self) -> dict[str, Any]:
        """Return all figures, for a file."""
        names = ("steps", "seconds", "checked", "wrong", "pairs", "unsure", "sent", "bodies")
        figures = {name: getattr(self, name) for name in names}
        more = {"latency (ms)": self.latency(), "after warm-up and at the end": self._held()}
        faults = {"not held": self.faults(), "refused": self.refused, "failure": self.failure}
        samples = [one._asdict() for one in self.usages.samples]
        return figures | more | faults | {"samples": samples}


SURE = 1e-9
"""Gaps of this size (m) are decided: a million times what is rounded in coordinates below 1e3 m."""
NO_AXIS = 1e-7
"""Edge axes shorter than this are of parallel edges: the other axes decide."""
CORNERS = np.array(list(product((-0.5, 0.5), repeat=3)))


class Truth(NamedTuple):
    """Pairs that collide, or that doubles do not decide.

    pairs (m, 2) rows i < j; depths (m,) minimum translation that separates (m); sure (m,).
    """

    pairs: Integers
    depths: Floats
    sure: np.ndarray


def truth_of(poses: Floats, sizes: Floats) -> Truth:
    """Test each pair of boxes: poses (n, 7), sizes (n, 3) edge lengths."""
    rotations = rotations_of(poses[:, 3:])
    corners = np.einsum("kc,nic->nki", CORNERS, rotations * sizes[:, None, :])
    corners += poses[:, None, :3]
    pairs = _near(poses[:, :3], 0.5 * np.linalg.norm(sizes, axis=1))
    i, j = pairs.T
    gaps = _gaps(corners[i], corners[j], rotations[i], rotations[j])
    exact = _on_grid(poses, sizes)
    sure = (np.abs(gaps) > SURE) | (exact[i] & exact[j])
    collide = (gaps <= 0.0) | ~sure
    return Truth(pairs[collide], -gaps[collide], sure[collide])


def _near(centers: Floats, radii: Floats) -> Integers:
    """Return the rows of all pairs but those whose balls are apart."""
    i, j = np.triu_indices(len(centers), 1)
    offsets = centers[i] - centers[j]
    reach = radii[i] + radii[j] + SURE
    near = np.einsum("nk,nk->n", offsets, offsets) <= reach * reach
    return np.stack([i[near], j[near]], axis=1)


def _gaps(corners_a: Floats, corners_b: Floats, axes_a: Floats, axes_b: Floats) -> Floats:
    """Return the largest gap of each pair over 15 unit axes (m); negative: the depth."""
    crossed = np.cross(axes_a[:, :, :, None], axes_b[:, :, None, :], axis=1)
    lengths = np.linalg.norm(crossed, axis=1, keepdims=True)
    null = lengths[:, 0].reshape(-1, 9) < NO_AXIS
    crossed = (crossed / np.maximum(lengths, NO_AXIS)).reshape(-1, 3, 9)
    axes = np.concatenate([axes_a, axes_b, crossed], axis=2)
    a, b = np.matmul(corners_a, axes), np.matmul(corners_b, axes)
    gaps = np.maximum(b.min(axis=1) - a.max(axis=1), a.min(axis=1) - b.max(axis=1))
    gaps[:, 6:][null] = -np.inf
    largest: Floats = gaps.max(axis=1, initial=-np.inf)
    return largest


def _on_grid(poses: Floats, sizes: Floats) -> np.ndarray:
    steps = np.concatenate([poses[:, :3], 0.5 * sizes], axis=1) / GRID
    upright = (poses[:, 3:] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
    exact: np.ndarray = (steps == np.round(steps)).all(axis=1) & upright
    return exact


Pair = tuple[tuple[int, int], tuple[int, int]]
"""Number of the namespace and id of both bodies, in order."""
Found = dict[Pair, float]
"""Depths (m) of colliding pairs."""
SHOWN = 20
"""Pairs named of a wrong answer."""


class Wanted(NamedTuple):
    """Pairs that certainly collide, and pairs that are too close to call."""

    pairs: Found
    unsure: set[Pair]


class Checker:
    """Judges answers, step by step."""

    def __init__(self, world: World, result: Result) -> None:
        self.world, self.result = world, result
        self._changes: dict[str, Change] = {}
        self._wanted: dict[tuple[tuple[str, int], ...], Wanted] = {}

    def begin(self, changes: dict[str, Change]) -> None:
        """Begin a step: later answers may have any of its changes."""
        self._changes = changes
        self._wanted.clear()

    def end(self) -> None:
        """End a step: from now on answers have all its changes."""
        for change in self._changes.values():
            new = change.bodies.keys() - self.world.bodies.keys()
            counts = {"came": len(new), "went": len(change.gone)}
            self.result.bodies.update(counts | {"moved": len(change.bodies) - len(new)})
        self.world.apply(self._changes)
        self.begin({})

    def is_complete(self, found: Found) -> bool:
        """Return whether an answer is that to all changes: where beacons are not lit yet."""
        return not _faults(found, self._truth(dict.fromkeys(self._changes, -1)))

    def judge(self, rows: Any) -> bool:
        """Check the rows of an answer; return whether it has all changes of the step."""
        found = found_in(rows)
        has = {topic: self._has(topic, found) for topic in self._changes}
        applied = {topic: -1 for topic in self._changes if has[topic]}
        # single poses come in messages of their own: some may be there before the beacon
        rest = self._changes[TRANSFORM].bodies if not has.get(TRANSFORM, True) else {}
        guesses = [self._truth(applied)]
        guesses += [self._truth(applied | {TRANSFORM: n}) for n in range(1, len(rest))]
        faults = [_faults(found, wanted) for wanted in guesses]
        self.result.checked += 1
        self.result.pairs += len(found)
        self.result.unsure += len(guesses[0].unsure)
        if len(found) != len(rows) or all(faults):
            self.result.wrong += 1
            if not self.result.failure:
                self.result.failure = self._report(faults[0] or {"twice": []}, applied)
        return all(has.values())

    def _has(self, topic: str, found: Found) -> bool:
        lit = pair_of(beacon(topic), anchor(topic)) in found
        return lit != self.world.lit[topic]

    def _bodies(self, applied: dict[str, int]) -> Bodies:
        bodies = dict(self.world.bodies)
        for topic, count in applied.items():
            change = self._changes[topic]
            some = change.bodies if count < 0 else dict(list(change.bodies.items())[:count])
            Change(some, change.gone).apply(bodies)
        return bodies

    def _truth(self, applied: dict[str, int]) -> Wanted:
        """Return the pairs after changes; applied: changed bodies by topic, -1 for all."""
        key = tuple(sorted(applied.items()))
        if key not in self._wanted:
            bodies = self._bodies(applied)
            truth, keys = truth_of(*rows_of(bodies)), list(bodies)
            pairs = [pair_of(keys[i], keys[j]) for i, j in truth.pairs.tolist()]
            depths = dict(zip(pairs, truth.depths.tolist(), strict=True))
            unsure = {pair for pair, sure in zip(pairs, truth.sure, strict=True) if not sure}
            self._wanted[key] = Wanted(depths, unsure)
        return self._wanted[key]

    def _report(self, faults: dict[str, list[Pair]], applied: dict[str, int]) -> dict[str, Any]:
        """Return step, changes, wrong pairs and bodies of a wrong answer, for a file."""
        bodies = self._bodies(applied)
        named = {_numbers(key): key for key in bodies}
        wrong = {
            what: [[named.get(one, one) for one in pair] for pair in pairs[:SHOWN]]
            for what, pairs in faults.items()
        }
        return {
            "step": self.world.steps,
            "changes in it": sorted(applied),
            **wrong,
            "bodies": [
                {"ns": ns, "id": number, **body._asdict()} for (ns, number), body in bodies.items()
            ],
        }


def _numbers(key: Key) -> tuple[int, int]:
    return namespace_number(key[0]), key[1]


def pair_of(a: Key, b: Key) -> Pair:
    """Return a pair in the order of answers."""
    first, second = sorted((_numbers(a), _numbers(b)))
    return first, second


def found_in(rows: Any) -> Found:
    """Return the pairs of the rows of an answer."""
    names = ("ns_a", "id_a", "ns_b", "id_b", "depth")
    columns = [rows[name].tolist() for name in names]
    return {((a, b), (c, d)): depth for a, b, c, d, depth in zip(*columns, strict=True)}


def _faults(found: Found, wanted: Wanted) -> dict[str, list[Pair]]:
    """Return the faults of an answer, empty for a right one."""
    sure = wanted.pairs.keys() - wanted.unsure
    deep = [p for p in sure & found.keys() if not abs(found[p] - wanted.pairs[p]) <= SURE]
    lists = {
        "missing": sorted(sure - found.keys()),
        "too many": sorted(found.keys() - wanted.pairs.keys()),
        "wrong depth": sorted(deep),
    }
    return {what: pairs for what, pairs in lists.items() if pairs}

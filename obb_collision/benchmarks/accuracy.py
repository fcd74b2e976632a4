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

"""What accuracy costs: the command ``obb_collision accuracy``.

For every level, from spheres to triangles: the time per pair and per step, memory, preparation, and
how many of its reports are false, relative to the triangles; beside the installed peers, on the
same pairs in the same run. Then the effects on each level, and the fits of a box. All take
turns, so the ratios hold even on a noisy machine; absolute times are this machine's.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from itertools import zip_longest
from time import perf_counter, thread_time
from typing import Any, NamedTuple

import numpy as np

from obb_collision.benchmarks.contest import ContestPlan, Price, measure
from obb_collision.benchmarks.corpora import Corpus, box_corpus, file_corpus, generated_corpus
from obb_collision.benchmarks.effects import EffectRow, measure_effects
from obb_collision.benchmarks.measuring import Show, Table, as_text, machine
from obb_collision.geometry.fitting.fit import FITS, fit_points
from obb_collision.geometry.shapes.meshes import Mesh

#: Minimum share of the time that is left after compiling, which takes about a third of a run the
#: first time: a minute on a busy machine.
LEAST_SHARE = 0.6
#: Shares of the parts in the time that is left when they begin: meshes of files take the most.
TIME_SHARES = {
    "boxes": 0.15,
    "fits": 0.2,
    "reading": 0.1,
    "effects": 0.2,
    "generated": 0.5,
    "files": 1,
}
#: Pairs per effect.
EFFECT_PAIRS = 600


class FitRow(NamedTuple):
    """A fit over all meshes: volume relative to the best box of any fit, and milliseconds."""

    fit: str
    meshes: int
    mean_volume: float  #: geometric mean
    worst_volume: float
    mean_ms: float


@dataclass
class AccuracyResult:
    """The measurements of a run."""

    prices: list[Price] = field(default_factory=list)
    fits: list[FitRow] = field(default_factory=list)
    effects: list[EffectRow] = field(default_factory=list)

    @property
    def missed(self) -> int:
        """Collisions that our levels miss, and unsafe effects: none, or there is a defect."""
        wrong = sum(row.unsafe for row in self.effects)
        return sum(price.missed for price in self.prices) + wrong


def run(options: argparse.Namespace, show: Show) -> AccuracyResult:
    """Measure everything in about ``options.seconds``."""
    start, seed = perf_counter(), options.seed
    show("compiling")
    boxes, generated = box_corpus(options.bodies, seed), generated_corpus(seed)
    _warm_up(generated, seed)
    end = max(start + options.seconds, perf_counter() + LEAST_SHARE * options.seconds)

    def share(part: str) -> float:
        return TIME_SHARES[part] * max(0.0, end - perf_counter())

    corpora = {"boxes": boxes, "generated": generated}
    if options.meshes:
        show("reading meshes")
        corpora["files"] = file_corpus(options.meshes, share("reading"))
    result = AccuracyResult()
    show("fits")
    result.fits = measure_fits(corpora.values(), share("fits"), show)
    best = [corpus for corpus in corpora.values() if corpus.shapes][-1]
    pairs = min(EFFECT_PAIRS, options.pairs)
    result.effects = measure_effects(best, pairs, share("effects"), seed, show)
    for part, corpus in corpora.items():
        if not corpus.shapes:
            result.prices.append(Price(corpus.name, corpus.note, 0, 0))
            continue
        plan = ContestPlan(options.bodies, options.pairs, options.timed, share(part))
        result.prices.append(measure(corpus, plan, seed, show))
    return result


def _warm_up(generated: Corpus, seed: int) -> None:
    """Compile what is measured, on very few pairs."""
    few = Corpus("", dict(list(generated.shapes.items())[:3]))
    measure_effects(few, 30, 0.0, seed, lambda what: None)
    for corpus in (box_corpus(20, seed), few):
        measure(corpus, ContestPlan(20, 1, 10, 0.0), seed, lambda what: None)
    measure_fits([few], 0.0, lambda what: None)


def as_json(result: AccuracyResult, options: argparse.Namespace) -> dict[str, Any]:
    """Return everything measured, for a file."""
    prices = [
        asdict(price)
        | {"rows": [asdict(r) | {"false_of_reports": r.false_of_reports} for r in price.rows]}
        for price in result.prices
    ]
    return {
        "seed": options.seed,
        "seconds": options.seconds,
        "this_machine": machine(("python-fcl", "coal")),
        "corpora": prices,
        "fits": [row._asdict() for row in result.fits],
        "effects": [asdict(row) for row in result.effects],
        "missed": result.missed,
    }


def measure_fits(corpora: Iterable[Corpus], seconds: float, show: Show) -> list[FitRow]:
    """Fit boxes to the meshes of corpora, as many as fit in ``seconds``, at least one."""
    end = perf_counter() + seconds
    rows = zip_longest(*(corpus.shapes.values() for corpus in corpora))
    meshes = [shape for row in rows for shape in row if isinstance(shape, Mesh)]
    fits: list[list[tuple[float, float]]] = []
    for k, mesh in enumerate(meshes):
        if fits and perf_counter() > end:
            break
        show(f"fits {k + 1}/{len(meshes)}")
        boxes = [_fit(mesh._points(), fit) for fit in FITS]
        if min(volume for volume, _ in boxes) > 0.0:
            fits.append(boxes)
    if not fits:
        return []
    volumes, spent = np.moveaxis(np.array(fits), 2, 0)
    ratios = volumes / volumes.min(axis=1, keepdims=True)
    figures = np.exp(np.log(ratios).mean(axis=0)), ratios.max(axis=0), 1e3 * spent.mean(axis=0)
    return [
        FitRow(fit, len(fits), *values)
        for fit, values in zip(FITS, np.array(figures).T.tolist(), strict=True)
    ]


def _fit(points: np.ndarray, fit: str) -> tuple[float, float]:
    """Return volume and seconds."""
    start = thread_time()
    _, _, half_extents = fit_points(points, fit)
    return 8.0 * float(half_extents.prod()), thread_time() - start


def price_table(price: Price) -> Table:
    """Return the table of a corpus: levels and peers."""
    lines = [["", "a pair, ns", "x obb", "a step, ms", "memory, bytes", "once, ms"]]
    lines[0] += ["false reports", "missed"]
    for row in price.rows:
        ours = ((row.step_ms, ".2f"), (row.bytes, ",.0f"), (row.prepare_ms, ".1f"))
        times = [f"{row.pair_ns:,.0f}", f"{row.pair_ns / price.row('obb').pair_ns:.1f}"]
        times += ["-" if value is None else f"{value:{form}}" for value, form in ours]
        lines.append([row.name, *times, f"{row.false_of_reports:.1%}", str(row.missed)])
    return lines


def effect_table(rows: Sequence[EffectRow]) -> Table:
    """Return the table of the effects on each level, and of peers if there are any."""
    lines = [["mm", "pairs", "a pair, ns", "mean", "worst", "unsafe", "peer to ours"]]
    for row in rows:
        errors = [f"{1e3 * x:.3g}" for x in (row.mean_error, row.worst_error)]
        differ = "" if row.differ is None else f"{1e3 * row.differ:.3g}"
        unsafe = "" if row.peer else str(row.unsafe)
        figures = [f"{row.pairs}", f"{row.pair_ns:,.0f}", *errors, unsafe, differ]
        lines.append([f"{row.effect} {row.name}", *figures])
    return lines


def format_result(result: AccuracyResult) -> str:
    """Return everything as text."""
    parts = []
    for price in result.prices:
        if not price.rows:
            parts.append(f"{price.corpus}: none ({price.note})")
            continue
        head = f"{price.corpus}: {price.shapes} shapes, {price.pairs} pairs whose AABBs overlap, "
        head += f"{price.colliding} collide; a step moves {price.bodies}"
        notes = [price.note] if price.note else []
        if price.missing:
            notes.append(f"not installed, so not compared: {', '.join(price.missing)}")
        parts.append("\n".join([head, as_text(price_table(price)), *notes]))
    if result.effects:
        head = "Effects: errors to the finest level, of shapes of 1 m; of times the way at 1 m/s"
        parts.append(f"{head}\n{as_text(effect_table(result.effects))}")
    if result.fits:
        lines = [["fit", "mean volume", "worst", "ms"]]
        for row in result.fits:
            sizes = [f"{row.mean_volume:.3f}", f"{row.worst_volume:.2f}", f"{row.mean_ms:.1f}"]
            lines.append([row.fit, *sizes])
        head = f"Fits of a box to {result.fits[0].meshes} meshes: volume over the best box's"
        parts.append(f"{head}\n{as_text(lines)}")
    parts.append("\n".join(_claims(result.prices)))
    return "\n\n".join(parts)


def _claims(prices: Sequence[Price]) -> list[str]:
    """Return the promises about the levels, and whether the run confirms them."""
    missed, pairs = (sum(getattr(p, key) for p in prices) for key in ("missed", "pairs"))
    lines = [
        f"No level may miss what a more exact one reports: {missed} missed on {pairs:,} pairs."
    ]
    for price in prices:
        for label, ratio in price.ratios.items():
            level = {"box": "obb"}.get(label.split()[-1], label.split()[-1])
            times = f"takes {ratio:.1f} times as long per pair as {level}."
            lines.append(f"{price.corpus}: {label} {times}")
    lines.append(
        "Called from Python, the peers with one pair per call, the levels with all pairs in one. "
        "Ratios are medians of turns; times are this machine's. Hulls and meshes are stored once "
        "per shape."
    )
    return lines


def report(result: AccuracyResult, options: argparse.Namespace) -> int:
    """Print and write what was measured; return 1 if a level missed a collision."""
    print(format_result(result))
    if options.json:
        options.json.write_text(json.dumps(as_json(result, options), indent=1) + "\n")
    if options.picture:
        from obb_collision.benchmarks.plots import save_accuracy

        save_accuracy(result.prices, result.effects, options.picture)
    if result.missed:
        print(f"\nDEFECT: {result.missed} collisions missed", file=sys.stderr)
    return int(result.missed > 0)

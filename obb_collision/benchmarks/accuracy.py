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

"""Measures what accuracy costs: console script ``obb_collision accuracy``.

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
from obb_collision.benchmarks.corpora import Corpus, box_corpus, generated_corpus, real_corpus
from obb_collision.benchmarks.effects import EffectRow, measure_effects
from obb_collision.benchmarks.levels import BOX_PEERS, MESH_PEERS
from obb_collision.benchmarks.tables import Table, as_text, machine
from obb_collision.benchmarks.timing import Show, TimedProgress, progress
from obb_collision.cli import MAX_SEED, Parser, interruptible, new_file, option, real, whole
from obb_collision.geometry.fitting.fit import FITS, fit_points
from obb_collision.geometry.shapes.meshes import Mesh

#: Default duration of a run, seconds; compiling takes about a third of it the first time.
SECONDS = 100.0
#: Minimum share of the time that is left after compiling: a minute on a busy machine.
LEAST_SHARE = 0.6
#: Bodies in the room, pairs tested in each corpus of meshes, pairs timed beside the peers.
BODIES, PAIRS, TIMED = 2_000, 60_000, 3_000
#: Shares of the parts in the time that is left when they begin: real meshes take the most.
SHARES = {"boxes": 0.15, "fits": 0.2, "reading": 0.1, "effects": 0.2, "real": 0.6}
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
    """All that was measured."""

    prices: list[Price] = field(default_factory=list)
    fits: list[FitRow] = field(default_factory=list)
    effects: list[EffectRow] = field(default_factory=list)

    @property
    def missed(self) -> int:
        """Collisions that our levels miss, and unsafe effects: none, or there is a defect."""
        wrong = sum(row.unsafe for row in self.effects)
        return sum(price.missed for price in self.prices) + wrong


class Size(NamedTuple):
    """How much is measured, whatever the time."""

    bodies: int
    pairs: int
    timed: int


def run(seconds: float, seed: int, size: Size, bar: TimedProgress) -> AccuracyResult:
    """Measure everything in about ``seconds``."""
    bar.show("compiling")
    boxes, generated = box_corpus(size.bodies, seed), generated_corpus(seed)
    _warm_up(generated, seed)
    bar.leave(LEAST_SHARE * seconds)
    bar.show("reading real meshes")
    real = real_corpus(SHARES["reading"] * bar.left)
    result = AccuracyResult()
    bar.show("fits")
    result.fits = measure_fits([generated, real], SHARES["fits"] * bar.left, bar.show)
    best, pairs = real if real.shapes else generated, min(EFFECT_PAIRS, size.pairs)
    result.effects = measure_effects(best, pairs, SHARES["effects"] * bar.left, seed, bar.show)
    corpora = [(boxes, SHARES["boxes"]), (generated, 1.0 - SHARES["real"]), (real, 1.0)]
    for corpus, share in corpora:
        if not corpus.shapes:
            result.prices.append(Price(corpus.name, corpus.note, 0, 0))
            continue
        plan = ContestPlan(size.bodies, size.pairs, size.timed, share * bar.left)
        result.prices.append(measure(corpus, plan, seed, bar.show))
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
        asdict(price) | {"rows": [row.as_dict() for row in price.rows]} for price in result.prices
    ]
    return {
        "seed": options.seed,
        "seconds": options.seconds,
        "this_machine": machine(peer.distribution for peer in (*BOX_PEERS, *MESH_PEERS)),
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
    volumes: list[list[float]] = []
    times: list[list[float]] = []
    for k, mesh in enumerate(meshes):
        if volumes and perf_counter() > end:
            break
        show(f"fits {k + 1}/{len(meshes)}")
        points = mesh._points()
        found = [_fit(points, fit) for fit in FITS]
        if min(volume for volume, _ in found) > 0.0:
            volumes.append([volume for volume, _ in found])
            times.append([spent for _, spent in found])
    sizes, spent = np.array(volumes).reshape(-1, len(FITS)), np.array(times).reshape(-1, len(FITS))
    if len(sizes) == 0:
        return []
    ratios = sizes / sizes.min(axis=1, keepdims=True)
    return [
        FitRow(
            fit,
            len(ratios),
            float(np.exp(np.log(ratios[:, k]).mean())),
            float(ratios[:, k].max()),
            1e3 * float(spent[:, k].mean()),
        )
        for k, fit in enumerate(FITS)
    ]


def _fit(points: np.ndarray, fit: str) -> tuple[float, float]:
    """Return volume and seconds."""
    start = thread_time()
    _, _, half_extents = fit_points(points, fit)
    return 8.0 * float(half_extents.prod()), thread_time() - start


def price_table(price: Price) -> Table:
    """Return the table of a corpus: levels and peers."""
    lines = [["", "a pair, ns", "x obb", "a step, ms", "memory, bytes", "once, ms"]]
    lines[0] += ["false: of reports", "of pairs", "missed"]
    for row in price.rows:
        shares = (f"{100.0 * x:.1f}%" for x in (row.false_of_reports, row.false_of_pairs))
        ours = ((row.step_ms, ".2f"), (row.bytes, ",.0f"), (row.prepare_ms, ".1f"))
        times = [f"{row.pair_ns:,.0f}", f"{row.pair_ns / price.row('obb').pair_ns:.1f}"]
        times += ["-" if value is None else f"{value:{form}}" for value, form in ours]
        lines.append([row.name, *times, *shares, str(row.missed)])
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
    """Return what the run shows about the promises of the levels."""
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


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = Parser(
        prog="obb_collision accuracy",
        description="Measures what accuracy costs, per level: time, memory and false alarms, "
        "beside the installed peers.",
    )
    option(parser, "--seconds", real(0.001, 1e6), SECONDS, "approximate total time (s)")
    option(parser, "--seed", whole(0, MAX_SEED), 0, "seed of the random poses")
    option(parser, "--bodies", whole(1, 10**6), BODIES, "number of bodies")
    option(parser, "--pairs", whole(1, 10**8), PAIRS, "pairs per corpus")
    option(parser, "--timed", whole(1, 10**8), TIMED, "pairs timed beside the peers")
    option(parser, "--json", new_file(), text="write all numbers as JSON")
    option(parser, "--plot", new_file(".png", ".svg"), text="draw time against false alarms")
    return parser.parse_args(arguments)


@interruptible("obb_collision accuracy")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the comparison; exit code 1 if a level missed a collision or a verdict was wrong."""
    options = parse(arguments)
    size = Size(options.bodies, options.pairs, options.timed)
    with progress(options.seconds) as bar:
        result = run(options.seconds, options.seed, size, bar)
    print(format_result(result))
    if options.json:
        options.json.write_text(json.dumps(as_json(result, options), indent=1) + "\n")
    if options.plot:
        from obb_collision.benchmarks.plots import save_accuracy

        save_accuracy(result.prices, result.effects, options.plot)
    if result.missed:
        print(f"\nDEFECT: {result.missed} collisions missed", file=sys.stderr)
    return int(result.missed > 0)

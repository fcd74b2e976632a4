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
same pairs in the same run. Then the effects on each level, the fits of a box, and what certainty
costs. All take turns, so the
ratios hold even on a noisy machine; absolute times are this machine's.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from obb_collision.benchmarks.price.corpus import Plan, measure
from obb_collision.benchmarks.price.effects import EffectRow, measure_effects
from obb_collision.benchmarks.price.fits import FitRow, measure_fits
from obb_collision.benchmarks.price.floats import FloatRow, measure_floats, pair_sets
from obb_collision.benchmarks.price.peers import BOX_PEERS, MESH_PEERS
from obb_collision.benchmarks.price.plot import save_plot
from obb_collision.benchmarks.price.progress import Progress, progress
from obb_collision.benchmarks.price.rows import Price
from obb_collision.benchmarks.price.scenes import (
    Corpus,
    box_corpus,
    generated_corpus,
    real_corpus,
)
from obb_collision.benchmarks.price.tables import claims, format_result
from obb_collision.cli import MAX_SEED, Parser, interruptible, new_file, option, real, whole

#: Default duration of a run, seconds; compiling takes about a third of it the first time.
SECONDS = 100.0
#: Minimum share of the time that is left after compiling: a minute on a busy machine.
LEAST_SHARE = 0.6
#: Bodies in the room, pairs tested in each corpus of meshes, pairs timed beside the peers.
BODIES, PAIRS, TIMED = 2_000, 60_000, 3_000
#: Pairs per hard family that the kernels decide.
HARD_PAIRS = 1_000
#: Shares of the parts in the time that is left when they begin: real meshes take the most.
SHARES = {
    "boxes": 0.15, "fits": 0.15, "floats": 0.1, "reading": 0.1, "effects": 0.15, "real": 0.6,
}  # fmt: skip
#: Pairs per effect.
EFFECT_PAIRS = 600


@dataclass
class Result:
    """All that was measured."""

    prices: list[Price] = field(default_factory=list)
    fits: list[FitRow] = field(default_factory=list)
    floats: list[FloatRow] = field(default_factory=list)
    effects: list[EffectRow] = field(default_factory=list)

    @property
    def missed(self) -> int:
        """Collisions that our levels miss, and unsafe effects: none, or there is a defect."""
        wrong = sum(row.unsafe for row in self.effects)
        wrong += sum(r.false + r.missed for r in self.floats if r.kernel.startswith("certified"))
        return sum(price.missed for price in self.prices) + wrong


@dataclass(frozen=True)
class Size:
    """How much is measured, whatever the time."""

    bodies: int
    pairs: int
    timed: int
    hard: int


def run(seconds: float, seed: int, size: Size, bar: Progress) -> Result:
    """Measure everything in about ``seconds``."""
    bar.show("compiling")
    boxes, generated = box_corpus(size.bodies, seed), generated_corpus(seed)
    _warm_up(generated, seed)
    bar.leave(LEAST_SHARE * seconds)
    bar.show("reading real meshes")
    real = real_corpus(SHARES["reading"] * bar.left)
    result = Result()
    bar.show("fits")
    result.fits = measure_fits([generated, real], SHARES["fits"] * bar.left, bar.show)
    sets = pair_sets(boxes, size.bodies, size.hard, seed)
    result.floats = measure_floats(sets, SHARES["floats"] * bar.left, bar.show)
    result.effects = measure_effects(
        real if real.shapes else generated, min(EFFECT_PAIRS, size.pairs),
        SHARES["effects"] * bar.left, seed, bar.show,
    )  # fmt: skip
    corpora = [(boxes, SHARES["boxes"]), (generated, 1.0 - SHARES["real"]), (real, 1.0)]
    for corpus, share in corpora:
        if not corpus.shapes:
            result.prices.append(Price(corpus.name, corpus.note, 0, 0))
            continue
        plan = Plan(size.bodies, size.pairs, size.timed, share * bar.left)
        result.prices.append(measure(corpus, plan, seed, bar.show))
    return result


def _warm_up(generated: Corpus, seed: int) -> None:
    """Compile what is measured, on very few pairs."""
    few = Corpus("", dict(list(generated.shapes.items())[:3]))
    measure_effects(few, 30, 0.0, seed, lambda what: None)
    for corpus in (box_corpus(20, seed), few):
        measure(corpus, Plan(20, 1, 10, 0.0), seed, lambda what: None)
    measure_fits([few], 0.0, lambda what: None)
    measure_floats(pair_sets(box_corpus(20, seed), 20, 2, seed), 0.0, lambda what: None)


def machine() -> dict[str, Any]:
    """Return what the absolute times depend on."""
    peers: dict[str, str | None] = {}
    for peer in (*BOX_PEERS, *MESH_PEERS):
        try:
            peers[peer.distribution] = version(peer.distribution)
        except PackageNotFoundError:
            peers[peer.distribution] = None
    return {"machine": platform.machine(), "python": platform.python_version(), "peers": peers}


def as_json(result: Result, options: argparse.Namespace) -> dict[str, Any]:
    """Return everything measured, for a file."""
    prices = []
    for price in result.prices:
        prices.append(asdict(price) | {"rows": [row.as_dict() for row in price.rows]})
    return {
        "seed": options.seed,
        "seconds": options.seconds,
        "this_machine": machine(),
        "corpora": prices,
        "fits": [asdict(row) for row in result.fits],
        "floats": [asdict(row) for row in result.floats],
        "effects": [asdict(row) for row in result.effects],
        "claims": claims(result.prices),
        "missed": result.missed,
    }


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
    size = Size(options.bodies, options.pairs, options.timed, min(HARD_PAIRS, options.pairs))
    with progress(options.seconds) as bar:
        result = run(options.seconds, options.seed, size, bar)
    print(format_result(result.prices, result.fits, result.floats, result.effects))
    if options.json:
        options.json.write_text(json.dumps(as_json(result, options), indent=1) + "\n")
    if options.plot:
        save_plot(result.prices, result.effects, options.plot)
    if result.missed:
        print(f"\nDEFECT: {result.missed} collisions missed", file=sys.stderr)
    return int(result.missed > 0)

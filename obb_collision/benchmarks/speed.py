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

"""Measures the full step beside the installed peers: console script ``obb_collision_speed``.

A step sets every pose, updates, and finds every colliding pair. All peers see the same scenes and
take turns in one run, so the ratios hold even on a noisy machine; the times are this machine's.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from obb_collision.benchmarks.certificate import measure_certificate
from obb_collision.benchmarks.effects import format_effects, run_effects, save_effects_plot
from obb_collision.benchmarks.peers.steps import PEERS, Peer
from obb_collision.cli import MAX_SEED, Parser, interruptible, new_file, real, whole
from obb_collision.geometry.boxes import Boxes
from obb_collision.typing import Floats

SIZES = (10, 100, 1_000, 10_000)
#: Half extents of the boxes, metres.
EXTENTS = (0.05, 0.5)
#: Cubic metres per box: gives about half a colliding pair per box.
VOLUME_PER_BOX = 1.75
#: Steps of motion in turn. All boxes move and turn a little in each, as in a simulation or at the
#: rate of a robot: broad phases that update a tree are designed for that.
FRAMES = 8
#: Maximum displacement along each axis, metres, and maximum rotation about each, radians.
STEP, TURN = 0.02, 0.05


#: Minimum ratio between the heights of two labels in the plot.
LABEL_SPACING = 1.6
#: Colours of our lines in the plot, which are thick; colours and line styles of the peers'.
OURS = {"find_pairs": "#0b6e4f", "Scene": "#2ca25f"}
PEER_STYLES = (("0.25", "--"), ("0.45", "-."), ("0.6", ":"), ("0.35", (0, (5, 1))))


@dataclass(frozen=True)
class Row:
    """Times of one peer at one size."""

    peer: str
    boxes: int
    median_ms: float
    best_ms: float
    steps: int
    pairs: int
    differing_pairs: int  #: in the first frame, against find_pairs


def make_frames(count: int, seed: int) -> tuple[Floats, list[tuple[Floats, Floats]]]:
    """Return half extents (n, 3) and poses (centres, rotations) of every frame."""
    rng = np.random.default_rng(seed)
    half = 0.5 * (VOLUME_PER_BOX * count) ** (1 / 3)
    half_extents = rng.uniform(*EXTENTS, (count, 3))
    centers = rng.uniform(-half, half, (count, 3))
    rotations = Rotation.random(count, rng)
    frames = []
    for _ in range(FRAMES):
        frames.append((centers, rotations.as_matrix()))
        centers = centers + rng.uniform(-STEP, STEP, (count, 3))
        rotations = Rotation.from_rotvec(rng.uniform(-TURN, TURN, (count, 3))) * rotations
    return half_extents, frames + frames[-2:0:-1]  # there and back: no jump at the end


def run_size(count: int, seconds: float, seed: int) -> list[Row]:
    """Time every installed peer on the same frames, taking turns, for about ``seconds``."""
    half_extents, frames = make_frames(count, seed)
    peers: dict[str, Peer] = {}
    for name, module, kind in PEERS:
        if importlib.util.find_spec(module) is not None:
            peers[name] = kind(half_extents, *frames[0])
    found: dict[str, Any] = {name: peer.step(*frames[0]) for name, peer in peers.items()}
    pairs = {name: peers[name].pairs(found[name]) for name in peers}
    times: dict[str, list[float]] = {name: [] for name in peers}
    deadline = perf_counter() + seconds
    while perf_counter() < deadline or min(len(t) for t in times.values()) < FRAMES:
        frame = frames[len(times["find_pairs"]) % len(frames)]
        for name, peer in peers.items():
            start = perf_counter()
            peer.step(*frame)
            times[name].append(perf_counter() - start)
    return [
        Row(
            name,
            count,
            1e3 * float(np.median(spent)),
            1e3 * min(spent),
            len(spent),
            len(pairs[name]),
            len(pairs[name] ^ pairs["find_pairs"]),
        )
        for name, spent in times.items()
    ]


def format_table(rows: Sequence[Row]) -> str:
    """Return the rows as text, with each peer's median relative to ``find_pairs``."""
    ours = {row.boxes: row.median_ms for row in rows if row.peer == "find_pairs"}
    lines = [
        f"{'':12} {'boxes':>7} {'median ms':>10} {'best ms':>9} {'ratio':>7} {'pairs':>7}  note"
    ]
    for row in rows:
        note = f"{row.differing_pairs} pairs differ" if row.differing_pairs else ""
        lines.append(
            f"{row.peer:12} {row.boxes:7} {row.median_ms:10.3f} {row.best_ms:9.3f} "
            f"{row.median_ms / ours[row.boxes]:6.1f}x {row.pairs:7}  {note}"
        )
    return "\n".join(lines)


def save_plot(rows: Sequence[Row], path: Path) -> None:
    """Draw the quickest step over the number of boxes, both logarithmic.

    The quickest, because on a machine that others use medians depend more on the others.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 4.8), layout="constrained")
    axes = figure.subplots()
    names = list(dict.fromkeys(row.peer for row in rows))
    peers = iter(PEER_STYLES)
    ends: list[tuple[float, int, str, str]] = []
    for name in names:
        own = [row for row in rows if row.peer == name]
        color, style = (OURS[name], "-") if name in OURS else next(peers)
        axes.loglog(
            [row.boxes for row in own],
            [row.best_ms for row in own],
            marker="o",
            color=color,
            linestyle=style,
            linewidth=3.0 if name in OURS else 1.3,
        )
        label = f"obb_collision: {name}" if name in OURS else name
        ends.append((own[-1].best_ms, own[-1].boxes, label, color))
    lowest = 0.0
    for time, boxes, label, color in sorted(ends):
        lowest = max(time, lowest * LABEL_SPACING)  # labels must not cover each other
        axes.annotate(
            label,
            (boxes, lowest),
            xytext=(8, 0),
            textcoords="offset points",
            va="center",
            color=color,
            weight="bold" if label.startswith("obb_collision") else "normal",
            annotation_clip=False,
        )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(lambda value, _: f"{value:,g}")
    axes.set_xlabel("boxes, all moving")
    axes.set_ylabel("milliseconds per step (quickest)")
    axes.set_title("Set every pose, find every colliding pair")
    axes.margins(x=0.05, y=0.08)
    axes.grid(which="both", alpha=0.2)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)


def _run_effects(options: argparse.Namespace) -> int:
    rows = run_effects(options.seconds, lambda text: print(text, file=sys.stderr, flush=True))
    print(format_effects(rows))
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")
    if options.plot:
        save_effects_plot(rows, options.plot)
    return 0


@interruptible("obb_collision_speed")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark and print its table."""
    parser = Parser(
        prog="obb_collision_speed",
        description="Measures the full step beside the installed peers: sets every pose, updates, "
        "and finds every colliding pair.",
    )
    parser.add_argument(
        "--sizes", type=whole(1, 10**7), nargs="+", default=list(SIZES), help="numbers of boxes"
    )
    parser.add_argument(
        "--seconds", type=real(0.001, 1e6), default=20.0, help="approximate time for all sizes (s)"
    )
    parser.add_argument(
        "--seed", type=whole(0, MAX_SEED), default=0, help="seed of the random scenes"
    )
    parser.add_argument("--json", type=new_file(), metavar="FILE", help="write the rows as JSON")
    parser.add_argument(
        "--plot", type=new_file(".png", ".svg"), metavar="FILE", help="draw the rows, PNG or SVG"
    )
    parser.add_argument(
        "--effects",
        action="store_true",
        help="measure what each effect costs in the scenes that come with the package instead",
    )
    options = parser.parse_args(arguments)
    if options.effects:
        return _run_effects(options)
    rows: list[Row] = []
    for size in options.sizes:
        print(f"{size} boxes ...", file=sys.stderr, flush=True)
        rows += run_size(size, options.seconds / len(options.sizes), options.seed)
    print(format_table(rows))
    half_extents, frames = make_frames(max(options.sizes), options.seed)
    cost = measure_certificate(Boxes(*frames[0], half_extents))
    print(
        f"narrow phase, {cost.pairs} candidate pairs: plain {cost.plain_ns:.1f} ns per pair, "
        f"certified {cost.certified_ns:.1f} ns, ratio {cost.ratio:.2f}; {cost.undecided} undecided"
    )
    missing = [name for name, module, _ in PEERS if importlib.util.find_spec(module) is None]
    if missing:
        print(f"not installed, so not compared: {', '.join(missing)}")
    if options.json:
        result = {"steps": [asdict(row) for row in rows], "certificate": asdict(cost)}
        options.json.write_text(json.dumps(result, indent=1) + "\n")
    if options.plot:
        save_plot(rows, options.plot)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

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

"""The picture of what accuracy costs: time per pair against false alarms, and errors of effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from obb_collision.benchmarks.price.effects import EffectRow
from obb_collision.benchmarks.price.rows import Price, Row
from obb_collision.typing import Floats

#: Colour of our levels, and marker and colour of each peer; distinguishable without colours.
OURS = "#0b5fa5"
PEERS = {
    "python-fcl": ("s", "#c8500a"),
    "coal": ("^", "#4f7f1f"),
    "trimesh": ("D", "#8a4fa3"),
    "MuJoCo": ("v", "#a03050"),
}
#: Effects in the picture, and what is below the panel of each.
EFFECTS = {
    "clearance": "clearance: time per pair",
    "contacts": "depth of contacts: time per pair",
    "sweep": "time of impact: time per pair",
}
#: Offset in x and y, horizontal and vertical alignment.
Place = tuple[float, float, str, str]
#: Where a label may be beside its point: offset in points of 1/72 inch, and which end is there.
PLACES: list[Place] = [
    (9, 0, "left", "center"), (-6, -6, "right", "top"), (0, 9, "center", "bottom"),
    (6, 6, "left", "bottom"), (0, -9, "center", "top"), (6, -6, "left", "top"),
    (-9, 0, "right", "center"), (-6, 6, "right", "bottom"),
    *((x, y, "left", "center") for y in range(20, 120, 14) for x in (12, 0, 24, -12)),
    *((-12, y, "right", "center") for y in range(20, 120, 14)),
    *((x, -20, way, "center") for x, way in ((12, "left"), (-12, "right"))),
]  # fmt: skip
#: A label whose offset is larger than this gets a line to its point, points of 1/72 inch.
NEAR = 15.0
#: Margin around a point and a piece of line without labels, pixels at 100 dots per inch.
POINT_ROOM = 6.0
#: How many times longer than the longest time the panels reach, for labels.
ROOM, ROOM_BELOW = 5.0, 300.0
#: How far labels may extend beyond the axes to the right and above.
MARGIN = 12.0


@dataclass(frozen=True)
class Spot:
    """A point of a panel and its label."""

    name: str
    peer: bool
    pair_ns: float
    height: float


def save_plot(prices: Sequence[Price], effects: Sequence[EffectRow], path: Path) -> None:
    """Draw levels and peers on the most lifelike corpus measured, PNG or SVG by the name.

    Below them the effects, if there are any.
    """
    from matplotlib.figure import Figure

    measured = [price for price in prices if price.rows]
    price, panels = measured[-1], 2 if effects else 1
    figure = Figure(figsize=(8.4, 5.2 * panels), dpi=100)
    figure.subplots_adjust(
        left=0.085, right=0.965, bottom=0.115 / panels, top=1.0 - 0.155 / panels,
        hspace=0.42, wspace=0.28,
    )  # fmt: skip
    grid = figure.add_gridspec(panels, len(EFFECTS))
    axes = figure.add_subplot(grid[0, :])
    lines = _lines(price)
    for points, width in zip(lines, (2.2, 1.4), strict=False):
        axes.plot(*points.T, color=OURS, linewidth=width, marker="o", markersize=8, zorder=3)
    for row in price.rows:
        if row.peer:
            marker, color = PEERS[row.name.split()[0]]
            axes.plot(
                row.pair_ns, _percent(row), marker, color=color, markersize=9,
                markerfacecolor="white", markeredgewidth=2.0, zorder=4, clip_on=False,
            )  # fmt: skip
    _frame(axes, price)
    spots = [Spot(_name(row), row.peer, *_at(row)) for row in price.rows]
    _label(figure, axes, spots, lines)
    if effects:
        below = [figure.add_subplot(grid[1, k]) for k in range(len(EFFECTS))]
        _draw_effects(figure, below, effects)
    figure.savefig(path, dpi=130)


def _draw_effects(figure: Any, several: Sequence[Any], effects: Sequence[EffectRow]) -> None:
    """Draw the mean error of effects against their time, a panel each."""
    _title(
        several[0], "Effects at the accuracy asked for",
        "Errors to the finest level of each, shapes of 1 m; of times of impact at 1 m/s.",
    )  # fmt: skip
    for axes, (effect, name) in zip(several, EFFECTS.items(), strict=True):
        spots = [
            Spot(row.name, row.peer, row.pair_ns, 1e3 * row.mean_error)
            for row in effects
            if row.effect == effect
        ]
        if not spots:
            axes.set_axis_off()
            continue
        line = np.array([_spot(spot) for spot in spots if not spot.peer])
        axes.plot(*line.T, color=OURS, linewidth=2.0, marker="o", markersize=7, zorder=3)
        for spot in spots:
            if spot.peer:
                marker, color = PEERS[spot.name.split()[0]]
                axes.plot(
                    *_spot(spot), marker, color=color, markersize=8,
                    markerfacecolor="white", markeredgewidth=1.8, zorder=4, clip_on=False,
                )  # fmt: skip
        highest = max(spot.height for spot in spots)
        _scale(axes, [spot.pair_ns for spot in spots], ROOM_BELOW)
        axes.set_ylim(-0.15 * highest, 1.2 * highest + 1e-3)
        axes.set_xlabel(name)
        _label(figure, axes, spots, [line])
    several[0].set_ylabel("mean error, mm")


def _lines(price: Price) -> list[Floats]:
    """Return the line (k, 2) of the levels from quick to slow, and the branch of the trees."""
    levels = sorted((row for row in price.rows if not row.peer), key=lambda row: row.pair_ns)
    trees = [row for row in levels if row.name.startswith("obb_tree")]
    ladder = [_at(row) for row in levels if row not in trees]
    branch = [_at(price.row("obb")), *(_at(row) for row in trees)]
    return [np.array(ladder), np.array(branch)][: 2 if trees else 1]


def _percent(row: Row) -> float:
    return 100.0 * row.false_of_reports


def _scale(axes: Any, times: Sequence[float], room: float) -> None:
    axes.set_xscale("log")
    axes.set_xlim(0.6 * min(times), room * max(times))
    axes.xaxis.set_major_formatter(lambda value, _: _time(value))
    axes.grid(which="major", alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel("time per pair, logarithmic: what counts are ratios within the run")


def _title(axes: Any, title: str, text: str) -> None:
    place = {"xycoords": "axes fraction", "textcoords": "offset points", "va": "center"}
    for words, up, style in (
        (title, 44, {"fontsize": 13.5, "fontweight": "bold"}),
        (text, 22, {"fontsize": 10, "color": "#555555"}),
    ):
        axes.annotate(words, (0.0, 1.0), (-40, up), **place, **style)


def _frame(axes: Any, price: Price) -> None:
    _scale(axes, [row.pair_ns for row in price.rows], ROOM)
    axes.set_ylim(-8.0, 1.12 * max(_percent(row) for row in price.rows) + 1.0)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:.0f} %")
    axes.set_ylabel("false alarms among the reports")
    what = f"{price.shapes} {price.corpus}, {price.pairs:,} pairs. "
    how = "Filled: levels of obb_collision, none missed. Hollow: peers, from Python."
    _title(axes, "A more accurate level takes longer and gives fewer false alarms", what + how)
    axes.annotate(
        "better", (0.02, 0.05), (0.1, 0.155), xycoords="axes fraction", textcoords="axes fraction",
        color="#777777", fontsize=11, va="center", ha="left",
        arrowprops={"arrowstyle": "-|>", "color": "#999999", "linewidth": 1.8},
    )  # fmt: skip


def _time(nanoseconds: float) -> str:
    """Return a time with a convenient unit."""
    if nanoseconds < 1e3:
        return f"{nanoseconds:g} ns"
    return f"{nanoseconds / 1e3:g} µs" if nanoseconds < 1e6 else f"{nanoseconds / 1e6:g} ms"


def _label(figure: Any, axes: Any, rows: Sequence[Spot], lines: list[Floats]) -> None:
    """Write each name at the first of PLACES where it covers nothing: ours first, then peers.

    If there is none, rather over lines than over labels.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    renderer = FigureCanvasAgg(figure).get_renderer()  # which measures texts
    to_pixels = axes.transData.transform
    points = [*to_pixels([_spot(row) for row in rows])]
    for start, end in (ends for line in lines for ends in pairwise(to_pixels(line))):
        points += [*np.linspace(start, end, 24)]
    taken = [Bbox([point, point]).padded(POINT_ROOM) for point in points]
    x, y, right, top = axes.get_window_extent(renderer).extents
    inside = Bbox([(x, y), (right + MARGIN, top + MARGIN)])
    labels: list[Bbox] = []
    for row in sorted(rows, key=lambda row: (row.peer, row.pair_ns)):
        point = to_pixels(_spot(row))
        faults: list[tuple[Any, ...]] = []
        for place in PLACES:
            text = _write(axes, row, place)
            text.update_positions(renderer)
            box = Text.get_window_extent(text, renderer)
            text.remove()
            way = np.linspace(point, np.clip(point, box.min, box.max))
            crossed = any(label.contains(*step) for label in labels for step in way)
            outside = not (inside.contains(*box.min) and inside.contains(*box.max))
            hidden = box.count_overlaps(labels)
            faults.append((hidden, outside, crossed, box.count_overlaps(taken), len(faults), box))
            if faults[-1][:4] == (0, False, False, 0):
                break
        *_, best, box = min(faults, key=lambda fault: fault[:5])
        _write(axes, row, PLACES[best])
        labels.append(box)


def _write(axes: Any, row: Spot, place: Place) -> Any:
    x, y, ha, va = place
    color = PEERS[row.name.split()[0]][1] if row.peer else OURS
    end = {"left": 0.0, "center": 0.5, "right": 1.0}[ha], 0.5 - 0.5 * float(np.sign(y))
    line = {"arrowstyle": "-", "color": color, "linewidth": 0.8, "shrinkB": 5, "relpos": end}
    return axes.annotate(
        row.name, _spot(row), (x, y), textcoords="offset points", ha=ha, va=va, color=color,
        fontsize=9.5, fontweight="normal" if row.peer else "bold",
        arrowprops=line if float(np.hypot(x, y)) > NEAR else None,
    )  # fmt: skip


def _spot(spot: Spot) -> tuple[float, float]:
    return spot.pair_ns, spot.height


def _name(row: Row) -> str:
    """Return the name to write: only the first depth is written out."""
    kind, _, depth = row.name.partition(" ")
    if row.peer or not depth:
        return row.name
    return f"{kind}, depth 1" if depth == "1" else depth


def _at(row: Row) -> tuple[float, float]:
    return row.pair_ns, _percent(row)

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

"""The picture of what accuracy costs: the time per pair against false alarms."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from obb_collision.benchmarks.price.rows import Price, Row
from obb_collision.typing import Floats

#: Colour of our levels, and marker and colour of each peer; distinguishable without colours.
OURS = "#0b5fa5"
PEERS = {
    "python-fcl": ("s", "#c8500a"),
    "coal": ("^", "#4f7f1f"),
    "trimesh": ("D", "#8a4fa3"),
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
]  # fmt: skip
#: A label whose offset is larger than this gets a line to its point, points of 1/72 inch.
NEAR = 15.0
#: Margin around a point and a piece of line without labels, pixels at 100 dots per inch.
POINT_ROOM = 4.0
#: How far labels may extend beyond the axes to the right and above.
MARGIN = 12.0


def save_plot(prices: Sequence[Price], path: Path) -> None:
    """Draw levels and peers on the most lifelike corpus measured, PNG or SVG by the name."""
    from matplotlib.figure import Figure

    measured = [price for price in prices if price.rows]
    price = measured[-1]
    figure = Figure(figsize=(8.4, 5.2), dpi=100)
    figure.subplots_adjust(left=0.085, right=0.975, bottom=0.115, top=0.845)
    axes = figure.subplots()
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
    _frame(figure, axes, price)
    _label(figure, axes, price.rows, lines)
    figure.savefig(path, dpi=130)


def _lines(price: Price) -> list[Floats]:
    """Return the line (k, 2) of the levels from quick to slow, and the branch of the trees."""
    levels = sorted((row for row in price.rows if not row.peer), key=lambda row: row.pair_ns)
    trees = [row for row in levels if row.name.startswith("obb_tree")]
    ladder = [_at(row) for row in levels if row not in trees]
    branch = [_at(price.row("obb")), *(_at(row) for row in trees)]
    return [np.array(ladder), np.array(branch)][: 2 if trees else 1]


def _percent(row: Row) -> float:
    return 100.0 * row.false_of_reports


def _frame(figure: Any, axes: Any, price: Price) -> None:
    axes.set_xscale("log")
    times = [row.pair_ns for row in price.rows]
    axes.set_xlim(0.6 * min(times), 5.0 * max(times))
    axes.set_ylim(-8.0, 1.12 * max(_percent(row) for row in price.rows) + 1.0)
    axes.xaxis.set_major_formatter(lambda value, _: _time(value))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:.0f} %")
    axes.grid(which="major", alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel("time per pair, logarithmic: what counts are ratios within the run")
    axes.set_ylabel("false alarms among the reports")
    figure.text(
        0.015, 0.955, "A more accurate level takes longer and gives fewer false alarms",
        fontsize=13.5, fontweight="bold", va="center",
    )  # fmt: skip
    what = f"{price.shapes} {price.corpus}, {price.pairs:,} pairs. "
    how = "Filled: levels of obb_collision, none missed. Hollow: peers, from Python."
    figure.text(
        0.015, 0.9, what + how, fontsize=10, color="#555555", va="center",
    )  # fmt: skip
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


def _label(figure: Any, axes: Any, rows: Sequence[Row], lines: list[Floats]) -> None:
    """Write each name at the first of PLACES where it covers nothing: ours first, then peers."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    renderer = FigureCanvasAgg(figure).get_renderer()  # which measures texts
    to_pixels = axes.transData.transform
    points = [*to_pixels([_at(row) for row in rows])]
    for start, end in (ends for line in lines for ends in pairwise(to_pixels(line))):
        points += [*np.linspace(start, end, 24)]
    taken = [Bbox([point, point]).padded(POINT_ROOM) for point in points]
    x, y, right, top = axes.get_window_extent(renderer).extents
    inside = Bbox([(x, y), (right + MARGIN, top + MARGIN)])
    labels: list[Bbox] = []
    for row in sorted(rows, key=lambda row: (row.peer, row.pair_ns)):
        for place in PLACES:
            text = _write(axes, row, place)
            text.update_positions(renderer)
            box = Text.get_window_extent(text, renderer)
            within = inside.contains(*box.min) and inside.contains(*box.max)
            way = np.linspace(to_pixels(_at(row)), np.clip(to_pixels(_at(row)), box.min, box.max))
            crossed = any(label.contains(*point) for label in labels for point in way)
            if within and not crossed and not box.count_overlaps(taken + labels):
                break
            text.remove()
        else:
            text = _write(axes, row, PLACES[0])
        labels.append(box)


def _write(axes: Any, row: Row, place: Place) -> Any:
    x, y, ha, va = place
    color = PEERS[row.name.split()[0]][1] if row.peer else OURS
    line = {"arrowstyle": "-", "color": color, "linewidth": 0.8, "shrinkB": 5}
    return axes.annotate(
        _name(row), _at(row), (x, y), textcoords="offset points", ha=ha, va=va, color=color,
        fontsize=9.5, fontweight="normal" if row.peer else "bold",
        arrowprops=line if float(np.hypot(x, y)) > NEAR else None,
    )  # fmt: skip


def _name(row: Row) -> str:
    """Return the name to write: only the first depth is written out."""
    kind, _, depth = row.name.partition(" ")
    if row.peer or not depth:
        return row.name
    return f"{kind}, depth 1" if depth == "1" else depth


def _at(row: Row) -> tuple[float, float]:
    return row.pair_ns, _percent(row)

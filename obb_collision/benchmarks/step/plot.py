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


"""The picture of the full step: milliseconds over the number of boxes, and by form of the scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from obb_collision.benchmarks.peers.steps import SCENE
from obb_collision.benchmarks.step.measure import Row
from obb_collision.benchmarks.step.tables import OWN

#: Colours of ours, which are thick and filled; colour, line and mark of each peer.
OURS = {"find_pairs": "#0b6e4f", "Scene, separations": "#2ca25f", "Scene, contacts": "#1f6fb4"}
PEERS: dict[str, tuple[str, Any, str]] = {
    "MuJoCo": ("#7a3b96", "--", "s"),
    "rapier3d": ("#b8860b", (0, (5, 1)), "P"),
    "coal": ("#c8500a", "-.", "^"),
    "python-fcl": ("0.35", ":", "v"),
    "pybullet": ("0.5", (0, (1, 1)), "D"),
    "trimesh": ("0.65", (0, (3, 1, 1, 1)), "X"),
}


def best_rows(rows: Sequence[Row]) -> list[Row]:
    """Return what is drawn: ours with the most threads, and the quickest of each peer per case."""
    best: dict[tuple[object, str], Row] = {}
    for row in rows:
        name = row.name if row.name in OWN else row.name.split(" ")[0]
        if name == SCENE.name:
            continue
        key = row.case, name
        rival = best.get(key)
        if rival is None or (
            row.threads > rival.threads if name in OWN else row.median_ms < rival.median_ms
        ):
            best[key] = row
    return list(best.values())


def save_plot(rows: Sequence[Row], path: Path) -> None:
    """Draw the rows, PNG or SVG by the name."""
    from matplotlib.figure import Figure

    drawn = [row for row in best_rows(rows) if row.moving == 1.0]
    first = drawn[0].form
    sizes = [row for row in drawn if row.form == first]
    common = max({row.boxes for row in drawn}, key=lambda n: sum(r.boxes == n for r in drawn))
    forms = [row for row in drawn if row.boxes == common]
    both = len({row.form for row in forms}) > 1
    figure = Figure(figsize=(13.0 if both else 9.0, 5.0), layout="constrained")
    panels = figure.subplots(1, 2, width_ratios=(1.0, 1.05)) if both else [figure.subplots()]
    _draw_sizes(panels[0], sizes)
    if both:
        _draw_forms(panels[1], forms)
    handles, names = panels[0].get_legend_handles_labels()
    beside: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.02, 0.5), "frameon": False}
    panels[-1].legend(handles, names, labelspacing=1.2, **beside)
    figure.suptitle(
        "New poses in, colliding pairs out: milliseconds per step, all boxes moving",
        fontweight="bold",
    )
    figure.savefig(path, dpi=130)


def _style(row: Row) -> dict[str, Any]:
    if row.name in OURS:
        return {"color": OURS[row.name], "linestyle": "-", "marker": "o", "linewidth": 3.0}
    color, line, mark = PEERS[row.name.split(" ")[0]]
    return {"color": color, "linestyle": line, "marker": mark, "linewidth": 1.4}


def _name(row: Row) -> str:
    if row.name in OWN:
        return f"obb_collision: {row.name}"
    return row.name.split(" ")[0]


def _draw_sizes(axes: Any, rows: Sequence[Row]) -> None:
    for name in dict.fromkeys(map(_name, rows)):
        own = sorted((row for row in rows if _name(row) == name), key=lambda row: row.boxes)
        sizes, times = [row.boxes for row in own], [row.median_ms for row in own]
        axes.loglog(sizes, times, label=name, **_style(own[-1]))
    axes.set_xlabel("boxes, all over a room")
    _finish(axes, axes.yaxis, axes.xaxis)


def _draw_forms(axes: Any, rows: Sequence[Row]) -> None:
    forms = list(dict.fromkeys(row.form for row in rows))
    for row in rows:
        style = _style(row) | {"linestyle": "none", "markersize": 10 if row.name in OWN else 7}
        axes.plot(row.median_ms, forms.index(row.form), zorder=3, **style)
    axes.set_xscale("log")
    axes.set_yticks(range(len(forms)), forms)
    axes.invert_yaxis()
    axes.set_xlabel(f"milliseconds per step, {rows[0].boxes:,} boxes, by form of the scene")
    _finish(axes, axes.xaxis)


def _finish(axes: Any, *scales: Any) -> None:
    for axis in scales:
        axis.set_major_formatter(lambda value, _: f"{value:,.0f}" if value >= 1 else f"{value:g}")
    axes.grid(which="major", alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)

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

"""Pictures of what was measured; PNG or SVG by the name of the file. They need matplotlib."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from obb_collision.benchmarks.contest import Price
from obb_collision.benchmarks.contestants import SCENE
from obb_collision.benchmarks.effects import OFF, PAIRS, CostRow, EffectRow
from obb_collision.benchmarks.speed import OWN
from obb_collision.benchmarks.steps import StepRow

#: Colour, line and mark of ours, which are thick and filled, and of each peer.
STYLES: dict[str, tuple[str, Any, str]] = {
    "find_pairs": ("#0b6e4f", "-", "o"),
    "Scene, separations": ("#2ca25f", "-", "o"),
    "Scene, contacts": ("#1f6fb4", "-", "o"),
    "MuJoCo": ("#7a3b96", "--", "s"),
    "rapier3d": ("#b8860b", (0, (5, 1)), "P"),
    "coal": ("#c8500a", "-.", "^"),
    "python-fcl": ("0.35", ":", "v"),
    "pybullet": ("0.5", (0, (1, 1)), "D"),
}
OURS = "#0b5fa5"
#: Effects in the picture of accuracy, and what is below the panel of each.
EFFECTS = {
    "clearance": "clearance: time per pair",
    "contacts": "depth of contacts: time per pair",
    "sweep": "time of impact: time per pair",
}
LEGEND: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.02, 0.5), "frameon": False}


def _figure(panels: Any, size: tuple[float, float], **options: Any) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(*panels, squeeze=False, **options)


def _style(name: str) -> dict[str, Any]:
    color, line, mark = STYLES[name if name in OWN else name.split(" ")[0]]
    width = 3.0 if name in OWN else 1.4
    return {"color": color, "linestyle": line, "marker": mark, "linewidth": width}


def _finish(axes: Any, label: str, scales: Iterable[Any], shown: Any) -> None:
    for axis in scales:
        axis.set_major_formatter(lambda value, _: shown(value))
        axis.set_minor_formatter("")
    axes.set_xlabel(label)
    axes.grid(which="major", alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def _count(value: float) -> str:
    return f"{value:,.0f}" if value >= 1 else f"{value:g}"


def _time(nanoseconds: float) -> str:
    """Return a time with a convenient unit."""
    if nanoseconds < 1e3:
        return f"{nanoseconds:g} ns"
    return f"{nanoseconds / 1e3:g} µs" if nanoseconds < 1e6 else f"{nanoseconds / 1e6:g} ms"


def save_accuracy(prices: Sequence[Price], effects: Sequence[EffectRow], path: Path) -> None:
    """Draw levels and peers on the last corpus measured, and below the errors of effects."""
    from matplotlib.figure import Figure

    price = [price for price in prices if price.rows][-1]
    rows: Any = [["levels"] * len(EFFECTS), list(EFFECTS)][: 2 if effects else 1]
    figure = Figure(figsize=(10.0, 4.8 * len(rows)), layout="constrained")
    panels = figure.subplot_mosaic(rows)
    axes = panels.pop("levels")
    spots = [(r.name, r.peer, r.pair_ns, 100.0 * r.false_of_reports) for r in price.rows]
    _draw_spots(axes, spots, "time per pair, logarithmic: what counts are ratios within the run")
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:.0f} %")
    axes.set_ylabel("false alarms among the reports")
    axes.set_title("A more accurate level takes longer and gives fewer false alarms")
    for effect, axes in panels.items():
        own = [row for row in effects if row.effect == effect]
        spots = [(row.name, row.peer, row.pair_ns, 1e3 * row.mean_error) for row in own]
        if spots:
            _draw_spots(axes, spots, EFFECTS[effect])
        else:
            axes.set_axis_off()
        axes.set_ylabel("mean error, mm: shapes of 1 m, 1 m/s")
    what = f"{price.shapes} {price.corpus}, {price.pairs:,} pairs. "
    figure.suptitle(f"{what}Filled: levels of obb_collision. Hollow: peers, from Python.")
    figure.savefig(path, dpi=130)


def _draw_spots(axes: Any, spots: Sequence[tuple[str, bool, float, float]], label: str) -> None:
    """Draw a line of ours and marks of peers, their names beside them."""
    line = sorted((time, height) for _, peer, time, height in spots if not peer)
    axes.plot(*zip(*line, strict=True), color=OURS, linewidth=2.0, marker="o", zorder=3)
    axes.set_xscale("log")
    axes.margins(0.2, 0.15)
    for k, (name, peer, time, height) in enumerate(sorted(spots, key=lambda spot: spot[2])):
        color = _style(name)["color"] if peer else OURS
        if peer:
            mark = {"marker": _style(name)["marker"], "markerfacecolor": "white"}
            axes.plot(time, height, color=color, zorder=4, clip_on=False, **mark)
        up = (9, -14, 20, -25)[k % 4]  # neighbours on different sides
        weight = "normal" if peer else "bold"
        axes.annotate(
            name,
            (time, height),
            (0, up),
            textcoords="offset points",
            ha="center",
            color=color,
            fontsize=8.5,
            fontweight=weight,
        )
    _finish(axes, label, [axes.xaxis], _time)


def save_speed(rows: Sequence[StepRow], path: Path) -> None:
    """Draw the full step: milliseconds over the number of boxes, and by form of the scene."""
    drawn = [row for row in best_rows(rows) if row.moving == 1.0]
    sizes = [row for row in drawn if row.form == drawn[0].form]
    common = max({row.boxes for row in drawn}, key=lambda n: sum(r.boxes == n for r in drawn))
    by_form = [row for row in drawn if row.boxes == common]
    forms = list(dict.fromkeys(row.form for row in by_form))
    figure, panels = _figure((1, min(2, len(forms))), (13.0 if len(forms) > 1 else 9.0, 5.0))
    axes = panels[0, 0]
    for name in dict.fromkeys(row.name.split(" ")[0] for row in sizes if row.name not in OWN):
        own = [row for row in sizes if row.name.startswith(name) and row.name not in OWN]
        _draw_sizes(axes, name, own)
    for name in dict.fromkeys(row.name for row in sizes if row.name in OWN):
        _draw_sizes(axes, name, [row for row in sizes if row.name == name])
    _finish(axes, "boxes, all over a room", [axes.yaxis, axes.xaxis], _count)
    if len(forms) > 1:
        axes = panels[0, 1]
        for row in by_form:
            style = _style(row.name) | {"linestyle": "none"}
            axes.semilogx(row.median_ms, forms.index(row.form), zorder=3, **style)
        axes.set_yticks(range(len(forms)), forms)
        axes.invert_yaxis()
        label = f"milliseconds per step, {common:,} boxes, by form of the scene"
        _finish(axes, label, [axes.xaxis], _count)
    handles, names = panels[0, 0].get_legend_handles_labels()
    panels[0, -1].legend(handles, names, labelspacing=1.2, **LEGEND)
    figure.suptitle("New poses in, colliding pairs out: milliseconds per step, all boxes moving")
    figure.savefig(path, dpi=130)


def best_rows(rows: Sequence[StepRow]) -> list[StepRow]:
    """Return what is drawn: ours with the most threads, and the quickest of each peer per case."""
    best: dict[tuple[object, str], StepRow] = {}
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


def _draw_sizes(axes: Any, name: str, rows: Sequence[StepRow]) -> None:
    own = sorted(rows, key=lambda row: row.boxes)
    label = f"obb_collision: {name}" if name in OWN else name
    points = [row.boxes for row in own], [row.median_ms for row in own]
    axes.loglog(*points, label=label, **_style(name))


def save_effect_costs(rows: list[CostRow], path: Path) -> None:
    """Draw what each effect adds to a step as bars, one panel per scene."""
    rows = [row for row in rows if row.variant != PAIRS]
    scenes = list(dict.fromkeys(row.scene for row in rows))
    counts = [sum(row.scene == scene for row in rows) for scene in scenes]
    size = (7.5, 0.42 * sum(counts) + 2.0)
    ratios = {"height_ratios": counts}
    figure, panels = _figure((len(scenes), 1), size, sharex=True, gridspec_kw=ratios)
    for axes, scene in zip(panels[:, 0], scenes, strict=True):
        own = [row for row in rows if row.scene == scene]
        (base,) = (row.step_us for row in own if row.variant == OFF)
        labels = [row.variant for row in own]
        more = [max(row.extra_us, 0.0) for row in own]
        axes.barh(labels, [base] * len(own), color="0.78")
        bars = axes.barh(labels, more, left=base, color="#d1495b")
        texts = [f"{base:.0f} µs" if x.variant == OFF else f"+{x.extra_us:.0f} µs" for x in own]
        axes.bar_label(bars, texts, padding=4)
        axes.set_title(f"{scene}, {own[0].objects} objects", loc="left", weight="bold")
        axes.invert_yaxis()
        axes.margins(x=0.12)
        axes.spines[["top", "right"]].set_visible(False)
    panels[-1, 0].set_xlabel("µs per step (median)")
    figure.suptitle("What a step costs: grey the pairs, red what the effects add")
    figure.savefig(path, dpi=130)

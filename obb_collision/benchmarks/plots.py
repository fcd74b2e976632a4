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

"""Plots of measurements; PNG or SVG by the name of the file. They need matplotlib."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from obb_collision.benchmarks.contest import Price
from obb_collision.benchmarks.contestants import OUR_NAMES, SCENE_PAIRS
from obb_collision.benchmarks.effects import ALL_EFFECTS, PAIRS_ALONE, CostRow, EffectRow
from obb_collision.benchmarks.steps import StepRow

#: The look of all pictures of the project.
STYLE: Any = {
    "font.size": 10.0,
    "axes.titlesize": 12.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "svg.hashsalt": "obb_collision",
}
OUR_COLOR = "#1f5fa8"
#: Colour, line and mark: ours one family, thick and filled; each peer another colour, thin.
LOOKS: dict[str, tuple[str, Any, str]] = {
    "find_pairs": ("#08306b", "-", "o"),
    "Scene, separations": (OUR_COLOR, "-", "o"),
    "Scene, contacts": ("#6baed6", "-", "o"),
    "obb_collision": (OUR_COLOR, "-", "o"),
    "MuJoCo": ("#7a3b96", "--", "s"),
    "parry3d": ("#a50f15", "--", "D"),
    "rapier3d": ("#b8860b", (0, (5, 1)), "P"),
    "coal": ("#c8500a", "-.", "^"),
    "pinocchio": ("#c8500a", "-.", "^"),
    "python-fcl": ("0.35", ":", "v"),
    "pybullet": ("0.55", (0, (1, 1)), "X"),
}
#: Effects in the picture of accuracy, and the titles of their panels.
EFFECT_TITLES = {
    "clearance": "Clearance",
    "contacts": "Depth of contacts",
    "sweep": "Time of impact",
}
#: Marks of the scenes in the picture of the costs of effects.
SCENE_MARKS = "osD^"
#: Where a label may stand: points from its spot, and its alignments; the first free one is taken.
LABEL_PLACES = [
    (x * scale, y * scale, ("right", "center", "left")[1 + (x > 0) - (x < 0)], va)
    for scale in (1.0, 2.0, 2.5, 3.0, 4.5)
    for x, y, va in (
        *((6, 6, "bottom"), (0, 8, "bottom"), (-6, 6, "bottom"), (9, 0, "center")),
        *((0, -8, "top"), (-9, 0, "center"), (6, -6, "top"), (-6, -6, "top")),
    )
]


@contextmanager
def picture(
    path: Path, size: tuple[float, float], mosaic: Any = "a", **options: Any
) -> Iterator[Any]:
    """Yield (figure, panels by name) in the project's style, and save the figure at the end."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        yield figure, figure.subplot_mosaic(mosaic, **options)
        figure.savefig(path, dpi=130)


def look(name: str) -> dict[str, Any]:
    """Return the colour, line and mark of a contestant."""
    is_ours = name in OUR_NAMES or name == "obb_collision"
    key = name if is_ours else name.split(" ")[0]
    color, line, mark = LOOKS[key]
    width = 3.0 if is_ours else 1.4
    return {"color": color, "linestyle": line, "marker": mark, "linewidth": width}


def place_labels(axes: Any, labels: Sequence[tuple[str, float, float, dict[str, Any]]]) -> None:
    """Write labels (text, x, y, style) beside their spots: none covers another, a spot, a line."""
    figure = axes.figure
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # what is placed stays
    spots = [axes.transData.transform((x, y)) for _, x, y, _ in labels]
    for line in axes.lines:
        ends = axes.transData.transform(line.get_xydata())
        spots += [at for a, b in pairwise(ends) for at in np.linspace(a, b, 100)]
    taken: list[Any] = []
    for text, x, y, style in labels:
        for right, up, ha, va in LABEL_PLACES:
            note = axes.annotate(
                text, (x, y), (right, up), textcoords="offset points", ha=ha, va=va, **style
            )  # fmt: skip
            box = note.get_window_extent()
            free = not any(box.overlaps(other) for other in taken)
            free = free and bool((axes.bbox.min <= box.min).all()) and box.x1 <= axes.bbox.x1
            if free and not any(box.padded(3).contains(*spot) for spot in spots):
                break
            note.remove()
        else:
            note = axes.annotate(text, (x, y), (8, 0), textcoords="offset points", **style)
        taken.append(note.get_window_extent())


def name_values(axis: Any, shown: Callable[[float], str]) -> None:
    """Format the values of an axis."""
    axis.set_major_formatter(lambda value, _: shown(value))
    axis.set_minor_formatter("")


def number(value: float) -> str:
    """Return a number with its thousands apart."""
    return f"{value:,.0f}" if value >= 1 else f"{value:g}"


def time(nanoseconds: float) -> str:
    """Return a time with a convenient unit."""
    if nanoseconds < 1e3:
        return f"{nanoseconds:g} ns"
    return f"{nanoseconds / 1e3:g} µs" if nanoseconds < 1e6 else f"{nanoseconds / 1e6:g} ms"


def save_accuracy(prices: Sequence[Price], effects: Sequence[EffectRow], path: Path) -> None:
    """Draw levels and peers on the last corpus measured, and below the errors of effects."""
    price = [price for price in prices if price.rows][-1]
    rows: Any = [["levels"] * len(EFFECT_TITLES), list(EFFECT_TITLES)][: 2 if effects else 1]
    with picture(path, (11.0, 4.6 * len(rows)), rows) as (figure, panels):
        axes = panels.pop("levels")
        levels = [(r.name, r.peer, r.pair_ns, 100.0 * r.false_of_reports) for r in price.rows]
        drawn = [(axes, levels)]
        name_values(axes.yaxis, lambda value: f"{value:.0f} %")
        axes.set_ylabel("false alarms among the reports")
        axes.set_title(
            f"A more accurate level takes longer and gives fewer false alarms\n"
            f"{price.shapes} {price.corpus}, {price.pairs:,} pairs; hollow: peers, from Python"
        )
        for effect, panel in panels.items():
            own = [row for row in effects if row.effect == effect]
            drawn.append((panel, [(r.name, r.peer, r.pair_ns, 1e3 * r.mean_error) for r in own]))
            panel.set_title(EFFECT_TITLES[effect])
            panel.set_ylabel("mean error, mm")
        for panel, spots in drawn:
            _draw_spots(panel, spots)
        figure.draw_without_rendering()
        for panel, spots in drawn:
            _name_spots(panel, spots)


Spot = tuple[str, bool, float, float]
"""Name, whether it is a peer, time in ns, and height."""


def _draw_spots(axes: Any, spots: Sequence[Spot]) -> None:
    """Draw a line of ours and marks of peers."""
    line = sorted((time, height) for _, peer, time, height in spots if not peer)
    if line:
        axes.plot(*zip(*line, strict=True), zorder=3, **look("obb_collision"))
    for name, peer, when, height in spots:
        if peer:
            style = look(name) | {"linestyle": "none", "markerfacecolor": "white"}
            axes.plot(when, height, zorder=4, clip_on=False, **style)
    axes.set_xscale("log")
    axes.margins(0.22, 0.2)
    axes.set_xlabel("time per pair")
    name_values(axes.xaxis, time)


def _name_spots(axes: Any, spots: Sequence[Spot]) -> None:
    labels = []
    for name, peer, when, height in sorted(spots, key=lambda spot: spot[1]):
        color = look(name if peer else "obb_collision")["color"]
        weight = "normal" if peer else "bold"
        labels.append((name, when, height, {"color": color, "fontsize": 9.0, "weight": weight}))
    place_labels(axes, labels)


def save_speed(rows: Sequence[StepRow], path: Path) -> None:
    """Draw the full step: milliseconds over the number of boxes, and by form of the scene."""
    drawn = [row for row in best_rows(rows) if row.moving == 1.0]
    sizes = [row for row in drawn if row.form == drawn[0].form]
    common = max({row.boxes for row in drawn}, key=lambda n: sum(r.boxes == n for r in drawn))
    by_form = [row for row in drawn if row.boxes == common]
    forms = list(dict.fromkeys(row.form for row in by_form))
    panels = ["sizes", "forms"] if len(forms) > 1 else ["sizes"]
    with picture(path, (13.0 if len(forms) > 1 else 9.0, 5.0), [panels]) as (figure, axes):
        for name in sorted({short_name(row.name) for row in sizes}, key=list(LOOKS).index):
            own = sorted((r.boxes, r.median_ms) for r in sizes if short_name(r.name) == name)
            label = f"obb_collision: {name}" if name in OUR_NAMES else name
            axes["sizes"].loglog(*zip(*own, strict=True), label=label, **look(name))
        axes["sizes"].set(xlabel="boxes, all over a room", ylabel="ms per step")
        axes["sizes"].set_title("New poses in, colliding pairs out; ours on one thread")
        name_values(axes["sizes"].xaxis, number)
        name_values(axes["sizes"].yaxis, number)
        if len(forms) > 1:
            for row in by_form:
                style = look(short_name(row.name)) | {"linestyle": "none"}
                axes["forms"].semilogx(row.median_ms, forms.index(row.form), zorder=3, **style)
            axes["forms"].set_yticks(range(len(forms)), forms)
            axes["forms"].invert_yaxis()
            axes["forms"].set(xlabel="ms per step", ylabel="form of the scene")
            axes["forms"].set_title(f"{common:,} boxes")
            name_values(axes["forms"].xaxis, number)
        handles, names = axes["sizes"].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside right center", labelspacing=1.2)


def short_name(name: str) -> str:
    """Return the name of a contestant without its variant, such as a broad phase."""
    return name if name in OUR_NAMES else name.split(" ")[0]


def best_rows(rows: Sequence[StepRow]) -> list[StepRow]:
    """Select the rows to draw: ours with the fewest threads, the fastest of each peer per case."""
    best: dict[tuple[object, str], StepRow] = {}
    for row in rows:
        name = short_name(row.name)
        if name == SCENE_PAIRS.name:
            continue
        rival = best.get((row.case, name))
        key = "threads" if name in OUR_NAMES else "median_ms"
        if rival is None or getattr(row, key) < getattr(rival, key):
            best[row.case, name] = row
    return list(best.values())


def save_effect_costs(rows: Sequence[CostRow], path: Path) -> None:
    """Draw how many times as long as the pairs alone a step takes with each effect."""
    variants = sorted(
        {row.variant: 0 for row in rows if row.variant != PAIRS_ALONE},
        key=lambda name: name == ALL_EFFECTS,
    )
    scenes = list(dict.fromkeys(row.scene for row in rows))
    with picture(path, (9.0, 0.55 * len(variants) + 1.8)) as (figure, panels):
        axes = panels["a"]
        draw_effect_costs(axes, rows, variants, scenes)
        axes.set_title("A step beside its pairs alone: effects that are off cost next to nothing")
        figure.legend(loc="outside right center")


def draw_effect_costs(
    axes: Any, rows: Iterable[CostRow], variants: Sequence[str], scenes: Sequence[str]
) -> None:
    """Draw the ratios of steps to the pairs alone: a row per variant, a mark per scene."""
    rows = [row for row in rows if row.scene in scenes]
    base = {row.scene: row.step_us for row in rows if row.variant == PAIRS_ALONE}
    for scene, mark, color in zip(
        scenes, SCENE_MARKS, ("#08306b", OUR_COLOR, "#6baed6"), strict=False
    ):
        own = [row for row in rows if row.scene == scene and row.variant in variants]
        ratios = [row.step_us / base[scene] for row in own]
        places = [variants.index(row.variant) for row in own]
        label = f"{scene}, {own[0].objects} objects"
        axes.semilogx(ratios, places, mark, color=color, markersize=8, label=label, zorder=3)
        for ratio, place in zip(ratios, places, strict=True):
            axes.hlines(place, 1.0, ratio, color=color, alpha=0.35, linewidth=4, zorder=2)
    for place, variant in enumerate(variants):
        times = [row.step_us / base[row.scene] for row in rows if row.variant == variant]
        low, high = min(times), max(times)
        text = f"+{100 * (high - 1):.2g} %" if high < 1.5 else f"{high:.1f} times"
        axes.annotate(
            text, (high, place), (9, 0), textcoords="offset points", va="center", fontsize=9
        )  # fmt: skip
        axes.set_xlim(min(1.0, low) * 0.97, None)
    axes.axvline(1.0, color="0.3", linewidth=1.2)
    axes.margins(x=0.25)
    axes.set_yticks(range(len(variants)), variants)
    axes.invert_yaxis()
    axes.set_xlabel("time of a step, pairs alone = 1")
    name_values(axes.xaxis, lambda value: f"{value:g}")
    axes.set_xticks([1, 2, 4, 8], minor=False)

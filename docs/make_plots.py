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

"""Makes the plots in this folder anew: all, or those that are named.

    python docs/make_plots.py [accuracy] [effects] [speed] [promises] [separating_axis] [robots]
        [iou]

They are drawn from the tables and programs on the pages, so that both say the same; the commands
beside the tables measure anew. It needs the extra ``bench``.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from obb_collision.benchmarks import plots
from obb_collision.benchmarks.contest import ContestRow, Price
from obb_collision.benchmarks.effects import (
    ALL_EFFECTS,
    EFFECTS_OFF,
    PAIRS_ALONE,
    CostRow,
    EffectRow,
)
from obb_collision.benchmarks.steps import StepRow

FOLDER = Path(__file__).parent
#: Nanoseconds.
UNITS = {"ns": 1.0, "µs": 1e3, "ms": 1e6}


def table(page: str, head: str) -> list[list[str]]:
    """Return the cells of a table whose head begins in a certain way, the head first."""
    _, begin, rest = (FOLDER / page).read_text(encoding="utf-8").partition(f"\n{head}")
    lines = (begin[1:] + rest).partition("\n\n")[0].partition("\n<!--")[0].splitlines()
    del lines[1]  # the rule
    return [[cell.strip().replace("`", "") for cell in line[1:-1].split("|")] for line in lines]


def program_of(page: str) -> dict[str, Any]:
    """Run the Python blocks of a page, and return their variables."""
    text, variables = (FOLDER / page).read_text(encoding="utf-8"), dict[str, Any]()
    for block in re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        if "std_msgs" not in block:
            exec(block, variables)
    return variables


def _numbers(cell: str) -> list[tuple[str, float]]:
    """Return the numbers of a cell such as ``3.6 / 10.7 µs`` with their unit; none is 0."""
    unit = cell.rsplit(" ", 1)[-1]
    parts = [part.split(" ")[0].replace(",", "") for part in cell.split(" / ")]
    return [(unit, 0.0 if part == "none" else float(part)) for part in parts]


def _kinds(name: str) -> list[str]:
    """Return the contestants of a row such as ``coal hull / mesh``."""
    library, *kinds = re.split(r" / | ", name)
    return [f"{library} {kind}" for kind in kinds]


def _price() -> Price:
    text = (FOLDER / "accuracy.md").read_text(encoding="utf-8")
    shapes, pairs = re.findall(r"(\d+) meshes.*? ([\d,]+) pairs", text, re.DOTALL)[0]
    price = Price("real meshes", "", int(shapes), 0, int(pairs.replace(",", "")))
    for name, time, *_, false in table("accuracy.md", "| level |")[1:]:
        names = _kinds(name) if " " in name else [name]
        for one, (unit, number), (_, share) in zip(
            names, _numbers(time), _numbers(false), strict=True
        ):
            row = ContestRow(one, " " in name, number * UNITS[unit], reports=100, false=int(share))
            price.rows.append(row)
    return price


def draw_accuracy() -> None:
    """Draw what accuracy costs: the time per pair against false alarms and errors of effects."""
    effect, rows = "", []
    for name, time, mean, _ in table("accuracy.md", "| effect | time per pair")[1:]:
        what, _, level = name.partition(" at ")
        names = [level] if level else _kinds(name)
        effect = {"time of impact": "sweep"}.get(what, what) if level else effect
        for one, (unit, number), (_, error) in zip(
            names, _numbers(time), _numbers(mean), strict=True
        ):
            rows.append(EffectRow(effect, one, not level, 1, number * UNITS[unit], 1e-3 * error))
    plots.save_accuracy([_price()], rows, FOLDER / "accuracy.svg")


def _effect_costs() -> list[CostRow]:
    (_, *scenes), *lines = table("effects.md", "| | tabletop")
    rows = []
    for column, (scene, objects) in enumerate((head.split()[:2] for head in scenes), start=1):
        scene, base = scene.removesuffix(","), 0.0
        for cells in lines:
            name, cell = cells[0].removeprefix("and ").split(",")[0], cells[column]
            if not cell:
                continue
            number = float(cell.replace(",", ""))
            base = number if name == EFFECTS_OFF else base
            step = base + number if cell.startswith("+") else number
            name = ALL_EFFECTS if name.startswith("all") else name
            rows.append(CostRow(scene, name, int(objects), step, 0.0, 0.0, 0.0))
    assert {PAIRS_ALONE, EFFECTS_OFF, ALL_EFFECTS} <= {row.variant for row in rows}
    return rows


def draw_effects() -> None:
    """Draw what each effect adds to a step, in the scenes that come with the package."""
    plots.save_effect_costs(_effect_costs(), FOLDER / "effects.svg")


def draw_speed() -> None:
    """Draw the tables of the full step: by number of boxes, and by form of the scene."""
    rows = []
    heads = ("uniform", "10 |"), ("", "uniform |"), ("uniform", "1,000 |")
    for form, start in heads:
        (_, *columns), *lines = table("speed.md", f"| ms per step | {start}")
        for name, *cells in lines:
            name = re.sub(", (best broad phase|refit|rebuild)$", ", 1 thread", name)
            name, _, threads = name.rpartition(", ")
            for column, cell in zip(columns, cells, strict=True):
                if cell and (form or column != "uniform"):
                    boxes = int(column.replace(",", "")) if form else 10_000
                    ms, count = float(cell.split(" ")[0].rstrip("*")), int(threads.split(" ")[0])
                    case = form or column, boxes, 1.0
                    rows.append(StepRow(name, count, *case, ms, ms, 0, 0.0, 0, 0, 0, 0.0))
    plots.save_speed(rows, FOLDER / "speed.svg")


def draw_promises() -> None:
    """Draw the three promises beside each other, from the tables that prove them."""
    with plots.picture(FOLDER / "promises.svg", (13.0, 3.8), "abc") as (_, panels):
        levels = [row for row in _price().rows if not row.peer]
        names = [f"{row.name}\n{plots.time(row.pair_ns)} per pair" for row in levels]
        shares = [100.0 * row.false_of_reports for row in levels]
        bars = panels["a"].barh(names, shares, color=plots.OUR_COLOR)
        panels["a"].bar_label(bars, [f"{share:.0f} %" for share in shares], padding=4)
        panels["a"].set_title("You see what accuracy costs")
        panels["a"].set_xlabel("share of the alarms that are false")

        (_, *checkers), *rows = table("../README.md", "| pairs | this library")
        wrong = [
            sum(int(n) for row in rows for n in row[column].split("/"))
            for column in range(1, len(checkers) + 1)
        ]
        colors = [plots.OUR_COLOR, *["#b9bec5"] * len(checkers)][: len(checkers)]
        bars = panels["b"].barh(checkers, wrong, color=colors)
        panels["b"].bar_label(bars, [f"{count:,}" for count in wrong], padding=4)
        panels["b"].set_title("It is right")
        panels["b"].set_xlabel(f"wrong answers in {len(rows)}00,000 pairs")

        costs = _effect_costs()
        scene = max({row.scene for row in costs}, key=[row.scene for row in costs].count)
        variants = [
            row.variant for row in costs if row.scene == scene and row.variant != PAIRS_ALONE
        ]
        plots.draw_effect_costs(panels["c"], costs, variants, [scene])
        panels["c"].set_title("You pay for what you ask for")
        assert ALL_EFFECTS in variants
        for name in "ab":
            panels[name].invert_yaxis()
            panels[name].margins(x=0.22)
            panels[name].grid(visible=False)
            panels[name].set_xticks([])


def draw_separating_axis() -> None:
    """Draw the projections of two boxes of the plane on an axis that separates them, and not."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.2, 3.9), layout="constrained")
    colors = ("#4c78a8", "#f58518")
    boxes = [_rectangle((1.2, 1.6), 31.5, (0.65, 0.34)), _rectangle((2.2, 2.1), 49.0, (0.6, 0.35))]
    titles = (
        "On this axis the projections overlap",
        "On this one they do not: the boxes are apart",
    )
    for axes, angle, title in zip(figure.subplots(1, 2), (0.0, 58.5), titles, strict=True):
        _draw_projections(axes, boxes, colors, np.radians(angle))
        axes.set_title(title)
    figure.savefig(FOLDER / "separating_axis.svg")


def _rectangle(center: tuple[float, float], degrees: float, half: tuple[float, float]) -> Any:
    turn = np.radians(-degrees)
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    return corners @ axes.T + center


def _draw_projections(axes: Any, boxes: list[Any], colors: tuple[str, str], angle: float) -> None:
    """Draw the boxes, and their projections on a line beside them."""
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([np.sin(angle), -np.cos(angle)])
    foot = across * (max((box @ across).max() for box in boxes) + 0.25)
    ends = []
    for box, color in zip(boxes, colors, strict=True):
        axes.fill(*box.T, facecolor=color, alpha=0.3, edgecolor=color, linewidth=2)
        shadow = box @ along
        ends.append((shadow.min(), shadow.max()))
        for corner in (box[shadow.argmin()], box[shadow.argmax()]):
            axes.plot(*np.transpose([corner, (corner @ along) * along + foot]), ":", color=color)
        axes.plot(*(np.outer(ends[-1], along) + foot).T, color=color, linewidth=6, alpha=0.8)
    low, high = sorted([ends[0][1], ends[1][0]])
    word, color = ("gap", "#2ca02c") if ends[0][1] < ends[1][0] else ("overlap", "#d62728")
    line = np.outer([low, high], along) + foot + 0.12 * across
    axes.plot(*line.T, color=color, linewidth=4)
    axes.text(
        *(line.mean(axis=0) + 0.2 * across), word, color=color, weight="bold", ha="center",
        va="center",
    )  # fmt: skip
    axes.set_aspect("equal")
    axes.axis("off")


def draw_robots() -> None:
    """Draw the states per second of each checker in each world."""
    sys.path.insert(0, str(FOLDER.parent))  # tools are not installed
    from tools.robots import save_plot

    (_, *worlds, _, _), *lines = table("robots.md", "| us per state |")
    rows = [
        {"world": world, "checker": checker, "states_per_second": 1e6 / float(cell)}
        for checker, *cells in lines
        for world, cell in zip(worlds, cells, strict=False)
    ]
    save_plot(rows, FOLDER / "robots.svg")


def draw_iou() -> None:
    """Draw the detections of the tutorial and the truth from above, with what the program finds."""
    found = program_of("tutorials/perceived_boxes_iou.md")
    looks = {
        "truth": {"facecolor": "0.85", "edgecolor": "none"},
        "seen": {"fill": False, "edgecolor": plots.OUR_COLOR, "linewidth": 2.5},
    }
    texts = {
        row: f"{iou:.2f}" for row, iou in zip(found["pairs"][:, 0], found["scores"], strict=True)
    }
    with plots.picture(FOLDER / "tutorials" / "iou.svg", (9.0, 4.2)) as (figure, panels):
        axes = panels["a"]
        for name, look in looks.items():
            for corners in found[name].corners()[:, :4, :2]:  # of the upper face
                (drawn,) = axes.fill(*corners.T, **look)
            drawn.set_label(name)
        for row, corners in enumerate(found["seen"].corners()):
            text = f"{row}: IoU {texts[row]}" if row in texts else f"{row}: no truth"
            x, y = corners[:, 0].mean(), corners[:, 1].max() + (1.2 if row == 1 else 0.3)
            axes.text(x, y, text, color=plots.OUR_COLOR, weight="bold", ha="center")
        axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", ylim=(-5, 7.5))
        axes.set_title("Detections 1 and 2 are one car: non-maximum suppression keeps 1")
        figure.legend(loc="outside right center")


PLOTS = {
    "accuracy": draw_accuracy,
    "effects": draw_effects,
    "speed": draw_speed,
    "promises": draw_promises,
    "separating_axis": draw_separating_axis,
    "robots": draw_robots,
    "iou": draw_iou,
}


def make(pictures: Mapping[str, Callable[[], None]]) -> None:
    """Make the pictures whose names are the arguments, or all."""
    names = sys.argv[1:] or list(pictures)
    if not set(names) <= set(pictures):
        sys.exit(f"the pictures are {', '.join(pictures)}")
    for name in names:
        pictures[name]()


if __name__ == "__main__":
    make(PLOTS)

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

"""Makes the pictures in this folder anew: all, or those that are named.

    python docs/make_pictures.py [accuracy] [effects] [separating_axis] [demo] [arm_cell] [robots]

The plots are drawn from the tables on the pages, so that both say the same; the commands beside the
tables measure anew. `speed.svg` is drawn by its command. ``demo`` makes ``view.png`` and
``demo.png``, ``arm_cell`` that of the tutorial: they need the extra ``ros``,
``demo`` the extra ``view`` and Chromium or Chrome, too.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

FOLDER = Path(__file__).parent
#: When vehicles collide in the scene, seconds.
TIME = 28.0
#: When the arm grazes a board in its cell, seconds.
ARM_TIME = 10.0
#: Pixels of the browser's window, and where it warns of a software renderer: painted over.
WINDOW, WARNING = (1640, 740), (0, 0, 345, 190)
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
#: Nanoseconds.
UNITS = {"ns": 1.0, "µs": 1e3}


def table(page: str, head: str) -> list[list[str]]:
    """Return the cells of the rows of a table whose first line begins in a certain way."""
    lines = (FOLDER / page).read_text(encoding="utf-8").splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith(head))
    rows = []
    for line in lines[first + 2 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip().replace("`", "") for cell in line.strip("|").split("|")])
    return rows


def draw_accuracy() -> None:
    """Draw what accuracy costs: the time per pair against false alarms."""
    from obb_collision.benchmarks.contest import ContestRow, Price
    from obb_collision.benchmarks.plots import save_accuracy

    text = (FOLDER / "accuracy.md").read_text(encoding="utf-8")
    shapes, pairs = re.findall(r"On (\d+) meshes .*? all ([\d,]+) pairs", text, re.DOTALL)[0]
    price = Price("real meshes", "", int(shapes), 0, int(pairs.replace(",", "")))
    ours = [row[0] for row in table("accuracy.md", "| accuracy |")]
    for name, time, *_, false in table("accuracy.md", "| level |"):
        numbers, unit = time.rsplit(" ", 1)
        library, *kinds = re.split(r" / | ", name)
        peer = name.split(",")[0] not in ours
        names = [f"{library} {kind}" for kind in kinds] if peer else [name]
        shares = false.split(" / ")
        for one, number, share in zip(names, numbers.split(" / "), shares, strict=True):
            percent = 0 if share == "none" else int(share.removesuffix(" %"))
            price.rows.append(
                ContestRow(one, peer, float(number) * UNITS[unit], reports=100, false=percent)
            )
    save_accuracy([price], [], FOLDER / "accuracy.svg")


def draw_effects() -> None:
    """Draw what each effect adds to a step, in the scenes that come with the package."""
    from obb_collision.benchmarks.effects import ALL, CostRow
    from obb_collision.benchmarks.plots import save_effect_costs

    lines = (FOLDER / "effects.md").read_text(encoding="utf-8").splitlines()
    head = next(line for line in lines if line.startswith("| | tabletop"))
    scenes = re.findall(r"(\w+), (\d+)", head)
    rows = []
    for column, (scene, objects) in enumerate(scenes, start=1):
        base = 0.0
        for cells in table("effects.md", head):
            name, cell = cells[0].removeprefix("and ").split(",")[0], cells[column]
            if not cell:
                continue
            base = base if cell.startswith("+") else float(cell)
            extra = float(cell) if cell.startswith("+") else 0.0
            name = ALL if name.startswith("all") else name
            rows.append(CostRow(scene, name, int(objects), base, extra, 0.0, 0.0))
    save_effect_costs(rows, FOLDER / "effects.svg")


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


def photograph(url: str, file: Path) -> subprocess.Popen[bytes]:
    """Start a browser that writes a picture of a page and ends."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"needs one of {', '.join(BROWSERS)}")
    return subprocess.Popen(
        [
            *(browser, "--headless=new", "--no-sandbox", "--hide-scrollbars"),
            *("--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
            *("--force-color-profile=srgb", f"--window-size={WINDOW[0]},{WINDOW[1]}"),
            *("--virtual-time-budget=120000", f"--screenshot={file}", url),
        ]
    )


def draw_demo() -> None:
    """Run the demo up to a time and draw that state, in the browser and as a file."""
    from PIL import Image
    from rclpy.context import Context

    from obb_collision.demo.command import DEFAULT_SCENE, scene_file
    from obb_collision.demo.run import Demo
    from obb_collision.demo.scene import DemoScene
    from obb_collision.demo.view import BrowserView, LiveView
    from obb_collision.node.runtime.environment import set_defaults

    set_defaults()
    context = Context()
    context.init()
    scene = DemoScene(*scene_file(DEFAULT_SCENE))
    view = BrowserView(port=0, view=scene.description.view)
    demo = Demo(context, scene, rate=30.0, seconds=1.0, report=print, live=True)
    live = LiveView(view, demo.listener, scene.shapes, scene.zones)
    try:
        demo.begin()
        demo.settle(TIME)
        with TemporaryDirectory() as folder:
            file = Path(folder) / "view.png"
            browser = photograph(view.url, file)
            demo.spin_until(lambda: browser.poll() is not None)
            picture = Image.open(file).convert("RGB")
            picture.paste("white", WARNING)
            picture.save(FOLDER / "view.png", optimize=True)
        demo.save_picture(FOLDER / "demo.png")
    finally:
        live.close()
        demo.close()
        context.try_shutdown()


def draw_arm_cell() -> None:
    """Run the demo of the arm up to where it collides, and draw that state."""
    from rclpy.context import Context

    from obb_collision.demo.command import scene_file
    from obb_collision.demo.run import Demo
    from obb_collision.demo.scene import DemoScene
    from obb_collision.node.runtime.environment import set_defaults

    set_defaults()
    context = Context()
    context.init()
    demo = Demo(context, DemoScene(*scene_file("arm_cell")), rate=30.0, seconds=1.0, report=print)
    try:
        demo.begin()
        demo.settle(ARM_TIME)
        demo.save_picture(FOLDER / "tutorials" / "arm_cell.png")
    finally:
        demo.close()
        context.try_shutdown()


def draw_robots() -> None:
    """Draw the states per second of each checker in each world."""
    from tools.robots import save_plot

    rows = [
        {"world": world, "checker": checker, "states_per_second": float(rate.replace(",", ""))}
        for world, _, checker, _, rate, *_ in table("robots.md", "| world | objects | checker |")
    ]
    save_plot(rows, FOLDER / "robots.svg")


PICTURES = {
    "accuracy": draw_accuracy,
    "effects": draw_effects,
    "separating_axis": draw_separating_axis,
    "demo": draw_demo,
    "arm_cell": draw_arm_cell,
    "robots": draw_robots,
}


def main() -> None:
    """Make the pictures whose names are the arguments, or all."""
    names = sys.argv[1:] or list(PICTURES)
    if not set(names) <= set(PICTURES):
        sys.exit(f"the pictures are {', '.join(PICTURES)}")
    for name in names:
        PICTURES[name]()


if __name__ == "__main__":
    main()

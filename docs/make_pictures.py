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

    python docs/make_pictures.py [accuracy] [effects] [speed] [promises] [separating_axis] [demo]
        [arm_cell] [robots]

The plots are drawn from the tables on the pages, so that both say the same; the commands beside the
tables measure anew. ``demo`` makes ``view.png`` and
``demo.png``, ``arm_cell`` that of the tutorial: they need the extra ``ros``,
``demo`` the extra ``view`` and Chromium or Chrome, too.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from base64 import b64decode
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, sleep
from typing import Any
from urllib.request import urlopen

import numpy as np
from PIL import Image
from rclpy.context import Context
from websockets.sync.client import connect

from obb_collision.demo.command import DEFAULT_SCENE, scene_file
from obb_collision.demo.run import Demo
from obb_collision.demo.scene import DemoScene
from obb_collision.demo.view import BrowserView, LiveView
from obb_collision.node.runtime.environment import set_defaults

FOLDER = Path(__file__).parent
#: When vehicles collide in the scene, seconds.
TIME = 28.0
#: When the arm grazes a board in its cell, seconds.
ARM_TIME = 10.0
#: The film: when it begins and how long it takes, s; pictures per second, pixels, colours.
FILM, FRAMES, FILM_SIZE, COLORS = (27.0, 3.0), 10, (984, 444), 255
#: Seconds until the page is there, and until it shows a state that was sent.
LOADED, SETTLED = 15.0, 1.5
#: Pixels of the browser's window, and where it warns of a software renderer: painted over.
WINDOW, WARNING = (1640, 883), (0, 0, 345, 190)
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
#: Nanoseconds.
UNITS = {"ns": 1.0, "µs": 1e3, "ms": 1e6}


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


def _numbers(cell: str) -> list[tuple[str, float]]:
    """Return the numbers of a cell such as ``3.6 / 10.7 µs`` with their unit; none is 0."""
    unit = cell.rsplit(" ", 1)[-1]
    parts = [part.split(" ")[0].replace(",", "") for part in cell.split(" / ")]
    return [(unit, 0.0 if part == "none" else float(part)) for part in parts]


def _kinds(name: str) -> list[str]:
    """Return the contestants of a row such as ``coal hull / mesh``."""
    library, *kinds = re.split(r" / | ", name)
    return [f"{library} {kind}" for kind in kinds]


def _price() -> Any:
    from obb_collision.benchmarks.contest import ContestRow, Price

    text = (FOLDER / "accuracy.md").read_text(encoding="utf-8")
    shapes, pairs = re.findall(r"(\d+) meshes.*? ([\d,]+) pairs", text, re.DOTALL)[0]
    price = Price("real meshes", "", int(shapes), 0, int(pairs.replace(",", "")))
    for name, time, *_, false in table("accuracy.md", "| level |"):
        names = _kinds(name) if " " in name else [name]
        for one, (unit, number), (_, share) in zip(
            names, _numbers(time), _numbers(false), strict=True
        ):
            row = ContestRow(one, " " in name, number * UNITS[unit], reports=100, false=int(share))
            price.rows.append(row)
    return price


def draw_accuracy() -> None:
    """Draw what accuracy costs: the time per pair against false alarms and errors of effects."""
    from obb_collision.benchmarks.effects import EffectRow
    from obb_collision.benchmarks.plots import save_accuracy

    effect, rows = "", []
    for name, time, mean, _ in table("accuracy.md", "| effect | time per pair"):
        what, _, level = name.partition(" at ")
        names = [level] if level else _kinds(name)
        effect = {"time of impact": "sweep"}.get(what, what) if level else effect
        for one, (unit, number), (_, error) in zip(
            names, _numbers(time), _numbers(mean), strict=True
        ):
            rows.append(EffectRow(effect, one, not level, 1, number * UNITS[unit], 1e-3 * error))
    save_accuracy([_price()], rows, FOLDER / "accuracy.svg")


def _effect_costs() -> list[Any]:
    from obb_collision.benchmarks.effects import ALL, OFF, PAIRS, CostRow

    lines = (FOLDER / "effects.md").read_text(encoding="utf-8").splitlines()
    head = next(line for line in lines if line.startswith("| | tabletop"))
    rows = []
    for column, (scene, objects) in enumerate(re.findall(r"(\w+), (\d+)", head), start=1):
        base = 0.0
        for cells in table("effects.md", head):
            name, cell = cells[0].removeprefix("and ").split(",")[0], cells[column]
            if not cell:
                continue
            number = float(cell.replace(",", ""))
            base = number if name == OFF else base
            step = base + number if cell.startswith("+") else number
            name = ALL if name.startswith("all") else name
            rows.append(CostRow(scene, name, int(objects), step, 0.0, 0.0, 0.0))
    assert {PAIRS, OFF, ALL} <= {row.variant for row in rows}
    return rows


def draw_effects() -> None:
    """Draw what each effect adds to a step, in the scenes that come with the package."""
    from obb_collision.benchmarks.plots import save_effect_costs

    save_effect_costs(_effect_costs(), FOLDER / "effects.svg")


def draw_speed() -> None:
    """Draw the tables of the full step: by number of boxes, and by form of the scene."""
    from obb_collision.benchmarks.plots import save_speed
    from obb_collision.benchmarks.steps import StepRow

    rows = []
    heads = {
        "uniform": "| ms per step | 10 |",
        "": "| ms per step | uniform |",
    }
    for form, start in heads.items():
        text = (FOLDER / "speed.md").read_text(encoding="utf-8")
        head = next(line for line in text.splitlines() if line.startswith(start))
        columns = [cell.strip() for cell in head.strip("|").split("|")][1:]
        for name, *cells in table("speed.md", start):
            name, _, threads = name.replace(", best broad phase", ", 1 thread").rpartition(", ")
            for column, cell in zip(columns, cells, strict=True):
                if cell and not (column == "uniform" and not form):
                    boxes = int(column.replace(",", "")) if form else 10_000
                    ms, count = float(cell.split(" ")[0].rstrip("*")), int(threads.split(" ")[0])
                    case = form or column, boxes, 1.0
                    rows.append(StepRow(name, count, *case, ms, ms, 0, 0.0, 0, 0, 0, 0.0))
    save_speed(rows, FOLDER / "speed.svg")


def draw_promises() -> None:
    """Draw the three promises beside each other, from the tables that prove them."""
    from obb_collision.benchmarks import plots
    from obb_collision.benchmarks.effects import ALL, PAIRS

    with plots.picture(FOLDER / "promises.svg", (13.0, 3.8), "abc") as (_, panels):
        levels = [row for row in _price().rows if not row.peer]
        names = [f"{row.name}\n{plots.time(row.pair_ns)} per pair" for row in levels]
        shares = [100.0 * row.false_of_reports for row in levels]
        bars = panels["a"].barh(names, shares, color=plots.OURS)
        panels["a"].bar_label(bars, [f"{share:.0f} %" for share in shares], padding=4)
        panels["a"].set_title("You see what accuracy costs")
        panels["a"].set_xlabel("share of the alarms that are false")

        text = (FOLDER.parent / "README.md").read_text(encoding="utf-8")
        head = next(line for line in text.splitlines() if line.startswith("| pairs | this library"))
        checkers = [cell.strip() for cell in head.strip("|").split("|")][1:]
        rows = table("../README.md", "| pairs | this library")
        wrong = [
            sum(int(n) for row in rows for n in row[column].split("/"))
            for column in range(1, len(checkers) + 1)
        ]
        colors = [plots.OURS, *["#b9bec5"] * len(checkers)][: len(checkers)]
        bars = panels["b"].barh(checkers, wrong, color=colors)
        panels["b"].bar_label(bars, [f"{count:,}" for count in wrong], padding=4)
        panels["b"].set_title("It is right")
        panels["b"].set_xlabel(f"wrong answers in {len(rows)}00,000 pairs")

        costs = _effect_costs()
        scene = max({row.scene for row in costs}, key=[row.scene for row in costs].count)
        variants = [row.variant for row in costs if row.scene == scene and row.variant != PAIRS]
        plots.draw_effect_costs(panels["c"], costs, variants, [scene])
        panels["c"].set_title("You pay for what you ask for")
        assert ALL in variants
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


@contextmanager
def browser_of(url: str) -> Iterator[Callable[[], Image.Image]]:
    """Open a page in a browser without a window; yields what takes a picture of it."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"needs one of {', '.join(BROWSERS)}")
    with TemporaryDirectory() as folder:
        command = [
            *(browser, "--headless=new", "--no-sandbox", "--hide-scrollbars"),
            *("--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
            *("--force-color-profile=srgb", f"--window-size={WINDOW[0]},{WINDOW[1]}"),
            *("--remote-debugging-port=0", f"--user-data-dir={folder}", url),
        ]
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        try:
            port, pages = Path(folder) / "DevToolsActivePort", []
            while not pages:
                sleep(0.5)
                if port.exists():
                    address = f"http://localhost:{port.read_text().split()[0]}/json/list"
                    with urlopen(address) as reply:
                        pages = [page for page in json.load(reply) if page["url"].startswith(url)]
            with connect(pages[0]["webSocketDebuggerUrl"], max_size=None) as socket:

                def take() -> Image.Image:
                    socket.send(json.dumps({"id": 1, "method": "Page.captureScreenshot"}))
                    data = json.loads(socket.recv())["result"]["data"]
                    picture = Image.open(BytesIO(b64decode(data))).convert("RGB")
                    picture.paste("white", WARNING)
                    return picture

                yield take
        finally:
            process.terminate()
            process.wait()


@contextmanager
def running_demo(scene: str, **options: Any) -> Iterator[Demo]:
    """Start the demo of a scene."""
    set_defaults()
    context = Context()
    context.init()
    description = DemoScene(*scene_file(scene))
    demo = Demo(context, description, rate=30.0, seconds=1.0, report=print, **options)
    try:
        demo.begin()
        yield demo
    finally:
        demo.close()
        context.try_shutdown()


def draw_demo() -> None:
    """Run the demo up to a time and draw that state; and a few seconds of it, in the browser."""
    with running_demo(DEFAULT_SCENE, live=True) as demo:
        scene = demo.scene
        view = BrowserView(port=0, view=scene.description.view)
        live = LiveView(view, demo.listener, scene.shapes, scene.zones)

        def picture(time: float) -> Image.Image:
            demo.settle(time)
            ready = monotonic() + SETTLED
            demo.spin_until(lambda: monotonic() >= ready)
            taken = pool.submit(take)
            demo.spin_until(taken.done)  # a node that does not spin would be STALE
            return taken.result()

        with closing(live), browser_of(view.url) as take, ThreadPoolExecutor(1) as pool:
            ready = monotonic() + LOADED
            demo.spin_until(lambda: monotonic() >= ready)
            frames = [picture(FILM[0] + k / FRAMES) for k in range(round(FILM[1] * FRAMES))]
            picture(TIME).save(FOLDER / "view.png", optimize=True)
        small = [frame.resize(FILM_SIZE, Image.Resampling.LANCZOS) for frame in frames]
        pixels = np.concatenate([np.asarray(frame).reshape(-1, 3) for frame in small])
        colors = np.unique(pixels | 7, axis=0)  # each one once: rare ones count
        palette = Image.fromarray(colors[None]).quantize(COLORS)
        first, *others = [frame.quantize(palette=palette, dither=0) for frame in small]
        options: Any = {"duration": 1000 / FRAMES, "loop": 0, "optimize": True}
        first.save(FOLDER / "view.gif", save_all=True, append_images=others, **options)
        demo.save_picture(FOLDER / "demo.png")


def draw_arm_cell() -> None:
    """Run the demo of the arm up to where it collides, and draw that state."""
    with running_demo("arm_cell") as demo:
        demo.settle(ARM_TIME)
        demo.save_picture(FOLDER / "tutorials" / "arm_cell.png")


def draw_robots() -> None:
    """Draw the states per second of each checker in each world."""
    sys.path.insert(0, str(FOLDER.parent))  # tools are not installed
    from tools.robots import save_plot

    rows = [
        {"world": world, "checker": checker, "states_per_second": float(rate.replace(",", ""))}
        for world, _, checker, _, rate, *_ in table("robots.md", "| world | objects | checker |")
    ]
    save_plot(rows, FOLDER / "robots.svg")


PICTURES = {
    "accuracy": draw_accuracy,
    "effects": draw_effects,
    "speed": draw_speed,
    "promises": draw_promises,
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

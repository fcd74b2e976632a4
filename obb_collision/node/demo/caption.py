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

"""Texts on the demo's picture: title, legend, names at the contacts.

The only module that needs matplotlib, which is an extra: import it where a picture is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke

Color = tuple[float, float, float]
#: x and y in pixels from the top left, and the text.
Label = tuple[float, float, str]

#: Pixels per inch of the figure; one point of text is DPI / 72 pixels.
DPI = 100
#: Room that a label takes, pixels.
LABEL_WIDTH, LABEL_HEIGHT = 250.0, 22.0
#: Size of the letters, points, and from one line to the next, pixels: legible at half the size.
LETTERS, LINE = 15.5, 32
INK, GREY = (0.13, 0.15, 0.18), (0.42, 0.45, 0.49)


class Entry(NamedTuple):
    """A line of the legend; form: "box", "dot", "speck" or "line", as in the picture."""

    text: str
    color: Color
    form: str = "box"


def save_picture(
    file: Path,
    image: npt.NDArray[np.uint8],
    title: str,
    subtitle: str,
    legend: Sequence[Entry],
    labels: Sequence[Label],
) -> None:
    """Write an image (h, w, 3) as PNG with its texts."""
    height, width = image.shape[:2]
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.imshow(image, interpolation="none", extent=(0, width, height, 0), aspect="auto")
    halo = [withStroke(linewidth=3.5, foreground=(1.0, 1.0, 1.0, 0.85))]
    over: Any = {"va": "baseline", "path_effects": halo, "zorder": 4}
    axes.text(44, 70, title, fontsize=30, weight="bold", color=INK, **over)
    axes.text(46, 110, subtitle, fontsize=LETTERS, color=GREY, **over)
    top = height - 34 - LINE * len(legend)
    for k, entry in enumerate(legend):
        y = top + LINE * k
        _draw_sign(axes, entry, y)
        axes.text(82, y, entry.text, fontsize=LETTERS, color=INK, path_effects=halo, zorder=4)
    for at_x, at_y, text in spread(labels):
        axes.text(at_x + 15, at_y - 11, text, fontsize=13, color=INK, path_effects=halo)
    axes.set(xlim=(0, width), ylim=(height, 0))
    figure.savefig(file, dpi=DPI, format="png", pil_kwargs={"optimize": True})


def _draw_sign(axes: Any, entry: Entry, y: float) -> None:
    """Draw what stands before a legend's text whose base line is at y, as it is in the picture."""
    color = tuple(entry.color)
    if entry.form == "dot":
        white: Any = {"markeredgewidth": 2, "markeredgecolor": "white"}
        axes.plot([57], [y - 6], color=color, marker="o", markersize=10, **white)
    elif entry.form == "speck":
        axes.plot([57], [y - 6], color=color, marker="o", markersize=4)
    elif entry.form == "line":
        axes.plot([46, 68], [y - 7, y - 7], color=color, linewidth=3.0)
    else:
        box = [(46, y), (68, y), (68, y - 16), (46, y - 16)]
        axes.add_patch(Polygon(box, facecolor=(*color, 0.25), edgecolor=color, linewidth=2.0))


def spread(labels: Sequence[Label]) -> list[Label]:
    """Return labels moved down, from the top one on, until none covers another."""
    placed: list[Label] = []
    for x, y, text in sorted(labels, key=lambda label: label[1]):
        for other_x, other_y, _ in placed:  # these are in order too
            if abs(x - other_x) < LABEL_WIDTH and y < other_y + LABEL_HEIGHT:
                y = other_y + LABEL_HEIGHT
        placed.append((x, y, text))
        placed.sort(key=lambda label: label[1])
    return placed

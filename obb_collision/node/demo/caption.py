"""Texts on the demo's picture: title, legend, names at the contacts.

The only module that needs matplotlib, which is an extra: import it where a picture is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke

from obb_collision.node.demo.picture import COLLIDING, STATE_COLORS

#: x and y in pixels from the top left, and the text.
Label = tuple[float, float, str]

#: Pixels per inch of the figure; one point of text is DPI / 72 pixels.
DPI = 100
#: Room that a label takes, pixels.
LABEL_WIDTH, LABEL_HEIGHT = 200.0, 18.0
INK, GREY = (0.13, 0.15, 0.18), (0.42, 0.45, 0.49)


def save_picture(
    file: Path,
    image: npt.NDArray[np.uint8],
    title: str,
    subtitle: str,
    legend: Sequence[str],
    labels: Sequence[Label],
) -> None:
    """Write an image (h, w, 3) as PNG with its texts.

    legend: a text for each state.
    """
    height, width = image.shape[:2]
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.imshow(image, interpolation="none", extent=(0, width, height, 0), aspect="auto")
    axes.text(44, 62, title, fontsize=25, weight="bold", color=INK, va="baseline")
    axes.text(45, 95, subtitle, fontsize=12.5, color=GREY, va="baseline")
    for k, (text, color) in enumerate(zip(legend, STATE_COLORS, strict=True)):
        x, y = 45, height - 92 + 26 * k
        box = [(x, y), (x + 18, y), (x + 18, y + 14), (x, y + 14)]
        axes.add_patch(_outlined(box, color))
        axes.text(x + 29, y + 13, text, fontsize=12.5, color=INK, va="baseline")
    dot: Any = {
        "marker": "o",
        "markersize": 7.5,
        "markeredgewidth": 1.5,
        "markeredgecolor": "white",
    }
    axes.plot([54], [height - 111], color=tuple(STATE_COLORS[COLLIDING]), **dot)
    axes.text(74, height - 106, "contact, and how deep", fontsize=12.5, color=INK, va="baseline")
    halo = [withStroke(linewidth=3.0, foreground=(1.0, 1.0, 1.0, 0.85))]
    for at_x, at_y, text in spread(labels):
        axes.text(at_x + 13, at_y - 10, text, fontsize=10.5, color=INK, path_effects=halo)
    axes.set(xlim=(0, width), ylim=(height, 0))
    figure.savefig(file, dpi=DPI, format="png", pil_kwargs={"optimize": True})


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


def _outlined(corners: Sequence[tuple[float, float]], color: npt.NDArray[np.float64]) -> Any:
    return Polygon(corners, facecolor=(*color, 0.25), edgecolor=tuple(color), linewidth=1.8)

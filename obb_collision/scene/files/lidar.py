"""A lidar that is not there: a cloud of what a scanner in the middle of a scene would see.

For demos and measurements of the effect ``points``. The rays meet the floor (z = 0) and, of the
objects that the sensor sees, the oriented boxes or the cylinders upright in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import Floats

Cloud = NDArray[np.float32]

#: Scanners have a few lines of many points: this many, between these angles above the horizon.
LINES = 32
LOWEST, HIGHEST = np.radians(-35.0), np.radians(15.0)
#: Standard deviation of a measured distance (m), and the nearest one measured.
NOISE, NEAREST = 0.01, 0.3


@dataclass(frozen=True)
class Lidar:
    """A scanner: number of rays a turn, range (m), position (3,), patterns of what it sees.

    seed: of the noise of the distances; equal seeds and times give equal clouds.
    """

    count: int
    range: float
    position: tuple[float, float, float] = (0.0, 0.0, 1.0)
    sees: tuple[str, ...] = ("*",)
    seed: int = 0

    def directions(self) -> Floats:
        """Return the unit directions (count, 3) of the rays, line by line from below."""
        lines = min(LINES, self.count)
        line = np.arange(self.count) * lines // self.count
        turn = np.modf(np.arange(self.count) * lines / self.count)[0] * 2.0 * np.pi
        rise = LOWEST + (HIGHEST - LOWEST) * line / max(lines - 1, 1)
        return np.stack(
            [np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)], axis=1
        )

    def scan(self, boxes: Boxes, time: float, turned: Sequence[bool] = ()) -> Cloud:
        """Return the points (k, 3) seen at a time (s).

        boxes: of what it sees; turned (n,): whether cylinders along z stand in them.
        """
        directions = self.directions()
        origin = np.array(self.position)
        with np.errstate(divide="ignore"):
            way = np.where(directions[:, 2] < 0.0, -origin[2] / directions[:, 2], np.inf)
        way[way <= 0.0] = np.inf
        for row in range(len(boxes)):
            hit = _to_cylinder if turned and turned[row] else _to_box
            center, rotation, half_extents = boxes.row(row)
            start, along = (origin - center) @ rotation, directions @ rotation
            way = np.minimum(way, hit(start, along, half_extents))
        moment = round(time * 1e6) % 2**63  # microseconds: what a stamp would tell apart
        noise = np.random.default_rng([self.seed, moment]).normal(0.0, NOISE, self.count)
        seen = (way >= NEAREST) & (way <= self.range)
        points = origin + (way + noise)[seen, None] * directions[seen]
        return points.astype(np.float32)


def _to_box(start: Floats, along: Floats, half_extents: Floats) -> Floats:
    """Return (n,) metres along rays to a box, inf where they miss it; by slabs (Kay, Kajiya 1986).

    start (3,), along (n, 3): the rays in the frame of the box. From inside nothing is seen of it.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (-half_extents - start) / along, (half_extents - start) / along
    near = np.nanmax(np.fmin(first, second), axis=1)
    far = np.nanmin(np.fmax(first, second), axis=1)
    return np.where((near <= far) & (near > 0.0), near, np.inf)


def _to_cylinder(start: Floats, along: Floats, half_extents: Floats) -> Floats:
    """Return (n,) metres along rays to the cylinder along z in a box, inf where they miss it."""
    radius, height = half_extents[0], half_extents[2]
    a = (along[:, :2] ** 2).sum(axis=1)
    b = along[:, :2] @ start[:2]
    root = b * b - a * (start[:2] @ start[:2] - radius * radius)
    with np.errstate(divide="ignore", invalid="ignore"):
        side = np.sqrt(root) / a
        enter, leave = -b / a - side, -b / a + side
        caps = (np.array([[-height], [height]]) - start[2]) / along[:, 2]
    near, far = np.fmax(enter, caps.min(axis=0)), np.fmin(leave, caps.max(axis=0))
    return np.where((root >= 0.0) & (near <= far) & (near > 0.0), near, np.inf)

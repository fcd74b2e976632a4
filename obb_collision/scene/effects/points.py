"""The effect ``points``: which obstacle points lie inside which boxes of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from obb_collision.queries.points import PointsInside, points_inside
from obb_collision.scene.effects.base import Cycle, Option, Outcome, Setting
from obb_collision.scene.store import Rows


@dataclass(frozen=True, eq=False)
class ObjectPoints:
    """What the boxes of n objects hold of the cloud ``Scene.points``.

    indices (n,): the objects that call for it, ascending; inside: row by row the same.
    """

    indices: Rows
    inside: PointsInside

    def __len__(self) -> int:
        return len(self.indices)


class Points:
    """Points inside boxes, or within ``margin`` of them; nothing to do without a cloud."""

    name = "points"
    options: Mapping[str, Option] = {
        "margin": Option(0.0, 0.0, 1e6, "Points this near to a box count as inside (m)."),
    }
    lazy = True

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Count the points of all callers at once."""
        called = cycle.active if setting.wanted is None else cycle.active & setting.wanted
        slots = np.flatnonzero(called)
        if cycle.points is None or len(cycle.points) == 0 or len(slots) == 0:
            return Outcome(ObjectPoints(slots, _nothing(len(slots))), 0)
        inside = points_inside(cycle.boxes.take(slots), cycle.points, setting.values["margin"])
        return Outcome(ObjectPoints(slots, inside), len(cycle.points))


def _nothing(count: int) -> PointsInside:
    none = np.full(count, -1)
    return PointsInside(np.zeros(count, np.int64), none, none.copy(), np.full(count, np.inf), 0)

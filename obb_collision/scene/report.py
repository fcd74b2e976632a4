"""Report: what one check of a scene found, and what it took."""

from __future__ import annotations

from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import Floats
from obb_collision.queries.witness import witness_kernel
from obb_collision.scene.ladder import Found


@dataclass(frozen=True, eq=False)
class Report:
    """The colliding pairs of a scene, m of them, as arrays with one row a pair.

    pairs (m, 2) int64: object indices i < j, in lexicographic order.
    verdicts (m,) int8: ``Verdict.TOUCHING`` or ``OVERLAP``; both count as colliding. OVERLAP is
    certain; on all rungs but OBB and MESH, which can't be, everything is TOUCHING.
    separations (m,) metres, negative where overlapping; normals (m, 3), unit, from i to j.
    points (m, 3) metres: a place near both boxes at which to show the contact. These three are
    those of the boxes on every rung; on the rungs below OBB separations may be positive.
    rungs (m,) int8: the ``Accuracy`` that each pair was decided on.
    stages: seconds spent, by stage of the check.
    """

    pairs: NDArray[np.int64]
    verdicts: NDArray[np.int8]
    separations: Floats
    normals: Floats
    points: Floats
    rungs: NDArray[np.int8]
    slot_names: tuple[str | None, ...] = field(repr=False)
    stages: dict[str, float] = field(repr=False)

    def __len__(self) -> int:
        return len(self.pairs)

    @property
    def depths(self) -> Floats:
        """(m,) metres: how deep each pair overlaps, 0 where only touching."""
        result: Floats = np.maximum(-self.separations, 0.0)
        return result

    @property
    def colliding(self) -> NDArray[np.bool_]:
        """(slots,) whether the object of each index takes part in a collision."""
        mask = np.zeros(len(self.slot_names), np.bool_)
        mask[self.pairs.ravel()] = True
        return mask

    def names(self) -> list[tuple[str, str]]:
        """Return the pairs by name, in the order of ``pairs``."""
        return [(str(self.slot_names[i]), str(self.slot_names[j])) for i, j in self.pairs.tolist()]


def describe(
    boxes: Boxes,
    found: Found,
    names: tuple[str | None, ...],
    stages: dict[str, float],
    last: Report | None,
    old: NDArray[np.int64] | None,
) -> Report:
    """Add separations, normals and points, copied where row ``old`` of ``last`` has them.

    boxes: those of all slots; old (m,): -1 for pairs found anew, None if all are; stages: seconds
    spent so far.
    """
    start = perf_counter()
    pairs, verdicts, rungs = found
    gaps, normals, points = np.empty(len(pairs)), *np.empty((2, len(pairs), 3))
    anew = np.arange(len(pairs)) if old is None else np.flatnonzero(old < 0)
    results = np.empty(len(anew)), *np.empty((2, len(anew), 3))
    witness_kernel(boxes.centers, boxes.rotations, boxes.half_extents, pairs[anew], *results)
    gaps[anew], normals[anew], points[anew] = results
    if old is not None and last is not None:
        known = np.flatnonzero(old >= 0)
        for new_values, values in (
            (gaps, last.separations),
            (normals, last.normals),
            (points, last.points),
        ):
            new_values[known] = values[old[known]]
    stages = {**stages, "separations": perf_counter() - start}
    return Report(pairs, verdicts, gaps, normals, points, rungs, names, stages)

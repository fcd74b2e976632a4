"""Report: what one check of a scene found, and what it took."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.validation import Floats


@dataclass(frozen=True, eq=False)
class Report:
    """The colliding pairs of a scene, m of them, as arrays with one row a pair.

    pairs (m, 2) int64: object indices i < j, in lexicographic order.
    verdicts (m,) int8: ``Verdict.TOUCHING`` or ``OVERLAP``; both count as colliding.
    separations (m,) metres, negative where overlapping; normals (m, 3), unit, from i to j.
    points (m, 3) metres: a place near both boxes at which to show the contact.
    stages: seconds spent, by stage of the check.
    """

    pairs: NDArray[np.int64]
    verdicts: NDArray[np.int8]
    separations: Floats
    normals: Floats
    points: Floats
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

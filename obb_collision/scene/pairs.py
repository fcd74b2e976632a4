"""Find every colliding pair of a set of boxes: broad phase, then the certified test."""

from __future__ import annotations

import numpy as np

from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.separation import SEPARATE, Verdicts, pair_verdicts
from obb_collision.scene.broad_phase import Pairs, find_candidates


def find_pairs(boxes: Boxes, exact: bool = False) -> Pairs:
    """Return (m, 2) int64, i < j, lexicographic: every pair that is not SEPARATE.

    Touching counts as colliding, and so does what doubles can't tell from touching; with
    ``exact=True`` the latter is decided by integer arithmetic.
    """
    pairs, _ = find_pairs_and_verdicts(boxes, exact)
    return pairs


def find_pairs_and_verdicts(boxes: Boxes, exact: bool = False) -> tuple[Pairs, Verdicts]:
    """Return the pairs of ``find_pairs`` and the verdict (m,) int8 of each."""
    return colliding_pairs(boxes, find_candidates(*boxes.world_bounds()), exact)


def colliding_pairs(boxes: Boxes, candidates: Pairs, exact: bool = False) -> tuple[Pairs, Verdicts]:
    """Return the candidates (m, 2) that are not SEPARATE, sorted, and their verdicts."""
    first = np.ascontiguousarray(candidates[:, 0])
    second = np.ascontiguousarray(candidates[:, 1])
    verdicts = pair_verdicts(boxes, first, boxes, second, exact)
    colliding = verdicts != SEPARATE
    keys = first[colliding] * len(boxes) + second[colliding]
    order = np.argsort(keys)
    pairs = candidates[colliding][order]
    return pairs, verdicts[colliding][order]

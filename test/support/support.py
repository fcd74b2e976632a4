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

"""Small tools that several tests share: from families to stored boxes, and to witnesses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import pytest
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

import obb_collision as oc
from obb_collision import Boxes, MovingBoxes, sweeps
from obb_collision.geometry.validation import orthonormal_defect
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.queries.clearance.clearance import Clearances
from obb_collision.queries.contacts import Contacts
from obb_collision.queries.sweep import TOLERANCE, Sweeps
from obb_collision.queries.verdict.witness import witness_kernel
from obb_collision.typing import Floats
from tools.cases.families import generate

Arrays = tuple[Floats, Floats, Floats]
Answer = TypeVar("Answer")

#: Of boxes of any doubles that are accepted, from subnormal to 1e300, for hypothesis.
numbers = st.floats(-1e300, 1e300)
vectors = st.tuples(numbers, numbers, numbers)
extents = st.tuples(*3 * [st.floats(0.0, 1e300)])
quaternions = st.tuples(*4 * [st.floats(-1.0, 1.0)]).filter(any)


@st.composite
def any_pairs(draw: st.DrawFn) -> tuple[Boxes, Boxes]:
    """Draw a box and another, some of them with equal centres, of any doubles."""
    center = draw(vectors)
    places = center, draw(st.one_of(vectors, st.none())) or center
    a, b = (Boxes.from_poses([(*p, *draw(quaternions))], [draw(extents)]) for p in places)
    return a, b


def stored(boxes: Boxes) -> Arrays:
    """Return the arrays of boxes as they are stored: what verdicts speak about."""
    return boxes.centers, boxes.rotations, boxes.half_extents


def row_of(boxes: Boxes, row: int | np.integer) -> Arrays:
    """Return centre (3,), rotation (3, 3) and half extents (3,) of one box."""
    return boxes.centers[row], boxes.rotations[row], boxes.half_extents[row]


def family(name: str, n: int, seed: int = 0) -> tuple[Boxes, Boxes]:
    """``n`` pairs of a family as boxes."""
    a, b = generate(name, n, seed)
    return Boxes(*a), Boxes(*b)


def sizes(a: Boxes, b: Boxes) -> Floats:
    """(n,) size of each pair: the sum of its six half extents, metres."""
    return np.asarray((a.half_extents + b.half_extents).sum(axis=1))


def joined(a: Boxes, b: Boxes) -> tuple[Boxes, NDArray[np.int64]]:
    """All boxes of both sides, and the (n, 2) rows of the pairs in it."""
    both = Boxes.trusted(
        *(np.concatenate([x, y]) for x, y in zip(stored(a), stored(b), strict=True))
    )
    rows = np.arange(len(a))
    return both, np.stack([rows, rows + len(a)], axis=1)


def witnesses(a: Boxes, b: Boxes) -> tuple[Floats, Floats]:
    """Signed gaps (n,) metres and unit axes (n, 3) from a to b."""
    boxes, pairs = joined(a, b)
    gaps, axes, points = np.empty(len(a)), np.empty((len(a), 3)), np.empty((len(a), 3))
    witness_kernel(boxes.arrays, pairs, gaps, axes, points, 0, len(pairs))
    return gaps, axes


def refused(reason: str, ask: Callable[..., Any], *arguments: Any, **options: Any) -> None:
    """Assert that a call raises ValueError with this reason."""
    with pytest.raises(ValueError, match=reason):
        ask(*arguments, **options)


def by_threads(ask: Callable[[], Answer], *counts: int | None) -> list[Answer]:
    """Return the answers that as many threads give."""
    try:
        answers = []
        for count in counts:
            oc.set_threads(count)
            answers.append(ask())
        return answers
    finally:
        oc.set_threads(None)


def loosened(rotations: Floats, rng: np.random.Generator) -> Floats:
    """Stretch, skew and jitter axes until R^T R - I reaches up to 64 unit roundoffs."""
    n = len(rotations)
    stretched = 1.0 + rng.uniform(-20.0, 20.0, (n, 1, 3)) * ROUNDOFF
    result = rotations * stretched + rng.uniform(-18.0, 18.0, (n, 3, 3)) * ROUNDOFF
    too_loose = np.abs(orthonormal_defect(result)) > 60.0 * ROUNDOFF
    result[too_loose] = rotations[too_loose]
    assert too_loose.mean() < 0.7
    return result


def contacts(boxes: Boxes, pairs: ArrayLike, limit: int = 4) -> Contacts:
    return oc.contacts(boxes, boxes, pairs, max_points=limit)


def clearances(boxes: Boxes, pairs: ArrayLike) -> Clearances:
    return oc.clearances(boxes, boxes, pairs)


def sweep(
    start: Boxes, end: Boxes, pairs: ArrayLike, tolerance: float = TOLERANCE, *,
    contacts: bool = True,
) -> Sweeps:  # fmt: skip
    """Sweep boxes from pose to pose."""
    moving = MovingBoxes(start, end)
    return sweeps(moving, moving, pairs, tolerance=tolerance, contacts=contacts)


def sweep_twists(
    boxes: Boxes, twists: ArrayLike, pairs: ArrayLike, horizon: float,
    tolerance: float = TOLERANCE, *, origins: ArrayLike | None = None, contacts: bool = True,
) -> Sweeps:  # fmt: skip
    """Sweep boxes by their twists."""
    moving = MovingBoxes.from_twists(boxes, twists, horizon, origins=origins)
    return sweeps(moving, moving, pairs, tolerance=tolerance, contacts=contacts)

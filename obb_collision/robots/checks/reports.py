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

"""Reports of checks of states and motions of robots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from obb_collision.typing import Floats, Integers, Mask, Rows

#: The second name of a pair whose first name is a joint out of its limits.
OUT_OF_LIMITS = "out of limits"


class StatePairs(NamedTuple):
    """Every colliding pair of every state, states ascending.

    Attributes
    ----------
    states : (m,) numpy.ndarray
        The row of the state of each pair.
    pairs : (m, 2) numpy.ndarray
        Rows of the report's ``names``, the smaller first.
    """

    states: Rows
    pairs: Integers


class FirstPairs:
    """A report with a pair of links or objects per row, by number (``first_pairs``) and name."""

    first_pairs: Integers
    names: Sequence[str]

    @cached_property
    def pairs(self) -> list[tuple[str, str] | None]:
        """(n,) the names of ``first_pairs``, None without a pair."""
        return [
            None if a < 0 else (self.names[a], self.names[b]) for a, b in self.first_pairs.tolist()
        ]

    def __len__(self) -> int:
        return len(self.first_pairs)


class ValidityReport(FirstPairs):
    """A report of states or motions, which are valid within limits and free of collisions."""

    out_of_limits: Mask
    _things: ClassVar[str] = ""

    @cached_property
    def colliding(self) -> Mask:
        """(n,) whether each state or motion collides; undecided motions count as colliding."""
        return np.asarray(self.first_pairs[:, 0] >= 0)

    @cached_property
    def valid(self) -> Mask:
        """(n,) whether each state or motion is within limits and certainly free of collisions."""
        free = np.asarray(self.first_pairs[:, 0] < 0)
        if not self.out_of_limits.any():  # usually, and it halves the time of a single state
            return free
        return np.asarray(free & ~self.out_of_limits.any(axis=1))

    def __repr__(self) -> str:
        count, out = int(self.valid.sum()), int(self.out_of_limits.any(axis=1).sum())
        limits = f", {out} out of limits" if out else ""
        return f"{type(self).__name__}({count} of {len(self)}{self._things} valid{limits})"


@dataclass(frozen=True, eq=False, repr=False)
class StateReport(ValidityReport):
    """Which states of robots are valid: within limits, and free of collisions.

    ``pairs`` has the names of the first colliding pair of each state, None for none.

    Attributes
    ----------
    out_of_limits : (n, joints) numpy.ndarray
        True for joints beyond their limits, or with mimics beyond theirs.
    first_pairs : (n, 2) numpy.ndarray
        A colliding pair per state, as rows of ``names``, the smaller first; -1 for none. Of several
        pairs it is always the same one, the first in the order of tests.
    names : sequence of str
        Links, attached objects, and objects of the scene.
    all_pairs : StatePairs or None
        Every colliding pair, if the check was asked for them.
    """

    out_of_limits: Mask
    first_pairs: Integers
    names: Sequence[str]
    all_pairs: StatePairs | None = None
    _things: ClassVar[str] = " states"

    def pairs_of(self, state: int) -> list[tuple[str, str]]:
        """Return the names of all colliding pairs of a state, after a check with all_pairs=True."""
        if self.all_pairs is None:
            raise ValueError("all pairs were not requested: use check(..., all_pairs=True)")
        states, pairs = self.all_pairs
        first, last = np.searchsorted(states, [state, state + 1])
        return [(self.names[a], self.names[b]) for a, b in pairs[first:last].tolist()]


@dataclass(frozen=True, eq=False)
class StateDistances(FirstPairs):
    """The least distance in each state, or that of every pair within ``max_distance``.

    Rows (n,) are states, or with ``all_pairs=True`` pairs in states.

    Attributes
    ----------
    distances : (n,) numpy.ndarray
        Metres. Lower bounds of the distance of boxes, hulls or meshes, by the accuracy; minus the
        depth of the deepest pair in a collision; infinite if no pair is within ``max_distance``.
    upper_bounds : (n,) numpy.ndarray
        Upper bounds of the distance of the shapes, which is larger than that of meshes around
        cylinders, cones and ellipsoids; 0 in a collision of other shapes.
    first_pairs : (n, 2) numpy.ndarray
        Rows of ``names``, the smaller first; -1 for none.
    points : (n, 2, 3) numpy.ndarray
        The closest points of the pair, in the scene; NaN for none.
    directions : (n, 3) numpy.ndarray
        Unit vectors from the first to the second body of the pair; NaN for none.
    names : sequence of str
        As in ``StateReport``.
    states : (n,) numpy.ndarray
        The state of each row, ascending.
    jacobians : (n, joints) numpy.ndarray or None
        The gradients of distances by the joints, with ``jacobian=True``; NaN for no pair.
    """

    distances: Floats
    upper_bounds: Floats
    first_pairs: Integers
    points: Floats
    directions: Floats
    names: Sequence[str]
    states: Rows
    jacobians: Floats | None = None


@dataclass(frozen=True, eq=False, repr=False)
class MotionReport(ValidityReport):
    """Which motions are valid all the way from start to end.

    Attributes
    ----------
    fractions : (n,) numpy.ndarray
        Where the motion collides, from 0 at the start to 1 at the end; NaN for a free one. With
        ``first=True`` it is certainly free up to there, and collides within ``resolution``.
    undecided : (n,) numpy.ndarray
        Motions that count as colliding without a colliding state: a pair is too near to be proved
        free.
    out_of_limits : (n, joints) numpy.ndarray
        True for joints that leave their limits.
    first_pairs : (n, 2) numpy.ndarray
        The pair, as in ``StateReport``.
    names : sequence of str
        As in ``StateReport``.
    joint_names : sequence of str
        The columns of ``out_of_limits``.
    """

    fractions: Floats
    undecided: Mask
    out_of_limits: Mask
    first_pairs: Integers
    names: Sequence[str]
    joint_names: Sequence[str]

    @cached_property
    def pairs(self) -> list[tuple[str, str] | None]:
        """(n,) the names of ``first_pairs``, None without a pair.

        A free motion that exceeds limits has the first such joint, and OUT_OF_LIMITS.
        """
        pairs = super().pairs
        for row in np.flatnonzero(self.out_of_limits.any(axis=1)).tolist():
            joint = self.joint_names[int(self.out_of_limits[row].argmax())]
            pairs[row] = pairs[row] or (joint, OUT_OF_LIMITS)
        return pairs

    @property
    def first_invalid(self) -> int | None:
        """The row of the first motion that is not valid, None if all are valid."""
        rows = np.flatnonzero(~self.valid)
        return int(rows[0]) if len(rows) else None

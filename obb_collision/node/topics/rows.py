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

"""Results of a check -> rows of the clouds, sorted by (ns_a, id_a, ns_b, id_b), a before b.

The order is that of the numbers, the same in every node and run: ``ns`` and ``id`` as int32. Every
``..._rows`` takes a result, the state that was checked and the layout of a row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from obb_collision.node.messages.names import namespace_number
from obb_collision.node.objects.table import ObjectTable, Slots
from obb_collision.queries.clearance.clearance import Clearances
from obb_collision.queries.contacts.contacts import Contacts
from obb_collision.queries.points.points import PointsInside
from obb_collision.scene.effects.base import join_rows
from obb_collision.scene.effects.sweep import SweptPairs
from obb_collision.scene.report import Report
from obb_collision.typing import Floats, Mask

StructuredRows = npt.NDArray[Any]
"""(n,) array with named fields."""

PAIR_FIELDS = ("ns_a", "id_a", "ns_b", "id_b")
POSITION_FIELDS = ("x", "y", "z")
NORMAL_FIELDS = ("normal_x", "normal_y", "normal_z")
POINT_FIELDS = ("point_x", "point_y", "point_z")
END, BEGIN, LASTING = range(3)
"""Kinds of events: a collision ended, began, or lasts."""
REMOVED, NOT_CHECKED = 1, 2
"""Why a collision ended, other than 0, which is that the objects are apart."""
A_FIELDS, B_FIELDS = ("a_x", "a_y", "a_z"), ("b_x", "b_y", "b_z")


@dataclass(frozen=True)
class CheckedState:
    """One check to publish.

    stamp: of the state (ns). step: seconds between it and that of the check before. cloud_stamp:
    of the newest points that are watched. now: time of the check (ns).
    """

    report: Report
    table: ObjectTable
    stamp: int
    step: float
    cloud_stamp: int
    now: int


class Ordered(NamedTuple):
    """Pairs in the order of the rows.

    order: which pair each was; a, b: its objects; swapped: they are the other way round there.
    """

    order: Slots
    a: Slots
    b: Slots
    swapped: Mask

    def flipped(self, normals: Floats) -> Floats:
        """Return normals (m, 3) of the pairs in the order of the rows, from a to b."""
        return np.where(self.swapped[:, None], -1.0, 1.0) * normals[self.order]


def order_pairs(pairs: npt.NDArray[np.int64], table: ObjectTable) -> Ordered:
    """Sort pairs (m, 2) of slots by the keys of their objects."""
    ranks = table.ranks
    first, second = ranks[pairs[:, 0]], ranks[pairs[:, 1]]
    order = np.argsort(np.minimum(first, second) * len(ranks) + np.maximum(first, second))
    swapped = (first > second)[order]
    left, right = pairs[order, 0], pairs[order, 1]
    a, b = np.where(swapped, right, left), np.where(swapped, left, right)
    return Ordered(order, a, b, swapped)


def pair_rows(
    dtype: np.dtype[Any], pairs: Ordered, state: CheckedState, which: Slots | slice = slice(None)
) -> StructuredRows:
    """Return rows for pairs, or those of their indices ``which``, with nothing but the objects."""
    a, b, table = pairs.a[which], pairs.b[which], state.table
    rows = np.zeros(len(a), dtype)
    rows["ns_a"], rows["id_a"] = table.ns[a], table.id[a]
    rows["ns_b"], rows["id_b"] = table.ns[b], table.id[b]
    return rows


def _put(rows: StructuredRows, names: tuple[str, ...], values: Floats) -> None:
    with np.errstate(over="ignore"):  # x y z are float32, for RViz
        for name, column in zip(names, values.T, strict=True):
            rows[name] = column


def collision_rows(report: Report, state: CheckedState, dtype: np.dtype[Any]) -> StructuredRows:
    """Return rows (m,) of the colliding pairs; NaN where the effect ``separations`` gave none."""
    pairs = order_pairs(report.pairs, state.table)
    rows = pair_rows(dtype, pairs, state)
    rows["verdict"], rows["accuracy"] = report.verdicts[pairs.order], report.accuracies[pairs.order]
    if "separations" not in report.results:
        for name in (*POSITION_FIELDS, *NORMAL_FIELDS, "depth"):
            rows[name] = np.nan
        return rows
    _put(rows, POSITION_FIELDS, report.positions[pairs.order])
    _put(rows, NORMAL_FIELDS, pairs.flipped(report.normals))
    rows["depth"] = report.depths[pairs.order]
    return rows


def contact_rows(result: Contacts, state: CheckedState, dtype: np.dtype[Any]) -> StructuredRows:
    """Return rows (k,), one per contact point."""
    pairs = order_pairs(result.pairs, state.table)
    counts = result.counts[pairs.order]
    pair = np.repeat(np.arange(len(counts)), counts)
    index = np.arange(len(pair)) - np.repeat(np.cumsum(counts) - counts, counts)
    rows = pair_rows(dtype, pairs, state, pair)
    points = result.positions[pairs.order[pair], index]
    _put(rows, POSITION_FIELDS, points)
    _put(rows, POINT_FIELDS, points)
    _put(rows, NORMAL_FIELDS, pairs.flipped(result.normals)[pair])
    rows["depth"] = result.position_depths[pairs.order[pair], index]
    rows["index"], rows["count"] = index, counts[pair]
    return rows


def clearance_rows(result: Clearances, state: CheckedState, dtype: np.dtype[Any]) -> StructuredRows:
    """Return rows (k,), one per pair that is near."""
    pairs = order_pairs(result.pairs, state.table)
    rows = pair_rows(dtype, pairs, state)
    swapped = pairs.swapped[:, None]
    first, second = result.positions_a[pairs.order], result.positions_b[pairs.order]
    a, b = np.where(swapped, second, first), np.where(swapped, first, second)
    _put(rows, POSITION_FIELDS, 0.5 * a + 0.5 * b)
    _put(rows, A_FIELDS, a)
    _put(rows, B_FIELDS, b)
    _put(rows, NORMAL_FIELDS, pairs.flipped(result.normals))
    rows["distance"] = result.distances[pairs.order]
    return rows


def prediction_rows(
    result: SweptPairs, state: CheckedState, dtype: np.dtype[Any]
) -> StructuredRows:
    """Return rows (k,): collisions passed since the state before, and those to come."""
    swept = join_rows([result.passed, result.predicted])
    passed = np.arange(len(swept)) < len(result.passed)
    pairs = order_pairs(swept.pairs, state.table)
    rows = pair_rows(dtype, pairs, state)
    points = np.where(swept.undecided[:, None], np.nan, swept.positions)[pairs.order]
    normals = np.where(swept.undecided[:, None], np.nan, swept.normals)
    _put(rows, POSITION_FIELDS, points)
    _put(rows, POINT_FIELDS, points)
    _put(rows, NORMAL_FIELDS, pairs.flipped(normals))
    times = np.where(passed, (swept.free_until - 1.0) * state.step, swept.free_until)
    rows["time"] = times[pairs.order]
    rows["passed"], rows["undecided"] = passed[pairs.order], swept.undecided[pairs.order]
    return rows


def event_rows(events: StructuredRows, state: CheckedState, dtype: np.dtype[Any]) -> StructuredRows:
    """Return the rows (k,), which events have from the beginning."""
    return events


def inside_rows(result: PointsInside, state: CheckedState, dtype: np.dtype[Any]) -> StructuredRows:
    """Return rows (k,) of the pairs of a cloud and an object with points inside."""
    assert result.clouds is not None
    assert result.positions is not None
    table = state.table
    hit = np.flatnonzero(result.counts)
    slots, clouds = result.indices[hit], result.clouds[hit]
    cloud_slots = np.maximum(clouds, 0)
    rows = np.zeros(len(slots), dtype)
    rows["ns"], rows["id"] = table.ns[slots], table.id[slots]
    rows["count"], rows["first"] = result.counts[hit], result.first[hit]
    rows["nearest"], rows["distance"] = result.nearest[hit], result.distances[hit]
    _put(rows, POSITION_FIELDS, result.positions[hit])
    rows["cloud_ns"], rows["cloud_id"] = table.ns[cloud_slots], table.id[cloud_slots]
    for number, name in enumerate(state.report.cycle.watched):
        namespace, _, ident = name.rpartition("/")
        own = clouds == -1 - number
        rows["cloud_ns"][own], rows["cloud_id"][own] = namespace_number(namespace), int(ident)
    return rows[np.lexsort([rows[name] for name in ("cloud_id", "cloud_ns", "id", "ns")])]

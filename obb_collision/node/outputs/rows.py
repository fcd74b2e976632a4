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

"""What a check gave -> rows of the clouds, sorted by (ns_a, id_a, ns_b, id_b), a before b.

The order is that of the numbers, the same in every node and run: ``ns`` and ``id`` as int32.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from obb_collision.node.messages.layouts import (
    A_FIELDS,
    B_FIELDS,
    CLEARANCE_DTYPE,
    COLLISION_DTYPE,
    CONTACT_DTYPE,
    INSIDE_DTYPE,
    NORMAL_FIELDS,
    POINT_FIELDS,
    POSITION_FIELDS,
    PREDICTION_DTYPE,
    Rows,
)
from obb_collision.node.objects.table import ObjectTable, Slots
from obb_collision.scene.effects.clearance import PairClearances
from obb_collision.scene.effects.contacts import PairContacts
from obb_collision.scene.effects.points import ObjectPoints
from obb_collision.scene.effects.sweep import SweptPairs
from obb_collision.scene.report import Report
from obb_collision.typing import Floats


class Ordered(NamedTuple):
    """Pairs in the order of the rows.

    order: which pair each was; a, b: its objects; swapped: they are the other way round there.
    """

    order: Slots
    a: Slots
    b: Slots
    swapped: npt.NDArray[np.bool_]

    def flipped(self, normals: Floats) -> Floats:
        """Return normals (m, 3) of the pairs in the order of the rows, from a to b."""
        turned: Floats = np.where(self.swapped[:, None], -1.0, 1.0) * normals[self.order]
        return turned


def order_pairs(pairs: npt.NDArray[np.int64], table: ObjectTable) -> Ordered:
    """Sort pairs (m, 2) of slots by the keys of their objects."""
    keys = table.order_keys(pairs)
    order = np.lexsort((keys.max(axis=1), keys.min(axis=1)))
    keys, pairs = keys[order], pairs[order]
    swapped = keys[:, 0] > keys[:, 1]
    a, b = np.where(swapped, pairs[:, ::-1].T, pairs.T)
    return Ordered(order, a, b, swapped)


def _named_rows(dtype: np.dtype[Any], a: Slots, b: Slots, table: ObjectTable) -> Rows:
    rows = np.zeros(len(a), dtype)
    rows["ns_a"], rows["id_a"] = table.ns[a], table.id[a]
    rows["ns_b"], rows["id_b"] = table.ns[b], table.id[b]
    return rows


def _put(rows: Rows, names: tuple[str, ...], values: Floats) -> None:
    with np.errstate(over="ignore"):  # x y z are float32, for RViz
        for name, column in zip(names, values.T, strict=True):
            rows[name] = column


def collision_rows(report: Report, table: ObjectTable) -> Rows:
    """(m,) rows of COLLISION_DTYPE; NaN for what the effect ``separations`` did not give."""
    found = order_pairs(report.pairs, table)
    rows = _named_rows(COLLISION_DTYPE, found.a, found.b, table)
    rows["verdict"], rows["accuracy"] = report.verdicts[found.order], report.accuracies[found.order]
    if "separations" not in report.results:
        for name in (*POSITION_FIELDS, *NORMAL_FIELDS, "depth"):
            rows[name] = np.nan
        return rows
    _put(rows, POSITION_FIELDS, report.points[found.order])
    _put(rows, NORMAL_FIELDS, found.flipped(report.normals))
    rows["depth"] = report.depths[found.order]
    return rows


def contact_rows(result: PairContacts, table: ObjectTable) -> Rows:
    """(k,) rows of CONTACT_DTYPE, one a contact point."""
    found = order_pairs(result.pairs, table)
    counts = result.counts[found.order]
    pair = np.repeat(np.arange(len(counts)), counts)
    index = np.arange(len(pair)) - np.repeat(np.cumsum(counts) - counts, counts)
    rows = _named_rows(CONTACT_DTYPE, found.a[pair], found.b[pair], table)
    points = result.points[found.order[pair], index]
    _put(rows, POSITION_FIELDS, points)
    _put(rows, POINT_FIELDS, points)
    _put(rows, NORMAL_FIELDS, found.flipped(result.normals)[pair])
    rows["depth"] = result.point_depths[found.order[pair], index]
    rows["index"], rows["count"] = index, counts[pair]
    return rows


def clearance_rows(result: PairClearances, table: ObjectTable) -> Rows:
    """(k,) rows of CLEARANCE_DTYPE."""
    found = order_pairs(result.pairs, table)
    rows = _named_rows(CLEARANCE_DTYPE, found.a, found.b, table)
    swapped = found.swapped[:, None]
    first, second = result.points_a[found.order], result.points_b[found.order]
    a, b = np.where(swapped, second, first), np.where(swapped, first, second)
    _put(rows, POSITION_FIELDS, 0.5 * a + 0.5 * b)
    _put(rows, A_FIELDS, a)
    _put(rows, B_FIELDS, b)
    _put(rows, NORMAL_FIELDS, found.flipped(result.normals))
    rows["distance"] = result.distances[found.order]
    return rows


def prediction_rows(result: SweptPairs, step: float, table: ObjectTable) -> Rows:
    """(k,) rows of PREDICTION_DTYPE; ``step``: seconds between the last two states checked."""
    hits = result.passed, result.predicted
    open_ = result.passed_undecided, result.predicted_undecided
    found = order_pairs(np.concatenate([part.pairs for part in (*hits, *open_)]), table)
    rows = _named_rows(PREDICTION_DTYPE, found.a, found.b, table)
    nowhere = np.full((sum(map(len, open_)), 3), np.nan)
    points = np.concatenate([*(part.points for part in hits), nowhere])[found.order]
    _put(rows, POSITION_FIELDS, points)
    _put(rows, POINT_FIELDS, points)
    _put(rows, NORMAL_FIELDS, found.flipped(np.concatenate([*(h.normals for h in hits), nowhere])))
    times = [*(part.times for part in hits), *(part.free_until for part in open_)]
    for number in (0, 2):
        times[number] = (times[number] - 1.0) * step
    rows["time"] = np.concatenate(times)[found.order]
    part = np.repeat(np.arange(4), [len(seconds) for seconds in times])[found.order]
    rows["passed"], rows["undecided"] = part % 2 == 0, part >= 2
    return rows


def inside_rows(result: ObjectPoints, points: npt.NDArray[Any] | None, table: ObjectTable) -> Rows:
    """(k,) rows of INSIDE_DTYPE, of the objects with points inside; points: the cloud."""
    found = np.flatnonzero(result.counts)
    found = found[np.argsort(table.order_keys(result.indices[found]))]
    slots = result.indices[found]
    rows = np.zeros(len(slots), INSIDE_DTYPE)
    rows["ns"], rows["id"] = table.ns[slots], table.id[slots]
    rows["count"], rows["first"] = result.counts[found], result.first[found]
    rows["nearest"], rows["distance"] = result.nearest[found], result.distances[found]
    if points is not None and len(found):
        _put(rows, POSITION_FIELDS, points[result.nearest[found]])
    return rows

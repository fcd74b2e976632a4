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

"""From messages of the node to names in one line: ``for a, b, *_ in named_contacts(message, ns)``.

``namespaces`` is the latest message of the topic ``namespaces``, a dict of names by number, such as
that of several nodes merged, or just a list of the names: the number of a namespace is that of its
name (``namespace_number``).
Rows keep their order. All raise RefusedError: "field layout" for a message of another topic,
"unknown namespace" where the table is older than the message: it is published first, but topics may
overtake each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isnan
from typing import NamedTuple, TypeAlias

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import PointCloud2

from obb_collision.node.messages.conversions import name_from_key, namespace_table
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.layouts import (
    A_FIELDS,
    B_FIELDS,
    NORMAL_FIELDS,
    POINT_FIELDS,
    Rows,
    clearances_from_ros,
    collisions_from_ros,
    contacts_from_ros,
    points_inside_from_ros,
    predictions_from_ros,
)
from obb_collision.queries.verdict.verdict import Verdict

Namespaces: TypeAlias = DiagnosticStatus | Sequence[str] | Mapping[int, str]
Triple = tuple[float, float, float]


class NamedPair(NamedTuple):
    """One collision with the objects' names, ``ns/id``."""

    a: str
    b: str
    depth: float
    touching: bool
    """Touching, or not told from touching by doubles; it counts as colliding all the same."""


class NamedContact(NamedTuple):
    """One contact point: where (m), unit normal from a to b, depth (m)."""

    a: str
    b: str
    point: Triple
    normal: Triple
    depth: float


class NamedClearance(NamedTuple):
    """One pair that is near: signed distance (m) and the closest points."""

    a: str
    b: str
    distance: float
    point_a: Triple
    point_b: Triple


class NamedPrediction(NamedTuple):
    """One collision to come or passed: when (s from the stamp), where (m), unit normal from a to b.

    If it is ``undecided``, it is not known whether the objects collide: they certainly don't
    before the time, but they may from then on. Point and normal are NaN then.
    """

    a: str
    b: str
    time: float
    point: Triple
    normal: Triple

    @property
    def undecided(self) -> bool:
        """Whether it is not known if they collide."""
        return isnan(self.point[0])


class NamedPoints(NamedTuple):
    """One object with points inside: how many, indices in the cloud of the first and the nearest.

    distance: from the box centre to the nearest one (m).
    """

    name: str
    points: int
    first: int
    nearest: int
    distance: float


def named_pairs(message: PointCloud2, namespaces: Namespaces) -> list[NamedPair]:
    """Return the collisions with names: ``for pair in named_pairs(message, table): pair.depth``."""
    rows = collisions_from_ros(message)
    values = rows[["depth", "verdict"]].tolist()
    return [
        NamedPair(a, b, depth, verdict == Verdict.TOUCHING)
        for (a, b), (depth, verdict) in zip(_pairs(rows, namespaces), values, strict=True)
    ]


def named_contacts(message: PointCloud2, namespaces: Namespaces) -> list[NamedContact]:
    """Return the contact points with names."""
    rows = contacts_from_ros(message)
    values = rows[[*POINT_FIELDS, *NORMAL_FIELDS, "depth"]].tolist()
    return [
        NamedContact(a, b, v[:3], v[3:6], v[6])
        for (a, b), v in zip(_pairs(rows, namespaces), values, strict=True)
    ]


def named_clearances(message: PointCloud2, namespaces: Namespaces) -> list[NamedClearance]:
    """Return the pairs that are near, with names."""
    rows = clearances_from_ros(message)
    values = rows[["distance", *A_FIELDS, *B_FIELDS]].tolist()
    return [
        NamedClearance(a, b, v[0], v[1:4], v[4:7])
        for (a, b), v in zip(_pairs(rows, namespaces), values, strict=True)
    ]


def named_predictions(message: PointCloud2, namespaces: Namespaces) -> list[NamedPrediction]:
    """Return the collisions to come, with names: also what may come, see ``NamedPrediction``."""
    return _predictions(message, namespaces, passed=False)


def named_passed_collisions(message: PointCloud2, namespaces: Namespaces) -> list[NamedPrediction]:
    """Return what collided, or may have, between the last two states, with names.

    Times are negative. ``named_predictions`` has the rest: only what is to come.
    """
    return _predictions(message, namespaces, passed=True)


def _predictions(
    message: PointCloud2, namespaces: Namespaces, passed: bool
) -> list[NamedPrediction]:
    rows = predictions_from_ros(message)
    rows = rows[(rows["passed"] != 0) == passed]
    values = rows[["time", *POINT_FIELDS, *NORMAL_FIELDS]].tolist()
    return [
        NamedPrediction(a, b, v[0], v[1:4], v[4:7])
        for (a, b), v in zip(_pairs(rows, namespaces), values, strict=True)
    ]


def named_points_inside(message: PointCloud2, namespaces: Namespaces) -> list[NamedPoints]:
    """Return the objects with points inside, with names."""
    rows = points_inside_from_ros(message)
    values = rows[["count", "first", "nearest", "distance"]].tolist()
    names = _names(rows, "ns", "id", namespaces)
    return [NamedPoints(name, *v) for name, v in zip(names, values, strict=True)]


def _pairs(rows: Rows, namespaces: Namespaces) -> list[tuple[str, str]]:
    a, b = (_names(rows, *ends, namespaces) for ends in (("ns_a", "id_a"), ("ns_b", "id_b")))
    return list(zip(a, b, strict=True))


def _names(rows: Rows, ns: str, number: str, namespaces: Namespaces) -> list[str]:
    table = namespace_table(namespaces)
    try:
        return [name_from_key((table[index], key)) for index, key in rows[[ns, number]].tolist()]
    except KeyError as error:
        raise RefusedError("unknown namespace", "take a newer message of 'namespaces'") from error

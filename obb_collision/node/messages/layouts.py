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

"""The rows of the clouds that the node publishes, and how they are read, always by field name.

RViz draws x y z only as float32; whatever is measured is float64. Every field stands at a multiple
of its size, and a row at a multiple of 8 bytes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from obb_collision.node.messages.clouds import cloud_from_ros, cloud_to_ros
from obb_collision.node.messages.errors import RefusedError

Rows = npt.NDArray[Any]

PAIR_FIELDS = ("ns_a", "id_a", "ns_b", "id_b")
POSITION_FIELDS = ("x", "y", "z")
NORMAL_FIELDS = ("normal_x", "normal_y", "normal_z")
POINT_FIELDS = ("point_x", "point_y", "point_z")
A_FIELDS, B_FIELDS = ("a_x", "a_y", "a_z"), ("b_x", "b_y", "b_z")


def _layout(*groups: tuple[str, tuple[str, ...]]) -> np.dtype[Any]:
    return np.dtype([(name, kind) for kind, names in groups for name in names], align=True)


COLLISION_DTYPE = _layout(
    ("<f4", POSITION_FIELDS),
    ("<f8", (*NORMAL_FIELDS, "depth")),
    ("<i4", PAIR_FIELDS),
    ("u1", ("verdict", "accuracy")),
)
"""One row of ``collisions``: contact point, unit normal from a to b and depth (m), the two objects
as number of the namespace and id; the verdict: 1 touching or not told from it, 2 overlap; the
number of the ``Accuracy`` on which it was decided."""

CONTACT_DTYPE = _layout(
    ("<f4", POSITION_FIELDS),
    ("<f8", (*NORMAL_FIELDS, "depth", *POINT_FIELDS)),
    ("<i4", PAIR_FIELDS),
    ("u1", ("index", "count")),
)
"""One row of ``contacts``: a contact point of a pair, number ``index`` of ``count``."""

CLEARANCE_DTYPE = _layout(
    ("<f4", POSITION_FIELDS),
    ("<f8", (*NORMAL_FIELDS, "distance", *A_FIELDS, *B_FIELDS)),
    ("<i4", PAIR_FIELDS),
)
"""One row of ``clearances``: signed distance (m) and the closest points of a pair; x y z is the
middle between them."""

PREDICTION_DTYPE = _layout(
    ("<f4", POSITION_FIELDS),
    ("<f8", (*NORMAL_FIELDS, "time", *POINT_FIELDS)),
    ("<i4", PAIR_FIELDS),
    ("u1", ("passed", "undecided")),
)
"""One row of ``predicted_collisions``: time from the stamp (s), point and normal of the contact at
that time; ``passed``: 1 if it happened between the last two states, and the time is negative;
``undecided``: 1 if it is not known whether the objects collide: they certainly don't before the
time, may from then on, and point and normal are NaN."""

INSIDE_DTYPE = _layout(
    ("<f4", POSITION_FIELDS),
    ("<f8", ("distance",)),
    ("<i4", ("ns", "id", "count", "first", "nearest")),
)
"""One row of ``points_inside``: an object with points in its box: how many, the indices in the
cloud of the first and of the one nearest to the box centre, its distance (m) and position."""

OPTIONAL_FIELDS = ("accuracy", "undecided")
"""Fields that messages recorded with an earlier version don't have."""


def rows_from_ros(message: PointCloud2, layout: np.dtype[Any], topic: str) -> Rows:
    """(n,) structured array of a message, by field name.

    Raises RefusedError ("field layout") where a field of the layout is missing.
    """
    rows = cloud_from_ros(message, layout.names or ())
    known = rows.dtype.names or ()
    for name in layout.names or ():
        if name not in known and name not in OPTIONAL_FIELDS:
            raise RefusedError("field layout", f"no field {name!r}: not a {topic} message")
    return rows


def collisions_to_ros(rows: Rows, header: Header | None = None) -> PointCloud2:
    """``collisions`` message of (n,) rows of COLLISION_DTYPE."""
    return cloud_to_ros(rows, header)


def collisions_from_ros(message: PointCloud2) -> Rows:
    """(n,) structured array of a ``collisions`` message: ``rows["depth"]``, ``rows["id_a"]``..."""
    return rows_from_ros(message, COLLISION_DTYPE, "collisions")


def contacts_from_ros(message: PointCloud2) -> Rows:
    """(n,) structured array of a ``contacts`` message."""
    return rows_from_ros(message, CONTACT_DTYPE, "contacts")


def clearances_from_ros(message: PointCloud2) -> Rows:
    """(n,) structured array of a ``clearances`` message."""
    return rows_from_ros(message, CLEARANCE_DTYPE, "clearances")


def predictions_from_ros(message: PointCloud2) -> Rows:
    """(n,) structured array of a ``predicted_collisions`` message."""
    return rows_from_ros(message, PREDICTION_DTYPE, "predicted_collisions")


def points_inside_from_ros(message: PointCloud2) -> Rows:
    """(n,) structured array of a ``points_inside`` message."""
    return rows_from_ros(message, INSIDE_DTYPE, "points_inside")

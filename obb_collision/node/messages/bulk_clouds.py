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


"""Clouds with a row per object: bulk poses, and complete sets of boxes."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from obb_collision.node.messages.clouds import (
    KNOWN_LAYOUTS,
    NO_LIMIT,
    cloud_from_ros,
    cloud_to_ros,
    side_by_side,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.typing import Floats, Integers

POSE_FIELDS = ("x", "y", "z", "qx", "qy", "qz", "qw")
SIZE_FIELDS = ("size_x", "size_y", "size_z")
KEY_FIELDS = ("ns", "id")


def poses_from_ros(
    message: PointCloud2, most: int = NO_LIMIT
) -> tuple[Integers | None, Integers, Floats]:
    """Bulk poses: namespace numbers (n,) or None without a field ``ns``, ids (n,), poses (n, 7).

    Raises RefusedError ("field layout") where a field is missing or of the wrong kind: ``id`` and
    ``ns`` are integers of any size, the pose fields float32 or float64. Also ("too many points")
    for more rows than ``most``.
    """
    return _rows_from_ros(message, POSE_FIELDS, most)


def boxes_from_ros(
    message: PointCloud2, most: int = NO_LIMIT
) -> tuple[Integers | None, Integers, Floats, Floats]:
    """Boxes of a message of ``object_boxes``: as ``poses_from_ros``, and sizes (n, 3) in metres.

    Raises RefusedError ("field layout", "too many points").
    """
    namespaces, ids, values = _rows_from_ros(message, (*POSE_FIELDS, *SIZE_FIELDS), most)
    return namespaces, ids, values[:, :7].copy(), values[:, 7:].copy()


def _rows_from_ros(
    message: PointCloud2, names: tuple[str, ...], most: int
) -> tuple[Integers | None, Integers, Floats]:
    """Return namespace numbers (n,) or None, ids (n,), and the values of fields (n, k)."""
    rows = cloud_from_ros(message, (*KEY_FIELDS, *names), most)
    has_namespaces, together = _layout_of(rows.dtype, names)
    if together is None:
        values = np.empty((len(rows), len(names)))
        for column, name in enumerate(names):
            values[:, column] = rows[name]
    else:
        values = rows.view(together)["all"].astype(np.float64)
    namespaces = rows["ns"].astype(np.int64) if has_namespaces else None
    return namespaces, rows["id"].astype(np.int64), values


@lru_cache(KNOWN_LAYOUTS)
def _layout_of(dtype: np.dtype[Any], names: tuple[str, ...]) -> tuple[bool, np.dtype[Any] | None]:
    """Return whether rows have a field ``ns``, and a type that has the other fields together.

    None for it where they are not side by side. RefusedError ("field layout").
    """
    fields: Mapping[str, Any] = dtype.fields or {}
    for name in ("id", *names):
        if name not in fields:
            raise RefusedError("field layout", f"no field {name!r}")
    for name in KEY_FIELDS:
        if name in fields and fields[name][0].kind not in "iu":
            raise RefusedError("field layout", f"field {name!r} is not an integer")
    for name in names:
        if fields[name][0].kind != "f":
            raise RefusedError("field layout", f"field {name!r} is not a float")
    return "ns" in fields, side_by_side(dtype, names)


def poses_to_ros(
    ids: npt.ArrayLike,
    poses: npt.ArrayLike,
    namespaces: npt.ArrayLike | None = None,
    header: Header | None = None,
    single: bool = False,
) -> PointCloud2:
    """Bulk poses for ``object_poses``: (n,) ids, (n, 7) poses, (n,) namespace numbers.

    ``single`` writes float32, half the bytes and 7 decimal digits.
    """
    return _rows_to_ros(ids, np.asarray(poses, np.float64), POSE_FIELDS, namespaces, header, single)


def boxes_to_ros(
    ids: npt.ArrayLike,
    poses: npt.ArrayLike,
    sizes: npt.ArrayLike,
    namespaces: npt.ArrayLike | None = None,
    header: Header | None = None,
    single: bool = False,
) -> PointCloud2:
    """Return the complete set of boxes for ``object_boxes``: as ``poses_to_ros``, and their sizes.

    sizes: (n, 3) edge lengths in metres. Without namespaces all are in ``boxes``.
    """
    values = np.hstack(
        (
            np.asarray(poses, np.float64).reshape(-1, len(POSE_FIELDS)),
            np.asarray(sizes, np.float64).reshape(-1, len(SIZE_FIELDS)),
        )
    )
    return _rows_to_ros(ids, values, (*POSE_FIELDS, *SIZE_FIELDS), namespaces, header, single)


def _rows_to_ros(
    ids: npt.ArrayLike,
    values: Floats,
    names: tuple[str, ...],
    namespaces: npt.ArrayLike | None,
    header: Header | None,
    single: bool,
) -> PointCloud2:
    ids = np.asarray(ids)
    keys = KEY_FIELDS[1:] if namespaces is None else KEY_FIELDS
    kind = "<f4" if single else "<f8"
    layout = [*((name, kind) for name in names), *((name, "<i4") for name in keys)]
    rows = np.zeros(len(ids), np.dtype(layout))
    for column, name in enumerate(names):
        rows[name] = values[:, column]
    rows["id"] = ids
    if namespaces is not None:
        rows["ns"] = namespaces
    return cloud_to_ros(rows, header)

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

"""PointCloud2 <-> arrays, always by field name: obstacle points, bulk poses, sets of boxes."""

from __future__ import annotations

import struct
from collections.abc import Collection, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from obb_collision.node.messages.cdr import (
    ENCAPSULATION,
    FLAG,
    NO_LIMIT,
    SIZE,
    STAMP,
    TOO_MANY_POINTS,
    padded,
)
from obb_collision.node.messages.conversions import NANOSECONDS
from obb_collision.node.messages.errors import RefusedError
from obb_collision.typing import Floats, Integers

DATATYPES = {
    PointField.INT8: "i1",
    PointField.UINT8: "u1",
    PointField.INT16: "i2",
    PointField.UINT16: "u2",
    PointField.INT32: "i4",
    PointField.UINT32: "u4",
    PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}
LARGEST_POINT = 2**31 - 1
"""Bytes of a point at most: numpy before 2.0 stores the size of an item in 32 bits."""
KNOWN_LAYOUTS = 64
"""Layouts of clouds that are remembered: a sender has one, and reading it takes 30 us."""
FIELD, LAYOUT = struct.Struct("<IBxxxI"), struct.Struct("<BxxxIII")
"""Parts of a serialised cloud: the end of a field, and what follows all fields."""
DATATYPE_OF = {np.dtype(code): number for number, code in DATATYPES.items()}


def cloud_from_ros(
    message: PointCloud2, names: Collection[str], most: int = NO_LIMIT
) -> npt.NDArray[Any]:
    """Return a structured view (n,) of the named fields that a cloud has, whatever its layout.

    Order of fields, padding and endianness are the message's. No more is copied than the message
    holds. Raises RefusedError ("field layout") where it contradicts itself, and ("too many points")
    where there are more than ``most``.
    """
    step, width, height = int(message.point_step), int(message.width), int(message.height)
    fields = ((f.name, f.datatype, f.count, f.offset) for f in message.fields if f.name in names)
    dtype = _layout(tuple(fields), bool(message.is_bigendian), step)
    if width * height == 0:
        return np.zeros(0, dtype)
    rows, size = int(message.row_step) or width * step, len(message.data)
    if height > 1 and rows == size == height * width * step:
        rows = width * step  # some say so of the whole cloud; RViz reads point after point
    # Rows that overlap would make far more points than there are bytes.
    if step == 0 or rows < width * step or size < (height - 1) * rows + width * step:
        raise RefusedError(
            "field layout",
            f"{size} bytes of data for {height} rows of {rows} bytes, "
            f"{width} points of {step} bytes each",
        )
    if width * height > most:
        raise RefusedError(TOO_MANY_POINTS, f"{width * height}, {most} is the limit")
    grid = np.ndarray((height, width), dtype, memoryview(message.data), 0, (rows, step))
    return grid.reshape(-1)


@lru_cache(KNOWN_LAYOUTS)
def _layout(
    described: tuple[tuple[str, int, int, int], ...], is_bigendian: bool, step: int
) -> np.dtype[Any]:
    """Return the type of rows. All is checked in Python's integers: numpy's wrap around."""
    if step > LARGEST_POINT:
        raise RefusedError("field layout", f"points of {step} bytes each")
    order = ">" if is_bigendian else "<"
    fields: dict[str, tuple[str, int]] = {}
    for name, datatype, count, start in described:
        # count 0 is what some old writers put for a single number
        if datatype not in DATATYPES or count > 1:
            wrong = f"datatype {datatype} and count {count}"
            raise RefusedError("field layout", f"field {name!r} has {wrong}: no number")
        code, offset = DATATYPES[datatype], int(start)
        if offset < 0 or offset + int(code[1:]) > step:
            raise RefusedError(
                "field layout",
                f"field {name!r} at byte {offset} reaches beyond the {step} of a point",
            )
        if name in fields:
            raise RefusedError("field layout", f"field {name!r} occurs twice")
        fields[name] = order + code, offset
    formats, offsets = [code for code, _ in fields.values()], [at for _, at in fields.values()]
    layout: Any = {"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": step}
    return np.dtype(layout)


def field_bytes(dtype: np.dtype[Any]) -> bytes:
    """Return the serialised fields of clouds whose rows are of a structured type."""
    fields: Mapping[str, Any] = dtype.fields or {}
    parts = [struct.pack("<I", len(fields))]
    for name in dtype.names or ():
        kind, offset = fields[name][:2]
        parts += padded(name), FIELD.pack(offset, DATATYPE_OF[kind.newbyteorder("=")], 1)
    return b"".join(parts)


def cloud_to_bytes(rows: npt.NDArray[Any], stamp: int, frame: str, fields: bytes) -> bytes:
    """Return a serialised unordered cloud of a (n,) structured array: rclpy takes 20 us for fields.

    stamp: nanoseconds. fields: those of the rows, see ``field_bytes``.
    """
    data, dtype = np.ascontiguousarray(rows).tobytes(), rows.dtype
    names = dtype.names or ()
    is_bigendian = any(dtype[name].byteorder == ">" for name in names)
    is_dense = "x" not in names or bool(np.isfinite(rows["x"]).all())
    parts = (
        *(ENCAPSULATION, STAMP.pack(*divmod(stamp, NANOSECONDS)), padded(frame)),
        *(SIZE.pack(1, len(rows)), fields),
        *(LAYOUT.pack(is_bigendian, dtype.itemsize, len(data), len(data)), data),
        FLAG.pack(is_dense),
    )
    return b"".join(parts)


def cloud_to_ros(rows: npt.NDArray[Any], header: Header | None = None) -> PointCloud2:
    """Return an unordered cloud of a structured array (n,); fields follow the array's dtype."""
    data = cloud_to_bytes(rows, 0, "", field_bytes(rows.dtype))
    message: PointCloud2 = deserialize_message(data, PointCloud2)
    if header is not None:
        message.header = header
    return message


def points_from_ros(message: PointCloud2, most: int = NO_LIMIT) -> npt.NDArray[Any]:
    """Return the points (n, 3) of a cloud, in order: float32 if x y z are, else float64.

    Where they stand side by side in the message they are not copied. Raises RefusedError ("field
    layout") where one of them is missing or no float, ("too many points") for more than ``most``.
    """
    rows = cloud_from_ros(message, POINT_FIELDS, most)
    _, together = _layout_of(rows.dtype, POINT_FIELDS, ())
    if together is not None:
        points: npt.NDArray[Any] = rows.view(together)["all"]
        if points.dtype.isnative and points.flags.aligned:
            return points
    single = max(rows.dtype[name].itemsize for name in POINT_FIELDS) == 4
    return np.stack([rows[name] for name in POINT_FIELDS], axis=1, dtype="f4" if single else "f8")


def side_by_side(dtype: np.dtype[Any], names: tuple[str, ...]) -> np.dtype[Any] | None:
    """Return a type of rows whose one field "all" is k fields of one type that are side by side.

    None where they are not.
    """
    fields: Mapping[str, Any] = dtype.fields or {}
    kinds, places = zip(*(fields[name][:2] for name in names), strict=True)
    kind, first = kinds[0], places[0]
    expected = range(first, first + len(names) * kind.itemsize, kind.itemsize)
    if places != tuple(expected) or kinds.count(kind) < len(names):
        return None
    layout: Any = {"names": ["all"], "formats": [(kind, len(names))], "offsets": [first]}
    layout["itemsize"] = dtype.itemsize
    return np.dtype(layout)


POINT_FIELDS = ("x", "y", "z")
POSE_FIELDS = (*POINT_FIELDS, "qx", "qy", "qz", "qw")
SIZE_FIELDS = ("size_x", "size_y", "size_z")
KEY_FIELDS = ("ns", "id")


def poses_from_ros(
    message: PointCloud2, most: int = NO_LIMIT
) -> tuple[Integers | None, Integers, Floats]:
    """Return namespace numbers (n,), or None without a field ``ns``, ids (n,) and poses (n, 7).

    Raises RefusedError ("field layout") where a field is missing or of the wrong kind: ``id`` and
    ``ns`` are integers of any size, the pose fields float32 or float64. Also ("too many points")
    for more rows than ``most``.
    """
    return _rows_from_ros(message, POSE_FIELDS, most)


def boxes_from_ros(
    message: PointCloud2, most: int = NO_LIMIT
) -> tuple[Integers | None, Integers, Floats, Floats]:
    """Return the boxes of a message of ``object_boxes``, with sizes (n, 3) in metres.

    The other results are those of ``poses_from_ros``.

    Raises RefusedError ("field layout", "too many points").
    """
    namespaces, ids, values = _rows_from_ros(message, (*POSE_FIELDS, *SIZE_FIELDS), most)
    return namespaces, ids, values[:, :7].copy(), values[:, 7:].copy()


def _rows_from_ros(
    message: PointCloud2, names: tuple[str, ...], most: int
) -> tuple[Integers | None, Integers, Floats]:
    """Return namespace numbers (n,) or None, ids (n,), and the values of fields (n, k)."""
    rows = cloud_from_ros(message, (*KEY_FIELDS, *names), most)
    has_namespaces, together = _layout_of(rows.dtype, names, ("id",))
    if together is None:
        values = np.empty((len(rows), len(names)))
        for column, name in enumerate(names):
            values[:, column] = rows[name]
    else:
        values = rows.view(together)["all"].astype(np.float64)
    namespaces = rows["ns"].astype(np.int64) if has_namespaces else None
    return namespaces, rows["id"].astype(np.int64), values


@lru_cache(KNOWN_LAYOUTS)
def _layout_of(
    dtype: np.dtype[Any], names: tuple[str, ...], needed: tuple[str, ...]
) -> tuple[bool, np.dtype[Any] | None]:
    """Return whether rows have a field ``ns``, and a type that has the other fields together.

    None for it where they are not side by side. RefusedError ("field layout").
    """
    fields: Mapping[str, Any] = dtype.fields or {}
    for name in (*needed, *names):
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
    """Return bulk poses for ``object_poses``: ids (n,), poses (n, 7), namespace numbers (n,).

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
    parts = (poses, POSE_FIELDS), (sizes, SIZE_FIELDS)
    values = np.hstack([np.asarray(p, np.float64).reshape(-1, len(names)) for p, names in parts])
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

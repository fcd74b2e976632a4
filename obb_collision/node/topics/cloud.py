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

"""Entries of the table of topics: a topic, or a cloud with its fields, rows and reader."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from obb_collision.node.messages.clouds import cloud_from_ros, cloud_to_ros, field_bytes
from obb_collision.node.messages.conversions import name_from_key, namespace_table
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import stand_in
from obb_collision.node.topics.rows import CheckedState, StructuredRows
from obb_collision.scene.effects.base import Option

Namespaces: TypeAlias = DiagnosticStatus | Sequence[str] | Mapping[int, str]
"""The latest message of ``namespaces``, names by number (such as those of several nodes, merged),
or just the names."""
Fields = tuple[str, ...]
Record = TypeVar("Record")

RELIABLE = QoSProfile(depth=10)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""The last message reaches late subscribers too, if they request transient local."""
MEANINGS = {
    "x y z": "The place of the row (m), float32 for RViz.",
    "normal_x normal_y normal_z": "Unit vector from a to b.",
    "ns_a id_a ns_b id_b": "The objects: number of the namespace and id, a before b.",
}
"""Of the fields that most clouds have."""
OPTIONAL_FIELDS = ("accuracy", "undecided", "cloud_ns", "cloud_id")
"""Fields that messages recorded with an earlier version don't have."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Topic:
    """One topic that the node publishes.

    name: as given to rclpy. message: its type. description: the beginning of a
    sentence; of a topic of an effect, the effect has it. note: sentences about its mode. needs:
    effects of the scene without a topic of their own that its messages are made from. options: of
    a topic without effect, by name; an effect has its own.
    """

    name: str
    description: str = ""
    note: str = ""
    message: type
    qos: QoSProfile = field(default_factory=lambda: RELIABLE)
    needs: Fields = ()
    options: Mapping[str, Option] = field(default_factory=dict)

    @property
    def is_latched(self) -> bool:
        """Whether late subscribers get the last message."""
        return self.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL


@dataclass(frozen=True, eq=False, kw_only=True)
class Cloud(Topic, Generic[Record]):
    """A topic whose messages are clouds, and how their rows are written and read.

    fields: groups of names with their kind, in order; every field stands at a multiple of its
    size, and a row at a multiple of 8 bytes. RViz draws x y z only as float32; whatever is measured
    is float64. make_rows: fills rows from the result of the effect (of ``collisions``, from the
    report). record: makes a named row, of the names of its two objects and the ``values``:
    a field, or a vector of several, each. of_points: whether the stamp is that of the points.
    meanings: of the fields that not all clouds have, for docs/topics.md.
    """

    message: type = PointCloud2
    fields: tuple[tuple[str, Fields], ...]
    make_rows: Callable[[Any, CheckedState, np.dtype[Any]], StructuredRows]
    record: Callable[..., Record]
    values: tuple[str | Fields, ...]
    of_points: bool = False
    meanings: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """The layout of a row."""
        return np.dtype([(name, kind) for kind, names in self.fields for name in names], align=True)

    @cached_property
    def field_bytes(self) -> bytes:
        """The fields of all messages that the node publishes, serialised."""
        return field_bytes(self.dtype)

    def to_ros(self, rows: StructuredRows, header: Header | None = None) -> PointCloud2:
        """Return the message of (n,) rows of ``dtype``."""
        return cloud_to_ros(rows, header)

    def from_ros(self, message: PointCloud2) -> StructuredRows:
        """Return a message as (n,) structured array, by field name: ``rows["depth"]``.

        Raises RefusedError ("field layout") where a field is missing: a message of another topic.
        """
        names = self.dtype.names or ()
        rows = cloud_from_ros(message, names)
        present = rows.dtype.names or ()
        for name in names:
            if name not in present and name not in OPTIONAL_FIELDS:
                raise RefusedError("field layout", f"no field {name!r}: not a {self.name} message")
        return rows

    def named(self, message: PointCloud2, namespaces: Namespaces) -> list[Record]:
        """Return the rows of a message with the names of their objects, in the message's order.

        namespaces: the latest message of the topic ``namespaces``, a dict of names by number, or
        just a list of the names. Raises RefusedError: "field layout" for a message of another
        topic, "unknown namespace" where the table is older than the message: it is published
        first, but topics may overtake each other.
        """
        return self.name_rows(self.from_ros(message), namespaces)

    def name_rows(self, rows: StructuredRows, namespaces: Namespaces) -> list[Record]:
        """Return rows as records with the names of their objects."""
        ends = _POINTS_ENDS if "ns" in (self.dtype.names or ()) else _PAIR_ENDS
        names = [_names(rows, *end, namespaces) for end in ends]
        groups = [rows[group if isinstance(group, str) else [*group]] for group in self.values]
        columns = [group.tolist() for group in groups]
        return [self.record(*row) for row in zip(*names, *columns, strict=True)]


_PAIR_ENDS = (("ns_a", "id_a"), ("ns_b", "id_b"))
_POINTS_ENDS = (("ns", "id"), ("cloud_ns", "cloud_id"))


def _names(rows: npt.NDArray[Any], ns: str, number: str, namespaces: Namespaces) -> list[str]:
    table = namespace_table(namespaces)
    if ns in OPTIONAL_FIELDS:
        if ns not in (rows.dtype.names or ()):
            return [""] * len(rows)
        table = {**{index: stand_in(index) for index in rows[ns].tolist()}, **table}
    try:
        return [name_from_key((table[index], key)) for index, key in rows[[ns, number]].tolist()]
    except KeyError as error:
        raise RefusedError("unknown namespace", "take a newer message of 'namespaces'") from error

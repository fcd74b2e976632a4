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

"""Rows of ``collisions`` in words, for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

from obb_collision.accuracy import ALL_LEVELS
from obb_collision.node.messages.conversions import name_from_key
from obb_collision.queries.verdict.verdict import Verdict


def text_from_rows(
    rows: npt.NDArray[Any],
    namespaces: Mapping[int, str],
    header: Header,
    limit: int,
    total: int,
    truncated: bool,
) -> DiagnosticArray:
    """Return a status with the total, then one per pair, at most ``limit``.

    total: how many pairs collide; at least, if pairs are left out of the rows.
    """
    message_total = f"{'at least ' if truncated else ''}{total} pairs in collision"
    if total > limit:
        message_total += f", the first {min(limit, len(rows))} named"
    values = [KeyValue(key="pairs", value=str(len(rows)))]
    if truncated:
        values.append(KeyValue(key="pairs at least", value=str(total)))
    message = DiagnosticArray(header=header)
    message.status = [DiagnosticStatus(name="collisions", message=message_total, values=values)]
    for row in rows[:limit]:
        a = name_from_key((namespaces[int(row["ns_a"])], int(row["id_a"])))
        b = name_from_key((namespaces[int(row["ns_b"])], int(row["id_b"])))
        touching = row["verdict"] == Verdict.TOUCHING
        values = [
            ("a", a),
            ("b", b),
            ("depth", repr(float(row["depth"]))),
            ("normal", " ".join(f"{row['normal_' + axis]:.4f}" for axis in "xyz")),
            ("verdict", Verdict(row["verdict"]).name.lower()),
            ("accuracy", ALL_LEVELS[row["accuracy"]]),
        ]
        message.status.append(
            DiagnosticStatus(
                level=DiagnosticStatus.WARN,
                name=f"{a} - {b}",
                message=_told(row["depth"], touching),
                values=[KeyValue(key=key, value=value) for key, value in values],
            )
        )
    return message


def _told(depth: float, touching: bool) -> str:
    if touching:
        return "touching"
    return "overlapping" if np.isnan(depth) else f"{depth:.6f} m deep"

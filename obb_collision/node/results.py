"""A report of the scene -> rows of ``collisions`` and their text for people."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

from obb_collision.node.clouds import COLLISION_DTYPE
from obb_collision.node.conversions import name_from_key
from obb_collision.node.object_table import ObjectTable
from obb_collision.queries.separation import Verdict
from obb_collision.scene.report import Report


def collision_rows(report: Report, table: ObjectTable) -> npt.NDArray[Any]:
    """(m,) rows of COLLISION_DTYPE, sorted by (ns_a, id_a, ns_b, id_b), a before b."""
    rows = np.zeros(len(report), COLLISION_DTYPE)
    a, b = report.pairs.T
    keys_a, keys_b = table.order_keys(a), table.order_keys(b)
    swapped = keys_a > keys_b
    a, b = np.where(swapped, b, a), np.where(swapped, a, b)
    order = np.lexsort((np.maximum(keys_a, keys_b), np.minimum(keys_a, keys_b)))
    a, b = a[order], b[order]
    sign = np.where(swapped, -1.0, 1.0)
    with np.errstate(over="ignore"):  # x y z are float32, for RViz
        for column, name in enumerate("xyz"):
            rows[name] = report.points[order, column]
            rows[f"normal_{name}"] = (report.normals[:, column] * sign)[order]
    rows["depth"] = report.depths[order]
    rows["ns_a"], rows["id_a"] = table.ns[a], table.id[a]
    rows["ns_b"], rows["id_b"] = table.ns[b], table.id[b]
    rows["verdict"] = report.verdicts[order]
    return rows


def text_from_rows(
    rows: npt.NDArray[Any], namespaces: list[str], header: Header, limit: int
) -> DiagnosticArray:
    """Say the same for people: a status with the total, then one a pair, at most ``limit``."""
    total = f"{len(rows)} pairs in collision"
    if len(rows) > limit:
        total += f", the first {limit} named"
    values = [KeyValue(key="pairs", value=str(len(rows)))]
    message = DiagnosticArray(header=header)
    message.status = [DiagnosticStatus(name="collisions", message=total, values=values)]
    for row in rows[:limit]:
        a = name_from_key((namespaces[row["ns_a"]], int(row["id_a"])))
        b = name_from_key((namespaces[row["ns_b"]], int(row["id_b"])))
        touching = row["verdict"] == Verdict.TOUCHING
        normal = " ".join(f"{row['normal_' + axis]:.4f}" for axis in "xyz")
        message.status.append(
            DiagnosticStatus(
                level=DiagnosticStatus.WARN,
                name=f"{a} - {b}",
                message="touching" if touching else f"{row['depth']:.6f} m deep",
                values=[
                    KeyValue(key="a", value=a),
                    KeyValue(key="b", value=b),
                    KeyValue(key="depth", value=repr(float(row["depth"]))),
                    KeyValue(key="normal", value=normal),
                    KeyValue(key="verdict", value=Verdict(row["verdict"]).name.lower()),
                ],
            )
        )
    return message

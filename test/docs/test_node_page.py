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

"""docs/node.md is what the node is: its topics, fields, readers, services and parameters."""

from __future__ import annotations

import re

import numpy as np
import pytest
from pages import ROOT, table_rows

pytest.importorskip("rclpy")
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from obb_collision.node.diagnostics.answer import CODES
from obb_collision.node.inputs.detections import DETECTIONS, QUEUE
from obb_collision.node.inputs.subscriptions import INPUTS, Input
from obb_collision.node.parameters.parameters import SPECS
from obb_collision.node.robots.robots import KINDS, OUTPUTS
from obb_collision.node.topics import topics as records
from obb_collision.node.topics.cloud import Cloud
from obb_collision.node.topics.topics import NAMESPACES, TOPICS

NODE = ROOT / "docs" / "node.md"
RELIABILITY = {ReliabilityPolicy.RELIABLE: "reliable", ReliabilityPolicy.BEST_EFFORT: "best effort"}


def type_name(message: type) -> str:
    return f"`{message.__module__.split('.')[0]}/{message.__name__}`"


def qos_text(qos: QoSProfile) -> str:
    """Return a QoS in the words of the page."""
    words = [RELIABILITY[qos.reliability]]
    latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    words.append("latched" if latched else str(qos.depth))
    if qos.deadline != Duration():
        words.append(f"deadline {qos.deadline.nanoseconds / 1e9:g} s")
    return ", ".join(words)


def test_the_topics_in_are_those_of_the_node() -> None:
    seen = type("Detection3DArray", (), {"__module__": "vision_msgs"})  # it need not be there
    detections = {DETECTIONS.topic: Input(seen, *QUEUE)}
    rows = [row[:3] for row in table_rows(NODE, "## Topics in")]
    assert rows == [
        [f"`{name}`", type_name(topic.kind), f"{RELIABILITY[topic.reliability]}, {topic.depth}"]
        for name, topic in (INPUTS | detections).items()
    ] + [["`/tf`, `/tf_static`", "`tf2_msgs/TFMessage`", "reliable, 100"]]


def test_the_topics_of_a_robot_are_those_of_the_node() -> None:
    text = NODE.read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `arm/(\w+)` \| `\w+/\w+` \| ([^|]+) \|", text, re.M))
    given = {
        name: QoSProfile(
            depth=topic.depth, reliability=topic.reliability, durability=topic.durability
        )
        for name, topic in KINDS.items()
    }
    given |= {name: qos for name, (_, qos) in OUTPUTS.items()}
    assert rows == {name: qos_text(qos) for name, qos in given.items()}


def test_the_topics_out_are_those_of_the_table() -> None:
    rows = sorted(row[:3] for row in table_rows(NODE, "## Topics out"))
    topics = (*TOPICS.values(), NAMESPACES)
    assert rows == sorted([f"`{t.name}`", type_name(t.message), qos_text(t.qos)] for t in topics)


def page_fields() -> dict[str, dict[str, str]]:
    """Return the type of each field on the page by cloud, without those that all have."""
    fields: dict[str, dict[str, str]] = {"collisions": {}}
    for names, kind, *_ in table_rows(NODE, "### Fields of the clouds"):
        fields["collisions"] |= dict.fromkeys(names.strip("`").split(), kind)
    topic = ""
    text = NODE.read_text(encoding="utf-8")
    start = text.index("| topic | bytes | field |")
    for line in text[start:].splitlines()[2:]:
        if not line.startswith("|"):
            break
        name, size, names, kind = (cell.strip().strip("`") for cell in line.split("|")[1:5])
        if name:
            topic = name
            fields[topic] = {"bytes": size}
        fields[topic] |= dict.fromkeys(names.split(), kind)
    return fields


def test_the_fields_of_the_clouds_are_those_of_the_table() -> None:
    found = page_fields()
    found["collisions"]["bytes"] = "72"
    assert "A row of\n`collisions` is 72 bytes" in NODE.read_text(encoding="utf-8")
    shared = {name: found["collisions"][name] for name in ("x", "y", "z")}
    pairs = {
        name: found["collisions"][name]
        for name in ("normal_x", "normal_y", "normal_z", "ns_a", "id_a", "ns_b", "id_b")
    }
    clouds = {t.name: t.dtype for t in TOPICS.values() if isinstance(t, Cloud)}
    assert set(found) == set(clouds)
    for name, dtype in clouds.items():
        expected = {field: str(np.dtype(dtype[field])) for field in dtype.names or ()}
        common = shared if name == "points_inside" else shared | pairs
        assert found[name] | common == expected | {"bytes": str(dtype.itemsize)}


def test_the_named_rows_are_those_of_the_readers() -> None:
    rows = {
        "named_pairs": records.NamedPair._fields,
        "named_contacts": records.NamedContact._fields,
        "named_clearances": records.NamedClearance._fields,
        "named_events": records.NamedEvent._fields,
        "named_predictions": records.NamedPrediction._fields,
        "named_points_inside": records.NamedPoints._fields,
    }
    found = {row[0].strip("`"): row[2] for row in table_rows(NODE, "### Rows with names")}
    assert set(found) == {*rows, "named_passed_collisions"}
    for name, fields in rows.items():
        assert tuple(re.findall(r"`(\w+)`", found[name])) == fields


def test_the_codes_of_what_is_missing_are_those_of_the_status() -> None:
    rows = table_rows(NODE, "## What is not known")
    assert [code for row in rows for code in re.findall(r"`(\w+)`", row[0])] == list(CODES)


def test_the_parameters_are_those_of_the_node() -> None:
    expected = []
    for spec in SPECS:
        allowed = ", ".join(f"`{choice}`" for choice in spec.choices)
        if spec.limits is not None:
            allowed = f"{spec.limits[0]:g} to {spec.limits[1]:g}"
        expected.append([f"`{spec.name}`", f"`{spec.default}`", allowed, spec.description])
    assert table_rows(NODE, "## Parameters") == expected


def test_the_recording_leaves_out_what_is_computed_for_subscribers() -> None:
    (pattern,) = re.findall(r"--exclude-regex '(.*)'", NODE.read_text(encoding="utf-8"))
    names = {key: "/cell/" + t.name.replace("~", "obb_collision") for key, t in TOPICS.items()}
    left_out = {key for key, name in names.items() if re.search(pattern, name)}
    assert left_out == {"text", "contacts", "clearance", "sweep", "points", "markers"}

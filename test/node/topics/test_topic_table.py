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

"""The table of topics is the one place: the documentation agrees with it."""

import re
from itertools import takewhile
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from each import each

from obb_collision.node.topics.cloud import Cloud, Topic
from obb_collision.node.topics.topics import NAMESPACES, TOPICS
from obb_collision.scene.effects import EFFECTS

ROOT = Path(__file__).parents[3]
TEXT = "\n".join(page.read_text() for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")))
KINDS = {"<f4": "float32", "<f8": "float64", "<i4": "int32", "u1": "uint8"}


def cells(line: str) -> list[str]:
    """Return the cells of a row of a table."""
    return [cell.strip() for cell in line.strip("|").split("|")]


def layout_rows(topic: str) -> list[list[str]]:
    """Return the row with the size of a topic's rows, and those after it without a topic."""
    lines = iter(TEXT.splitlines())
    first = next(cells(line) for line in lines if re.match(rf"\| `{topic}` \| \d+ \|", line))
    return [first, *takewhile(lambda row: row[:2] == ["", ""], map(cells, lines))]


@each("topic", [*TOPICS.values(), NAMESPACES])
def test_the_documentation_has_type_and_qos_of_each_topic(topic: Topic) -> None:
    kind = f"`{topic.message.__module__.split('.')[0]}/{topic.message.__name__}`"
    lines = (ROOT / "docs" / "node.md").read_text().splitlines()
    rows = [cells(line) for line in lines if line.startswith(f"| `{topic.name}` | {kind}")]
    ((_, _, qos, _),) = rows
    assert ("latched" in qos) == topic.is_latched
    assert topic.is_latched or str(topic.qos.depth) in qos


@each("name", sorted(EFFECTS.keys() & TOPICS.keys()))
def test_the_documentation_has_the_fields_of_the_cloud_of_each_effect(name: str) -> None:
    cloud = TOPICS[name]
    assert isinstance(cloud, Cloud)
    rows = layout_rows(cloud.name)
    assert rows[0][1] == str(cloud.dtype.itemsize)
    found = {field: row[3] for row in rows for field in row[2].strip("`").split()}
    kinds = {field: KINDS[kind] for kind, fields in cloud.fields for field in fields}
    common = {*"xyz", "normal_x", "normal_y", "normal_z", "ns_a", "id_a", "ns_b", "id_b"}
    assert found == {field: kind for field, kind in kinds.items() if field not in common}

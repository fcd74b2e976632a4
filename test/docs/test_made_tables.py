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

"""The pages that look up have the tables that the code gives; a recording leaves out effects."""

from __future__ import annotations

import re
import sys

import pytest
from pages import ROOT

pytest.importorskip("rclpy")
sys.path.append(str(ROOT / "docs"))
import make_tables  # type: ignore[import-not-found]

from obb_collision.node.topics.topics import TOPICS


def test_the_tables_are_up_to_date() -> None:
    found = make_tables.tables()
    marks: list[str] = []
    for name in make_tables.PAGES:
        text = (ROOT / "docs" / name).read_text(encoding="utf-8")
        marks += re.findall(r"<!-- table: (.*) -->", text)
        assert make_tables.with_tables(text, found) == text, "python docs/make_tables.py"
    assert sorted(marks) == sorted(found)
    assert make_tables.PARAMETER_FILE.read_text(encoding="utf-8") == make_tables.parameter_file()


def test_the_recording_leaves_out_what_is_computed_for_subscribers() -> None:
    text = (ROOT / "docs" / "node.md").read_text(encoding="utf-8")
    (pattern,) = re.findall(r"--exclude-regex '(.*)'", text)
    names = {key: "/cell/" + t.name.replace("~", "obb_collision") for key, t in TOPICS.items()}
    left_out = {key for key, name in names.items() if re.search(pattern, name)}
    assert left_out == {"text", "contacts", "clearance", "sweep", "points", "markers"}

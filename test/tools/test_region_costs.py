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

"""The measurement of regions runs, and its figures are of what it says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from tools.regions import far_costs, main


def test_what_is_near_is_a_part_and_nothing_is_near_to_what_is_far() -> None:
    costs = far_costs(400, seed=1, repeats=2)
    near = [costs[name]["near"] for name in ("1 of 1", "1 of 2", "1 of 4", "far")]
    assert near[0] == 400
    assert near == sorted(near, reverse=True)
    assert 200 < near[1] < 400
    assert near[3] == 0


@pytest.mark.slow  # test_regions_node.py shows that two regions find what one does
def test_two_processes_answer_for_what_one_does(tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    few = ["--objects", "200", "--processes", "2", "--seconds", "0.1"]
    assert main([*few, "--json", str(file)]) == 0
    one, two = json.loads(file.read_text())["processes"]
    assert (one["processes"], two["processes"]) == (1, 2)
    for row in (one, two):
        assert row["pairs"] > 20
        assert row["samples"] >= 1
        assert row["CPU per state, all (ms)"] >= row["CPU per state, busiest process (ms)"]

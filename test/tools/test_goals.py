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

"""Goals: on next to nothing, and what is met is told from what is not."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tools import goals


def test_goals_are_measured_and_one_that_fails_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(goals, "SIZES", (10, 20))
    monkeypatch.setattr(goals, "LARGE", (20, 30, 40))
    monkeypatch.setattr(goals, "FORMS", ["uniform", "line"])
    monkeypatch.setattr(goals, "SHORT_TURNS", 3)
    monkeypatch.setattr(goals, "BOXES_TURNS", 3)
    monkeypatch.setattr(goals, "FORM_BOXES", 30)
    for part in ("node", "starts", "per_pair"):
        monkeypatch.setattr(goals.Goals, part, failing)
    files = [tmp_path / "goals.json", tmp_path / "page.md"]
    arguments = ["--seconds", "0.001", "--json", str(files[0])]
    assert goals.main([*arguments, "--markdown", str(files[1])]) == 0
    text = capsys.readouterr()
    found = json.loads(files[0].read_text())["goals"]
    assert len(found) == 6 + 2 + 4 + 1 + 3 + 3
    for goal in found:
        failed = "no such thing" in goal["measured"]
        absent = "not installed" in goal["measured"]
        assert (goal["met"] is None) == (failed or absent), goal
    assert sum("no such thing" in goal["measured"] for goal in found) == 3
    assert "10 boxes: move_indices, check, pairs read" in text.out
    assert "| find_pairs, 20 boxes |" in files[1].read_text()


def failing(self: object) -> Iterator[goals.Goal]:
    raise RuntimeError("no such thing")


def test_a_goal_is_met_by_what_was_measured() -> None:
    assert goals.ratio("x", "y", 4.0, 1.0, 4.0, "ms").met is True
    assert goals.ratio("x", "y", 4.0, 1.0, 3.9, "ms").met is False
    assert goals.below("x", 20.0, 19.9, "µs").met is True
    assert goals.below("x", 20.0, 20.0, "µs").met is False


def test_a_goal_of_the_node_needs_an_answer_to_every_frame() -> None:
    rows = [
        {"way": way, "objects": objects, "median": 0.5, "95 %": 0.6, "99 %": 5.0, "longest": 9.0}
        for way, objects, *_ in goals.NODE
    ]
    assert [goal.met for goal in goals.node_goals(rows)] == [False, *[True] * 5]
    rows[0]["99 %"] = 2.0
    del rows[3]["median"]
    assert [goal.met for goal in goals.node_goals(rows)] == [True] * 3 + [False] + [True] * 2
    table = goals.node_table(rows)
    assert table[1] == ["object_poses", "1,000", "0.500", "0.600", "2.00", "9.00"]
    assert table[4][2] == "no answer"


def test_the_node_is_measured_in_all_ways_that_have_a_goal() -> None:
    pytest.importorskip("rclpy")
    from tools import latency

    for way, objects, *_ in goals.NODE:
        assert way in latency.WAYS
        assert objects in (*latency.SIZES, latency.OTHERS)

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

"""The soak itself, short: a node in another process, and every answer checked."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
import rig  # noqa: F401 - of this machine only

from tools.soak import __main__ as command


@pytest.mark.slow  # .ci/full runs a long one
def test_a_short_soak_holds(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "result.json"
    arguments = ["--seconds", "1000", "--steps", "60", "--seed", "2", "--json", str(file)]
    # what caches fill in the first seconds is no growth
    code = command.main([*arguments, "--objects", "40", "--growth", "100"])
    output = capfd.readouterr().out
    assert code == 0, output
    assert output.endswith("everything held\n")
    result = json.loads(file.read_text())
    assert result["steps"] == 60
    assert result["checked"] >= 60
    assert result["wrong"] == result["unsure"] == 0
    assert result["not held"] == []
    assert min(result["sent"].values()) > 5
    assert min(result["bodies"].values()) > 5
    assert result["latency (ms)"]["99 %"] > 0.0


@pytest.mark.slow  # test_checker.py finds them without a node
def test_objects_that_are_missing_are_found(capfd: pytest.CaptureFixture[str]) -> None:
    # whatever has moved is in no pair by the next check, however soon that is
    wrong = ["-p", "object_timeout:=0.000001", "-p", "stale_policy:=ignore"]
    code = command.main(["--seconds", "60", "--objects", "30", "--", *wrong])
    output = capfd.readouterr().out
    assert code == 1
    assert '"missing"' in output
    assert "python -m tools.soak --seed 1 --steps" in output
    assert "\nNOT held: " in output
    assert "wrong answers" in output


def test_a_node_that_ends_is_found(capfd: pytest.CaptureFixture[str]) -> None:
    assert command.main(["--", "--no-such-argument"]) == 1
    assert "NOT held: the node ended with" in capfd.readouterr().out

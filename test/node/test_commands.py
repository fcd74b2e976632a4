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

"""Console scripts that can't start say why in a line."""

import pytest

pytest.importorskip("rclpy")

from obb_collision.node import commands, environment


@pytest.mark.parametrize("command", [commands.node, commands.latency])
def test_without_ros_they_say_what_is_missing(
    command: object, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(environment, "find_spec", lambda name: None)
    assert callable(command)
    assert command([]) == 1
    assert "needs rclpy" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("parameter", "reason"),
    [
        ("rate:=-1.0", "rate out of range"),
        ("rate:=5", "expecting type 'DOUBLE'"),
        ("trigger:=never", "trigger must be one of timer, arrival, not 'never'"),
        ("fixed_frame:=''", "fixed_frame must not be empty"),
    ],
)
def test_parameters_that_cannot_be_used_end_the_node_with_the_reason(
    parameter: str, reason: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert commands.node(["--ros-args", "-p", parameter]) == 1
    assert reason in capfd.readouterr().err

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

"""The attack itself, short: a node in another process, hostile messages, probes in between.

How long it may be blocked is measured by the command, on a machine that has nothing else to do.
"""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")
import rig  # noqa: F401 - of this machine only

from obb_collision.checks.fuzz import command


def test_a_short_attack_finds_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ["--messages", "600", "--seed", "4", "--bound", "20"]
    code = command.main(arguments)
    output = capfd.readouterr().out
    assert code == 0, output
    assert "probes answered right: 6\n" in output
    assert output.endswith("nothing found\n")


def test_a_node_that_ends_is_found(capfd: pytest.CaptureFixture[str]) -> None:
    assert command.main(["--messages", "100", "--", "--no-such-argument"]) == 1
    assert "FOUND after 0 messages" in capfd.readouterr().out

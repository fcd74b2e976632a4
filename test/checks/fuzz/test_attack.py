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

from obb_collision.checks.fuzz import attack, command
from obb_collision.checks.fuzz.session import probes


def run(*arguments: str) -> int:
    return command.main([*arguments, "--bound", "20", "--seed", "4"])


@pytest.mark.parametrize("share", [0.25, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_short_attack_finds_nothing(capfd: pytest.CaptureFixture[str], share: float) -> None:
    messages, raw, scenes, robots = (int(share * count) for count in (600, 400, 40, 1000))
    sizes = {"--messages": messages, "--raw": raw, "--scenes": scenes, "--robots": robots}
    code = run(*(word for name, size in sizes.items() for word in (name, str(size))))
    output = capfd.readouterr().out
    assert code == 0, output
    assert f"scene files: {scenes} read" in output
    assert f"robot files: {robots} read" in output
    assert int(output.split("sent: ")[1].split()[0]) >= messages + raw
    assert "detections " in output
    assert "bot/joint_states " in output  # a small share without being asked for
    assert output.endswith("nothing found\n")


def test_an_attack_on_a_robot_finds_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    files = ("--scenes", "0", "--robots", "0")
    assert run("--messages", "300", "--raw", "100", "--robot-share", "0.5", *files) == 0
    output = capfd.readouterr().out
    assert "bot/joint_states" in output
    assert "bot/trajectory_in" in output
    assert "states of a robot " in output


def test_a_part_of_an_attack_is_run_again(capfd: pytest.CaptureFixture[str]) -> None:
    assert run("--only", "raw:17") == 0
    output = capfd.readouterr().out
    assert "sent: 1 (" in output
    assert "probes answered right: 1 (" in output


def test_processes_share_an_attack(capfd: pytest.CaptureFixture[str]) -> None:
    share = ("--processes", "2", "--robot-share", "0", "--robots", "0")
    assert run("--messages", "200", "--raw", "0", "--scenes", "0", *share) == 0
    output = capfd.readouterr().out
    assert "probes answered right: 3 (" in output  # the cases come to both nodes first
    assert output.count("memory of the node: ") == 2


@pytest.mark.parametrize("part", [("message", 0, 1_000_000), ("raw", 17, 1018), ("raw", 5, 6)])
def test_shares_are_all_of_a_part_in_whole_batches(part: attack.Part) -> None:
    what, first, last = part
    shares = [attack.share(part, index, 3) for index in range(3)]
    assert [number for _, *ends in shares for number in range(*ends)] == list(range(first, last))
    assert {name for name, _, _ in shares} == {what}
    assert all((start - first) % attack.BATCH == 0 or start == last for _, start, _ in shares)


def test_what_is_no_part_of_an_attack_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for text in ("raw:17-3", "raw", "5", "other:5"):
        with pytest.raises(SystemExit):
            run("--only", text)
        assert "must be like raw:17 or message:0-99" in capsys.readouterr().err


def test_a_node_that_ends_is_found(capfd: pytest.CaptureFixture[str]) -> None:
    code = command.main(
        ["--messages", "100", "--scenes", "0", "--robots", "0", "--", "--no-such-argument"]
    )
    assert code == 1
    assert "FOUND: the node ended" in capfd.readouterr().out


def test_a_wrong_answer_is_found_with_what_reproduces_it(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probes, "right_pairs", lambda poses, sizes: set())
    assert run("--only", "message:100-299") == 1
    output = capfd.readouterr().out
    assert "FOUND: pairs of probe 0" in output
    assert "again: obb_collision_fuzz --seed 4 --only message:100-199" in output

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

import re

import pytest

pytest.importorskip("rclpy")
import rig  # noqa: F401 - of this machine only

from tools.fuzz import __main__ as command
from tools.fuzz import attack
from tools.fuzz.session import probes


def run(*arguments: str) -> int:
    return command.main([*arguments, "--bound", "20", "--seed", "4"])


def numbers_after(words: str, output: str) -> list[int]:
    """Return the whole numbers that follow some words."""
    return [int(number) for number in re.findall(rf"{words}(\d+)", output)]


@pytest.mark.slow  # a part of an attack is run below, and a long one by .ci/full
@pytest.mark.parametrize(
    ("share", "more"),
    [
        (0.25, ("--robot-share", "0.5", "--processes", "2")),
        pytest.param(1.0, (), marks=pytest.mark.slow),  # a small share is of the robot all the same
    ],
)
def test_a_short_attack_finds_nothing(
    capfd: pytest.CaptureFixture[str], share: float, more: tuple[str, ...]
) -> None:
    messages, raw, scenes, robots = (int(share * count) for count in (1200, 400, 40, 400))
    sizes = {"--messages": messages, "--raw": raw, "--scenes": scenes, "--robots": robots}
    code = run(*(word for name, size in sizes.items() for word in (name, str(size))), *more)
    output = capfd.readouterr().out
    assert code == 0, output
    assert sum(numbers_after("scene files: ", output)) == scenes
    assert sum(numbers_after("robot files: ", output)) == robots
    assert numbers_after("sent: ", output)[0] >= messages + raw
    assert output.count("memory of the node: ") == (2 if more else 1)
    assert "detections " in output
    assert "bot/joint_states" in output
    assert "bot/trajectory_in" in output or not more
    assert "states of a robot " in output or not more
    assert output.endswith("nothing found\n")


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


def test_a_part_is_run_again_and_a_wrong_answer_is_found_with_what_reproduces_it(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    right = [probes.right_pairs]  # of the first probe
    monkeypatch.setattr(
        probes, "right_pairs", lambda *boxes: right.pop()(*boxes) if right else set()
    )
    monkeypatch.setattr(attack, "BATCH", 2)
    assert run("--only", "raw:17-21") == 1
    output = capfd.readouterr().out
    assert "sent: 4 (" in output
    assert "probes answered right: 2 (" in output  # by boxes, and the points in them
    assert "FOUND: pairs of probe 2" in output
    assert "again: python -m tools.fuzz --seed 4 --only raw:19-20" in output

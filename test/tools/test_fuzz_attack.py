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

import os
import re
import signal
import time
from pathlib import Path
from random import Random

import numpy as np
import pytest

pytest.importorskip("rclpy")
import rig  # noqa: F401 - of this machine only

from obb_collision.node import namespace_number
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.inputs import Inputs
from obb_collision.node.inputs.subscriptions import INPUTS
from obb_collision.node.objects import Objects
from obb_collision.node.objects.frames import FixedFrameOnly
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.topics.topics import COLLISIONS
from tools.fuzz import __main__ as command
from tools.fuzz import attack, files, probes
from tools.fuzz.client import Answer, FoundError
from tools.fuzz.messages import Messages
from tools.fuzz.probes import BOXES, SETS, Pair
from tools.fuzz.process import FEWEST, Canary, Child, Usage, Usages
from tools.fuzz.session import Result, faults, find_answer


def run(*arguments: str) -> int:
    return command.main([*arguments, "--bound", "20", "--seed", "4"])


def numbers_after(words: str, output: str) -> list[int]:
    """Return the whole numbers that follow some words."""
    return [int(number) for number in re.findall(rf"{words}(\d+)", output)]


@pytest.mark.slow  # a part of an attack is run below, and a long one by .ci/full
def test_a_short_attack_finds_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    messages, raw, scenes, robots = 300, 100, 10, 100
    sizes: dict[str, float] = {
        "--messages": messages,
        "--raw": raw,
        "--scenes": scenes,
        "--robots": robots,
    }
    sizes |= {"--robot-share": 0.5, "--processes": 2}
    code = run(*(word for name, size in sizes.items() for word in (name, str(size))))
    output = capfd.readouterr().out
    assert code == 0, output
    assert sum(numbers_after("scene files: ", output)) == scenes
    assert sum(numbers_after("robot files: ", output)) == robots
    assert numbers_after("sent: ", output)[0] >= messages + raw
    assert output.count("memory of the node: ") == 2
    assert "detections " in output
    assert "bot/joint_states" in output
    assert "bot/trajectory_in" in output
    assert "states of a robot " in output
    assert output.endswith("nothing found\n")


def test_shares_are_all_of_a_part_in_whole_batches() -> None:
    for part in (("message", 0, 1_000_000), ("raw", 17, 1018), ("raw", 5, 6)):
        what, first, last = part
        shares = [attack.share(part, index, 3) for index in range(3)]
        numbers = [number for _, *ends in shares for number in range(*ends)]
        assert numbers == list(range(first, last))
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


def test_an_interrupt_is_no_finding(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(attack.Attack, "run", interrupted)
    assert run() == 130
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err == "python -m tools.fuzz: interrupted\n"


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


GOOD = tuple("\n".join(text.splitlines()).encode() for text in (files.urdf(), files.SRDF))


def test_scenes_are_good_before_they_are_changed(tmp_path: Path) -> None:
    files.place_files(tmp_path)
    path = tmp_path / "scene.yaml"
    for text in files.texts():
        path.write_text(text)
        assert files.read(path) == ""
    assert files.mutated_scene(1, 5) == files.mutated_scene(1, 5)
    assert len({files.mutated_scene(1, number) for number in range(50)}) > 30


def test_a_process_reads_them_all(tmp_path: Path) -> None:
    refused, longest = attack.attack_reader("scene", tmp_path, 1, 10, 40)
    assert 10 < refused < 30
    assert longest < attack.READING
    refused, longest = attack.attack_reader("robot", tmp_path, 1, 10, 40)
    assert 5 < refused < 30


def test_robots_are_good_before_they_are_changed(tmp_path: Path) -> None:
    numbers = [number for number in range(200) if files.mutated_robot(1, number) == GOOD]
    assert len(numbers) > 5
    for number in numbers:
        assert files.read_robot(tmp_path, 1, number) == ""
    assert files.mutated_robot(1, 3) == files.mutated_robot(1, 3)
    assert len({files.mutated_robot(1, number) for number in range(50)}) > 30


def test_mutated_robots_are_read_or_refused_with_the_place(tmp_path: Path) -> None:
    outcomes = [files.read_robot(tmp_path, 2, number) for number in range(300)]
    assert 30 < sum(not reason for reason in outcomes) < 200
    for reason in filter(None, outcomes):
        assert re.match(r"RobotError: .*bot\.[us]rdf(:\d+)?: ", reason), reason
        assert len(reason) < 1000


def test_a_reader_that_ends_or_takes_long_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(FoundError, match="scene:0 ended its reader"):
        attack.attack_reader("scene", tmp_path / "none", 1, 0, 3)
    monkeypatch.setattr(attack, "READING", 0.0)
    with pytest.raises(FoundError, match=r"scene:\d+ took"):
        attack.attack_reader("scene", tmp_path, 1, 0, 3)


def answered(data: bytes, room: int) -> set[Pair]:
    """Return the pairs that a node with room for so many objects finds in a set of boxes."""
    frames, guard = FixedFrameOnly("map"), Guard(pytest.fail, lambda: True)
    objects = Objects("map", frames, guard)
    objects.shapes.max_objects = room
    monitors = {topic: InputMonitor(topic, lambda text: None) for topic in INPUTS}
    inputs = Inputs(objects, monitors, lambda: 10**18, lambda: False, guard, frames)
    inputs.callbacks()["object_boxes"](data)
    inputs.boxes.apply()
    objects.update(10**18)
    ids = objects.table.id[objects.scene.check().pairs]
    return {(min(pair), max(pair)) for pair in ids.tolist()}


def test_the_sure_pair_of_a_set_is_there_only_once_all_of_it_is(tmp_path: Path) -> None:
    maker = probes.Probes(Messages(Random(1), tmp_path))
    for number in range(20):
        probe = maker.make(number, Random(number), 10**18, everything=True, full=True)
        data = dict(probe.messages)["object_boxes"]
        for room in range(BOXES):  # the objects before are removed by another topic, maybe later
            assert probe.sure not in answered(data, room)
        assert answered(data, BOXES) == probe.pairs


def test_an_answer_with_as_many_pairs_as_there_may_be_is_none() -> None:
    def answer(pairs: list[Pair]) -> Answer:
        rows = np.zeros(len(pairs), COLLISIONS.dtype)
        rows["ns_a"] = rows["ns_b"] = namespace_number(SETS)
        rows["id_a"], rows["id_b"] = np.array(pairs).T
        return Answer(0, 0, COLLISIONS.to_ros(rows))

    few, all_of_them, other = [(6, 7), (7, 9)], [(6, 7), (7, 9), (8, 9)], [(7, 9), (8, 9)]
    answers = [answer(pairs) for pairs in (all_of_them, other, few)]
    assert find_answer(answers, 6, (6, 7), most=4) == set(all_of_them)
    assert find_answer(answers, 6, (6, 7), most=3) == set(few), "the first one may lack pairs"
    assert find_answer(answers, 6, (6, 7), most=2) is None


MEGABYTE = 10**6


def grown(by: Usage, samples: int = 100) -> Usages:
    """Return samples of a process that grows evenly."""
    usages = Usages()
    for number in range(samples):
        usages.add(Usage(*(round(one * number / samples) for one in by)))
    return usages


def test_what_grows_is_found_and_what_warms_up_is_not() -> None:
    result = Result(usages=grown(Usage(100 * MEGABYTE, 0, 0)))
    assert faults(result, 61.0) == []
    assert faults(result, 59.0) == ["its memory grew by 60.0 MB"]
    leaking = faults(Result(usages=grown(Usage(0, 20, 0))), 1.0)
    assert leaking == ["it grew by 12 descriptors, 0 threads"]
    warm = Usages()
    for number in range(100):
        warm.add(Usage(MEGABYTE * min(number, 15), 5, 5))
    assert faults(Result(usages=warm), 1.0) == []


def test_the_course_of_memory_has_a_number_for_each_tenth() -> None:
    assert grown(Usage(100 * MEGABYTE, 0, 0)).course() == [
        (10 * tenth + 4.5) * MEGABYTE for tenth in range(10)
    ]


def test_few_samples_say_nothing() -> None:
    assert grown(Usage(10**9, 9, 9), FEWEST - 1).growth() is None


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="only Linux says it")
def test_a_process_is_measured(tmp_path: Path) -> None:
    child = Child(["-c", "0"], 1, tmp_path / "log", module="pdb")
    try:
        usage, delays = child.usage(), child.delays()
        assert usage is not None
        assert usage.memory > 0
        assert usage.descriptors >= 1
        assert usage.threads == 1
        assert min(delays.values(), default=0.0) >= 0.0
    finally:
        child.end()
    assert child.usage() is None
    assert child.delays() == {}


def long_ones(found: list[tuple[float, float]]) -> list[tuple[float, float]]:
    return [(start, end) for start, end in found if end - start > 0.15]


def test_a_process_that_is_stopped_stood_still() -> None:
    bird, found = Canary(), list[tuple[float, float]]()
    try:
        for _ in range(20):  # it may be stopped before it slept at all: then once more
            os.kill(bird.number, signal.SIGSTOP)
            stopped = time.monotonic()
            while time.monotonic() < stopped + 0.2:
                found += bird.stalls()
            os.kill(bird.number, signal.SIGCONT)
            going = time.monotonic()
            while time.monotonic() < going + 1.0 and not long_ones(found):
                found += bird.stalls()
            if long_ones(found):
                break
        assert long_ones(found)
        assert all(start < end <= time.time() for start, end in found)
    finally:
        bird.close()

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

"""Attacks on a node in another process, short, with their messages; and faults around it."""

from __future__ import annotations

import os
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing, suppress
from multiprocessing import get_context
from pathlib import Path
from random import Random

import numpy as np
import pytest

pytest.importorskip("rclpy")
import rig  # noqa: F401 - of this machine only
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node import namespace_number
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.inputs import Inputs, MessageType, detections_from_bytes
from obb_collision.node.inputs.subscriptions import INPUTS
from obb_collision.node.messages.cdr import cloud_from_bytes, states_from_bytes
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects import Objects
from obb_collision.node.objects.frames import FixedFrameOnly
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.topics.topics import COLLISIONS
from tools.faults import __main__ as faults_command
from tools.faults.__main__ import BY_NAME, FAULTS, Fault, Outcome, attempt
from tools.faults.bench import Bench
from tools.fuzz import __main__ as command
from tools.fuzz import files, probes
from tools.fuzz.cases import CASES, FIXED, MANY, Sent, Stream
from tools.fuzz.client import Answer, FoundError
from tools.fuzz.messages import TYPE, Messages, serialised, written
from tools.fuzz.mutations import mutate
from tools.fuzz.probes import BOXES, SETS, Pair, Probes
from tools.fuzz.process import Canary, Usage, Usages
from tools.fuzz.robot import ROBOT, RobotMessages
from tools.fuzz.session import Result, faults, find_answer


def test_a_part_is_run_again_and_a_wrong_answer_is_found_with_what_reproduces_it(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    right = [probes.right_pairs]  # of the first probe
    answer = lambda *boxes: right.pop()(*boxes) if right else set()  # noqa: E731
    monkeypatch.setattr(probes, "right_pairs", answer)
    monkeypatch.setattr(command, "BATCH", 2)
    assert command.main(["--only", "raw:17-21", "--bound", "20", "--seed", "4"]) == 1
    output = capfd.readouterr().out
    assert "sent: 4 (" in output
    assert "probes answered right: 2 (" in output  # by boxes, and the points in them
    assert "FOUND: pairs of probe 2" in output
    assert "again: python -m tools.fuzz --seed 4 --only raw:19-20" in output


def test_files_are_good_before_they_are_changed(tmp_path: Path) -> None:
    files.place_files(tmp_path)
    path = tmp_path / "scene.yaml"
    for text in files.texts():
        path.write_text(text)
        assert files.read(path) == ""
    good = tuple("\n".join(text.splitlines()).encode() for text in (files.urdf(), files.SRDF))
    numbers = [number for number in range(200) if files.mutated_robot(1, number) == good]
    assert len(numbers) > 5
    for number in numbers:
        assert files.read_robot(tmp_path, 1, number) == ""
    mutate_file: Callable[[int, int], object]
    for mutate_file in (files.mutated_scene, files.mutated_robot):
        assert mutate_file(1, 5) == mutate_file(1, 5)
        assert len({mutate_file(1, number) for number in range(50)}) > 30


def test_slow_and_dead_readers_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "READING", 0.0)
    with pytest.raises(FoundError, match=r"robot:\d+ took"):
        command.attack_reader("robot", tmp_path, 1, 0, 30)
    monkeypatch.setattr(sys, "executable", "false")  # which ends at once
    with pytest.raises(FoundError, match="scene:0 ended its reader"):
        command.attack_reader("scene", tmp_path, 1, 0, 3)


@pytest.mark.filterwarnings("ignore:the SRDF names links")
def test_mutated_robots_are_read_or_refused_with_the_place(tmp_path: Path) -> None:
    outcomes = [files.read_robot(tmp_path, 2, number) for number in range(100)]
    assert 10 < sum(not reason for reason in outcomes) < 70
    for reason in filter(None, outcomes):
        assert re.match(r"RobotError: .*bot\.[us]rdf(:\d+)?: ", reason), reason
        assert len(reason) < 1000


def answered(data: bytes, room: int) -> set[Pair]:
    """Return the pairs that a node with room for so many objects finds in a set of boxes."""
    frames, guard = FixedFrameOnly("map"), Guard(pytest.fail, lambda: True)
    monitors = {topic: InputMonitor(topic, lambda text: None) for topic in INPUTS}
    objects = Objects("map", frames, guard, monitors)
    objects.shapes.max_objects = room
    inputs = Inputs(objects, lambda: 10**18, frames)
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
    assert faults(result, 31.0) == []
    assert faults(result, 29.0) == ["its memory grew by 30.0 MB"]
    leaking = faults(Result(usages=grown(Usage(0, 40, 0))), 1.0)
    assert leaking == ["it grew by 12 descriptors, 0 threads"]
    warm = Usages()
    for number in range(100):
        warm.add(Usage(MEGABYTE * min(number, 40), 5, 5))
    assert faults(Result(usages=warm), 1.0) == []


def test_a_process_that_is_stopped_stood_still() -> None:
    found = list[tuple[float, float]]()

    def is_seen() -> bool:
        return any(end - start > 0.15 for start, end in found)

    with closing(Canary()) as bird:
        tries = 0
        while not is_seen():  # it may be stopped before it slept at all: then once more
            tries += 1
            assert tries <= 20
            for number, seconds in ((signal.SIGSTOP, 0.2), (signal.SIGCONT, 1.0)):
                os.kill(bird.number, number)
                begun = time.monotonic()
                while time.monotonic() < begun + seconds and not is_seen():
                    found += bird.stalls()
        assert all(start < end <= time.time() for start, end in found)


DOMAIN = 1 + os.getpid() % 100


@pytest.mark.slow  # they take minutes together
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_node_does_what_is_expected(fault: Fault) -> None:
    with ProcessPoolExecutor(1, get_context("spawn")) as apart:  # with participants of its own only
        outcome = apart.submit(attempt, fault, DOMAIN).result()
    assert outcome.held, outcome.seen


def test_faults_are_distinct_and_the_page_has_each_and_none_that_failed() -> None:
    assert len(BY_NAME) == len({fault.what for fault in FAULTS}) == len(FAULTS)
    assert all(fault.what.endswith(".") for fault in FAULTS)
    page = Path(__file__).parents[2] / "docs" / "faults.md"
    rows = [line for line in page.read_text(encoding="utf-8").splitlines() if line[:3] == "| `"]
    assert [row.split("`")[1] for row in rows] == list(BY_NAME)
    assert not any("not as expected" in row for row in rows)


def test_rows_of_other_faults_stay_and_failures_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(bench: Bench) -> str:
        raise FoundError("nothing | at all")

    first, second = FAULTS[:2]
    page = tmp_path / "page.md"
    page.write_text("# Title\n\nText.\n<!-- speed: faults -->\n<!-- end -->\n")
    faults_command.write_table(page, [Outcome(second, "seen", held=True, seconds=2.0)])
    monkeypatch.setitem(BY_NAME, first.name, first._replace(make=fails))
    assert faults_command.main(["--only", first.name, "--markdown", str(page)]) == 1
    assert "NOT AS EXPECTED" in capsys.readouterr().out
    lines = page.read_text().splitlines()
    assert lines[:3] == ["# Title", "", "Text."]
    rows = [line for line in lines if line.startswith("| `")]
    assert [row.split("`")[1] for row in rows] == [first.name, second.name]
    assert "**not as expected**: nothing / at all" in rows[0]
    assert rows[1].endswith("| seen |")


@pytest.fixture
def still(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stop the clock: stamps are what differs between two messages of a number."""
    monkeypatch.setattr("time.time_ns", lambda: 1_800_000_000_000_000_000)


def content(sent: Sent, stream: Stream) -> object:
    """Return what is sent, without the bytes between fields: rclpy puts there what it likes."""
    if sent.kind in ("damaged", "raw"):
        return sent.topic, sent.kind, len(sent.data)
    if sent.topic == "detections":
        return sent.topic, sent.kind, sent.data
    return sent.topic, sent.kind, repr(deserialize_message(sent.data, stream.types[sent.topic]))


@pytest.mark.usefixtures("still")
def test_a_message_depends_on_seed_and_number_only(tmp_path: Path) -> None:
    def some(seed: int, numbers: list[int]) -> dict[tuple[str, int], object]:
        stream = Stream(seed, tmp_path)
        found = {("message", number): stream.message(number) for number in numbers}
        found |= {("raw", number): stream.raw(number) for number in numbers}
        return {key: content(sent, stream) for key, sent in found.items()}

    numbers = list(range(100, 160))
    first, again, other = some(3, numbers), some(3, numbers[::-1]), some(4, numbers)
    assert first == again
    assert sum(first[key] == other[key] for key in first) < 10


def test_each_case_comes_once_at_first(tmp_path: Path) -> None:
    stream = Stream(1, tmp_path)
    sent = [stream.message(number) for number in range(len(CASES))]
    assert [one.kind for one in sent] == list(CASES)
    by_kind = {one.kind: one.data for one in sent}
    assert len(states_from_bytes(by_kind["100,000 states"]).poses) == MANY
    for seed in range(2):  # in a known namespace or not, with all poses or not
        _, data = CASES["100,000 different names"](Random(seed), stream.messages)
        states = states_from_bytes(data)
        assert len(set(states.names)) == MANY
        assert states.names[7].endswith("/100007")
        assert len(states.poses) in (MANY, MANY - 1)
    assert cloud_from_bytes(by_kind["100,000 boxes"]).width == MANY
    detections = detections_from_bytes(by_kind["100,000 detections"], MANY)
    assert len(set(detections.ids)) == MANY
    np.testing.assert_array_equal(detections.sizes, np.full((MANY, 3), 0.5))
    assert set(detections.frames) == {"map"}
    with pytest.raises(RefusedError, match="malformed message"):
        detections_from_bytes(by_kind["detections and results claimed"], 2**40)
    assert len(by_kind["texts of 1 MB"]) > 1_000_000
    with pytest.raises(RefusedError, match=r"1000\d\d fields"):
        cloud_from_bytes(by_kind["100,000 fields"])


def test_what_the_middleware_does_not_send_is_not_made(tmp_path: Path) -> None:
    stream = Stream(1, tmp_path)
    sent = [stream.raw(number) for number in range(300)]
    assert all(one.data for one in sent)
    clocks = [one for one in sent if one.topic == "/clock"]
    assert clocks
    assert all(len(one.data) <= FIXED["/clock"] for one in clocks)


def test_probes_have_their_sure_pair_and_hostile_items(tmp_path: Path) -> None:
    probes, kinds, hostile = Probes(Messages(Random(1), tmp_path)), set(), 0
    for number in range(200):
        probe = probes.make(number, Random(number), 10**18, everything=False, full=False)
        assert probe.sure in probe.pairs
        kinds.add(probe.kind)
        for topic, data in (*probe.first, *probe.messages):
            if topic == "objects":
                markers = deserialize_message(data, MarkerArray).markers
                good = [one for one in markers if one.ns == "probe" and one.action == Marker.ADD]
                assert len(good) in (0, BOXES)
                hostile += len(markers) - len(good) - 1
            elif topic == "object_states":
                states = states_from_bytes(data)
                hostile += int(np.sum(~(np.abs(states.poses) <= 1e300).all(axis=1)))
    assert len(kinds) == 6
    assert hostile > 300


def some(folder: Path, seed: int, topic: str, mutations: int) -> Iterator[bytes]:
    random = Random(seed)
    messages = Messages(random, folder)
    for _ in range(50):
        message = messages.makers[topic][1]()
        for _ in range(mutations):
            with suppress(AssertionError):  # what rclpy refuses to set
                mutate(message, random)
        yield serialised(message)


def test_messages_and_their_mutations_can_be_sent_and_read(tmp_path: Path) -> None:
    for topic, (kind, _) in Messages(Random(0), tmp_path).makers.items():
        valid, spoiled = ([*some(tmp_path, 7, topic, mutations)] for mutations in (0, 4))
        for data in valid + spoiled:
            if topic == "detections":
                assert detections_from_bytes(data, 10**5).header is not None
            else:
                assert isinstance(deserialize_message(data, kind), kind)
        assert len(set(valid)) > 25 or topic == "/parameter_events"
        assert len(set(spoiled)) > 25


@pytest.mark.skipif(MessageType is None, reason="vision_msgs is not installed")
def test_vision_msgs_reads_the_same(tmp_path: Path) -> None:
    messages = Messages(Random(1), tmp_path)
    for _ in range(100):
        data = serialised(messages.detections())
        message = deserialize_message(data, TYPE)
        assert written(message) == data
        again = detections_from_bytes(serialize_message(message), 10**5)  # any bytes as padding
        np.testing.assert_equal(tuple(again), tuple(detections_from_bytes(data, 10**5)))


def test_questions_have_states_that_only_the_attached_box_makes_invalid(tmp_path: Path) -> None:
    robot = RobotMessages(Messages(Random(1), tmp_path), tmp_path)
    questions = [robot.question(number, Header()) for number in range(20)]
    possible = np.concatenate([one.possible for one in questions])
    alone = np.concatenate([one.alone for one in questions])
    assert not (possible & ~alone).any()
    assert 50 < np.count_nonzero(possible) < np.count_nonzero(alone) < len(alone) - 50
    again = robot.question(7, Header())
    np.testing.assert_array_equal(again.possible, questions[7].possible)


def test_markers_are_locked_to_links_known_and_unknown(tmp_path: Path) -> None:
    messages, markers = Messages(Random(1), tmp_path), list[Marker]()
    for made in (False, True):
        if made:
            RobotMessages(messages, tmp_path)
        markers = [messages.marker() for _ in range(400)]
        assert any(one.header.frame_id.startswith(ROBOT) for one in markers) == made
    locked = {one.header.frame_id for one in markers if one.frame_locked}
    assert {*messages.links, f"{ROBOT}/l3", f"{ROBOT}/none"} <= locked

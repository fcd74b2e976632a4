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

"""Messages of the attack: valid to begin with, the same for the same seed, and really spoiled."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from random import Random

import numpy as np
import pytest

pytest.importorskip("rclpy")
from geometry_msgs.msg import Vector3
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.inputs import MessageType, detections_from_bytes
from obb_collision.node.messages.cdr import cloud_from_bytes, states_from_bytes
from obb_collision.node.messages.conversions import pose_to_ros, stamp_to_ros
from obb_collision.node.messages.errors import RefusedError
from tools.fuzz.cases import CASES, FIXED, MANY, Sent, Stream
from tools.fuzz.messages import (
    TYPE,
    Box,
    Detection,
    Detections,
    Hypothesis,
    Messages,
    Result,
    serialised,
)
from tools.fuzz.mutations import damaged, hostile_value, mutate, raw
from tools.fuzz.probes import BOXES, Probes, right_pairs
from tools.fuzz.robot import LATCHED, ROBOT, RobotMessages


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
    for seed in range(9):  # in a known namespace or not, with all poses or not
        states = states_from_bytes(
            CASES["100,000 different names"](Random(seed), stream.messages)[1]
        )
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
    sent = [stream.raw(number) for number in range(1000)]
    assert all(one.data for one in sent)
    clocks = [one for one in sent if one.topic == "/clock"]
    assert clocks
    assert all(len(one.data) <= FIXED["/clock"] for one in clocks)


def test_right_pairs_are_those_of_intervals() -> None:
    poses, sizes = np.zeros((3, 7)), np.ones((3, 3))
    poses[:, 6] = 1.0
    poses[:, 0] = [0.0, 1.0, 2.25]  # the first two touch
    assert right_pairs(poses, sizes) == {(0, 1)}
    poses[2, :2] = [0.5, 0.75]  # a corner of it is between them
    poses[2, 3:] = [0.0, 0.0, np.sin(np.pi / 8), np.cos(np.pi / 8)]
    assert right_pairs(poses, sizes) == {(0, 1), (0, 2), (1, 2)}


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


def some(folder: Path, seed: int, topic: str, mutations: int) -> list[bytes]:
    random = Random(seed)
    messages = Messages(random, folder)
    found = []
    for _ in range(100):
        message = messages.makers[topic][1]()
        for _ in range(mutations):
            try:
                mutate(message, random)
            except AssertionError:  # what rclpy refuses to set
                continue
        found.append(serialised(message))
    return found


def test_messages_and_their_mutations_can_be_sent_and_read(tmp_path: Path) -> None:
    for topic, (kind, _) in Messages(Random(0), tmp_path).makers.items():
        valid, spoiled = (some(tmp_path, 7, topic, mutations) for mutations in (0, 4))
        for data in valid + spoiled:
            if topic == "detections":
                assert detections_from_bytes(data, 10**5).header is not None
            else:
                assert isinstance(deserialize_message(data, kind), kind)
        assert len(set(valid)) > 50 or topic == "/parameter_events"
        assert len(set(spoiled)) > 50


def test_every_kind_of_value_has_hostile_ones() -> None:
    random = Random(3)
    numbers = {hostile_value("int32", random) for _ in range(1000)}
    assert {-(2**31), 2**31 - 1, 0, -1} <= numbers
    assert {0, 2**32 - 1} <= {hostile_value("uint32", random) for _ in range(1000)}
    assert {str(hostile_value("double", random)) for _ in range(1000)} >= {"nan", "inf", "1e+300"}
    assert {True, False} == {hostile_value("boolean", random) for _ in range(100)}
    assert "%00" in {hostile_value("string", random) for _ in range(1000)}


def test_damage_changes_bytes_but_not_the_head() -> None:
    random, data = Random(5), bytes(range(200))
    spoiled = [damaged(data, random) for _ in range(500)]
    assert sum(one != data for one in spoiled) > 480
    assert all(one[:4] == data[:4] for one in spoiled)
    assert {len(one) < len(data) for one in spoiled} == {True, False}


def test_raw_bytes_are_never_empty_and_rarely_a_message() -> None:
    random, data = Random(6), bytes(range(200))
    made = [raw(data, data[:4] + bytes(50), random) for _ in range(1000)]
    assert min(map(len, made)) == 1
    assert {one[:4] == data[:4] for one in made} == {True, False}
    assert sum(one == data for one in made) < 50


def test_every_field_is_in_its_place() -> None:
    header = Header(stamp=stamp_to_ros(3 * 10**9 + 5), frame_id="camera")
    poses = [[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0], [4.0, 5.0, 6.0, 1.0, 0.0, 0.0, 0.0]]
    some = [
        Detection(header, [Result(Hypothesis(name, 0.5))] * count, Box(pose_to_ros(pose)), name)
        for pose, name, count in zip(poses, ("a", "track-7"), (0, 3), strict=True)
    ]
    some[1].bbox.size = Vector3(x=7.0, y=8.0, z=9.0)
    found = detections_from_bytes(serialised(Detections(header, some)), 2)
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == (3, 5)
    assert found.frames == {found.header.frame_id} == {"camera"}
    assert found.ids == ["a", "track-7"]
    np.testing.assert_array_equal(found.poses, poses)
    np.testing.assert_array_equal(found.sizes, [[0.0] * 3, [7.0, 8.0, 9.0]])


@pytest.mark.skipif(MessageType is None, reason="vision_msgs is not installed")
def test_vision_msgs_reads_the_same(tmp_path: Path) -> None:
    from rclpy.serialization import deserialize_message, serialize_message

    messages = Messages(Random(1), tmp_path)
    for _ in range(100):
        data = serialised(messages.detections())
        assert serialize_message(deserialize_message(data, TYPE)) == data


def test_questions_have_states_that_only_the_attached_box_makes_invalid(tmp_path: Path) -> None:
    robot = RobotMessages(Messages(Random(1), tmp_path), tmp_path)
    questions = [robot.question(number, Header()) for number in range(20)]
    possible, alone = (
        np.concatenate([getattr(one, name) for one in questions]) for name in ("possible", "alone")
    )
    assert not (possible & ~alone).any()
    assert 50 < np.count_nonzero(possible) < np.count_nonzero(alone) < len(alone) - 50
    again = robot.question(7, Header())
    np.testing.assert_array_equal(again.possible, questions[7].possible)


def test_markers_are_locked_to_links_known_and_unknown(tmp_path: Path) -> None:
    messages = Messages(Random(1), tmp_path)
    assert not any(marker.header.frame_id.startswith(ROBOT) for marker in markers(messages))
    RobotMessages(messages, tmp_path)
    locked = {one.header.frame_id for one in markers(messages) if one.frame_locked}
    assert set(messages.links) <= locked
    assert {f"{ROBOT}/l3", f"{ROBOT}/none"} <= locked


def markers(messages: Messages) -> list[Marker]:
    return [messages.marker() for _ in range(400)]


def test_few_descriptions_have_meshes(tmp_path: Path) -> None:
    messages = Messages(Random(1), tmp_path)
    make = RobotMessages(messages, tmp_path).makers[LATCHED[0]][1]
    texts = [make().data for _ in range(1000)]
    assert 10 < sum("<mesh" in text for text in texts) < 150
    good = Counter(texts).most_common(1)[0][1]
    assert 500 < good < 750  # half of them, and those of which no line was changed

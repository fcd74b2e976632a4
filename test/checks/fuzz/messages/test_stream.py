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

"""Messages by number: the same for the same seed, all cases among them; probes that are right."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
import pytest

pytest.importorskip("rclpy")
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.inputs.detections import detections_from_bytes
from obb_collision.node.messages.cdr import cloud_from_bytes, states_from_bytes
from obb_collision.node.messages.errors import RefusedError
from tools.fuzz.messages import stream as stream_module
from tools.fuzz.messages.cases import CASES, MANY
from tools.fuzz.messages.messages import Messages
from tools.fuzz.messages.stream import Sent, Stream
from tools.fuzz.session.probes import BOXES, Probes, right_pairs


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
    for kind in ("detections and results claimed",):
        with pytest.raises(RefusedError, match="malformed message"):
            detections_from_bytes(by_kind[kind], 2**40)
    assert len(by_kind["texts of 1 MB"]) > 1_000_000
    with pytest.raises(RefusedError, match=r"1000\d\d fields"):
        cloud_from_bytes(by_kind["100,000 fields"])


def test_what_the_middleware_does_not_send_is_not_made(tmp_path: Path) -> None:
    stream = Stream(1, tmp_path)
    sent = [stream.raw(number) for number in range(1000)]
    assert all(one.data for one in sent)
    clocks = [one for one in sent if one.topic == "/clock"]
    assert clocks
    assert all(len(one.data) <= stream_module.FIXED["/clock"] for one in clocks)


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

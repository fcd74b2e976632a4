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

"""What the attack sends: valid to begin with, the same for the same seed, and really spoiled."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

pytest.importorskip("rclpy")
from rclpy.serialization import deserialize_message

from obb_collision.node.inputs.detections import detections_from_bytes
from tools.fuzz.messages.look_alikes import serialised
from tools.fuzz.messages.messages import Messages
from tools.fuzz.mutations.data import damaged, raw
from tools.fuzz.mutations.fields import hostile_value, mutate

TOPICS = (
    *("objects", "object_transform", "object_states", "object_poses", "object_boxes", "points"),
    *("/tf", "/tf_static", "/clock", "/parameter_events", "detections"),
)


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


@pytest.mark.parametrize("topic", TOPICS)
def test_messages_and_their_mutations_can_be_sent_and_read(tmp_path: Path, topic: str) -> None:
    kind = Messages(Random(0), tmp_path).makers[topic][0]
    valid, spoiled = (some(tmp_path, 7, topic, mutations) for mutations in (0, 4))
    for data in valid + spoiled:
        if topic == "detections":
            assert detections_from_bytes(data, 10**5).header is not None
        else:
            assert isinstance(deserialize_message(data, kind), kind)
    if topic != "/parameter_events":
        assert len(set(valid)) > 50
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

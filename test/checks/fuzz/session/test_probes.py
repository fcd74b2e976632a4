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

"""Probes of an attack, given to the inputs of a node in this process."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
import pytest

pytest.importorskip("rclpy")
from obb_collision.node import namespace_number
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.inputs.inputs import Inputs
from obb_collision.node.inputs.subscriptions import INPUTS
from obb_collision.node.objects.frames import FixedFrameOnly
from obb_collision.node.objects.objects import Objects
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.topics.topics import COLLISIONS
from tools.fuzz.messages.messages import Messages
from tools.fuzz.session.client import Answer
from tools.fuzz.session.probes import BOXES, SETS, Pair, Probes
from tools.fuzz.session.session import find_answer


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


@pytest.mark.parametrize("number", range(20))
def test_the_sure_pair_of_a_set_is_there_only_once_all_of_it_is(
    tmp_path: Path, number: int
) -> None:
    probes = Probes(Messages(Random(1), tmp_path))
    probe = probes.make(number, Random(number), 10**18, everything=True, full=True)
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

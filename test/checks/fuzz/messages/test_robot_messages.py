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

"""Messages of a robot: what is attached counts, and markers are locked to its links."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from random import Random

import numpy as np
import pytest

pytest.importorskip("rclpy")
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from tools.fuzz.messages.messages import Messages
from tools.fuzz.messages.robot_messages import LATCHED, ROBOT, RobotMessages


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
    assert not any(marker.header.frame_id.startswith(ROBOT) for marker in some(messages))
    RobotMessages(messages, tmp_path)
    locked = {one.header.frame_id for one in some(messages) if one.frame_locked}
    assert set(messages.links) <= locked
    assert {f"{ROBOT}/l3", f"{ROBOT}/none"} <= locked


def some(messages: Messages) -> list[Marker]:
    return [messages.marker() for _ in range(400)]


def test_few_descriptions_have_meshes(tmp_path: Path) -> None:
    messages = Messages(Random(1), tmp_path)
    make = RobotMessages(messages, tmp_path).makers[LATCHED[0]][1]
    texts = [make().data for _ in range(1000)]
    assert 10 < sum("<mesh" in text for text in texts) < 150
    good = Counter(texts).most_common(1)[0][1]
    assert 500 < good < 750  # half of them, and those of which no line was changed

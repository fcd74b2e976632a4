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

"""Good messages of a robot after hostile ones: it must be known again, and answered right."""

from __future__ import annotations

import time
from functools import partial
from random import Random

import numpy as np
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from obb_collision.node.messages.clouds import cloud_from_ros
from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.robots.validity import NOT_KNOWN
from tools.fuzz.messages.robot_messages import Question, RobotMessages
from tools.fuzz.process.child import Child
from tools.fuzz.session.client import Client, FoundError

KNOWN = 20.0
"""Seconds in which the robot must be known: it may be that a process reads meshes of another."""
CLEARING = 2.0
"""Seconds after which objects are removed again; each time the robot is read anew."""


def ask_robot(robot: RobotMessages, random: Random, client: Client, child: Child) -> None:
    """Remove all objects, send good messages and ask for states, until all that can be are valid.

    That they are not may be for a time: hostile objects that waited in a queue come after they were
    removed, and are removed again, and what is attached comes by another topic. FoundError for
    others that are valid, and where it lasts.
    """
    number, start, before, next_time = random.getrandbits(31), time.monotonic(), child.delays(), 0.0
    seen: object = None
    while time.monotonic() < start + KNOWN + child.waited(before):
        if time.monotonic() > next_time:
            client.call(child, Trigger, "clear", Trigger.Request())
            next_time = time.monotonic() + CLEARING
        header = Header(stamp=stamp_to_ros(time.time_ns()), frame_id="map")
        question = robot.question(number, header)
        seen = _ask(question, header, client, child)
        if seen is None:
            return
    raise FoundError(f"after {KNOWN:g} s states of the robot are {seen}; {client.status()}")


def _ask(question: Question, header: Header, client: Client, child: Child) -> object:
    """Send messages and wait for the answer; returns it where it is not what it shall become."""
    for topic, message in question.messages:
        client.publishers[topic].publish(message)
    reached = partial(client.answer_at, header.stamp)
    answer = client.until(child, reached, "answer about states of the robot")
    rows = cloud_from_ros(answer, ("valid", "reason"))
    valid = rows["valid"].astype(bool)
    known = len(rows) == len(question.possible) and bool((rows["reason"] != NOT_KNOWN).all())
    may_be = question.alone if known else np.zeros(len(rows), bool)
    if len(rows) != len(may_be) or (valid & ~may_be).any():
        raise FoundError(f"of states of the robot valid are {rows}, possible are {may_be}")
    return None if known and np.array_equal(valid, question.possible) else rows

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

"""The messages of an attack: each is a function of the seed and of its number alone.

So a number from a report is enough to make it again. Stamps are an exception: they are near the
time at which a message is made.
"""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import NamedTuple

from tools.fuzz.messages.cases import CASES, Made
from tools.fuzz.messages.look_alikes import serialised
from tools.fuzz.messages.messages import Messages
from tools.fuzz.messages.robot_messages import RobotMessages
from tools.fuzz.mutations.data import damaged, raw
from tools.fuzz.mutations.fields import mutate

CASE_SHARE = 0.002
"""Share of the messages that are a named case; the first ones are all cases once."""
DAMAGED = 0.15
"""Share of the others whose bytes are damaged, besides what their fields hold."""
CLOCK_SHARE = 0.02
"""Share of the messages on topics that are not the node's own, each: tf, clock, events."""

FIXED = {"/clock": 12}
"""Bytes of messages without texts and lists: the middleware sends no longer ones."""


class Sent(NamedTuple):
    """A message to send: its topic, its bytes, and what it is."""

    topic: str
    data: bytes
    kind: str


class Stream:
    """Makes messages by number; ``folder`` gets mesh files.

    robots: share of the messages on the topics of a robot.
    """

    def __init__(self, seed: int, folder: Path, robots: float = 0.0) -> None:
        self._seed, self._share = seed, robots
        self.messages = Messages(Random(seed), folder)
        self.robot = RobotMessages(self.messages, folder) if robots else None
        self._makers = dict(self.messages.makers)
        self.types = {topic: kind for topic, (kind, _) in self._makers.items()}
        """Type by topic."""
        self._own = [topic for topic in self.types if not topic.startswith("/")]
        self._others = [topic for topic in self.types if topic.startswith("/")]
        if self.robot is not None:
            self._makers |= self.robot.makers
            self.types |= {topic: kind for topic, (kind, _) in self.robot.makers.items()}

    def _start(self, what: str, number: int) -> Random:
        random = Random(f"{self._seed} {what} {number}")
        self.messages.random = random
        return random

    def _topic(self, random: Random) -> str:
        """Choose a topic."""
        if self.robot is not None and random.random() < self._share:
            return random.choice(list(self.robot.makers))
        if random.random() < CLOCK_SHARE * len(self._others):
            return random.choice(self._others)
        return random.choice(self._own)

    def message(self, number: int) -> Sent:
        """Return a message whose fields are hostile, or that is one of the cases."""
        random = self._start("message", number)
        if number < len(CASES) or random.random() < CASE_SHARE:
            names = list(CASES)
            name = names[number] if number < len(names) else random.choice(names)
            return self._sent(CASES[name](random, self.messages), name)
        topic = self._topic(random)
        message = self._makers[topic][1]()
        for _ in range(random.choice((0, 1, 1, 2, 5))):
            try:
                mutate(message, random)
            except AssertionError:  # rclpy refuses to set it, so it can't be sent
                continue
        data = serialised(message)
        if random.random() < DAMAGED:
            return Sent(topic, _sendable(topic, damaged(data, random)), "damaged")
        return Sent(topic, data, "mutated")

    def raw(self, number: int) -> Sent:
        """Return bytes that may be no message at all."""
        random = self._start("raw", number)
        topic = self._topic(random)
        data, other = (
            serialised(self._makers[one][1]()) for one in (topic, random.choice(self._own))
        )
        return Sent(topic, _sendable(topic, raw(data, other, random)), "raw")

    def _sent(self, made: Made, name: str) -> Sent:
        topic, message = made
        data = message if isinstance(message, bytes) else serialised(message)
        return Sent(topic, data, name)


def _sendable(topic: str, data: bytes) -> bytes:
    return data[: FIXED.get(topic)]

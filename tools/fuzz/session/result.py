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

"""What an attack on a node sent and saw."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from tools.fuzz.process.usage import Usages


@dataclass
class Result:
    """What was sent and seen."""

    sent: Counter[str] = field(default_factory=Counter)
    """Messages and requests by topic and service."""
    probes: Counter[str] = field(default_factory=Counter)
    """Answered probes by the way in which their boxes came."""
    again: int = 0
    """Sets of boxes that were sent again, as a hostile one had a later stamp."""
    longest: float = 0.0
    """Longest time between two answers (s)."""
    lost: int = 0
    """Answers that the middleware lost on their way; times without them are not judged."""
    excused: int = 0
    """Times that were longer than allowed only because the machine had other work."""
    late: list[tuple[str, float, float]] = field(default_factory=list)
    """Where one was longer than allowed: the batch, its length and what is allowed."""
    usages: Usages = field(default_factory=Usages)
    received: Counter[str] = field(default_factory=Counter)
    """Messages that the node has received, and those that its queues lost."""
    refused: Counter[str] = field(default_factory=Counter)

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

"""Frames that a test moves about, without tf2."""

from __future__ import annotations

from typing import Any

import numpy as np

from obb_collision.node.messages.errors import RefusedError


class FakeFrames:
    """Frames that a test moves about."""

    waits = True
    description = "a test"

    def __init__(self) -> None:
        self.known: dict[str, list[float]] = {}
        self.asked: list[tuple[str, int]] = []

    def lookup(self, frame: str, stamp: int) -> Any:
        self.asked.append((frame, stamp))
        if frame not in self.known:
            raise RefusedError("unknown frame", frame)
        return np.array(self.known[frame])

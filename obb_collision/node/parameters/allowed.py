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

"""Pairs that may touch, as a parameter and in the scene."""

from __future__ import annotations

from collections.abc import Sequence

from obb_collision.scene.scene import Scene

AllowedPair = tuple[str, str]
"""Two patterns of names: objects that match them may touch."""
AllowedRule = tuple[str, str, bool]
"""The same, or with False: they may not."""


def allowed_from_text(text: str) -> AllowedPair:
    """Read ``PATTERN PATTERN``; ValueError for anything else."""
    words = text.split()
    if len(words) != 2:
        raise ValueError(f"{text!r} is not two names or patterns like 'robot/* table/1'")
    return words[0], words[1]


def set_allowed(scene: Scene, rules: Sequence[AllowedRule]) -> None:
    """Set the rules of pairs that may touch; the last rule that matches a pair applies."""
    scene.allowed = list(rules)

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

"""A scene in which nothing changes is free or collides, and is never said not to be known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray
from rig import LATCHED, Rig, cube

from obb_collision.node.diagnostics.answer import COLLIDING, FREE

SCENE = "objects: [{{name: a/1, shape: box, size: [1, 1, 1], position: [{}, 0, 0]}}]"
STATUSES = 8
"""Messages of a steady scene: 0.1 s and more between two."""


@pytest.mark.parametrize(("x", "level"), [(0.5, COLLIDING), (3.0, FREE)])
@pytest.mark.parametrize("source", ["markers", "file", "file and marker"])
def test_what_is_sent_once_is_known_for_good(
    tmp_path: Path, source: str, x: float, level: bytes
) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(SCENE.format(0.0))
    given: dict[str, Any] = {"scene_file": str(file)} if "file" in source else {}
    with Rig(object_timeout=0.2, given=given) as rig:
        levels: list[bytes] = []

        def take(message: DiagnosticArray) -> None:
            levels.append(message.status[0].level)

        if source == "markers":
            rig.send(cube(("a", 1)), stamped=False)
        if source != "file":
            rig.send(cube(("b", 1), (x, 0.0, 0.0)), stamped=False)
        wanted = FREE if source == "file" else level
        rig.client.create_subscription(DiagnosticArray, "collision_status", take, LATCHED)
        rig.until(lambda: wanted in levels, "an answer")
        del levels[: levels.index(wanted)]
        rig.until(lambda: len(levels) > STATUSES, "more of them")
        assert set(levels) == {wanted}

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

"""``docs/architecture.md`` shows the way that a pose takes through the node."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from pages import ROOT

pytest.importorskip("rclpy")
from rig import Rig, cube
from visualization_msgs.msg import Marker

import obb_collision
from obb_collision.node import namespace_number

PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PACKAGE = Path(obb_collision.__file__).parent
MOST_WORDS = 600


def drawn() -> list[str]:
    """Return the folders of the drawing that data passes, in its order."""
    drawing = PAGE.split("```")[1]
    return re.findall(r"^ ((?:node|scene)/\w+)", drawing, re.MULTILINE)


def test_a_pose_passes_the_folders_in_the_order_of_the_drawing() -> None:
    number, count = namespace_number("a"), 100  # of a few the broad phase is not asked
    poses = [[0.5 * n, 0, 0, 0, 0, 0, 1] for n in range(count)]
    entered: dict[str, None] = {}

    def note(frame: FrameType, event: str, _: Any) -> None:
        path = Path(frame.f_code.co_filename)
        # what is asked for is looked up first
        name = frame.f_code.co_name
        before = name == "checked" or path.name in ("ladder.py", "settings.py")
        before |= path.name == "outputs.py" and not name.startswith("publish_report")
        if event == "call" and path.is_relative_to(PACKAGE) and not before:
            entered.setdefault(path.parent.relative_to(PACKAGE).as_posix())

    with Rig(accuracy="hull") as rig:
        rig.listen("contacts")
        rig.send(*(cube(("a", n), type=Marker.SPHERE) for n in range(count)))
        rig.send_poses(range(count), poses, [number] * count)
        rig.answer()
        sys.setprofile(note)
        try:
            rig.send_poses(range(count), poses[::-1], [number] * count)
            rig.answer()
        finally:
            sys.setprofile(None)
    assert len(drawn()) == 9
    assert [folder for folder in entered if folder in drawn()] == drawn()


def test_the_page_is_short_and_names_every_layer_in_the_order_of_imports() -> None:
    assert len(PAGE.split()) <= MOST_WORDS
    named = [
        name
        for row in re.findall(r"^\| (`.*?) \|", PAGE, re.MULTILINE)
        for name in re.findall(r"`(\w+)`", row)
    ]
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert set(named) == folders
    for folder in re.findall(r"queries/\w+|`([\w/]+\.py)`", PAGE):
        assert not folder or (PACKAGE / folder).exists(), folder

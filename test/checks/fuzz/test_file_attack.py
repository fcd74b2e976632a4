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

"""Mutated scene files: the same for the same seed, some good, and a reader that ends is found."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from tools.fuzz import file_attack
from tools.fuzz.files import robots, scenes
from tools.fuzz.session.client import FoundError

GOOD = tuple("\n".join(text.splitlines()).encode() for text in (robots.urdf(), robots.SRDF))


def test_scenes_are_good_before_they_are_changed(tmp_path: Path) -> None:
    scenes.place_files(tmp_path)
    path = tmp_path / "scene.yaml"
    for text in scenes.texts():
        path.write_text(text)
        assert scenes.read(path) == ""
    assert scenes.mutated_scene(1, 5) == scenes.mutated_scene(1, 5)
    assert len({scenes.mutated_scene(1, number) for number in range(50)}) > 30


def test_a_process_reads_them_all(tmp_path: Path) -> None:
    refused, longest = file_attack.attack_reader("scene", tmp_path, 1, 10, 40)
    assert 10 < refused < 30
    assert longest < file_attack.READING
    refused, longest = file_attack.attack_reader("robot", tmp_path, 1, 10, 40)
    assert 5 < refused < 30


def test_robots_are_good_before_they_are_changed(tmp_path: Path) -> None:
    numbers = [number for number in range(200) if robots.mutated_robot(1, number) == GOOD]
    assert len(numbers) > 5
    for number in numbers:
        assert robots.read_robot(tmp_path, 1, number) == ""
    assert robots.mutated_robot(1, 3) == robots.mutated_robot(1, 3)
    assert len({robots.mutated_robot(1, number) for number in range(50)}) > 30


def test_mutated_robots_are_read_or_refused_with_the_place(tmp_path: Path) -> None:
    outcomes = [robots.read_robot(tmp_path, 2, number) for number in range(300)]
    assert 30 < sum(not reason for reason in outcomes) < 200
    for reason in filter(None, outcomes):
        assert re.match(r"RobotError: .*bot\.[us]rdf(:\d+)?: ", reason), reason
        assert len(reason) < 1000


def test_a_reader_that_ends_or_takes_long_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(FoundError, match="scene:0 ended its reader"):
        file_attack.attack_reader("scene", tmp_path / "none", 1, 0, 3)
    monkeypatch.setattr(file_attack, "READING", 0.0)
    with pytest.raises(FoundError, match=r"scene:\d+ took"):
        file_attack.attack_reader("scene", tmp_path, 1, 0, 3)

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

"""docs/scene_files.md says what is so: its keys are those of the code, its examples work."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import trimesh

from obb_collision.scene.effects import EFFECTS
from obb_collision.scene_files import (
    READY,
    SceneFileError,
    load_scene,
    moveit,
    native,
    objects,
)
from obb_collision.scene_files.description import NODE_EFFECTS
from obb_collision.scene_files.objects import KINDS

ROOT = Path(__file__).parents[2]
DOCS = (ROOT / "docs" / "scene_files.md").read_text()


def first_cells(heading: str) -> list[set[str]]:
    """Return the words in code font in the first cell of each row of a section's tables."""
    section = DOCS.split(f"{heading}\n", 1)[1].split("\n## ", 1)[0]
    cells = re.findall(r"^\| ([^|]*) \|", section, re.MULTILINE)
    return [set(re.findall(r"`(\w+)", cell)) for cell in cells if not cell.startswith("-")]


def words(heading: str) -> set[str]:
    return set().union(*first_cells(heading))


def test_keys_are_those_of_the_code() -> None:
    assert words("## Keys of a file") == set(native.KEYS)
    kinds = {key for keys in KINDS.values() for key in keys}
    sizes = {key for keys in objects.SIZES.values() for key in keys}
    assert words("## Keys of an object") == {*objects.KEYS, *sizes, *kinds}
    assert words("## Robots") == set(native.ROBOT_KEYS)
    assert words("## Effects") == {*EFFECTS, *NODE_EFFECTS}
    parts = words("## MoveIt planning scenes")
    assert {part for part in parts if part != "is_diff"} <= set(moveit.KEYS)
    lines = DOCS.split("## Effects\n", 1)[1].splitlines()
    for effect, values in EFFECTS.items():
        row = next(line for line in lines if line.startswith(f"| `{effect}` |"))
        named = set(re.findall(r"`(\w+)`", row.split("|")[2]))
        assert named == {"mode", "objects", *values.options}


def test_ready_scenes_are_listed() -> None:
    rows = re.findall(r"^\| `(\w+)\.yaml` \|", DOCS, re.MULTILINE)
    assert tuple(rows) == READY


def test_the_example_loads_and_the_snippet_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    example, robots = re.findall(r"```yaml\n(.*?)```", DOCS, re.DOTALL)
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box().export(tmp_path / "meshes" / "hand.stl")
    path = tmp_path / "cell.yaml"
    path.write_text(example)
    assert load_scene(path).names == ["table/0", "cup/0", "gripper/0"]
    for name in ("arm.urdf", "arm.srdf", "arm_finger.obj"):
        (tmp_path / name).write_bytes((ROOT / "config" / name).read_bytes())
    path.write_text(robots)
    assert load_scene(path).robots[0].motion is not None

    (code,) = re.findall(r"```python\n(.*?)```", DOCS, re.DOTALL)
    monkeypatch.chdir(ROOT)
    exec(compile(code, "scene_files.md", "exec"), {})
    assert capsys.readouterr().out == "[]\n"


def test_the_errors_are_as_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (shown,) = re.findall(r"```text\n(.*?)```", DOCS, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    text = [
        "groups: {gripper: [g/*]}", *["# words"] * 9, "objects:",
        "- {name: a, shape: box, size: [1, 1, 1]}", "- {name: b, shape: box, size: [1, 1, 1]}",
        "- {name: c, shape: box, size: [1, -1]}", *["# words"] * 4, "effects:",
        "  contact: on", "allowed: [[a, b],", "  [griper, a]]",
    ]  # fmt: skip
    Path("cell.yaml").write_text("\n".join(text))
    with pytest.raises(SceneFileError) as error:
        load_scene("cell.yaml")
    assert str(error.value).splitlines() == shown.splitlines()

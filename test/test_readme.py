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

"""What the README shows is so: its snippets run, its tables are those of the code."""

import re
from pathlib import Path

import pytest

from obb_collision.geometry.representations import memory_table

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
SNIPPETS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
WITHOUT_ROS = [code for code in SNIPPETS if "import obb_collision as oc" in code]
WITH_ROS = [code for code in SNIPPETS if "import rclpy" in code]


def test_the_snippets_are_found() -> None:
    assert len(WITHOUT_ROS) == 5
    assert len(WITH_ROS) == 1


@pytest.mark.parametrize(
    "code", WITHOUT_ROS, ids=["scene", "arrays", "mesh scene", "meshes", "effects"]
)
def test_snippets_run_and_print_what_they_say(
    code: str, capsys: pytest.CaptureFixture[str]
) -> None:
    exec(compile(code, "README.md", "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    expected = re.findall(r"print\(.*\)  # (\[.*?\]|\{\}|\d+)(?:[:\s]|$)", code, re.MULTILINE)
    assert len(expected) > 0
    for line, text in zip(printed, expected, strict=False):
        assert line.startswith(text)


def table_rows(heading: str) -> list[list[str]]:
    """Return the cells of the first table behind a heading, without its two head lines."""
    lines = README.split(heading, 1)[1].splitlines()
    table = [line for line in lines if line.startswith("|")]
    first = lines.index(table[0])
    rows = []
    for line in lines[first + 2 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def test_the_memory_table_is_that_of_the_arrays() -> None:
    found = {
        row[0]: tuple(int(cell) for cell in row[1:]) for row in table_rows("What one box takes")
    }
    assert found == memory_table()


def test_the_parameter_table_is_that_of_the_node() -> None:
    pytest.importorskip("rclpy")
    from obb_collision.node.parameters.parameters import SPECS

    rows = {row[0].strip("`"): row for row in table_rows("### Parameters")}
    assert set(rows) == {spec.name for spec in SPECS}
    for spec in SPECS:
        assert rows[spec.name][1] == f"`{spec.default}`"
        assert rows[spec.name][3] == spec.description
        if spec.limits is not None:
            assert rows[spec.name][2] == f"{spec.limits[0]:g} to {spec.limits[1]:g}"


def test_files_and_links_exist() -> None:
    targets = re.findall(r"\]\(([^)#]+?)\)", README)
    assert targets
    for target in targets:
        assert (ROOT / target).exists(), target


def test_console_scripts_exist() -> None:
    setup = (ROOT / "setup.py").read_text()
    scripts = dict(re.findall(r'"(obb_collision_\w+) = ([\w.]+):\w+"', setup))
    assert set(re.findall(r"obb_collision_(?:node|demo|speed|\w+_answers|latency)", README)) <= set(
        scripts
    )
    for module in scripts.values():
        place = ROOT / module.replace(".", "/")
        assert place.with_suffix(".py").exists() or (place / "__init__.py").exists(), module


def test_the_rosdep_line_allows_what_comes_from_pypi() -> None:
    (line,) = re.findall(r"^.*rosdep install.*$", README, re.MULTILINE)
    from_pypi = re.findall(r"<exec_depend>(.*-pip)<", (ROOT / "package.xml").read_text())
    assert from_pypi == ["python3-trimesh-pip"]
    assert line.startswith("PIP_BREAK_SYSTEM_PACKAGES=1 rosdep install ")


def test_the_recording_leaves_out_what_is_computed_for_who_subscribes() -> None:
    pytest.importorskip("rclpy")
    from obb_collision.node.outputs.effects import TOPICS

    (pattern,) = re.findall(r"--exclude-regex '(.*)'", README)
    names = {
        effect: "/cell/" + topic.replace("~", "obb_collision") for effect, topic in TOPICS.items()
    }
    left_out = {effect for effect, name in names.items() if re.search(pattern, name)}
    assert left_out == {"text", "contacts", "clearance", "sweep", "points", "markers"}

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

"""The tables and links of the documentation are those of the code, its drawing is true."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from each import each
from pages import PAGES, ROOT, code_blocks, page_name, table_rows

import obb_collision as oc
from obb_collision import Accuracy
from obb_collision.geometry.representations import memory_table
from obb_collision.scene.effects import EFFECTS

pytest.importorskip("rclpy")

from rig import Rig, cube
from visualization_msgs.msg import Marker

from obb_collision.node import namespace_number
from obb_collision.node.topics.topics import TOPICS

README = ROOT / "README.md"
LIBRARY, NUMERICS = (ROOT / "docs" / f"{name}.md" for name in ("library", "numerics"))


def test_the_readme_is_short() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) < 200


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub and myst-parser make them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@each("page", PAGES)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.exists(), target
        assert not anchor or anchor in anchors(file), target


def test_every_page_is_linked_from_the_readme() -> None:
    text = README.read_text(encoding="utf-8")
    for page in PAGES[1:]:
        assert f"]({page_name(page)})" in text, page


def test_the_memory_table_is_that_of_the_arrays() -> None:
    rows = table_rows(LIBRARY, "## What a box takes in memory")
    assert {row[0]: tuple(map(int, row[1:])) for row in rows} == memory_table()


def test_the_levels_of_accuracy_are_those_of_the_code() -> None:
    rows = table_rows(ROOT / "docs" / "accuracy.md", "## The levels")
    assert [row[0].strip("`") for row in rows] == [level.name.lower() for level in Accuracy]


def test_the_api_reference_has_every_public_name_once() -> None:
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    named = re.findall(r"^\.\. auto(?:class|function|data):: (\w+)$", text, re.MULTILINE)
    assert sorted(named) == sorted(set(oc.__all__) - {"regions", "shapes"})


def test_the_effects_are_those_of_the_scene() -> None:
    rows = table_rows(LIBRARY, "## Only what you ask for")
    found = {row[0].strip("`"): set(re.findall(r"`(\w+)`", row[2])) for row in rows}
    assert found == {name: set(effect.options) for name, effect in EFFECTS.items()}


def test_the_readme_repeats_what_other_pages_measured() -> None:
    speed = table_rows(ROOT / "docs" / "speed.md", "# Speed")
    for row in table_rows(README, "## It is fast for many objects"):
        assert row in speed
    right = {row[0]: row for row in table_rows(NUMERICS, "## Wrong answers, side by side")}
    for name, ours, textbook, *peers in table_rows(README, "### It is right"):
        row = right[name]
        assert [ours, textbook, *peers] == [row[2], row[5], *row[7:]]


def test_the_rosdep_line_allows_what_comes_from_pypi() -> None:
    from_pypi = re.findall(r"<exec_depend>(.*-pip)<", (ROOT / "package.xml").read_text())
    assert from_pypi == ["python3-trimesh-pip"]
    for page in (README, ROOT / "docs" / "install.md"):
        (line,) = re.findall(r"^.*rosdep install --from.*$", page.read_text(), re.MULTILINE)
        assert line.startswith("PIP_BREAK_SYSTEM_PACKAGES=1 rosdep install ")


@each("page", PAGES)
def test_public_names_in_a_page_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    names = set(re.findall(r"\boc\.([A-Za-z]\w*(?:\.[A-Z]\w*)?)", text))
    if page.stem == "effects":
        names |= set(re.findall(r"`(\w+)`", text.split("## Questions without a scene\n", 1)[1]))
        assert "clearances" in names
    for name in names:
        found: object = oc
        for part in name.split("."):
            assert hasattr(found, part), f"oc.{name}"
            found = getattr(found, part)


PACKAGE, TOOLS = ROOT / "obb_collision", ROOT / "tools"
LAYERS = (
    "numerics", "geometry", "queries", "scene", "robots", "warm_up", "scene_files", "node",
    "demo", "benchmarks",
)  # fmt: skip
"""The folders of the package in the order of their imports."""


def first_line(folder: Path) -> str:
    """Return what the docstring of a folder says first."""
    docstring = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
    return (docstring or "").partition("\n")[0]


def test_the_tree_is_that_of_the_folders() -> None:
    assert {file.parent.name for file in PACKAGE.glob("*/__init__.py")} == set(LAYERS)
    tree = [("obb_collision/", PACKAGE), *((f"  {name}/", PACKAGE / name) for name in LAYERS)]
    (shown,) = code_blocks(ROOT / "CONTRIBUTING.md", "text")
    lines = [f"{name:<22} {first_line(folder)}" for name, folder in [*tree, ("tools/", TOOLS)]]
    assert shown.splitlines() == lines


def test_every_folder_says_in_one_line_what_it_is() -> None:
    for file in (*PACKAGE.rglob("__init__.py"), *TOOLS.rglob("__init__.py")):
        assert 0 < len(first_line(file.parent)) <= 80, file
        assert first_line(file.parent).endswith("."), file


def test_files_that_are_named_exist_and_those_beside_the_folders_are_named() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = re.findall(r"`((?:obb_collision|test|docs)/[\w./]+)`", text)
    assert "obb_collision/queries/sweep/sweep.py" in named
    for path in named:
        assert (ROOT / path).exists(), path
    for file in set(PACKAGE.glob("*.py")) - {PACKAGE / "__init__.py"}:
        assert f"`{file.name}`" in text, file.name


def test_the_tables_are_up_to_date(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs")
    import make_tables  # type: ignore[import-not-found]

    found = make_tables.tables()
    marks: list[str] = []
    for name in make_tables.PAGES:
        text = (ROOT / "docs" / name).read_text(encoding="utf-8")
        marks += re.findall(r"<!-- table: (.*) -->", text)
        assert make_tables.with_tables(text, found) == text, "python docs/make_tables.py"
    assert sorted(marks) == sorted(found)
    assert make_tables.PARAMETER_FILE.read_text(encoding="utf-8") == make_tables.parameter_file()


def test_the_recording_leaves_out_what_is_computed_for_subscribers() -> None:
    text = (ROOT / "docs" / "node.md").read_text(encoding="utf-8")
    (pattern,) = re.findall(r"--exclude-regex '(.*)'", text)
    names = {key: "/cell/" + t.name.replace("~", "obb_collision") for key, t in TOPICS.items()}
    left_out = {key for key, name in names.items() if re.search(pattern, name)}
    assert left_out == {"text", "contacts", "clearance", "sweep", "points", "markers"}


ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
MOST_WORDS = 600


def drawn() -> list[str]:
    """Return the folders of the drawing that data passes, in its order."""
    drawing = ARCHITECTURE.split("```")[1]
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
        rig.send_poses(range(count), poses, [number] * count).answer()
        sys.setprofile(note)
        try:
            rig.send_poses(range(count), poses[::-1], [number] * count).answer()
        finally:
            sys.setprofile(None)
    assert len(drawn()) == 9
    assert [folder for folder in entered if folder in drawn()] == drawn()


def test_the_page_is_short_and_names_every_layer_in_the_order_of_imports() -> None:
    assert len(ARCHITECTURE.split()) <= MOST_WORDS
    named = [
        name
        for row in re.findall(r"^\| (`.*?) \|", ARCHITECTURE, re.MULTILINE)
        for name in re.findall(r"`(\w+)`", row)
    ]
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert set(named) == folders
    for folder in re.findall(r"queries/\w+|`([\w/]+\.py)`", ARCHITECTURE):
        assert not folder or (PACKAGE / folder).exists(), folder

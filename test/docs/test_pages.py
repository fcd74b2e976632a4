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

"""Pages: commands can be given, programs run, tables and links are those of the code."""

from __future__ import annotations

import ast
import contextlib
import io
import re
import shlex
import sys
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from each import each
from pages import PAGES, ROOT, code_blocks, page_name, table_rows
from processes import NEED_ROS, PROGRAMS, function_of, program_of

import obb_collision as oc
import obb_collision.geometry.representations as representations
from obb_collision import Accuracy
from obb_collision.demo.motion import read_motions
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene_files import SceneDescription, describe_scene

SETUP = (ROOT / "setup.py").read_text(encoding="utf-8")
EXTRAS = set(re.findall(r'^        "(\w+)": \[', SETUP, re.MULTILINE))
OTHERS = {
    "ament_copyright", "ament_flake8", "ament_pep257", "colcon", "export", "mypy", "rosdep", "ruff",
    "source", "sphinx-build",
}  # fmt: skip
"""Programs whose options are not ours."""


def commands() -> Iterator[tuple[str, str]]:
    """Yield the page and the text of each command: in blocks, indented, and in code font."""
    for page in PAGES:
        for block in code_blocks(page, "sh"):
            line = ""
            for part in block.splitlines():
                line += part
                with contextlib.suppress(ValueError):  # a quotation or line goes on in the next
                    if not line.endswith("\\"):
                        shlex.split(line, comments=True)
                        yield page_name(page), line
                        line = ""
                        continue
                line = line.removesuffix("\\") + "\n"
        text = page.read_text(encoding="utf-8")
        for line in re.findall(r"^    ((?:obb_collision[_ ]|python ).*)$", text, re.MULTILINE):
            yield page_name(page), line
        begin = "obb_collision_|obb_collision |python -m |pip install |bash "
        for line in re.findall(rf"`((?:{begin})[^`]*)`", text):
            if not re.match(r"obb_collision_\w+\.", line):  # a file
                yield page_name(page), line


def split_chain(line: str) -> list[list[str]]:
    """Return the words of each command of a line, without the folder of an environment."""
    chain: list[list[str]] = [[]]
    for word in shlex.split(line, comments=True):
        if word == "&&":
            chain.append([])
        else:
            chain[-1].append(word.removeprefix(".venv/bin/"))
    return [words for words in chain if words]


@cache
def help_text(script: str) -> str:
    """Return what ``--help`` of a console script prints."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), pytest.raises(SystemExit) as end:
        function_of(script)(["--help"])
    assert end.value.code == 0
    return printed.getvalue()


def check_parameter(name: str) -> None:
    if find_spec("rclpy") is not None:
        from obb_collision.node.parameters.parameters import SPECS
        from obb_collision.node.parameters.sources import source_specs

        assert name in {spec.name for spec in (*SPECS, *source_specs("NAME"))}


def check_script(words: list[str]) -> None:
    script, own = program_of(words)
    assert script in PROGRAMS, words
    if "--ros-args" in own:
        start = own.index("--ros-args")
        own, ros = own[:start], own[start:]
        given = re.findall(r"-p (\w+):=", " ".join(ros))
        for name in given if script.endswith("node") else ():
            check_parameter(name)
    options = {word for word in own if word.startswith("-")}
    if options and (script not in NEED_ROS or find_spec("rclpy") is not None):
        assert options <= set(re.findall(r"--[\w-]+", help_text(script)))


def check_ros2(words: list[str]) -> None:
    if words[1] == "launch":
        text = (ROOT / "launch" / words[3]).read_text(encoding="utf-8")
        for argument in words[4:]:
            assert f'"{argument.partition(":=")[0]}"' in text
    elif words[1] == "run":
        assert words[3] in PROGRAMS or words[2] != "obb_collision"
    elif words[1] == "param":
        check_parameter(words[4])


@each("page", [page_name(page) for page in PAGES])
def test_commands_can_be_given(page: str) -> None:
    for words in (w for name, line in commands() if name == page for w in split_chain(line)):
        program = words[0]
        for word in words:
            if re.match(r"(\.ci|config|docs|launch|obb_collision|test)/[\w.]", word):
                assert (ROOT / word).exists(), word
        if program.startswith("obb_collision") or program_of(words)[0] in PROGRAMS:
            check_script(words)
        elif program in ("python", "python3") and words[1] == "-m":
            assert find_spec(words[2]) is not None, words
        elif program in ("python", "bash"):
            assert (ROOT / words[1]).exists(), words
        elif program == "pip":
            for names in re.findall(r"\.\[([\w,]+)\]", " ".join(words)):
                assert set(names.split(",")) <= EXTRAS
        elif program == "ros2":
            check_ros2(words)
        else:
            assert program in OTHERS, words


def test_the_commands_are_found() -> None:
    programs = {program_of(words)[0] for _, line in commands() for words in split_chain(line)}
    assert "pip" in programs
    same = {"obb_collision", *(f"obb_collision {name}" for name in ("demo", "merge", "node"))}
    assert set(PROGRAMS) - programs <= {*same, "python -m tools.peers.meshes"}


AT_REST = """\
objects:
- {name: cup/0, shape: sphere, radius: 1}
- {name: straw/0, shape: sphere, radius: 1}
robots: [{name: arm, urdf: arm.urdf}]
"""


def test_yaml_blocks_are_scenes_motions_or_parameters(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box().export(tmp_path / "meshes" / "hand.stl")
    for name in ("arm.urdf", "arm.srdf", "arm_finger.obj"):
        (tmp_path / name).write_bytes((ROOT / "config" / name).read_bytes())
    scenes: list[SceneDescription] = []
    parameters: list[str] = []
    for page in PAGES:
        for block in code_blocks(page, "yaml"):
            if block.startswith("/**:"):
                names = re.findall(r"^    ([\w.]+):", block, re.MULTILINE)
                given = yaml.safe_load(block)["/**"]["ros__parameters"]
                sources = given.get("sources", [])
                parameters += set(names) - set(sources)
                parameters += (f"NAME.{key}" for source in sources for key in given[source])
                continue
            if block.startswith("collision_monitor:"):  # test/node/base reads it
                continue
            path = tmp_path / f"scene_{len(scenes)}.yaml"
            path.write_text(AT_REST if "waypoints" in block else block)
            scenes.append(describe_scene(path))
            if "waypoints" in block:
                path.with_suffix(".motion.yaml").write_text(block)
                assert read_motions(scenes[-1], path).moving == [0, 1]
    assert all(scene.objects for scene in scenes)
    assert len(scenes) >= 2
    for name in set(parameters) - {"qos_overrides"}:
        check_parameter(name)


PAGE_PROGRAMS = {page_name(page): code_blocks(page, "python") for page in PAGES}
PATIENCE = 300.0
"""Seconds after which a program with ROS is stopped: long, as it may compile its kernels."""


def test_the_programs_are_found() -> None:
    with_code = {name for name, blocks in PAGE_PROGRAMS.items() if blocks}
    assert with_code >= {"README.md", "docs/library.md", "docs/scaling.md", "docs/scene_files.md"}
    fenced = sum(page.read_text(encoding="utf-8").count("```python") for page in PAGES)
    assert sum(map(len, PAGE_PROGRAMS.values())) == fenced


@contextmanager
def node_beside(parameters: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Run a node with a file of parameters in a thread, in the domain of programs from outside."""
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.utilities import try_shutdown
    from rig import DOMAIN, own_context

    from obb_collision.node.node import CollisionNode

    def spin() -> None:
        with contextlib.suppress(ExternalShutdownException):  # the test has failed already
            while not ending.is_set():
                executor.spin_once(timeout_sec=0.1)

    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    arguments = ["--ros-args", "--params-file", str(parameters)]
    ending, watchdog = threading.Event(), threading.Timer(PATIENCE, try_shutdown)
    spinning = threading.Thread(target=spin)
    with own_context() as context:
        executor = SingleThreadedExecutor(context=context)
        node = CollisionNode(context=context, cli_args=arguments)
        executor.add_node(node)
        watchdog.start()
        spinning.start()
        try:
            yield
        finally:
            watchdog.cancel()
            ending.set()
            spinning.join(PATIENCE)
            try_shutdown()
            executor.shutdown()
            node.destroy_node()


@pytest.mark.parametrize("name", [name for name, blocks in PAGE_PROGRAMS.items() if blocks])
def test_the_blocks_run_and_print_what_they_say(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    clean = tmp_path / "clean"
    clean.mkdir()
    monkeypatch.chdir(clean)
    parameters = tmp_path / "parameters.yaml"
    blocks = [block for block in code_blocks(ROOT / name, "yaml") if block.startswith("/**:")]
    parameters.write_text("".join(blocks))
    variables: dict[str, object] = {"__name__": Path(name).stem}
    for code in PAGE_PROGRAMS[name]:
        beside: AbstractContextManager[None] = nullcontext()
        if "import rclpy" in code:
            pytest.importorskip("rclpy")
            beside = node_beside(parameters, monkeypatch)
        with beside:
            exec(compile(code, name, "exec"), variables)
        expected = re.findall(r"^ *print\(.*\)  # (.*)$", code, re.MULTILINE)
        assert capsys.readouterr().out.splitlines() == expected


README = ROOT / "README.md"
LIBRARY, NUMERICS = (ROOT / "docs" / f"{name}.md" for name in ("library", "numerics"))


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


def test_every_page_is_linked_from_the_readme_which_is_short() -> None:
    text = README.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 200
    for page in PAGES[1:]:
        assert f"]({page_name(page)})" in text, page


def test_tables_of_memory_levels_and_effects_and_the_api_reference_are_those_of_the_code() -> None:
    one = oc.Boxes(np.zeros((1, 3)), np.eye(3)[None], np.ones((1, 3)))
    numbers = {
        "axis-aligned box (two corners)": 2 * one.centers.size,
        "oriented box, two axes (compact)": representations.to_compact(one).size,
        "corner and three edges": representations.corner_and_edges(one).size,
        "oriented box, three axes": sum(array.size for array in one.arrays),
        "eight corners": one.corners().size,
        "six planes": representations.face_planes(one).size,
    }
    rows = table_rows(LIBRARY, "## What a box takes in memory")
    assert {row[0]: [*map(int, row[1:])] for row in rows} == {
        name: [size, 8 * size, 4 * size] for name, size in numbers.items()
    }
    rows = table_rows(ROOT / "docs" / "accuracy.md", "## The levels")
    assert [row[0].strip("`") for row in rows] == [level.name.lower() for level in Accuracy]
    rows = table_rows(LIBRARY, "## Only what you ask for")
    found = {row[0].strip("`"): set(re.findall(r"`(\w+)`", row[2])) for row in rows}
    assert found == {name: set(effect.options) for name, effect in EFFECTS.items()}
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    named = re.findall(r"^\.\. auto(?:class|function|data):: (\w+)$", text, re.MULTILINE)
    assert sorted(named) == sorted(set(oc.__all__) - {"regions", "shapes"})


def test_the_readme_repeats_what_other_pages_measured() -> None:
    speed = table_rows(ROOT / "docs" / "speed.md", "# Speed")
    for row in table_rows(README, "## It is fast for many objects"):
        assert row in speed
    right = {row[0]: row for row in table_rows(NUMERICS, "## Wrong answers, side by side")}
    for name, ours, textbook, *peers in table_rows(README, "### It is right"):
        row = right[name]
        assert [ours, textbook, *peers] == [row[2], row[5], *row[7:]]


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
    *("numerics", "geometry", "queries", "scene", "robots", "warm_up", "scene_files", "zones"),
    *("node", "demo", "benchmarks"),
)
"""The folders of the package in the order of their imports."""


def first_line(folder: Path) -> str:
    """Return what the docstring of a folder says first."""
    docstring = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
    return (docstring or "").partition("\n")[0]


def test_the_tree_is_that_of_the_folders_each_of_which_says_in_one_line_what_it_is() -> None:
    assert {file.parent.name for file in PACKAGE.glob("*/__init__.py")} == set(LAYERS)
    tree = [("obb_collision/", PACKAGE), *((f"  {name}/", PACKAGE / name) for name in LAYERS)]
    (shown,) = code_blocks(ROOT / "CONTRIBUTING.md", "text")
    lines = [f"{name:<22} {first_line(folder)}" for name, folder in [*tree, ("tools/", TOOLS)]]
    assert shown.splitlines() == lines
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
    pytest.importorskip("rclpy")
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
    pytest.importorskip("rclpy")
    from obb_collision.node.topics.topics import TOPICS

    text = (ROOT / "docs" / "node.md").read_text(encoding="utf-8")
    (pattern,) = re.findall(r"--exclude-regex '(.*)'", text)
    names = {key: "/cell/" + t.name.replace("~", "obb_collision") for key, t in TOPICS.items()}
    left_out = {key for key, name in names.items() if re.search(pattern, name)}
    assert left_out == {"text", "contacts", "clearance", "sweep", "points", "markers"}


ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_a_pose_passes_the_folders_in_the_order_of_the_drawing() -> None:
    pytest.importorskip("rclpy")
    from rig import Rig, cube
    from visualization_msgs.msg import Marker

    from obb_collision.node import namespace_number

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
    drawn = re.findall(r"^ ((?:node|scene)/\w+)", ARCHITECTURE.split("```")[1], re.MULTILINE)
    assert len(drawn) == 9
    assert [folder for folder in entered if folder in drawn] == drawn


def test_the_page_is_short_and_names_every_layer() -> None:
    assert len(ARCHITECTURE.split()) <= 600
    cells = re.findall(r"^\| (`.*?) \|", ARCHITECTURE, re.MULTILINE)
    named = {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}
    assert named == {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    for path in re.findall(r"queries/\w+(?![\w/])|[\w/]+\.py", ARCHITECTURE):
        assert (PACKAGE / path).exists(), path

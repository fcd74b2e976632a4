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

"""Every command of the documentation can be given, and every Python block runs."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest
import trimesh
from each import each
from pages import PAGES, ROOT, code_blocks, page_name
from processes import NEED_ROS, PROGRAMS, function_of, program_of

from obb_collision.scene_files import SceneDescription, describe_scene

SETUP = (ROOT / "setup.py").read_text(encoding="utf-8")
EXTRAS = set(re.findall(r'^        "(\w+)": \[', SETUP, re.MULTILINE))
OTHERS = {
    "PIP_BREAK_SYSTEM_PACKAGES=1", "ament_copyright", "ament_flake8", "ament_pep257", "colcon",
    "mypy", "ruff", "source", "sphinx-build",
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

        assert name in {spec.name for spec in SPECS}


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


def check_paths(words: list[str]) -> None:
    for word in words:
        if re.match(r"(\.ci|config|docs|launch|obb_collision|test)/[\w.]", word):
            assert (ROOT / word).exists(), word


def check_extras(words: list[str]) -> None:
    for names in re.findall(r"\.\[([\w,]+)\]", " ".join(words)):
        assert set(names.split(",")) <= EXTRAS


@each("page", [page_name(page) for page in PAGES])
def test_commands_can_be_given(page: str) -> None:
    for words in (w for name, line in commands() if name == page for w in split_chain(line)):
        program = words[0]
        check_paths([word for word in words if not word.startswith("--")])
        if program.startswith("obb_collision") or program_of(words)[0] in PROGRAMS:
            check_script(words)
        elif program in ("python", "python3") and words[1] == "-m":
            assert find_spec(words[2]) is not None, words
        elif program in ("python", "bash"):
            assert (ROOT / words[1]).exists(), words
        elif program == "pip":
            check_extras(words)
        elif program == "ros2":
            check_ros2(words)
        else:
            assert program in OTHERS, words


def test_the_commands_are_found() -> None:
    programs = {program_of(words)[0] for _, line in commands() for words in split_chain(line)}
    assert "pip" in programs
    same = {"obb_collision", *(f"obb_collision {name}" for name in ("demo", "merge", "node"))}
    assert set(PROGRAMS) - programs <= {*same, "python -m tools.peers.meshes"}


def test_console_scripts_have_modules() -> None:
    for place in PROGRAMS.values():
        path = ROOT / Path(place.split(":")[0].replace(".", "/"))
        assert path.with_suffix(".py").exists(), place


def test_yaml_blocks_are_scenes_or_parameters(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box().export(tmp_path / "meshes" / "hand.stl")
    for name in ("arm.urdf", "arm.srdf", "arm_finger.obj"):
        (tmp_path / name).write_bytes((ROOT / "config" / name).read_bytes())
    scenes: list[SceneDescription] = []
    parameters: list[str] = []
    for page in PAGES:
        for block in code_blocks(page, "yaml"):
            if block.startswith("/**:"):
                parameters += re.findall(r"^    ([\w.]+):", block, re.MULTILINE)
                continue
            path = tmp_path / f"scene_{len(scenes)}.yaml"
            path.write_text(block)
            scenes.append(describe_scene(path))
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


def parameter_blocks(name: str) -> list[str]:
    """Return the parameters that a page has for all nodes."""
    return [block for block in code_blocks(ROOT / name, "yaml") if block.startswith("/**:")]


@contextmanager
def node_beside(parameters: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Run a collision node in a thread, in the domain that the programs take from outside.

    parameters: a file, maybe of none.
    """
    from rclpy.context import Context
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.utilities import try_shutdown
    from rig import DOMAIN

    from obb_collision.node.node import CollisionNode

    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    context = Context()
    context.init(domain_id=DOMAIN)
    executor = SingleThreadedExecutor(context=context)
    arguments = ["--ros-args", "--params-file", str(parameters)]
    node = CollisionNode(context=context, cli_args=arguments)
    executor.add_node(node)
    ending = threading.Event()

    def spin() -> None:
        try:
            while not ending.is_set():
                executor.spin_once(timeout_sec=0.1)
        except ExternalShutdownException:  # the test has failed already
            return

    watchdog = threading.Timer(PATIENCE, try_shutdown)
    spinning = threading.Thread(target=spin)
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
        context.try_shutdown()


@pytest.mark.parametrize("name", [name for name, blocks in PAGE_PROGRAMS.items() if blocks])
def test_the_blocks_run_and_print_what_they_say(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    clean = tmp_path / "clean"
    clean.mkdir()
    monkeypatch.chdir(clean)
    parameters = tmp_path / "parameters.yaml"
    parameters.write_text("".join(parameter_blocks(name)))
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

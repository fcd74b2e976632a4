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

"""Every Python block of the documentation runs, and prints what the comments behind it say.

The blocks of a page are one program, in one namespace; those with ROS have a node beside them, with
the parameters that the page has for all nodes. A print with a comment in its line prints that
comment, and nothing else is printed. They run in an empty folder.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path

import pytest
from pages import PAGES, ROOT, code_blocks, page_name

PROGRAMS = {page_name(page): code_blocks(page, "python") for page in PAGES}
PATIENCE = 300.0
"""Seconds after which a program with ROS is stopped: long, as it may compile its kernels."""


def test_the_programs_are_found() -> None:
    with_code = {name for name, blocks in PROGRAMS.items() if blocks}
    assert with_code >= {"README.md", "docs/library.md", "docs/scaling.md", "docs/scene_files.md"}
    fenced = sum(page.read_text(encoding="utf-8").count("```python") for page in PAGES)
    assert sum(map(len, PROGRAMS.values())) == fenced


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


@pytest.mark.parametrize("name", [name for name, blocks in PROGRAMS.items() if blocks])
def test_the_blocks_run_and_print_what_they_say(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    clean = tmp_path / "clean"
    clean.mkdir()
    monkeypatch.chdir(clean)
    parameters = tmp_path / "parameters.yaml"
    parameters.write_text("".join(parameter_blocks(name)))
    variables: dict[str, object] = {"__name__": Path(name).stem}
    for code in PROGRAMS[name]:
        beside: AbstractContextManager[None] = nullcontext()
        if "import rclpy" in code:
            pytest.importorskip("rclpy")
            beside = node_beside(parameters, monkeypatch)
        with beside:
            exec(compile(code, name, "exec"), variables)
        expected = re.findall(r"^ *print\(.*\)  # (.*)$", code, re.MULTILINE)
        assert capsys.readouterr().out.splitlines() == expected

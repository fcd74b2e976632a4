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

"""The tree in CONTRIBUTING.md has the folders of the package and the tools, and what they say."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from pages import ROOT, code_blocks

PACKAGE, TOOLS = ROOT / "obb_collision", ROOT / "tools"
ORDER = (
    "numerics", "geometry", "queries", "scene", "robots", "warm_up", "scene_files", "node",
    "demo", "benchmarks",
)  # fmt: skip
"""The layers in the order of their imports; folders within one are sorted by name."""
WIDTH = 22
"""Column of the descriptions."""


def tree() -> list[str]:
    """Return one line per folder: its name, and the first line of its docstring."""

    def order(path: Path) -> tuple[int, Path]:
        top = path.relative_to(PACKAGE).parts
        return (ORDER.index(top[0]) if top else -1, path)

    lines = []
    files = sorted(PACKAGE.rglob("__init__.py"), key=lambda file: order(file.parent))
    for file in (*files, *sorted(TOOLS.rglob("__init__.py"), key=lambda file: file.parent)):
        docstring = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8")))
        assert docstring is not None, file
        depth = len(file.parent.relative_to(ROOT).parts) - 1
        name = f"{'  ' * depth}{file.parent.name}/"
        lines.append(f"{name:<{WIDTH}} {docstring.splitlines()[0]}")
    return lines


def test_the_tree_is_that_of_the_folders() -> None:
    (shown,) = code_blocks(ROOT / "CONTRIBUTING.md", "text")
    assert shown.splitlines() == tree()


def test_every_folder_says_in_one_line_what_it_is() -> None:
    for line in tree():
        assert len(line) <= 100, line
        assert line.endswith("."), line


def test_files_that_are_named_exist_and_those_beside_the_folders_are_named() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = re.findall(r"`((?:obb_collision|test|docs)/[\w./]+)`", text)
    assert "obb_collision/queries/sweep/sweep.py" in named
    for path in named:
        assert (ROOT / path).exists(), path
    for file in set(PACKAGE.glob("*.py")) - {PACKAGE / "__init__.py"}:
        assert f"`{file.name}`" in text, file.name

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

"""The kernel cache: what an edit compiles again, and what a damaged file does."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from obb_collision import _kernel_cache

PACKAGE = Path(_kernel_cache.__file__).resolve().parent
RUN = """
import numpy as np
import obb_collision as oc
from obb_collision.queries import separation

box = oc.OBB([0.25, 0.0, 0.0], np.eye(3), [1.0, 1.0, 1.0])
assert box.separation(oc.OBB([4.0, 0.0, 0.0], np.eye(3), [1.0, 1.0, 1.0])).gap == 1.75
"""


def run(home: Path, code: str = RUN) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(home)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True, timeout=300)


def kernels(home: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in sorted(home.rglob("*.kernel"))}


def modules_of(tree: ast.Module) -> set[str]:
    """Every module or name that a source file imports, by Python's own grammar."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports are not seen by the cache's key"
            found |= {node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)}
    return {name for name in found if name.startswith("obb_collision")}


def test_the_imports_are_those_that_the_grammar_finds() -> None:
    for file in PACKAGE.rglob("*.py"):
        truth = set()
        for name in modules_of(ast.parse(file.read_text())):
            base = PACKAGE.joinpath(*name.split(".")[1:])
            candidates = (base.with_suffix(".py"), base / "__init__.py")
            truth |= {path for path in candidates if path.is_file() and base != PACKAGE}
        found = {path for path in _kernel_cache.imports_of(file) if path.parent != PACKAGE.parent}
        assert truth <= found, file


@pytest.mark.parametrize("damage", ["empty", "zeroed", "garbage", "halved"])
def test_a_damaged_file_is_written_anew(tmp_path: Path, damage: str) -> None:
    run(tmp_path)
    good = kernels(tmp_path)
    assert good
    for path, content in good.items():
        path.write_bytes(
            {
                "empty": b"",
                "zeroed": bytes(len(content)),
                "garbage": os.urandom(len(content)),
                "halved": content[: len(content) // 2],
            }[damage]
        )
    run(tmp_path)
    again = kernels(tmp_path)
    assert again.keys() == good.keys()
    assert all(len(again[path]) > len(content) // 2 for path, content in good.items())


def test_a_second_run_compiles_nothing(tmp_path: Path) -> None:
    run(tmp_path)
    before = {path: path.stat().st_mtime_ns for path in kernels(tmp_path)}
    run(tmp_path)
    assert {path: path.stat().st_mtime_ns for path in kernels(tmp_path)} == before

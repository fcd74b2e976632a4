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

"""The kernel cache: edits, damage, folders that take nothing, and numba without inner parts."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from processes import PATIENCE

import obb_collision._jit as jit
import obb_collision._kernel_cache as kernel_cache
import obb_collision._numba as numba_parts
from obb_collision._kernel_cache import Compiled, compiled

PACKAGE = Path(kernel_cache.__file__).resolve().parent
EXAMPLE = """
from obb_collision._jit import njit

@njit
def helper(x):
    return x + 1.0

@njit
def kernel(x):
    return 2.0 * helper(x)
"""
NAMES = ["example.helper", "example.kernel"]
RUN = f"""
names = {{"__name__": "obb_collision.example"}}
exec({EXAMPLE!r}, names)
assert names["kernel"](1.5) == 5.0
"""


def run(home: Path, code: str, **environment: str) -> str:
    """Run code in a process with a cache of its own; returns what it says on stderr."""
    variables = {**os.environ, "NUMBA_CACHE_DIR": str(home), **environment}
    done = subprocess.run(
        [sys.executable, "-c", code], env=variables, timeout=PATIENCE, capture_output=True,
        text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stderr


def kernels(home: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in sorted(home.rglob("*.kernel"))}


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a copy of the package, and the kernels of one run in ``cache``."""
    folder = tmp_path_factory.mktemp("copied")
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(PACKAGE, folder / PACKAGE.name, ignore=ignored)
    assert run_copied(folder) != []
    return folder


def run_copied(folder: Path) -> list[str]:
    """Use the copy; return the kernels that it compiled."""
    code = """
import obb_collision as oc
from obb_collision._kernel_cache import compiled
oc.Boxes.from_poses([(1, 2, 3, 0, 0, 0, 1)], [(1, 1, 1)])
print(compiled.names)
"""
    variables = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=variables | {"PYTHONPATH": str(folder)},
        timeout=PATIENCE, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    names: list[str] = ast.literal_eval(done.stdout)
    return names


def test_an_edit_that_kernels_do_not_depend_on_compiles_nothing(copied: Path) -> None:
    for file in (copied / PACKAGE.name).rglob("*.py"):
        text = file.read_text()
        edited = re.sub(r'(    """)(\w)', r"\1Edited: \2", f"# a line more\n{text}\nEDITED = 1\n")
        file.write_text(edited)
    assert "Edited: " in (copied / PACKAGE.name / "geometry" / "poses.py").read_text()
    assert run_copied(copied) == []


def test_an_edit_of_a_kernel_compiles_it(copied: Path) -> None:
    file = copied / PACKAGE.name / "geometry" / "poses.py"
    text = file.read_text()
    edited = text.replace("    usual = True\n", "    edited = 0.5\n    usual = True\n")
    assert edited != text
    file.write_text(edited)
    try:
        assert run_copied(copied) == ["geometry.poses._read_kernel"]
    finally:
        file.write_text(text)


def test_another_processor_is_another_file(tmp_path: Path) -> None:
    run(tmp_path, RUN)
    assert len(kernels(tmp_path)) == 2
    run(tmp_path, RUN, NUMBA_CPU_NAME="generic")
    assert len(kernels(tmp_path)) == 4


def forget_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave those of a test out of those of the package."""
    monkeypatch.setattr(jit, "kernels", [])
    monkeypatch.setattr(jit, "caches", [])


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of an empty cache that this process uses."""
    folder = tmp_path / "obb_collision"
    monkeypatch.setattr(kernel_cache, "places", [folder])
    forget_kernels(monkeypatch)
    return folder


def use_example() -> list[str]:
    """Define kernels anew, as another process would, and use them; returns those compiled."""
    before = len(compiled.names)
    exec(RUN)
    return sorted(compiled.names[before:])


def test_folders_that_nobody_used_for_long_are_removed(home: Path) -> None:
    for name, days in {"example.gone-1": 31, "example.other-1": 29}.items():
        (home / name).mkdir(parents=True)
        os.utime(home / name, (0.0, time.time() - 86400.0 * days - 60.0))
    assert use_example() == NAMES
    assert {path.name for path in home.iterdir()} & {"example.gone-1", "example.other-1"} == {
        "example.other-1"
    }


@pytest.mark.parametrize("damage", ["empty", "zeroed", "garbage", "halved", "pipe"])
def test_a_damaged_file_is_written_anew(
    home: Path, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    assert use_example() == NAMES
    good = kernels(home)
    assert len(good) == 2
    for path, content in good.items():
        if damage == "pipe":
            path.unlink()
            os.mkfifo(path)
            continue
        path.write_bytes(
            {
                "empty": b"",
                "zeroed": bytes(len(content)),
                "garbage": os.urandom(len(content)),
                "halved": content[: len(content) // 2],
            }[damage]
        )
    assert use_example() == NAMES
    assert damage == "pipe" or f"kernels in {home} are damaged" in caplog.text
    again = kernels(home)
    assert again.keys() == good.keys()
    assert all(len(again[path]) > len(content) // 2 for path, content in good.items())
    assert use_example() == []


def test_a_second_use_compiles_and_writes_nothing(home: Path) -> None:
    assert use_example() == NAMES
    before = {path: path.stat().st_mtime_ns for path in kernels(home)}
    assert use_example() == []
    assert {path: path.stat().st_mtime_ns for path in kernels(home)} == before


def test_what_only_loads_compiles_nothing(home: Path) -> None:
    before = len(compiled.names)
    with kernel_cache.only_loading(), pytest.raises(kernel_cache.KernelMissingError):
        use_example()
    assert compiled.names[before:] == []
    assert use_example() == NAMES
    with kernel_cache.only_loading():
        assert use_example() == []


FULL = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))  # as a full disk: files end there
"""


def test_a_full_disk_is_said_once_and_stops_nothing(tmp_path: Path) -> None:
    said = run(tmp_path, FULL + RUN + "\nfrom obb_collision import _kernel_cache as cache"
               f"\nassert sorted(cache.unsaved) == {NAMES}")  # fmt: skip
    assert said.count(f"kernels can't be kept in {tmp_path / 'obb_collision'}: File too large") == 1
    assert kernels(tmp_path) == {}
    assert not list(tmp_path.rglob("tmp*"))  # nothing half written is left


def test_a_folder_that_is_a_file_is_said_and_stops_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("")
    folder = tmp_path / "file" / "obb_collision"
    monkeypatch.setattr(kernel_cache, "places", [folder])
    monkeypatch.setattr(kernel_cache, "unsaved", [])
    forget_kernels(monkeypatch)
    assert use_example() == NAMES
    assert kernel_cache.unsaved == NAMES
    assert f"kernels can't be kept in {folder}: Not a directory" in caplog.text


def test_without_a_home_folder_nothing_is_said_and_nothing_stops(tmp_path: Path) -> None:
    said = run(tmp_path, RUN, NUMBA_CACHE_DIR="", XDG_CACHE_HOME="relative", HOME="~")
    assert "kept in" not in said
    assert not Path("~").exists()


def test_a_private_folder_takes_what_the_other_does_not_and_goes_with_the_process(
    tmp_path: Path,
) -> None:
    (tmp_path / "file").write_text("")
    private = tmp_path / "private"
    private.mkdir()
    code = (
        "from obb_collision import _kernel_cache as cache\n"
        "assert cache.private_place() == cache.private_place() == cache.places[-1]\n"
        + RUN
        + "\nassert cache.unsaved == []\nassert list(cache.places[-1].rglob('*.kernel'))"
    )
    run(tmp_path / "file", code, TMPDIR=str(private))
    assert list(private.iterdir()) == []


def test_a_kernel_is_compiled_for_python_and_for_kernels_and_one_for_python_does_for_both(
    home: Path,
) -> None:
    assert use_example() == NAMES  # what Python calls, and its helper
    names: dict[str, Any] = {"__name__": "obb_collision.example"}
    exec(EXAMPLE, names)
    before = len(compiled.names)
    assert names["helper"](1.5) == 2.5
    assert compiled.names[before:] == NAMES[:1], "for Python"
    (home / next(home.glob("example.kernel-*")).name).rename(home / "elsewhere")
    for file in home.glob("example.helper-*/inner-*"):
        file.unlink()
    assert use_example() == NAMES[1:], "the helper for Python does for kernels"


def test_a_number_written_out_is_no_kernel_of_its_own(home: Path) -> None:
    names: dict[str, Any] = {"__name__": "obb_collision.example"}
    exec(
        "from obb_collision._jit import njit\n@njit\ndef inner(x, n):\n"
        "    return x + n\n@njit\ndef outer(x, n):\n"
        "    return inner(x, 1) + inner(x, 2) + inner(x, n)\n",
        names,
    )
    before = len(compiled.names)
    assert names["outer"](0.5, 3) == 7.5
    assert compiled.names[before:].count("example.inner") == 1


def test_compiling_is_logged_on_stderr_and_can_be_silenced(tmp_path: Path) -> None:
    quiet = "import logging; logging.getLogger('obb_collision').setLevel('ERROR')\n"
    eager = "from obb_collision._kernel_cache import compiled; compiled._due = 0.0\n"
    loud = run(
        tmp_path,
        eager.replace("_due = 0.0", "_due = FIRST_LINE").replace(
            "import compiled", "import FIRST_LINE, compiled"
        )
        + "compiled.seconds = 1.0\n"
        + RUN,
    )
    assert loud.startswith("compiling kernels (obb_collision warm-up compiles all beforehand)")
    assert "so far" in loud
    assert run(tmp_path / "other", quiet + eager + RUN) == ""


def test_a_quick_compilation_is_not_worth_a_line(caplog: pytest.LogCaptureFixture) -> None:
    progress = Compiled()
    for seconds in (0.5, 0.9, 1.1, 2.0, 6.0, 6.2, 11.5):
        progress.seconds = seconds
        progress.log()
    assert [line.rpartition(", ")[2] for line in caplog.messages] == ["1 s", "6 s", "12 s"]


@pytest.mark.parametrize("hidden", ["CompileResult", "DefaultOptions", "redirect"])
def test_without_an_inner_part_of_numba_kernels_are_compiled_all_the_same(
    home: Path, hidden: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if hidden == "redirect":

        def hide(of: object, name: str, *default: object) -> Any:
            return None if name == "get_call_template" else getattr(of, name, *default)

        monkeypatch.setattr(numba_parts, "getattr", hide, raising=False)
    else:
        monkeypatch.setattr(numba_parts, hidden, None)
    use_example()
    assert bool(kernels(home)) == (hidden != "CompileResult")
    assert bool(kernel_cache.why_not_kept()) == (hidden == "CompileResult")

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
import logging
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numba
import pytest

from obb_collision import _compiling, _jit, _kernel_cache
from obb_collision._kernel_key import fields_of, kernel_key
from obb_collision.warm_up.steps import possible_steps, task_of

PACKAGE = Path(_kernel_cache.__file__).resolve().parent
RUN = """
import obb_collision as oc

boxes = oc.Boxes.from_poses([(1, 2, 3, 0, 0, 0, 1)], [(1, 1, 1)])
assert boxes.rotations[0].diagonal().tolist() == [1, 1, 1]
"""


def run(home: Path, code: str = RUN, **environment: str) -> str:
    """Run code in a process with a cache of its own; returns what it says on stderr."""
    variables = {**os.environ, "NUMBA_CACHE_DIR": str(home), **environment}
    done = subprocess.run(
        [sys.executable, "-c", code], env=variables, timeout=600, capture_output=True, text=True
    )
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


def run_copied(folder: Path, **environment: str) -> list[str]:
    """Use the copy; return the kernels that it compiled."""
    code = RUN + "\nfrom obb_collision._compiling import compiled\nprint(compiled.names)"
    variables = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache"), **environment}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=variables | {"PYTHONPATH": str(folder)},
        timeout=600, capture_output=True, text=True,
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
    edited = re.sub(r"(def _fill_matrices\(.*\n)", r"\1    edited = 0.5\n", text)
    assert edited != text
    file.write_text(edited)
    try:
        assert run_copied(copied) == ["geometry.poses._fill_matrices"]
    finally:
        file.write_text(text)


@pytest.mark.parametrize(
    "flag", [{"NUMBA_BOUNDSCHECK": "1"}, {"NUMBA_OPT": "1"}, {"NUMBA_CPU_NAME": "generic"}]
)
def test_bounds_checks_optimisation_and_the_processor_are_in_the_key(
    copied: Path, flag: dict[str, str]
) -> None:
    assert run_copied(copied, **flag) != []


KERNEL = """
from typing import NamedTuple
import numpy as np
from obb_collision._jit import njit

class Point(NamedTuple):
    x: float
    y: float

FACTOR = 2.0
STEPS = (1, 2)
ARRAY = np.array([1.0, 2.0])

@njit
def helper(x):
    return x + 1.0

@njit
def kernel(x):
    'Return something.'
    return Point(helper(x) * FACTOR + 0.25, ARRAY[STEPS[0]])
"""


def key_of(source: str) -> str:
    names: dict[str, Any] = {"__name__": "obb_collision.example"}
    exec(source, names)
    return kernel_key(names["kernel"])


@pytest.mark.parametrize(
    ("before", "after", "same"),
    [
        ("Return something.", "Return something else.", True),
        ("import numpy", "# a comment\nimport numpy", True),
        ("FACTOR = 2.0", "OTHER = 1\nFACTOR = 2.0", True),
        ("FACTOR = 2.0", "FACTOR = 2.0000000000000004", False),
        ("STEPS = (1, 2)", "STEPS = (1, 3)", False),
        ("1.0, 2.0]", "1.0, 3.0]", False),
        ("x + 1.0", "x + 2.0", False),
        ("x + 1.0", "x - 1.0", False),
        ("0.25", "0.5", False),
        ("    x: float\n    y: float", "    y: float\n    x: float", False),
    ],
)
def test_the_key_has_what_a_kernel_depends_on(
    before: str, after: str, same: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_jit, "kernels", [])
    assert before in KERNEL
    assert (key_of(KERNEL) == key_of(KERNEL.replace(before, after, 1))) == same


def test_what_a_key_cannot_be_made_of_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_jit, "kernels", [])
    with pytest.raises(TypeError, match="depends on a dict"):
        key_of(KERNEL.replace("STEPS = (1, 2)", "STEPS = {0: 1}"))


def test_every_kernel_has_a_key_of_its_own() -> None:
    for step in possible_steps():
        task_of(step)  # imports its kernels
    keys = {kernel_key(kernel) for kernel in _jit.kernels}
    assert len(keys) == len(_jit.kernels) > 250


def test_fields_in_another_order_are_another_signature() -> None:
    def signature(*fields: str) -> Any:
        make: Any = NamedTuple
        point = make("Point", [(field, float) for field in fields])
        return numba.typeof((point(1.0, 2.0), 1))

    first, second = signature("x", "y"), signature("y", "x")
    assert str(first) == str(second)
    assert fields_of(first) != fields_of(second)
    assert fields_of(first) == fields_of(signature("x", "y"))


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
    said = run(tmp_path)
    assert f"kernels in {tmp_path / 'obb_collision'} are damaged" in said
    again = kernels(tmp_path)
    assert again.keys() == good.keys()
    assert all(len(again[path]) > len(content) // 2 for path, content in good.items())


def test_a_second_run_compiles_nothing(tmp_path: Path) -> None:
    run(tmp_path)
    before = {path: path.stat().st_mtime_ns for path in kernels(tmp_path)}
    assert run(tmp_path) == ""
    assert {path: path.stat().st_mtime_ns for path in kernels(tmp_path)} == before


FULL = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))  # as a full disk: files end there
"""


def test_a_full_disk_is_said_once_and_stops_nothing(tmp_path: Path) -> None:
    said = run(tmp_path, FULL + RUN + "\nfrom obb_collision import _kernel_cache as cache"
               "\nassert 'geometry.poses._fill_matrices' in cache.unsaved")  # fmt: skip
    assert said.count(f"kernels can't be kept in {tmp_path / 'obb_collision'}: File too large") == 1
    assert kernels(tmp_path) == {}
    assert not list(tmp_path.rglob("tmp*"))  # nothing half written is left


@pytest.mark.parametrize("home", ["a file", "no place for one"])
def test_a_folder_that_cannot_be_is_said_and_stops_nothing(tmp_path: Path, home: str) -> None:
    (tmp_path / "a file").write_text("")
    if home == "a file":
        said = run(tmp_path / home)
        assert f"kernels can't be kept in {tmp_path / home / 'obb_collision'}" in said
    else:
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


HOLDING = """
import sys
from obb_collision import _kernel_cache as cache
print(cache.private_place(), flush=True)
sys.stdin.read()
"""


def test_private_folders_are_removed_once_their_processes_are_gone(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    link, young = tmp_path / "obb_collision-kernels-link", tmp_path / "obb_collision-kernels-young"
    link.symlink_to(elsewhere)
    young.mkdir()
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    started = [
        subprocess.Popen(
            [sys.executable, "-c", HOLDING],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(2)
    ]
    try:
        killed, alive = (Path(process.stdout.readline().strip()) for process in started)  # type: ignore[union-attr]
        started[0].kill()
        started[0].wait(60.0)
        for folder in (killed, alive):
            assert folder.is_dir()
            os.utime(folder, (0.0, 0.0))
        run(tmp_path, "from obb_collision._kernel_cache import drop_left_places as drop; drop()",
            TMPDIR=str(tmp_path))  # fmt: skip
        assert not killed.exists()
        assert alive.is_dir()
        assert young.is_dir()
        assert elsewhere.is_dir()
        started[1].communicate(timeout=60.0)
        assert not alive.exists()
    finally:
        for process in started:
            process.kill()
            process.communicate()


def test_a_thread_that_only_loads_compiles_nothing(tmp_path: Path) -> None:
    code = f"""
from obb_collision import _kernel_cache as cache
from obb_collision._compiling import compiled
missing = ""
try:
    with cache.only_loading():
        exec({RUN!r})
except cache.KernelMissingError as error:
    missing = str(error)
assert compiled.names == []
"""
    run(tmp_path, code + "assert missing")
    run(tmp_path)
    run(tmp_path, code + "assert not missing")


def test_compiling_is_said_after_a_second_and_can_be_silenced(tmp_path: Path) -> None:
    slow = "from obb_collision import _compiling\n_compiling.FIRST_WORD = 0.0\n"
    slow += "_compiling.compiled.say = _compiling.Words()\n"
    said = run(tmp_path / "first", slow + RUN)
    assert said.startswith("compiling kernels (obb_collision_warm_up compiles all beforehand)")
    assert "so far" in said
    silent = "import logging\nlogging.getLogger('obb_collision').setLevel('ERROR')\n"
    assert run(tmp_path / "second", silent + slow + RUN) == ""


def test_a_quick_compilation_is_not_worth_a_word() -> None:
    words, said = _compiling.Words(), []
    handler = logging.Handler()
    handler.emit = lambda record: said.append(record.getMessage())  # type: ignore[method-assign]
    _kernel_cache.logger.addHandler(handler)
    try:
        for seconds in (0.5, 0.9, 1.1, 2.0, 6.0, 6.2, 11.5):
            words(SimpleNamespace(seconds=seconds, names=["a"]))  # type: ignore[arg-type]
    finally:
        _kernel_cache.logger.removeHandler(handler)
    assert [line.rpartition(", ")[2] for line in said] == ["1 s", "6 s", "12 s"]

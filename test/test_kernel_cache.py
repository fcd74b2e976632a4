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

"""The kernel cache: keys, edits, damage, folders that take nothing, numba without inner parts."""

from __future__ import annotations

import ast
import os
import pickle
import re
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import bounds_checks
import numba
import pytest
from each import each
from processes import Done, run_python

import obb_collision._jit as jit
import obb_collision._kernel_cache as kernel_cache
import obb_collision._numba as numba_parts
from obb_collision._kernel_cache import FLAGS, Compiled, compiled, config, fields_of, kernel_key
from obb_collision.warm_up.steps import possible_steps, task_of

PACKAGE = Path(kernel_cache.__file__).resolve().parent
EXAMPLE = """
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
    point = Point(helper(x) * FACTOR + 0.25, ARRAY[STEPS[0]])
    return point.x + point.y
"""
#: Neither root nor who runs the tests.
OTHER_USER = 54321
NAMES = ["example.helper", "example.kernel"]
RUN = f"""
names = {{"__name__": "obb_collision.example"}}
exec({EXAMPLE!r}, names)
assert names["kernel"](1.5) == 7.25
"""


def run(home: Path, code: str, **environment: str) -> Done:
    """Run code in a process with a cache of its own."""
    return run_python("-c", code, NUMBA_CACHE_DIR=str(home), **environment)


def kernels(home: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in sorted(home.rglob("*.kernel"))}


USE = """
from obb_collision._kernel_cache import compiled
from obb_collision.geometry.poses import as_poses
as_poses([(1, 2, 3, 0, 0, 0, 1)])
print(compiled.names)
"""
EDIT = "    usual = True\n", "    edited = 0.5\n    usual = True\n"


def test_an_edit_compiles_what_depends_on_it_and_nothing_else(tmp_path: Path) -> None:
    package = tmp_path / PACKAGE.name
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))

    def compiled_now() -> list[str]:
        code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}){USE}"
        names: list[str] = ast.literal_eval(run(tmp_path / "cache", code).stdout)
        return names

    assert len(compiled_now()) > 1
    for file in package.rglob("*.py"):
        text = file.read_text()
        edited = re.sub(r'(    """)(\w)', r"\1Edited: \2", f"# a line more\n{text}\nEDITED = 1\n")
        file.write_text(edited.replace(*EDIT))
    text = (package / "geometry" / "poses.py").read_text()
    assert "Edited: " in text
    assert EDIT[1] in text
    assert compiled_now() == ["geometry.poses._read_kernel"]


@pytest.fixture(autouse=True)
def _own_kernels() -> Iterator[None]:
    """Leave those of a test out of those of the package."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jit, "kernels", [*jit.kernels])
        patch.setattr(jit, "caches", [*jit.caches])
        yield


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of an empty cache that this process uses."""
    folder = tmp_path / "obb_collision"
    monkeypatch.setattr(kernel_cache, "places", [folder])
    return folder


def defined(source: str) -> dict[str, Any]:
    """Return the names of a module with this source."""
    names: dict[str, Any] = {"__name__": "obb_collision.example"}
    exec(source, names)
    return names


def use_example() -> list[str]:
    """Define kernels anew, as another process would, and use them; returns those compiled."""
    before = len(compiled.names)
    assert defined(EXAMPLE)["kernel"](1.5) == 7.25
    return sorted(compiled.names[before:])


def test_folders_that_nobody_used_for_long_are_removed(home: Path) -> None:
    gone, other = home / "example.gone-1", home / "example.other-1"
    for folder, days in ((gone, 31), (other, 29)):
        folder.mkdir(parents=True)
        os.utime(folder, (0.0, time.time() - 86400.0 * days - 60.0))
    assert use_example() == NAMES
    assert (gone.exists(), other.exists()) == (False, True)


@pytest.mark.parametrize("damage", ["empty", "zeroed", "garbage", "halved", "pipe"])
def test_damage_is_written_over(home: Path, damage: str, caplog: pytest.LogCaptureFixture) -> None:
    assert use_example() == NAMES
    good = kernels(home)
    assert len(good) == 2
    for path, content in good.items():
        size = len(content)
        path.unlink()
        if damage == "pipe":
            os.mkfifo(path)
            continue
        halved, garbage = content[: size // 2], os.urandom(size)
        damaged = {"empty": b"", "zeroed": bytes(size), "garbage": garbage, "halved": halved}
        path.write_bytes(damaged[damage])
    assert use_example() == NAMES
    assert damage == "pipe" or f"kernels in {home} are damaged" in caplog.text
    again = kernels(home)
    assert again.keys() == good.keys()
    assert all(len(again[path]) > len(content) // 2 for path, content in good.items())
    assert use_example() == []


def give_away(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a file or folder belong to another user."""
    if os.geteuid() == 0:
        os.chown(path, OTHER_USER, -1)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: OTHER_USER)


OWNED = {"another user's": (None, None), "all may write": (0o757, None), "group": (0o775, 12345)}


@pytest.mark.parametrize("how", OWNED)
@pytest.mark.parametrize("what", ["cache", "folder", "file"])
def test_what_somebody_else_may_have_written_is_not_executed(
    home: Path, what: str, how: str, monkeypatch: pytest.MonkeyPatch, caplog: Any
) -> None:
    assert use_example() == NAMES
    files = [*kernels(home)]
    mode, group = OWNED[how]
    for path in {"cache": [home], "folder": [file.parent for file in files], "file": files}[what]:
        if mode is None:
            give_away(path, monkeypatch)
        else:
            path.chmod(mode)
        if group is not None:
            monkeypatch.setattr(os, "getegid", lambda: group)
    assert not jit.caches[-1].is_kept
    executed: list[object] = []
    monkeypatch.setattr(pickle, "loads", executed.append)
    assert use_example() == NAMES
    assert not executed
    assert f"kernels in {home} are not used: " in caplog.text
    assert ("another user" in caplog.text) == (mode is None)
    if what == "cache":
        assert str(home) in kernel_cache.why_not_kept()
    monkeypatch.undo()
    if what == "file":  # written anew, and one's own
        assert {path.stat().st_uid for path in files} == {os.geteuid()}
        assert all(path.stat().st_mode & 0o077 == 0 for path in files)


def test_a_group_of_ones_own_may_write_as_it_does_with_umask_002(home: Path) -> None:
    before = os.umask(0o002)
    try:
        assert use_example() == NAMES
    finally:
        os.umask(before)
    for folder in (home, *home.iterdir()):
        folder.chmod(0o775)
    assert use_example() == []


def test_no_umask_makes_a_cache_that_all_may_write(home: Path) -> None:
    before = os.umask(0)
    try:
        assert use_example() == NAMES
    finally:
        os.umask(before)
    assert use_example() == []


@pytest.mark.skipif(os.geteuid() != 0, reason="as root only: sudo -E")
def test_root_leaves_nothing_in_the_home_of_a_user(tmp_path: Path) -> None:
    os.chown(tmp_path, OTHER_USER, -1)
    for folder in (tmp_path, tmp_path / ".cache"):  # the second one is there already
        done = run_python("-c", RUN, HOME=str(tmp_path), XDG_CACHE_HOME="", NUMBA_CACHE_DIR="")
        assert done.returncode == 0, done.stderr
        assert f"{folder} belongs to another user" in done.stderr
        assert [path for path in tmp_path.rglob("*") if path.stat().st_uid == 0] == []
        (tmp_path / ".cache").mkdir(exist_ok=True)
        os.chown(tmp_path / ".cache", OTHER_USER, -1)


class HandlerError(Exception):
    """What a handler of a signal raises."""


def raise_error(*_: object) -> None:
    raise HandlerError


@pytest.mark.parametrize("is_damaged", [False, True])
def test_what_a_handler_of_a_signal_raises_while_a_kernel_loads_is_not_lost(
    home: Path, is_damaged: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert use_example() == NAMES
    load, signals = pickle.loads, iter([signal.SIGUSR1])

    def interrupted(content: bytes) -> object:
        for number in signals:
            signal.raise_signal(number)
        return pickle.UnpicklingError if is_damaged else load(content)

    monkeypatch.setattr(pickle, "loads", interrupted)
    before = signal.signal(signal.SIGUSR1, raise_error)
    try:
        with pytest.raises(HandlerError):
            use_example()
    finally:
        signal.signal(signal.SIGUSR1, before)
    monkeypatch.undo()
    monkeypatch.setattr(kernel_cache, "places", [home])
    assert use_example() == []


def test_loading_compiles_nothing_and_a_second_use_neither_compiles_nor_writes(home: Path) -> None:
    before = len(compiled.names)
    with kernel_cache.only_loading(), pytest.raises(kernel_cache.KernelMissingError):
        use_example()
    assert compiled.names[before:] == []
    assert use_example() == NAMES
    written = {path: path.stat().st_mtime_ns for path in kernels(home)}
    with kernel_cache.only_loading():
        assert use_example() == []
    assert use_example() == []
    assert {path: path.stat().st_mtime_ns for path in kernels(home)} == written


FULL = f"""
import resource
from pathlib import Path
from obb_collision import _kernel_cache as cache
_, most = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, most))  # as a full disk: files end there
{RUN}
assert sorted(cache.unsaved) == {NAMES}
assert not [path for path in cache.places[0].rglob("*") if path.is_file()], "half written"
resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
cache.unsaved.clear()
cache.places[:] = [Path(__import__("sys").executable) / "cache"]
assert cache.private_place() == cache.private_place() == cache.places[-1]
{RUN}
assert cache.unsaved == []
assert list(cache.places[-1].rglob("*.kernel"))
"""


def test_a_full_disk_is_said_once_and_a_private_folder_takes_kernels_then(tmp_path: Path) -> None:
    private = tmp_path / "private"
    private.mkdir()
    said = run(tmp_path, FULL, TMPDIR=str(private)).stderr
    assert said.count(f"kernels can't be kept in {tmp_path / 'obb_collision'}: File too large") == 1
    assert kernels(tmp_path) == {}
    assert list(private.iterdir()) == []


def test_a_folder_that_is_a_file_is_said_and_none_is_not_and_neither_stops_anything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(kernel_cache.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", "~")
    assert kernel_cache.cache_home() is None
    monkeypatch.setattr(kernel_cache, "places", [])
    assert use_example() == NAMES
    assert "kept in" not in caplog.text
    (tmp_path / "file").write_text("")
    folder = tmp_path / "file" / "obb_collision"
    monkeypatch.setattr(kernel_cache, "places", [folder])
    monkeypatch.setattr(kernel_cache, "unsaved", [])
    assert use_example() == NAMES
    assert kernel_cache.unsaved == NAMES
    assert f"kernels can't be kept in {folder}: Not a directory" in caplog.text


def test_a_kernel_for_python_does_for_kernels_too_but_not_the_other_way_round(home: Path) -> None:
    assert use_example() == NAMES  # what Python calls, and its helper
    before = len(compiled.names)
    assert defined(EXAMPLE)["helper"](1.5) == 2.5
    assert compiled.names[before:] == NAMES[:1], "for Python"
    (home / next(home.glob("example.kernel-*")).name).rename(home / "elsewhere")
    for file in home.glob("example.helper-*/inner-*"):
        file.unlink()
    assert use_example() == NAMES[1:], "the helper for Python does for kernels"


def test_a_number_written_out_is_no_kernel_of_its_own(home: Path) -> None:
    outer = "\n@njit\ndef outer(x, n):\n    return inner(x, 1) + inner(x, 2) + inner(x, n)\n"
    before = len(compiled.names)
    source = EXAMPLE + "@njit\ndef inner(x, n):\n    return x + n\n" + outer
    assert defined(source)["outer"](0.5, 3) == 7.5
    assert compiled.names[before:].count("example.inner") == 1


LOGGED = f"""
import logging
from obb_collision._kernel_cache import FIRST_LINE, compiled
compiled._due, compiled.seconds = FIRST_LINE, 1.0
{RUN}
logging.getLogger('obb_collision').setLevel('ERROR')
compiled._due = 0.0
{RUN.replace("0.25", "0.5").replace("7.25", "7.5")}
assert compiled.names.count("example.kernel") == 2
"""


def test_compiling_is_logged_and_silenced_and_another_processor_is_another_file(home: Path) -> None:
    use_example()
    assert len(kernels(home)) == 2
    loud = run(home.parent, LOGGED, NUMBA_CPU_NAME="generic").stderr
    assert loud.startswith("compiling kernels (obb_collision warm-up compiles all beforehand)")
    assert loud.count("so far") == 1
    assert len(kernels(home)) == 5


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


def key_of(source: str) -> str:
    return kernel_key(defined(source)["kernel"])


@each("before, after, same", [
    ("Return something.", "Return something else.", True),
    ("import numpy", "# a comment\nimport numpy", True),
    ("FACTOR = 2.0", "OTHER = 1\nFACTOR = 2.0", True),
    ("FACTOR = 2.0", "FACTOR = 2.0000000000000004", False),
    ("STEPS = (1, 2)", "STEPS = (1, 3)", False), ("1.0, 2.0]", "1.0, 3.0]", False),
    ("x + 1.0", "x + 2.0", False), ("x + 1.0", "x - 1.0", False), ("0.25", "0.5", False),
    ("    x: float\n    y: float", "    y: float\n    x: float", False),
])  # fmt: skip
def test_the_key_has_what_a_kernel_depends_on(before: str, after: str, same: bool) -> None:
    assert before in EXAMPLE
    assert (key_of(EXAMPLE) == key_of(EXAMPLE.replace(before, after, 1))) == same
    with pytest.raises(TypeError, match="depends on a dict"):
        key_of(EXAMPLE.replace("STEPS = (1, 2)", "STEPS = {0: 1}"))


@each("flag", FLAGS)
def test_the_key_has_the_settings_of_numba(flag: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = key_of(EXAMPLE)
    monkeypatch.setattr(config, flag, "another", raising=False)
    assert key_of(EXAMPLE) != before


def test_every_kernel_has_a_key_of_its_own() -> None:
    for step in possible_steps():
        task_of(step)  # imports its kernels
    keys = {kernel_key(kernel) for kernel in jit.kernels}
    assert len(keys) == len(jit.kernels) > 250


def test_fields_in_another_order_are_another_signature() -> None:
    def signature(*fields: str) -> Any:
        make: Any = NamedTuple
        point = make("Point", [(field, float) for field in fields])
        return numba.typeof((point(1.0, 2.0), 1))

    first, second = signature("x", "y"), signature("y", "x")
    assert str(first) == str(second)
    assert fields_of(first) != fields_of(second)
    assert fields_of(first) == fields_of(signature("x", "y"))
    assert fields_of(jit.HeldType([("value", first)])) == (fields_of(first),)


ACCESS = """
import numpy as np
from obb_collision.numerics.vec3 import fill_lengths

lengths = np.zeros(3)
try:
    fill_lengths(np.ones((3, 3)), lengths[:2])
    print(round(lengths[2] ** 2, 9))
except Exception as error:
    print(f"{type(error).__name__}: {error}")
"""
CAUGHT = """
import pytest
from bounds_checks import none_out_of_bounds

with pytest.raises(AssertionError, match="accesses out of bounds, called from"):
    with none_out_of_bounds():
        try:
            fill_lengths(np.ones((3, 3)), np.zeros(3)[:2])
        except IndexError:
            pass
"""


def test_accesses_out_of_bounds_raise_with_the_flag_and_are_found_if_caught(tmp_path: Path) -> None:
    assert run(tmp_path, ACCESS, NUMBA_BOUNDSCHECK="0").stdout == "3.0\n"
    path = f"import sys; sys.path.append({str(Path(bounds_checks.__file__).parent)!r})"
    caught = path + CAUGHT if sys.version_info >= (3, 12) else ""  # it needs sys.monitoring
    for more in ("", caught):  # compiled, whatever the cache has without the flag, and from it
        checked = run(tmp_path, ACCESS + more, NUMBA_BOUNDSCHECK="1")
        assert checked.stdout == "IndexError: index is out of bounds\n"

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

"""What is said about compiling, and when."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

from processes import PATIENCE

from obb_collision import _compiling, _kernel_cache

PROGRAM = """
import logging, sys
from obb_collision import _compiling
from obb_collision._jit import njit

__name__ = "obb_collision.example"
_compiling.FIRST_WORD = 0.0
for level, add in (("WARNING", "1.0"), ("ERROR", "2.0")):
    _compiling.compiled.say = _compiling.Words()
    logging.getLogger("obb_collision").setLevel(level)
    njit(eval("lambda x: x + " + add))(1.0)
    sys.stderr.write("end of " + level + "\\n")
assert len(_compiling.compiled.names) == 2
"""


def test_compiling_is_said_on_stderr_and_can_be_silenced(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    said, silent = done.stderr.split("end of WARNING\n")
    assert said.startswith("compiling kernels (obb_collision warm-up compiles all beforehand)")
    assert "so far" in said
    assert silent == "end of ERROR\n"


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

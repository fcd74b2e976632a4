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

"""Nothing that is handed to the library ends the process, or is read out of bounds."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

import obb_collision as oc

HERE = Path(__file__).parent


#: One case in so many is run; all of them take a minute or two.
@pytest.mark.parametrize("step", [8, pytest.param(1, marks=pytest.mark.slow)])
def test_hostile_arguments_are_answered_or_refused(step: int) -> None:
    """In a process of its own: what it was doing when it ended is in the last line."""
    source = str(Path(oc.__file__).parents[1])
    ran = subprocess.run(
        [sys.executable, str(HERE / "hostile_arguments.py"), str(step)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join((source, str(HERE / "support")))},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    lines = ran.stdout.splitlines()
    failed = [f"{case}: {line}" for case, line in pairwise(lines) if line.startswith("FAILED")]
    assert failed == []
    assert ran.returncode == 0, f"ended by {ran.returncode} in {lines[-1:]}: {ran.stderr[-2000:]}"
    assert lines[-1].startswith("done ")
    assert len(lines) > 12000 // step

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

"""Ctrl-C ends every benchmark with one line and the exit code that shells have for it."""

from __future__ import annotations

import argparse
import select
import signal
import subprocess
import sys
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

import obb_collision

PACKAGE = Path(obb_collision.__file__).parent
MAINS = [
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
    for path in sorted((PACKAGE / "benchmarks").rglob("*.py"))
    if "def main(" in path.read_text()
]
PATIENCE = 300.0
AGAIN = 10.0
"""Seconds after which somebody presses Ctrl-C again."""


@pytest.mark.parametrize("module", MAINS)
def test_an_interrupt_is_one_line_and_exit_code_130(
    module: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if module.endswith("latency") and not find_spec("rclpy"):
        pytest.skip("needs ROS")
    main = import_module(module).main

    def interrupted(*args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", interrupted)
    assert main([]) == 130
    assert capsys.readouterr().err.endswith(f"{module.rpartition('.')[2]}: interrupted\n")


def test_a_signal_ends_a_benchmark_that_runs() -> None:
    code = (  # where SIGINT is ignored, as in the background of a shell, Python leaves it at that
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from tools.wrong_answers import main; "
        "raise SystemExit(main(['--pairs', '200000']))"
    )
    command = [sys.executable, "-c", code]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        try:
            begun, _, _ = select.select([process.stderr], [], [], PATIENCE)  # the bar: it runs
            said = None
            while said is None:  # an interrupt within a callback is lost
                process.send_signal(signal.SIGINT)
                with suppress(subprocess.TimeoutExpired):
                    _, said = process.communicate(timeout=AGAIN)
        finally:
            process.kill()
    assert begun
    assert process.returncode == 130
    assert said.splitlines()[-1] == "python -m tools.wrong_answers: interrupted"
    assert "Traceback" not in said

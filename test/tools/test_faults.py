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

"""Faults around a node in another process: the code of ``python -m tools.faults``."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from tools.faults import __main__ as command
from tools.faults.__main__ import BY_NAME, FAULTS, Fault, Outcome, attempt
from tools.faults.bench import Bench, FaultError

SHORT = ("little-memory",)
"""Faults that are made at every run of the tests; the others take minutes together."""
DOMAIN = 1 + os.getpid() % 100


@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(fault, marks=() if fault.name in SHORT else pytest.mark.slow, id=fault.name)
        for fault in FAULTS
    ],
)
def test_a_node_does_what_is_expected(fault: Fault) -> None:
    with ProcessPoolExecutor(1, get_context("spawn")) as apart:  # with participants of its own only
        outcome = apart.submit(attempt, fault, DOMAIN).result()
    assert outcome.held, outcome.seen


def test_names_and_descriptions_are_distinct() -> None:
    assert len(BY_NAME) == len({fault.what for fault in FAULTS}) == len(FAULTS)
    assert all(fault.what.endswith(".") for fault in FAULTS)


def test_the_page_has_every_fault_and_none_that_failed() -> None:
    page = Path(__file__).parents[2] / "docs" / "faults.md"
    rows = [line for line in page.read_text(encoding="utf-8").splitlines() if line[:3] == "| `"]
    assert [row.split("`")[1] for row in rows] == list(BY_NAME)
    assert not any("not as expected" in row for row in rows)


def fails(bench: Bench) -> str:
    """Fail."""
    raise FaultError("nothing | at all")


def test_rows_of_other_faults_stay_and_failures_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = FAULTS[:2]
    page = tmp_path / "page.md"
    page.write_text("# Title\n\nText.\n")
    command.write_table(page, [Outcome(second, "seen", held=True, seconds=2.0)])
    monkeypatch.setitem(BY_NAME, first.name, first._replace(make=fails))
    assert command.main(["--only", first.name, "--markdown", str(page)]) == 1
    assert "NOT AS EXPECTED" in capsys.readouterr().out
    lines = page.read_text().splitlines()
    assert lines[:3] == ["# Title", "", "Text."]
    rows = [line for line in lines if line.startswith("| `")]
    assert [row.split("`")[1] for row in rows] == [first.name, second.name]
    assert "**not as expected**: nothing / at all" in rows[0]
    assert rows[1].endswith("| seen |")

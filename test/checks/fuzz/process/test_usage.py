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

"""Growth of a process: that of its last samples over those after warm-up."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from tools.fuzz.process.child import Child, Usage
from tools.fuzz.process.usage import FEWEST, Usages
from tools.fuzz.report import faults
from tools.fuzz.session.result import Result

MEGABYTE = 10**6


def grown(by: Usage, samples: int = 100) -> Usages:
    """Return samples of a process that grows evenly."""
    usages = Usages()
    for number in range(samples):
        usages.add(Usage(*(round(one * number / samples) for one in by)))
    return usages


def test_what_grows_is_found_and_what_warms_up_is_not() -> None:
    result = Result(usages=grown(Usage(100 * MEGABYTE, 0, 0)))
    assert faults(result, 61.0) == []
    assert faults(result, 59.0) == ["its memory grew by 60.0 MB"]
    leaking = faults(Result(usages=grown(Usage(0, 20, 0))), 1.0)
    assert leaking == ["it grew by 12 descriptors, 0 threads"]
    warm = Usages()
    for number in range(100):
        warm.add(Usage(MEGABYTE * min(number, 15), 5, 5))
    assert faults(Result(usages=warm), 1.0) == []


def test_the_course_of_memory_has_a_number_for_each_tenth() -> None:
    assert grown(Usage(100 * MEGABYTE, 0, 0)).course() == [
        (10 * tenth + 4.5) * MEGABYTE for tenth in range(10)
    ]


def test_few_samples_say_nothing() -> None:
    assert grown(Usage(10**9, 9, 9), FEWEST - 1).growth() is None


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="only Linux says it")
def test_a_process_is_measured(tmp_path: Path) -> None:
    child = Child(["-c", "0"], 1, tmp_path / "log", module="pdb")
    try:
        usage, delays = child.usage(), child.delays()
        assert usage is not None
        assert usage.memory > 0
        assert usage.descriptors >= 1
        assert usage.threads == 1
        assert min(delays.values(), default=0.0) >= 0.0
    finally:
        child.end()
    assert child.usage() is None
    assert child.delays() == {}

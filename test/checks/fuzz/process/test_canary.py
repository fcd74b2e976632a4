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

"""A process that says when it stood still."""

from __future__ import annotations

import os
import signal
import time

import pytest

from tools.fuzz.process import canary


class EndError(Exception):
    """Ends a canary."""


def lines_of(monkeypatch: pytest.MonkeyPatch, slept: list[float]) -> list[bytes]:
    """Return what a canary says whose sleeps last so long (s)."""
    now, said, left = 1000.0, list[bytes](), iter(slept)

    def sleep(seconds: float) -> None:
        nonlocal now
        try:
            now += next(left)
        except StopIteration:
            raise EndError from None

    monkeypatch.setattr(time, "time", lambda: now)
    monkeypatch.setattr(time, "sleep", sleep)
    monkeypatch.setattr(os, "write", lambda file, line: said.append(line))
    with pytest.raises(EndError):
        canary.main()
    assert said.pop(0) == b"awake\n"
    return said


def test_only_long_sleeps_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    said = lines_of(monkeypatch, [canary.NAP, 0.5, canary.NAP + canary.LATE / 2])
    assert [tuple(map(float, line.split())) for line in said] == [(1000.01, 1000.505)]


def long_ones(found: list[tuple[float, float]]) -> list[tuple[float, float]]:
    return [(start, end) for start, end in found if end - start > 0.15]


def test_a_process_that_is_stopped_stood_still() -> None:
    bird, found = canary.Canary(), list[tuple[float, float]]()
    try:
        for _ in range(20):  # it may be stopped before it slept at all: then once more
            os.kill(bird.number, signal.SIGSTOP)
            stopped = time.monotonic()
            while time.monotonic() < stopped + 0.2:
                found += bird.stalls()
            os.kill(bird.number, signal.SIGCONT)
            going = time.monotonic()
            while time.monotonic() < going + 1.0 and not long_ones(found):
                found += bird.stalls()
            if long_ones(found):
                break
        assert long_ones(found)
        assert all(start < end <= time.time() for start, end in found)
    finally:
        bird.close()

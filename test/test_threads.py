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

"""Kernels on several threads: the same bits, no hang, no thread where none is wanted."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from each import each
from processes import run_python
from support import refused

import obb_collision as oc
from obb_collision._kernel_cache import KernelMissingError, only_loading
from obb_collision._threads import VARIABLE, ranges, run, run_parts


@pytest.fixture(autouse=True)
def _restore() -> Iterator[None]:
    yield
    oc.set_threads(None)


@each("number", [1, 2, 3, 5])
def test_ranges_are_all_rows_in_order_and_so_are_results(number: int) -> None:
    oc.set_threads(number)
    for count in (0, 1, 7, 64, 1001):
        parts = ranges(count, 8)
        assert [row for part in parts for row in range(*part)] == list(range(count))
        assert len(parts) == 1 or min(stop - start for start, stop in parts) >= 8
        assert len(parts) == 1 or number > 1
    out = np.zeros(1000, np.int64)

    def kernel(start: int, stop: int) -> int:
        out[start:stop] += 1
        return start

    starts = run(kernel, 1000, 10)
    assert starts == sorted(starts)
    assert (out == 1).all()


def test_few_rows_start_no_thread_two_work_at_once_and_all_is_done_where_all_are_busy() -> None:
    oc.set_threads(4)
    names = run(lambda start, stop: threading.current_thread().name, 10, 100)
    assert names == [threading.current_thread().name]
    oc.set_threads(2)
    both = threading.Barrier(2)
    numbers = run_parts(lambda part: (both.wait(60), threading.get_ident())[1], 2)
    assert len(set(numbers)) == 2
    assert run_parts(lambda _: run_parts(lambda part: part, 5), 3) == [[0, 1, 2, 3, 4]] * 3


def test_what_a_part_raises_is_raised_by_the_call() -> None:
    oc.set_threads(3)
    for bad in range(6):

        def call(part: int, bad: int = bad) -> None:
            if part == bad:
                raise KeyError(part)

        with pytest.raises(KeyError, match=str(bad)):
            run_parts(call, 6)


def test_after_an_interrupt_no_part_runs_any_more() -> None:
    oc.set_threads(2)
    first, interrupted, returned, ended = (threading.Event() for _ in range(4))
    main = threading.get_ident()
    late: list[bool] = []

    def interrupt(*_: object) -> None:
        interrupted.set()
        raise KeyboardInterrupt

    def call(_: int) -> None:
        both.wait(60)
        if threading.get_ident() == main:
            first.set()
            return
        first.wait(60)
        signal.pthread_kill(main, signal.SIGINT)
        while not interrupted.wait(1.0):  # it came just before the main thread began to wait
            signal.pthread_kill(main, signal.SIGINT)
        late.append(returned.wait(0.2))  # a part that still runs
        ended.set()

    both = threading.Barrier(2)
    before = signal.signal(signal.SIGINT, interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            run_parts(call, 2)
    finally:
        signal.signal(signal.SIGINT, before)
        returned.set()
    assert ended.wait(60)
    assert late == [False]


def test_a_kernel_is_loaded_in_the_calling_thread_before_others_use_it() -> None:
    oc.set_threads(2)
    threads: list[int] = []

    def kernel(start: int, stop: int) -> None:
        threads.append(threading.get_ident())
        if len(threads) == 1:
            raise KernelMissingError("kernel")

    with only_loading(), pytest.raises(KernelMissingError):
        run(kernel, 100, 10)
    assert threads == [threading.get_ident()]


@each("number", [0, -1, 1025, 1.0, True, "2", 10**400])
def test_a_bad_number_is_refused(number: int) -> None:
    before = oc.threads()
    refused("number must be a whole number from 1 to 1024", oc.set_threads, number)
    assert oc.threads() == before


def test_the_variable_sets_the_number_or_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "3")
    oc.set_threads(None)
    assert oc.threads() == 3
    for text in ("0", "two", "1.5", "-1", "9" * 30):
        monkeypatch.setenv(VARIABLE, text)
        refused("OBB_COLLISION_THREADS must be a whole number from 1", oc.set_threads, None)
    monkeypatch.delenv(VARIABLE)
    oc.set_threads(None)
    assert 1 <= oc.threads() <= (os.cpu_count() or 1)


FORK = """
import os, threading
from obb_collision._threads import run_parts, set_threads
set_threads(2)
assert threading.active_count() == 1
both = threading.Barrier(2)
run_parts(lambda part: both.wait(60), 2)
child = os.fork()
both = threading.Barrier(2)
run_parts(lambda part: both.wait(60), 2)  # in both processes
if child:
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
print(run_parts(lambda part: part, 3), flush=True)
"""
LATE = """
import atexit
from obb_collision._threads import run_parts, set_threads
set_threads(3)
atexit.register(lambda: print(run_parts(lambda part: part, 3)))
run_parts(lambda part: part, 3)
"""


@each("code", [FORK, LATE])
def test_a_forked_process_and_one_that_ends_go_on(code: str) -> None:
    done = run_python("-W", "ignore", "-c", code)
    assert done.stderr == ""
    assert set(done.stdout.splitlines()) == {"[0, 1, 2]"}

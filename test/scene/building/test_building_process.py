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

"""The process that builds: limits, deaths and what follows them, and none at all."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from builders import build
from each import each

from obb_collision.scene.building import process
from obb_collision.scene.building.builder import Builder
from obb_collision.scene.building.errors import NO_BUILDER, NO_MEMORY, TOO_SLOW, BuildError
from obb_collision.scene.building.jobs import Triangles
from obb_collision.scene.building.process import Limits
from obb_collision.shapes import Mesh

ONE = np.ones(3)


@pytest.fixture(scope="module")
def builder() -> Iterator[Builder]:
    """Yield a builder whose process each test may spoil: the next one goes on from there."""
    made = Builder()
    yield made
    made.close()


def test_too_little_memory_refuses_the_item_alone(builder: Builder) -> None:
    builder.limits = Limits(memory=150 << 20)
    points = np.random.default_rng(0).normal(size=(900_000, 3))
    with pytest.raises(BuildError) as caught:
        build(builder, Triangles(points, ONE))
    assert caught.value.reason == NO_MEMORY
    assert isinstance(build(builder, Triangles(points[:30], ONE)), Mesh), "the next one is built"
    builder.limits = Limits()
    assert isinstance(build(builder, Triangles(points[:60_000], ONE)), Mesh), "limits may change"


def signal_worker(builder: Builder, number: int) -> None:
    worker = builder.process.number
    assert worker is not None
    os.kill(worker, number)


def test_what_takes_too_long_is_refused_and_the_next_is_built(builder: Builder) -> None:
    job = Triangles(np.random.default_rng(0).normal(size=(300, 3)), ONE)
    build(builder, job)
    signal_worker(builder, signal.SIGSTOP)  # it hangs
    builder.limits = Limits(seconds=0.2)
    with pytest.raises(BuildError) as caught:
        build(builder, job)
    assert caught.value.reason == TOO_SLOW
    builder.limits = Limits()
    assert isinstance(build(builder, job), Mesh)


def test_a_process_that_dies_is_started_again(builder: Builder) -> None:
    job = Triangles(np.random.default_rng(0).normal(size=(300, 3)), ONE)
    build(builder, job)
    signal_worker(builder, signal.SIGKILL)
    assert isinstance(build(builder, job), Mesh), "killed while it had nothing to do"


#: Ends a process with its first job, as often as ``deaths`` says.
DOOM = """
import os, pathlib
from obb_collision.scene.building import worker
count, perform = pathlib.Path({count!r}), worker.perform
def doomed(message):
    died = count.stat().st_size
    if died < {deaths}:
        count.write_text("x" * (died + 1))
        os.kill(os.getpid(), 9)
    return perform(message)
worker.perform = doomed
"""


@each("deaths", [1, 2])
def test_a_job_whose_process_is_killed_is_tried_once_more(
    builder: Builder, deaths: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = tmp_path / "count"
    count.write_text("")
    doom = DOOM.format(count=str(count), deaths=deaths)
    code = process.CODE.replace("main(int", f"exec({doom!r}); main(int")
    monkeypatch.setattr(process, "CODE", code)
    builder.process.stop()
    job = Triangles(np.random.default_rng(0).normal(size=(300, 3)), ONE)
    if deaths == 1:
        assert isinstance(build(builder, job), Mesh)
    else:
        with pytest.raises(BuildError, match="twice, it was ended by SIGKILL") as caught:
            build(builder, job)
        assert caught.value.reason == NO_BUILDER
        assert isinstance(build(builder, job), Mesh), "the next one is built"
    assert count.read_text() == "x" * deaths
    monkeypatch.undo()
    builder.process.stop()


def test_without_a_process_everything_is_refused(
    builder: Builder, monkeypatch: pytest.MonkeyPatch
) -> None:
    builder.process.stop()
    for executable in ("", "/no/python", "/bin/false", "/bin/cat"):
        monkeypatch.setattr(sys, "executable", executable)
        for _ in range(2):
            with pytest.raises(BuildError) as caught:
                build(builder, Triangles(np.zeros((3, 3)), ONE))
            assert caught.value.reason == NO_BUILDER
            assert "it does not start" in caught.value.detail
    monkeypatch.undo()
    assert isinstance(build(builder, Triangles(np.eye(3), ONE)), Mesh)

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

"""The queue of a builder."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from builders import PATIENCE, outcomes, wait_built

from obb_collision.scene.building import builder as building
from obb_collision.scene.building.builder import Builder, Outcome
from obb_collision.scene.building.jobs import (
    NO_BUILDER,
    NO_MEMORY,
    TOO_MANY,
    BuildError,
    Task,
    Triangles,
)
from obb_collision.scene.building.process import Limits

ONE = np.ones(3)


@pytest.fixture
def own() -> Iterator[Builder]:
    """Yield a builder."""
    made = Builder()
    yield made
    made.close()


class Held:
    """A process that does what a test lets it do, and a job to hold it up."""

    def __init__(self, builder: Builder, monkeypatch: pytest.MonkeyPatch) -> None:
        self.let, begun = threading.Event(), threading.Event()
        self.done: list[str] = []

        def run(task: Task, limits: Limits) -> None:
            begun.set()
            if task[1] == ("hold",):
                assert self.let.wait(PATIENCE)
            self.done += task[1]

        monkeypatch.setattr(builder.process, "run", run)
        builder.request("hold", "hold", Named("hold"))
        assert begun.wait(PATIENCE)


@dataclass(frozen=True)
class Named:
    """A job with a name."""

    name: str
    size: int = 1

    def task(self) -> Task:
        return str, (self.name,)

    def finish(self, result: None) -> str:
        return self.name


@pytest.fixture
def held(own: Builder, monkeypatch: pytest.MonkeyPatch) -> Held:
    return Held(own, monkeypatch)


def names(outcomes: list[Outcome]) -> list[tuple[str, list[Any]]]:
    return [(outcome.result, sorted(outcome.keys, key=str)) for outcome in outcomes]


def test_the_last_request_of_a_key_counts_and_keeps_its_place(own: Builder, held: Held) -> None:
    for name in ("a1", "b1", "a2", "b2", "a3"):
        own.request(name[0], name, Named(name))
    assert len(own) == 3
    held.let.set()
    assert names(outcomes(own)) == [("hold", ["hold"]), ("a3", ["a"]), ("b2", ["b"])]
    assert held.done == ["hold", "a3", "b2"]
    assert len(own) == own.size == 0


def test_equal_jobs_are_done_once_for_all_their_keys(own: Builder, held: Held) -> None:
    for key in ("a", "b", "c"):
        own.request(key, "same", Named("same"))
    own.request("b", "other", Named("other"))
    held.let.set()
    assert names(outcomes(own))[1:] == [("same", ["a", "c"]), ("other", ["b"])]


def test_what_is_cancelled_is_not_built_and_not_told(own: Builder, held: Held) -> None:
    own.request("a", "a", Named("a"))
    own.request("b", "b", Named("b"))
    own.cancel("a")
    own.cancel("hold")  # has begun
    held.let.set()
    assert names(outcomes(own)) == [("b", ["b"])]
    assert held.done == ["hold", "b"]
    own.request("c", "c", Named("c"))
    wait_built(own)
    own.cancel("c")  # done, but not told yet
    assert own.poll() == []


def test_what_has_begun_is_told_though_something_newer_is_wanted(own: Builder, held: Held) -> None:
    own.request("hold", "newer", Named("newer"))
    assert own.wants("hold")
    held.let.set()
    assert names(outcomes(own)) == [("hold", ["hold"]), ("newer", ["hold"])]
    assert not own.wants("hold")


def test_the_queue_is_bounded_in_jobs_and_in_bytes(
    own: Builder, held: Held, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(building, "MOST_WAITING", 3)
    for name in "abc":
        own.request(name, name, Named(name))
    with pytest.raises(BuildError, match=TOO_MANY):
        own.request("d", "d", Named("d"))
    assert not own.wants("d")
    own.request("c", "c2", Named("c2"))  # in place of another
    own.cancel("a")
    own.limits = Limits(waiting=100)
    with pytest.raises(BuildError, match=TOO_MANY):
        own.request("d", "d", Named("d", size=98))
    own.request("d", "d", Named("d", size=97))
    monkeypatch.setattr(building, "MOST_WAITING", 10)
    own.limits = Limits()
    held.let.set()
    assert [name for name, _ in names(outcomes(own))] == ["hold", "b", "c2", "d"]


def test_a_job_that_fails_here_is_refused(own: Builder, held: Held) -> None:
    class Failing(Named):
        def finish(self, result: None) -> str:
            raise ZeroDivisionError("here")

    class Large(Named):
        def finish(self, result: None) -> str:
            raise MemoryError

    own.request("a", "a", Failing("a"))
    own.request("b", "b", Large("b"))
    held.let.set()
    _, failed, large = outcomes(own)
    assert failed.error is not None
    assert "ZeroDivisionError: here" in failed.error.detail
    assert large.error is not None
    assert large.error.reason == NO_MEMORY


def test_nothing_is_built_once_it_is_closed() -> None:
    others = set(threading.enumerate())
    builder = Builder()
    builder.request("a", "a", Triangles(np.eye(3), ONE))
    builder.close()
    assert set(threading.enumerate()) <= others
    with pytest.raises(BuildError, match=NO_BUILDER):
        builder.request("b", "b", Triangles(np.eye(3), ONE))

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

"""Building in another process: what comes back, and what is refused with which reason."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from obb_collision.scene.building import builder as building
from obb_collision.scene.building import process
from obb_collision.scene.building.builder import Builder, Outcome
from obb_collision.scene.building.errors import (
    NO_BUILDER,
    NO_MEMORY,
    TOO_MANY,
    TOO_SLOW,
    BuildError,
)
from obb_collision.scene.building.jobs import (
    BAD_POINTS,
    UNREADABLE,
    Bodies,
    Job,
    MeshFile,
    Triangles,
    body_corners,
)
from obb_collision.scene.building.process import Limits
from obb_collision.scene.building.wire import Message, Pipe
from obb_collision.shapes import Hull, Mesh

PATIENCE = 120.0
ONE = np.ones(3)


def wait(builder: Builder, count: int = 1) -> list[Outcome]:
    """Return so many outcomes, in the order in which they were done."""
    done: list[Outcome] = []
    limit = time.monotonic() + PATIENCE
    while len(done) < count:
        assert time.monotonic() < limit, "nothing is built"
        done += builder.poll()
        time.sleep(0.002)
    return done


def build(builder: Builder, job: Job) -> Any:
    """Return what a job gives, or raise why it gives nothing."""
    builder.request("key", object(), job)
    (outcome,) = wait(builder)
    if outcome.error is not None:
        raise outcome.error
    return outcome.result


@pytest.fixture(scope="module")
def builder() -> Iterator[Builder]:
    made = Builder()
    yield made
    made.close()


@pytest.fixture
def own() -> Iterator[Builder]:
    """Yield a builder that a test may spoil."""
    made = Builder()
    yield made
    made.close()


def test_what_is_built_is_what_would_be_built_here(builder: Builder, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(300, 3))
    scale = np.array((1.0, 2.0, 0.5))
    part = trimesh.creation.icosphere(2)
    file = tmp_path / "part.ply"
    part.export(file)
    faces = np.arange(300).reshape(-1, 3)
    cases: list[tuple[Job, Mesh | Hull]] = [
        (Triangles(points, scale), Mesh(points, faces, scale)),
        (Bodies(points, scale), Hull(body_corners(points, scale))),
        (MeshFile(str(file), scale), Mesh.from_file(file, scale)),
        (MeshFile("x.ply", scale, file.read_bytes()), Mesh.from_file(file, scale)),
    ]
    for job, expected in cases:
        built = build(builder, job)
        shape = built[0] if isinstance(built, tuple) else built
        assert type(shape) is type(expected)
        for got, wanted in zip(shape.local_box, expected.local_box, strict=True):
            np.testing.assert_array_equal(got, wanted)
        np.testing.assert_array_equal(
            shape._points() * np.array(shape.scale), expected._points() * np.array(expected.scale)
        )


def test_a_view_on_a_message_that_is_not_aligned_is_taken(builder: Builder) -> None:
    points = np.random.default_rng(1).normal(size=(9, 3))
    view = np.frombuffer(b"1234" + points.tobytes(), "<f8", 27, 4).reshape(-1, 3)
    assert not view.flags.aligned
    mesh = build(builder, Triangles(view, ONE))
    assert mesh.vertices.flags.aligned
    np.testing.assert_array_equal(mesh.vertices, points)


@pytest.mark.parametrize(
    ("job", "reason"),
    [
        (Triangles(np.full((3, 3), np.nan), ONE), BAD_POINTS),
        (Bodies(np.full((3, 3), np.inf), ONE), BAD_POINTS),
        (Triangles(np.full((3, 3), 1e300), 10.0 * ONE), "bad shape"),
        (MeshFile("/no/such.stl", ONE), UNREADABLE),
        (MeshFile("file:///a%00b.stl", ONE), UNREADABLE),
        (MeshFile("x.stl", ONE, b"no mesh"), UNREADABLE),
        (MeshFile("x." + "a" * 300, ONE, b"no mesh"), UNREADABLE),
        (MeshFile("x.stl", ONE, b""), UNREADABLE),
    ],
)
def test_refusals_have_reasons(builder: Builder, job: Job, reason: str) -> None:
    with pytest.raises(BuildError) as caught:
        build(builder, job)
    assert caught.value.reason == reason
    assert len(str(caught.value)) < 1000


def test_a_file_that_has_not_changed_is_not_built_again(builder: Builder, tmp_path: Path) -> None:
    file = tmp_path / "part.stl"
    trimesh.creation.box((1.0, 1.0, 1.0)).export(file)
    _, version = build(builder, MeshFile(str(file), ONE))
    assert build(builder, MeshFile(str(file), ONE, known=version)) is None
    trimesh.creation.box((3.0, 3.0, 3.0)).export(file)
    os.utime(file, ns=(0, version[0] + 1))
    changed, newer = build(builder, MeshFile(str(file), ONE, known=version))
    assert changed.local_box[2] == pytest.approx([1.5, 1.5, 1.5])
    assert newer != version
    with pytest.raises(BuildError, match="10 is the limit"):
        build(builder, MeshFile(str(file), ONE, largest=10))


def test_too_little_memory_refuses_the_item_alone(own: Builder) -> None:
    own.limits = Limits(memory=150 << 20)
    points = np.random.default_rng(0).normal(size=(900_000, 3))
    with pytest.raises(BuildError) as caught:
        build(own, Triangles(points, ONE))
    assert caught.value.reason == NO_MEMORY
    assert isinstance(build(own, Triangles(points[:30], ONE)), Mesh), "the next one is built"
    own.limits = Limits()
    assert isinstance(build(own, Triangles(points[:60_000], ONE)), Mesh), "limits may change"


def signal_worker(builder: Builder, number: int) -> None:
    worker = builder.process.number
    assert worker is not None
    os.kill(worker, number)


def test_what_takes_too_long_is_refused_and_the_next_is_built(own: Builder) -> None:
    job = Triangles(np.random.default_rng(0).normal(size=(300, 3)), ONE)
    build(own, job)
    signal_worker(own, signal.SIGSTOP)  # it hangs
    own.limits = Limits(seconds=0.2)
    with pytest.raises(BuildError) as caught:
        build(own, job)
    assert caught.value.reason == TOO_SLOW
    own.limits = Limits()
    assert isinstance(build(own, job), Mesh)


def test_a_process_that_dies_is_started_again(own: Builder) -> None:
    job = Triangles(np.random.default_rng(0).normal(size=(300, 3)), ONE)
    build(own, job)
    signal_worker(own, signal.SIGKILL)
    assert isinstance(build(own, job), Mesh), "killed while it had nothing to do"


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


@pytest.mark.parametrize("deaths", [1, 2])
def test_a_job_whose_process_is_killed_is_tried_once_more(
    own: Builder, deaths: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = tmp_path / "count"
    count.write_text("")
    doom = DOOM.format(count=str(count), deaths=deaths)
    code = process.CODE.replace("main(int", f"exec({doom!r}); main(int")
    monkeypatch.setattr(process, "CODE", code)
    job = Triangles(np.random.default_rng(0).normal(size=(300, 3)), ONE)
    if deaths == 1:
        assert isinstance(build(own, job), Mesh)
    else:
        with pytest.raises(BuildError, match="twice, it was ended by SIGKILL") as caught:
            build(own, job)
        assert caught.value.reason == NO_BUILDER
        assert isinstance(build(own, job), Mesh), "the next one is built"
    assert count.read_text() == "x" * deaths


@pytest.mark.parametrize("executable", ["", "/no/python", "/bin/false", "/bin/cat"])
def test_without_a_process_everything_is_refused(
    own: Builder, monkeypatch: pytest.MonkeyPatch, executable: str
) -> None:
    monkeypatch.setattr(sys, "executable", executable)
    for _ in range(2):
        with pytest.raises(BuildError) as caught:
            build(own, Triangles(np.zeros((3, 3)), ONE))
        assert caught.value.reason == NO_BUILDER
        assert "it does not start" in caught.value.detail
    monkeypatch.undo()
    assert isinstance(build(own, Triangles(np.eye(3), ONE)), Mesh)


class Held:
    """A process that does what a test lets it do, and a job to hold it up."""

    def __init__(self, builder: Builder, monkeypatch: pytest.MonkeyPatch) -> None:
        self.let, self.begun = threading.Event(), threading.Event()
        self.done: list[str] = []

        def run(message: Message, limits: Limits) -> Message:
            self.begun.set()
            if message["job"] == "hold":
                assert self.let.wait(PATIENCE)
            self.done.append(message["job"])
            return {}

        monkeypatch.setattr(builder.process, "run", run)
        builder.request("hold", "hold", Named("hold"))
        assert self.begun.wait(PATIENCE)


@dataclass(frozen=True)
class Named:
    """A job with a name."""

    name: str
    size: int = 1

    def message(self) -> Message:
        return {"job": self.name}

    def finish(self, reply: Message) -> str:
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
    assert names(wait(own, 3)) == [("hold", ["hold"]), ("a3", ["a"]), ("b2", ["b"])]
    assert held.done == ["hold", "a3", "b2"]
    assert len(own) == own.size == 0


def test_equal_jobs_are_done_once_for_all_their_keys(own: Builder, held: Held) -> None:
    for key in ("a", "b", "c"):
        own.request(key, "same", Named("same"))
    own.request("b", "other", Named("other"))
    held.let.set()
    assert names(wait(own, 3))[1:] == [("same", ["a", "c"]), ("other", ["b"])]


def test_what_is_cancelled_is_not_built_and_not_told(own: Builder, held: Held) -> None:
    own.request("a", "a", Named("a"))
    own.request("b", "b", Named("b"))
    own.cancel("a")
    own.cancel("hold")  # has begun
    held.let.set()
    assert names(wait(own, 1)) == [("b", ["b"])]
    assert held.done == ["hold", "b"]
    own.request("c", "c", Named("c"))
    while own.wants("c"):
        time.sleep(0.001)
    own.cancel("c")  # done, but not told yet
    assert own.poll() == []


def test_what_has_begun_is_told_though_something_newer_is_wanted(own: Builder, held: Held) -> None:
    own.request("hold", "newer", Named("newer"))
    assert own.wants("hold")
    held.let.set()
    assert names(wait(own, 2)) == [("hold", ["hold"]), ("newer", ["hold"])]
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
    held.let.set()
    assert [name for name, _ in names(wait(own, 4))] == ["hold", "b", "c2", "d"]


def test_a_job_that_fails_here_is_refused(own: Builder, held: Held) -> None:
    class Failing(Named):
        def finish(self, reply: Message) -> str:
            raise ZeroDivisionError("here")

    class Large(Named):
        def finish(self, reply: Message) -> str:
            raise MemoryError

    own.request("a", "a", Failing("a"))
    own.request("b", "b", Large("b"))
    held.let.set()
    _, failed, large = wait(own, 3)
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


def pipes() -> tuple[Pipe, Pipe, list[int]]:
    (a, b), (c, d) = os.pipe(), os.pipe()
    return Pipe(a, d), Pipe(c, b), [a, b, c, d]


def test_messages_come_back_as_they_were() -> None:
    near, far, descriptors = pipes()
    message = {
        "text": "ä\ud800\0",
        "number": 0.1,
        "none": None,
        "large": np.random.default_rng(0).normal(size=(500_000, 3)),
        "empty": np.empty((0, 3), np.int64),
        "whole": np.arange(5, dtype=np.int8),
        "flags": np.array([True, False]),
    }
    sender = threading.Thread(target=near.send, args=(message, PATIENCE))
    sender.start()
    got = far.receive(PATIENCE)
    sender.join()
    assert got is not None
    assert got.keys() == message.keys()
    for name, value in message.items():
        np.testing.assert_array_equal(got[name], value)
        assert getattr(got[name], "dtype", None) == getattr(value, "dtype", None)
    with pytest.raises(TimeoutError):
        far.receive(0.0)
    os.close(descriptors[3])
    os.close(descriptors[1])
    assert near.receive(PATIENCE) is None


@pytest.mark.parametrize(
    "data",
    [b"\xff" * 8, b"\2" + bytes(7) + b"no", b"\2" + bytes(7) + b"{}"],
    ids=["too long", "no JSON", "no message"],
)
def test_what_is_no_message_is_an_error(data: bytes) -> None:
    _, far, descriptors = pipes()
    os.write(descriptors[3], data)
    with pytest.raises(ValueError, match=r"."):
        far.receive(PATIENCE)

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

"""Shapes built in another process: results, refusals, limits, deaths, and the queue."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from each import each
from scenes import PATIENCE, build, outcomes, wait_built

from obb_collision import _child
from obb_collision.geometry.shapes.files import MeshFolders
from obb_collision.scene.building import builder as building
from obb_collision.scene.building import jobs
from obb_collision.scene.building.builder import Builder, Limits, Outcome
from obb_collision.shapes import Hull, Mesh

ONE = np.ones(3)


@pytest.fixture(scope="module")
def builder() -> Iterator[Builder]:
    """Yield a builder whose process each test may spoil: the next one goes on from there."""
    with closing(Builder()) as made:
        yield made


def refusal(builder: Builder, job: jobs.Job) -> jobs.BuildError:
    with pytest.raises(jobs.BuildError) as caught:
        build(builder, job)
    return caught.value


def corners(shape: Mesh | Hull) -> np.ndarray:
    """Return the points of a hull, or the corners of the faces of a mesh (n, 3), metres."""
    points = shape.points if isinstance(shape, Hull) else shape.vertices[shape.faces.ravel()]
    return points * np.array(shape.scale)


def test_what_is_built_is_what_would_be_built_here(builder: Builder, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(300, 3))
    scale = np.array((1.0, 2.0, 0.5))
    part = trimesh.creation.icosphere(2)
    file = tmp_path / "part.ply"
    part.export(file)
    faces = np.arange(300).reshape(-1, 3)
    view = np.frombuffer(b"1234" + points.tobytes(), "<f8", 900, 4).reshape(-1, 3)
    assert not view.flags.aligned, "as on a message"
    cases: list[tuple[jobs.Job, Mesh | Hull]] = [
        (jobs.Triangles(points, scale), Mesh(points, faces, scale)),
        (jobs.Triangles(view, scale), Mesh(points, faces, scale)),
        (jobs.Bodies(points, scale), Hull(jobs.body_corners(points, scale))),
        (jobs.MeshFile(str(file), scale), Mesh.from_file(file, scale)),
        (jobs.MeshFile("x.ply", scale, file.read_bytes()), Mesh.from_file(file, scale)),
    ]
    for job, expected in cases:
        built = build(builder, job)
        shape = built[0] if isinstance(built, tuple) else built
        assert type(shape) is type(expected)
        assert isinstance(shape, Hull) or shape.vertices.flags.aligned
        for got, wanted in zip(shape.local_box, expected.local_box, strict=True):
            np.testing.assert_array_equal(got, wanted)
        np.testing.assert_array_equal(corners(shape), corners(expected))


@each("job, reason", [
    (jobs.Triangles(np.full((3, 3), np.nan), ONE), jobs.BAD_POINTS),
    (jobs.Bodies(np.full((3, 3), np.inf), ONE), jobs.BAD_POINTS),
    (jobs.Triangles(np.full((3, 3), 1e300), 10.0 * ONE), "bad shape"),
    *((jobs.MeshFile(name, ONE), jobs.UNREADABLE) for name in ("/no/such.stl", "file:///a%00b.stl")),
    *((jobs.MeshFile(name, ONE, data), jobs.UNREADABLE)
      for name, data in (("x.stl", b"no mesh"), ("x." + "a" * 300, b"no mesh"), ("x.stl", b""))),
])  # fmt: skip
def test_refusals_have_reasons(builder: Builder, job: jobs.Job, reason: str) -> None:
    error = refusal(builder, job)
    assert error.reason == reason
    assert len(str(error)) < 1000


def test_a_file_that_has_not_changed_is_not_built_again(builder: Builder, tmp_path: Path) -> None:
    file = tmp_path / "part.stl"
    trimesh.creation.box((1.0, 1.0, 1.0)).export(file)
    _, version = build(builder, jobs.MeshFile(str(file), ONE))
    assert build(builder, jobs.MeshFile(str(file), ONE, known=version)) is None
    trimesh.creation.box((3.0, 3.0, 3.0)).export(file)
    os.utime(file, ns=(0, version[0] + 1))
    changed, newer = build(builder, jobs.MeshFile(str(file), ONE, known=version))
    assert changed.local_box[2] == pytest.approx([1.5, 1.5, 1.5])
    assert newer != version
    assert "10 is the limit" in str(refusal(builder, jobs.MeshFile(str(file), ONE, largest=10)))


def test_files_outside_the_allowed_folders_are_refused(builder: Builder, tmp_path: Path) -> None:
    for folder in ("allowed", "other"):
        (tmp_path / folder).mkdir()
        trimesh.creation.box().export(tmp_path / folder / "part.stl")
    folders = MeshFolders((str(tmp_path / "allowed"),))
    uri = (tmp_path / "allowed" / "part.stl").as_uri()
    mesh, _ = build(builder, jobs.MeshFile(uri, ONE, folders=folders))
    assert len(mesh.faces) == 12
    for name in ("file:///etc/passwd", uri.replace("allowed", "allowed/%2e%2e/other")):
        error = refusal(builder, jobs.MeshFile(name, ONE, folders=folders))
        assert error.reason == jobs.UNREADABLE
        assert "is not in a folder" in str(error)
    error = refusal(builder, jobs.MeshFile(uri, ONE, triangles=11, folders=folders))
    assert error.reason == jobs.TOO_MANY_TRIANGLES
    assert "12 triangles, 11 is the limit" in str(error)


def test_too_little_memory_refuses_the_item_alone(builder: Builder) -> None:
    builder.limits = Limits(memory=150 << 20)
    points = np.random.default_rng(0).normal(size=(900_000, 3))
    assert refusal(builder, jobs.Triangles(points, ONE)).reason == jobs.NO_MEMORY
    assert isinstance(build(builder, jobs.Triangles(points[:30], ONE)), Mesh), "the next one"
    builder.limits = Limits()
    assert isinstance(build(builder, jobs.Triangles(points[:60_000], ONE)), Mesh), "they may change"


def signal_worker(builder: Builder, number: int) -> None:
    worker = builder.process.number
    assert worker is not None
    os.kill(worker, number)


def test_one_that_hangs_is_not_waited_for_and_one_that_dies_is_replaced(builder: Builder) -> None:
    job = jobs.Triangles(np.random.default_rng(0).normal(size=(300, 3)), ONE)
    build(builder, job)
    signal_worker(builder, signal.SIGSTOP)  # it hangs
    builder.limits = Limits(seconds=0.2)
    assert refusal(builder, job).reason == jobs.TOO_SLOW
    builder.limits = Limits()
    assert isinstance(build(builder, job), Mesh)
    signal_worker(builder, signal.SIGKILL)
    assert isinstance(build(builder, job), Mesh), "killed while it had nothing to do"


@dataclass(frozen=True)
class Doomed:
    """A job whose process is killed for a number of times."""

    count: Path
    deaths: int
    size: int = 0

    def task(self) -> jobs.Task:
        code = f"""
import os, pathlib
count = pathlib.Path({str(self.count)!r})
died = count.stat().st_size
if died < {self.deaths}:
    count.write_text("x" * (died + 1))
    os.kill(os.getpid(), 9)
"""
        return exec, (code,)

    def finish(self, result: None) -> str:
        return "built"


@each("deaths", [1, 2])
def test_a_killed_job_is_tried_once_more(builder: Builder, deaths: int, tmp_path: Path) -> None:
    job = Doomed(tmp_path / "count", deaths)
    job.count.write_text("")
    if deaths == 2:
        error = refusal(builder, job)
        assert error.reason == jobs.NO_BUILDER
        assert "twice, it was ended by SIGKILL" in str(error)
    assert build(builder, job) == "built", "the next one, or the first one again"
    assert job.count.read_text() == "x" * deaths


def test_all_is_refused_without_process(builder: Builder, monkeypatch: pytest.MonkeyPatch) -> None:
    builder.process.stop()
    for executable in ("", "/no/python", "/bin/false", "/bin/cat"):
        monkeypatch.setattr(sys, "executable", executable)
        for _ in range(2):
            error = refusal(builder, jobs.Triangles(np.zeros((3, 3)), ONE))
            assert error.reason == jobs.NO_BUILDER
            assert "it does not start" in error.detail
    monkeypatch.undo()
    assert isinstance(build(builder, jobs.Triangles(np.eye(3), ONE)), Mesh)


HOSTILE = """
import os, sys
from multiprocessing.connection import Connection
class Bomb:
    def __reduce__(self):
        return os.mkdir, ({folder!r},)
connection = Connection(int(sys.argv[2]))
connection.send_bytes(b"")
connection.recv_bytes()
{reply}
connection.recv_bytes()
"""


def said(*messages: bytes) -> str:
    return "\n".join(f"connection.send_bytes({message!r})" for message in messages)


def arrays(**kinds: tuple[str, list[int]]) -> bytes:
    """Return what announces the mesh of a file."""
    parts: list[object] = [{"type": kind, "shape": shape} for kind, shape in kinds.values()]
    return json.dumps(["value", [*parts[:2], parts[2:], None]]).encode()


CORNERS = np.eye(3).tobytes()
BOX = {"center": ("<f8", [3]), "turn": ("<f8", [3, 3]), "half": ("<f8", [3])}
REST = bytes(24), CORNERS, bytes(24)
VERTICES, FACES, SIZES = ("<f8", [3, 3]), ("<i8", [1, 3]), ("<f8", [1, 3])
ODD = "its reply is not understood"
BEYOND = np.array([[0, 1, 3]]).tobytes()


@pytest.mark.parametrize(
    ("reply", "why"),
    [
        ("connection.send(Bomb())", ODD),
        (said(b'["value", ' + b"[" * 100_000), ODD),
        (said(b"[]"), ODD),
        (said(b'["error", 1, 2]'), ODD),
        (
            said(b'["value", [{"type": "O", "shape": [1]}]]', bytes(8)),
            ODD,
        ),
        (said(b'["value", [{"type": "<f8", "shape": [-1]}]]', b""), ODD),
        (
            said(b'["value", [{"type": "<f8", "shape": [2]}]]', bytes(8)),
            ODD,
        ),
        (
            said(b'["value", [{"type": "<f8", "shape": [1]}]]', bytes(99)),
            ODD,
        ),
        (said(b'["value", [{"type": "<f8", "shape": [1000000000000000]}]]'), "not enough memory"),
        (said(b'["value", 5]'), "TypeError"),
        (said(arrays(v=VERTICES, f=FACES, **BOX), CORNERS, BEYOND, *REST), "faces must index"),
        (said(arrays(v=VERTICES, f=SIZES, **BOX), CORNERS, bytes(24), *REST), "must be integers"),
    ],
    ids=range(12),
)
def test_a_process_that_a_file_has_taken_over_executes_nothing_here(
    reply: str, why: str, tmp_path: Path, own: Builder, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "made"
    monkeypatch.setattr(_child, "CODE", HOSTILE.format(folder=str(folder), reply=reply))
    error = refusal(own, jobs.MeshFile("a.stl", ONE, b"solid"))
    assert why in str(error)
    assert not folder.exists()


@pytest.fixture
def own() -> Iterator[Builder]:
    """Yield a builder."""
    with closing(Builder()) as made:
        yield made


class Held:
    """A process that does what a test lets it do, and a job to hold it up."""

    def __init__(self, builder: Builder, monkeypatch: pytest.MonkeyPatch) -> None:
        self.let, begun = threading.Event(), threading.Event()
        self.done: list[str] = []

        def run(task: jobs.Task, limits: Limits) -> None:
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
    error: Exception | None = None

    def task(self) -> jobs.Task:
        return str, (self.name,)

    def finish(self, result: None) -> str:
        if self.error is not None:
            raise self.error
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


def test_the_queue_is_bounded(own: Builder, held: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(building, "MOST_WAITING", 3)
    for name in "abc":
        own.request(name, name, Named(name))
    with pytest.raises(jobs.BuildError, match=jobs.TOO_MANY):
        own.request("d", "d", Named("d"))
    assert not own.wants("d")
    own.request("c", "c2", Named("c2"))  # in place of another
    own.cancel("a")
    own.limits = Limits(waiting=100)
    with pytest.raises(jobs.BuildError, match=jobs.TOO_MANY):
        own.request("d", "d", Named("d", size=98))
    own.request("d", "d", Named("d", size=97))
    monkeypatch.setattr(building, "MOST_WAITING", 10)
    own.limits = Limits()
    held.let.set()
    assert [name for name, _ in names(outcomes(own))] == ["hold", "b", "c2", "d"]


def test_a_job_that_fails_here_is_refused(own: Builder, held: Held) -> None:
    own.request("a", "a", Named("a", error=ZeroDivisionError("here")))
    own.request("b", "b", Named("b", error=MemoryError()))
    held.let.set()
    _, failed, large = outcomes(own)
    assert failed.error is not None
    assert "ZeroDivisionError: here" in failed.error.detail
    assert large.error is not None
    assert large.error.reason == jobs.NO_MEMORY


def test_nothing_is_built_once_it_is_closed() -> None:
    others = set(threading.enumerate())
    builder = Builder()
    builder.request("a", "a", jobs.Triangles(np.eye(3), ONE))
    builder.close()
    assert set(threading.enumerate()) <= others
    with pytest.raises(jobs.BuildError, match=jobs.NO_BUILDER):
        builder.request("b", "b", jobs.Triangles(np.eye(3), ONE))

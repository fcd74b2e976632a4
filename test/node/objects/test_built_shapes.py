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

"""Shapes that are built beside the cycles: awaited, superseded, shared, and refused alone."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import trimesh
from each import each
from geometry_msgs.msg import Point
from objects_rig import BODY, BOX, OTHER, PAIR, Gate, mesh_marker, named, triangle
from rig import Patch, Rig, cube, sync
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

from obb_collision.geometry.shapes import meshes
from obb_collision.geometry.trees import pool
from obb_collision.node.diagnostics.answer import COLLIDING, UNKNOWN, Reason
from obb_collision.node.objects import shape_requests
from obb_collision.scene.building.builder import Limits


@pytest.fixture
def gate(rig: Rig) -> Iterator[Gate]:
    made = Gate(rig)
    yield made
    made.open()


def test_a_new_object_is_unplaceable_until_its_shape_is_there(rig: Rig, gate: Gate) -> None:
    rig.send(cube(BOX), triangle())
    assert rig.pairs() == set()
    status = rig.status(": objects")
    assert status["unplaceable: shape being built"] == status["unplaceable"] == "1"
    assert status["names unplaceable"] == "body/1"
    assert "1 unplaceable (not checked)" in status["message"]
    drawn = rig.next("obb_collision/markers").markers
    assert [(marker.ns, marker.id) for marker in drawn] == [BOX], "no box is shown for it"
    gate.open()
    rig.built(BODY)
    assert named(sync(rig)) == named(PAIR)
    assert rig.status(": objects")["unplaceable"] == "0"
    assert not rig.is_doubtful(BODY)


def test_a_new_shape_takes_the_place_of_the_last_one_when_it_is_there(rig: Rig, gate: Gate) -> None:
    rig.send(cube(BOX, (3.0, 0.0, 0.0)), cube(BODY))
    assert rig.pairs() == set()
    rig.send(triangle(size=4.0))
    assert sync(rig) == set(), "the last box stays"
    assert rig.is_doubtful(BODY)
    status = rig.status(": objects")
    assert status["new shape being built"] == "1"
    assert "new shapes being built (last box kept)" in status["message"]
    rig.until(lambda: rig.node.status.answer.level == UNKNOWN, "a status that is not known")
    assert rig.node.status.answer.reasons == (Reason("shape_building", ("body/1",), 1),)
    gate.open()
    rig.built(BODY)
    assert named(sync(rig)) == named(PAIR)
    assert not rig.is_doubtful(BODY)
    assert rig.node.status.answer.level == COLLIDING


def test_a_newer_marker_supersedes_a_shape_that_waits(rig: Rig, gate: Gate) -> None:
    rig.send(cube(BOX, (30.0, 0.0, 0.0)), triangle(OTHER))  # what is built first
    sync(rig)
    rig.until(lambda: rig.node.objects.shapes.builder.is_busy, "the first job")
    for size in (2.0, 3.0, 31.0):
        rig.send(triangle(size=size))
    sync(rig)
    gate.open()
    rig.built(BODY)
    assert named(sync(rig)) == named(PAIR | {("body/1", "body/2")})
    assert len(gate.jobs) == 2
    rig.send(triangle(size=32.0), cube(BODY))
    rig.built(BODY)
    assert len(gate.jobs) <= 3
    signature = rig.node.objects.table.signature(BODY)
    assert signature is not None
    assert signature[0] == Marker.CUBE, "a simple shape cancels, too"
    assert named(sync(rig)) == named({("body/1", "body/2")})


ENDS: dict[str, Callable[[Rig], Any]] = {
    "delete": lambda rig: rig.send(cube(BODY, action=Marker.DELETE)),
    "delete all": lambda rig: rig.send(Marker(action=Marker.DELETEALL)),
    "service": lambda rig: rig.call(Trigger, "obb_collision/clear", Trigger.Request()),
}


@each("end", ENDS)
@each("had_shape", [False, True])
def test_what_is_deleted_does_not_come_back(rig: Rig, end: str, had_shape: bool) -> None:
    gate, size = Gate(rig), 1.0 + [*ENDS].index(end) + 0.5 * had_shape  # none is built yet
    if had_shape:
        rig.send(cube(BODY))
    rig.send(triangle(size=size))
    rig.until(lambda: rig.node.objects.shapes.builder.is_busy, "the job")
    ENDS[end](rig)
    rig.until(lambda: BODY not in rig.node.objects.table.slots, "it to be gone")
    gate.open()
    rig.send(cube(BOX), triangle(OTHER, size=size, x=0.1))
    rig.built(OTHER)
    assert named(sync(rig)) == named({("box/1", "body/2")})
    assert BODY not in rig.node.objects.table.slots
    assert rig.node.objects.unplaceable == {}
    assert not rig.refused("objects")


def test_the_same_points_and_files_are_built_once(rig: Rig, tmp_path: Path) -> None:
    gate = Gate(rig)
    file = tmp_path / "part.stl"
    trimesh.creation.box((1.0, 1.0, 1.0)).export(file)
    keys = [("body", number) for number in range(6)]
    rig.send(*(triangle(key) for key in keys[:3]), *(mesh_marker(file, key) for key in keys[3:]))
    rig.until(lambda: len(rig.node.objects.shapes.builder) == len(keys), "all to wait")
    gate.open()
    rig.built(*keys)
    assert gate.jobs == ["_box_of", "_read"]
    rig.send(triangle(("late", 1)), mesh_marker(file, ("late", 2)))
    rig.built(("late", 1), ("late", 2))
    assert gate.jobs[:2] == ["_box_of", "_read"]
    assert gate.jobs.count("_box_of") == 1
    scene = rig.node.objects.scene
    assert len({id(shape) for shape in scene.objects.cache._shapes.values()}) == 2


def test_a_file_is_looked_at_again_with_a_marker_of_it(monkeypatch: Patch, tmp_path: Path) -> None:
    monkeypatch.setattr(shape_requests, "CHECK_PERIOD", 0.05)
    file = tmp_path / "part.stl"
    trimesh.creation.box((1.0, 1.0, 1.0)).export(file)
    with Rig() as rig:
        rig.send(cube(BOX, (2.0, 0.0, 0.0)), mesh_marker(file), mesh_marker(file, OTHER))
        rig.built(BODY, OTHER)
        assert named(sync(rig)) == named({("body/1", "body/2")})
        rig.send(mesh_marker(file))
        assert not rig.is_doubtful(BODY), "a look at the file is no reason for doubt"
        trimesh.creation.box((5.0, 5.0, 5.0)).export(file)
        os.utime(file, ns=(0, 1))
        rig.send(mesh_marker(file))
        everything = named({("box/1", "body/1"), ("box/1", "body/2"), ("body/1", "body/2")})
        rig.until(lambda: named(sync(rig)) == everything, "the new file, in all that have it")
        file.unlink()
        rig.send(mesh_marker(file))
        rig.until(lambda: rig.refused("objects"), "refusal")
        assert named(sync(rig)) == everything, "the last box stays"
        assert rig.is_doubtful(BODY)
        assert set(rig.refused("objects")) == {"unreadable mesh"}


def embedded(name: str, data: bytes, key: tuple[str, int] = BODY) -> Marker:
    marker = mesh_marker("embedded://part", key)
    marker.mesh_file.filename, marker.mesh_file.data = name, data
    return marker


STL = trimesh.creation.box((1.0, 1.0, 1.0)).export(file_type="stl")
PIPED = b'{"asset":{"version":"2.0"},"buffers":[{"uri":"pipe.stl","byteLength":1}]}'
UNREADABLE = (
    *("file:///dev/zero", "file:///part%00.stl", f"file:///{'a' * 300}.stl"),
    *(f"file:///{'a/' * 2500}b.stl", f"package://%00/../{'a' * 300}", "file://[/part.stl"),
    *("part.stl", "file:///%ED%A0%80.stl"),
)
EMBEDDED = {f"part.{'a' * 300}": STL, "part": STL, "part.stl": b"nothing", "part.gltf": PIPED}


def test_meshes_that_cannot_be_read_are_refused_alone(rig: Rig, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.stl")
    uris = ((tmp_path / "pipe.stl").as_uri(), *UNREADABLE)
    bad = [mesh_marker(uri, ("uri", number)) for number, uri in enumerate(uris)]
    bad += [embedded(*item, ("embedded", n)) for n, item in enumerate(EMBEDDED.items())]
    rig.send(*bad, cube(BOX), cube(OTHER))
    assert named(rig.pairs()) == named({("box/1", "body/2")})
    rig.refuses("objects", {"unreadable mesh": len(bad)})
    unplaceable = {(marker.ns, marker.id): "unreadable mesh" for marker in bad}
    assert rig.node.objects.unplaceable == unplaceable
    assert rig.node.guard.total == 0
    assert named(sync(rig)) == named({("box/1", "body/2")})
    os.mkfifo(tmp_path / "pipe.mtl")  # materials do not hold up a mesh
    file = tmp_path / "part.obj"
    file.write_text("mtllib pipe.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
    rig.send(mesh_marker(file))
    rig.built(BODY)
    assert named(sync(rig)) >= named(PAIR)


def test_without_a_builder_or_temporary_folder_the_rest_goes_on(monkeypatch: Patch) -> None:
    monkeypatch.setattr(sys, "executable", "/no/python")
    with Rig(own_builder=True) as rig:
        rig.send(cube(BOX), cube(OTHER), triangle())
        assert named(rig.pairs()) == named({("box/1", "body/2")})
        rig.refuses("objects", {"shape builder failed": 1})
        status = rig.status(": objects")
        assert status["unplaceable: shape builder failed"] == "1"
        rig.send(triangle(OTHER))
        rig.until(lambda: rig.refused("objects")["shape builder failed"] == 2, "refusal")
        assert named(sync(rig)) == named({("box/1", "body/2")}), "the last box stays"
        assert rig.is_doubtful(OTHER)
        monkeypatch.undo()
        for name in ("TMPDIR", "TEMP", "TMP"):
            monkeypatch.setenv(name, "/dev/full")
        monkeypatch.setattr(tempfile, "tempdir", "/dev/full")
        rig.send(embedded("part.stl", STL))
        rig.built(BODY)


def test_an_item_beyond_the_limits_is_refused_alone(rig: Rig) -> None:
    rig.set(shape_timeout=0.5, shape_memory=100, shape_queue=1)
    limits = rig.node.objects.shapes.builder.limits
    assert limits == Limits(seconds=0.5, memory=100_000_000, waiting=1_000_000)
    body = cube(BODY, type=Marker.TRIANGLE_LIST)
    body.points = [Point(x=float(n % 7), y=float(n % 11), z=1.0) for n in range(60_000)]
    rig.set(shape_timeout=60.0)
    rig.send(body, cube(BOX), triangle(OTHER))
    rig.built(OTHER)
    rig.until(lambda: rig.refused("objects"), "refusal")
    assert list(rig.refused("objects").values()) == [1]
    assert named(sync(rig)) == named({("box/1", "body/2")})


def test_cycles_do_nothing_that_takes_long(rig: Rig, monkeypatch: Patch, tmp_path: Path) -> None:
    monkeypatch.setattr(meshes, "fit_points", Mock(side_effect=AssertionError("in this process")))
    for name in ("open", "stat"):
        real = getattr(os, name)

        def guarded(path: Any, *args: Any, real: Any = real, **options: Any) -> Any:
            assert "part" not in str(path), "the node opens a mesh file itself"
            return real(path, *args, **options)

        monkeypatch.setattr(os, name, guarded)
    file = tmp_path / "part.stl"
    with file.open("wb") as stream:
        stream.write(STL)
    points = triangle().points
    kinds = (Marker.LINE_LIST, Marker.LINE_STRIP)
    lists = [cube(("list", kind), type=kind, points=points) for kind in kinds]
    arrow = cube(("list", 0), type=Marker.ARROW, points=points)
    rig.send(triangle(), mesh_marker(file, OTHER), arrow, *lists)
    rig.built(BODY, OTHER, ("list", 0), *(("list", kind) for kind in kinds))
    assert rig.node.guard.total == 0
    assert not rig.refused("objects")


@each("at_start", [True, False])
def test_trees_of_large_meshes_are_not_built_by_the_thread_of_the_cycles(
    monkeypatch: Patch, tmp_path: Path, at_start: bool
) -> None:
    build = Mock(side_effect=AssertionError("a tree is built in the node's process"))
    file = tmp_path / "part.stl"
    trimesh.creation.icosphere(3).export(file)
    with Rig(accuracy="mesh" if at_start else "obb") as rig:
        for name in ("mesh_tree", "hull_mesh"):
            monkeypatch.setattr(pool, name, build)
        other = mesh_marker(file, OTHER)
        other.pose.position.x = other.pose.position.y = 1.5  # the boxes collide, the balls do not
        rig.send(mesh_marker(file), other)
        rig.built(BODY, OTHER)
        if not at_start:
            assert named(sync(rig)) == named({("body/1", "body/2")})
            rig.set(accuracy="mesh")
        rig.until(lambda: sync(rig) == set(), "the trees")
        assert rig.node.guard.total == 0
        assert not rig.node.objects.trees.failed

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

"""Shapes that take time: built beside the cycles, waited for, renewed and superseded."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
import trimesh
from each import each
from gate import Gate
from rig import Rig, cube, pose, sync
from shape_markers import BODY, BOX, OTHER, PAIR, doubtful, mesh_marker, named, triangle
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

from obb_collision.node.diagnostics.answer import COLLIDING, UNKNOWN, Reason
from obb_collision.node.objects import shape_requests


@pytest.fixture
def gate(rig: Rig) -> Iterator[Gate]:
    made = Gate(rig)
    yield made
    made.open()


def gone(rig: Rig, key: tuple[str, int]) -> None:
    rig.until(lambda: key not in rig.node.objects.table.slots, f"{key} to be gone")


def test_a_new_object_is_unplaceable_until_its_shape_is_there(rig: Rig, gate: Gate) -> None:
    rig.listen("/diagnostics", "obb_collision/markers")
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
    assert not doubtful(rig, BODY)


def test_poses_that_come_while_a_shape_is_built_are_not_lost(rig: Rig, gate: Gate) -> None:
    rig.send(cube(BOX), triangle(x=50.0))
    rig.answer()
    rig.send_transform("body/1", pose(0.2))
    sync(rig)
    gate.open()
    rig.built(BODY)
    assert named(sync(rig)) == named(PAIR)
    assert not rig.refused("object_transform")


def test_a_new_shape_takes_the_place_of_the_last_one_when_it_is_there(rig: Rig, gate: Gate) -> None:
    rig.listen("/diagnostics")
    rig.send(cube(BOX, (3.0, 0.0, 0.0)), cube(BODY))
    assert rig.pairs() == set()
    rig.send(triangle(size=4.0))
    assert sync(rig) == set(), "the last box stays"
    assert doubtful(rig, BODY)
    status = rig.status(": objects")
    assert status["new shape being built"] == "1"
    assert "new shapes being built (last box kept)" in status["message"]
    rig.until(lambda: rig.node.status.answer.level == UNKNOWN, "a status that is not known")
    assert rig.node.status.answer.reasons == (Reason("shape_building", ("body/1",), 1),)
    gate.open()
    rig.built(BODY)
    assert named(sync(rig)) == named(PAIR)
    assert not doubtful(rig, BODY)
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


def test_a_shape_that_comes_back_to_what_it_was_waits_for_nothing(rig: Rig, gate: Gate) -> None:
    rig.send(cube(BODY))
    sync(rig)
    rig.send(triangle(), cube(BODY))
    sync(rig)
    assert not doubtful(rig, BODY)
    assert len(rig.node.objects.shapes.builder) == 0


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
    gone(rig, BODY)
    gate.open()
    rig.send(cube(BOX), triangle(OTHER, size=size, x=0.1))
    rig.built(OTHER)
    assert named(sync(rig)) == named({("box/1", "body/2")})
    assert BODY not in rig.node.objects.table.slots
    assert rig.node.objects.unplaceable == {}
    assert not rig.refused("objects")


def test_a_lifetime_ends_while_a_shape_is_built(rig: Rig, gate: Gate) -> None:
    marker = triangle()
    marker.lifetime.nanosec = 50_000_000
    rig.send(marker)
    rig.until(lambda: rig.node.objects.shapes.builder.is_busy, "its shape being built")
    gone(rig, BODY)
    gate.open()
    rig.send(triangle(OTHER))
    rig.built(OTHER)
    assert BODY not in rig.node.objects.table.slots


def test_the_same_points_and_files_are_built_once(rig: Rig, tmp_path: Path) -> None:
    gate = Gate(rig)
    file = tmp_path / "part.stl"
    trimesh.creation.box((1.0, 1.0, 1.0)).export(file)
    keys = [("body", number) for number in range(6)]
    rig.send(*(triangle(key) for key in keys[:3]), *(mesh_marker(file, key) for key in keys[3:]))
    rig.until(lambda: len(rig.node.objects.shapes.builder) == len(keys), "all to wait")
    gate.open()
    rig.built(*keys)
    assert gate.jobs == ["triangles", "file"]
    rig.send(triangle(("late", 1)), mesh_marker(file, ("late", 2)))
    rig.built(("late", 1), ("late", 2))
    assert gate.jobs[:2] == ["triangles", "file"]
    assert gate.jobs.count("triangles") == 1
    scene = rig.node.objects.scene
    assert len({id(shape) for shape in scene._cache._shapes.values()}) == 2


def test_a_file_is_looked_at_again_when_a_marker_names_it_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(shape_requests, "CHECK_PERIOD", 0.05)
    file = tmp_path / "part.stl"
    trimesh.creation.box((1.0, 1.0, 1.0)).export(file)
    with Rig() as rig:
        rig.send(cube(BOX, (2.0, 0.0, 0.0)), mesh_marker(file), mesh_marker(file, OTHER))
        rig.built(BODY, OTHER)
        assert named(sync(rig)) == named({("body/1", "body/2")})
        rig.send(mesh_marker(file))
        assert not doubtful(rig, BODY), "a look at the file is no reason for doubt"
        trimesh.creation.box((5.0, 5.0, 5.0)).export(file)
        os.utime(file, ns=(0, 1))
        rig.send(mesh_marker(file))
        everything = named({("box/1", "body/1"), ("box/1", "body/2"), ("body/1", "body/2")})
        rig.until(lambda: named(sync(rig)) == everything, "the new file, in all that have it")
        file.unlink()
        rig.send(mesh_marker(file))
        rig.until(lambda: rig.refused("objects"), "refusal")
        assert named(sync(rig)) == everything, "the last box stays"
        assert doubtful(rig, BODY)
        assert set(rig.refused("objects")) == {"unreadable mesh"}

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

"""Markers: shapes, world boxes, and names from outside, of which tables stay small."""

from __future__ import annotations

import zlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from each import each
from geometry_msgs.msg import Point
from objects_rig import named
from rclpy.serialization import deserialize_message
from rig import A1, A2, B1, Patch, Rig, color, cube, pose, sync
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision import OBB, Boxes, shapes
from obb_collision.node import namespace_number, namespace_table
from obb_collision.node.messages import marker_shapes, names
from obb_collision.node.messages.box_markers import COLORS, MarkerArrayWriter, Markers, edge_points
from obb_collision.node.messages.cdr import namespace_bytes
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import MAX_NAME_BYTES, FrameTable, NamespaceTable
from obb_collision.node.outputs import NAMESPACES_RATE

POINTS = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 1.0, 0.0)]


def marker(kind: int, scale: tuple[float, float, float] = (1.0, 1.0, 1.0), points=()) -> Marker:  # type: ignore[no-untyped-def]
    message = Marker(type=kind, points=[Point(x=x, y=y, z=z) for x, y, z in points])
    message.scale.x, message.scale.y, message.scale.z = scale
    return message


def inside(box: OBB, points: Any) -> bool:
    return bool(np.all(box.contains(np.array(points))))


def world(message: Marker) -> OBB:
    return OBB(*marker_shapes.shape_from_ros(message).local_box)


@each("kind", [Marker.CUBE, Marker.SPHERE, Marker.CYLINDER])
def test_bodies_fill_their_scale(kind: int) -> None:
    box = world(marker(kind, (1.0, 2.0, 3.0)))
    assert box.half_extents.tolist() == [0.5, 1.0, 1.5]
    assert box.center.tolist() == [0.0, 0.0, 0.0]


@each(
    "kind, scale, reach",
    [
        (Marker.TRIANGLE_LIST, (2.0, 1.0, 1.0), (0.0, 0.0, 0.0)),
        (Marker.LINE_STRIP, (0.2, 0.0, 0.0), (0.1, 0.1, 0.1)),
        (Marker.LINE_LIST, (0.2, 0.0, 0.0), (0.1, 0.1, 0.1)),
    ],
)
def test_triangles_and_lines_are_one_body_around_all_points(
    kind: int, scale: tuple[float, float, float], reach: tuple[float, float, float]
) -> None:
    box = world(marker(kind, scale, POINTS))
    stretch = np.array(scale) if kind == Marker.TRIANGLE_LIST else 1.0
    for sign in np.ndindex(2, 2, 2):
        corners = np.array(POINTS) * stretch + (2 * np.array(sign) - 1) * reach
        assert inside(box, corners)
    size = np.ptp(np.array(POINTS) * stretch, axis=0) + 2 * np.array(reach)
    assert np.prod(2 * box.half_extents) <= np.prod(size) * 1.0001 + 1e-9


def test_arrows_contain_what_is_drawn() -> None:
    along_x = world(marker(Marker.ARROW, (2.0, 0.1, 0.2)))
    assert inside(along_x, [(0, 0, 0), (2, 0, 0), (1.6, 0.1, 0), (1.6, 0, 0.2)])
    assert not along_x.contains((-0.01, 0.0, 0.0))
    between = world(marker(Marker.ARROW, (0.1, 0.2, 0.0), POINTS[:2]))
    assert inside(between, [(0, 0.1, 0), (2, 0, -0.1)])


def test_meshes_are_read_from_uris_and_from_the_message(tmp_path: Path) -> None:
    file = tmp_path / "part name.stl"
    trimesh.creation.box((1.0, 2.0, 3.0)).export(file)
    message = marker(Marker.MESH_RESOURCE, (1.0, 1.0, 2.0))
    message.mesh_resource = file.as_uri()
    assert sorted(world(message).half_extents.round(6)) == [0.5, 1.0, 3.0]
    sent = marker(Marker.MESH_RESOURCE)
    sent.mesh_resource, sent.mesh_file.filename = "embedded://part.stl", "part.stl"
    sent.mesh_file.data = file.read_bytes()
    assert sorted(world(sent).half_extents.round(6)) == [0.5, 1.0, 1.5]


@each(
    "message, reason",
    [
        (marker(Marker.TEXT_VIEW_FACING), "no body"),
        (marker(77), "unknown marker type"),
        (marker(Marker.CUBE, (1.0, 0.0, 1.0)), "bad scale"),
        (marker(Marker.CUBE, (1.0, -1.0, 1.0)), "bad scale"),
        (marker(Marker.CUBE, (1.0, float("nan"), 1.0)), "bad scale"),
        (marker(Marker.SPHERE, (1.0, float("inf"), 1.0)), "bad scale"),
        (marker(Marker.POINTS, (0.0, 1.0, 0.0), POINTS), "bad scale"),
        (marker(Marker.CUBE, (1.0, 5e-323, 1.0)), "bad scale"),
        (marker(Marker.POINTS), "no points"),
        (marker(Marker.SPHERE_LIST, points=POINTS), "several bodies"),
        (marker(Marker.TRIANGLE_LIST, points=POINTS[:2]), "array lengths differ"),
        (marker(Marker.ARROW, points=POINTS[:1]), "array lengths differ"),
        (marker(Marker.CUBE_LIST, points=[(0.0, float("nan"), 0.0)]), "bad points"),
        (marker(Marker.MESH_RESOURCE), "unreadable mesh"),
    ],
)
def test_what_is_no_body_is_refused_with_a_reason(message: Marker, reason: str) -> None:
    with pytest.raises(RefusedError) as caught:
        marker_shapes.shape_from_ros(message)
    assert caught.value.reason == reason


def test_signatures_change_with_the_shape_only() -> None:
    def signature() -> marker_shapes.Signature:
        return marker_shapes.plan_shape(marker_shapes.marker_shape_from_ros(moved)).signature

    moved = marker(Marker.LINE_LIST, points=POINTS)
    first = signature()
    moved.pose.position.x = 5.0
    assert signature() == first
    moved.points[1].x += 1e-9
    assert signature() != first


def test_shapes_come_back_from_markers() -> None:
    vertices, faces = [(0.0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [(0, 1, 2), (0, 2, 3)]
    for shape in (
        shapes.Box((1.0, 2.0, 3.0)),
        shapes.Sphere(0.7),
        shapes.Ellipsoid((1.0, 2.0, 3.0)),
        shapes.Cylinder(0.5, 2.0, scale=(1.0, 2.0, 3.0)),
        shapes.Mesh(vertices, faces, scale=(2.0, 1.0, 1.0)),
    ):
        back = marker_shapes.shape_from_ros(marker_shapes.shape_to_ros(shape))
        for got, expected in zip(back.local_box, shape.local_box, strict=True):
            np.testing.assert_array_equal(got, expected)
    with pytest.raises(TypeError, match="Cone"):
        marker_shapes.shape_to_ros(shapes.Cone(1.0, 1.0))


BOXES = Boxes.from_poses(
    np.array([(0, 0, 0, 0, 0, 0, 1.0), (5, 6, 7, 0, 0.6, 0, 0.8)]),
    np.array([(0.5, 1.0, 1.5), (0.1, 0.0, 0.3)]),
)
STAMP = 12_000_000_345


def read(data: bytes) -> list[Marker]:
    return list(deserialize_message(data, MarkerArray).markers)


def test_serialised_cubes_are_what_rclpy_reads() -> None:
    markers = Markers("map")
    keys = [("äb", 1), ("", -2)]
    first, second = read(markers.write(keys, BOXES, np.array([0, 2]), STAMP, 1.5, None))
    assert (first.ns, first.id, first.type, first.action) == ("äb", 1, Marker.CUBE, Marker.ADD)
    assert (second.ns, second.id) == ("", -2)
    assert second.header.frame_id == "map"
    assert (second.header.stamp.sec, second.header.stamp.nanosec) == (12, 345)
    assert (second.lifetime.sec, second.lifetime.nanosec) == (1, 500_000_000)
    assert (second.pose.position.x, second.pose.orientation.y) == pytest.approx((5.0, 0.6))
    assert (first.scale.x, first.scale.y, first.scale.z) == (1.0, 2.0, 3.0)
    assert second.scale.y > 0.0, "RViz refuses flat cubes"
    turns = [marker.pose.orientation for marker in (first, second)]
    norms = [np.linalg.norm([turn.x, turn.y, turn.z, turn.w]) for turn in turns]
    assert norms == pytest.approx([1.0, 1.0], abs=1e-9), "as RViz and Foxglove require them"
    assert (second.color.r, second.color.a) == pytest.approx((COLORS[2][0], COLORS[2][3]))


def test_gone_markers_are_deleted_once_and_lists_replace_cubes() -> None:
    assert read(MarkerArrayWriter("map", 0, 0.0).message()) == []
    markers = Markers("map")
    keys = [A1, A2]
    markers.write(keys, BOXES, np.array([0, 0]), STAMP, 0.0, None)
    message = read(markers.write(keys[:1], BOXES[np.array([0])], np.array([1]), STAMP, 0.0, None))
    assert [(m.id, m.action) for m in message] == [(2, Marker.DELETE), (1, Marker.ADD)]
    message = read(markers.write([], BOXES, np.array([0, 1]), STAMP, 0.0, 0.01))
    assert [m.action for m in message] == [Marker.DELETE, Marker.ADD, Marker.ADD]
    assert [len(m.points) for m in message] == [0, 24, 24]
    ends = np.array([(p.x, p.y, p.z) for m in message[1:] for p in m.points])
    np.testing.assert_array_equal(ends, edge_points(BOXES))
    edges = np.linalg.norm(ends[1:24:2] - ends[:24:2], axis=1)
    assert sorted(edges.tolist()) == [1.0] * 4 + [2.0] * 4 + [3.0] * 4
    empty = Boxes(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty((0, 3)))
    message = read(markers.write([], empty, np.empty(0, np.int64), STAMP, 0.0, 0.01))
    assert [m.action for m in message] == [Marker.DELETE, Marker.DELETE]


def test_marker_boxes_are_complete_coloured_by_state_and_deleted_when_gone() -> None:
    with Rig(marker_rate=100.0) as rig:
        rig.send(cube(A1), cube(A2, (0.5, 0, 0)), cube(B1, (9, 0, 0), (1, 2, 3))).answer()

        def shown() -> dict[tuple[str, int], Marker]:
            return {(m.ns, m.id): m for m in rig.next("obb_collision/markers").markers}

        rig.until(lambda: len(shown()) == 3, "three markers")
        boxes = shown()
        assert all(m.action == Marker.ADD and m.type == Marker.CUBE for m in boxes.values())
        for key, state in ((A1, 1), (A2, 1), (B1, 0)):
            assert color(boxes[key]) == COLORS[state]
        assert (boxes[B1].scale.x, boxes[B1].scale.y, boxes[B1].scale.z) == (1.0, 2.0, 3.0)
        assert boxes[B1].pose.position.x == 9.0
        rig.send(cube(B1, (8, 0, 0), (0, 1, 1)))
        rig.until(lambda: color(shown()[B1]) == COLORS[2], "grey")
        assert shown()[B1].pose.position.x == 9.0, "a refused object keeps its last box"
        rig.send(Marker(ns="a", id=2, action=Marker.DELETE))
        rig.until(lambda: shown().get(A2, Marker()).action == Marker.DELETE, "delete")
        rig.until(lambda: A2 not in shown() and A1 in shown(), "gone")


LONG = "x" * 1_000_000


def test_the_number_is_the_crc_32_as_int32() -> None:
    for name in ("", "a", "b", "äöü/1", "crate"):
        number = np.array(namespace_number(name), np.int32)
        assert number.view(np.uint32) == zlib.crc32(name.encode())


def test_of_two_namespaces_with_one_number_the_second_is_refused_until_the_first_is_gone() -> None:
    first, second = ("plumless", 1), ("buckeroo", 1)
    assert namespace_number(first[0]) == namespace_number(second[0])
    with Rig() as rig:
        rig.send(cube(first), cube(second, (0.1, 0, 0)), cube(A1, (0.2, 0, 0)))
        assert named(rig.pairs()) == named({("a/1", "plumless/1")})
        assert rig.refused("objects") == {"namespace number taken": 1}
        assert rig.node.objects.unplaceable == {second: "namespace number taken"}
        rig.send(Marker(ns=first[0], id=1, action=Marker.DELETE))
        rig.send(cube(second, (0.1, 0, 0)), cube(A1, (0.2, 0, 0))).answer()
        rig.until(lambda: "buckeroo" in namespace_table(rig.last["namespaces"]).values(), "table")
        assert named(rig.pairs()) == named({("a/1", "buckeroo/1")})


@each("number", [0, 1, -1, 2**31 - 1, -(2**31)])
def test_unknown_numbers_are_refused_and_counted(rig: Rig, number: int) -> None:
    rig.send(cube(A1), cube(A2, (0.5, 0, 0))).answer()
    rig.send_poses([1, 2], [pose(5.0), pose(6.0)], [number, namespace_number("a")])
    rig.refuses("object_poses", {"unknown namespace": 1})
    assert sync(rig) == set(), "the other row is used"


def test_the_same_bits_as_uint32_will_do(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0))).answer()
    table = rig.node.objects.table
    unsigned = np.array([zlib.crc32(b"a")], np.int64)
    assert unsigned[0] >= 2**31
    assert table.find(unsigned, np.array([2])).tolist() == [table.slots[A2]]
    assert table.find(unsigned + 2**32, np.array([2])).tolist() == [-1]
    assert table.find(unsigned, np.array([2**40])).tolist() == [-1]


def test_long_names_are_refused_and_not_kept(rig: Rig) -> None:
    limit = "y" * MAX_NAME_BYTES
    rig.send(*(cube((f"{number}{LONG}", 1)) for number in range(5)), cube((limit, 1)), cube(A1))
    rig.pairs()
    assert rig.refused("objects") == {"bad name": 5}
    unplaceable = rig.node.objects.unplaceable
    assert len(unplaceable) == 5, "they are not checked, and that is said"
    assert all(len(namespace) < MAX_NAME_BYTES for namespace, _ in unplaceable)
    rig.send(Marker(ns="0" + LONG, id=1, action=Marker.DELETE))
    rig.send(Marker(ns="1" + LONG, action=Marker.DELETEALL))
    sync(rig)
    assert len(unplaceable) == 3
    rig.send_transform(LONG, pose(0.0))
    rig.refuses("object_transform", {"unknown object": 1})
    rig.send_transform("a/1", pose(0.0), LONG)
    rig.until(lambda: rig.refused("object_transform").get("bad name"), "refusal")
    assert set(namespace_table(rig.last["namespaces"]).values()) == {limit, "a", "sync"}


@each("name", ["\ud800", "a\0b", "é" * 128, "a\nb", "\n" * 255, "\ud800" * 2000, LONG])
def test_what_is_no_name_is_refused(name: str) -> None:
    with pytest.raises(RefusedError, match="bad name"):
        names.check_name(name, "namespace")
    with pytest.raises(RefusedError, match="bad name"):
        NamespaceTable().admit(name)
    kept = names.shortened(name)
    assert kept.isprintable()
    names.check_name(kept, "namespace")
    assert names.shortened(kept) == kept


def test_namespaces_come_and_go_and_a_full_table_recovers(rig: Rig, monkeypatch: Patch) -> None:
    monkeypatch.setattr(names, "MAX_NAMESPACES", 20)
    for round_ in range(3):
        rig.send(*(cube((f"{round_} {number}", 0), (5.0 * number, 0, 0)) for number in range(25)))
        rig.answer()
        assert len(rig.node.objects.table) == 20
        assert rig.refused("objects") == {"too many namespaces": 5 * (round_ + 1)}
        rig.send(Marker(action=Marker.DELETEALL))
        sync(rig)
        rig.send(Marker(action=Marker.DELETEALL))
    rig.until(lambda: len(rig.node.objects.table) == 0, "all deleted")
    rig.call(Trigger, "obb_collision/clear", Trigger.Request())
    rig.until(lambda: len(rig.last["namespaces"].values) == 0, "an empty table")


def test_a_scene_file_with_more_than_fits_starts_with_the_rest(tmp_path: Path) -> None:
    file = tmp_path / "many.yaml"
    shape = "shape: box, size: [1, 1, 1]"
    lines = [f"  - {{name: thing {n}, {shape}, position: [{2 * n}, 0, 0]}}" for n in range(9)]
    file.write_text("\n".join(["objects:", *lines]))
    with Rig(scene_file=str(file), max_objects=7) as rig:
        assert len(rig.node.objects.table) == 7
        assert set(rig.node.objects.unplaceable.values()) == {"too many objects"}
        rig.send_transform("thing 0/0", pose(1.5))
        assert named(rig.pairs()) == named({("thing 0/0", "thing 1/0")})


def test_the_table_is_bounded_in_bytes() -> None:
    table = NamespaceTable()
    most = names.MAX_NAMESPACE_BYTES // MAX_NAME_BYTES
    for number in range(most + 10):
        table.use(table.admit(f"{number:0{MAX_NAME_BYTES}}")) if number < most else None
    with pytest.raises(RefusedError, match="too many namespaces"):
        table.admit("z" * MAX_NAME_BYTES)
    table.leave(next(iter(table.names)))
    table.admit("z" * MAX_NAME_BYTES)
    assert len(table) == most


def test_unused_namespaces_stay_until_their_place_is_needed() -> None:
    table = NamespaceTable()
    number = table.admit("a")
    table.use(number, 2)
    version = table.version
    table.leave(number, 2)
    assert (table.names, table.version) == ({number: "a"}, version), "no table is sent for it"
    assert table.admit("a") == number
    table.forget_unused()
    assert (table.names, len(table)) == ({}, 0)
    assert table.version > version


@each("count", [0, 1, 5])
def test_the_table_is_written_as_rclpy_would(count: int) -> None:
    table = {namespace_number("ä" * n): "ä" * n for n in range(count)}
    message = deserialize_message(namespace_bytes(table), DiagnosticStatus)
    values = [KeyValue(key=str(number), value=name) for number, name in table.items()]
    text = f"{count} namespaces"
    assert message == DiagnosticStatus(name="namespaces", message=text, values=values)


def test_a_large_table_is_not_sent_at_every_cycle(rig: Rig, monkeypatch: Patch) -> None:
    now, out = [1e6], rig.node.outputs
    sent: list[bytes] = []
    monkeypatch.setattr("obb_collision.node.outputs.outputs.perf_counter", lambda: now[0])
    monkeypatch.setattr(out, "namespaces", SimpleNamespace(publish=sent.append))
    table = NamespaceTable()
    for number in range(10_000):
        table.admit(f"{number:0100}")
        if number % 10 == 9:
            now[0] += 0.02  # 1,000 cycles, each with new names
            out.publish_namespaces(table)
    assert sum(len(data) for data in sent) < 1.2 * NAMESPACES_RATE * 20.0
    assert len(sent) < 500, "each at first, later ones more and more rarely"
    now[0] += 1.0
    out.publish_namespaces(table)
    assert len(deserialize_message(sent[-1], DiagnosticStatus).values) == 10_000


def test_frames_that_nothing_uses_give_their_place_to_others() -> None:
    frames = FrameTable("map")
    assert frames.index("") == frames.index("map") == 0
    indices = [frames.index(f"f{number}") for number in range(names.MAX_FRAMES - 1)]
    assert [frames.name(index) for index in indices[:2]] == ["f0", "f1"]
    assert frames.is_full
    frames.keep_only(indices)
    with pytest.raises(RefusedError, match="too many frames"):
        frames.index("one more")
    frames.keep_only([*indices[:5], *indices[6:]])
    assert "f5" not in frames
    assert frames.index("one more") == indices[5]
    assert frames.index("f6") == indices[6]
    assert len(frames) == names.MAX_FRAMES
    with pytest.raises(RefusedError, match="bad name"):
        frames.index(LONG)

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

"""Markers -> shapes and back, and the world boxes as markers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from each import each
from geometry_msgs.msg import Point
from rclpy.serialization import deserialize_message
from rig import Rig, color, cube
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision import OBB, Boxes, shapes
from obb_collision.node.messages.box_markers import COLORS, MarkerArrayWriter, Markers, edge_points
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_shapes import (
    Signature,
    marker_shape_from_ros,
    plan_shape,
    shape_from_ros,
    shape_to_ros,
)

POINTS = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 1.0, 0.0)]


def marker(kind: int, scale: tuple[float, float, float] = (1.0, 1.0, 1.0), points=()) -> Marker:  # type: ignore[no-untyped-def]
    message = Marker(type=kind, points=[Point(x=x, y=y, z=z) for x, y, z in points])
    message.scale.x, message.scale.y, message.scale.z = scale
    return message


def signature_of(message: Marker) -> Signature:
    return plan_shape(marker_shape_from_ros(message)).signature


def inside(box: OBB, points: Any) -> bool:
    return bool(np.all(box.contains(np.array(points))))


def world(message: Marker) -> OBB:
    return OBB(*shape_from_ros(message).local_box)


@each("kind", [Marker.CUBE, Marker.SPHERE, Marker.CYLINDER])
def test_bodies_fill_their_scale(kind: int) -> None:
    box = world(marker(kind, (1.0, 2.0, 3.0)))
    assert box.half_extents.tolist() == [0.5, 1.0, 1.5]
    assert box.center.tolist() == [0.0, 0.0, 0.0]


@each(
    "kind, scale, reach",
    [
        (Marker.TRIANGLE_LIST, (2.0, 1.0, 1.0), (0.0, 0.0, 0.0)),
        (Marker.CUBE_LIST, (0.2, 0.4, 0.6), (0.1, 0.2, 0.3)),
        (Marker.SPHERE_LIST, (0.2, 0.4, 0.6), (0.1, 0.2, 0.3)),
        (Marker.POINTS, (0.2, 0.4, 0.0), (0.2, 0.2, 0.2)),
        (Marker.LINE_STRIP, (0.2, 0.0, 0.0), (0.1, 0.1, 0.1)),
        (Marker.LINE_LIST, (0.2, 0.0, 0.0), (0.1, 0.1, 0.1)),
    ],
)
def test_lists_are_one_body_around_all_points(
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
        (marker(Marker.TRIANGLE_LIST, points=POINTS[:2]), "array lengths differ"),
        (marker(Marker.ARROW, points=POINTS[:1]), "array lengths differ"),
        (marker(Marker.CUBE_LIST, points=[(0.0, float("nan"), 0.0)]), "bad points"),
        (marker(Marker.MESH_RESOURCE), "unreadable mesh"),
    ],
)
def test_what_is_no_body_is_refused_with_a_reason(message: Marker, reason: str) -> None:
    with pytest.raises(RefusedError) as caught:
        shape_from_ros(message)
    assert caught.value.reason == reason


def test_signatures_change_with_the_shape_only() -> None:
    first, moved = marker(Marker.LINE_LIST, points=POINTS), marker(Marker.LINE_LIST, points=POINTS)
    moved.pose.position.x = 5.0
    assert signature_of(first) == signature_of(moved)
    moved.points[1].x += 1e-9
    assert signature_of(first) != signature_of(moved)


def test_shapes_come_back_from_markers() -> None:
    vertices, faces = [(0.0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [(0, 1, 2), (0, 2, 3)]
    for shape in (
        shapes.Box((1.0, 2.0, 3.0)),
        shapes.Sphere(0.7),
        shapes.Ellipsoid((1.0, 2.0, 3.0)),
        shapes.Cylinder(0.5, 2.0, scale=(1.0, 2.0, 3.0)),
        shapes.Mesh(vertices, faces, scale=(2.0, 1.0, 1.0)),
    ):
        back = shape_from_ros(shape_to_ros(shape))
        for got, expected in zip(back.local_box, shape.local_box, strict=True):
            np.testing.assert_array_equal(got, expected)
    with pytest.raises(TypeError, match="Cone"):
        shape_to_ros(shapes.Cone(1.0, 1.0))


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
    markers = Markers("map")
    keys = [("a", 1), ("a", 2)]
    markers.write(keys, BOXES, np.array([0, 0]), STAMP, 0.0, None)
    message = read(markers.write(keys[:1], BOXES[np.array([0])], np.array([1]), STAMP, 0.0, None))
    assert [(m.id, m.action) for m in message] == [(2, Marker.DELETE), (1, Marker.ADD)]
    message = read(markers.write([], BOXES, np.array([0, 1]), STAMP, 0.0, 0.01))
    assert [m.action for m in message] == [Marker.DELETE, Marker.ADD, Marker.ADD]
    assert [len(m.points) for m in message] == [0, 24, 24]
    ends = np.array([(p.x, p.y, p.z) for m in message[1:] for p in m.points])
    np.testing.assert_array_equal(ends, edge_points(BOXES))
    empty = Boxes(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty((0, 3)))
    message = read(markers.write([], empty, np.empty(0, np.int64), STAMP, 0.0, 0.01))
    assert [m.action for m in message] == [Marker.DELETE, Marker.DELETE]


def test_the_edges_of_a_box_are_twelve_with_the_right_lengths() -> None:
    ends = edge_points(BOXES)[:24].reshape(12, 2, 3)
    lengths = sorted(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).tolist())
    assert lengths == [1.0] * 4 + [2.0] * 4 + [3.0] * 4


def test_an_empty_marker_array_is_serialised() -> None:
    assert read(MarkerArrayWriter("map", 0, 0.0).message()) == []


A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)


def test_marker_boxes_are_complete_coloured_by_state_and_deleted_when_gone() -> None:
    with Rig(marker_rate=100.0) as rig:
        rig.listen("obb_collision/markers")
        rig.send(cube(A1), cube(A2, (0.5, 0, 0)), cube(B1, (9, 0, 0), (1, 2, 3))).answer()
        bad = cube(B1, (8, 0, 0), (0, 1, 1))

        def shown() -> dict[tuple[str, int], Marker]:
            return {(m.ns, m.id): m for m in rig.next("obb_collision/markers").markers}

        rig.until(lambda: len(shown()) == 3, "three markers")
        boxes = shown()
        assert all(m.action == Marker.ADD and m.type == Marker.CUBE for m in boxes.values())
        assert color(boxes[A1]) == COLORS[1]
        assert color(boxes[A2]) == COLORS[1]
        assert color(boxes[B1]) == COLORS[0]
        assert (boxes[B1].scale.x, boxes[B1].scale.y, boxes[B1].scale.z) == (1.0, 2.0, 3.0)
        assert boxes[B1].pose.position.x == 9.0
        rig.send(bad)
        rig.until(lambda: color(shown()[B1]) == COLORS[2], "grey")
        assert shown()[B1].pose.position.x == 9.0, "a refused object keeps its last box"
        rig.send(Marker(ns="a", id=2, action=Marker.DELETE))
        rig.until(lambda: shown().get(A2, Marker()).action == Marker.DELETE, "delete")
        rig.until(lambda: A2 not in shown() and A1 in shown(), "gone")

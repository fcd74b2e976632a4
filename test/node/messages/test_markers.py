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

"""The boxes that the node draws."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")
from rig import Rig, color, cube
from visualization_msgs.msg import Marker

from obb_collision.node.messages.box_markers import COLORS, LINES_NAMESPACE

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
NAN = float("nan")


def test_marker_boxes_are_complete_coloured_by_state_and_deleted_when_gone() -> None:
    with Rig(marker_rate=100.0) as rig:
        rig.listen("obb_collision/markers")
        rig.send(cube(A1), cube(A2, (0.5, 0, 0)), cube(B1, (9, 0, 0), (1, 2, 3)))
        rig.answer()
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


def test_many_boxes_are_drawn_as_lines() -> None:
    with Rig(marker_rate=100.0, marker_max_cubes=2) as rig:
        rig.listen("obb_collision/markers")
        rig.send(cube(A1), cube(A2, (0.5, 0, 0)), cube(B1, (9, 0, 0)))
        rig.answer()

        def lines() -> dict[int, int]:
            markers = rig.next("obb_collision/markers").markers
            return {
                m.id: len(m.points)
                for m in markers
                if m.ns == LINES_NAMESPACE and m.type == Marker.LINE_LIST
            }

        rig.until(lambda: lines() == {0: 24, 1: 48}, "line lists")
        rig.set(marker_form="cubes")
        rig.until(lambda: lines() == {}, "cubes again")

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

"""Several senders of one topic: what one says stands for no other, and what was lost is missing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from each import each
from rclpy.serialization import serialize_message
from rig import POSES, Rig, cube, node_apart, pose
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.diagnostics.answer import COLLIDING, UNKNOWN

A1, A2 = ("a", 1), ("a", 2)
DELETEALL = Marker.DELETEALL


@contextmanager
def other_sender(rig: Rig, topic: str, depth: int = 1000) -> Iterator[Any]:
    """Yield another publisher of a topic, of a process of its own; it ends with this."""
    with node_apart("other") as node:
        publisher = node.create_publisher(rig.pubs[topic].msg_type, topic, depth)
        rig.until(publisher.get_subscription_count, "the node")
        yield publisher


def bad_and_good(rig: Rig, topic: str) -> tuple[Any, Any]:
    """Return a message of a topic about a/2, cut, and whole."""
    sent: list[Any] = []
    own = rig.pubs[topic]
    rig.pubs[topic] = type("Catcher", (), {"publish": staticmethod(sent.append)})()
    rig.send_by(topic, {A2: pose(5.0)})
    rig.pubs[topic] = own
    return serialize_message(sent[0])[:-9], sent[0]


@each("topic", POSES)
def test_what_one_sender_says_does_not_make_another_readable(topic: str) -> None:
    with Rig() as rig:
        rig.send(cube(A1), cube(A2, (5, 0, 0))).answer()
        rig.known()
        bad, good = bad_and_good(rig, topic)
        with other_sender(rig, topic) as other:
            other.publish(bad)
            rig.known("input_unreadable", topic)
            for step in range(5):
                rig.send_by(topic, {A1: pose(-0.1 * step)}).answer()
                rig.known("input_unreadable", topic)
            other.publish(good)
            rig.known()
            other.publish(bad)
            rig.known("input_unreadable", topic)
        rig.known("input_unreadable", topic)  # it is gone, and its object is where it said
        rig.send_by(topic, {A1: pose(-0.1)}).answer()
        rig.known("input_unreadable", topic)
        rig.send(cube(A2, action=Marker.DELETE))
        rig.known()


def test_a_sender_that_is_gone_and_has_no_object_asks_for_nothing() -> None:
    with Rig() as rig:
        rig.send(cube(A1)).answer()
        bad, _ = bad_and_good(rig, "object_poses")
        with other_sender(rig, "object_poses") as other:
            other.publish(bad)
            rig.known("input_unreadable", "object_poses")
        rig.known()


@each("ends", ["delete all", "clear"])
def test_changes_that_were_lost_are_missing_until_all_is_said_again(ends: str) -> None:
    with Rig(max_objects=100_000) as rig:
        depth = rig.node.topics["objects"].depth
        rig.send(cube(A1)).answer()
        rig.known()
        for n in range(depth + 5):  # the executor is at rest
            rig.send(cube(("b", n), (5.0 * n, 9.0, 0.0)))
        rig.known("messages_lost", "objects")
        assert rig.monitor("objects").lost > 0
        rig.send(cube(A1)).answer()
        rig.known("messages_lost", "objects")
        if ends == "clear":
            rig.call(Trigger, "obb_collision/clear", Trigger.Request())
        else:
            rig.send(cube(("", 0), action=DELETEALL), cube(A1)).answer()
        rig.known()


def test_the_first_gap_of_a_sender_counts_where_the_queue_was_full() -> None:
    with Rig(max_objects=100_000) as rig:
        rig.send(cube(A1)).answer()
        with other_sender(rig, "objects", 10_000) as other:
            own, rig.pubs["objects"] = rig.pubs["objects"], other
            for n in range(rig.node.topics["objects"].depth + 100):
                rig.send(cube(("b", n), (5.0 * n, 9.0, 0.0)))
            rig.known("messages_lost", "objects")
            rig.pubs["objects"] = own


def test_poses_that_were_lost_are_missing_until_newer_ones_came_of_all() -> None:
    with Rig() as rig:
        rig.send(cube(A1), cube(A2, (5, 0, 0))).answer()
        for step in range(rig.node.topics["object_transform"].depth + 9):
            rig.send_transform("a/2", pose(5.0 + step))
        rig.known("messages_lost", "object_transform")
        rig.send_transform("a/2", pose(7.0)).answer()
        rig.known("messages_lost", "object_transform")
        rig.send_transform("a/1", pose(0.0)).answer()
        rig.known()


def test_states_that_come_again_only_count_losses(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (5, 0, 0))).answer()
    for step in range(40):
        rig.send_states(["a/2"], [pose(5.0 + step)])
    rig.answer()
    assert rig.monitor("object_states").lost > 0
    rig.known()


def test_who_comes_late_has_lost_nothing() -> None:
    with node_apart("early") as node:
        publisher = node.create_publisher(MarkerArray, "objects", 10)
        for n in range(500):
            publisher.publish(MarkerArray(markers=[cube(("old", n))]))
        with Rig() as rig:
            rig.until(publisher.get_subscription_count, "the node")
            publisher.publish(MarkerArray(markers=[cube(A1)]))
            rig.until(lambda: len(rig.node.objects.table) == 1, "its next message")
            rig.known()
            assert rig.monitor("objects").lost == 0


def test_two_senders_of_complete_sets_are_named(rig: Rig) -> None:
    rig.send_boxes([1], [pose(0.0)]).answer()
    own = rig.pubs["object_boxes"]
    with other_sender(rig, "object_boxes") as other:
        rig.pubs["object_boxes"] = other  # as one that has restarted, which is no second one
        rig.send_boxes([2], [pose(0.0)]).answer()
        rig.known()
        rig.pubs["object_boxes"] = own
        rig.send_boxes([1], [pose(0.0)]).answer()
        rig.known("two_publishers", "object_boxes")
    rig.known()


def test_a_set_of_a_restarted_sender_is_not_older_than_those_before(rig: Rig) -> None:
    rig.send_boxes([1], [pose(0.0)]).answer()
    own, later = rig.pubs["object_boxes"], rig.stamp
    with other_sender(rig, "object_boxes") as other:
        rig.pubs["object_boxes"], rig.stamp = other, later - 500_000_000
        rig.send_boxes([1, 2], [pose(0.0), pose(0.5)])
        rig.says(COLLIDING)
        rig.pubs["object_boxes"], rig.stamp = own, later
    rig.send_boxes([], np.empty((0, 7)))
    rig.known()


@each("first", [[1], []])
def test_an_older_set_of_one_sender_marks_its_boxes_or_its_input(first: list[int]) -> None:
    with Rig() as rig:
        rig.send_boxes(first, [pose(0.0)] * len(first))
        rig.known()
        rig.stamp -= 500_000_000
        rig.send_boxes([1, 2], [pose(0.0), pose(0.5)])
        values = rig.says(UNKNOWN)
        assert values["reason"] == ("refused" if first else "input_unreadable")
        rig.stamp += 700_000_000
        rig.send_boxes(first, [pose(0.0)] * len(first))
        rig.known()


def test_another_node_of_the_same_name_is_named(rig: Rig) -> None:
    rig.send(cube(A1)).answer()
    with node_apart("obb_collision") as node:
        other = node.create_publisher(
            rig.node.outputs.publishers["collision_status"].msg_type, "collision_status", 1
        )
        rig.known("two_publishers", "collision_status")
        node.destroy_publisher(other)
        rig.known()
        node.create_publisher(other.msg_type, "recorded/collision_status", 1)
        rig.cycles(40)
        rig.known()

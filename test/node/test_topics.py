"""The node by its topics and services only: what goes in, what comes out, what is refused."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Twist
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rig import FRAME, NAMESPACE, Client, Rig, cube, overlaps, pose
from sensor_msgs.msg import PointCloud2, PointField
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

from obb_collision import Verdict
from obb_collision.node import collisions_from_ros, poses_to_ros
from obb_collision.node.conversions import namespaces_from_ros, stamp_from_ros, states_to_ros
from obb_collision.node.errors import RefusedError
from obb_collision.node.markers import COLORS, LINES_NAMESPACE

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
NAN = float("nan")


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig() as made:
        yield made


def sync(rig: Client) -> set[tuple[str, str]]:
    """Pairs once everything sent before is taken in: a far cube's state comes after it."""
    rig.send(cube(("sync", 0), (1e3, 1e3, 1e3)))
    return rig.pairs()


# --- what goes in and out ------------------------------------------------------------------------


def test_collisions_come_every_cycle_also_when_there_is_nothing(rig: Rig) -> None:
    first = rig.next("collisions")
    second = rig.next("collisions")
    assert first.header.frame_id == second.header.frame_id == FRAME
    assert stamp_from_ros(second.header.stamp) > stamp_from_ros(first.header.stamp)
    assert len(collisions_from_ros(second)) == 0
    assert rig.last["in_collision"].data is False


def test_markers_make_objects_and_transforms_move_them(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3.0, 0.0, 0.0)), cube(B1, (6.0, 0.0, 0.0)))
    assert rig.pairs() == set()
    rig.send_transform("a/2", pose(0.75))
    assert rig.pairs() == {("a/1", "a/2")}
    (row,) = collisions_from_ros(rig.last["collisions"])
    assert row["depth"] == pytest.approx(0.25)
    assert (row["normal_x"], row["normal_y"], row["normal_z"]) == pytest.approx((1.0, 0.0, 0.0))
    assert 0.25 <= row["x"] <= 0.5
    rig.until(lambda: rig.last["in_collision"].data, "in_collision")
    rig.send_transform("a/2", pose(6.5))
    assert rig.pairs() == {("a/2", "b/1")}
    rig.send_transform("a/2", pose(3.0))
    assert rig.pairs() == set()
    rig.until(lambda: not rig.last["in_collision"].data, "in_collision false")


def test_touching_boxes_collide(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (1.0, 0.0, 0.0)))
    assert rig.pairs() == {("a/1", "a/2")}


def test_rows_are_sorted_with_the_smaller_key_first(rig: Rig) -> None:
    # sent in an order in which scene indices and keys disagree
    rig.send(
        cube(("z", 7), (0.2, 0, 0)), cube(("z", -7), (0.1, 0, 0)), cube(("b", 3)), cube(("b", 2))
    )
    message = rig.answer()
    rows = collisions_from_ros(message)
    keys = [tuple(int(row[n]) for n in ("ns_a", "id_a", "ns_b", "id_b")) for row in rows]
    assert keys == sorted(keys)
    assert len(keys) == 6
    assert all(key[:2] < key[2:] for key in keys)
    assert rig.namespaces(2) == ["z", "b"]
    (row,) = rows[(rows["id_a"] == -7) & (rows["id_b"] == 7)]
    assert row["normal_x"] > 0.99


def test_states_move_many_objects_by_name(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0)), cube(("", 5), (6, 0, 0)))
    rig.send_states(["a/1", "/5"], [pose(3.5), pose(4.2)])
    assert rig.pairs() == {("a/1", "a/2"), ("a/1", "/5")}
    rig.send_states(["5"], [pose(9.0)])
    assert rig.pairs() == {("a/1", "a/2")}


@pytest.mark.parametrize("single", [False, True])
def test_clouds_move_many_objects_by_index(rig: Rig, single: bool) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0)), cube(B1, (6, 0, 0)))
    rig.answer()
    table = rig.namespaces(2)
    namespaces = [table.index("b"), table.index("a")]
    rig.send_poses([1, 2], [pose(0.5), pose(1.25)], namespaces, single=single)
    assert rig.pairs() == {("a/1", "b/1"), ("a/2", "b/1")}


def test_clouds_without_ns_serve_a_single_namespace_and_are_refused_otherwise(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0)))
    rig.answer()
    rig.send_poses([2], [pose(0.5)])
    assert rig.pairs() == {("a/1", "a/2")}
    rig.send(cube(B1, (9, 0, 0)))
    rig.answer()
    rig.send_poses([2], [pose(5.0)])
    rig.until(lambda: rig.refused("object_poses"), "refusal")
    assert rig.refused("object_poses") == {"field layout": 1}
    assert sync(rig) == {("a/1", "a/2")}


def test_an_unchanged_shape_is_a_pose_update_and_a_changed_one_is_fitted(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0)))
    rig.answer()
    shape = rig.node.objects.signature(A2)
    rig.send(cube(A2, (0.5, 0, 0)))
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.node.objects.signature(A2) is shape
    rig.send(cube(A2, (3, 0, 0), (5.0, 1.0, 1.0)))
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.node.objects.signature(A2) != shape


def test_delete_takes_one_and_deleteall_a_namespace_or_everything(rig: Rig) -> None:
    everyone = [cube(A1), cube(A2, (0.1, 0, 0)), cube(B1, (0.2, 0, 0)), cube(("", 9), (0.3, 0, 0))]
    rig.send(*everyone)
    assert len(rig.pairs()) == 6
    rig.send(
        Marker(ns="a", id=1, action=Marker.DELETE), Marker(ns="a", id=77, action=Marker.DELETE)
    )
    assert sync(rig) == {("a/2", "b/1"), ("a/2", "/9"), ("b/1", "/9")}
    rig.send(Marker(ns="a", action=Marker.DELETEALL))
    assert len(sync(rig)) == 1
    rig.send(Marker(action=Marker.DELETEALL), cube(A1))
    assert rig.pairs() == set()
    assert list(rig.node.objects.table.slots) == [A1]


def test_lifetimes_end_objects_and_a_new_marker_renews_them() -> None:
    with Rig(rate=200.0) as rig:
        rig.send(cube(A1), cube(A2, lifetime=Duration(nanosec=1_000)))
        assert rig.pairs() == {("a/1", "a/2")}, "RViz takes lifetimes up to 0.1 ms as none"
        rig.send(cube(A2, lifetime=Duration(nanosec=200_000_000)))
        rig.answer()
        rig.until(lambda: len(collisions_from_ros(rig.next("collisions"))) == 0, "expiry")
        assert list(rig.node.objects.table.slots) == [A1]


def test_padding_grows_every_box_on_every_side() -> None:
    with Rig(padding=0.1) as rig:
        rig.send(cube(A1), cube(A2, (1.19, 0, 0)), cube(B1, (-1.21, 0, 0)))
        assert rig.pairs() == {("a/1", "a/2")}
        assert all(result.successful for result in rig.set(padding=0.15))
        rig.until(lambda: len(collisions_from_ros(rig.next("collisions"))) == 2, "new padding")


def test_the_older_of_two_states_is_dropped_whatever_its_way(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0)))
    rig.answer()
    newest = rig.stamp
    rig.stamp -= 900_000_000
    rig.send_transform("a/2", pose(0.0))
    rig.send_poses([2], [pose(0.0)])
    rig.send_states(["a/2"], [pose(0.0)])
    rig.send(cube(A2))
    for topic in ("object_transform", "object_poses", "object_states", "objects"):
        rig.until(lambda t=topic: rig.refused(t), topic)  # type: ignore[misc]
        assert rig.refused(topic) == {"older stamp": 1}
    rig.stamp = newest
    assert sync(rig) == set()


def test_text_for_people_is_capped_and_states_the_total() -> None:
    with Rig(max_text_pairs=2) as rig:
        rig.send(*(cube(("a", number)) for number in range(4)))
        rig.answer()
        rig.listen("collisions_text")
        message = rig.next("collisions_text")
        assert message.status[0].message == "6 pairs in collision, the first 2 named"
        assert [status.name for status in message.status[1:]] == ["a/0 - a/1", "a/0 - a/2"]
        values = {pair.key: pair.value for pair in message.status[1].values}
        assert float(values["depth"]) == pytest.approx(1.0)
        assert len(values["normal"].split()) == 3


def test_touching_pairs_collide_and_are_marked_as_touching(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (1.0, 0.0, 0.0)))  # exactly face to face
    rows = collisions_from_ros(rig.answer())
    assert rows["verdict"].tolist() == [Verdict.TOUCHING]
    assert rows["depth"].tolist() == [0.0]
    rig.listen("collisions_text")
    assert rig.next("collisions_text").status[1].message == "touching"
    rig.send_transform("a/2", pose(0.5))
    assert collisions_from_ros(rig.answer())["verdict"].tolist() == [Verdict.OVERLAP]


def test_latched_topics_reach_late_subscribers(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2))
    rig.answer()
    rig.last.pop("namespaces")
    rig.listen("namespaces")
    message = rig.until(lambda: rig.last.get("namespaces"), "latched table")
    assert namespaces_from_ros(message) == ["a"]


# --- markers -------------------------------------------------------------------------------------


def color(marker: Marker) -> Any:
    return pytest.approx((marker.color.r, marker.color.g, marker.color.b, marker.color.a))


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


# --- what is refused -----------------------------------------------------------------------------

BAD_POSES = {
    "bad pose": [0.0, NAN, 0.0, 0.0, 0.0, 0.0, 1.0],
    "zero quaternion": [0.0] * 7,
}
SENDERS = {
    "object_transform": lambda rig, name, number, row: rig.send_transform(name, row),
    "object_states": lambda rig, name, number, row: rig.send_states(
        [name, "a/2"], [row, pose(3.5)]
    ),
    "object_poses": lambda rig, name, number, row: rig.send_poses(
        [number, 2], [row, pose(3.5)], [0, 0]
    ),
}


@pytest.mark.parametrize("reason", BAD_POSES)
@pytest.mark.parametrize("topic", SENDERS)
def test_a_bad_pose_is_refused_alone_and_its_object_keeps_colliding(
    rig: Rig, topic: str, reason: str
) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0)), cube(B1, (0.5, 0, 0)))
    assert rig.pairs() == {("a/1", "b/1")}
    SENDERS[topic](rig, "a/1", 1, BAD_POSES[reason])
    rig.until(lambda: rig.refused(topic), "refusal")
    assert rig.refused(topic) == {reason: 1}
    assert sync(rig) == {("a/1", "b/1")}
    slot, other = (rig.node.objects.table.slots[key] for key in (A1, A2))
    assert rig.node.objects.doubtful[slot]
    assert not rig.node.objects.doubtful[other]
    moved = topic != "object_transform"
    assert rig.node.objects.table.world[other][0] == (3.5 if moved else 3.0)
    rig.send_transform("a/1", pose(0.0))
    assert rig.pairs() == {("a/1", "b/1")}
    assert not rig.node.objects.doubtful[slot], "a good pose clears the doubt"


@pytest.mark.parametrize("topic", SENDERS)
def test_unknown_objects_are_refused_alone(rig: Rig, topic: str) -> None:
    rig.send(cube(A1, (3, 0, 0)), cube(A2))
    rig.answer()
    SENDERS[topic](rig, "a/99", 99, pose(0.0))
    rig.until(lambda: rig.refused(topic), "refusal")
    assert rig.refused(topic) == {"unknown object": 1}
    assert sync(rig) == (set() if topic == "object_transform" else {("a/1", "a/2")})


@pytest.mark.parametrize("topic", SENDERS)
def test_poses_in_an_unknown_frame_are_refused_and_their_objects_marked(
    rig: Rig, topic: str
) -> None:
    rig.send(cube(A1), cube(A2, (0.5, 0, 0)))
    rig.answer()
    if topic == "object_transform":
        rig.send_transform("a/1", pose(9.0), "nowhere")
    elif topic == "object_states":
        rig.send_states(["a/1"], [pose(9.0)], "nowhere")
    else:
        rig.send_poses([1], [pose(9.0)], frame="nowhere")
    rig.until(lambda: rig.refused(topic), "refusal")
    assert rig.refused(topic) == {"unknown frame": 1}
    assert sync(rig) == {("a/1", "a/2")}
    assert rig.node.objects.doubtful[rig.node.objects.table.slots[A1]]


def text_marker() -> Marker:
    return cube(A1, type=Marker.TEXT_VIEW_FACING, text="hello")


def in_nowhere() -> Marker:
    marker = cube(A1)
    marker.header.frame_id = "nowhere"
    return marker


def with_pose(*values: float) -> Marker:
    marker = cube(A1, values[:3])
    q = marker.pose.orientation
    q.x, q.y, q.z, q.w = values[3:]
    return marker


BAD_MARKERS = {
    "bad scale": [
        lambda: cube(A1, size=(0, 1, 1)),
        lambda: cube(A1, size=(1, -1, 1)),
        lambda: cube(A1, size=(1, NAN, 1)),
    ],
    "bad pose": [lambda: with_pose(NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)],
    "zero quaternion": [lambda: with_pose(*[0.0] * 7)],
    "unknown frame": [in_nowhere],
    "unknown marker type": [text_marker, lambda: cube(A1, type=77)],
    "unknown action": [lambda: cube(A1, action=1)],
    "unreadable mesh": [
        lambda: cube(A1, type=Marker.MESH_RESOURCE, mesh_resource="file:///none.stl")
    ],
    "no points": [lambda: cube(A1, type=Marker.TRIANGLE_LIST)],
}


@pytest.mark.parametrize("reason", BAD_MARKERS)
def test_a_bad_marker_is_refused_alone_and_never_taken_as_free(rig: Rig, reason: str) -> None:
    makers = BAD_MARKERS[reason]
    rig.listen("/diagnostics")
    for make in makers:
        rig.send(make(), cube(A2, (0.5, 0, 0)))
        assert rig.pairs() == set(), "the rest of the message is used"
    assert rig.refused("objects") == {reason: len(makers)}
    assert rig.node.objects.unplaceable == {A1: reason}
    status = rig.status(": objects")
    assert status["unplaceable"] == "1"
    assert status["names unplaceable"] == "a/1"
    assert status[f"unplaceable: {reason}"] == "1"
    rig.send(cube(A1))
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.node.objects.unplaceable == {}
    for make in makers:
        rig.send(make())
    assert sync(rig) == {("a/1", "a/2")}, "the last good box stays"
    assert rig.node.objects.doubtful[rig.node.objects.table.slots[A1]]


def test_objects_beyond_the_limit_are_refused_and_reported() -> None:
    with Rig(max_objects=2) as rig:
        rig.send(cube(A1), cube(A2, (0.5, 0, 0)), cube(B1, (0.6, 0, 0)))
        assert rig.pairs() == {("a/1", "a/2")}
        assert rig.refused("objects") == {"too many objects": 1}
        assert rig.node.objects.unplaceable == {B1: "too many objects"}
        rig.set(max_objects=3)
        rig.send(cube(B1, (0.6, 0, 0)))
        assert len(rig.pairs()) == 3


def test_mismatched_lengths_in_states_refuse_the_message_and_mark_its_objects(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (0.5, 0, 0)))
    rig.answer()
    message = states_to_ros(["a/1"], np.array([pose(9.0)]), rig.header())
    message.joint_names = ["a/1", "a/2"]
    rig.pubs["object_states"].publish(message)
    rig.until(lambda: rig.refused("object_states"), "refusal")
    assert rig.refused("object_states") == {"array lengths differ": 1}
    assert sync(rig) == {("a/1", "a/2")}
    assert np.count_nonzero(rig.node.objects.doubtful) == 2


def test_a_twist_list_of_another_length_is_counted_and_the_poses_are_used(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0)))
    message = states_to_ros(["a/1"], np.array([pose(3.0)]), rig.header())
    message.twist = [Twist(), Twist()]
    rig.pubs["object_states"].publish(message)
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.refused("object_states") == {"array lengths differ": 1}


def test_clouds_of_a_wrong_layout_are_refused(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (0.5, 0, 0)))
    rig.answer()
    message = poses_to_ros([1], [pose(9.0)])
    for field in message.fields:
        if field.name == "qw":
            field.datatype = PointField.INT32
    rig.pubs["object_poses"].publish(message)
    rig.pubs["object_poses"].publish(PointCloud2())
    rig.until(lambda: rig.refused("object_poses").get("field layout") == 2, "refusals")
    assert sync(rig) == {("a/1", "a/2")}


# --- staleness, diagnostics, services, parameters ------------------------------------------------


@pytest.mark.parametrize("policy", ["keep", "ignore"])
def test_stale_objects_are_kept_or_ignored_but_always_reported(policy: str) -> None:
    with Rig(object_timeout=0.3, stale_policy=policy, marker_rate=100.0) as rig:
        rig.listen("/diagnostics", "obb_collision/markers")
        rig.send(cube(A1), cube(A2, (0.5, 0, 0)), cube(B1, (9, 0, 0)))
        assert rig.pairs() == {("a/1", "a/2")}
        table = rig.node.objects.table
        rig.until(lambda: np.count_nonzero(table.stale) == 3, "stale")
        message = rig.next("collisions")
        assert len(collisions_from_ros(message)) == (1 if policy == "keep" else 0)
        status = rig.status(": objects")
        assert (status["stale"], status["count"], status["level"]) == ("3", "3", "01")
        markers = {(m.ns, m.id): m for m in rig.next("obb_collision/markers").markers}
        assert color(markers[B1]) == COLORS[2]
        rig.send_states(["a/1", "a/2"], [pose(0.0), pose(0.6)])
        assert rig.pairs() == {("a/1", "a/2")}, "a new state ends it"


def test_diagnostics_say_what_came_in_what_was_refused_and_how_long_it_took(rig: Rig) -> None:
    rig.listen("/diagnostics")
    rig.send(cube(A1), cube(A2), cube(B1, (9, 0, 0), (0, 0, 0)))
    rig.answer()
    rig.next("/diagnostics")
    status = rig.status("input objects")
    assert status["topic"] == NAMESPACE + "/objects"
    assert status["messages"] == "1"
    assert status["rejected: bad scale"] == "1"
    assert float(status["age (s)"]) >= 0.0
    assert rig.status("input object_poses")["age (s)"] == "never"
    objects = rig.status(": objects")
    assert (objects["count"], objects["colliding"], objects["unplaceable"]) == ("2", "2", "1")
    cycle = rig.status(": cycle")
    assert {"rate (Hz)", "overruns", "cycle mean (ms)", "cycle max (ms)"} <= set(cycle)
    assert {"update mean (ms)", "check mean (ms)", "publish max (ms)"} <= set(cycle)
    assert rig.last["/diagnostics"].status[0].hardware_id == "obb_collision"


def test_a_sender_with_incompatible_qos_is_reported(rig: Rig) -> None:
    rig.listen("/diagnostics")
    qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    rig.client.create_publisher(PointCloud2, "object_poses", qos)
    rig.until(lambda: rig.status(": qos").get("object_poses"), "mismatch")
    assert rig.status("input object_poses")["qos mismatches"] == "1"
    assert "incompatible QoS on object_poses" in rig.status(": qos")["message"]


def test_clear_removes_everything(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2))
    rig.answer()
    response = rig.call(Trigger, "obb_collision/clear", Trigger.Request())
    assert (response.success, response.message) == (True, "2 objects removed")
    assert len(collisions_from_ros(rig.next("collisions"))) == 0
    rig.send(cube(A1, (0.2, 0, 0)))
    assert rig.pairs() == set()


def test_enable_stops_and_resumes_the_checks_while_states_are_taken(rig: Rig) -> None:
    rig.listen("/diagnostics")
    rig.send(cube(A1), cube(A2, (3, 0, 0)))
    rig.answer()
    assert rig.call(SetBool, "obb_collision/enable", SetBool.Request(data=False)).success
    status = rig.status(": cycle")
    assert (status["enabled"], status["level"]) == ("False", "01")
    rig.last.pop("collisions", None)
    rig.send_transform("a/2", pose(0.5))
    slot = rig.node.objects.table.slots[A2]
    rig.until(lambda: rig.node.objects.table.world[slot][0] == 0.5, "state taken")
    assert "collisions" not in rig.last
    assert rig.call(SetBool, "obb_collision/enable", SetBool.Request(data=True)).success
    assert rig.pairs() == {("a/1", "a/2")}


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("rate", 0.0, "range"),
        ("rate", NAN, "range"),
        ("rate", 10, "type"),
        ("padding", -0.1, "range"),
        ("object_timeout", float("inf"), "range"),
        ("stale_policy", "forget", "one of keep, ignore"),
        ("trigger", "", "one of timer, arrival"),
        ("max_objects", 0, "range"),
        ("fixed_frame", "odom", "read-only"),
    ],
)
def test_wrong_parameters_are_refused_with_a_reason(
    rig: Rig, name: str, value: Any, reason: str
) -> None:
    before = rig.node.get_parameter(name).value
    (result,) = rig.set(**{name: value})
    assert not result.successful
    assert reason in result.reason
    assert rig.node.get_parameter(name).value == before


def test_every_parameter_has_a_description_and_numbers_a_range(rig: Rig) -> None:
    for name in rig.node._parameters:
        if name in ("use_sim_time", "start_type_description_service") or "qos_" in name:
            continue
        descriptor = rig.node.describe_parameter(name)
        assert len(descriptor.description) > 20, name
        value = rig.node.get_parameter(name).value
        if isinstance(value, float):
            assert descriptor.floating_point_range, name
        elif isinstance(value, int):
            assert descriptor.integer_range, name


def test_the_rate_changes_at_run_time(rig: Rig) -> None:
    rig.listen("/diagnostics")
    assert all(result.successful for result in rig.set(rate=5.0))
    rig.next("/diagnostics")
    rig.until(lambda: 2.0 < float(rig.status(": cycle")["rate (Hz)"]) < 9.0, "slower")


def test_arrival_answers_without_waiting_for_the_timer() -> None:
    with Rig(trigger="arrival", rate=0.1, min_period=0.0) as rig:
        rig.send(cube(A1), cube(A2, (3, 0, 0)))
        assert rig.pairs() == set()
        for x in (0.5, 3.0, 0.25):
            rig.send_poses([2], [pose(x)])
            assert rig.pairs() == ({("a/1", "a/2")} if x < 1 else set())


def test_a_burst_of_arrivals_ends_with_the_newest_state_evaluated() -> None:
    with Rig(trigger="arrival", rate=0.1, min_period=0.05) as rig:
        rig.send(cube(A1), cube(A2, (3, 0, 0)))
        for x in np.linspace(3.0, 0.5, 40):
            rig.send_transform("a/2", pose(x))
        assert rig.pairs() == {("a/1", "a/2")}


def test_two_nodes_in_namespaces_do_not_meet() -> None:
    with Rig() as rig:
        from obb_collision.node.node import CollisionNode

        other = CollisionNode(context=rig.context, namespace="cell")
        try:
            assert other._outputs.collisions.topic_name == "/cell/collisions"
            assert other._outputs.markers.topic_name == "/cell/obb_collision/markers"
            assert other._outputs.diagnostics.topic_name == "/diagnostics"
            assert other._monitors["objects"].topic == "/cell/objects"
        finally:
            other.destroy_node()


# --- frames --------------------------------------------------------------------------------------


class FakeFrames:
    """Frames that a test moves about."""

    waits = True
    description = "a test"

    def __init__(self) -> None:
        self.known: dict[str, list[float]] = {}
        self.asked: list[tuple[str, int]] = []

    def lookup(self, frame: str, stamp: int) -> Any:
        self.asked.append((frame, stamp))
        if frame not in self.known:
            raise RefusedError("unknown frame", frame)
        return np.array(self.known[frame])


def in_frame(marker: Marker, frame: str) -> Marker:
    marker.header.frame_id = frame
    return marker


def test_poses_in_other_frames_are_placed_at_their_stamp() -> None:
    frames = FakeFrames()
    turn = np.sqrt(0.5)
    frames.known["robot"] = [5.0, 0.0, 0.0, 0.0, 0.0, turn, turn]
    with Rig(frames) as rig:
        rig.send(cube(A1, (5, 2, 0)), in_frame(cube(A2, (1.5, 0, 0)), "robot"))
        assert rig.pairs() == {("a/1", "a/2")}
        assert ("robot", rig.stamp) in frames.asked
        frames.known["robot"][0] = 9.0
        rig.send_transform("a/1", pose(5, 2))
        assert rig.pairs() == {("a/1", "a/2")}, "not locked: stays where it was placed"
        rig.send_poses([2], [pose(1.5)], frame="robot")
        assert rig.pairs() == set()


def test_frame_locked_objects_follow_their_frame() -> None:
    frames = FakeFrames()
    frames.known["robot"] = pose(5.0)
    with Rig(frames) as rig:
        rig.send(cube(A1), in_frame(cube(A2, frame_locked=True), "robot"))
        assert rig.pairs() == set()
        frames.known["robot"] = pose(0.5)
        rig.until(lambda: len(collisions_from_ros(rig.next("collisions"))) == 1, "followed")
        assert ("robot", 0) in frames.asked
        del frames.known["robot"]
        table = rig.node.objects.table
        rig.until(lambda: rig.node.objects.doubtful[table.slots[A2]], "doubt")
        assert len(collisions_from_ros(rig.next("collisions"))) == 1, "keeps its last box"


def test_an_object_whose_frame_is_not_known_yet_is_unplaceable_until_it_is() -> None:
    frames = FakeFrames()
    with Rig(frames, transform_timeout=0.0) as rig:
        rig.listen("/diagnostics")
        rig.send(cube(A1), in_frame(cube(A2), "late"))
        rig.until(lambda: rig.refused("objects") == {"unknown frame": 1}, "refusal")
        assert rig.status(": objects")["names unplaceable"] == "a/2"
        frames.known["late"] = pose(0.5)
        rig.until(lambda: len(collisions_from_ros(rig.next("collisions"))) == 1, "placed")
        assert rig.refused("objects") == {"unknown frame": 1}, "counted once"
        assert rig.status(": objects")["unplaceable"] == "0"


def test_tf2_frames_are_used_where_tf2_is_installed() -> None:
    pytest.importorskip("tf2_ros")
    with Rig() as rig:
        assert rig.node._frames.description == "tf2"


def test_without_tf2_the_node_says_so() -> None:
    if importlib.util.find_spec("tf2_ros") is not None:
        pytest.skip("tf2_ros is installed")
    with Rig() as rig:
        assert "fixed frame only" in rig.node._frames.description


def test_a_moving_cube_meets_what_the_oracle_says(rig: Rig) -> None:
    rng = np.random.default_rng(3)
    boxes = np.hstack((rng.uniform(0, 4, (25, 3)), rng.uniform(0.2, 1.5, (25, 3))))
    rig.send(*(cube(("c", i), box[:3], box[3:]) for i, box in enumerate(boxes)))
    for _ in range(15):
        mover = int(rng.integers(25))
        boxes[mover, :3] = rng.uniform(0, 4, 3)
        rig.send_transform(f"c/{mover}", pose(*boxes[mover, :3]))
        expected = {
            (f"c/{i}", f"c/{j}")
            for i in range(25)
            for j in range(i + 1, 25)
            if overlaps(boxes[i], boxes[j])
        }
        assert rig.pairs() == expected

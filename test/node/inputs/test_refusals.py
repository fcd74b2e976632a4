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

"""What is wrong or too much is refused alone; what comes faster than cycles run is counted."""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from each import each
from geometry_msgs.msg import Point, Twist
from objects_rig import BOX, levels, mesh_marker, triangle
from rig import A1, A2, B1, POSES, Patch, Printed, Rig, cube, pose, sync
from robot_rig import URDF, RobotRig
from visualization_msgs.msg import Marker

from obb_collision.node.diagnostics.answer import FREE, UNKNOWN, Reason
from obb_collision.node.inputs import subscriptions
from obb_collision.node.inputs.senders import NO_NUMBER, Senders
from obb_collision.node.messages.conversions import pose_to_ros, stamp_from_ros, states_to_ros
from obb_collision.node.objects.refusals import MAX_UNPLACEABLE, Unplaceable
from obb_collision.node.objects.table import NO_TIME

NAN = float("nan")
BAD_POSES = {"bad pose": [0.0, NAN, 0.0, 0.0, 0.0, 0.0, 1.0], "zero quaternion": [0.0] * 7}


@each("reason", BAD_POSES)
@each("topic", POSES[1:])
def test_a_bad_pose_is_refused_and_its_object_collides(rig: Rig, topic: str, reason: str) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0)), cube(B1, (0.5, 0, 0)))
    assert rig.pairs() == {("a/1", "b/1")}
    rig.send_by(topic, {A1: BAD_POSES[reason], A2: pose(3.5)})
    rig.refuses(topic, {reason: 1})
    assert sync(rig) == {("a/1", "b/1")}
    assert (rig.is_doubtful(A1), rig.is_doubtful(A2)) == (True, False)
    assert rig.pose_of(A2)[0] == 3.5
    rig.send_transform("b/1", pose(-2.0))
    assert rig.pairs() == set()
    answer = rig.node.status.answer
    assert answer.level == UNKNOWN, "it is not free: nobody knows where it is"
    assert answer.reasons == (Reason("refused", ("a/1",), 1),)
    rig.send_transform("a/1", pose(0.0))
    assert rig.pairs() == set()
    assert not rig.is_doubtful(A1), "a good pose clears the doubt"
    assert (rig.node.status.answer.level, rig.node.status.answer.message) == (FREE, "free")


@each(
    "reason, fields",
    [
        *(("bad scale", {"size": size}) for size in ((0, 1, 1), (1, -1, 1), (1, NAN, 1))),
        *((reason, {"pose": pose_to_ros(bad)}) for reason, bad in BAD_POSES.items()),
        ("unknown frame", {"frame": "nowhere"}),
        ("unknown marker type", {"type": 77}),
        ("unknown action", {"action": 1}),
        ("unreadable mesh", {"type": Marker.MESH_RESOURCE, "mesh_resource": "file:///none.stl"}),
        ("no points", {"type": Marker.TRIANGLE_LIST}),
    ],
)
def test_a_bad_marker_is_refused_alone(rig: Rig, reason: str, fields: dict[str, Any]) -> None:
    bad = cube(A1, **fields)
    rig.send(bad, cube(A2, (0.5, 0, 0)))
    assert rig.pairs() == set(), "the rest of the message is used"
    rig.refuses("objects", {reason: 1})
    assert rig.node.objects.unplaceable == {A1: reason}
    wanted = f"unplaceable: {reason}"  # a message on its way was made before
    status = rig.until(lambda: wanted in (s := rig.status(": objects")) and s, wanted)
    assert status["unplaceable"] == status[wanted] == "1"
    assert status["names unplaceable"] == "a/1"
    rig.send(cube(A1))
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.node.objects.unplaceable == {}
    rig.send(bad)
    assert sync(rig) == {("a/1", "a/2")}, "the last good box stays"
    rig.refuses("objects", {reason: 2})
    assert rig.is_doubtful(A1)


def test_an_arrow_between_points_needs_no_quaternion(rig: Rig) -> None:
    points = [Point(x=-1.0), Point(x=1.0)]
    arrow = cube(A1, size=(0.1, 0.2, 0), type=Marker.ARROW, points=points)
    arrow.pose.orientation.w = 0.0
    rig.send(arrow, cube(A2))
    assert rig.pairs() == {("a/1", "a/2")}
    arrow.points = []
    rig.send(arrow)
    rig.refuses("objects", {"zero quaternion": 1})


def test_annotations_are_counted_as_refused_and_no_objects_that_are_not_checked(rig: Rig) -> None:
    text = cube(A1, type=Marker.TEXT_VIEW_FACING, text="hello")
    rig.send(text, cube(A2), cube(B1, type=Marker.ARROW_STRIP))
    assert rig.pairs() == set()
    assert rig.refused("objects") == {"no body": 2}
    assert rig.node.objects.unplaceable == {}


def test_a_twist_list_of_another_length_is_counted_and_the_poses_are_used(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0)))
    message = states_to_ros(["a/1"], np.array([pose(3.0)]), rig.header())
    message.twist = [Twist(), Twist()]
    rig.pubs["object_states"].publish(message)
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.refused("object_states") == {"array lengths differ": 1}


@pytest.fixture
def limited(tmp_path: Path) -> Iterator[Rig]:
    (tmp_path / "allowed").mkdir()
    folders = [str(tmp_path / "allowed")]
    with Rig(mesh_folders=folders, max_triangles=11, max_cloud_points=2, max_name_length=5) as made:
        yield made


def test_shapes_beyond_the_limits_are_refused(limited: Rig, tmp_path: Path, capfd: Printed) -> None:
    for folder in ("allowed", "."):
        trimesh.creation.box().export(tmp_path / folder / "part.stl")
    limited.send(triangle(A1), mesh_marker(tmp_path / "allowed" / "part.stl", B1))
    limited.refuses("objects", {"too many points": 1, "too many triangles": 1})
    assert "12 triangles, 11 is the limit" in capfd.readouterr().err
    many = triangle(A1)
    many.points = many.points * 12
    limited.send(many)
    limited.refuses("objects", {"too many points": 1, "too many triangles": 2})
    limited.send(mesh_marker(tmp_path / "part.stl", B1))
    limited.until(lambda: "unreadable mesh" in limited.refused("objects"), "a file elsewhere")
    assert "is not in a folder from which meshes are read" in capfd.readouterr().err
    limited.send(cube(BOX), cube(A1))
    assert limited.pairs() == {("a/1", "box/1")}


def test_names_beyond_the_limit_are_refused_and_clouds_whole(limited: Rig) -> None:
    limited.send(cube(A1), cube(("123456", 1)), cube(("12345", 1)), cube(("\u00e9\u00e9\u00e9", 1)))
    assert limited.pairs() == {("12345/1", "a/1")}
    assert limited.refused("objects") == {"bad name": 2}
    limited.listen("points_inside")
    one = np.array([pose(9.0)])
    limited.send_points(np.zeros((3, 3)))
    limited.send_poses([1, 2, 3], np.repeat(one, 3, axis=0))
    limited.send_boxes([1, 2, 3], np.repeat(one, 3, axis=0))
    for topic in ("points", "object_poses", "object_boxes"):
        limited.refuses(topic, {"too many points": 1})
    assert sync(limited) == {("12345/1", "a/1")}
    limited.send_boxes([1, 2], np.array([pose(0.1), pose(9.0)]))
    limited.until(lambda: len(limited.node.objects.table) == 5, "a set within the limit")


def test_packages_that_are_not_installed_are_found_for_all_that_name_files(tmp_path: Path) -> None:
    """By a folder of their own, and in a folder of packages."""
    pytest.importorskip("lxml")
    uris = {}
    for package, folder in (("arm_description", "v2"), ("parts", "parts")):
        (tmp_path / folder).mkdir()
        trimesh.creation.box().export(tmp_path / folder / "a part.stl")
        uris[package] = f"package://{package}/a%20part.stl"
    scene, urdf = tmp_path / "scene.yaml", URDF
    rows = [f"{{name: {name}, shape: mesh, file: '{uri}'}}" for name, uri in uris.items()]
    scene.write_text(f"objects: [{', '.join(rows)}]")
    for uri in uris.values():
        urdf = urdf.replace('<box size="0.1 0.1 0.1"/>', f'<mesh filename="{uri}"/>', 1)
    folders = [f"arm_description: {tmp_path / 'v2'}", str(tmp_path)]
    with RobotRig({"mesh_folders": folders, "scene_file": str(scene)}) as rig:
        rig.start_robot(urdf)
        rig.send(*(mesh_marker(uri, key) for uri, key in zip(uris.values(), (A1, B1), strict=True)))
        rig.built(A1, B1)
        others = ("arm_description/0", "parts/0", "arm/column/0", "arm/hand/0", "b/1")
        assert {("a/1", other) for other in others} <= {tuple(sorted(pair)) for pair in sync(rig)}
        assert rig.refused("objects") == {}


def test_refused_objects_beyond_the_limit_count_until_all_are_deleted_or_expire() -> None:
    for expiry in (NO_TIME, 5):
        found = Unplaceable()
        for ident in range(MAX_UNPLACEABLE + 3):
            found.add(("a", ident), "bad scale", expiry)
        assert len(found) <= MAX_UNPLACEABLE + 1
        for ident in range(MAX_UNPLACEABLE + 3):
            found.delete(("a", ident))
        found.delete_all("a")
        assert len(found) == 1
        if expiry == NO_TIME:
            found.delete_all(None)
        else:
            found.expire(expiry)
        assert not found


FLOOD = 300
"""Messages of a topic that arrive while nobody reads: more than any queue holds but that of poses
one by one."""


@each("topic", POSES)
def test_the_first_cycle_after_a_flood_has_the_newest_state(topic: str, rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (9, 0, 0))).answer()
    for step in range(FLOOD):  # the executor is at rest: all of them wait, or are lost
        rig.send_by(topic, {A2: pose(0.5 if step == FLOOD - 1 else 9.0 + step)})
    cycle, seen = rig.node.cycle, list[int]()
    run = cycle.run_stages

    def record(now: int) -> dict[str, float]:
        result = run(now)
        seen.append(rig.node.objects.newest_stamp(now))
        return result

    cycle.run_stages = record  # type: ignore[method-assign]
    rig.until(lambda: rig.stamp in seen, "the newest state")
    assert seen.index(rig.stamp) <= 1, "no cycle for states between, but one that began before"
    assert rig.pairs() == {("a/1", "a/2")}
    assert stamp_from_ros(rig.last["collisions"].header.stamp) == rig.stamp
    monitor = rig.monitor(topic)
    sent = FLOOD + (1 if topic == "objects" else 0)
    assert monitor.messages + monitor.lost <= sent
    assert monitor.superseded >= monitor.messages - 3, "what was taken and not used is counted"


def test_of_messages_that_take_long_one_alone_delays_a_cycle(rig: Rig, monkeypatch: Patch) -> None:
    rig.send(cube(A1), cube(A2, (9, 0, 0))).answer()
    seconds, monitor = count(), rig.monitor("object_states")
    monkeypatch.setattr(subscriptions, "monotonic", lambda: float(next(seconds)))
    for step in range(3):
        rig.send_states(["a/2"], [pose(9.0 + step)])
    taken = []
    for _ in range(4):
        rig.node.subscribed.drain()
        taken.append(monitor.messages)
    assert taken == [1, 2, 3, 3]


def test_states_that_come_in_a_long_cycle_are_answered_by_the_next(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (9, 0, 0))).answer()
    cycle, sent = rig.node.cycle, list[int]()
    run, stamps = cycle.run_stages, list[int]()

    def flood_and_run(now: int) -> dict[str, float]:
        if not sent:  # as if this cycle took as long as these take to come
            for step in range(50):
                rig.send_transform("a/2", pose(0.5 if step == 49 else 9.0))
            sent.append(rig.stamp)
        result = run(now)
        stamps.append(rig.node.objects.newest_stamp(now))
        return result

    cycle.run_stages = flood_and_run  # type: ignore[method-assign]
    rig.until(lambda: len(stamps) >= 3, "cycles")
    assert stamps[0] < sent[0]
    assert sent[0] in stamps[1:3], "one cycle later, or two where they had not all come yet"


def test_accuracy_is_not_lowered_without_a_budget() -> None:
    with Rig(accuracy="mesh", rate=1000.0) as rig:
        rig.send(triangle(A1), triangle(A2, x=0.1))
        rig.built(A1, A2)
        rig.until(lambda: levels(rig) == ["mesh"], "meshes compared")
        for step in range(FLOOD):
            rig.send_transform("a/2", pose(0.1 + 1e-6 * step))
        rig.answer()
        assert levels(rig) == ["mesh"]
        assert rig.node.cycle.report is not None
        assert not rig.node.cycle.report.behind


def test_a_message_after_a_change_of_parameters_is_taken_as_the_change_has_it(rig: Rig) -> None:
    for n in range(10):
        rig.set(max_objects=1)
        rig.set(max_objects=100)
        rig.send(*(cube((f"b{n}", k), (0.9 * k, 0.0, 10.0 * n)) for k in range(3)))
        assert len(rig.pairs()) == 2 * (n + 1)


def test_a_storm_of_parameters_leaves_the_node_with_the_last_ones(rig: Rig) -> None:
    rig.send(*(cube(("a", n), (0.9 * n, 0.0, 0.0)) for n in range(5)))
    assert len(rig.pairs()) == 4
    for n in range(100):
        assert rig.set(padding=0.001 * (n + 1))[0].successful
        rig.set(accuracy_overrides=[f"a/{n % 5}: aabb"])
    assert rig.node.objects.scene.padding == 0.1
    assert rig.node.objects.shapes.overrides.overrides[0][0] == "a/4"


def total(numbers: list[Any], publishers: int = 1) -> int:
    senders = Senders(10, lambda: publishers)
    given = [{"publication_sequence_number": number} for number in numbers]
    return sum(senders.note_message(info)[1] for info in given)


def test_gaps_of_one_publisher_are_counted() -> None:
    assert total([1, 2, 5, 9]) == 2 + 3
    assert total([1000, 1001]) == 0, "it had published before the node came"
    assert total([1, 2, 3, 1, 2, 4]) == 1, "it has begun anew"
    assert total([None, 0, NO_NUMBER, NO_NUMBER + 5]) == 0, "middlewares without numbers"


@each("seed", range(20))
def test_of_several_publishers_all_losses_are_counted(seed: int) -> None:
    rng = random.Random(seed)
    next_numbers = {"a": 1, "b": 1, "c": 700}
    given, lost = [1, 1, 700], 0
    for _ in range(300):
        name = rng.choice(list(next_numbers))
        next_numbers[name] += 1 + (jump := rng.choice((0, 0, 0, 0, 1, 40)))
        lost += jump
        given.append(next_numbers[name])
    assert total(given, 3) == lost


def test_more_messages_than_a_queue_holds_are_counted_as_lost_and_superseded(rig: Rig) -> None:
    rig.send(cube(A1)).answer()
    rig.send_states(["a/1"], [pose(-1)]).answer()
    for step in range(40):  # 10 of them fit into the queue, as nobody reads meanwhile
        rig.send_states(["a/1"], [pose(step)])
    rig.answer()
    assert rig.pose_of(A1)[0] == 39.0, "the latest state wins"
    monitor = rig.monitor("object_states")
    assert monitor.lost + monitor.messages == 41
    assert monitor.lost >= 30 - 1, "but for the first, if that was taken before the others came"
    status = rig.status("input object_states")
    assert (status["lost"], status["superseded"]) == (str(monitor.lost), str(monitor.superseded))

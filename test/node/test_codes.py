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

"""Every code of ``collision_status`` that is not of robots, reached over topics and left again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from each import each
from numpy.lib.recfunctions import repack_fields

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Time
from fake_frames import FakeFrames
from geometry_msgs.msg import TransformStamped
from rclpy.serialization import serialize_message
from rig import FRAME, Rig, cube, pose
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node import boxes_to_ros, namespace_number, poses_to_ros
from obb_collision.node.diagnostics.answer import FREE, UNKNOWN
from obb_collision.node.inputs import detections
from obb_collision.node.inputs.subscriptions import Input
from obb_collision.node.messages.clouds import cloud_from_ros, cloud_to_ros
from obb_collision.node.messages.conversions import states_to_ros

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
APART = cube(A1), cube(A2, (3, 0, 0))
STATUS = "collision_status"
MOST = 3
"""Rows that a cloud may have."""


def said(rig: Rig) -> tuple[bytes, tuple[str, ...], str]:
    """Level, codes and whom the first is about, of the last status."""
    if STATUS not in rig.last:
        return b"", (), ""
    (status,) = rig.last[STATUS].status
    values = {pair.key: pair.value for pair in status.values}
    return status.level, tuple(values["reasons"].split()), values["who"]


def wait(rig: Rig, *codes: str, who: str = "", level: bytes | None = None) -> None:
    """Wait for exactly these codes and their level, and for whom the first one is about."""
    wanted = level or (UNKNOWN if codes else FREE)

    def reached() -> bool:
        found = said(rig)
        return found[:2] == (wanted, codes) and found[2].startswith(who)

    rig.until(reached, f"{wanted!r} {codes} {who}")


@contextmanager
def told(*markers: Marker, frames: Any = None, **parameters: Any) -> Iterator[Rig]:
    """Yield a rig with a status and some objects, slow enough for a loaded machine."""
    with Rig(frames=frames, given={"cycle_timeout": 30.0} | parameters) as rig:
        rig.listen(STATUS)
        if markers:
            rig.send(*markers)
            rig.answer()
        yield rig


def clear(rig: Rig) -> None:
    assert rig.call(Trigger, "obb_collision/clear", Trigger.Request()).success


def delete(*keys: tuple[str, int], action: int = Marker.DELETE) -> list[Marker]:
    return [Marker(ns=ns, id=ident, action=action) for ns, ident in keys]


def send_nothing(rig: Rig) -> None:
    rig.send_boxes([], np.empty((0, 7)))


def delete_one_by_one(rig: Rig) -> None:
    for key in (A1, A2):
        rig.send(*delete(key))


EMPTY: dict[str, Callable[[Rig], Any]] = {
    "clear": clear,
    "DELETEALL": lambda rig: rig.send(Marker(action=Marker.DELETEALL)),
    "no boxes": send_nothing,
    "expect_empty": lambda rig: rig.set(expect_empty=True),
}
EMPTIED: dict[str, Callable[[Rig], Any]] = {
    "DELETE of the last": lambda rig: rig.send(*delete(A1, A2)),
    "DELETE of one after the other": delete_one_by_one,
    "DELETEALL of a namespace": lambda rig: rig.send(*delete(A1, action=Marker.DELETEALL)),
}


def test_no_objects_until_somebody_says_that_there_are_none_which_no_lifetime_does() -> None:
    with told() as rig:
        for say in (*EMPTY.values(), *EMPTIED.values()):
            wait(rig, "no_objects")
            if say in EMPTIED.values():
                rig.send(*APART)
                wait(rig)
            say(rig)
            wait(rig)
            rig.set(expect_empty=False)
            marker = cube(B1)
            marker.lifetime.nanosec = 20_000_000
            rig.send(marker)
        wait(rig, "no_objects")
        text = cube(B1, type=Marker.TEXT_VIEW_FACING, text="hello")
        rig.send(*delete(B1, ("b", 2)), text, *delete(("b", 2), action=Marker.DELETEALL))
        rig.cycles(3)
        wait(rig, "no_objects")
        rig.send(cube(A1, size=(0, 1, 1)))
        wait(rig, "refused", who="a/1 (bad scale)")
        rig.send(*delete(A1))
        wait(rig)


def test_a_scene_file_says_what_there_is_even_if_that_is_nothing(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    for objects in ("[]", "[{name: part/1, shape: box, size: [1, 1, 1], position: [0, 0, 0]}]"):
        file.write_text(f"padding: 0.01\nobjects: {objects}\n")
        with told(scene_file=str(file)) as rig:
            wait(rig)


def lengths_differ(rig: Rig) -> None:
    message = states_to_ros(["a/1"], np.array([pose(0)]), rig.header())
    message.joint_names.append("a/2")
    rig.pubs["object_states"].publish(message)


def bad_stamp(rig: Rig) -> None:
    header = Header(stamp=Time(nanosec=4_000_000_000), frame_id=FRAME)
    rig.pubs["object_states"].publish(states_to_ros(["a/2"], np.array([pose(3)]), header))


def in_arm(key: tuple[str, int]) -> Marker:
    marker = cube(key, (9, 9, 0))
    marker.header.frame_id = "arm"
    return marker


def enable(rig: Rig, value: bool) -> None:
    rig.call(SetBool, "obb_collision/enable", SetBool.Request(data=value))


A = namespace_number("a")
Step = Callable[[Rig], Any]
TABLE: dict[str, tuple[dict[str, Any], Step, tuple[str, str], Step]] = {
    "disabled": (
        {},
        lambda rig: enable(rig, False),
        ("disabled", ""),
        lambda rig: enable(rig, True),
    ),
    "required objects": (
        {"groups": ["these: a/1 c/*"], "required_objects": ["these", "a/?"]},
        lambda rig: None,
        ("required_missing", "c/*"),
        lambda rig: rig.send(cube(("c", 7), (9, 0, 0))),
    ),
    "required inputs": (
        {"required_inputs": ["object_poses: 1000"]},
        lambda rig: None,
        ("input_silent", "object_poses"),
        lambda rig: rig.send_poses([1], [pose(0)], [A]),
    ),
    "input_timeout": (
        {},
        lambda rig: rig.set(input_timeout=0.1),
        ("input_silent", "all"),
        lambda rig: rig.set(input_timeout=1000.0),
    ),
    "unknown objects": (
        {"ignored_objects": ["dust/*"]},
        lambda rig: rig.send_states(["dust/1", "a/1", "c/3"], [pose(0)] * 3),
        ("unknown_objects", "c/3"),
        lambda rig: None,
    ),
    "unknown objects of bulk poses": (
        {},
        lambda rig: rig.send_poses([1, 9], [pose(0)] * 2, [A] * 2),
        ("unknown_objects", "a/9"),
        lambda rig: rig.send(cube(("a", 9), (9, 0, 0))),
    ),
    "unplaced": (
        {},
        lambda rig: rig.send(in_arm(B1)),
        ("unplaced", "b/1"),
        lambda rig: rig.frames.known.update(arm=pose(0)),
    ),
    "late_frame": (
        {"transform_timeout": 0.05},
        lambda rig: rig.send_transform("a/1", pose(0), "arm"),
        ("late_frame", "a/1"),
        lambda rig: rig.send_transform("a/1", pose(0)),
    ),
    "refused pose": (
        {},
        lambda rig: rig.send_transform("a/1", [float("nan")] * 7),
        ("refused", "a/1"),
        lambda rig: rig.send_poses([1], [pose(0)], [A]),
    ),
    "refused stamp": (
        {},
        bad_stamp,
        ("refused", "a/2"),
        lambda rig: rig.send_transform("a/2", pose(3)),
    ),
    "lengths differ": (
        {},
        lengths_differ,
        ("refused", "a/1, a/2"),
        lambda rig: rig.send_states(["a/1", "a/2"], [pose(0), pose(3)]),
    ),
    "stale by name": (
        {"object_timeout_overrides": ["a/2: 0.2"]},
        lambda rig: None,
        ("stale", "a/2"),
        lambda rig: rig.set(stale_policy_overrides=["a/*: keep"]),
    ),
    "stale from the second message on": (
        {"object_timeout": 0.2},
        lambda rig: rig.send(APART[1]),
        ("stale", "a/2"),
        lambda rig: rig.set(object_timeout=0.0),
    ),
    "deleted and added with each message": (
        {"object_timeout": 0.2},
        lambda rig: rig.send(Marker(action=Marker.DELETEALL), *APART),
        ("stale", "a/1, a/2"),
        lambda rig: rig.set(object_timeout=0.0),
    ),
}


@each("name", TABLE)
def test_a_code_is_reached_and_left_again(name: str) -> None:
    parameters, enter, (code, who), leave = TABLE[name]
    with told(*APART, frames=FakeFrames(), **parameters) as rig:
        enter(rig)
        wait(rig, code, who=who)
        leave(rig)
        wait(rig)


def broken_clouds(full: PointCloud2) -> dict[str, PointCloud2]:
    """Return a readable cloud of keys and numbers, broken in several ways."""
    found = {}
    rows = cloud_from_ros(full, [field.name for field in full.fields])
    for name in ("qw", "x", "id"):
        kept = [each for each in rows.dtype.names or () if each != name]
        found[f"no {name}"] = cloud_to_ros(repack_fields(rows[kept]), full.header)
    kinds = [(name, "<i4" if name == "x" else rows.dtype[name]) for name in rows.dtype.names or ()]
    found["x as int32"] = cloud_to_ros(rows.astype(kinds), full.header)
    for name, add in (("point_step", -8), ("row_step", -1), ("width", 1), ("height", 1)):
        broken = deepcopy(full)
        setattr(broken, name, getattr(broken, name) + add)
        found[name] = broken
    return found


def no_name(full: PointCloud2) -> PointCloud2:
    """Return a cloud with an id that no object can have."""
    rows = cloud_from_ros(full, [field.name for field in full.fields])
    kinds = [
        (name, "<f8" if kind.kind == "f" else "<u4")
        for name, (kind, *_) in (rows.dtype.fields or {}).items()
    ]
    rows = rows.astype(kinds)
    rows["id"] = 0xFFFFFFFF
    return cloud_to_ros(rows, full.header)


def is_marked(rig: Rig, topic: str) -> bool:
    level, codes, who = said(rig)
    return level == UNKNOWN and codes[0] == "input_unreadable" and who.startswith(topic)


def test_what_cannot_be_read_marks_its_input_until_that_is_read_again_or_cleared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # bytes are read as what they are, whatever type is said of the topic: vision_msgs are rare
    monkeypatch.setattr(detections, "INPUTS", {"detections": Input(PointCloud2, 10)})
    ids, places, twice = [1, 2], [pose(0), pose(3)], [A, A]
    header = Header(frame_id=FRAME)
    poses = poses_to_ros(ids, places, twice, header)
    boxes = boxes_to_ros([7], [pose(9)], np.ones((1, 3)), None, header)
    states = states_to_ros(["a/1", "a/2"], np.array(places), header)
    transform = TransformStamped(header=header, child_frame_id="a/1")
    transform.transform.rotation.w = 1.0
    good = {
        "objects": MarkerArray(markers=list(APART)),
        "object_transform": transform,
        "object_states": states,
        "object_poses": poses,
        "object_boxes": boxes,
    }
    none_detected = serialize_message(header) + bytes(4)
    many = list(range(MOST + 1))
    broken: list[tuple[str, Any]] = [
        *(("object_poses", each) for each in broken_clouds(poses).values()),
        *(("object_boxes", each) for each in broken_clouds(boxes).values()),
        ("object_poses", poses_to_ros(many, [pose(0)] * len(many), None, header)),
        ("object_boxes", boxes_to_ros(many, [pose(0)] * len(many), np.ones((len(many), 3)))),
        ("object_boxes", no_name(boxes)),
        *((topic, serialize_message(message)[:-9]) for topic, message in good.items()),
        *((topic, serialize_message(message)[:7]) for topic, message in good.items()),
        *(("detections", none_detected[:end]) for end in (7, -4, -1)),
        ("detections", none_detected[:-4] + (MOST + 1).to_bytes(4, "little")),
    ]
    good["detections"] = none_detected
    with told(*APART, max_cloud_points=MOST) as rig:
        rig.pubs["detections"] = rig.client.create_publisher(PointCloud2, "detections", 10)
        rig.wait_inputs()
        for number, (topic, message) in enumerate(broken):
            rig.pubs[topic].publish(message)
            rig.until(partial(is_marked, rig, topic), f"{topic} {number}")
            if number % 2:
                rig.pubs[topic].publish(good[topic])
            else:
                clear(rig)
            wait(rig)
            rig.pubs["objects"].publish(good["objects"])
            rig.cycles(2)
        rig.pubs["points"].publish(serialize_message(poses)[:-9])
        rig.until(lambda: rig.refused("points"), "points that cannot be read")
        rig.cycles(2)
        wait(rig)

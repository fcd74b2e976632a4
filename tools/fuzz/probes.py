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

"""Valid items among hostile ones in the same messages, and their colliding pairs.

A probe is a set of boxes with ids of its own. They arrive by markers, or are put in place by one of
the topics that move objects, or come as a set of boxes; hostile items stand between them. Which
pairs collide is decided for all pairs without any broad phase: of boxes that are not turned by
intervals of exact numbers, of others by the library's exact arithmetic on integers.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from random import Random
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import TransformStamped, Vector3
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

import obb_collision as oc
from obb_collision.node.inputs.detections import DETECTIONS
from obb_collision.node.messages.clouds import cloud_to_ros
from obb_collision.node.messages.conversions import (
    name_from_key,
    pose_to_ros,
    stamp_to_ros,
    states_to_ros,
    transform_to_ros,
)
from obb_collision.node.messages.names import namespace_number
from obb_collision.typing import Floats
from tools.fuzz.messages import Box, Detection, Detections, Messages, box_marker, serialised
from tools.fuzz.mutations import FLOATS, mutate

NAMESPACE, SETS = "probe", "probe set"
"""Namespaces of the probes: of markers, and of sets of boxes; detections have their own."""
NUMBERS = {namespace_number(name) for name in (NAMESPACE, SETS, DETECTIONS.namespace)}
FIRST_ID, BOXES = 1_000_000, 6
FAR = 1000.0
"""Distance (m) at which boxes wait that are moved by the probe."""
MOVES = ("object_transform", "object_states", "object_poses")
"""Topics that move what is there already."""
COMPLETE = ("object_boxes", "detections")
"""Topics whose messages replace the one before."""
HOSTILE = 6
"""Hostile items among the good ones of a message, at most."""

Pair = tuple[int, int]
Message = tuple[str, bytes]


class Probe(NamedTuple):
    """Messages to send, and the pairs of ids that the answer must have.

    kind: topic of the boxes. first: messages that must arrive before the others, since topics
    overtake one another. known, sure: pairs that collide once the node has used the first
    messages, and once it has used all. poses (n, 7), sizes (n, 3): of the boxes; their ids begin
    with the first id of ``sure``. others: messages that replace hostile sets. room: messages that
    remove all objects except the set of boxes of the probe.
    """

    kind: str
    first: list[Message]
    messages: list[Message]
    pairs: set[Pair]
    known: Pair
    sure: Pair
    poses: Floats
    sizes: Floats
    others: list[Message]
    room: list[Message]


class Boxes(NamedTuple):
    """The boxes of a probe, and the markers before them in a message."""

    start: list[Marker]
    ids: Any
    poses: Floats
    sizes: Floats
    stamp: int


def right_pairs(poses: Floats, sizes: Floats) -> set[Pair]:
    """Return the pairs (i, j) of colliding boxes with poses (n, 7) and sizes (n, 3)."""
    boxes = oc.Boxes.from_poses(poses, sizes / 2.0)
    pairs = list(combinations(range(len(poses)), 2))
    first, second = (np.array(rows) for rows in zip(*pairs, strict=True))
    exact = oc.verdicts(boxes[first], boxes[second], exact=True) != oc.Verdict.SEPARATE
    plain = (poses[:, 6] == 1.0)[first] & (poses[:, 6] == 1.0)[second]
    gaps = 2.0 * np.abs(poses[first, :3] - poses[second, :3]) - (sizes[first] + sizes[second])
    collide = np.where(plain, (gaps <= 0.0).all(axis=1), exact)
    return {pair for pair, yes in zip(pairs, collide.tolist(), strict=True) if yes}


class Probes:
    """Makes probes."""

    def __init__(self, messages: Messages) -> None:
        self._messages = messages
        self._makers: dict[str, Callable[..., list[Message]]] = {
            "markers": self._markers,
            "object_transform": self._transforms,
            "object_states": self._states,
            "object_poses": self._poses,
            "object_boxes": self._set,
            "detections": self._detections,
        }

    def make(self, number: int, random: Random, stamp: int, everything: bool, full: bool) -> Probe:
        """Return a probe by its number.

        everything: whether all other objects are removed. full: whether there may be as many
        objects as the node takes; then only a set of boxes, which replaces others, is certain.
        """
        self._messages.random = random
        poses, sizes = self._boxes(random)
        ids = FIRST_ID + BOXES * number + np.arange(BOXES)
        kind = "object_boxes" if full else random.choice(list(self._makers))
        start = [Marker(action=Marker.DELETEALL, ns="" if everything else NAMESPACE)]
        boxes = Boxes(start, ids, poses, sizes, stamp)
        first: list[Message] = []
        empty = self._cloud(random, ids[:0], poses[:0], sizes[:0], stamp)
        none = Detections(header_at(stamp))
        sets = {"object_boxes": serialised(empty), "detections": serialised(none)}
        others = [(topic, data) for topic, data in sets.items() if topic != kind]
        first += others if everything else ()
        array = MarkerArray(markers=[Marker(action=Marker.DELETEALL)])
        room = [*others, ("objects", serialised(array))]
        if kind in MOVES:
            first.append(self._waiting(random, boxes))
            boxes = boxes._replace(start=[])
        messages = self._makers[kind](random, boxes)
        pairs = {(int(ids[i]), int(ids[j])) for i, j in right_pairs(poses, sizes)}
        known, sure = (int(ids[2]), int(ids[3])), (int(ids[0]), int(ids[1]))
        return Probe(kind, first, messages, pairs, known, sure, poses, sizes, others, room)

    def _boxes(self, random: Random) -> tuple[Floats, Floats]:
        """Return poses and sizes, multiples of 1/8 where boxes are not turned; 0 and 1 collide."""
        poses = np.zeros((BOXES, 7))
        poses[:, :3] = [[random.randint(0, 16) / 8 for _ in range(3)] for _ in range(BOXES)]
        poses[:2, :3] = 1.0
        poses[:, 6] = 1.0
        for row in range(BOXES):
            if random.random() < 0.3:
                turn = np.array([random.gauss(0.0, 1.0) for _ in range(4)])
                poses[row, 3:] = turn / np.linalg.norm(turn)
        sizes = np.array([[random.randint(1, 8) / 8 for _ in range(3)] for _ in range(BOXES)])
        return poses, sizes

    def _array(self, random: Random, start: list[Marker], good: list[Marker]) -> bytes:
        """Return good markers with hostile ones between them."""
        array = MarkerArray(markers=list(good))
        for _ in range(random.randint(0, HOSTILE)):
            marker = self._messages.marker()
            try:
                mutate(marker, random)
            except AssertionError:
                continue
            if marker.action != Marker.DELETEALL and marker.ns != NAMESPACE:
                array.markers.insert(random.randint(0, len(array.markers)), marker)
        array.markers = [*start, *array.markers]
        return serialize_message(array)

    def _cubes(self, boxes: Boxes) -> list[Marker]:
        header = header_at(boxes.stamp)
        rows = zip(boxes.ids.tolist(), boxes.poses, boxes.sizes, strict=True)
        return [box_marker((NAMESPACE, ident), pose, size, header) for ident, pose, size in rows]

    def _markers(self, random: Random, boxes: Boxes) -> list[Message]:
        return [("objects", self._array(random, boxes.start, self._cubes(boxes)))]

    def _waiting(self, random: Random, boxes: Boxes) -> Message:
        """Return a message that adds boxes far from each other, except for a pair."""
        poses = np.zeros((BOXES, 7))
        poses[:, 0], poses[:, 6] = FAR * np.arange(1, 1 + BOXES), 1.0
        poses[3] = poses[2]
        return "objects", self._array(random, boxes.start, self._cubes(boxes._replace(poses=poses)))

    def _transforms(self, random: Random, boxes: Boxes) -> list[Message]:
        messages = []
        for row in (*range(2, BOXES), 0, 1):  # the pair of 0 and 1 is there once all is done
            message = TransformStamped(header=header_at(boxes.stamp + 1))
            message.child_frame_id = name_from_key((NAMESPACE, int(boxes.ids[row])))
            message.transform = transform_to_ros(boxes.poses[row])
            messages.append(("object_transform", serialize_message(message)))
        return messages

    def _states(self, random: Random, boxes: Boxes) -> list[Message]:
        names = [name_from_key((NAMESPACE, ident)) for ident in boxes.ids.tolist()]
        rows = list(zip(names, boxes.poses, strict=True))
        for name in random.sample((*names, "a/1", "nobody/1", "", "b/2", "x" * 5000), HOSTILE):
            at = random.randint(0, len(rows))
            if name in names:  # before the good row: the later one of two counts
                at = [given for given, _ in rows].index(name)
            rows.insert(at, (name, self._bad_pose(random)))
        every, moved = zip(*rows, strict=True)
        message = states_to_ros(list(every), np.array(moved), header_at(boxes.stamp + 1))
        return [("object_states", serialize_message(message))]

    def _bad_pose(self, random: Random) -> Floats:
        pose = np.array([0.0] * 6 + [1.0])
        hostile = [value for value in FLOATS if not abs(value) <= 1e300]  # NaN, too
        if random.random() < 0.3:
            pose[6] = 0.0
        else:
            pose[random.randrange(7)] = random.choice(hostile)
        return pose

    def _poses(self, random: Random, boxes: Boxes) -> list[Message]:
        cloud = self._cloud(random, boxes.ids, boxes.poses, None, boxes.stamp + 1)
        return [("object_poses", serialize_message(cloud))]

    def _set(self, random: Random, boxes: Boxes) -> list[Message]:
        last = np.roll(np.arange(BOXES), -2)  # the sure pair: without room for all, it is not there
        cloud = self._cloud(
            random, boxes.ids[last], boxes.poses[last], boxes.sizes[last], boxes.stamp
        )
        return [
            ("objects", self._array(random, boxes.start, [])),
            ("object_boxes", serialize_message(cloud)),
        ]

    def _detections(self, random: Random, boxes: Boxes) -> list[Message]:
        some = []
        for row in np.roll(np.arange(BOXES), -2).tolist():  # the sure pair last
            box = Box(pose_to_ros(boxes.poses[row]), vector_to_ros(boxes.sizes[row]))
            some.append(Detection(header_at(boxes.stamp), [], box, str(boxes.ids[row])))
        for _ in range(random.randint(0, HOSTILE)):
            box = Box(pose_to_ros(self._bad_pose(random)), vector_to_ros(boxes.sizes[0]))
            bad = Detection(header_at(boxes.stamp), [], box, random.choice(("", "7", "nobody")))
            some.insert(random.randint(0, len(some)), bad)
        return [
            ("objects", self._array(random, boxes.start, [])),
            ("detections", serialised(Detections(header_at(boxes.stamp), some))),
        ]

    def _cloud(
        self, random: Random, ids: Any, poses: Floats, sizes: Floats | None, stamp: int
    ) -> PointCloud2:
        """Return rows of boxes in any layout, with hostile rows between them."""
        names = ["ns", "id", "x", "y", "z", "qx", "qy", "qz", "qw", "unused", "\u00e9"]
        names += [] if sizes is None else ["size_x", "size_y", "size_z"]
        random.shuffle(names)
        order = random.choice("<>")
        kinds = [order + ("i4" if name in ("ns", "id") else "f8") for name in names]
        width = sum(int(kind[2:]) for kind in kinds) + random.randint(0, 9)
        ends = np.cumsum([0, *(int(kind[2:]) for kind in kinds)])[:-1].tolist()
        layout: Any = {"names": names, "formats": kinds, "offsets": ends, "itemsize": width}
        good = np.zeros(len(ids), np.dtype(layout))
        good["ns"] = namespace_number(NAMESPACE if sizes is None else SETS)
        good["id"] = ids
        columns = ("x", "y", "z", "qx", "qy", "qz", "qw")
        for column, name in enumerate(columns):
            good[name] = poses[:, column]
        for column, name in enumerate(() if sizes is None else ("size_x", "size_y", "size_z")):
            assert sizes is not None
            good[name] = sizes[:, column]
        bad: Any = np.zeros(random.randint(0, HOSTILE) if len(ids) else 0, good.dtype)
        for row in range(len(bad)):
            bad[row] = good[random.randrange(len(ids))]  # a later row of the same key counts
            bad[random.choice(columns)][row] = random.choice((np.nan, np.inf, 1e308))
        return cloud_to_ros(np.concatenate((bad, good)), header_at(stamp))

    def points(
        self, random: Random, probe: Probe, stamp: int
    ) -> tuple[PointCloud2, dict[int, int]]:
        """Return points, some of them not finite, and the number of points in each box by its id.

        Only boxes that are not turned are counted: for them the count is exact.
        """
        places = np.array([[random.randint(0, 32) / 16 for _ in "xyz"] for _ in range(200)])
        right = {}
        for row in np.flatnonzero(probe.poses[:, 6] == 1.0).tolist():
            inside = 2.0 * np.abs(places - probe.poses[row, :3]) <= probe.sizes[row]
            right[probe.sure[0] + row] = int(np.count_nonzero(inside.all(axis=1)))
        rows = np.zeros(300, [(name, random.choice(("<f4", "<f8"))) for name in "xyz"])
        hostile = [value for value in FLOATS if not abs(value) <= 1e9]  # NaN, too
        with np.errstate(over="ignore"):
            for column, name in enumerate("xyz"):
                rows[name][:200] = places[:, column]
                rows[name][200:] = [random.choice(hostile) for _ in range(100)]
        random.shuffle(order := list(range(300)))
        return cloud_to_ros(rows[order], header_at(stamp)), right


def header_at(stamp: int) -> Header:
    """Return a header in the fixed frame."""
    return Header(stamp=stamp_to_ros(stamp), frame_id="map")


def vector_to_ros(values: Any) -> Vector3:
    """Return a vector."""
    x, y, z = (float(one) for one in values)
    return Vector3(x=x, y=y, z=z)

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

"""Sets of boxes without topics: beside markers and poses as a dict says."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from objects_rig import KnownUntil
from rclpy.serialization import serialize_message
from rig import cube, pose
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node import boxes_to_ros, namespace_number, poses_to_ros
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.inputs import Inputs
from obb_collision.node.inputs.subscriptions import INPUTS
from obb_collision.node.messages.conversions import Key, stamp_to_ros
from obb_collision.node.objects import Objects
from obb_collision.node.objects.frames import FixedFrameOnly
from obb_collision.node.runtime.guard import Guard

NAMESPACES = ("boxes", "a", "")
SIZES = (1.0, 2.0, 0.0)  # the last one is refused


class Row(NamedTuple):
    """A box or marker at a place along x, a cube of a size."""

    ns: str
    id: int
    place: int
    size: float

    @property
    def key(self) -> Key:
        return self.ns, self.id


class Sent(NamedTuple):
    """A message: kind is set, add, delete, all or poses."""

    kind: str
    rows: list[Row]


rows = st.builds(
    Row,
    ns=st.sampled_from(NAMESPACES),
    id=st.integers(-1, 2),
    place=st.integers(0, 3),
    size=st.sampled_from(SIZES),
)
kinds = st.sampled_from(["set", "set", "set", "add", "delete", "all", "poses"])
sequences = st.lists(st.builds(Sent, kinds, st.lists(rows, max_size=6)), max_size=8)


class Model:
    """Objects by key, with what they came by, their place and their size."""

    def __init__(self) -> None:
        self.objects: dict[Key, tuple[str, int, float]] = {}
        self.missing: set[Key] = set()

    def apply(self, sent: Sent) -> None:
        getattr(self, sent.kind)({row.key: row for row in sent.rows})

    def set(self, last: dict[Key, Row]) -> None:
        kept = {k: o for k, o in self.objects.items() if o[0] == "marker" or k in last}
        self.objects, self.missing = kept, set()
        for key, row in last.items():
            owner = kept.get(key, ("set",))[0]
            if owner == "set" and row.size:
                self.objects[key] = "set", row.place, row.size
            elif key not in kept or owner == "marker":
                self.missing.add(key)

    def add(self, last: dict[Key, Row]) -> None:
        for key, row in last.items():
            if self.objects.get(key, ("marker",))[0] == "marker" and row.size:
                self.objects[key] = "marker", row.place, row.size

    def delete(self, last: dict[Key, Row]) -> None:
        for key in last:
            if self.objects.get(key, ("",))[0] == "marker":
                del self.objects[key]

    def all(self, last: dict[Key, Row]) -> None:
        gone = {key[0] for key in last}
        for key, (owner, *_) in list(self.objects.items()):
            if owner == "marker" and (key[0] in gone or "" in gone):
                del self.objects[key]

    def poses(self, last: dict[Key, Row]) -> None:
        for key, row in last.items():
            if key in self.objects:
                owner, _, size = self.objects[key]
                self.objects[key] = owner, row.place, size


class Real:
    """The inputs of a node, without its topics."""

    def __init__(self, frames: Any = None) -> None:
        self.now = 1
        self.errors: list[str] = []
        guard, frames = Guard(self.errors.append, lambda: True), frames or FixedFrameOnly("map")
        self.objects = Objects("map", frames, guard)
        self.monitors = {topic: InputMonitor(topic, lambda text: None) for topic in INPUTS}
        clock, never = (lambda: self.now), (lambda: False)
        self.inputs = Inputs(self.objects, self.monitors, clock, never, guard, frames)

    def send(self, sent: Sent) -> None:
        self.now += 1
        take = self.inputs.callbacks()
        # a namespace that nobody has said is called by its number: a marker says them all
        names = [cube((name, 99), size=(1, 1, 1)) for name in NAMESPACES]
        gone = [Marker(ns=name, id=99, action=Marker.DELETE) for name in NAMESPACES]
        take["objects"](serialize_message(MarkerArray(markers=[*names])))
        self.inputs.markers.apply()
        getattr(self, f"_{sent.kind}")(sent.rows, take)
        take["objects"](serialize_message(MarkerArray(markers=gone)))
        self.inputs.markers.apply()
        self.inputs.boxes.apply()
        self.objects.update(self.now)

    def _cloud(self, given: list[Row]) -> tuple[Any, Any, Any, Any]:
        places = np.array([pose(row.place) for row in given]).reshape(-1, 7)
        sizes = np.array([[row.size] * 3 for row in given]).reshape(-1, 3)
        numbers = [namespace_number(row.ns) for row in given]
        return [row.id for row in given], places, sizes, numbers

    def _set(self, given: list[Row], take: Any) -> None:
        take["object_boxes"](serialize_message(boxes_to_ros(*self._cloud(given))))

    def _poses(self, given: list[Row], take: Any) -> None:
        ids, places, _, numbers = self._cloud(given)
        take["object_poses"](serialize_message(poses_to_ros(ids, places, numbers)))

    def _markers(self, given: list[Row], take: Any, action: int) -> None:
        markers = [cube(row.key, (row.place, 0, 0), [row.size] * 3, action=action) for row in given]
        take["objects"](serialize_message(MarkerArray(markers=markers)))

    def _add(self, given: list[Row], take: Any) -> None:
        # of a backlog the last usable state counts, so of a key the last row is sent alone
        self._markers(list({row.key: row for row in given}.values()), take, Marker.ADD)

    def _delete(self, given: list[Row], take: Any) -> None:
        self._markers(given, take, Marker.DELETE)

    def _all(self, given: list[Row], take: Any) -> None:
        self._markers(given, take, Marker.DELETEALL)

    @property
    def born(self) -> dict[Key, int]:
        """Return what no two objects share."""
        serial = self.objects.scene.objects.store.born
        return {key: int(serial[slot]) for key, slot in self.objects.table.slots.items()}

    @property
    def state(self) -> dict[Key, tuple[str, int, float]]:
        table, scene = self.objects.table, self.objects.scene
        found = {}
        for key, slot in table.slots.items():
            owner = "set" if table.of_set[slot] else "marker"
            index = scene.index(f"{key[0]}/{key[1]}")
            assert index == slot, "one object under one name in table and scene"
            box = scene.objects.store.boxes(np.array([slot]))
            place = int(scene.objects.poses_of([slot])[0, 0])
            assert box.centers[0].tolist() == [place, 0, 0]
            found[key] = owner, place, 2.0 * float(box.half_extents[0, 0])
            assert table.visible[slot]
        return found


@settings(max_examples=60, deadline=None)
@given(sequences)
def test_any_sequence_comes_to_what_a_dict_comes_to(sequence: list[Sent]) -> None:
    model, real = Model(), Real()
    for sent in sequence:
        before, born = dict(model.objects), real.born
        model.apply(sent)
        real.send(sent)
        assert real.state == model.objects
        if sent.kind == "set":
            stay = {key for key in before if before[key][0] == model.objects.get(key, ("",))[0]}
            assert all(real.born[key] == born[key] for key in stay), "the same objects all along"
        if sent.kind == "set":
            assert model.missing <= set(real.objects.unplaceable), "what is not checked is said"
    assert not real.errors
    assert len(real.objects.scene) == len(model.objects)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.lists(rows, max_size=6), min_size=1, max_size=6), st.integers(0, 6))
def test_sets_that_wait_together_come_to_the_last_of_them(
    sets: list[list[Row]], split: int
) -> None:
    one, other = Real(), Real()
    for some in sets[:split]:
        one.send(Sent("set", some))
        other.send(Sent("set", some))
    waiting = sets[split:]
    for some in waiting:
        other._set(some, other.inputs.callbacks())
    last = Sent("set", waiting[-1] if waiting else sets[-1])
    one.send(last)
    other.send(last)
    assert other.state == one.state
    assert other.monitors["object_boxes"].superseded == len(waiting)


def test_a_set_whose_transform_is_no_pose_is_refused() -> None:
    frames = KnownUntil()
    frames.lookup = lambda frame, stamp: np.full(7, np.nan)  # type: ignore[method-assign]
    real = Real(frames)
    header = Header(stamp=stamp_to_ros(1), frame_id="camera")
    message = boxes_to_ros([1], [pose(0)], np.ones((1, 3)), header=header)
    real.inputs.callbacks()["object_boxes"](serialize_message(message))
    real.inputs.boxes.apply()
    assert real.state == {}
    assert real.monitors["object_boxes"].refused == {"bad transform": 1}

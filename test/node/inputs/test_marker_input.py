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

"""Messages of ``objects`` that wait come to what they come to one after another, within bounds."""

from __future__ import annotations

import math
from typing import NamedTuple

from builtin_interfaces.msg import Duration
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from objects_rig import SECOND
from rclpy.serialization import serialize_message
from rig import A1, A2, FRAME, POSES, Patch, Rig, cube, pose, spy, sync
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.inputs import markers as marker_input
from obb_collision.node.inputs.batch import Batch, find_faults, gather, settle
from obb_collision.node.messages.cdr import markers_from_bytes
from obb_collision.node.messages.conversions import Key, stamp_to_ros

CLEAR = Marker(action=Marker.DELETEALL)


def serialized(*markers: Marker) -> bytes:
    data: bytes = serialize_message(MarkerArray(markers=list(markers)))
    return data


def keys(rig: Rig) -> set[Key]:
    return set(rig.node.objects.table.slots)


def wait(rig: Rig, *messages: bytes) -> None:
    """Let messages wait as if they had just come, without a cycle in between."""
    for message in messages:
        rig.node.inputs.markers.queue(message, rig.node.now())


def test_of_a_backlog_only_last_states_are_looked_at(rig: Rig, monkeypatch: Patch) -> None:
    put = spy(monkeypatch, rig.node.objects.shapes, "put_primitives")
    wait(rig, *(serialized(cube(A1, (x, 0, 0)), cube(A2, (x + 0.5, 0, 0))) for x in range(50)))
    assert sync(rig) == {("a/1", "a/2")}
    assert sum(len(call.args[0][0]) for call in put.call_args_list) == 3, "two, and that of sync"
    assert rig.pose_of(A1)[0] == 49.0
    wait(rig, *(serialized(cube(A1, (x, 0, 0))) for x in range(50)))
    put.reset_mock()
    sync(rig)
    put.assert_not_called()  # an unchanged shape is a pose update


def test_deleteall_drops_what_waits(rig: Rig, monkeypatch: Patch) -> None:
    gathered = spy(monkeypatch, marker_input, "gather")
    for n in range(20):
        wait(rig, serialized(CLEAR, *(cube(("c", 10 * n + k)) for k in range(9))))
    rig.until(lambda: len(keys(rig)) == 9, "the last frame")
    assert [len(call.args[0]) for call in gathered.call_args_list] == [1]
    assert keys(rig) == {("c", 190 + k) for k in range(9)}


def test_what_waits_is_bounded(rig: Rig, monkeypatch: Patch) -> None:
    monkeypatch.setattr(marker_input, "MAX_WAITING_BYTES", 100_000)
    markers, peak = rig.node.inputs.markers, 0
    triangles = cube(("t", 1), type=Marker.TRIANGLE_LIST)
    for number in range(300):
        message = serialized(
            triangles,
            *(cube(("c", k), (number, 3 * k, 0)) for k in range(20)),
            Marker(ns="d", id=number, action=Marker.DELETE),
        )
        markers.queue(message, rig.node.now())
        peak = max(peak, markers.size)
        assert markers.size <= 100_000 + 3 * len(message)
    assert peak > 50_000
    sync(rig)
    assert {key for key in keys(rig) if key[0] == "c"} == {("c", k) for k in range(20)}
    assert {rig.pose_of(("c", k))[0] for k in range(20)} == {299.0}
    assert rig.refused("objects").keys() == {"no points"}


def test_many_new_objects_without_end_are_refused_within_bounds(monkeypatch: Patch) -> None:
    monkeypatch.setattr(marker_input, "MAX_WAITING_BYTES", 100_000)
    with Rig(max_objects=100) as rig:
        for number in range(100):
            wait(rig, serialized(*(cube(("c", 50 * number + k)) for k in range(50))))
            assert rig.node.inputs.markers.size <= 150_000
        rig.until(lambda: rig.refused("objects"), "refusals")
        rig.cycles(2)
        assert rig.refused("objects") == {"too many objects": 4900}
        assert len(keys(rig)) == 100


def test_where_the_last_state_cannot_be_built_the_one_before_counts(rig: Rig) -> None:
    broken = cube(A1, (5, 0, 0), type=Marker.TRIANGLE_LIST)
    wait(rig, serialized(cube(A1)), serialized(broken))
    assert sync(rig) == set()
    assert rig.is_doubtful(A1)
    assert rig.pose_of(A1)[0] == 0.0
    assert rig.refused("objects") == {"no points": 1}


def test_other_topics_come_after_the_markers_before_them(rig: Rig) -> None:
    wait(rig, serialized(cube(A1), cube(A2, (3, 0, 0))))
    rig.send_transform("a/2", pose(0.5))
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.refused("object_transform") == {}


def test_what_is_deleted_and_comes_again_is_a_new_object(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (5, 0, 0))).answer()
    objects, stamp = rig.node.objects, rig.stamp
    slot, born = objects.table.slots[A1], objects.scene.objects.store.born.copy()
    rig.stamp -= 900_000_000
    rig.send(CLEAR, cube(A1, (1, 0, 0)))
    assert rig.pairs() == set()
    assert keys(rig) == {A1}
    assert objects.table.slots[A1] == slot
    assert objects.scene.objects.store.born[slot] > born[slot]
    assert rig.refused("objects") == {}, "its stamps begin anew"
    assert rig.stamp < stamp


@each("seconds", [0, 7])
def test_overload_is_said_with_ages_of_states(rig: Rig, monkeypatch: Patch, seconds: int) -> None:
    subscribed = rig.node.subscribed
    taken = subscribed.take_wait
    monkeypatch.setattr(subscribed, "take_wait", lambda: (wait := taken()) and wait + seconds)
    stamp = stamp_to_ros(rig.now() - 3 * SECOND)

    def said() -> bool:
        rig.send(cube(A1, header=Header(stamp=stamp, frame_id=FRAME)), stamped=False)
        status = rig.status(": cycle")
        key = "age of the newest state evaluated (s)"
        if key not in status or ("overload" in status["message"]) != bool(seconds):
            return False
        assert float(status["longest delay (s)"]) >= seconds
        assert float(status[key]) >= 3.0, "by its stamp"
        return status["level"] == "01" if seconds else True

    rig.until(said, "a report on this state")


def test_no_message_has_no_delay(rig: Rig) -> None:
    rig.send(cube(A1)).answer()
    rig.cycles(1)
    assert rig.node.subscribed.take_wait() == 0.0
    rig.next("/diagnostics")
    assert "longest delay (s)" not in rig.status(": cycle")


def test_all_that_waits_is_taken_before_one_cycle(rig: Rig) -> None:
    rig.set(rate=0.1)  # no cycle for 10 s
    for x in range(30):
        rig.send(cube(A1, (x, 0, 0)))
        rig.send_transform("a/1", pose(x + 0.5))
    total = rig.node.cycle.monitor.total
    rig.until(lambda: rig.monitor("objects").messages > 0, "the first message")
    rig.node.collect()
    assert [rig.monitor(topic).messages for topic in POSES[:2]] == [30, 30]
    assert rig.node.cycle.monitor.total == total
    table = rig.node.objects.table
    assert table.stamp[table.slots[A1]] == rig.stamp


ANY = 1 << 62
"""A tolerance for stamps that believes each."""
NAMESPACES = ["", "a", "b"]


class Action(NamedTuple):
    """A marker of a test: kind is add, bad, delete or all."""

    kind: str
    ns: str
    id: int
    stamp: int
    lifetime: int


actions = st.builds(
    Action,
    kind=st.sampled_from(["add", "add", "add", "bad", "delete", "all"]),
    ns=st.sampled_from(NAMESPACES),
    id=st.integers(-1, 1),
    stamp=st.integers(0, 3),
    lifetime=st.sampled_from([0, 0, 1, 5]),
)
messages = st.lists(st.lists(actions, max_size=6), min_size=1, max_size=5)


def marker_of(action: Action) -> Marker:
    """Return the marker; what is bad has no size."""
    marker = cube((action.ns, action.id), size=(0, 1, 1) if action.kind == "bad" else (1, 1, 1))
    marker.action = {"delete": Marker.DELETE, "all": Marker.DELETEALL}.get(action.kind, Marker.ADD)
    marker.header.stamp = stamp_to_ros(action.stamp)
    marker.lifetime = Duration(sec=action.lifetime)
    return marker


def gathered(sent: list[list[Action]]) -> Batch:
    """Return messages, received a second apart."""
    arrays = [MarkerArray(markers=[marker_of(action) for action in one]) for one in sent]
    scans = [markers_from_bytes(serialize_message(message)) for message in arrays]
    return gather(scans, [number * SECOND for number in range(len(scans))])


class Model:
    """What one marker after another does to objects that are all there at the beginning."""

    def __init__(self, ended: set[int]) -> None:
        keys = [(ns, number) for ns in NAMESPACES for number in (-1, 0, 1)]
        self.rows: dict[Key, int] = dict.fromkeys(keys, -1)  # -1: as it was
        self.order: dict[Key, int] = {}
        self.until: dict[Key, float] = {}
        self.doubtful: dict[Key, int] = {}
        self._ended = ended

    def apply(self, row: int, action: Action, received: int) -> None:
        key = action.ns, action.id
        if received >= self.until.get(key, math.inf):  # the object has expired
            self.order.pop(key, None)
        if action.kind == "all":
            for other in {*self.rows, *self.order, *self.doubtful}:
                if action.ns in ("", other[0]):
                    self._remove(other)
        elif action.kind == "delete":
            self._remove(key)
        elif action.kind == "bad":
            self.doubtful[key] = row
        elif not 0 < action.stamp < self.order.get(key, 0):
            order = action.stamp or self.order.get(key, 0)
            if row in self._ended:
                self._remove(key)
            else:
                self.rows[key] = row
            self.order[key] = order
            self.until[key] = received + action.lifetime if action.lifetime else math.inf
            self.doubtful.pop(key, None)

    def _remove(self, key: Key) -> None:
        for table in (self.rows, self.order, self.until, self.doubtful):
            table.pop(key, None)


def outlived(sent: list[list[Action]], now: int) -> set[int]:
    """Rows whose lifetime was over before ``now`` (s), with a later message about the namespace."""
    numbered = [(part, action) for part, one in enumerate(sent) for action in one]
    return {
        row
        for row, (part, action) in enumerate(numbered)
        if action.kind == "add" and action.lifetime and part + action.lifetime <= now
        if any(p > part and a.ns == action.ns and a.kind == "add" for p, a in numbered)
    }


@settings(max_examples=150)
@given(messages, st.integers(0, 8))
def test_a_backlog_comes_to_its_messages_in_order(sent: list[list[Action]], now: int) -> None:
    markers = gathered(sent)
    model = Model(outlived(sent, now))
    numbered = ((part, action) for part, one in enumerate(sent) for action in one)
    for row, (part, action) in enumerate(numbered):
        model.apply(row, action, part)
    assert results(markers, sent, now) == (model.rows, model.doubtful)


def results(markers: Batch, sent: list[list[Action]], now: int) -> tuple[dict[Key, int], ...]:
    """Return the number of the marker that each object has in the end, and of that it refused."""
    found = settle(markers, find_faults(markers, lambda frame: 0), now * SECOND, ANY)
    rows = {(ns, number): -1 for ns in NAMESPACES for number in (-1, 0, 1)}
    for action in (action for one in sent for action in one if action.kind == "all"):
        rows = {key: row for key, row in rows.items() if action.ns not in ("", key[0])}
    doubtful = {}
    for index, first in enumerate(found.first.tolist()):
        key, winner, bad = markers.key(first), found.winner[index], found.bad[index]
        if found.remover[index] >= 0:
            rows.pop(key, None)
        if winner >= 0:
            rows[key] = int(winner)
        if bad >= 0:
            doubtful[key] = int(bad)
    return rows, doubtful


def test_names_are_told_apart_by_their_bytes() -> None:
    data = serialize_message(MarkerArray(markers=[Marker(ns="abc"), Marker(ns="abd")]))
    scan = markers_from_bytes(data.replace(b"abc", b"a\xffc").replace(b"abd", b"a\xfec"))
    markers = gather([scan, scan], [0, 1])
    assert markers.ns.of.tolist() == [0, 1, 0, 1]
    assert {error.reason for error in markers.ns.bad.values()} == {"bad name"}

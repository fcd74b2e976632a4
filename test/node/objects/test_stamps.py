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

"""Stamps of all kinds, twists, and quaternions far from unit length."""

from __future__ import annotations

from collections import Counter
from unittest.mock import patch

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from each import each
from hypothesis import given
from hypothesis import strategies as st
from objects_rig import MILLISECOND, SECOND, START, ObjectsRig, place
from rig import A1, A2, FRAME, POSES, FakeFrames, Printed, Rig, cube, pose, sync
from std_msgs.msg import Header

from obb_collision.node.messages.conversions import stamp_from_ros, stamp_to_ros, states_to_ros
from obb_collision.node.objects.conditions import STALE
from obb_collision.node.objects.states import AHEAD, ANEW

TOPIC = "object_states"
HOUR = 3600 * SECOND


class Model:
    """One object, by the rules for stamps: a tolerance of 0.5 s, and a second for late ones."""

    def __init__(self) -> None:
        self.order = self.received = self.stamp = 0
        self.is_overtaken = False
        self.doubted: Counter[tuple[str, str]] = Counter()

    def send(self, stamp: int, now: int) -> int:
        """Take a state; returns whether it is too old, and refused."""
        older = 0 < stamp < self.order
        if older and now - self.received <= SECOND:
            self.is_overtaken = True
            return 1
        is_ahead = stamp > now + SECOND // 2
        self.doubted += Counter({(TOPIC, ANEW): int(older), (TOPIC, AHEAD): int(is_ahead)})
        if stamp and not is_ahead:  # any other orders nothing
            self.order = stamp
        self.received, self.stamp, self.is_overtaken = now, stamp, False
        return 0

    def is_doubtful(self, now: int) -> bool:
        held_back = self.is_overtaken and SECOND // 2 < now - self.received <= SECOND
        return held_back or self.stamp > now + SECOND // 2

    def newest(self, now: int) -> int:
        """Return the stamp that is believed, 0 for none."""
        return self.stamp if self.stamp <= now + SECOND // 2 else 0


DELAYS = [0, 20 * MILLISECOND, 300 * MILLISECOND, 700 * MILLISECOND, 2 * SECOND]
OFFSETS = [0, -10 * MILLISECOND, -HOUR // 9, SECOND // 2, SECOND // 2 + 1, HOUR]


@given(st.lists(st.tuples(st.sampled_from(DELAYS), st.none() | st.sampled_from(OFFSETS))))
def test_states_are_ordered_and_doubted_by_stamps(steps: list[tuple[int, int | None]]) -> None:
    """None: without a stamp. The second object gets no state after its first."""
    rig, model = ObjectsRig(A1, A2), Model()
    rig.send(START)
    model.send(START, START)
    for delay, offset in steps:
        rig.now += delay
        rig.cycle()
        assert rig.is_doubtful() == model.is_doubtful(rig.now), "also without a new state"
        stamp = 0 if offset is None else rig.now + offset
        assert rig.send(stamp, row=0) == model.send(stamp, rig.now)
        rig.cycle()
        assert rig.x() == place(model.stamp)
        assert rig.is_doubtful() == model.is_doubtful(rig.now)
        assert not rig.is_doubtful(1)
        assert rig.doubted == model.doubted
        assert rig.objects.newest_stamp(rig.now) == max(model.newest(rig.now), START)


def test_senders_far_ahead_of_the_node_move_their_objects_all_the_same() -> None:
    rig = ObjectsRig(A1)  # as on a robot that begins in 1970
    for _ in range(10):
        rig.now += 20 * MILLISECOND
        assert rig.send(rig.now + HOUR) == 0
        rig.cycle()
        assert rig.x() == place(rig.now + HOUR)
        assert rig.is_doubtful()
        assert rig.objects.newest_stamp(rig.now) == rig.now, "time of receipt"
    assert rig.doubted[TOPIC, AHEAD] == 10
    rig.now += HOUR
    rig.objects.clock_jumped(HOUR)
    rig.cycle()
    assert not rig.is_doubtful(), "once the clock is right"


def test_by_topics_a_marker_of_the_future_among_others_does_not_outlast_them(rig: Rig) -> None:
    rig.send(cube(A2)).answer()
    markers = [cube(A1, (x, 0, 0)) for x in (5.0, 0.5, 0.25)]
    rig.stamp += 1
    for marker, stamp in zip(markers, (rig.now() + HOUR, rig.stamp, rig.stamp + 1), strict=True):
        marker.header.stamp = stamp_to_ros(stamp)
    rig.stamp += 1
    rig.send(*markers, stamped=False)
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.pose_of(A1)[0] == 0.25


BAD = [Time(sec=2**31 - 1, nanosec=2**32 - 1), Time(sec=-1), Time(sec=1, nanosec=10**9)]


def send_stamped(rig: Rig, topic: str, stamp: Time) -> None:
    """Send a pose of a/1, or points, with a stamp of its own."""
    header = Header(stamp=stamp, frame_id=FRAME)
    with patch.object(rig, "header", lambda *_: header):
        if topic == "points":
            rig.send_points([[0.0, 0.0, 0.0]])
        else:
            rig.send_by(topic, {A1: pose(9.0)})


@each("topic", [*POSES, "points"])
def test_stamps_that_no_clock_gives_are_refused_by_topic(rig: Rig, topic: str) -> None:
    rig.send(cube(A1), cube(A2, (0.5, 0, 0)))
    assert rig.pairs() == {("a/1", "a/2")}
    for count, stamp in enumerate(BAD, 1):
        send_stamped(rig, topic, stamp)
        rig.refuses(topic, {"bad stamp": count})
    assert sync(rig) == {("a/1", "a/2")}
    assert rig.is_doubtful(A1) == (topic != "points")
    assert rig.node.guard.total == 0


def test_by_topics_a_future_stamp_is_counted_and_never_published(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0))).answer()
    ahead = stamp_to_ros(rig.now() + HOUR)
    message = states_to_ros(["a/2"], np.array([pose(0.5)]), rig.header())
    message.header.stamp = ahead
    rig.pubs["object_states"].publish(message)
    rig.until(lambda: rig.last["in_collision"].data, "used")
    status = rig.status("input object_states")
    assert status[f"doubtful: {AHEAD}"] == "1"
    objects = rig.status(": objects")
    assert objects["names doubtful stamp"] == "a/2"
    assert (objects["message"], objects["level"]) == ("1 with a doubtful stamp", "01")
    assert stamp_from_ros(rig.next("collisions").header.stamp) <= rig.now() + SECOND // 2
    rig.send_transform("a/2", pose(3.0))
    assert rig.pairs() == set()


def test_by_topics_the_points_of_the_future_carry_their_time_of_receipt(rig: Rig) -> None:
    rig.next("points_inside")
    rig.send(cube(A1)).answer()
    send_stamped(rig, "points", stamp_to_ros(rig.now() + HOUR))
    message = rig.until(lambda: (m := rig.last.get("points_inside")) and m.width and m, "inside")
    assert stamp_from_ros(message.header.stamp) <= rig.now()
    assert dict(rig.monitor("points").doubted) == {AHEAD: 1}


FORWARD = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]


def twist(rig: Rig, name: str) -> list[float]:
    scene = rig.node.objects.scene
    twists: list[float] = scene.objects.store.twists[scene.index(name)].tolist()
    return twists


@each("topic", POSES)
def test_a_state_with_a_twist_sets_it_and_any_other_ends_it(rig: Rig, topic: str) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0))).answer()
    twists = [FORWARD, [0.0] * 6]
    rig.send_states(["a/1", "a/2"], [pose(0.0), pose(3.0)], twists=twists).answer()
    assert [twist(rig, name) for name in ("a/1", "a/2")] == twists
    rig.send_by(topic, {A1: pose(9.0)}).answer()
    assert twist(rig, "a/1") == [0.0] * 6


def test_twists_of_a_turned_frame_are_turned_with_it() -> None:
    frames = FakeFrames()
    turn = np.sqrt(0.5)
    frames.known["robot"] = [5.0, 0.0, 0.0, 0.0, 0.0, turn, turn]  # x of it is y of the map
    with Rig(frames) as rig:
        rig.send(cube(A1)).answer()
        rig.send_states(["a/1"], [pose(0.0)], "robot", twists=[FORWARD]).answer()
        assert twist(rig, "a/1") == pytest.approx([-2.0, 1.0, 3.0, -0.2, 0.1, 0.3])


@each("bad", [[np.nan, 0, 0, 0, 0, 0], [0, 0, 0, 0, np.inf, 0], [2e300] + [0] * 5])
def test_a_twist_that_is_no_number_is_refused_without_its_pose(rig: Rig, bad: list[float]) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0))).answer()
    rig.send_states(["a/1", "a/2"], [pose(2.5), pose(3.0)], twists=[bad, FORWARD])
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.refused("object_states") == {"bad twist": 1}
    assert twist(rig, "a/1") == [0.0] * 6
    assert twist(rig, "a/2") == FORWARD
    assert not rig.node.objects.table.doubtful.any()


def test_a_stale_object_is_not_taken_to_go_on() -> None:
    with Rig(object_timeout=0.3) as rig:
        rig.has_true_stamps = True
        rig.send(cube(A1)).answer()
        rig.send_states(["a/1"], [pose(0.0)], twists=[FORWARD]).answer()
        rig.until(lambda: rig.node.objects.table.has(STALE).any(), "stale")
        rig.cycles(2)
        assert twist(rig, "a/1") == [0.0] * 6


def test_a_policy_set_after_the_last_twist_knows_its_speed() -> None:
    with Rig(given={"effects.sweep": "off", "object_timeout": 0.3}) as rig:
        rig.has_true_stamps = True
        rig.send(cube(A1)).answer()
        rig.send_states(["a/1"], [pose(0.0)], twists=[[10.0, 0, 0, 0, 0, 0]]).answer()
        rig.set(stale_policy="collide", stale_reach=1000.0)
        store, slot = rig.node.objects.scene.objects.store, rig.node.objects.table.slots[A1]
        for _ in range(2):
            rig.until(lambda: store.growths[slot], "growth")
            age = (rig.now() - rig.stamp) / SECOND
            assert 10.0 * 0.3 < store.growths[slot] <= 10.0 * age
            rig.send_by("objects", {A1: pose(0.0)}).answer()


def test_twists_are_not_used_where_sweeps_are_off() -> None:
    with Rig(given={"effects.sweep": "off"}) as rig:
        rig.send(cube(A1)).answer()
        rig.send_states(["a/1"], [pose(1.0)], twists=[FORWARD]).answer()
        assert twist(rig, "a/1") == [0.0] * 6


REASON = "doubtful: quaternion far from unit length"
#: A quarter turn about z, twice as long as it should be: the bar then lies along y.
PLACE = [0.0, 0.0, 0.0, 0.0, 0.0, 2.0**0.5, 2.0**0.5]
COLLIDE = ({("bar/1", "post/1")}, {("post/1", "bar/1")})
BAR, LONG = ("bar", 1), (8.0, 0.5, 0.5)


@each("topic", POSES)
def test_it_is_normalised_counted_and_told_once(topic: str, rig: Rig, capfd: Printed) -> None:
    rig.send(cube(BAR, size=LONG), cube(("post", 1), (0.0, 3.0, 0.0)))
    assert rig.pairs() == set()
    rig.send_by(topic, {BAR: [0.0, 0.0, 0.0, 0.0, 0.0, 0.7, 0.7]}, LONG)
    assert rig.pairs() in COLLIDE
    assert REASON not in rig.status(f"input {topic}"), "one that is near is taken as it is"
    for count in (1, 2, 3):
        rig.send_by(topic, {BAR: PLACE}, LONG)
        assert rig.pairs() in COLLIDE
        while rig.status(f"input {topic}").get(REASON) != str(count):
            pass  # the next report
    box = rig.node.objects.scene.obb("bar/1")
    np.testing.assert_allclose(box.rotation[:, 0], [0.0, 1.0, 0.0], atol=1e-15)
    assert not any(rig.refused(topic).values())
    told = [line for line in capfd.readouterr().err.splitlines() if "far from unit" in line]
    assert len(told) == 1
    assert f"{topic}: doubtful quaternion far from unit length: 1; last: bar/1" in told[0]

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

"""States in other frames: placed by tf2 at their stamp, late or refused."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from each import each
from geometry_msgs.msg import TransformStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from objects_rig import MILLISECOND, SECOND, START, ObjectsRig, place
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.time import Time
from rig import A1, A2, B1, FRAME, POSES, FakeFrames, Patch, Rig, color, cube, pose
from std_msgs.msg import Header

from obb_collision.node.diagnostics.answer import FREE, UNKNOWN
from obb_collision.node.messages import conversions as cv
from obb_collision.node.messages.box_markers import COLORS, DOUBTFUL
from obb_collision.node.messages.box_markers import FREE as GREEN
from obb_collision.node.messages.clouds import cloud_to_ros
from obb_collision.node.objects import frames as frames_of_node
from obb_collision.node.objects import placement
from obb_collision.node.objects.conditions import STALE, UNPLACED
from obb_collision.node.objects.frames import EXTRAPOLATION
from obb_collision.node.objects.states import AgeLimits, State


def test_without_tf2_the_node_says_so(monkeypatch: Patch) -> None:
    monkeypatch.setattr(frames_of_node, "tf2_ros", None)
    with Rig(tf2=True) as rig:
        assert "fixed frame only" in rig.node.frames.description
        rig.send(cube(A1, frame="nowhere"), cube(A2)).answer()
        assert rig.refused("objects") == {"unknown frame": 1}, "at once: no frame can come later"


class TransformException(Exception):  # noqa: N818 - tf2's name
    """Whatever makes a lookup fail."""


KINDS = "Lookup", "Connectivity", "Extrapolation", "InvalidArgument"
"""A frame is not known; nothing connects two; none is known at that time; no name of a frame."""
FAILURES: list[Any] = [type(f"{kind}Exception", (TransformException,), {}) for kind in KINDS]
UNKNOWN_FRAME, UNCONNECTED, TOO_FAR, _ = FAILURES


class Buffer:
    """Keeps transforms, and interpolates between them."""

    def __init__(self, cache_time: Any = None, node: Node | None = None) -> None:
        self._poses: dict[tuple[str, str], dict[int, Any]] = {}

    def set_transform(self, transform: TransformStamped, authority: str) -> None:
        names = transform.header.frame_id, transform.child_frame_id
        stamp = cv.stamp_from_ros(transform.header.stamp)
        self._poses.setdefault(names, {})[stamp] = cv.transform_from_ros(transform.transform)

    def set_transform_static(self, transform: TransformStamped, authority: str) -> None:
        self.set_transform(transform, authority)
        names = transform.header.frame_id, transform.child_frame_id
        self._poses[names] = {0: cv.transform_from_ros(transform.transform)}

    def lookup_transform(self, target: str, source: str, time: Time) -> TransformStamped:
        poses = self._poses.get((target, source))
        if poses is None:
            if {target, source} <= {name for names in self._poses for name in names}:
                raise UNCONNECTED(f"{source!r} and {target!r} are not connected")
            raise UNKNOWN_FRAME(f"{source!r} or {target!r} does not exist")
        stamps = sorted(poses)
        at = time.nanoseconds or stamps[-1]
        if stamps != [0] and not stamps[0] <= at <= stamps[-1]:
            raise TOO_FAR(f"{at} is outside of {stamps[0]} to {stamps[-1]}")
        numbers = np.array([poses[stamp] for stamp in stamps])
        found = [np.interp(at, stamps, column) for column in numbers.T]
        header = Header(stamp=cv.stamp_to_ros(at))  # as tf2 does: the time for which it is
        return TransformStamped(header=header, transform=cv.transform_to_ros(found))


class TransformListener:
    """Takes in transforms by set_transform of its buffer only."""

    def __init__(self, buffer: Buffer, node: Node, *, spin_thread: bool = False) -> None:
        self.buffer = buffer


USED = Buffer, TransformListener, TransformException, *FAILURES
STAND_IN = SimpleNamespace(**{one.__name__: one for one in USED})
"""What the node uses of tf2_ros, for machines without it: the same names, the same answers.

One level of frames only: each transform is stored by its child frame, and looked up in its parent.
"""


@pytest.fixture(params=["tf2", "stand-in"])
def tf2_ros(request: pytest.FixtureRequest, monkeypatch: Patch) -> Any:
    """tf2_ros as the node sees it: the real one where it is installed, and its stand-in."""
    if request.param == "tf2":
        return pytest.importorskip("tf2_ros", reason="tf2_ros is not installed (not on PyPI)")
    monkeypatch.setattr(frames_of_node, "tf2_ros", STAND_IN)
    return STAND_IN


def set_transform(
    rig: Rig, x: float, stamp: int, frame: str = "robot", of: str = FRAME, static: bool = False
) -> None:
    """Give the node a transform of a frame, as tf2's listener does."""
    transform = TransformStamped(child_frame_id=frame, transform=cv.transform_to_ros(pose(x)))
    transform.header = Header(stamp=cv.stamp_to_ros(stamp), frame_id=of)
    frames: Any = rig.node.frames
    buffer = frames.buffer
    (buffer.set_transform_static if static else buffer.set_transform)(transform, "test")


def test_with_tf2_poses_are_placed_at_their_stamp_or_by_the_last_transform(tf2_ros: Any) -> None:
    with Rig(tf2=True) as rig:
        assert rig.node.frames.description == "tf2"
        set_transform(rig, 2.0, rig.stamp)
        set_transform(rig, 4.0, rig.stamp + 2_000_000)  # the marker is of the middle
        rig.send(cube(A2, (0.5, 0, 0), frame="robot"), cube(A1, (3, 0, 0)))
        assert rig.pairs() == {("a/1", "a/2")}
        assert rig.pose_of(A2)[0] == 3.5
        set_transform(rig, 3.0, rig.stamp + 5_000_000)
        rig.send(cube(B1, (0.5, 0, 0), frame="robot"), stamped=False)
        rig.until(lambda: B1 in rig.node.objects.table.slots, "an object")
        rig.cycles(1)
        assert rig.pose_of(B1)[0] == 3.5
        set_transform(rig, 7.0, rig.stamp + 10_000_000)
        rig.cycles(2)
        assert rig.pose_of(B1)[0] == 3.5, "not locked: stays where it was placed"


def test_with_tf2_poses_are_also_found_in_other_frames(tf2_ros: Any) -> None:
    with Rig(tf2=True) as rig:
        set_transform(rig, 2.0, rig.stamp, "base", of="odom")
        set_transform(rig, 4.0, rig.stamp + 2_000_000, "base", of="odom")
        lookup = frames_of_node.lookup_in(rig.node.frames, FRAME, "odom")
        assert [lookup("base", at)[0][0] for at in (0, rig.stamp + 1_000_000)] == [4.0, 3.0]


def test_with_tf2_the_latest_transform_has_its_stamp_and_static_ones_none(tf2_ros: Any) -> None:
    with Rig(tf2=True) as rig:
        set_transform(rig, 2.0, rig.stamp)
        set_transform(rig, 4.0, rig.stamp + 2_000_000)
        lookup = rig.node.frames.lookup
        found = [lookup("robot", stamp) for stamp in (0, rig.stamp + 1_000_000)]
        assert [place[0] for place, _ in found] == [4.0, 3.0]
        assert [stamp - rig.stamp for _, stamp in found] == [2_000_000, 1_000_000]
        set_transform(rig, 1.0, rig.stamp, "table", static=True)
        assert lookup("table", 0)[1] == 0
        if tf2_ros is not STAND_IN:  # chains: the oldest of all that are not static
            set_transform(rig, 1.0, rig.stamp + 9_000_000, "hand", "robot")
            set_transform(rig, 1.0, 0, "finger", "hand", static=True)
            assert lookup("finger", 0)[1] == rig.stamp + 2_000_000


def test_with_tf2_a_stamp_out_of_reach_and_frames_apart_have_own_reasons(tf2_ros: Any) -> None:
    with Rig(tf2=True, transform_timeout=0.0) as rig:
        rig.send(cube(A1)).answer()
        set_transform(rig, 0.0, rig.stamp - 10)
        rig.send_transform("a/1", pose(1.0), "robot")
        rig.refuses("object_transform", {"extrapolation": 1})
        set_transform(rig, 0.0, rig.stamp + 1_000_000, "b", "a")
        rig.send_poses([1], [pose(1.0)], frame="b")
        rig.refuses("object_poses", {"no transform": 1})


def test_with_tf2_frame_locked_objects_follow_in_every_cycle(tf2_ros: Any) -> None:
    with Rig(tf2=True) as rig:
        set_transform(rig, 0.0, rig.stamp)
        rig.send(cube(A2, frame="robot", frame_locked=True))
        rig.until(lambda: A2 in rig.node.objects.table.slots, "an object")
        run, seen = rig.node.cycle.run, list[float]()
        frame = {"x": 0.0}

        def run_and_move(now: int) -> None:
            frame["x"] += 1.0
            rig.stamp += 1
            set_transform(rig, frame["x"], rig.stamp)
            run(now)
            seen.append(float(rig.pose_of(A2)[0]))

        rig.node.cycle.run = run_and_move  # type: ignore[method-assign]
        rig.until(lambda: len(seen) >= 10, "cycles")
        assert seen == [float(number + 1) for number in range(len(seen))]


def test_with_tf2_no_look_up_waits_and_each_is_made_once(tf2_ros: Any, monkeypatch: Patch) -> None:
    with Rig(tf2=True, transform_timeout=30.0) as rig:
        buffer: Any = rig.node.frames.buffer  # type: ignore[attr-defined]
        look_up, asked = buffer.lookup_transform, list[tuple[str, int]]()

        def record(target: str, source: str, time: Any, *timeout: Any) -> Any:
            assert timeout == (), "by default none"
            asked.append((source, rig.node.cycle.monitor.total))
            return look_up(target, source, time)

        monkeypatch.setattr(buffer, "lookup_transform", record)
        far = [cube(("far", number), frame=f"frame_{number % 3}") for number in range(30)]
        rig.send(cube(A1), cube(A2, (9, 0, 0)), *far)
        rig.until(lambda: len({cycle for _, cycle in asked}) > 5, "look-ups in vain")
        rig.send_transform("a/2", pose(0.5))
        assert rig.pairs() == {("a/1", "a/2")}, "others are answered while those wait"
        counts = Counter(asked)
        assert {source for source, _ in counts} == {"frame_0", "frame_1", "frame_2"}
        assert max(counts.values()) == 1, "one for each frame and cycle, not for each object"


def test_with_tf2_what_cannot_be_placed_is_told_coloured_and_never_free(tf2_ros: Any) -> None:
    with Rig(tf2=True, transform_timeout=0.1) as rig:
        set_transform(rig, 5.0, rig.stamp + 1_000_000)
        rig.send(cube(A1), cube(A2, frame="robot"))
        assert rig.pairs() == set()
        rig.says(FREE)

        def colors() -> list[Any]:
            return [color(marker) for marker in rig.next("obb_collision/markers").markers]

        assert colors() == [COLORS[GREEN]] * 2
        rig.send_transform("a/2", pose(1.0), "robot")  # whose transform never comes
        rig.send(cube(("new", 1), frame="nowhere"))

        rig.until(lambda: "new/1" in rig.says(UNKNOWN, "a/2", True)["message"], "both names")
        rig.until(lambda: colors() == [COLORS[GREEN], COLORS[DOUBTFUL]], "grey at the last place")
        found = rig.status(": objects")
        assert (found["unplaceable"], found["names unplaceable"]) == ("1", "new/1")
        assert (found["refused"], found["names refused"]) == ("1", "a/2")
        assert rig.status("input object_transform")["rejected: extrapolation"] == "1"
        assert rig.status("input objects")["rejected: unknown frame"] == "1"


PERIOD = 20 * MILLISECOND
"""Of the states, and of the cycles."""
LATE = "object_states", EXTRAPOLATION


def run(rig: ObjectsRig, steps: int, known: Callable[[int], int], frame: str = "robot") -> None:
    """Send a state and run a cycle ``steps`` times; ``known``: until when, at a time."""
    for _ in range(steps):
        rig.now += PERIOD
        rig.send(rig.now, frame)
        rig.frames.spans[frame] = START, known(rig.now)
        rig.cycle()


def jitter(now: int) -> int:
    """Return until when a transform is known that is up to 0.18 s late."""
    return now - int(np.random.default_rng(now).integers(0, 180)) * MILLISECOND


KNOWN: dict[str, Callable[[int], int]] = {
    **{f"{late} ms late": lambda now, late=late: now - late * MILLISECOND for late in (5, 60, 150)},  # type: ignore[misc]
    "at ten hertz": lambda now: now - now % (SECOND // 10),
    "jitters": jitter,
}


@each("known", KNOWN.values())
def test_an_object_is_where_its_newest_placed_state_says(known: Callable[[int], int]) -> None:
    rig, newest = ObjectsRig(A1), START
    for _ in range(100):
        newest = max(newest, known(rig.now + PERIOD))
        run(rig, 1, lambda _: newest)  # noqa: B023
        assert rig.x() == place(newest - newest % PERIOD)
        assert len(rig.objects.placement.waiting) <= 180 // 20 + 1
    assert not rig.refused
    assert not rig.is_doubtful()


def test_a_transform_later_than_the_timeout_is_said_and_the_object_marked() -> None:
    rig = ObjectsRig(A1, object_timeout=0.5)
    run(rig, 10, lambda now: now)
    assert rig.x() == place(rig.now)
    run(rig, 50, lambda now: now - SECOND)
    assert rig.is_doubtful()
    assert rig.refused[LATE] == 50 - 10 - 1, "each once it has waited for more than 0.2 s"
    assert rig.objects.table.has(STALE, rig.slots[0]), "counted from the last state placed"
    run(rig, 50, lambda now: now - SECOND)
    assert rig.x() == place(rig.now - SECOND), "it follows as late as its transform"
    assert [reason.code for reason in rig.known().reasons] == ["late_frame"]
    run(rig, 1, lambda now: now)
    assert not rig.is_doubtful()
    assert rig.x() == place(rig.now)


@each("by_stamp", [True, False])
@each("locked", [True, False])
@each("shift", [0, -100 * SECOND, 100 * SECOND])
def test_what_the_latest_transform_places_is_as_old_as_that(
    by_stamp: bool, locked: bool, shift: int
) -> None:
    """Sent once what is locked to its frame, again and again what has no stamp."""
    rig = ObjectsRig(A1)
    objects, frames = rig.objects, rig.frames
    objects.staleness.limits = AgeLimits(0.5)
    objects.states.by_stamp = objects.placement.latest.by_stamp = by_stamp

    def run(seconds: float, is_live: bool) -> bool:
        for _ in range(round(10 * seconds)):
            rig.now += SECOND // 10
            if is_live:
                ahead = 0 if by_stamp else 1000 * SECOND  # as the clock of the sender
                frames.spans["robot"] = 0, rig.now + ahead
            if not (locked and objects.table.locked.any()):
                rig.send(0, "robot")
                if locked:
                    objects.states.lock(rig.slots)
            rig.cycle()
        return bool(objects.table.has(STALE, rig.slots[0]))

    assert not run(2.0, is_live=True)
    assert not run(0.5, is_live=False)
    rig.now += shift
    objects.clock_jumped(shift)
    assert run(0.1, is_live=False)
    assert not run(0.1, is_live=True)
    del frames.spans["robot"]
    frames.known["robot"] = pose(0.0)
    assert not run(2.0, is_live=False), "static"


@settings(max_examples=8)
@given(st.integers(300, 9000), st.integers(1, 50), st.integers(0, 2**32))
def test_few_states_wait_for_a_transform_and_all_follow(lag: int, every: int, seed: int) -> None:
    """lag: in ms; every: of so many cycles one has a state of the first object."""
    rig, rng = ObjectsRig(A1, A2), np.random.default_rng(seed)
    behind, limit = lag * MILLISECOND, round(rig.objects.placement.timeout * SECOND)
    span = 2 * placement.LONGEST_LAG // placement.MOST_LATE  # one state of each is kept at least
    for step in range((lag + 2000) // 20):
        rig.now += PERIOD
        for row in np.flatnonzero((step % every == 0, rng.random() < 0.5)).tolist():
            rig.send(rig.now, "robot", row)
        rig.frames.spans["robot"] = START - SECOND, rig.now - behind
        rig.cycle()
        waiting = rig.objects.placement.waiting.rows
        late = waiting[rig.now - waiting["received"] > limit]
        assert np.bincount(late["slot"], minlength=1).max() <= placement.MOST_LATE
        if rig.now - START > behind + SECOND:
            furthest = place(rig.now - behind)
            assert furthest - (span + every * PERIOD) / SECOND <= rig.x() <= furthest


@each("objects", [1, 100, 1000, 15_000])
def test_states_that_are_late_are_few_of_each_object_and_of_all(objects: int) -> None:
    rng = np.random.default_rng(objects)
    slots = rng.integers(0, objects, 60_000)
    received = START + np.sort(rng.integers(0, placement.LONGEST_LAG, len(slots)))
    kept = placement.spaced(slots, received)
    counts = np.bincount(slots[kept], minlength=objects)
    assert counts.max() <= placement.MOST_LATE
    assert kept.sum() <= max(placement.MAX_LATE, 2 * objects)
    oldest = np.unique(slots, return_index=True)[1]
    assert kept[oldest].all(), "they reach back as far as before"
    assert placement.spaced(slots[kept], received[kept]).all(), "and stay"


@each("topic", POSES)
def test_late_refusals_are_counted_on_the_topic_by_which_the_state_came(topic: str) -> None:
    rig = ObjectsRig(A1, A2)
    rig.send(START + 1, "robot", 0, topic)
    rig.send(START + 1, "nowhere", 1, topic)
    rig.frames.spans["robot"] = START + 5, START + 10
    rig.now += SECOND
    rig.cycle()
    assert rig.refused == {(topic, "extrapolation"): 1, (topic, "unknown frame"): 1}


def test_many_stamps_of_a_late_frame_take_few_look_ups() -> None:
    rig = ObjectsRig(*(("a", number) for number in range(100)))
    rig.frames.spans["robot"] = START, START + 40
    for row in range(100):
        rig.send(START + 1 + row, "robot", row)
    rig.cycle()
    late = [stamp for _, stamp in rig.frames.asked if stamp > START + 40]
    assert len(late) < 20
    placed = ~rig.objects.table.has(UNPLACED, rig.slots)
    assert placed.tolist() == [row < 40 for row in range(100)]


def test_a_transform_or_a_place_that_is_no_number_is_refused() -> None:
    rig = ObjectsRig(A1)
    rig.frames.lookup = lambda frame, stamp: (np.zeros(7), stamp)  # type: ignore[method-assign]
    rig.send(START + 1, "robot")
    rig.now += SECOND
    rig.cycle()
    assert rig.refused == {("object_states", "bad transform"): 1}
    huge = np.array([-1e300, 0, 0, 0, 0, 0, 1.0])
    rig.frames.lookup = lambda frame, stamp: (huge, stamp)  # type: ignore[method-assign]
    far = np.array([[-1e300, 0, 0, 0, 0, 0, 1.0]])
    rig.objects.states.store(rig.slots, far, State("robot", START + 2, rig.now, "object_states"))
    rig.now += SECOND
    rig.cycle()
    assert rig.refused["object_states", "bad pose"] == 1
    assert not rig.errors


def test_frames_that_fail_otherwise_are_internal_errors_and_the_rest_goes_on() -> None:
    rig = ObjectsRig(A1, A2)

    rig.frames.lookup = Mock(side_effect=ZeroDivisionError)  # type: ignore[method-assign]
    rig.send(START + 1, "robot", 0)
    rig.send(START + 1, "", 1)
    rig.now += SECOND
    rig.cycle()
    assert rig.x(1) == place(START + 1)
    assert rig.refused == {("object_states", "internal error"): 1}
    assert len(rig.errors) == 1


def test_states_that_wait_are_bounded_and_reach_back_as_far_as_before() -> None:
    waiting = placement.WaitingStates(most=1000)
    for number in range(5000):
        states = np.zeros(3, placement.STATE)
        states["slot"], states["number"] = range(3), number
        waiting.add(states)
        assert len(waiting) <= 1000
    rows = waiting.rows
    for slot in range(3):
        numbers = np.sort(rows["number"][rows["slot"] == slot])
        assert numbers[-1] == 4999
        assert numbers[0] < 1000
        assert len(numbers) > 100


def test_clouds_wait_for_their_transforms_one_behind_the_other() -> None:
    frames = FakeFrames()
    with Rig(frames, transform_timeout=30.0) as rig:
        rig.send(cube(A1))
        rig.next("points_inside")
        frames.spans["lidar"] = 0, rig.stamp
        stamps: list[int] = []
        obstacles = rig.node.obstacles
        for x in (0.0, 0.4, 9.0):
            rig.send_points([[x, 0, 0]], "lidar")
            stamps.append(rig.stamp)
            rig.until(lambda: len(obstacles.waiting.clouds) == len(stamps), "taken in")
        frames.spans["lidar"] = 0, stamps[1]
        rig.until(lambda: obstacles.stamp == stamps[1], "the second of three")
        assert [cloud.stamp for cloud in obstacles.waiting.clouds] == stamps[2:]


def test_clouds_that_wait_are_bounded() -> None:
    with Rig(FakeFrames(), transform_timeout=30.0) as rig:
        obstacles = rig.node.obstacles
        rows = np.zeros(4, [(name, "<f4") for name in "xyz"])
        for number in range(100):
            header = Header(stamp=cv.stamp_to_ros(number + 1), frame_id="lidar")
            obstacles.queue(serialize_message(cloud_to_ros(rows, header)), rig.node.now())
        stamps = [cloud.stamp for cloud in obstacles.waiting.clouds]
        assert len(stamps) <= 16
        assert stamps == sorted(stamps)
        assert stamps[-1] == 100
        assert stamps[0] < 20, "they reach back"

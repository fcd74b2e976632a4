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

"""Transforms that come later than the states: the newest state that can be placed is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")
from each import each
from objects_rig import MILLISECOND, SECOND, START, KnownUntil, ObjectsRig, place
from rclpy.serialization import serialize_message
from rig import Rig, cube
from std_msgs.msg import Header

from obb_collision.node.messages.clouds import cloud_to_ros
from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.objects.conditions import STALE, UNPLACED
from obb_collision.node.objects.frames import EXTRAPOLATION
from obb_collision.node.objects.states import State
from obb_collision.node.objects.waiting import (
    LONGEST_LAG,
    MAX_LATE,
    MOST_LATE,
    STATE,
    WaitingStates,
    spaced,
)
from obb_collision.shapes import Box

PERIOD = 20 * MILLISECOND
"""Of the states, and of the cycles."""
A1, A2 = ("a", 1), ("a", 2)
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
def test_an_object_is_where_the_newest_state_with_a_transform_says(
    known: Callable[[int], int],
) -> None:
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


@settings(max_examples=15)
@given(st.integers(300, 9000), st.integers(1, 50), st.integers(0, 2**32))
def test_few_states_wait_for_a_transform_that_lags_and_the_object_follows(
    lag: int, every: int, seed: int
) -> None:
    """lag: in ms; every: of so many cycles one has a state of the first object."""
    rig, rng = ObjectsRig(A1, A2), np.random.default_rng(seed)
    placement, behind = rig.objects.placement, lag * MILLISECOND
    limit = round(placement.timeout * SECOND)
    span = 2 * LONGEST_LAG // MOST_LATE  # one state of each is kept at least
    for step in range((lag + 2000) // 20):
        rig.now += PERIOD
        for row in np.flatnonzero((step % every == 0, rng.random() < 0.5)).tolist():
            rig.send(rig.now, "robot", row)
        rig.frames.spans["robot"] = START - SECOND, rig.now - behind
        rig.cycle()
        waiting = placement.waiting.rows
        late = waiting[rig.now - waiting["received"] > limit]
        assert np.bincount(late["slot"], minlength=1).max() <= MOST_LATE
        if rig.now - START > behind + SECOND:
            furthest = place(rig.now - behind)
            assert furthest - (span + every * PERIOD) / SECOND <= rig.x() <= furthest


@each("objects", [1, 100, 1000, 15_000])
def test_states_that_are_late_are_few_of_each_object_and_of_all(objects: int) -> None:
    rng = np.random.default_rng(objects)
    slots = rng.integers(0, objects, 60_000)
    received = START + np.sort(rng.integers(0, LONGEST_LAG, len(slots)))
    kept = spaced(slots, received)
    counts = np.bincount(slots[kept], minlength=objects)
    assert counts.max() <= MOST_LATE
    assert kept.sum() <= max(MAX_LATE, 2 * objects)
    oldest = np.unique(slots, return_index=True)[1]
    assert kept[oldest].all(), "they reach back as far as before"
    assert spaced(slots[kept], received[kept]).all(), "and stay"


def test_the_age_counts_from_the_state_that_was_placed() -> None:
    rig = ObjectsRig(A1, object_timeout=0.1)
    run(rig, 50, lambda now: now - 150 * MILLISECOND)
    assert rig.objects.table.has(STALE, rig.slots[0]), "0.15 s old, though states come every 0.02 s"
    rig.limit(0.2)
    rig.cycle()
    assert not rig.objects.table.has(STALE, rig.slots[0])


def test_frames_of_one_message_wait_for_themselves_only() -> None:
    rig = ObjectsRig(A1, A2, ("a", 3))
    for _ in range(50):
        rig.now += PERIOD
        for row, frame in enumerate(("fast", "slow", "")):
            rig.send(rig.now, frame, row)
        rig.frames.spans = {
            "fast": (START, rig.now - 20 * MILLISECOND),
            "slow": (START, rig.now - 100 * MILLISECOND),
        }
        rig.cycle()
    assert [rig.x(row) for row in range(3)] == [
        place(rig.now - delay * MILLISECOND) for delay in (20, 100, 0)
    ]
    assert not rig.refused


def test_a_newer_state_in_another_frame_overtakes_what_waits() -> None:
    rig = ObjectsRig(A1)
    rig.send(START + 1, "robot")
    rig.send(START + 2)
    rig.cycle()
    assert rig.x() == place(START + 2)
    rig.frames.spans["robot"] = START, START + 10
    rig.cycle()
    assert rig.x() == place(START + 2), "the older one is not taken any more"
    assert len(rig.objects.placement.waiting) == 0


def test_a_state_that_needs_no_transform_is_not_lost_to_one_that_waits() -> None:
    rig = ObjectsRig(A1)
    rig.send(START + 1)
    rig.send(START + 2, "robot")
    rig.send(START + 3, "robot")
    rig.cycle()
    assert rig.x() == place(START + 1)
    assert not rig.objects.table.has(UNPLACED, rig.slots[0])
    rig.frames.spans["robot"] = START, START + 2
    rig.cycle()
    assert rig.x() == place(START + 2)


def test_what_waits_for_an_object_that_is_gone_moves_no_other_one() -> None:
    rig = ObjectsRig(A1)
    for stamp in (START + 1, START + 2):
        rig.send(stamp, "robot")
    rig.objects.shapes.remove(rig.slots[:1])
    rig.slots[0] = rig.objects.shapes.put(A2, Box([1.0, 1.0, 1.0]))
    rig.frames.spans["robot"] = START, START + 10
    rig.cycle()
    assert rig.objects.table.has(UNPLACED, rig.slots[0])
    assert len(rig.objects.placement.waiting) == 0


def test_a_timed_out_state_is_placed_when_its_frame_becomes_known_at_last() -> None:
    rig = ObjectsRig(A1)
    rig.send(START + 1, "late")
    rig.now += SECOND
    rig.cycle()
    assert rig.refused == {("object_states", "unknown frame"): 1}
    assert rig.objects.table.has(UNPLACED, rig.slots[0])
    rig.frames.spans["late"] = START, START + 10
    rig.now += SECOND
    rig.cycle()
    assert rig.x() == place(START + 1)
    assert not rig.is_doubtful()
    assert rig.refused.total() == 1, "counted once"


@each("topic", ["objects", "object_transform", "object_states", "object_poses"])
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
    rig.frames.lookup = lambda frame, stamp: np.zeros(7)  # type: ignore[method-assign]
    rig.send(START + 1, "robot")
    rig.now += SECOND
    rig.cycle()
    assert rig.refused == {("object_states", "bad transform"): 1}
    huge = np.array([-1e300, 0, 0, 0, 0, 0, 1.0])
    rig.frames.lookup = lambda frame, stamp: huge  # type: ignore[method-assign]
    far = np.array([[-1e300, 0, 0, 0, 0, 0, 1.0]])
    rig.objects.states.store(rig.slots, far, State("robot", START + 2, rig.now, "object_states"))
    rig.now += SECOND
    rig.cycle()
    assert rig.refused["object_states", "bad pose"] == 1
    assert not rig.errors


def test_frames_that_fail_otherwise_are_internal_errors_and_the_rest_goes_on() -> None:
    rig = ObjectsRig(A1, A2)

    def broken(frame: str, stamp: int) -> np.ndarray:
        raise ZeroDivisionError

    rig.frames.lookup = broken  # type: ignore[method-assign]
    rig.send(START + 1, "robot", 0)
    rig.send(START + 1, "", 1)
    rig.now += SECOND
    rig.cycle()
    assert rig.x(1) == place(START + 1)
    assert rig.refused == {("object_states", "internal error"): 1}
    assert len(rig.errors) == 1


def test_states_that_wait_are_bounded_and_reach_back_as_far_as_before() -> None:
    waiting = WaitingStates(most=1000)
    for number in range(5000):
        states = np.zeros(3, STATE)
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
    frames = KnownUntil()
    with Rig(frames, transform_timeout=30.0) as rig:
        rig.send(cube(A1))
        rig.listen("points_inside")
        rig.until(lambda: "points_inside" in rig.last, "points_inside")
        frames.spans["lidar"] = 0, rig.stamp
        stamps: list[int] = []
        obstacles = rig.obstacles
        for x in (0.0, 0.4, 9.0):
            rig.send_points([[x, 0, 0]], "lidar")
            stamps.append(rig.stamp)
            rig.until(
                lambda: [cloud.stamp for cloud in obstacles.waiting.clouds] == stamps, "taken in"
            )
        frames.spans["lidar"] = 0, stamps[1]
        rig.until(lambda: obstacles.stamp == stamps[1], "the second of three")
        assert [cloud.stamp for cloud in obstacles.waiting.clouds] == stamps[2:]


def test_clouds_that_wait_are_bounded() -> None:
    with Rig(KnownUntil(), transform_timeout=30.0) as rig:
        obstacles = rig.obstacles
        rows = np.zeros(4, [(name, "<f4") for name in "xyz"])
        for number in range(100):
            header = Header(stamp=stamp_to_ros(number + 1), frame_id="lidar")
            obstacles.take(serialize_message(cloud_to_ros(rows, header)))
        stamps = [cloud.stamp for cloud in obstacles.waiting.clouds]
        assert len(stamps) <= 16
        assert stamps == sorted(stamps)
        assert stamps[-1] == 100
        assert stamps[0] < 20, "they reach back"

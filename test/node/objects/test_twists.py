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

"""Twists of states, and quaternions far from unit length, by topics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("rclpy")
from each import each
from rig import FakeFrames, Rig, cube, pose

from obb_collision.node import namespace_number
from obb_collision.node.messages.conversions import pose_to_ros
from obb_collision.node.objects.conditions import STALE

A1, A2 = ("a", 1), ("a", 2)
NAN = float("nan")
FORWARD = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]


def twist(rig: Rig, name: str) -> list[float]:
    """Twist of an object in the scene."""
    scene = rig.node.objects.scene
    twists: list[float] = scene.objects.store.twists[scene.index(name)].tolist()
    return twists


def test_a_state_with_a_twist_sets_it_and_one_without_ends_it(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0)))
    rig.answer()
    rig.send_states(["a/1", "a/2"], [pose(0.0), pose(3.0)], twists=[FORWARD, [0.0] * 6])
    rig.answer()
    assert twist(rig, "a/1") == FORWARD
    assert twist(rig, "a/2") == [0.0] * 6
    rig.send_transform("a/1", pose(0.1))
    rig.answer()
    assert twist(rig, "a/1") == [0.0] * 6


@each("way", ["states", "poses", "marker"])
def test_any_other_state_ends_a_twist(rig: Rig, way: str) -> None:
    rig.send(cube(A1))
    rig.answer()
    rig.send_states(["a/1"], [pose(0.0)], twists=[FORWARD])
    rig.answer()
    if way == "states":
        rig.send_states(["a/1"], [pose(1.0)])
    elif way == "poses":
        rig.send_poses([1], [pose(1.0)])
    else:
        rig.send(cube(A1, (1.0, 0.0, 0.0)))
    rig.answer()
    assert twist(rig, "a/1") == [0.0] * 6


def test_twists_of_a_turned_frame_are_turned_with_it() -> None:
    frames = FakeFrames()
    turn = np.sqrt(0.5)
    frames.known["robot"] = [5.0, 0.0, 0.0, 0.0, 0.0, turn, turn]  # x of it is y of the map
    with Rig(frames) as rig:
        rig.send(cube(A1))
        rig.answer()
        rig.send_states(["a/1"], [pose(0.0)], "robot", twists=[FORWARD])
        rig.answer()
        assert twist(rig, "a/1") == pytest.approx([-2.0, 1.0, 3.0, -0.2, 0.1, 0.3])


@each("bad", [[NAN, 0, 0, 0, 0, 0], [0, 0, 0, 0, np.inf, 0], [2e300] + [0] * 5])
def test_a_twist_that_is_no_number_is_refused_alone_and_its_pose_is_used(
    rig: Rig, bad: list[float]
) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0)))
    rig.answer()
    rig.send_states(["a/1", "a/2"], [pose(2.5), pose(3.0)], twists=[bad, FORWARD])
    assert rig.pairs() == {("a/1", "a/2")}
    assert rig.refused("object_states") == {"bad twist": 1}
    assert twist(rig, "a/1") == [0.0] * 6
    assert twist(rig, "a/2") == FORWARD
    assert not rig.node.objects.table.doubtful.any()


def test_a_stale_object_is_not_taken_to_go_on() -> None:
    with Rig(object_timeout=0.3) as rig:
        rig.send(cube(A1))
        rig.answer()
        rig.send_states(["a/1"], [pose(0.0)], twists=[FORWARD])
        rig.answer()
        rig.until(lambda: rig.node.objects.table.has(STALE).any(), "stale")
        rig.cycles(2)
        assert twist(rig, "a/1") == [0.0] * 6


def test_twists_are_not_used_where_sweeps_are_off() -> None:
    with Rig(given={"effects.sweep": "off"}) as rig:
        rig.send(cube(A1))
        rig.answer()
        rig.send_states(["a/1"], [pose(1.0)], twists=[FORWARD])
        rig.answer()
        assert twist(rig, "a/1") == [0.0] * 6


REASON = "doubtful: quaternion far from unit length"
#: A quarter turn about z, twice as long as it should be: the bar then lies along y.
FAR = [0.0, 0.0, 2.0**0.5, 2.0**0.5]
PLACE = [0.0, 0.0, 0.0, *FAR]
COLLIDE = ({("bar/1", "post/1")}, {("post/1", "bar/1")})
SENDERS: dict[str, Callable[[Rig], None]] = {
    "objects": lambda rig: rig.send(
        cube(("bar", 1), size=(8.0, 0.5, 0.5), pose=pose_to_ros(PLACE))
    ),
    "object_transform": lambda rig: rig.send_transform("bar/1", PLACE),
    "object_states": lambda rig: rig.send_states(["bar/1", "post/1"], [PLACE, pose(0.0, 3.0)]),
    "object_poses": lambda rig: rig.send_poses([1], [PLACE], namespaces=[namespace_number("bar")]),
}


@each("topic", SENDERS)
def test_it_is_normalised_counted_and_told_once(
    topic: str, rig: Rig, capfd: pytest.CaptureFixture[str]
) -> None:
    rig.listen("/diagnostics")
    rig.send(cube(("bar", 1), size=(8.0, 0.5, 0.5)), cube(("post", 1), (0.0, 3.0, 0.0)))
    assert rig.pairs() == set()
    for count in (1, 2, 3):
        SENDERS[topic](rig)
        assert rig.pairs() in COLLIDE
        while rig.status(f"input {topic}").get(REASON) != str(count):
            pass  # the next report
    box = rig.node.objects.scene.obb("bar/1")
    np.testing.assert_allclose(box.rotation[:, 0], [0.0, 1.0, 0.0], atol=1e-15)
    assert not any(rig.refused(topic).values())
    told = [line for line in capfd.readouterr().err.splitlines() if "far from unit" in line]
    assert len(told) == 1
    assert f"{topic}: doubtful quaternion far from unit length: 1; last: bar/1" in told[0]


def test_one_that_is_near_is_taken_as_it_is(rig: Rig) -> None:
    rig.listen("/diagnostics")
    rig.send(cube(("bar", 1), size=(8.0, 0.5, 0.5)), cube(("post", 1), (0.0, 3.0, 0.0)))
    rig.send_transform("bar/1", [0.0, 0.0, 0.0, 0.0, 0.0, 0.7, 0.7])
    assert rig.pairs() in COLLIDE
    assert REASON not in rig.status("input object_transform")

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

"""What is stale, and the policy ``collide``: boxes grow by what objects can have moved."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
from each import each
from objects_rig import SECOND, START, ObjectsRig
from rig import Rig, color, cube
from scipy.spatial.transform import Rotation

from obb_collision.node.diagnostics.answer import COLLIDING, FREE
from obb_collision.node.diagnostics.answer import UNKNOWN as NOT_KNOWN
from obb_collision.node.messages.box_markers import COLORS, DOUBTFUL
from obb_collision.node.objects.conditions import STALE
from obb_collision.node.objects.states import AgeLimits, State
from obb_collision.node.objects.table import COLLIDE, IGNORE, KEEP, UNKNOWN
from obb_collision.scene.store import Overrides
from obb_collision.shapes import Box, Mesh, Sphere
from obb_collision.typing import Floats

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
SPEED, REACH = 2.0, 3.0


def lost_sight(policy: str = COLLIDE, x: float = 4.0) -> ObjectsRig:
    """Return a cube at the origin whose sender stops, and one at ``x`` whose sender goes on."""
    rig = ObjectsRig(A1, A2)
    rig.limit(0.5, policy, speed=SPEED, reach=REACH)
    send(rig, 0, 0.0)
    rig.beside = x  # type: ignore[attr-defined]
    step(rig, 0.0)
    return rig


def send(rig: ObjectsRig, row: int, x: float, stamp: int = 0, twist: Floats | float = 0.0) -> None:
    poses = np.array([[x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    rig.objects.states.store(rig.slots[[row]], poses, State("", stamp, rig.now), twist)


def step(rig: ObjectsRig, seconds: float) -> None:
    """Run a cycle after some time; the second cube gets a new state."""
    rig.now += round(seconds * SECOND)
    send(rig, 1, rig.beside)  # type: ignore[attr-defined]
    rig.cycle()


def pairs(rig: ObjectsRig) -> int:
    return len(rig.objects.scene.check())


def half_extents(rig: ObjectsRig, row: int = 0) -> Floats:
    extents: Floats = rig.objects.scene.obb(f"a/{row + 1}").half_extents
    return extents


def test_a_stale_box_collides_with_all_that_it_can_have_reached() -> None:
    rig = lost_sight(x=4.0)
    step(rig, 0.5)
    assert half_extents(rig).tolist() == [0.5] * 3, "not stale yet"
    step(rig, 0.5)
    assert half_extents(rig) == pytest.approx(0.5 + SPEED * 1.0)
    assert (pairs(rig), rig.known().level) == (0, FREE)
    step(rig, 0.49)
    assert pairs(rig) == 0, "0.02 m apart"
    step(rig, 0.02)
    assert rig.known().level == COLLIDING
    assert rig.known().message == "1 pair collides; stale: a/1", "it may be beyond its growth"
    assert rig.is_doubtful()
    assert half_extents(rig, 1).tolist() == [0.5] * 3, "whose sender goes on"


@each("policy, found", [(UNKNOWN, 0), (KEEP, 0), (IGNORE, 0), (COLLIDE, 1)])
def test_only_this_policy_grows_boxes(policy: str, found: int) -> None:
    rig = lost_sight(policy, x=1.5)
    step(rig, 1.0)
    assert pairs(rig) == found
    assert rig.known().level == {UNKNOWN: NOT_KNOWN, COLLIDE: COLLIDING}.get(policy, FREE)
    rig.limit(0.5, KEEP, speed=SPEED, reach=REACH)
    step(rig, 0.01)
    assert (pairs(rig), half_extents(rig).tolist()) == (0, [0.5] * 3)


def test_the_growth_is_bounded_and_then_it_is_not_known_what_collides() -> None:
    rig = lost_sight(x=100.0)
    step(rig, 1.5)
    assert rig.known().level == FREE
    step(rig, 0.01)
    assert half_extents(rig).tolist() == [0.5 + REACH] * 3
    found = rig.known()
    assert (found.level, found.flag(True)) == (NOT_KNOWN, True)
    assert found.message == "stale: a/1"
    send(rig, 0, 0.0)
    step(rig, 0.01)
    assert rig.known().message == "free"


def test_the_age_is_that_of_the_stamp_where_that_is_older() -> None:
    for stamp, age in ((START - SECOND // 4, 1.25), (START + SECOND // 4, 1.0), (0, 1.0)):
        rig = lost_sight()
        send(rig, 0, 0.0, stamp)
        rig.cycle()
        step(rig, 1.0)
        assert half_extents(rig) == pytest.approx(0.5 + SPEED * age)


@each("waits", [False, True])
def test_a_faster_twist_counts_also_while_its_state_waits(waits: bool) -> None:
    rig = lost_sight()
    twist = np.array([[0.0, 2.5, 0.0, 0.0, 0.0, 0.0]])
    send(rig, 0, 0.0, twist=twist)
    rig.cycle()
    if waits:  # for a frame that nobody publishes
        poses = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
        state = State("nowhere", 0, rig.now)
        rig.objects.states.store(rig.slots[:1], poses, state, 1.1 * twist)
    step(rig, 1.0)
    assert half_extents(rig) == pytest.approx(0.5 + (2.75 if waits else 2.5))


def test_a_grown_box_contains_the_object_however_it_moved_and_turned() -> None:
    rng = np.random.default_rng(11)
    for _ in range(200):
        size, age = rng.uniform(0.1, 3.0, 3), rng.uniform(0.6, 2.0)
        rig = ObjectsRig()
        rig.limit(0.5, COLLIDE, reach=1e6)
        points = rng.uniform(-0.5, 0.5, (30, 3)) * size + rng.uniform(-1.0, 1.0, 3)
        faces = rng.integers(0, 30, (20, 3))
        rig.slots = np.array([rig.objects.shapes.put(A1, Mesh(points, faces))])
        start = np.append(rng.uniform(-5.0, 5.0, 3), Rotation.random(None, rng).as_quat())
        twist = rng.uniform(-2.0, 2.0, 6)
        rig.objects.states.store(rig.slots, start[None], State("", 0, rig.now), twist[None])
        rig.cycle()
        rig.now += round(age * SECOND)
        rig.cycle()
        turn = Rotation.from_rotvec(twist[3:] * age) * Rotation.from_quat(start[3:])
        moved = turn.apply(points) + start[:3] + twist[:3] * age
        assert np.all(rig.objects.scene.obb("a/1").contains(moved))


def test_a_removed_object_leaves_no_growth_to_the_next_one() -> None:
    rig = lost_sight()
    step(rig, 1.5)
    assert half_extents(rig)[0] > 3.0
    rig.objects.shapes.remove(rig.slots[:1])
    rig.slots[0] = rig.objects.shapes.put(A1, Box([1.0, 1.0, 1.0]))
    send(rig, 0, 0.0)
    assert half_extents(rig).tolist() == [0.5] * 3
    step(rig, 0.01)
    assert half_extents(rig).tolist() == [0.5] * 3


def test_a_new_shape_and_padding_keep_the_growth() -> None:
    rig = lost_sight()
    step(rig, 1.0)
    rig.objects.scene.padding = 0.25
    assert half_extents(rig) == pytest.approx(0.75 + SPEED)
    rig.objects.shapes.put(A1, Box([2.0, 2.0, 2.0]))
    assert half_extents(rig) == pytest.approx(1.25 + SPEED)
    send(rig, 0, 0.0)
    step(rig, 0.01)
    assert half_extents(rig).tolist() == [1.25] * 3


def test_what_is_sent_once_does_not_age_and_each_object_has_its_own_limit() -> None:
    rig = ObjectsRig(A1, A2, B1)
    rig.objects.staleness.limits = AgeLimits(
        0.5, Overrides([("a/2", 2.0)]), policies=Overrides([("b/*", IGNORE)])
    )
    for _ in range(2):
        for row in (0, 1, 2) if rig.now == START else (1, 2):
            send(rig, row, 3.0 * row)
        rig.cycle()
        rig.now += SECOND // 10
    rig.now += SECOND
    rig.cycle()
    assert rig.objects.table.has(STALE, rig.slots).tolist() == [False, False, True]
    assert rig.known().message == "free; 1 stale (accepted): b/1"
    rig.now += SECOND
    rig.cycle()
    assert (rig.known().reasons[0].code, rig.known().reasons[0].who) == ("stale", ("a/2",))


@each("accuracy", ["sphere", "aabb", "hull", "mesh"])
def test_every_accuracy_respects_the_growth(accuracy: str) -> None:
    rig = ObjectsRig(A1, A2)
    rig.limit(0.5, COLLIDE, speed=SPEED, reach=10.0)
    rig.beside = 3.0  # type: ignore[attr-defined]
    corners = np.array([[0.0, 0, 0], [0.4, 0, 0], [0, 0.4, 0], [0, 0, 0.4]])
    tetrahedron = Mesh(corners, np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]))
    for key, shape in ((A1, tetrahedron), (A2, Sphere(0.2))):
        rig.objects.shapes.put(key, shape)
    rig.objects.scene.accuracy = accuracy
    send(rig, 0, 0.0)
    step(rig, 0.0)
    assert pairs(rig) == 0
    step(rig, 1.5)
    assert pairs(rig) == 1


def test_markers_show_the_grown_box_in_grey() -> None:
    limits: dict[str, Any] = {"object_timeout_overrides": ["*: 0.3"], "stale_policy": "collide"}
    with Rig(stale_speed=0.5, **limits) as rig:
        rig.listen("obb_collision/markers")
        rig.send(cube(A1), cube(B1, (0.0, 5.0, 0.0)), stamped=False)

        def shown() -> bool:
            rig.send(cube(B1, (0.0, 5.0, 0.0)), stamped=False)
            message = rig.last.get("obb_collision/markers")
            found = {} if message is None else {m.ns: m for m in message.markers}
            if not {"a", "b"} <= found.keys() or found["a"].scale.x < 1.5:
                return False
            assert color(found["a"]) == COLORS[DOUBTFUL]
            assert found["b"].scale.x == 1.0
            return True

        rig.until(shown, "a grown marker")

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

"""Lists of cubes, spheres and points over real topics: each element is an object."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from each import each
from geometry_msgs.msg import Point
from rig import Rig, cube, pose, sync
from robot_rig import RobotRig
from scipy.spatial.transform import Rotation
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

import obb_collision as oc
from obb_collision.node.diagnostics.answer import COLLIDING, FREE, UNKNOWN
from obb_collision.node.messages.conversions import duration_to_ros, pose_to_ros

LIST = ("walls", 7)
NAME = "walls/7"
ROW = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (4.0, 0.0, 0.0)]


def listed(
    points: Any, size: Any = (1.0, 1.0, 1.0), kind: int = Marker.CUBE_LIST, **fields: Any
) -> Marker:
    """Return a marker of a list."""
    given = {"type": kind, "points": [Point(x=x, y=y, z=z) for x, y, z in np.asarray(points)]}
    return cube(LIST, size=size, **{**given, **fields})


def between(*x: float) -> list[Marker]:
    """Return small cubes b/0, b/1, ... at places on the x axis."""
    return [cube(("b", n), (at, 0, 0), (0.1, 0.1, 0.1)) for n, at in enumerate(x)]


def met(rig: Any) -> set[tuple[str, str]]:
    """Return the pairs of elements and others, the number of the element first."""
    pairs = [sorted(pair, key=lambda name: "#" not in name) for pair in rig.pairs()]
    assert all(first.startswith(f"{NAME}#/") for first, _ in pairs)
    return {(first.removeprefix(f"{NAME}#/"), second) for first, second in pairs}


@each("kind", [Marker.CUBE_LIST, Marker.SPHERE_LIST, Marker.POINTS])
def test_what_collides_is_what_collides_with_each_element(kind: int) -> None:
    rng = np.random.default_rng(kind)
    size = [0.4, 0.3, 0.2] if kind == Marker.CUBE_LIST else [0.4, 0.4, 0.4]
    points, probes = rng.uniform(-1, 1, (60, 3)), rng.uniform(-1, 1, (60, 3))
    turn = Rotation.random(rng=1)
    place = np.array([0.3, -0.2, 0.1])
    want = set()
    for k, center in enumerate(turn.apply(points) + place):
        element = oc.OBB(center, turn.as_matrix(), 0.5 * np.array(size))
        for n, probe in enumerate(probes):
            apart = np.maximum(np.abs(center - probe) - 0.15, 0.0)
            meets = element.intersects(oc.OBB(probe, np.eye(3), [0.15] * 3))
            if kind != Marker.CUBE_LIST:
                meets = bool(np.linalg.norm(apart) <= 0.2)
            if meets:
                want.add((str(k), f"b/{n}"))
    assert len(want) > 20
    with Rig(accuracy="hull", check_only_pairs=["walls/7 *"]) as rig:
        at = pose_to_ros([*place, *turn.as_quat()])
        scale = [0.4, 0.1, 0.0] if kind == Marker.POINTS else size
        rig.send(listed(points, scale, kind, pose=at))
        rig.send(*(cube(("b", n), at, [0.3] * 3) for n, at in enumerate(probes)))
        assert met(rig) == want


@pytest.fixture
def walls() -> Iterator[Rig]:
    """Yield a rig with three cubes of a list, and one small cube in each and between them."""
    with Rig() as made:
        made.send(listed(ROW), *between(0.0, 1.0, 2.0, 3.0, 4.0))
        assert met(made) == {("0", "b/0"), ("1", "b/2"), ("2", "b/4")}
        yield made


def test_a_list_is_replaced_and_deleted_as_one(walls: Rig) -> None:
    walls.send(listed(ROW[1:], pose=pose_to_ros(pose(-1.0))))
    assert met(walls) == {("0", "b/1"), ("1", "b/3")}
    walls.send(cube(LIST, (2, 0, 0), (0.5, 0.5, 0.5)))
    assert walls.pairs() == {(NAME, "b/2")}
    walls.send(listed(ROW[:2]))
    assert met(walls) == {("0", "b/0"), ("1", "b/2")}
    walls.send(cube(LIST, action=Marker.DELETE))
    assert sync(walls) == set()
    walls.send(listed(ROW), listed(ROW[:1]), cube(LIST, action=Marker.DELETE), listed(ROW[1:2]))
    assert met(walls) == {("0", "b/2")}
    walls.send(cube(("walls", 8), (4, 0, 0)), cube(("walls", 0), action=Marker.DELETEALL))
    assert sync(walls) == set()
    walls.send(listed(ROW), cube(("b", 0), action=Marker.DELETEALL), *between(2.0))
    assert met(walls) == {("1", "b/0")}
    walls.send(cube(("", 0), action=Marker.DELETEALL), listed(ROW[:1]), *between(0.0, 2.0))
    assert met(walls) == {("0", "b/0")}
    assert len(walls.node.objects.table) == 3
    walls.call(Trigger, "obb_collision/clear", Trigger.Request())
    walls.send(listed(ROW), *between(4.0))
    assert met(walls) == {("2", "b/0")}
    assert walls.refused("objects") == {}


def test_a_list_ends_with_its_lifetime(walls: Rig) -> None:
    walls.send(listed(ROW, lifetime=duration_to_ros(0.2)))
    walls.until(lambda: len(walls.node.objects.table) == 5)
    walls.send(listed(ROW[:1]))
    assert met(walls) == {("0", "b/0")}


def test_an_older_list_is_not_used(walls: Rig) -> None:
    late, later = listed(ROW[:1]), cube(LIST, (1, 0, 0))
    late.header.stamp = later.header.stamp = walls.header().stamp
    walls.send(listed(ROW[1:]))
    assert met(walls) == {("0", "b/2"), ("1", "b/4")}
    walls.send(late, later, stamped=False)
    walls.until(lambda: walls.refused("objects") == {"older stamp": 2})
    walls.send(cube(("c", 0), (9, 0, 0)))
    assert met(walls) == {("0", "b/2"), ("1", "b/4")}


@each(
    "fields, reason",
    [
        ({"points": []}, "no points"),
        ({"points": [Point(x=float("nan"))]}, "bad points"),
        ({"pose": pose_to_ros(pose(np.nan))}, "bad pose"),
        ({"size": (1, 0, 1)}, "bad scale"),
        ({"ns": "x" * 254}, "bad name"),
        ({"points": [Point()] * 41}, "too many objects"),
    ],
)
def test_a_bad_list_is_refused_and_named_until_a_good_one_comes(
    fields: dict[str, Any], reason: str
) -> None:
    with Rig(max_objects=40) as rig:
        rig.send(listed(ROW), *between(1.0)).known()
        size = fields.pop("size", (1, 1, 1))
        bad = listed(ROW, size)
        for field, value in fields.items():
            setattr(bad, field, value)
        rig.send(bad)
        rig.until(lambda: rig.refused("objects") == {reason: 1})
        rig.says(UNKNOWN, "refused")
        name = {"ns": bad.ns, "id": 7}
        rig.send(listed(ROW[:2], ns="walls"), Marker(action=Marker.DELETE, **name))
        rig.says(FREE)


def test_lists_that_came_together_are_limited() -> None:
    with Rig(max_objects=40) as rig:
        lists = [listed(np.full((15, 3), 9.0 * n), id=n) for n in range(4)]
        rig.send(*lists)
        rig.until(lambda: rig.refused("objects") == {"too many objects": 2})
        rig.says(UNKNOWN, "refused")
        assert len(rig.node.objects.table) == 30


def test_rules_about_a_list_hold_for_its_elements() -> None:
    rules: dict[str, Any] = {
        "allowed_pairs": ["walls/7 b/0"],
        "accuracy_overrides": ["walls/7: hull"],
        "required_objects": ["walls/7"],
    }
    with Rig(**rules) as rig:
        rig.send(*between(0.0, 2.0, 3.0))
        rig.says(UNKNOWN, "required_missing")
        touching = [(0.0, 0, 0), (1.0, 0, 0), (2.0, 0, 0)]
        rig.send(listed(touching, kind=Marker.SPHERE_LIST), cube(("walls", 8), (1, 1.2, 0)))
        assert met(rig) == {("2", "b/1")}
        rig.send(cube(("walls", 8), (1, 0.75, 0)))
        assert met(rig) == {("2", "b/1"), *((str(k), "walls/8") for k in range(3))}
        rig.set(allowed_within=["walls"], allowed_pairs=["walls/? b/*"])
        rig.send(cube(("walls", 8), (1, 0.5, 0)))
        assert rig.pairs() == set()


def test_states_of_a_list_are_of_an_unknown_object(walls: Rig) -> None:
    walls.send_states([NAME], [pose(9.0)])
    walls.says(COLLIDING, "unknown_objects")
    walls.send_states([f"{NAME}#/1"], [pose(1.0)])
    assert met(walls) == {("0", "b/0"), ("1", "b/1"), ("2", "b/4")}


def test_what_a_robot_carries_may_be_a_list() -> None:
    with RobotRig() as rig:
        rig.start_robot(turn=0.0)
        held = listed([(0.7, 0, 0), (2.5, 0, 0)], (0.3, 0.1, 0.1), frame_locked=True)
        held.header.frame_id = "arm/hand"
        rig.send(held)
        rig.until(lambda: len(rig.robot.attached.slots) == 2)
        places = {k: rig.pose_of((f"{NAME}#", k))[:3] for k in range(2)}
        rig.put(places[1], (0.1, 0.1, 0.1))
        assert met(rig) == {("1", "crate/1")}
        rig.move(turn=1.0)
        assert rig.pairs() == set(), "the first touches its link only"
        assert np.linalg.norm(rig.pose_of((f"{NAME}#", 1))[:3] - places[1]) > 0.5


def test_many_elements_come_in_one_message() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(22.0)] * 3), axis=-1).reshape(-1, 3)[:10_000]
    with Rig() as rig:
        rig.send(listed(0.2 * grid, (0.2, 0.2, 0.2)), *between(0.0, 5.0))
        assert met(rig) == {("0", "b/0")}
        assert len(rig.node.objects.table) == 10_002
        rig.send(listed(0.2 * grid + 0.5, (0.2, 0.2, 0.2)))
        assert rig.pairs() == set()

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

"""The arm in its cell, through the real node: links collide when an independent check says so."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import pytest

import obb_collision as oc
from obb_collision.scene_files import find_scene, load_scene

rclpy_context = pytest.importorskip("rclpy.context")

from obb_collision.demo.run import Demo  # noqa: E402
from obb_collision.demo.scene import DemoScene  # noqa: E402
from obb_collision.demo.snapshot import OVERLAPPING, ROBOT  # noqa: E402
from obb_collision.node import NamedClearance  # noqa: E402

DOMAIN = 100 + os.getpid() % 40


@pytest.fixture(scope="module")
def demo() -> Iterator[Demo]:
    """Yield the demo of the cell, started."""
    context = rclpy_context.Context()
    context.init(domain_id=DOMAIN)
    file = find_scene("arm_cell")
    demo = Demo(context, DemoScene(load_scene(file), file), 30.0, 1.0, lambda _: None)
    try:
        demo.begin()
        yield demo
    finally:
        demo.close()
        context.try_shutdown()


def test_links_collide_by_name_when_the_robot_scene_says_so(demo: Demo) -> None:
    (arm,) = demo.scene.robots
    checker = oc.RobotScene({"arm": arm.robot}, demo.scene.description.build(), bases=[arm.pose])
    seen = set()
    for time in (0.5, 5.0, 9.6, 10.0, 12.0):
        demo.settle(time)
        rows = demo.listener.pairs.rows
        found = {frozenset((_link(row.a), _link(row.b))) for row in rows}
        report = checker.check(arm.joints(time)[0], all_pairs=True)
        wanted = set() if report.valid[0] else {frozenset(pair) for pair in report.pairs_of(0)}
        assert found == wanted
        seen |= found
    assert frozenset(("arm/hand", "shelf/3")) in seen
    assert frozenset(("arm/right_finger", "shelf/3")) in seen


def _link(name: str) -> str:
    """Return the link of an object of the arm, and any other name as it is."""
    return name.rpartition("/")[0] if name.startswith("arm/") else name


def test_colliding_links_are_red_and_near_ones_have_lines(demo: Demo) -> None:
    demo.settle(10.0)
    snapshot = demo.snapshot()
    states = dict(zip(snapshot.names, snapshot.states.tolist(), strict=True))
    red = {name for name, state in states.items() if state == OVERLAPPING}
    assert red == {"arm/hand/1", "arm/right_finger/0", "shelf/3"}
    assert states["arm/forearm/1"] == ROBOT
    assert len(snapshot.near) == len(demo.listener.effects["clearance"].rows) > 0
    near = {row.b if row.b.startswith("arm/") else row.a for row in _clearances(demo)}
    assert near <= {"arm/hand/0", "arm/hand/1", "arm/left_finger/0", "arm/right_finger/0"}


def _clearances(demo: Demo) -> list[NamedClearance]:
    return list(demo.listener.effects["clearance"].rows)


def test_bodies_of_links_are_drawn_where_the_robot_has_them(demo: Demo) -> None:
    demo.settle(5.0)
    (arm,) = demo.scene.robots
    bodies = {body.name: body for body in demo.snapshot().bodies()}
    poses = arm.robot.link_poses(arm.joints(5.0)[0])
    row = arm.robot.link_names.index("right_finger")
    wanted = poses[row, :3] + np.array(arm.pose[:3])  # the base is not turned
    np.testing.assert_allclose(bodies["arm/right_finger/0"].position, wanted, atol=1e-6)

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

"""A quaternion far from unit length is normalised, counted and told: by any topic."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("rclpy")
from each import each
from rig import Rig, cube, pose

from obb_collision.node import namespace_number
from obb_collision.node.messages.conversions import pose_to_ros

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

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

"""A node with a region: what it publishes then, and which parameters it refuses."""

from __future__ import annotations

import math
from typing import Any

import pytest

pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from rig import LATCHED, NAMESPACE, Rig, cube, sync
from sensor_msgs.msg import PointCloud2

from obb_collision.node import named_events
from obb_collision.node.merger import MergerNode, values_of
from obb_collision.node.node import CollisionNode
from obb_collision.node.objects.frames import FixedFrameOnly
from obb_collision.node.parameters.entries import range_from_text, text_from_region
from obb_collision.regions import Region


def test_only_pairs_of_the_region_are_published_and_only_what_is_near_is_drawn() -> None:
    with Rig(region=["x: -inf to 5.0"]) as rig:
        rig.listen("obb_collision/markers", "/diagnostics", "collision_status")
        rig.send(*(cube(("a", n), (x, 0, 0)) for n, x in enumerate((0.0, 0.5, 5.75, 6.0, 50.0))))
        assert rig.pairs() == {("a/0", "a/1")}
        assert rig.status(": objects")["near the region"] == "4"
        assert rig.status(": objects")["region"] == "x: -inf to 5.0"
        drawn = rig.next("obb_collision/markers").markers
        assert {marker.id for marker in drawn if marker.ns == "a"} == {0, 1, 2, 3}
        assert rig.set(region=["x: 5.0 to inf"])[0].successful
        assert sync(rig) == {("a/2", "a/3")}
        rig.send(cube(("a", 2), (5.25, 0, 0)), cube(("a", 3), (5.0, 0, 0)))
        assert rig.pairs() == set()  # their common part begins at 4.75
        assert rig.set(region=[""])[0].successful
        assert sync(rig) == {("a/0", "a/1"), ("a/2", "a/3")}


def test_what_cannot_be_joined_without_stamps_is_said(capfd: pytest.CaptureFixture[str]) -> None:
    with Rig(region=["x: -inf to 5.0"]) as rig:
        regions = [NAMESPACE, f"{NAMESPACE}/east"]
        east = CollisionNode(
            context=rig.context,
            namespace=regions[1],
            frames=FixedFrameOnly("map"),
            cli_args=["--ros-args", "-r", f"objects:={NAMESPACE}/objects"],
            parameter_overrides=[Parameter("region", value=["x: 5.0 to inf"])],
        )
        merger = MergerNode(
            context=rig.context,
            namespace=f"{NAMESPACE}/merged",
            parameter_overrides=[Parameter("regions", value=regions)],
        )
        rig.executor.add_node(east)
        rig.executor.add_node(merger)
        joined: list[Any] = []
        said: list[Any] = []
        listen = rig.client.create_subscription
        listen(PointCloud2, "merged/collisions", joined.append, 10)
        listen(DiagnosticArray, "merged/collision_status", said.append, LATCHED)

        def status() -> dict[str, str]:
            return values_of(said[-1].status[0]) if said else {}

        pair = cube(("a", 0)), cube(("a", 1), (0.5, 0, 0))
        rig.until(lambda: rig.pubs["objects"].get_subscription_count() == 2, "both nodes")
        rig.send(*pair, stamped=False)
        rig.until(lambda: status().get("who") == ", ".join(regions), "both are named")
        assert status()["reason"] == "region_unmatched"
        assert len(east.objects.table) == 2
        assert not joined
        assert "no object of theirs has a stamp" in capfd.readouterr().err
        rig.send(*pair)
        rig.until(lambda: joined and not status()["reasons"], "the answers together")
        assert joined[-1].width == 1
        east.destroy_node()
        merger.destroy_node()


def test_a_collision_that_moves_to_another_region_is_not_checked_any_more() -> None:
    with Rig(region=["x: -inf to 5.0"], given={"effects.events": "on"}) as rig:
        rig.listen("events")
        rig.send(cube(("a", 0)), cube(("a", 1), (0.5, 0, 0)))
        rig.until(lambda: "events" in rig.last and rig.last["events"].width, "the begin")
        rig.last.pop("events")
        rig.send(cube(("a", 0), (9, 0, 0)), cube(("a", 1), (9.5, 0, 0)))

        def ended() -> list[str]:
            message = rig.last.get("events")
            rows = [] if message is None else named_events(message, ["a"])
            return [row.reason for row in rows if row.event == "end"]

        assert rig.until(ended, "the end") == ["not checked"]


def test_a_halo_smaller_than_what_effects_look_beyond_is_refused(rig: Rig) -> None:
    assert rig.set(region=["y: 0 to 1"])[0].successful
    (result,) = rig.set(**{"effects.clearance_max_distance": 1.5})
    assert not result.successful
    assert "region_halo must be at least effects.clearance_max_distance, 1.5 m" in result.reason
    for wrong in ({"region_halo": 0.05}, {"region": ["x: 0 to 1", "x: 2 to 3"]}):
        (result,) = rig.set(**wrong)
        assert not result.successful
    assert "at most one entry" in result.reason
    many = {"effects.clearance": "off", "region_halo": 0.05}
    assert all(one.successful for one in rig.set(**many))
    (result,) = rig.set(**{"effects.points_margin": 0.06})
    assert not result.successful
    region = Region([-math.inf, 0, -math.inf], [math.inf, 1, math.inf], 0.05)
    rig.until(lambda: rig.node.objects.scene.region == region, "the region")
    assert rig.node.guard.total == 0


def test_a_start_with_a_halo_that_is_too_small_ends_with_the_reason() -> None:
    with (
        pytest.raises(ValueError, match="region_halo must be at least"),
        Rig(region=["z: 0 to inf"], region_halo=0.0),
    ):
        pass


def test_a_region_is_the_same_after_it_was_a_parameter() -> None:
    region = Region([-math.inf, 0.1, 1 / 3], [0.1 + 0.2, math.inf, 1e300])
    entries = [range_from_text(text) for text in text_from_region(region)]
    assert entries == [
        ("x", -math.inf, 0.1 + 0.2),
        ("y", 0.1, math.inf),
        ("z", 1 / 3, 1e300),
    ]
    assert text_from_region(Region([-math.inf] * 3, [math.inf] * 3)) == [""]

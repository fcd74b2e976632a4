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

"""Nodes of several regions, and the merger of their answers."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from node_process import environment
from processes import PATIENCE, started
from rclpy.parameter import Parameter
from rig import LATCHED, NAMESPACE, OUTPUTS, Rig, client_apart, node_apart
from sensor_msgs.msg import PointCloud2

from obb_collision.node import namespace_number
from obb_collision.node.diagnostics.answer import COLLIDING, FREE, UNKNOWN
from obb_collision.node.merger import MergerNode, values_of
from obb_collision.node.messages.clouds import cloud_to_ros
from obb_collision.node.messages.conversions import stamp_from_ros
from obb_collision.node.node import CollisionNode
from obb_collision.node.objects.frames import FixedFrameOnly
from obb_collision.node.parameters.entries import text_from_region
from obb_collision.node.topics.cloud import Cloud
from obb_collision.node.topics.topics import COLLISIONS, TOPICS
from obb_collision.regions import split_regions

REGIONS = ("west", "east")
SIDE = 6.0
"""Edge of the cube in which objects move (m)."""
COUNT = 40
TIMEOUT = 1.0
"""Seconds of silence after which a region is missing; tests must not depend on a loaded machine."""
CLOUDS = ("collisions", "contacts", "clearances", "predicted_collisions")
TRIGGER = {"trigger": "arrival", "min_period": 0.0, "rate": 5.0}
SHARED = ("objects", "object_transform", "object_states", "object_poses", "object_boxes", "points")


class Firsts(dict[str, Any]):
    """Messages by topic, the first of each stamp.

    A node that evaluates a stamp again, because its timer is due, has nothing that passed since.
    """

    def __setitem__(self, topic: str, message: Any) -> None:
        before = self.get(topic)
        if before is None or topic not in CLOUDS or before.header.stamp != message.header.stamp:
            super().__setitem__(topic, message)


class Shared(Rig):
    """A rig of a whole node, with one node per region, and the merger of these."""

    def __init__(self) -> None:
        super().__init__(deaf=True, given=TRIGGER)
        self.patience = PATIENCE
        self.last, self.merged = Firsts(), Firsts()
        self.random = np.random.default_rng(3)
        self.nodes: dict[str, Any] = {}
        for region in REGIONS:
            self.start(region)
        given = {"regions": list(REGIONS), "timeout": TIMEOUT}
        renamed = (*CLOUDS, "in_collision", "collision_status", "namespaces")
        self.merger = self.nodes["merger"] = MergerNode(
            context=self.context,
            namespace=NAMESPACE,
            parameter_overrides=[Parameter(name, value=value) for name, value in given.items()],
            cli_args=remapped({topic: f"merged/{topic}" for topic in renamed}),
        )
        self.executor.add_node(self.merger)
        self.listen(*CLOUDS)
        for topic in (*CLOUDS, "in_collision", "collision_status"):
            output, take = OUTPUTS[topic], partial(self.merged.__setitem__, topic)
            qos = LATCHED if output.is_latched else 10
            self.client.create_subscription(output.message, f"merged/{topic}", take, qos)

    def start(self, region: str) -> None:
        """Start the node of a region, with outputs of its own and shared inputs."""
        parts = split_regions([0.0] * 3, [SIDE] * 3, (2, 1, 1))
        part = text_from_region(parts[REGIONS.index(region)])
        given: dict[str, Any] = TRIGGER | {"region": part, "region_halo": 0.5}
        self.nodes[region] = CollisionNode(
            context=self.context,
            namespace=f"{NAMESPACE}/{region}",
            parameter_overrides=[Parameter(name, value=value) for name, value in given.items()],
            cli_args=remapped({topic: f"{NAMESPACE}/{topic}" for topic in SHARED}),
            frames=FixedFrameOnly("map"),
        )
        self.executor.add_node(self.nodes[region])

    def end(self, region: str) -> None:
        """End a node, which is silent from now on."""
        node = self.nodes.pop(region)
        self.executor.remove_node(node)
        node.destroy_node()

    def __exit__(self, *given: object) -> None:
        """Take all nodes down."""
        self.executor.shutdown()
        for node in self.nodes.values():
            node.destroy_node()
        super().__exit__(*given)

    def step(self) -> None:
        """Send the next frame: all boxes, some of which cross borders, with twists."""
        poses = np.zeros((COUNT, 7))
        poses[:, :3] = self.random.uniform(-0.5, SIDE + 0.5, (COUNT, 3)) * [1, 0.4, 0.4]
        poses[:, 3:] = self.random.normal(size=(COUNT, 4))
        poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
        numbers = np.full(COUNT, namespace_number("boxes"))
        self.send_boxes(range(COUNT), poses, [1.0, 0.5, 0.75], numbers)

    def joined(self, topic: str) -> bool:
        """Return whether both the whole node and the merger have the last stamp."""
        both = self.last.get(topic), self.merged.get(topic)
        return all(one and stamp_from_ros(one.header.stamp) == self.stamp for one in both)

    def check_same(self, what: str, *topics: str) -> None:
        """Check that the merger has, row by row, what the whole node has of the last frame."""
        self.until(lambda: all(map(self.joined, topics)), what)
        for topic in topics:
            cloud = next(t for t in TOPICS.values() if t.name == topic)
            assert isinstance(cloud, Cloud)
            one, together = cloud.from_ros(self.last[topic]), cloud.from_ros(self.merged[topic])
            assert len(one) > 0, topic
            for name in one.dtype.names or ():
                assert one[name].tobytes() == together[name].tobytes(), (topic, name)

    def check_frames(self, count: int) -> None:
        """Check that frames which all evaluate give the same, and nothing in two regions.

        One before them makes what is passed in a frame of the same two frames everywhere.
        """
        self.step()
        self.until(lambda: all(map(self.joined, CLOUDS)), "a frame that all evaluate")
        repeated = self.merger._merger.repeated
        for _ in range(count):
            self.step()
            self.check_same("a frame", *CLOUDS)
        assert self.merger._merger.repeated == repeated

    def merged_status(self) -> Any:
        return self.merged["collision_status"].status[0]

    def is_missing(self, region: str) -> bool:
        """Return whether the merged status says that a region is silent."""
        values = values_of(self.merged_status())
        return "region_silent" in values["reasons"].split() and region in values["who"]

    def apart(self) -> None:
        """Send a frame in which nothing collides."""
        poses = np.zeros((COUNT, 7))
        poses[:, 0], poses[:, 6] = np.linspace(-2.0, SIDE + 2.0, COUNT), 1.0
        self.send_boxes(range(COUNT), poses, 0.01, np.full(COUNT, namespace_number("boxes")))

    def frames_until(self, reached: Callable[[], Any], what: str) -> None:
        """Send frames, each once the one before is evaluated, until something is reached."""
        limit = time.monotonic() + PATIENCE
        while not reached():
            assert time.monotonic() < limit, f"waited in vain for {what}"
            self.step()
            self.answer()
            self.executor.spin_once(timeout_sec=0.02)


def remapped(names: dict[str, str]) -> list[str]:
    """Return arguments that give topics other names."""
    return ["--ros-args", *(word for old, new in names.items() for word in ("-r", f"{old}:={new}"))]


def test_two_regions_find_what_one_node_finds_also_while_one_restarts() -> None:
    with Shared() as client:
        client.frames_until(lambda: client.merged.keys() >= {*CLOUDS}, "all topics of all regions")
        client.check_frames(4)
        status = client.merged_status
        assert status().level == COLLIDING

        client.end("east")
        for topic in CLOUDS:
            client.merged.pop(topic, None)
        client.frames_until(lambda: client.is_missing("east"), "the missing region")
        assert not client.merged.keys() & {*CLOUDS}
        client.apart()
        client.until(lambda: status().message.startswith("at least 1 pair"), "what east said last")
        assert status().level == COLLIDING
        assert client.is_missing("east")
        assert client.merged["in_collision"].data

        client.start("east")
        client.frames_until(lambda: client.merged.keys() >= {*CLOUDS}, "all regions again")
        client.check_frames(2)
        client.apart()
        client.until(lambda: status().level == FREE, "free: they fill space")
        client.until(lambda: not client.merged["in_collision"].data, "the flag")
        assert status().message == "free"


def reasons(status: DiagnosticStatus) -> set[str]:
    return {*values_of(status)["reasons"].split()}


def test_regions_fill_space_each_by_one_node_or_the_merger_says_so() -> None:
    given = {"regions": ["west", "east"], "timeout": TIMEOUT}
    with client_apart() as client, node_apart("second") as second:
        merger = MergerNode(
            context=client.client.context,
            namespace=NAMESPACE,
            parameter_overrides=[Parameter(name, value=value) for name, value in given.items()],
        )
        client.executor.add_node(merger)
        ends = {
            region: client.client.create_publisher(
                DiagnosticArray, f"{region}/collision_status", STATUS.qos
            )
            for region in REGIONS
        }
        client.listen("collision_status")

        def told(west: str, east: str, code: str, who: str = "") -> bool:
            for region, bounds in zip(REGIONS, (west, east), strict=True):
                ends[region].publish(status("3", region=bounds))
            if "collision_status" not in client.last:
                return False
            (said,) = client.last["collision_status"].status
            found = reasons(said) & {"region_gap", "region_twice", "two_publishers"}
            return found == ({code} - {""}) and who in said.message

        cases = (
            ("x: -inf to 10.0", "x: 10.0 to inf", ""),
            ("x: -inf to 10.0", "x: 10.000000000000002 to inf", "region_gap"),
            ("x: -inf to 10.0", "x: 9.999999999999998 to inf", "region_twice"),
            ("everything", "x: 10.0 to inf", "region_twice"),
            ("x: -inf to 10.0", "x: 10.0 to inf, y: -5.0 to inf", "region_gap"),
            ("x: -inf to 10.0", "", "region_gap"),
            ("x: -inf to 10.0", "x: 10.0 to inf", ""),
        )
        for west, east, code in cases:
            client.until(partial(told, west, east, code), f"{west}, {east}: {code}")
        good = "x: -inf to 10.0", "x: 10.0 to inf"
        for topic, code, who in (
            ("east/collision_status", "region_twice", "east"),
            ("collision_status", "two_publishers", "collision_status"),
        ):
            end = second.create_publisher(DiagnosticArray, topic, STATUS.qos)
            client.until(partial(told, *good, code, who), code)
            second.destroy_publisher(end)
            client.until(partial(told, *good, ""), "one publisher each")
        client.executor.remove_node(merger)
        merger.destroy_node()


STATUS = TOPICS["collision_status"]
SCRIPT = "from obb_collision.commands import merge; raise SystemExit(merge())"
COMMAND = ("-c", SCRIPT, "--ros-args", "-r", f"__ns:={NAMESPACE}/merged")
ARGUMENTS = ("-p", f"regions:=['{NAMESPACE}/west']", "-p", "timeout:=0.5")


def status(objects: str, level: bytes = FREE, **more: str) -> DiagnosticArray:
    """Return what the node of a region says; more: further values."""
    pairs = {"objects": objects, "clearance radius (m)": "0.1", "region": "everything"} | more
    values = [KeyValue(key=key, value=value) for key, value in pairs.items()]
    return DiagnosticArray(status=[DiagnosticStatus(level=level, values=values)])


def test_bad_messages_do_not_end_the_merger_and_its_last_word_is_that_nothing_is_known() -> None:
    with client_apart() as client:
        told = client.client.create_publisher(DiagnosticArray, "west/collision_status", STATUS.qos)
        rows = client.client.create_publisher(PointCloud2, "west/collisions", 10)
        said: list[DiagnosticStatus] = []

        def take(message: DiagnosticArray) -> None:
            said.append(message.status[0])

        client.client.create_subscription(DiagnosticArray, "merged/collision_status", take, LATCHED)
        rows_sent = True

        def heard(level: bytes, reason: str, who: str, sent: DiagnosticArray | None) -> bool:
            assert process.poll() is None, process.communicate()[0]
            if sent is not None:
                told.publish(sent)
            if rows_sent:
                rows.publish(cloud_to_ros(np.zeros(0, COLLISIONS.dtype), client.header()))
            if not said:
                return False
            values = values_of(said[-1])
            return (said[-1].level, values["reason"], values["who"]) == (level, reason, who)

        def has_radius(expected: bool, sent: DiagnosticArray) -> bool:
            collides = heard(COLLIDING, "refused", f"{west} (a/1)", sent)
            return collides and ("clearance radius (m)" in values_of(said[-1])) == expected

        with started(*COMMAND, *ARGUMENTS, **environment()) as process:
            west, silent = f"{NAMESPACE}/west", f"{NAMESPACE}/west (silent)"
            for bad in (status("9" * 10_000), DiagnosticArray()):
                client.until(partial(heard, FREE, "", "", status("3")), "free")
                client.until(partial(heard, UNKNOWN, "region_silent", silent, bad), "silence")
            given = {"reason": "refused", "reasons": "refused stale", "who": "a/1"}
            sent = status("3", UNKNOWN, **given)
            client.until(partial(heard, UNKNOWN, "refused", f"{west} (a/1)", sent), "its reason")
            assert values_of(said[-1])["reasons"] == "refused stale"
            sent = status("3", UNKNOWN, reasons="of_tomorrow")
            client.until(partial(heard, UNKNOWN, "incomplete", west, sent), "another version")
            sent = status("3", COLLIDING, **given)
            client.until(partial(heard, COLLIDING, "refused", f"{west} (a/1)", sent), "both")
            assert values_of(said[-1])["clearance radius (m)"] == "0.1"
            client.until(partial(heard, FREE, "", "", status("3")), "free")
            bad = status("9" * 10_000, COLLIDING, **given)
            client.until(partial(heard, COLLIDING, "refused", f"{west} (a/1)", bad), "it collides")
            for bad_radius in ("far", "nan", "-1", ""):
                bad = status("3", COLLIDING, **given, **{"clearance radius (m)": bad_radius})
                client.until(partial(has_radius, False, bad), f"no radius, {bad_radius!r}")
                client.until(partial(has_radius, True, sent), "a radius")
            client.until(partial(heard, COLLIDING, "region_silent", silent, None), "its collision")
            back = f"{west} (back)"  # it says that it is free, and is not believed at once
            client.until(partial(heard, UNKNOWN, "region_silent", back, status("3")), "an end")
            client.until(partial(heard, FREE, "", "", status("3")), "free again")
            rows_sent = False  # and so there is no stamp that all have evaluated
            client.until(partial(heard, UNKNOWN, "region_unmatched", "", status("3")), "no rows")
            process.send_signal(signal.SIGTERM)
            output, _ = process.communicate(timeout=PATIENCE)
            assert process.returncode == 0, output
            client.until(lambda: "shutting down" in said[-1].message, "the last word")
            assert said[-1].level == UNKNOWN
            assert "internal error" not in output

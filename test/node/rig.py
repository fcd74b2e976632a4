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

"""The rig of the node's tests: publishers for its inputs, subscriptions for its outputs.

Nothing here sleeps: every wait spins the one executor until what is waited for is there. States
carry rising stamps, and ``collisions`` carries the newest one evaluated, so "the answer to this
state" is a stamp to wait for and not a number of messages.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar
from unittest.mock import Mock, patch

import numpy as np
import processes
import pytest
from geometry_msgs.msg import TransformStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from processes import SharedWorker, build_by
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import MultiDOFJointState, PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision import node as ros
from obb_collision.node import namespace_number
from obb_collision.node.diagnostics.answer import FREE, UNKNOWN
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.messages import conversions as cv
from obb_collision.node.messages.clouds import cloud_to_ros
from obb_collision.node.messages.conversions import Key, name_from_key, pose_to_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.node import CollisionNode
from obb_collision.node.objects.conditions import RESHAPED, UNSHAPED
from obb_collision.node.objects.frames import EXTRAPOLATION, UNKNOWN_FRAME, FixedFrameOnly
from obb_collision.node.status import reporting
from obb_collision.node.topics.topics import NAMESPACES, TOPICS
from obb_collision.scene.building.builder import WorkerProcess

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
DOMAIN = 1 + os.getpid() % 100
"""Domain id of this run, from the process id."""
NAMESPACE = f"/test_{os.getpid()}"
"""Namespace of all nodes of this run: where two runs share a domain by chance, they don't meet."""
FRAME = "map"
A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
"""Keys of objects."""
PATIENCE = 300.0
"""Seconds after which a wait has failed: long, as on a loaded machine kernels are compiled."""
REPORTS = 0.2
"""Seconds between two ``/diagnostics``: a test waits for several of them."""
FIRST_STAMP = 1_000_000_000
RELIABILITY = "subscription.reliability"
RATE = 100.0
"""Cycles per second: most of a test is waiting for one."""
STATUS, FLAG = "collision_status", "in_collision"

INPUTS: dict[str, Any] = {
    "objects": MarkerArray,
    "object_transform": TransformStamped,
    "object_states": MultiDOFJointState,
    "object_poses": PointCloud2,
    "object_boxes": PointCloud2,
    "points": PointCloud2,
}
POSES = ("objects", "object_transform", "object_states", "object_poses")
"""Topics that move objects."""
OUTPUTS = {t.name.replace("~", "obb_collision"): t for t in (*TOPICS.values(), NAMESPACES)}
HEARD = ("collisions", "in_collision", "namespaces")
"""Outputs that every rig listens to."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def cube(
    key: Key,
    position: Iterable[float] = (0.0, 0.0, 0.0),
    size: Iterable[float] = (1.0, 1.0, 1.0),
    frame: str = FRAME,
    **fields: Any,
) -> Marker:
    """Return an ADD marker of a cube; more fields by name."""
    marker = Marker(ns=key[0], id=key[1], type=Marker.CUBE)
    marker.pose = pose_to_ros((*position, 0, 0, 0, 1))
    marker.header.frame_id = frame
    marker.scale.x, marker.scale.y, marker.scale.z = (float(edge) for edge in size)
    for name, value in fields.items():
        setattr(marker, name, value)
    return marker


def spy(monkeypatch: Patch, owner: Any, name: str) -> Mock:
    """Take note of the calls of a function from now on."""
    noted = Mock(wraps=getattr(owner, name))
    monkeypatch.setattr(owner, name, noted)
    return noted


AnyRig = TypeVar("AnyRig", bound="Rig")
Patch = pytest.MonkeyPatch
Printed = pytest.CaptureFixture[str]
SHARED: list[Any] = []
"""The rig that several tests share: one of another kind ends it, as nodes have the same names."""


def end_shared() -> None:
    while SHARED:
        SHARED.pop().__exit__()


class Client:
    """A node that talks to a collision node by topics only."""

    def __init__(self, context: Context, executor: SingleThreadedExecutor) -> None:
        end_shared()
        self.executor = executor
        self.client = Node("client", context=context, namespace=NAMESPACE)
        create = self.client.create_publisher
        self.pubs = {topic: create(kind, topic, 100) for topic, kind in INPUTS.items()}
        self.last: dict[str, Any] = {}
        self.subscriptions: dict[str, Any] = {}
        self.services: dict[str, Any] = {}
        self.stamp = FIRST_STAMP
        self.patience = PATIENCE
        self.unmatched: set[str] = set()  # inputs that the node does not subscribe to
        executor.add_node(self.client)

    def listen(self, *topics: str) -> None:
        for topic in set(topics) - self.subscriptions.keys():
            qos = LATCHED if OUTPUTS[topic].is_latched else QoSProfile(depth=50)

            def take(message: Any, topic: str = topic) -> None:
                if topic != "/diagnostics" or message.status[0].name.startswith(NAMESPACE[1:]):
                    self.last[topic] = message

            kind = OUTPUTS[topic].message
            self.subscriptions[topic] = self.client.create_subscription(kind, topic, take, qos)

    def ignore(self, *topics: str) -> None:
        for topic in topics:
            self.client.destroy_subscription(self.subscriptions.pop(topic))
            self.last.pop(topic, None)

    def until(self, reached: Callable[[], Any], what: str = "") -> Any:
        """Spin until ``reached`` returns something true; returns that."""
        limit = time.monotonic() + self.patience
        while not (result := reached()):
            assert time.monotonic() < limit, f"waited in vain for {what or reached}"
            self.executor.spin_once(timeout_sec=0.05)
        return result

    def wait_matched(self) -> None:
        """Wait until every publisher has the node and ``collisions`` arrive here."""
        self.wait_inputs()
        if "collisions" in self.subscriptions:
            self.until(lambda: "collisions" in self.last, "collisions")

    def wait_inputs(self) -> None:
        wanted = [p for topic, p in self.pubs.items() if topic not in self.unmatched]
        self.until(lambda: all(p.get_subscription_count() for p in wanted), "match")

    def time(self) -> int:
        """Return the least stamp (ns) to send: by default they tell no time, and only rise."""
        return 0

    def header(self, frame: str = FRAME) -> Header:
        self.stamp = max(self.stamp + 1_000_000, self.time())
        return Header(stamp=cv.stamp_to_ros(self.stamp), frame_id=frame)

    def send(self, *markers: Marker, stamped: bool = True) -> Client:
        """Publish markers, all with the next stamp."""
        if stamped:
            stamp = self.header().stamp
            for marker in markers:
                marker.header.stamp = stamp
        self.pubs["objects"].publish(MarkerArray(markers=list(markers)))
        return self

    def send_transform(self, name: str, pose: Any, frame: str = FRAME) -> Client:
        message = TransformStamped(header=self.header(frame), child_frame_id=name)
        message.transform = cv.transform_to_ros(pose)
        self.pubs["object_transform"].publish(message)
        return self

    def send_states(self, names: Any, poses: Any, frame: str = FRAME, twists: Any = None) -> Client:
        message = cv.states_to_ros(names, poses, self.header(frame), twists)
        self.pubs["object_states"].publish(message)
        return self

    def send_points(self, points: Any, frame: str = FRAME, kind: str = "<f4") -> None:
        """Publish a cloud of points (n, 3), with the next stamp."""
        rows = np.zeros(len(points), [(name, kind) for name in "xyz"])
        for column, name in enumerate("xyz"):
            rows[name] = np.asarray(points)[:, column]
        self.pubs["points"].publish(cloud_to_ros(rows, self.header(frame)))

    def send_poses(self, ids: Any, poses: Any, namespaces: Any = None, **options: Any) -> Client:
        header = self.header(options.pop("frame", FRAME))
        message = ros.poses_to_ros(ids, poses, namespaces, header, **options)
        self.pubs["object_poses"].publish(message)
        return self

    def send_boxes(
        self, ids: Any, poses: Any, sizes: Any = 1.0, namespaces: Any = None, **options: Any
    ) -> Client:
        """Publish a complete set of boxes: poses (n, 7) and sizes, (n, 3) or one for all."""
        header = self.header(options.pop("frame", FRAME))
        sizes = np.broadcast_to(sizes, (len(ids), 3))
        message = ros.boxes_to_ros(ids, poses, sizes, namespaces, header, **options)
        self.pubs["object_boxes"].publish(message)
        return self

    def send_by(self, topic: str, poses: Mapping[Key, Any], size: Any = (1, 1, 1)) -> Client:
        """Send poses by key, by any of ``POSES``, in one message where it takes several."""
        names, rows = [name_from_key(key) for key in poses], list(poses.values())
        if topic == "objects":
            self.send(*(cube(k, size=size, pose=pose_to_ros(row)) for k, row in poses.items()))
        elif topic == "object_transform":
            for name, row in zip(names, rows, strict=True):
                self.send_transform(name, row)
        elif topic == "object_states":
            self.send_states(names, rows)
        else:
            namespaces = [namespace_number(namespace) for namespace, _ in poses]
            self.send_poses([number for _, number in poses], rows, namespaces)
        return self

    def answer(self, topic: str = "collisions") -> PointCloud2:
        """Wait for the message of a topic that is about the last state sent."""

        def arrived() -> Any:
            message = self.last.get(topic)
            return message and cv.stamp_from_ros(message.header.stamp) == self.stamp and message

        found: PointCloud2 = self.until(arrived, f"{topic} of stamp {self.stamp}")
        return found

    def pairs(self) -> set[tuple[str, str]]:
        """Names of the pairs in the answer to the last state, in the order of the rows."""
        rows = ros.collisions_from_ros(self.answer())
        self.namespaces(*rows["ns_a"].tolist(), *rows["ns_b"].tolist())
        named = ros.named_pairs(self.last["collisions"], self.last["namespaces"])
        return {(a, b) for a, b, *_ in named}

    def namespaces(self, *wanted: int | str) -> dict[int, str]:
        """Wait for a table with some namespaces, by number or name; topics overtake each other."""
        numbers = {namespace_number(one) if isinstance(one, str) else one for one in wanted}

        def complete() -> bool:
            table = self.last.get("namespaces")
            return table is not None and numbers <= cv.namespace_table(table).keys()

        self.until(complete, f"a table with {sorted(numbers)}")
        return dict(cv.namespace_table(self.last["namespaces"]))

    def next(self, topic: str) -> Any:
        """Wait for another message of a topic, subscribed to from now on."""
        self.listen(topic)
        self.last.pop(topic, None)
        return self.until(lambda: self.last.get(topic), topic)

    def says(
        self, level: bytes, text: str = "", flag: bool | None = None, **wanted: str
    ) -> dict[str, str]:
        """Wait for a level of the status, with a text in its message or a code, and for the flag.

        Return its values by key, its message too; wanted: some that it must have.
        """
        self.listen(STATUS, FLAG)

        def reached() -> Any:
            if STATUS not in self.last or (flag is not None and FLAG not in self.last):
                return None
            (status,) = self.last[STATUS].status
            values = {pair.key: pair.value for pair in status.values} | {"message": status.message}
            is_said = text in status.message or text in values["reasons"].split()
            is_flagged = flag is None or self.last[FLAG].data is flag
            found = status.level == level and is_said and wanted.items() <= values.items()
            return found and is_flagged and values

        found: dict[str, str] = self.until(reached, f"{level!r} {text} {wanted} {flag}")
        return found

    def known(self, reason: str = "", who: str = "") -> dict[str, str]:
        """Wait until the status has a first reason, "" for free, and names who."""
        return self.says(UNKNOWN if reason else FREE, who, reason=reason)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        service = self.services.get(name) or self.client.create_client(kind, name)
        self.services[name] = service
        self.until(service.service_is_ready, name)
        future = service.call_async(request)
        return self.until(lambda: future.done() and future.result(), name)

    def change(self, transition: int, label: str = "") -> bool:
        """Ask for a transition of the life cycle; returns whether it went through."""
        request = ChangeState.Request(transition=Transition(id=transition, label=label))
        return bool(self.call(ChangeState, "obb_collision/change_state", request).success)

    def go_through(self, *transitions: int) -> None:
        """Ask for transitions, each of which goes through; an active node takes messages in."""
        for transition in transitions:
            assert self.change(transition)
        if transitions[-1:] == (Transition.TRANSITION_ACTIVATE,):
            self.wait_inputs()

    def state(self) -> str:
        answer = self.call(GetState, "obb_collision/get_state", GetState.Request())
        return str(answer.current_state.label)

    def status(self, name: str) -> dict[str, str]:
        """Wait for another ``/diagnostics`` and return the values of one status, by key."""
        message = self.next("/diagnostics")
        (found,) = [status for status in message.status if status.name.endswith(name)]
        assert found.name.startswith(NAMESPACE[1:])
        values = {pair.key: pair.value for pair in found.values}
        return {"message": found.message, "level": found.level.hex()} | values


@contextmanager
def own_context(domain: int = DOMAIN) -> Iterator[Context]:
    context = Context()
    context.init(domain_id=domain)
    try:
        yield context
    finally:
        context.try_shutdown()


@contextmanager
def client_apart() -> Iterator[Client]:
    """Yield a client of nodes in other processes."""
    with own_context() as context:
        made = Client(context, SingleThreadedExecutor(context=context))
        made.patience = processes.PATIENCE
        try:
            yield made
        finally:
            made.executor.shutdown()
            made.client.destroy_node()


@contextmanager
def node_apart(name: str) -> Iterator[Node]:
    """Yield a node of a context of its own, as of another process."""
    with own_context() as context:
        node = Node(name, context=context, namespace=NAMESPACE)
        try:
            yield node
        finally:
            node.destroy_node()


class Rig(Client):
    """A collision node and a client in one context on one executor."""

    has_true_stamps = False

    def __init__(
        self,
        frames: Any = None,
        deaf: bool = False,
        given: Mapping[str, Any] | None = None,
        tf2: bool = False,
        sure_points: bool = True,
        unmatched: Iterable[str] = (),
        own_builder: bool = False,
        **parameters: Any,
    ) -> None:
        """Wait until they have met.

        frames: what knows other frames; none, unless tf2 is asked for, so that a test finds the
        same node whether tf2 is installed or not. deaf: the client listens to nothing yet, nor
        waits for a node without autostart; given: more parameters, of any name. sure_points: points
        arrive as surely as all else, so that a test need not send them twice. unmatched: inputs
        whose publishers here do not fit. own_builder: shapes are built by a process of this node.
        """
        build_by(WorkerProcess if own_builder else SharedWorker)
        parameters |= given or {}
        parameters.setdefault("mesh_folders", [tempfile.gettempdir()])
        parameters.setdefault("cycle_timeout", 30.0)  # slow enough for a loaded machine
        parameters.setdefault("rate", RATE)
        if sure_points:
            parameters.setdefault(f"qos_overrides.{NAMESPACE}/points.{RELIABILITY}", "reliable")
        if frames is None and not tf2:
            frames = FixedFrameOnly(parameters.get("fixed_frame", FRAME))
        self.context = Context()
        self.context.init(domain_id=DOMAIN)
        super().__init__(self.context, SingleThreadedExecutor(context=self.context))
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        with patch.object(reporting, "PERIOD", REPORTS):
            self.node = CollisionNode(
                context=self.context,
                namespace=NAMESPACE,
                frames=frames,
                parameter_overrides=overrides,
            )
        self.executor.add_node(self.node)
        self.unmatched.update(unmatched)
        if parameters.get("effects.points") == "off":
            self.unmatched.add("points")
        if deaf:
            if parameters.get("autostart", True):
                self.wait_matched()
            return
        self.listen(*HEARD)
        self.wait_matched()
        self.until(lambda: "namespaces" in self.last and "in_collision" in self.last, "latched")

    def another_case(self) -> None:
        """Take objects away, but not robots, and what was counted: one node serves many cases."""
        if not self.node.robots.robots:
            self.node.objects.clear()
        for topic in self.pubs.keys() & self.node.monitors.keys():
            monitor = self.monitor(topic)
            monitor.refused.clear()
            monitor.doubted.clear()
            monitor.since_last_report()
        self.cycles(1)

    def cycles(self, count: int) -> None:
        monitor = self.node.cycle.monitor
        end = monitor.total + count
        self.until(lambda: monitor.total >= end, "cycles")

    def built(self, *keys: Key) -> None:
        """Wait until objects have come and have their shapes, and a cycle more."""
        table = self.node.objects.table

        def ready() -> bool:
            slots = [table.slots.get(key, -1) for key in keys]
            return all(s >= 0 and not table.has(UNSHAPED | RESHAPED, s) for s in slots)

        self.until(ready, f"the shapes of {keys}")
        self.cycles(2)

    def pose_of(self, key: Key) -> Any:
        objects = self.node.objects
        return objects.scene.objects.poses_of([objects.table.slots[key]])[0]

    def now(self) -> int:
        return self.node.now()

    def time(self) -> int:
        return self.node.get_clock().now().nanoseconds if self.has_true_stamps else 0

    def monitor(self, topic: str) -> InputMonitor:
        return self.node.monitors[topic]

    def is_doubtful(self, key: Key) -> bool:
        table = self.node.objects.table
        return bool(table.doubtful[table.slots[key]])

    def refused(self, topic: str) -> dict[str, int]:
        return dict(self.monitor(topic).refused)

    def refuses(self, topic: str, expected: dict[str, int]) -> None:
        """Wait until items of an input are refused, as many as expected by reason and no more."""
        count = sum(expected.values())
        self.until(lambda: sum(self.refused(topic).values()) >= count, f"refusals by {topic}")
        assert self.refused(topic) == expected

    def set(self, **parameters: Any) -> list[Any]:
        """Set parameters of the node as a remote client would; returns the results."""
        return self.node.set_parameters([Parameter(n, value=v) for n, v in parameters.items()])

    def __enter__(self: AnyRig) -> AnyRig:
        return self

    def __exit__(self, *_: object) -> None:
        build_by(WorkerProcess)
        self.executor.shutdown()
        self.client.destroy_node()
        self.node.destroy_node()
        self.context.try_shutdown()


def pose(x: float, y: float = 0.0, z: float = 0.0) -> list[float]:
    """Return a pose (7,) without rotation."""
    return [float(x), float(y), float(z), 0.0, 0.0, 0.0, 1.0]


def sync(rig: Client) -> set[tuple[str, str]]:
    """Pairs once everything sent before is taken in: a far cube's state comes after it."""
    rig.send(cube(("sync", 0), (1e3, 1e3, 1e3)))
    return rig.pairs()


def color(marker: Marker) -> Any:
    return pytest.approx((marker.color.r, marker.color.g, marker.color.b, marker.color.a))


class FakeFrames:
    """Frames that a test moves about: the poses of some, and of some between which stamps.

    Those without stamps are static.
    """

    waits = True
    description = "a test"

    def __init__(self) -> None:
        self.known: dict[str, list[float]] = {}
        self.spans: dict[str, tuple[int, int]] = {}
        self.asked: list[tuple[str, int]] = []

    def lookup(self, frame: str, stamp: int) -> Any:
        self.asked.append((frame, stamp))
        if frame not in self.known.keys() | self.spans.keys():
            raise RefusedError(UNKNOWN_FRAME, frame)
        first, last = self.spans.get(frame, (stamp, stamp))
        if stamp and not first <= stamp <= last:
            raise RefusedError(EXTRAPOLATION, f"{stamp} is not between {first} and {last}")
        return np.array(self.known.get(frame, pose(0.0))), stamp or last

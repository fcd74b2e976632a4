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

"""Objects without ROS around them, and markers whose shapes are built beside the cycles."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from rig import PATIENCE, FakeFrames, Rig, cube
from visualization_msgs.msg import Marker

from obb_collision import Accuracy
from obb_collision.node import collisions_from_ros
from obb_collision.node.diagnostics.answer import Answer
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.inputs.subscriptions import INPUTS
from obb_collision.node.messages.conversions import Key
from obb_collision.node.objects import Objects
from obb_collision.node.objects.states import AgeLimits, State
from obb_collision.node.objects.table import UNKNOWN
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.status import objects_answer
from obb_collision.scene.building.builder import Limits
from obb_collision.scene.building.jobs import Task, perform
from obb_collision.scene.store.patterns import Overrides
from obb_collision.shapes import Box

MILLISECOND = 1_000_000
SECOND = 1000 * MILLISECOND
START = 1000 * SECOND
"""Time of the clock at the start of a test (ns)."""


class ObjectsRig:
    """Objects with boxes that slide along x, as far as their stamp says: 1 m per second."""

    def __init__(self, *keys: Key, timeout: float = 0.2, object_timeout: float = 0.0) -> None:
        self.frames = FakeFrames()
        self.errors: list[str] = []
        guard = Guard(self.errors.append, lambda: True)
        self._monitors = {topic: InputMonitor(topic, lambda text: None) for topic in INPUTS}
        self.objects = Objects("map", self.frames, guard, self._monitors)
        self.objects.placement.timeout = timeout
        self.limit(object_timeout)
        self.now = START
        put = self.objects.shapes.put
        self.slots = np.array([put(key, Box([1.0, 1.0, 1.0])) for key in keys], np.int64)

    @property
    def refused(self) -> Counter[tuple[str, str]]:
        return self._counted("refused")

    @property
    def doubted(self) -> Counter[tuple[str, str]]:
        return self._counted("doubted")

    def _counted(self, kind: str) -> Counter[tuple[str, str]]:
        counts = {topic: getattr(monitor, kind) for topic, monitor in self._monitors.items()}
        return Counter({(topic, why): n for topic in counts for why, n in counts[topic].items()})

    def send(
        self, stamp: int, frame: str = "", row: Any = None, topic: str = "object_states"
    ) -> int:
        """Store a state of all objects, or of one; returns how many were too old."""
        slots = self.slots if row is None else self.slots[[row]]
        poses = np.zeros((len(slots), 7))
        poses[:, 0], poses[:, 6] = place(stamp), 1.0
        state = State(frame, stamp, self.now, topic)
        return int(self.objects.states.store(slots, poses, state).sum())

    def cycle(self) -> None:
        self.objects.update(self.now)

    def limit(self, timeout: float = 0.0, policy: str = UNKNOWN, **more: Any) -> None:
        """Set the age limit (s) of all objects, from their first state on, and what follows it."""
        limits = AgeLimits(policy=policy, timeouts=Overrides([("*", timeout)]), **more)
        self.objects.staleness.limits = limits

    def known(self) -> Answer:
        found = objects_answer(self.objects, self.now)
        return replace(found, pairs=len(self.objects.scene.check()))

    def x(self, row: int = 0) -> float:
        """Where an object is in the scene."""
        return float(self.objects.scene.objects.poses_of(self.slots[[row]])[0, 0])

    def is_doubtful(self, row: int = 0) -> bool:
        return bool(self.objects.table.doubtful[self.slots[row]])


def place(stamp: int) -> float:
    """Where an object is at a stamp (m)."""
    return (stamp - START) / SECOND


class UnforeseenError(Exception):
    """What nobody thought of."""


class Gate:
    """Holds up what is built by a node until it is opened; counts the jobs.

    They are done by the thread that waits for them elsewhere: no process is started.
    """

    def __init__(self, rig: Rig, trees: bool = False) -> None:
        """Hold up shapes, or with ``trees`` the trees and hulls of shapes."""
        self.opened = threading.Event()
        self.jobs: list[str] = []
        objects = rig.node.objects
        builder = objects._tree_builder if trees else objects.shapes.builder
        builder.process.run = self.run  # type: ignore[method-assign]

    def run(self, task: Task, limits: Limits) -> object:
        assert self.opened.wait(PATIENCE)
        self.jobs.append(task[0].__name__)
        return perform(task)

    def open(self) -> None:
        self.opened.set()


BOX, BODY, OTHER = ("box", 1), ("body", 1), ("body", 2)
PAIR = {("box/1", "body/1")}


def named(pairs: set[tuple[str, str]]) -> set[frozenset[str]]:
    """Pairs whatever their order."""
    return {frozenset(pair) for pair in pairs}


def triangle(key: Key = BODY, size: float = 1.0, x: float = 0.0, **fields: Any) -> Marker:
    """Return a TRIANGLE_LIST marker: one triangle, from the origin along x and y."""
    corners = ((0.0, 0.0), (size, 0.0), (0.0, size))
    points = [Point(x=u, y=v, z=0.0) for u, v in corners]
    return cube(key, (x, 0.0, 0.0), type=Marker.TRIANGLE_LIST, points=points, **fields)


def mesh_marker(path: Path | str, key: Key = BODY, **fields: Any) -> Marker:
    uri = path if isinstance(path, str) else path.as_uri()
    return cube(key, type=Marker.MESH_RESOURCE, mesh_resource=uri, **fields)


RING, CRATE = ("mesh", 1), ("box", 1)
SQUARE = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
"""Corners of a frame, around whose middle nothing is."""


def frame_points(half: float = 1.0, width: float = 0.25) -> list[Point]:
    """Triangles of a flat square frame: what is in its middle is in its box, and meets no part."""
    points = []
    for (x, y), (u, v) in zip(SQUARE, (*SQUARE[1:], SQUARE[0]), strict=True):
        inner = 1.0 - width / half
        quad = [(x, y), (u, v), (inner * u, inner * v), (inner * x, inner * y)]
        for corner in (0, 1, 2, 0, 2, 3):
            a, b = quad[corner]
            points.append(Point(x=half * a, y=half * b, z=0.0))
    return points


def ring(key: Key = RING) -> Marker:
    return cube(key, type=Marker.TRIANGLE_LIST, points=frame_points())


def crate(key: Key = CRATE, x: float = 0.0) -> Marker:
    return cube(key, (x, 0.0, 0.0), (0.5, 0.5, 0.5))


def levels(rig: Rig) -> list[str]:
    """Names of the levels of the pairs in the next message."""
    rows = collisions_from_ros(rig.next("collisions"))
    return [Accuracy(level).name.lower() for level in rows["accuracy"].tolist()]

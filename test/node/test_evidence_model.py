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

"""Any sequence of messages, faults and silences: the node claims what a slow model knows.

The node is the real one, with its clocks in the hand of the test; the model shares no code with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from itertools import combinations
from math import inf, nan
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from rclpy.time import Time
from rig import DOMAIN, NAMESPACE, cube, pose
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node import boxes_to_ros, namespace_number, poses_to_ros
from obb_collision.node.messages.conversions import (
    stamp_to_ros,
    states_to_ros,
    transform_to_ros,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.node import CollisionNode

ORDER = (
    *("starting", "inactive", "disabled", "internal_error", "no_objects", "required_missing"),
    *("input_silent", "input_unreadable", "unknown_objects", "unplaced", "refused", "late_frame"),
    "stale",
)
OFFSET, WAIT, LONGEST_WAIT = 0.7, 0.2, 10.0
"""Where odom is, and for how long (s) states wait for it."""
REORDERED, MEMORY = 1.0, 1.0
"""Age (s) of a state up to which an older one is late, and of one that names an unknown object."""
SPEED, REACH = 0.37, 1.0
SECOND = 1_000_000_000
START = 1000.0


@dataclass
class Thing:
    """An object: what was said of it, and what of that could be used."""

    size: float
    of_set: bool = False
    expiry: float = inf
    x: float | None = None
    at: float = 0.0
    stamp: float = 0.0
    states: list[tuple[float, str, float, float]] = field(default_factory=list)
    received: float = 0.0
    order: float = 0.0
    repeated: bool = False
    bad_pose: bool = False
    bad_shape: bool = False
    overtaken: bool = False
    held_back: bool = False
    late: bool = False
    stale: bool = False


class Model:
    """What can be known."""

    def __init__(self, now: float, until: float) -> None:
        self.now, self.until, self.active, self.enabled = now, until, now, True
        self.activated = now
        self.things: dict[str, Thing] = {}
        self.newcomers: dict[str, tuple[bool, float]] = {}
        self.unknown: dict[str, float] = {}
        self.deleted: dict[str, float] = {}
        self.unreadable: set[str] = set()
        self.heard: dict[str, float] = {}
        self.sets: list[tuple[str, float, float, list[tuple[str, float, float, str]]]] = []
        self.set_order = self.set_received = 0.0
        self.declared = False
        self.ignored: list[str] = []
        self.pairs: list[tuple[Thing, Thing]] = []

    def declare(self) -> None:
        self.declared = not self.things and not self.newcomers

    def see(self) -> None:
        self.declared &= not self.things and not self.newcomers

    def is_placed_at(self, frame: str, stamp: float) -> bool:
        return frame == "map" or (frame == "odom" and stamp <= self.until)

    def is_late(self, thing: Thing, stamp: float) -> bool:
        late = 0 < stamp < thing.order and self.now - thing.received <= REORDERED
        thing.overtaken |= late
        return late

    def state(self, thing: Thing, x: float, frame: str, stamp: float) -> None:
        if self.is_late(thing, stamp):
            return
        thing.bad_pose = thing.overtaken = False
        thing.repeated |= thing.received > 0
        thing.received = self.now
        if 0 < stamp <= self.now + 0.5:
            thing.order = stamp
        thing.states.append((x, frame, stamp, self.now))

    def add(
        self, name: str, x: float, size: float, frame: str, stamp: float, fault: str, life: float
    ) -> None:
        thing = self.things.get(name)
        expiry = self.now + life if life else inf
        if fault:
            self.refuse(name, fault, expiry)
            return
        if thing is None:
            thing = self.things[name] = Thing(size)
        elif self.is_late(thing, stamp):
            return
        thing.size, thing.bad_shape, thing.expiry = size, False, expiry
        self.newcomers.pop(name, None)
        self.state(thing, x, frame, stamp)
        self.see()

    def refuse(self, name: str, fault: str, expiry: float = inf, of_set: bool = False) -> None:
        thing = self.things.get(name)
        if thing is None:
            self.newcomers[name] = of_set, expiry
        else:
            thing.bad_shape |= fault == "scale"
            thing.bad_pose |= fault != "scale"
            thing.expiry = max(thing.expiry, expiry)
        self.see()

    def is_of_set(self, name: str) -> bool:
        thing = self.things.get(name)
        return thing.of_set if thing else self.newcomers.get(name, (False, 0.0))[0]

    def delete(self, *names: str) -> None:
        gone = [name for name in names if name in self.things or name in self.newcomers]
        for name in names:
            self.deleted[name] = self.now
            self.unknown.pop(name, None)
            if not self.is_of_set(name):
                self.things.pop(name, None)
                self.newcomers.pop(name, None)
        if gone:
            self.declare()

    def named(self, name: str, x: float, frame: str, stamp: float, fault: str = "") -> None:
        thing = self.things.get(name)
        if thing is None:
            ignored = any(fnmatch(name, pattern) for pattern in self.ignored)
            if self.now - self.deleted.get(name, -inf) >= MEMORY and not ignored:
                self.unknown[name] = self.now
        elif fault:
            thing.bad_pose = True
        else:
            self.state(thing, x, frame, stamp)

    def take_set(self, frame: str, stamp: float, rows: list[tuple[str, float, float, str]]) -> None:
        if 0 < stamp < self.set_order and self.now - self.set_received <= REORDERED:
            return
        self.set_received = self.now
        if 0 < stamp <= self.now + 0.5:
            self.set_order = stamp
        if frame == "map":
            self.sets.clear()
        self.sets.append((frame, stamp, self.now, rows))

    def doubt_set(self) -> None:
        for thing in self.things.values():
            thing.bad_pose |= thing.of_set

    def sync(self) -> None:
        """Apply the sets that wait: the newest that can be placed, and refusals of newer ones."""
        usable = [self.is_placed_at(frame, stamp) for frame, stamp, _, _ in self.sets]
        if any(usable):
            last = len(usable) - 1 - usable[::-1].index(True)
            self.use_set(*self.sets[last])
            del self.sets[: last + 1]
        for one in [one for one in self.sets if self.now - one[2] > WAIT]:
            self.sets.remove(one)
            self.doubt_set()
            if not one[3]:
                self.unreadable.add("object_boxes")
            for name, *_ in one[3]:
                if name not in self.things:
                    self.newcomers[name] = True, inf
        self.see()

    def use_set(
        self, frame: str, stamp: float, received: float, rows: list[tuple[str, float, float, str]]
    ) -> None:
        self.newcomers = {name: one for name, one in self.newcomers.items() if not one[0]}
        for name in [n for n, thing in self.things.items() if thing.of_set]:
            if name not in [row[0] for row in rows]:
                del self.things[name]
        now, self.now = self.now, received
        for name, x, size, fault in rows:
            if fault:
                self.refuse(name, fault, of_set=True)
                continue
            thing = self.things.setdefault(name, Thing(size, True))
            thing.size, thing.bad_shape = size, False
            self.state(thing, x + OFFSET * (frame == "odom"), "map", stamp)
        self.now = now
        self.declare()

    def clear(self) -> None:
        for name in self.things:
            self.deleted[name] = self.now
            self.unknown.pop(name, None)
        self.things.clear()
        self.newcomers.clear()
        self.unreadable.clear()
        self.sets.clear()
        self.declare()

    def cycle(self, given: dict[str, Any]) -> None:
        self.sync()
        for name in [n for n, thing in self.things.items() if thing.expiry <= self.now]:
            del self.things[name]
        self.newcomers = {n: one for n, one in self.newcomers.items() if one[1] > self.now}
        for name, thing in self.things.items():
            self.place(thing)
            self.age(name, thing, given)
            since = self.now - thing.received
            thing.overtaken &= since <= REORDERED
            thing.held_back = thing.overtaken and since > REORDERED / 2
        boxes = [
            (thing, thing.x, 0.5 * thing.size + self.growth(name, thing, given))
            for name, thing in self.things.items()
            if thing.x is not None and not self.has(name, thing, given, "ignore")
        ]
        self.pairs = [
            (a, b)
            for (a, xa, ra), (b, xb, rb) in combinations(boxes, 2)
            if self.enabled and self.active and abs(xa - xb) <= ra + rb
        ]

    def place(self, thing: Thing) -> None:
        usable = [k for k, (_, frame, stamp, _) in enumerate(thing.states)
                  if self.is_placed_at(frame, stamp)]  # fmt: skip
        if usable:
            x, frame, thing.stamp, thing.at = thing.states[usable[-1]]
            thing.x = x + OFFSET * (frame == "odom")
            del thing.states[: usable[-1] + 1]
            thing.late = False
        thing.late |= any(self.now - at > WAIT for *_, at in thing.states)
        thing.states = [
            state
            for state in thing.states
            if self.now - state[3] <= (LONGEST_WAIT if state[1] == "odom" else WAIT)
            or state is thing.states[-1]
        ]

    def age(self, name: str, thing: Thing, given: dict[str, Any]) -> None:
        own = last(given["object_timeout_overrides"], name)
        limit = given["object_timeout"] if thing.repeated else 0.0
        limit = limit if own is None else own
        before = thing.stale
        thing.stale = thing.x is not None and 0.0 < float(limit) < self.now - thing.at
        if thing.stale and not before:
            thing.order = 0.0

    def has(self, name: str, thing: Thing, given: dict[str, Any], policy: str) -> bool:
        is_it = (last(given["stale_policy_overrides"], name) or given["stale_policy"]) == policy
        return thing.stale and is_it

    def moved(self, thing: Thing) -> float:
        return SPEED * (self.now - min(thing.at, thing.stamp or inf))

    def growth(self, name: str, thing: Thing, given: dict[str, Any]) -> float:
        collides = self.has(name, thing, given, "collide")
        return min(REACH, self.moved(thing)) if collides else 0.0

    def codes(self, given: dict[str, Any]) -> list[str]:
        found = set(self.of_scene(given))
        for name, thing in self.things.items():
            if self.has(name, thing, given, "ignore"):
                continue
            lost = self.has(name, thing, given, "collide") and self.moved(thing) > REACH
            if thing.bad_pose or thing.bad_shape or thing.held_back:
                found.add("refused")
            elif thing.x is None:
                found.add("unplaced")
            elif thing.late:
                found.add("late_frame")
            elif lost or self.has(name, thing, given, "unknown"):
                found.add("stale")
        return [code for code in ORDER if code in found]

    def of_scene(self, given: dict[str, Any]) -> Iterator[str]:
        if not self.active:
            yield "inactive"
        elif not self.enabled:
            yield "disabled"
        if not (self.things or self.newcomers or self.declared or given["expect_empty"]):
            yield "no_objects"
        if self.newcomers:
            yield "refused"
        for pattern in given["required_objects"]:
            if not any(fnmatch(name, pattern) for name in self.things):
                yield "required_missing"
        for text in given["required_inputs"]:
            topic, limit = text.split(": ")
            since = max(self.heard.get(topic, -inf), -inf)
            if since < self.activated or self.now - since > float(limit):
                yield "input_silent"
        if self.unreadable:
            yield "input_unreadable"
        for name, at in self.unknown.items():
            if name not in self.things and self.now - at < MEMORY:
                yield "unknown_objects"


def last(entries: Sequence[str], name: str) -> str | None:
    """Return the value of the last entry that matches a name."""
    values = [entry.split(": ")[1] for entry in entries if fnmatch(name, entry.split(": ")[0])]
    return values[-1] if values else None


class Frames:
    """odom is known up to a time, and nothing else."""

    waits, description, until = True, "a test", 0

    def lookup(self, frame: str, stamp: int) -> Any:
        if frame != "odom":
            raise RefusedError("unknown frame", frame)
        if stamp > self.until:
            raise RefusedError("extrapolation", frame)
        return np.array([OFFSET, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


class World:
    """The one node of all examples, and its clock."""

    made: World | None = None

    def __init__(self) -> None:
        self.now, self.frames, self.context = START, Frames(), Context()
        self.context.init(domain_id=DOMAIN)
        options = {"use_sim_time": True, "autostart": False, "marker_rate": 0.0}
        options |= {"stale_speed": SPEED, "stale_reach": REACH, "transform_timeout": WAIT}
        self.node = CollisionNode(
            context=self.context,
            namespace=f"{NAMESPACE}/model",  # with a logger of its own, which says nothing
            frames=self.frames,
            steady=lambda: self.now,
            parameter_overrides=[Parameter(name, value=one) for name, one in options.items()],
        )
        self.node.get_logger().set_level(LoggingSeverity.FATAL)

    def advance(self, seconds: float) -> None:
        self.now += seconds
        time = Time(nanoseconds=round(self.now * SECOND), clock_type=ClockType.ROS_TIME)
        clock: Any = self.node.get_clock()
        clock.set_ros_time_override(time)

    def set(self, given: dict[str, Any]) -> None:
        values = {name: one if one != [] else [""] for name, one in given.items()}
        results = self.node.set_parameters([Parameter(n, value=v) for n, v in values.items()])
        assert all(result.successful for result in results), results


@pytest.fixture(autouse=True, scope="module")
def one_node() -> Iterator[None]:
    """End the node after the last example."""
    yield
    if World.made is not None:
        World.made.node.destroy_node()
        World.made.context.try_shutdown()
        World.made = None


NAMES = st.sampled_from(["a/0", "a/1", "b/0"])
ANY = st.sampled_from(["a/0", "a/1", "b/0", "boxes/0", "boxes/1", "a/7", "z/0"])
PLACES = st.integers(0, 5).map(lambda k: 0.7 * k)
SIZES = st.sampled_from([1.0, 2.0])
FRAMES = st.sampled_from(["map", "map", "map", "odom", "lost"])
STAMPS = st.sampled_from([0.0, 0.0, 0.0, -0.3, 5.0, None])
"""Seconds from now on; None: no stamp."""
POSE_FAULTS = st.sampled_from(["", "", "", "pose", "zero", "stamp"])
STEPS = st.sampled_from([0.0503, 0.1103, 0.2311, 0.4703, 0.7117])
GIVEN = st.fixed_dictionaries(
    {
        "object_timeout": st.sampled_from([0.0, 0.5]),
        "object_timeout_overrides": st.sampled_from([[], ["a/1: 0.3"], ["a/*: 0.8", "a/0: 0"]]),
        "stale_policy": st.sampled_from(["unknown", "collide", "keep", "ignore"]),
        "stale_policy_overrides": st.sampled_from([[], ["b/*: keep"], ["a/0: ignore"]]),
        "required_objects": st.sampled_from([[], [], ["b/*"]]),
        "required_inputs": st.sampled_from([[], [], ["object_states: 0.7"]]),
        "ignored_objects": st.sampled_from([[], [], ["z/*"]]),
        "expect_empty": st.booleans(),
    }
)


class EvidenceMachine(RuleBasedStateMachine):
    """Messages go to the node and to the model, and both say what they know."""

    def __init__(self) -> None:
        super().__init__()
        World.made = self.world = World.made or World()
        self.node, self.is_started = self.world.node, False

    @initialize(given=GIVEN)
    def begin(self, given: dict[str, Any]) -> None:
        self.given = given
        self.world.set(given)
        self.start()

    def start(self) -> None:
        self.node.trigger_configure()
        self.world.advance(100.0)
        self.world.frames.until = round(self.world.now * SECOND)
        self.node.trigger_activate()
        self.is_started = True
        self.model = Model(self.world.now, self.world.now)
        self.model.ignored = self.given["ignored_objects"]
        self.tick(0.1103)

    def teardown(self) -> None:
        if self.is_started:
            self.is_started = False
            if self.model.active:
                self.node.trigger_deactivate()
            self.node.trigger_cleanup()

    @rule()
    def restart(self) -> None:
        self.teardown()
        self.start()

    @rule(given=GIVEN)
    def configure(self, given: dict[str, Any]) -> None:
        self.given = given
        self.world.set(given)
        self.tick(0.1103)
        self.model.ignored = given["ignored_objects"]

    @rule(step=STEPS)
    def tick(self, step: float) -> None:
        self.world.advance(step)
        self.model.now = self.world.now
        self.node._run_cycle()
        self.model.cycle(self.given)
        answer = self.node.status.answer
        codes = [reason.code for reason in answer.reasons]
        assert codes == self.model.codes(self.given), (answer.message, self.model.things)
        assert answer.pairs == len(self.model.pairs), self.model.things

    @invariant()
    def known_to_collide(self) -> None:
        if hasattr(self, "model"):
            left = [id(thing) for thing in self.model.things.values()]
            known = [pair for pair in self.model.pairs if {*map(id, pair)} <= {*left}]
            answer = self.node.evidence.answer()
            assert not known or answer.level == b"\2"

    @rule(step=st.sampled_from([0.0503, 0.2311]), known=st.booleans())
    def transforms(self, step: float, known: bool) -> None:
        """Let odom be known up to now; a cycle long enough after that looks at all states."""
        self.model.until = self.world.now + (1.0 if known else -0.1)
        self.world.frames.until = round(self.model.until * SECOND)
        self.tick(0.7117)

    def send(self, topic: str, message: Any, cut: bool = False) -> bool:
        """Send a message, or its first half; return whether the node can read it."""
        data = serialize_message(message)
        self.model.heard[topic] = self.model.now
        self.model.unreadable.discard(topic)
        if topic in ("object_transform", "object_states", "object_poses"):
            self.model.sync()
        if cut:
            self.model.unreadable.add(topic)
            if topic == "object_boxes":
                self.model.doubt_set()
        self.node.inputs.callbacks()[topic](data[: len(data) // 2] if cut else data)
        return not cut

    def header(self, frame: str, ahead: float | None, fault: str = "") -> tuple[Header, float]:
        stamp = 0.0 if ahead is None else self.world.now + ahead
        header = Header(frame_id=frame, stamp=stamp_to_ros(round(stamp * SECOND)))
        if fault == "stamp":
            header.stamp.nanosec = 4_000_000_000
        return header, stamp

    @staticmethod
    def pose(x: float, fault: str) -> list[float]:
        return {"pose": pose(nan), "zero": [x, *[0.0] * 6]}.get(fault, pose(x))

    @rule(
        names=st.lists(NAMES, min_size=1, max_size=2, unique=True),
        x=PLACES, size=SIZES, frame=FRAMES, ahead=STAMPS,
        fault=st.sampled_from(["", "", "", "", "scale", "pose", "stamp", "action"]),
        life=st.sampled_from([0.0, 0.0, 1.0, 2.5]), cut=st.integers(0, 9).map(lambda k: k == 9),
    )  # fmt: skip
    def markers(
        self, names: list[str], x: float, size: float, frame: str, ahead: float | None,
        fault: str, life: float, cut: bool,
    ) -> None:  # fmt: skip
        if frame != "map":  # of markers of an object that come together only the last one counts
            self.node.inputs.markers.apply()
        header, stamp = self.header(frame, ahead, fault)
        life = life if ahead == 0.0 else 0.0
        sent = []
        for name in names:
            marker = cube(key(name), (x, 0, 0), [0.0 if fault == "scale" else size] * 3)
            marker.header, marker.action = header, 7 if fault == "action" else Marker.ADD
            marker.lifetime = duration(life)
            if fault == "pose":
                marker.pose.position.x = nan
            sent.append(marker)
        if self.send("objects", MarkerArray(markers=sent), cut):
            for name in names:
                self.model.add(name, x, size, frame, stamp, fault.replace("action", "scale"), life)

    @rule(names=st.lists(st.one_of(NAMES, ANY), max_size=2, unique=True))
    def delete(self, names: list[str]) -> None:
        sent = [cube(key(name), action=Marker.DELETE) for name in names]
        self.send("objects", MarkerArray(markers=sent))
        self.model.delete(
            *[
                name
                for name in names
                if name not in self.model.things or not self.model.is_of_set(name)
            ]
        )

    @rule(namespace=st.sampled_from(["", "a", "b"]))
    def delete_all(self, namespace: str) -> None:
        self.send("objects", MarkerArray(markers=[cube((namespace, 0), action=Marker.DELETEALL)]))
        names = {**self.model.things, **self.model.newcomers}
        gone = [n for n in names if n.startswith(namespace) and not self.model.is_of_set(n)]
        self.model.delete(*gone)
        if not namespace:
            self.model.declare()

    @rule(name=ANY, x=PLACES, frame=FRAMES, ahead=STAMPS, fault=POSE_FAULTS, cut=st.booleans())
    def transform(
        self, name: str, x: float, frame: str, ahead: float | None, fault: str, cut: bool
    ) -> None:
        header, stamp = self.header(frame, ahead, fault)
        message = TransformStamped(header=header, child_frame_id=name)
        message.transform = transform_to_ros(self.pose(x, fault))
        if self.send("object_transform", message, cut and fault == "zero"):
            self.model.named(name, x, frame, stamp, fault)

    @rule(
        names=st.lists(ANY, max_size=3, unique=True), missing=st.integers(0, 5),
        x=PLACES, frame=FRAMES, ahead=STAMPS, fault=POSE_FAULTS, cut=st.booleans(),
    )  # fmt: skip
    def states(
        self, names: list[str], missing: int, x: float, frame: str, ahead: float | None,
        fault: str, cut: bool,
    ) -> None:  # fmt: skip
        header, stamp = self.header(frame, ahead, fault)
        poses = [self.pose(x + 0.7 * k, fault) for k, _ in enumerate(names)]
        message = states_to_ros(names, np.reshape(poses, (-1, 7)), header)
        if missing == 5 and names:
            message.transforms.pop()
            fault = "missing"
        if self.send("object_states", message, cut and fault == "zero"):
            for k, name in enumerate(names):
                self.model.named(name, x + 0.7 * k, frame, stamp, fault)

    @rule(
        names=st.lists(ANY.filter(lambda n: n != "z/0"), min_size=1, max_size=3, unique=True),
        x=PLACES, frame=FRAMES, ahead=STAMPS, fault=POSE_FAULTS,
        broken=st.sampled_from(["", "", "", "", "cut", "qw", "x", "step"]),
    )  # fmt: skip
    def poses(
        self, names: list[str], x: float, frame: str, ahead: float | None, fault: str, broken: str
    ) -> None:
        header, stamp = self.header(frame, ahead, fault)
        keys = [key(name) for name in names]
        rows = [self.pose(x + 0.7 * k, fault) for k, _ in enumerate(names)]
        numbers = [namespace_number(namespace) for namespace, _ in keys]
        message = poses_to_ros([ident for _, ident in keys], rows, numbers, header)
        if broken == "step":
            message.point_step = 3
        message.fields = [one for one in message.fields if one.name != broken]
        if self.send("object_poses", message, broken == "cut"):
            if broken:
                self.model.unreadable.add("object_poses")
                return
            for k, name in enumerate(names):
                self.model.named(name, x + 0.7 * k, frame, stamp, fault)

    @rule(
        rows=st.lists(st.tuples(PLACES, SIZES, st.sampled_from(["", "", "scale", "pose"])),
                      max_size=2),
        first=st.integers(0, 1), frame=FRAMES, ahead=STAMPS, broken=st.integers(0, 9),
    )  # fmt: skip
    def boxes(
        self, rows: list[tuple[float, float, str]], first: int, frame: str, ahead: float | None,
        broken: int,
    ) -> None:  # fmt: skip
        header, stamp = self.header(frame, ahead, "stamp" if broken == 8 else "")
        ids = [first + k for k, _ in enumerate(rows)]
        sizes = [[0.0 if fault == "scale" else size] * 3 for _, size, fault in rows]
        poses = np.reshape([self.pose(x, fault) for x, _, fault in rows], (-1, 7))
        message = boxes_to_ros(ids, poses, np.reshape(sizes, (-1, 3)), None, header)
        if self.send("object_boxes", message, broken == 9):
            if broken == 8:
                self.model.unreadable.add("object_boxes")
                self.model.doubt_set()
                return
            named = [(f"boxes/{i}", *row) for i, row in zip(ids, rows, strict=True)]
            self.model.take_set(frame, stamp, named)

    @rule()
    def clear(self) -> None:
        self.node._clear(Trigger.Request(), Trigger.Response())
        self.model.clear()

    @rule(on=st.booleans())
    def enable(self, on: bool) -> None:
        self.node._enable(SetBool.Request(data=on), SetBool.Response())
        self.model.enabled, self.model.pairs = on, []

    @rule()
    def pause(self) -> None:
        self.node.trigger_deactivate()
        self.model.active, self.model.pairs = 0.0, []
        self.tick(0.1103)
        self.node.trigger_activate()
        self.model.active = self.model.activated = self.model.now


def key(name: str) -> tuple[str, int]:
    namespace, number = name.split("/")
    return namespace, int(number)


def duration(seconds: float) -> Any:
    from builtin_interfaces.msg import Duration

    return Duration(sec=int(seconds), nanosec=round(seconds % 1 * SECOND))


TestEvidenceMachine = EvidenceMachine.TestCase
TestEvidenceMachine.settings = settings(max_examples=150, stateful_step_count=15, deadline=None)

LISTS = "object_timeout_overrides stale_policy_overrides required_objects required_inputs"
PLAIN: dict[str, Any] = {name: [] for name in (*LISTS.split(), "ignored_objects")}
PLAIN |= {"object_timeout": 0.0, "stale_policy": "unknown", "expect_empty": False}
GOOD = {"x": 0.0, "frame": "map", "ahead": 0.0, "fault": "", "cut": False}
MARKER = {**GOOD, "names": ["b/0"], "size": 1.0, "life": 0.0}
STATE = {**GOOD, "name": "z/0"}
SET = {"rows": [], "first": 0, "frame": "map", "ahead": 0.0, "broken": 0}
REFUSED = [(0.0, 1.0, "scale")]
FOUND = {
    "clear before a cycle": [("markers", MARKER), ("clear", {})],
    "set cleared before a cycle": [("boxes", {**SET, "rows": [(0.0, 1.0, "")]}), ("clear", {})],
    "ignored": [("configure", {"given": PLAIN | {"ignored_objects": ["z/*"]}}),
                ("transform", STATE)],
    "policies": [("configure", {"given": PLAIN | {"stale_policy_overrides": ["b/*: keep"]}})],
    "deleted at once": [("markers", MARKER), ("delete", {"names": ["b/0"]})],
    "newcomer deleted": [("markers", {**MARKER, "fault": "scale"}), ("tick", {"step": 0.0503}),
                         ("delete", {"names": ["b/0"]})],
    "newcomer ended": [("clear", {}), ("markers", {**MARKER, "fault": "scale", "life": 1.0}),
                       ("tick", {"step": 0.7117}), ("tick", {"step": 0.4703})],
    "bulk after delete": [("delete", {"names": ["a/0"]}),
                          ("poses", {**{n: GOOD[n] for n in ("x", "frame", "ahead", "fault")},
                                     "names": ["a/0"], "broken": ""})],
    "refused box": [("boxes", {**SET, "rows": REFUSED}), ("tick", {"step": 0.0503}),
                    ("delete_all", {"namespace": ""})],
    "refused box alone": [("clear", {}), ("boxes", {**SET, "rows": REFUSED})],
    "empty after cut": [("markers", {**MARKER, "cut": True}), ("delete", {"names": []})],
    "refused for longer": [("markers", {**MARKER, "life": 1.0}), ("tick", {"step": 0.7117}),
                           ("markers", {**MARKER, "life": 1.0, "fault": "scale"}),
                           ("tick", {"step": 0.4703})],
    "newer set refused": [("boxes", {**SET, "rows": [(0.0, 1.0, "")]}),
                          ("boxes", {**SET, "rows": [(0.7, 1.0, "")], "frame": "lost"}),
                          ("tick", {"step": 0.4703})],
}  # fmt: skip
"""Sequences after which the node claimed something else."""


@pytest.mark.parametrize("steps", FOUND.values(), ids=FOUND)
def test_what_the_machine_found(steps: list[tuple[str, dict[str, Any]]]) -> None:
    machine = EvidenceMachine()
    machine.begin(PLAIN)
    try:
        for name, given in steps:
            getattr(machine, name)(**given)
        machine.tick(0.0503)
    finally:
        machine.teardown()

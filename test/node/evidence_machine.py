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

"""The real node beside the slow model, with its clocks, publishers and faults in our hand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial, wraps
from math import nan
from random import Random
from typing import Any, TypeAlias

import numpy as np
from evidence_model import Model
from evidence_sources import Source
from evidence_things import ARM, CHANGES, EDGE, ORDER, Robot
from evidence_world import (
    ANY,
    EITHER,
    FRAMES,
    FRONT,
    GIVEN,
    JOINTS,
    NAMES,
    PLACES,
    PLAIN,
    POSE_FAULTS,
    RARELY,
    ROBOT_TOPICS,
    SENSORS,
    SHORTEST_LIFE,
    SIZES,
    STAMPS,
    STEPS,
    TOPICS,
    UNKNOWN,
    USUALLY,
    WATCHED,
    Builder,
    World,
    rule,
)
from geometry_msgs.msg import Point, TransformStamped
from objects_rig import SECOND
from rclpy.serialization import serialize_message
from rig import STATUS, cube, pose
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray
from walks import Step, one_of, repeated, several

from obb_collision.node import boxes_to_ros, namespace_number, poses_to_ros
from obb_collision.node.messages import conversions as cv
from obb_collision.node.objects.table import OF_SOURCE


def row(random: Random) -> tuple[float, float, str]:
    """Draw a row of a set of boxes."""
    return PLACES(random), SIZES(random), random.choice(["", "", "scale", "pose"])


def of_robot(step: Any) -> Any:
    """Let a step be none where there is no robot."""

    @wraps(step)
    def go(machine: Any, *given: Any, **named: Any) -> None:
        if machine.has_robot:
            step(machine, *given, **named)

    return go


Ahead: TypeAlias = "float | None"


class EvidenceMachine:
    """Messages go to the node and to the model, and both say what they know."""

    is_started = False

    def begin(
        self, has_robot: bool = False, has_sensors: bool = False, scene: Sequence[float] = (),
        **given: Any,
    ) -> None:  # fmt: skip
        self.given, self.scene = PLAIN | given, scene
        self.world = World.get(has_robot, has_sensors)
        self.node: Any = self.world.node
        self.has_robot, self.has_sensors = has_robot, has_sensors
        self.world.begin()
        self.world.set(self.given)
        self.start()

    @classmethod
    def go(cls, steps: Sequence[Step]) -> None:
        """Go through steps, of which the first one begins."""
        machine = cls()
        try:
            for name, arguments in steps:
                getattr(machine, name)(**arguments)
                machine.look()
        finally:
            machine.teardown()

    def start(self) -> None:
        self.node.trigger_configure()
        self.builder: Any = Builder()
        shapes: Any = self.node.objects.shapes
        shapes.builder = shapes.requests._builder = self.builder
        self.node.time._steady = lambda: 0  # of the machine, which may be busy
        self.take = self.node.subscribed._callbacks
        self.world.advance(100.0)
        self.world.frames.spans["odom"] = 0, round(self.world.now * SECOND)
        for topic, senders in self.node.subscribed.senders.items():
            senders.gone = partial(self.gone, topic)
        self.node.count_publishers = self.count_publishers
        self.speaker, self.losing = 1, set[str]()
        robot = Robot() if self.has_robot else None
        sensors = SENSORS if self.has_sensors else ()
        self.model = Model(
            self.world.now,
            self.world.steady,
            self.world.now,
            robot,
            [Source(name, self.has_robot and name == FRONT) for name in sensors],
            [WATCHED],
        )
        self.node.trigger_activate()
        self.is_started = True
        self.set_model()
        self.tick(0.1103)
        for name, x in zip(("a/0", "a/1", "b/0"), self.scene, strict=False):
            self.markers([name], x)
        if robot is not None:
            self.describe(EDGE)
            self.base()
            self.joints([1.4, 3.0])
            self.tick()
        if self.has_sensors:
            self.see_all()
            self.tick()

    def see_all(self) -> None:
        """Let every sensor deliver."""

    def teardown(self) -> None:
        if self.is_started:
            self.is_started = False
            if self.model.active:
                self.node.trigger_deactivate()
            self.node.trigger_cleanup()

    @rule(0.3)
    def restart(self) -> None:
        self.teardown()
        self.start()

    def set_model(self) -> None:
        self.model.ignored = self.given["ignored_objects"]
        self.model.by_stamp = self.given["judge_ages"] != "receipt"
        self.model.joints_age = self.given["joint_timeout"] > 0.0

    @rule(**GIVEN)
    def configure(self, **given: Any) -> None:
        self.given = PLAIN | given
        self.world.set(self.given)
        self.model.by_stamp = self.given["judge_ages"] != "receipt"
        self.model.joints_age = self.given["joint_timeout"] > 0.0
        self.tick(0.1103)
        self.set_model()

    def gone(self, topic: str, senders: Iterable[int]) -> set[int]:
        return {one for one in senders if (topic, one % 10) in self.model.gone}

    @rule(3.0, who=one_of([1, 2]), loses=several([*TOPICS, *ROBOT_TOPICS, *SENSORS], 0, 1))
    def turn(self, who: int = 2, loses: Sequence[str] = ()) -> None:
        """Let one of two publishers send from now on; loses: topics whose next message is lost."""
        self.speaker = who
        self.losing.update(loses)

    @rule(who=one_of([1, 2]))
    def end(self, who: int = 2) -> None:
        """End a publisher of every topic; if it speaks again, it never was."""
        self.apply()
        self.model.gone |= {(topic, who) for topic in self.node.monitors}
        self.tick()

    @rule(0.5, there=EITHER)
    def twin(self, there: bool = True) -> None:
        """Let another node publish this one's status, or no longer."""
        self.model.has_twin = there
        self.tick()

    def count_publishers(self, topic: str) -> int:
        return 1 + (self.model.has_twin and topic.endswith(STATUS))

    @rule(3.0, step=STEPS)
    def tick(self, step: float = 0.0503) -> None:
        if step > SHORTEST_LIFE:  # what ends while it waits is never seen
            self.apply()
        self.world.advance(step)
        self.cycle()

    def cycle(self, fails: str = "", waited: bool = False) -> None:
        """Let the node run a cycle, and compare what it says with what is known."""
        if self.model.now != self.world.now:
            self.model.ticked = self.world.steady
        self.model.now, self.model.steady = self.world.now, self.world.steady
        self.node.run_cycle()
        self.model.cycle(self.given, fails, waited)
        self.compare()
        if not fails:
            self.compare_objects()
        assert bool(self.node.evidence.not_known()) == bool(self.model.codes(self.given))

    def compare(self, *more: str) -> None:
        """Compare what the node says; more: codes that do not come from the model."""
        pairs, known = self.model.left(), {*self.model.codes(self.given), *more}
        codes, level = [code for code in ORDER if code in known], 2 if pairs else 3 if known else 0
        published: Any = self.node.status._published
        found = [reason[0] for reason in published[2:-1]]
        assert found == codes, (found, codes, self.model.things)
        assert published[0] == bytes([level])
        answer = self.node.status.answer
        assert answer.pairs == len(pairs), (answer.message, self.model.things)
        self.world.reached.update([("free", "", "collides", "unknown")[level], *codes])
        self.world.reached.update(self.model.kinds(codes, self.given))

    def compare_objects(self) -> None:
        """Compare what there is: by whom it came, its place, its size, and that it is the same."""
        objects, things = self.node.objects, self.model.things
        table, scene = objects.table, objects.scene
        owners = {
            cv.name_from_key(key): bool(table.of_set[slot])
            for key, slot in table.slots.items()
            if not table.of_robot[slot] and table.of_set[slot] != OF_SOURCE
        }
        assert owners == {name: thing.of_set for name, thing in things.items()}
        placed = {n: thing for n, thing in things.items() if thing.x is not None and thing.shaped}
        slots = np.array([scene.index(name) for name in placed], np.int64)
        boxes, serials = scene.objects.store.boxes(slots), scene.objects.store.born[slots].tolist()
        for row, (name, thing) in enumerate(placed.items()):
            assert thing.serial in (-1, serials[row]), "another object"
            thing.serial = serials[row]
            edge = 0.5 * thing.size + self.model.growth(name, thing, self.given)
            assert np.abs(boxes.centers[row] - (thing.x, 0.0, 0.0)).max() < 1e-9
            assert np.abs(boxes.half_extents[row] - edge).max() < 1e-9
        for name, thing in self.model.seen_things.items():
            points = np.sort(scene.objects.shape_of(name).points[:, 0])
            assert np.allclose(points, sorted(thing.points), atol=1e-6), (name, points, thing)

    def look(self) -> None:
        """Look between two cycles: what is known to collide is no less so."""
        self.model.look()
        answer = self.node.evidence.answer()
        self.model.codes(self.given)  # both look at the transforms of bases
        assert not self.model.left() or answer.level == b"\2"

    def apply(self) -> None:
        """Apply what waits: else only the last of several messages about an object may count."""
        self.node.inputs.markers.apply()
        self.node.inputs.boxes.apply()
        self.model.sync()

    @rule(2.0, known=EITHER)
    def transforms(self, known: bool = True) -> None:
        """Let odom be known up to now; a cycle long enough after that looks at all states."""
        self.model.until = self.world.now + (1.0 if known else -0.1)
        self.world.frames.spans["odom"] = 0, round(self.model.until * SECOND)
        self.tick(0.7117)

    def send(self, topic: str, message: Any, cut: bool = False, end: int | None = None) -> bool:
        """Send a message, or its first bytes, half of them; return whether it can be read."""
        data, monitor = serialize_message(message), self.node.monitors[topic]
        lost = topic in self.losing
        self.losing.discard(topic)
        if lost:
            monitor.lose(1, self.node.now() if topic in CHANGES else None)
        monitor.sender = 10 * (1 + list(self.node.monitors).index(topic)) + self.speaker
        self.model.hear(topic, self.speaker, lost)
        if topic in ("object_transform", "object_states", "object_poses"):
            self.model.sync()
        if cut:
            if topic == "object_boxes":
                self.model.doubt_set(is_read=False)
            self.model.cannot_read()
        self.take[topic](data[: end or len(data) // 2] if cut else data)
        return not cut

    def header(self, frame: str, ahead: float | None, fault: str = "") -> tuple[Header, float]:
        stamp = 0.0 if ahead is None else self.world.now + ahead
        header = Header(frame_id=frame, stamp=cv.stamp_to_ros(round(stamp * SECOND)))
        if fault == "stamp":
            header.stamp.nanosec = 4_000_000_000
        return header, stamp

    @staticmethod
    def pose(x: float, fault: str) -> list[float]:
        return {"pose": pose(nan), "zero": [x, *[0.0] * 6]}.get(fault, pose(x))

    @rule(
        3.0, names=several(NAMES, 1, 2), x=PLACES, size=SIZES, frame=FRAMES, ahead=STAMPS,
        fault=one_of(["", "", "", "", "", "", "", "scale", "pose", "stamp", "action"]),
        life=one_of([0.0, 0.0, 0.0, 1.0, 2.5]), cut=RARELY, locked=EITHER,
    )  # fmt: skip
    def markers(
        self, names: Sequence[str] = ("b/0",), x: float = 0.0, size: float = 1.0,
        frame: str = "map", ahead: Ahead = 0.0, fault: str = "", life: float = 0.0,
        cut: bool = False, locked: bool = False,
    ) -> None:  # fmt: skip
        if frame != "map":  # of those that come together only the last counts
            self.apply()
        header, stamp = self.header(frame, ahead, fault)
        life = life if ahead == 0.0 else 0.0
        sent = []
        for name in names:
            marker = cube(key(name), (x, 0, 0), [0.0 if fault == "scale" else size] * 3)
            marker.header, marker.action = header, 7 if fault == "action" else Marker.ADD
            marker.lifetime = cv.duration_to_ros(life)
            marker.frame_locked = locked = locked and frame == "odom"
            if fault == "pose":
                marker.pose.position.x = nan
            sent.append(marker)
        if self.send("objects", MarkerArray(markers=sent), cut):
            alone = fault == "action" or any(map(self.model.is_of_set, names))
            for name in names:
                fault = fault.replace("action", "scale")
                self.model.add(name, x, size, frame, stamp, fault, life, locked=locked)
            if alone:  # a deletion that comes with it would say nothing
                self.apply()

    @rule(names=several([*NAMES, *ANY, UNKNOWN], 0, 2))
    def delete(self, names: Sequence[str] = ()) -> None:
        sent = [cube(key(name), action=Marker.DELETE) for name in names]
        self.send("objects", MarkerArray(markers=sent))
        self.model.delete(*(name for name in names if not self.model.is_of_set(name)))

    @rule(0.7, namespace=one_of(["", "a", "b", "boxes"]))
    def delete_all(self, namespace: str = "") -> None:
        if self.model.deleting or not all(thing.seen for thing in self.model.things.values()):
            self.apply()  # else nobody remembers what came and went at once
        self.send("objects", MarkerArray(markers=[cube((namespace, 0), action=Marker.DELETEALL)]))
        names = {*self.model.things, *(name for name, _ in self.model.newcomers)}
        start = namespace and f"{namespace}/"
        gone = [n for n in names if n.startswith(start) and not self.model.is_of_set(n)]
        self.model.delete(*gone, is_named=False)
        if not namespace:
            self.model.declare()
            self.model.missed.pop("objects", None)

    @rule(
        2.0, name=one_of([*NAMES, *NAMES, *ANY, UNKNOWN]), x=PLACES, frame=FRAMES, ahead=STAMPS,
        fault=POSE_FAULTS, cut=EITHER,
    )  # fmt: skip
    def transform(
        self, name: str = "z/0", x: float = 0.0, frame: str = "map", ahead: Ahead = 0.0,
        fault: str = "", cut: bool = False,
    ) -> None:  # fmt: skip
        header, stamp = self.header(frame, ahead, fault)
        message = TransformStamped(header=header, child_frame_id=name)
        message.transform = cv.transform_to_ros(self.pose(x, fault))
        if self.send("object_transform", message, cut and fault == "zero"):
            self.model.named(name, x, frame, stamp, fault)

    @rule(
        2.0, names=several([*ANY, UNKNOWN], 0, 3), missing=RARELY, x=PLACES, frame=FRAMES,
        ahead=STAMPS, fault=POSE_FAULTS, cut=EITHER, speed=one_of([None, None, 0.0, 0.9]),
    )  # fmt: skip
    def states(
        self, names: Sequence[str] = ("b/0",), missing: bool = False, x: float = 0.0,
        frame: str = "map", ahead: Ahead = 0.0, fault: str = "", cut: bool = False,
        speed: float | None = None,
    ) -> None:  # fmt: skip
        header, stamp = self.header(frame, ahead, fault)
        poses = [self.pose(x + 0.7 * k, fault) for k, _ in enumerate(names)]
        one = [[0.0, speed or 0.0, 0.0, 0.0, 0.0, 0.0]]
        twists = None if speed is None else np.repeat(one, len(names), axis=0)
        message = cv.states_to_ros(names, np.reshape(poses, (-1, 7)), header, twists)
        if missing and names:
            message.transforms.pop()
            fault = "missing"
        if self.send("object_states", message, cut and fault == "zero"):
            for k, name in enumerate(names):
                self.model.named(name, x + 0.7 * k, frame, stamp, fault, speed)

    @rule(
        names=several(ANY, 1, 3), x=PLACES, frame=FRAMES, ahead=STAMPS, fault=POSE_FAULTS,
        broken=one_of(["", "", "", "", "cut", "qw", "x", "step"]),
    )  # fmt: skip
    def poses(
        self, names: Sequence[str] = ("b/0",), x: float = 0.0, frame: str = "map",
        ahead: Ahead = 0.0, fault: str = "", broken: str = "",
    ) -> None:  # fmt: skip
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
                self.model.unreadable.add(self.model.sender)
                return
            for k, name in enumerate(names):
                self.model.named(name, x + 0.7 * k, frame, stamp, fault)

    @rule(
        2.0, rows=repeated(row, 0, 2), first=one_of([0, 1]), frame=FRAMES, ahead=STAMPS,
        broken=one_of(range(10)),
    )  # fmt: skip
    def boxes(
        self, rows: Sequence[tuple[float, float, str]] = ((0.0, 1.0, ""),), first: int = 0,
        frame: str = "map", ahead: Ahead = 0.0, broken: int = 0,
    ) -> None:  # fmt: skip
        # a set that is refused applies those before it, and markers come first
        self.node.inputs.markers.apply()
        self.model.sync(has_sets=False)
        header, stamp = self.header(frame, ahead, "stamp" if broken == 8 else "")
        ids = [first + k for k, _ in enumerate(rows)]
        sizes = [[0.0 if fault == "scale" else size] * 3 for _, size, fault in rows]
        poses = np.reshape([self.pose(x, fault) for x, _, fault in rows], (-1, 7))
        message = boxes_to_ros(ids, poses, np.reshape(sizes, (-1, 3)), None, header)
        if self.send("object_boxes", message, broken == 9):
            if broken == 8:
                self.model.doubt_set(is_read=False)
                return
            named = [(f"boxes/{i}", *row) for i, row in zip(ids, rows, strict=True)]
            self.model.take_set(frame, stamp, named)

    @rule(name=one_of(NAMES), x=PLACES, size=SIZES, ahead=STAMPS, life=one_of([0.0, 0.0, 2.5]))
    def mesh(
        self, name: str = "b/0", x: float = 0.0, size: float = 1.0, ahead: Ahead = 0.0,
        life: float = 0.0,
    ) -> None:  # fmt: skip
        """Send a marker whose shape has to be built."""
        header, stamp = self.header("map", ahead)
        life = life if ahead == 0.0 else 0.0
        corners = [Point(), Point(x=size), Point(y=size)]
        marker = cube(key(name), (x, 0, 0), type=Marker.TRIANGLE_LIST, points=corners)
        marker.header, marker.lifetime = header, cv.duration_to_ros(life)
        self.apply()
        self.send("objects", MarkerArray(markers=[marker]))
        self.apply()
        self.model.add(name, x, size, "map", stamp, "", life, mesh=True)

    @rule(what=one_of(["built", "built", "failed"]))
    def deliver(self, what: str = "built") -> None:
        """Deliver all shapes that are wanted, or say that they cannot be built."""
        self.builder.delivers = self.model.delivers = what
        self.tick()

    @rule(0.5, edge=one_of([EDGE, 2 * EDGE, 0.0]))
    @of_robot
    def describe(self, edge: float = EDGE) -> None:
        """Send a description, or with 0 a text that is none."""
        self.send(f"{ARM}/robot_description", String(data=urdf(edge) if edge else "none"))
        reading = self.node.robots.robots[0].reading
        if reading is not None:
            reading.join()
        self.model.describe(edge)
        if not edge:
            self.model.unreadable.add(self.model.sender)
        self.tick()

    @rule(x=PLACES, frame=FRAMES, ahead=STAMPS, fault=POSE_FAULTS)
    @of_robot
    def base(self, x: float = 0.0, frame: str = "map", ahead: Ahead = 0.0, fault: str = "") -> None:
        """Send where the robot stands."""
        header, stamp = self.header(frame, ahead, fault)
        message = TransformStamped(header=header, child_frame_id=ARM)
        message.transform = cv.transform_to_ros(self.pose(x, fault))
        self.send("object_transform", message)
        self.model.take_base(x, frame, stamp, fault)

    @rule(
        2.0, values=one_of(JOINTS), ahead=STAMPS,
        fault=one_of(["", "", "", "stamp", "length", "cut"]),
    )  # fmt: skip
    @of_robot
    def joints(self, values: Any = (0.0, 1.4), ahead: Ahead = 0.0, fault: str = "") -> None:
        """Send values of some joints."""
        header, stamp = self.header("map", ahead, fault)
        named = {f"j{k}": value for k, value in enumerate(values) if value is not None}
        message = JointState(header=header, name=list(named), position=list(named.values()))
        message.velocity = [0.0] * len(named)
        if fault == "length":
            message.position.append(0.0)
        if self.send(f"{ARM}/joint_states", message, fault == "cut", 20):
            self.model.take_joints(values, stamp, fault)

    @rule(0.5)
    def clear(self, fails: bool = False) -> None:
        self.node._clear(Trigger.Request(), Trigger.Response())
        self.model.clear(fails)

    @rule(0.5, on=USUALLY)
    def enable(self, on: bool = True) -> None:
        self.node._enable(SetBool.Request(data=on), SetBool.Response())
        self.model.enabled, self.model.pairs = on, []

    @rule(0.5)
    def pause(self) -> None:
        self.node.trigger_deactivate()
        self.model.active, self.model.pairs = False, []
        self.tick(0.1103)
        self.node.trigger_activate()
        self.model.active, self.model.activated = True, self.model.steady


def key(name: str) -> tuple[str, int]:
    namespace, number = name.split("/")
    return namespace, int(number)


def urdf(edge: float) -> str:
    """Return a robot of two links that two joints move apart along x."""
    text = "<robot name='arm'>"
    for link, size in (("base", EDGE), ("middle", 0.0), ("hand", edge)):
        box = f"<geometry><box size='{size} {size} {size}'/></geometry>"
        text += f"<link name='{link}'>{f'<collision>{box}</collision>' if size else ''}</link>"
    for k, (parent, child) in enumerate((("base", "middle"), ("middle", "hand"))):
        text += f"<joint name='j{k}' type='prismatic'><parent link='{parent}'/><axis xyz='1 0 0'/>"
        text += f"<child link='{child}'/><limit lower='-9' upper='9'/></joint>"
    return f"{text}</robot>"

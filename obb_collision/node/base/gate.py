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


"""The gate of a mobile base: each command is answered by one that is safe, on the newest scene."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Collection, Iterable
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PolygonStamped, Twist, TwistStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float32, Header
from std_srvs.srv import SetBool

from obb_collision.node.base import bond
from obb_collision.node.base.bond import Bond
from obb_collision.node.base.drawing import Drawing
from obb_collision.node.base.objects import SceneObjects
from obb_collision.node.base.observations import (
    MESSAGES,
    BaseFrames,
    InvalidError,
    Lookup,
    Observation,
    placed,
    without,
)
from obb_collision.node.messages.conversions import stamp_from_ros, stamp_to_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.optional import optional
from obb_collision.node.parameters.base import GateParameters
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.typing import Floats
from obb_collision.zones import outlines
from obb_collision.zones.gate import ZERO, Decision, Surroundings, decide
from obb_collision.zones.zones import (
    ACTIONS,
    APPROACH,
    NOTHING,
    STOP,
    Exclusion,
    Zone,
    circle,
    nothing_to_place,
    polygon,
)

StateMessage: Any = optional("nav2_msgs.msg", "CollisionMonitorState")
ToggleType: Any = optional("nav2_msgs.srv", "Toggle")
"""None where nav2_msgs cannot be used."""

INVALID_SOURCE = "invalid source"
"""In place of a zone in the state: what nav2 calls it."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LOOK, BEAT = 0.02, 0.1
"""Seconds between two looks for a command that does not come, and between two zeros then."""
OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE
)  # fmt: skip
LARGEST = 1e12
"""Of a component of a command: more may overflow."""
FASTEST = 1e3
"""Metres: objects are looked for up to this far, however fast a command is."""


class Fault(NamedTuple):
    """Why nothing can be said: a code, whom it is about, and details."""

    code: str
    who: str = ""
    detail: str = ""


NO_FAULT = Fault("")
UNANSWERED = ("command_invalid", "inactive", "unconfigured")
"""Codes with which nav2's monitor says nothing at all."""


class View(NamedTuple):
    """What the gate asks the node for."""

    refresh: Callable[[], None]
    """Takes in the newest messages."""
    faults: Callable[[], Iterable[Fault]]
    """What is missing to know about the objects of the scene."""
    objects: SceneObjects
    odom: Lookup
    """Looks poses up in the frame of odometry, and the others in those of base and scene."""
    base: Lookup
    scene: Lookup


class Gate:
    """Answers commands; one answer per command.

    caught: counts an unforeseen error; now: time of the node's clock (ns); steady: seconds.
    """

    def __init__(
        self,
        node: Node,
        parameters: Parameters,
        caught: Callable[[str, Exception], None],
        now: Callable[[], int],
        steady: Callable[[], float],
    ) -> None:
        self._node, self._values, self._caught = node, parameters, caught
        self.now, self._steady = now, steady
        self.zones: list[Zone] = []
        self._sensors: list[Observation] = []
        self._exclusions: list[Exclusion] = []
        self._view: View | None = None
        """None while the node is not configured."""
        self.active, self.enabled = False, bool(parameters.enabled)
        self._stamped = bool(parameters.enable_stamped_cmd_vel)
        self._lock = threading.RLock()
        self._drawing = Drawing(node, parameters.base_frame_id)
        self._bond: Bond | None = None
        if bond.Status is not None and not parameters.autostart:
            self._bond = Bond(node, parameters.bond_heartbeat_period)
        self._said: tuple[object, ...] = ()
        self._zone = ""
        self._moves, self._stopped = True, 0
        """Whether the last command sent was not zero, and when (ns) the first zero after it was."""
        self._heard = self._sent = steady()
        self.commands, self.longest = 0, 0.0
        """Commands that came, and the longest time (s) until one was dealt with."""
        self.text, self.values = "", dict[str, object]()
        """The last state."""
        self._ended = threading.Event()
        self._open()
        self._thread = threading.Thread(target=self._watch, name="base gate", daemon=True)
        self._thread.start()

    def _open(self) -> None:
        """Create publishers, and subscribe to commands."""
        node, parameters = self._node, self._values
        kind = TwistStamped if self._stamped else Twist
        self._out = node.create_publisher(kind, parameters.cmd_vel_out_topic, 1)
        self._state = node.create_publisher(DiagnosticArray, "~/base_state", LATCHED)
        self._nav2_state = None
        if parameters.state_topic and StateMessage is not None:
            self._nav2_state = node.create_publisher(StateMessage, parameters.state_topic, 1)
        elif parameters.state_topic:
            node.get_logger().warning("state_topic: nav2_msgs cannot be used, ~/base_state is")
        self._tell(None, Fault("unconfigured"))
        heard = node.create_subscription(kind, parameters.cmd_vel_in_topic, self._command, 1)
        if heard.topic_name == self._out.topic_name:  # it would answer its own answers
            raise ValueError(f"cmd_vel_in_topic and cmd_vel_out_topic are {heard.topic_name!r}")

    @property
    def _given(self) -> GateParameters:
        given = self._values.gate
        assert given is not None
        return given

    def prepare(self, taken: Collection[str], most: Callable[[], int]) -> dict[str, type]:
        """Read zones and sources; return the topics of sources and their types. ValueError.

        taken: topics of other inputs; most: points of a message.
        """
        given, kinds = self._given, dict[str, type]()
        self.zones, self._exclusions = given.zones(), given.exclusions()
        self._sensors = []
        for settings in given.sources():
            topic, kind = settings.topic, MESSAGES[settings.type]
            if topic in taken or kinds.setdefault(topic, kind) is not kind:
                raise ValueError(f"{settings.name}.topic: another input has {topic!r}")
            self._sensors.append(Observation(settings, most, self._values.fail_closed))
        return kinds

    def take(self, topic: str, data: bytes, now: int) -> None:
        """Store a serialised message of a source; RefusedError for one that cannot be used."""
        for sensor in self._sensors:
            if sensor.settings.topic == topic:
                sensor.take(data, now)

    def begin(self, view: View, undo: Callable[..., object]) -> None:
        """Serve, being configured; undo: takes what ends that."""
        node, given = self._node, self._given
        kind, name = (SetBool, "data") if ToggleType is None else (ToggleType, "enable")

        def toggle(request: Any, response: Any) -> Any:
            self.enabled = bool(getattr(request, name))
            response.success = True
            response.message = "zones act" if self.enabled else "zones are off"
            return response

        undo(node.destroy_service, node.create_service(kind, "~/toggle", toggle))
        self._frames = BaseFrames(self._values, view.odom, view.base)
        self._in_scene = BaseFrames(self._values, view.scene, view.base)
        self._view = view
        for zone in self.zones:
            topic = given.topic_of(zone.name)
            if topic and zone.outline is None and not zone.parts:
                self._add_shape(zone, topic, undo)
            shown = given.shown_as(zone.name)
            if shown:
                undo(node.destroy_publisher, self._drawing.show(zone.name, shown))

    def apply(self) -> None:
        """Use the parameters that are live."""
        self._exclusions = self._given.exclusions()
        for zone, changed in zip(self.zones, self._given.zones(), strict=True):
            zone.settings, zone.parts = changed.settings, changed.parts
            zone.outline = changed.outline or zone.outline
        for sensor, settings in zip(self._sensors, self._given.sources(), strict=True):
            sensor.settings, sensor.strict = settings, self._values.fail_closed

    def _add_shape(self, zone: Zone, topic: str, undo: Callable[..., object]) -> None:
        """Subscribe to the shape of a zone."""
        node, given = self._node, self._given
        is_circle, is_footprint = given.is_circle(zone.name), given.is_footprint(zone.name)

        def take(message: Any) -> None:
            try:
                if is_circle:
                    zone.outline = circle(message.data)
                    return
                corners = [(p.x, p.y, p.z) for p in message.polygon.points]
                self._take_polygon(zone, np.array(corners), message.header, is_footprint)
            except (ValueError, InvalidError, RefusedError) as error:
                if self._values.fail_closed:
                    zone.outline = None
                node.get_logger().warning(f"{topic}: {error}", throttle_duration_sec=5.0)

        qos = LATCHED if given.is_latched(zone.name) else QoSProfile(depth=1)
        kind = Float32 if is_circle else PolygonStamped
        undo(node.destroy_subscription, node.create_subscription(kind, topic, take, qos))

    def _take_polygon(self, zone: Zone, corners: Floats, header: Header, moves: bool) -> None:
        """Give a zone a polygon; moves: in another frame it moves with the base since its stamp."""
        frame, stamp = header.frame_id, stamp_from_ros(header.stamp)
        polygon(corners.reshape(-1, 3)[:, :2])

        def place(now: int) -> None:
            zone.outline = None
            pose = self._frames.place(frame, now, now)
            zone.outline = polygon(placed(pose, corners)[:, :2])

        zone.place = nothing_to_place
        if frame in ("", self._values.base_frame_id):
            zone.outline = polygon(corners[:, :2])
        elif moves:
            pose = self._frames.at_once(frame, stamp)
            zone.outline = polygon(placed(pose, corners)[:, :2])
        else:
            zone.place = place

    def end(self) -> None:
        """Serve no more: the node is not configured."""
        self._view = None
        self.rest("unconfigured")

    def activate(self) -> None:
        """Begin to answer."""
        self.active, self._moves, self._zone = True, True, ""
        for zone in self.zones:
            zone.is_active, zone.in_a_row = False, 0
        if self._bond is not None:
            self._bond.begin()

    def rest(self, code: str) -> None:
        """Answer no more; a base that moves is stopped."""
        if self.active and self._bond is not None:
            self._bond.end()
        self.active = False
        if self._values.fail_closed and self._node.context.ok():
            with self._lock:
                self._tell(None, Fault(code))
                if self._moves:
                    self._publish(ZERO, None)

    def close(self) -> None:
        """Stop the base, and end."""
        if not self._ended.is_set():
            self._ended.set()
            self._thread.join()
            self.rest("shutting_down")

    def _command(self, message: Any) -> None:
        """Answer a command."""
        self._heard = began = self._steady()
        twist = message.twist if self._stamped else message
        header = message.header if self._stamped else None
        strict = self._values.fail_closed
        try:
            answer = self.decision(twist, strict)
        except Exception as error:
            self._caught("gate", error)
            answer = None, Fault("internal_error", detail=str(error))
        decision, fault = answer
        limit = self._values.command_timeout
        if strict and 0.0 < limit < self._steady() - began:
            decision, fault = None, Fault("overload", detail="the answer came too late")
        if decision is not None or strict or fault.code not in UNANSWERED:
            with self._lock:
                if strict and decision is not None and not self.active:  # ended meanwhile
                    decision, fault = None, Fault("inactive")
                self._send(ZERO if decision is None else decision.twist, header, strict)
                self._tell(decision, fault)
        self.commands += 1
        self.longest = max(self.longest, self._steady() - began)

    def decision(self, twist: Twist, strict: bool) -> tuple[Decision | None, Fault]:
        """Return the answer, or None and why nothing can be said."""
        parts = [getattr(side, axis) for side in (twist.linear, twist.angular) for axis in "xyz"]
        if not all(abs(part) <= LARGEST for part in parts):
            return None, Fault("command_invalid", detail="not finite, or too large")
        view = self._view
        if view is None or not self.active:
            return None, Fault("inactive" if view else "unconfigured")
        view.refresh()
        now, command = self.now(), (parts[0], parts[1], parts[5])
        points, fault = self._see(now)
        self._drawing.draw_points(points, now)
        decision = Decision(command)
        if self.enabled and not fault.code:
            decision, fault = self._decide(command, view, points, now, strict)
        self._drawing.draw_zones(self.zones, decision, now)
        return (None if fault.code else decision), fault

    def _see(self, now: int) -> tuple[dict[str, Floats], Fault]:
        """Return the points of sources in order, up to the first one that is invalid and why."""
        points: dict[str, Floats] = {}
        for sensor in self._sensors:
            settings = sensor.settings
            try:
                if settings.enabled:
                    seen = sensor.points(self._frames, now)
                    points[settings.name] = without(seen, self._exclusions, self._frames, now)
            except InvalidError as error:
                if settings.source_timeout:
                    return points, Fault(error.code, settings.name, error.detail)
        return points, NO_FAULT

    def _decide(
        self,
        command: outlines.Twist,
        view: View,
        points: dict[str, Floats],
        now: int,
        strict: bool,
    ) -> tuple[Decision, Fault]:
        """Return what zones make of a command, and with ``strict`` what is not known."""
        free = Decision(command)
        if strict:
            for fault in view.faults():
                return free, fault
        for zone in self.zones:
            try:
                zone.place(now)
            except InvalidError as error:
                if strict and zone.settings.enabled:
                    return free, Fault(error.code, zone.name, error.detail)
            zone.shape(command)
            if strict and zone.is_missing:
                return free, Fault("unplaced", zone.name, "its shape is not known")
        reach = self._reach(command)
        try:
            around = view.objects.about(points, lambda: self._in_scene.base_pose(now), reach)
        except InvalidError as error:
            if strict:
                return free, Fault("base_unknown", detail=error.detail)
            around = Surroundings(points)
        return decide(command, self.zones, around), NO_FAULT

    def _reach(self, command: outlines.Twist) -> float:
        """Return how far (m) objects may be from the base and count."""
        ways = [0.0]
        for zone in self.zones:
            shapes = zone.outline, *(part.outline for part in zone.parts)
            reach = max((shape.reach for shape in shapes if shape is not None), default=0.0)
            ahead = zone.settings.time_before_collision * (zone.settings.action == APPROACH)
            ways.append(reach + math.hypot(*command[:2]) * ahead)
        return min(max(ways), FASTEST)

    def _send(self, twist: outlines.Twist, header: Any, strict: bool) -> None:
        """Publish a command; without ``strict`` zeros end after a while."""
        now = self.now()
        if any(twist):
            self._publish(twist, header)
            return
        if self._moves:
            self._stopped = now
        if strict or now - self._stopped <= self._values.stop_pub_timeout * 1e9:
            self._publish(ZERO, header)
        self._moves = False

    def _publish(self, twist: outlines.Twist, header: Any) -> None:
        out = Twist()
        out.linear.x, out.linear.y, out.angular.z = map(float, twist)
        message: Any = out
        if self._stamped:
            if header is None:
                stamp = stamp_to_ros(self.now())
                header = Header(stamp=stamp, frame_id=self._values.base_frame_id)
            message = TwistStamped(header=header, twist=out)
        self._out.publish(message)
        self._moves, self._sent = any(twist), self._steady()
        if self._view is not None:
            self._frames.twist = self._in_scene.twist = twist

    def _tell(self, decision: Decision | None, fault: Fault) -> None:
        """Publish the state where it has changed."""
        name, action = INVALID_SOURCE, STOP
        if decision is not None:
            name, action = decision.zone, decision.action
        is_new = self.enabled and self.active and name != self._zone
        if self._nav2_state is not None and is_new:
            number = ACTIONS.index(action)
            self._nav2_state.publish(StateMessage(action_type=number, polygon_name=name))
        self._zone = name
        found = None if decision is None else decision.finding
        who = fault.who if found is None else " ".join(found.who)
        kind = action, name if decision else "", fault.code, who
        if kind == self._said:
            return
        self._said = kind
        values: dict[str, object] = {
            "reason": fault.code, "action": action, "zone": kind[1], "who": who,
        }  # fmt: skip
        if found is not None and found.who:
            values["time to collision (s)"] = f"{found.time:.3f}"
            corners = np.concatenate(list(found.points.values()))
            near = corners[np.argmin(np.hypot(corners[:, 0], corners[:, 1]))]
            values["nearest point (m)"] = " ".join(f"{value:.3f}" for value in near)
            values["points"] = len(corners)
        level = OK if action == NOTHING else ERROR if action == STOP else WARN
        text = f"{action} by {name}: {who}" if decision and name else action
        if fault.code:
            level, text = STALE, f"{fault.code} {who} {fault.detail}".strip()
        status = DiagnosticStatus(level=bytes(level), name=f"{self._node.get_name()}: base")
        status.message, status.hardware_id = text, "obb_collision"
        self.text, self.values = text, values
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = stamp_to_ros(self.now())
        self._state.publish(message)

    def _watch(self) -> None:
        """Stop the base where no command comes, or is answered, in time."""
        while not self._ended.wait(LOOK):
            try:
                self._look()
            except Exception as error:
                try:
                    self._caught("gate", error)
                except Exception:  # the context is gone: nothing can be published
                    return

    def _look(self) -> None:
        limit = self._values.command_timeout
        if not self._values.fail_closed or not limit:
            return
        with self._lock:  # of two answers the one that is published last is the newer one
            steady = self._steady()
            silent = steady - self._heard
            if silent <= limit:
                return
            repeats = silent <= limit + self._values.stop_pub_timeout and steady - self._sent > BEAT
            if self._moves or repeats:
                self._publish(ZERO, None)
                self._tell(None, Fault("command_silent"))

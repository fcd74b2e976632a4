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

"""The collision node: callbacks store, one cycle computes and publishes.

``main`` is the console script ``obb_collision_node``; ``CollisionNode`` can run in any process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from functools import partial
from time import monotonic, perf_counter
from typing import Any

from rclpy.clock import Clock, JumpThreshold, ROSClock, TimeJump
from rclpy.clock_type import ClockType
from rclpy.constants import S_TO_NS
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.timer import Timer
from std_srvs.srv import SetBool, Trigger

from obb_collision.node.base.gate import Fault, Gate, View
from obb_collision.node.base.objects import SceneObjects
from obb_collision.node.cycle.cycle import CycleRunner, Schedule
from obb_collision.node.diagnostics.answer import CODES, Reason
from obb_collision.node.diagnostics.monitors import InputMonitor, QosWatch
from obb_collision.node.inputs import detections
from obb_collision.node.inputs.clouds import Obstacles
from obb_collision.node.inputs.inputs import Inputs
from obb_collision.node.inputs.scene_file import SceneFile
from obb_collision.node.inputs.sources import Sources, source_inputs
from obb_collision.node.inputs.subscriptions import INPUTS, Input, Subscriptions
from obb_collision.node.messages.optional import unusable
from obb_collision.node.objects.frames import FrameSource, lookup_in, make_frames
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.table import COLLIDE
from obb_collision.node.outputs.outputs import Outputs
from obb_collision.node.parameters.entries import Groups
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.parameters.ready import Kernels
from obb_collision.node.parameters.settings import (
    MEGABYTE,
    SceneParameters,
    apply_limits,
    build_limits,
)
from obb_collision.node.robots.checked_robot import LinkFrames
from obb_collision.node.robots.robots import Robots, robot_inputs
from obb_collision.node.runtime.clock import NodeClock, refuse_bad_clocks
from obb_collision.node.runtime.guard import INTERNAL_ERROR, Guard
from obb_collision.node.runtime.lifecycle import ManagedNode
from obb_collision.node.runtime.running import run_node
from obb_collision.node.status import reporting
from obb_collision.node.status.collision_status import STATUS, CollisionStatus
from obb_collision.node.status.evidence import LONGEST_STANDSTILL, Evidence
from obb_collision.scene.effects.settings import OFF
from obb_collision.scene.store.allowed import Rule
from obb_collision.scene.store.patterns import Overrides
from obb_collision.scene_files import describe_scene
from obb_collision.scene_files.mesh_files import MeshReading

NODE_NAME = "obb_collision"
SENSOR_DEPTH = 10
"""Messages that wait in the queue of an observation source."""


class CollisionNode(ManagedNode):
    """Maintains the world boxes of a scene and publishes which collide.

    Unconfigured it has its publishers and the status; configured its kernels, inputs and objects,
    which are stored; only while it is active they are checked.

    frames: where frames are, by default tf2 where installed. ending: whether to give up compiling,
    which raises ExternalShutdownException at the start. steady: seconds, by which inputs are
    silent. All else goes to ``rclpy.node.Node`` (context, namespace, parameter_overrides...).
    """

    def __init__(
        self,
        *,
        frames: FrameSource | None = None,
        ending: Callable[[], bool] = lambda: False,
        steady: Callable[[], float] = monotonic,
        **node_options: Any,
    ) -> None:
        super().__init__(NODE_NAME, **node_options)
        self.steady = steady
        self.full_name = self.get_fully_qualified_name().lstrip("/")
        self.undo, self._ending = ExitStack(), ExitStack()
        """What ``release`` and ``destroy_node`` do."""
        self.gate: Gate | None = None
        """Of commands for a mobile base, if there are parameters of one."""
        self._ending.callback(self.undo.close)
        self._stop_robots: Callable[[], None] = lambda: None
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        try:
            self._set_up(frames, ending)
        except BaseException:
            self.destroy_node()  # else its subscriptions would continue to receive
            raise

    def _set_up(self, frames: FrameSource | None, ending: Callable[[], bool]) -> None:
        """Create the parts that every state of the life cycle needs, and start."""
        self.guard = Guard(self.get_logger().error, self.context.ok)
        self.parameters = Parameters(self)
        refuse_bad_clocks(self)
        autostart = self.parameters.autostart
        self._scene_file = self._read_scene_file() if autostart else None
        fixed_frame = self.parameters.fixed_frame
        self.frames = frames if frames is not None else make_frames(self, fixed_frame)
        logger = self.get_logger()
        for package, reason in unusable.items():
            logger.warning(f"{package} is installed but cannot be used, and is ignored: {reason}")
        self._make_outputs()
        if self.parameters.gate is not None:
            clocks = self._read_clock, self.steady
            self.gate = Gate(self, self.parameters, self.guard.caught, *clocks)
            self._ending.callback(self.gate.close)
        self.kernels = Kernels(
            logger.info,
            logger.warning,
            self._report_compiling,
            lambda: ending() or not self.context.ok(),
        )
        self._ending.callback(self.kernels.close)
        self.status.start()
        if autostart:
            self.start()
        else:
            self.rest()

    def _make_outputs(self) -> None:
        """Create the outputs; the status is published from now on."""
        self.outputs = Outputs(self, self.parameters, self.guard)
        self.effects = self.outputs.effects
        self.status = CollisionStatus(
            f"{self.full_name}: collision",
            self.outputs.publishers,
            self.effects,
            lambda: bool(self.parameters.unknown_is_collision),
            self._read_clock,
            self.guard,
            lambda: self.parameters.allowed_delay,
        )
        self._ending.callback(self.status.close)
        self.status.rest()

    def _report_compiling(self, text: str) -> None:
        """Report the progress of compiling, unless it was stopped."""
        if self.context.ok():
            with self.guard.catching("status"):
                self.status.rest(Reason("starting", detail=text))
                part = reporting.Part("kernels", [text], "ready", ())
                now = self._read_clock()
                reporting.publish_parts(self.outputs, self.full_name, now, [part])

    def rest(self, detail: str = "") -> None:
        """Report that nothing is configured; detail: is added to the status."""
        self.parameters.on_change = lambda: self.status.update(self.status.answer)
        self.status.rest(Reason("unconfigured", detail=detail))
        self.get_logger().info(CODES["unconfigured"])

    def configure(self) -> None:
        """Have kernels compiled, create inputs and objects, and begin to store messages."""
        scene_file, self._scene_file = self._scene_file or self._read_scene_file(), None
        unused = [] if self.gate is None else self.parameters.declare_gate()
        if unused:
            self.get_logger().warning(f"parameters that are not used: {', '.join(unused)}")
        start = perf_counter()
        self.kernels.prepare(self.parameters)
        seconds = perf_counter() - start
        self._make_inputs()
        self._make_cycle([] if scene_file is None else scene_file.allowed())
        self.outputs.publish_namespaces(self.objects.table.namespaces)
        self._apply_parameters()
        self.sources.add()
        if scene_file is not None:
            refused = scene_file.add_to(self.objects, self.now())
            if refused:
                self.get_logger().warning(
                    f"{self.parameters.scene_file}: {len(refused)} objects not checked: "
                    f"{refused[0]}"
                )
            self.objects.declare_empty()
        self._begin()
        if self.gate is not None:
            self._begin_gate(self.gate)
        log = self.get_logger().info
        topics = (
            " ".join(end.topic_name for end in ends.values())
            for ends in (self.subscribed.open, self.outputs.ends)
        )
        log("subscribed to {}; publishing {}; frames: {}".format(*topics, self.frames.description))
        log(
            f"ready: fixed frame '{self.parameters.fixed_frame[:80]}', "
            f"trigger {self.parameters.trigger} at {self.parameters.rate:g} Hz, "
            f"kernels loaded in {seconds:.1f} s"
        )

    def activate(self) -> None:
        """Begin to check the scene, from the next cycle on."""
        self.cycle.active = True
        self.evidence.activate()
        if self.gate is not None:
            self.gate.activate()
        self.get_logger().info("active")

    def deactivate(self) -> None:
        """Check nothing any more; messages are still stored."""
        self.cycle.active = False
        if self.gate is not None:
            self.gate.rest("inactive")
        self._pause()
        self.get_logger().info(CODES[self.cycle.paused])

    def release(self) -> None:
        """Remove inputs and objects."""
        self.undo.close()
        self.parameters.on_change = lambda: None
        self.parameters.on_check = lambda parameters: None
        self.parameters.restore_defaults()
        self.outputs.withdraw(self._read_clock())

    def finish(self) -> None:
        """Publish that the node ends."""
        self.status.close()
        self.kernels.close()
        self.get_logger().info("finalized")

    def _make_inputs(self) -> None:
        """Create the inputs; nothing is subscribed yet."""
        fixed_frame, names = self.parameters.fixed_frame, self.parameters.robots
        self.topics: dict[str, Input] = {**INPUTS, **detections.INPUTS, **robot_inputs(names)}
        self.topics |= source_inputs(self.parameters.source_settings)
        self.gate_topics = self._gate_topics()
        self.topics |= self.gate_topics
        if self.parameters.latched_objects:
            latched = self.topics["objects"]._replace(durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self.topics["objects"] = latched
        warn = self.get_logger().warning
        self.monitors = {
            topic: InputMonitor(topic, warn, steady=self.steady) for topic in self.topics
        }
        link_frames = LinkFrames(self.frames, fixed_frame, names)
        frames = link_frames if names else self.frames
        self.objects = Objects(fixed_frame, frames, self.guard, self.monitors)
        self.undo.callback(self.objects.close)
        self.objects.states.wants_twists = self._wants_twists
        self.inputs = Inputs(self.objects, self.now, self.frames)
        self.obstacles = Obstacles(self.objects, self.frames)
        self.time = NodeClock(
            self._read_clock, self._is_simulated, self._clock_jumped, seconds=self.steady
        )
        self.robots = Robots(
            self,
            self.undo,
            self.parameters,
            self.objects,
            link_frames,
            self.mesh_reading,
            self.now,
            lambda: self.evidence.not_known(),
        )
        self.sources = Sources(
            self.objects,
            self.frames,
            self.now,
            self.parameters,
            self.robots.parts,
            self.obstacles,
        )
        self.inputs.newest += self.sources.all
        self._watched = {"points", *(source.topic for source in self.sources.watched)}
        """Topics whose points are no obstacles."""
        self._stop_robots = self.robots.stop
        self.undo.callback(self.robots.close)

    def _make_cycle(self, allowed: list[Rule]) -> None:
        """Create the check, and what calls it."""
        objects, now = self.objects, self.now
        self.settings = SceneParameters(self.parameters, objects, allowed)
        self.cycle = CycleRunner(
            objects, self.obstacles, self.sources, self.outputs, self.guard, self.collect
        )
        self._schedule = Schedule(self._make_timer, self.run_cycle)
        points = self.inputs.guarded("points", self.obstacles.queue, changes=False)
        callbacks = {**self.inputs.callbacks(), "points": points}
        callbacks |= self.robots.callbacks(self.inputs)
        callbacks |= self.sources.callbacks(self.inputs)
        for topic in self.gate_topics:
            take = partial(self._observe, topic)
            callbacks[topic] = self.inputs.guarded(topic, take, changes=False)
        self.subscribed = Subscriptions(
            self, self.topics, callbacks, self.monitors, self._arrived, now
        )
        self.undo.callback(self.subscribed.close)
        status = self.outputs.publishers[STATUS].topic_name
        self.evidence = Evidence(
            self.parameters,
            objects,
            self.inputs,
            self.subscribed,
            self.robots,
            self.cycle,
            self.time,
            lambda: self.count_publishers(status),
        )
        self.reporting = reporting.Reporting(
            self.full_name,
            self.outputs,
            objects,
            self.subscribed,
            self.robots,
            self.cycle,
            QosWatch(self, self.get_logger().warning),
            now,
        )

    def _gate_topics(self) -> dict[str, Input]:
        """Return the topics of the sensors of a gate, if there is one."""
        if self.gate is None:
            return {}
        kinds = self.gate.prepare(self.topics, lambda: self.objects.max_points)
        qos = SENSOR_DEPTH, ReliabilityPolicy.BEST_EFFORT
        return {topic: Input(kind, *qos, is_query=True) for topic, kind in kinds.items()}

    def _observe(self, topic: str, data: bytes, now: int) -> None:
        if self.gate is not None:
            self.gate.take(topic, data, now)

    def _begin_gate(self, gate: Gate) -> None:
        """Let a gate serve, and end that when the node is released."""
        parameters, fixed = self.parameters, self.parameters.fixed_frame
        names = parameters.odom_frame_id, parameters.base_frame_id, fixed
        odom, base, scene = (lookup_in(self.frames, fixed, name) for name in names)
        objects = SceneObjects(self.objects.scene, parameters)
        view = View(self._take_newest, self._gate_faults, objects, odom, base, scene)
        self.reporting.more.append(partial(self._gate_part, gate))
        self.undo.callback(gate.end)
        gate.begin(view, self.undo.callback)

    def _gate_part(self, gate: Gate) -> reporting.Part:
        """Return the state of a gate for /diagnostics."""
        longest, gate.longest = gate.longest, 0.0
        times = {"commands": gate.commands, "longest answer (ms)": f"{1e3 * longest:.3f}"}
        faults = [gate.text] if gate.values.get("reason") else []
        return reporting.Part("base", faults, gate.text, {**gate.values, **times}.items())

    def _take_newest(self) -> None:
        """Take in what has arrived, for a command between two cycles."""
        self._take_in()
        self.objects.update(self.now())

    def _gate_faults(self) -> Iterator[Fault]:
        """Yield what is missing to know about objects; sensors see whether there are none."""
        for reason in self.evidence.answer().reasons:
            if reason.code not in ("starting", "no_objects" if self.gate_topics else ""):
                yield Fault(reason.code, reason.whom, reason.detail)
        if self.steady() - self.time.moved > LONGEST_STANDSTILL:
            yield Fault("clock_stopped")

    def _make_timer(self, period: float, callback: Callable[[], Any]) -> Timer:
        """Create a timer by steady time, until ``release``."""
        timer = self.create_timer(period, callback, clock=self._steady_clock)
        self.undo.callback(self.destroy_timer, timer)
        return timer

    def _arrived(self, topic: str) -> None:
        """Have a cycle run for a message: not for queries, nor for points that no effect needs."""
        wanted = topic not in self._watched or self.effects.is_requested("points")
        if wanted and not self.topics[topic].is_query:
            self._schedule.arrived()

    def _begin(self) -> None:
        """Subscribe, offer the services, and watch: clock, parameters, cycles, diagnostics."""
        report = self.guard.catching("diagnostics")(self.reporting.publish)
        self._make_timer(reporting.PERIOD, report)
        # each at once: the executor takes one request per service between two cycles
        self.parameters.on_change = self.guard.catching("parameters")(self._apply_parameters)
        self.parameters.on_check = self._check_parameters
        for service in (
            self.create_service(Trigger, "~/clear", self._clear),
            self.create_service(SetBool, "~/enable", self._enable),
        ):
            self.undo.callback(self.destroy_service, service)
        jump = self.get_clock().create_jump_callback(
            JumpThreshold(
                min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True
            ),
            post_callback=self._look_at_clock,
        )
        self.undo.callback(jump.unregister)
        for topic in self.topics:
            if topic not in self._watched:  # which are a matter of parameters
                self.subscribed.keep(topic, True)

    def _read_scene_file(self) -> SceneFile | None:
        """Read the scene file, if there is one, and take its settings as parameters."""
        if not self.parameters.scene_file:
            if self.parameters.robots:
                self.parameters.override_defaults({"accuracy": "hull"})
            return None
        with closing(self.mesh_reading()) as meshes:
            description = describe_scene(self.parameters.scene_file, meshes)
        for note in description.notes:
            self.get_logger().info(f"{self.parameters.scene_file}: {note}")
        for robot in description.robots:
            if robot.name not in self.parameters.robots:
                self.get_logger().warning(
                    f"{self.parameters.scene_file}: robot {robot.name} is not checked: it needs "
                    f"the parameter robots: ['{robot.name}']"
                )
        scene_file = SceneFile(description)
        self.parameters.override_defaults(scene_file.parameters())
        return scene_file

    def mesh_reading(self) -> MeshReading:
        """Return how mesh files are read: in another process, within the limits."""
        return MeshReading(
            self.parameters.folders,
            build_limits(self.parameters),
            self.parameters.mesh_file_size * MEGABYTE,
            self.parameters.max_triangles,
        )

    def collect(self) -> float:
        """Read and apply the queued messages; returns their maximum waiting time (s)."""
        self._take_in()
        return self.subscribed.take_wait()

    def _take_in(self) -> None:
        """Read and apply the queued messages."""
        with self.guard.catching("inputs"):  # lost messages mark their input
            self.subscribed.drain()
        self._change("input objects", self.inputs.markers.apply)
        for boxes in self.inputs.sets:
            self._change(f"input {boxes.topic}", boxes.apply)
        self._change("input robots", self.robots.apply)
        self._change("input sources", self.sources.apply)

    def _change(self, where: str, change: Callable[[], None]) -> None:
        """Change objects; after an unforeseen error they may differ from the messages."""
        with self.guard.catching(where):
            change()
            return
        self.objects.broken = where

    def _wants_twists(self) -> bool:
        """Return whether anything depends on how objects move."""
        parameters = self.parameters
        policies = parameters.stale_policy, *dict(parameters.stale_policy_overrides).values()
        wanted = parameters.mode("sweep") != OFF or COLLIDE in policies
        return wanted or bool(parameters.robots)

    def _check_parameters(self, changed: Parameters) -> None:
        """Raise ValueError for parameters that cannot be used, or not together."""
        self.kernels.check(changed)
        if changed.gate is not None:
            changed.gate.zones()
            changed.gate.exclusions()

    def _apply_parameters(self) -> None:
        parameters = self.parameters
        self.settings.apply()
        apply_limits(parameters, self.objects)
        self.evidence.apply()
        if self.gate is not None:
            self.gate.apply()
        wants_points = parameters.mode("points") != OFF
        for topic in self._watched:
            self.subscribed.keep(topic, wants_points)
        if not wants_points:
            self.obstacles.forget()
            self.sources.forget_watched()
        ignored = Groups(parameters.groups).all_meant(parameters.ignored_objects)
        self.inputs.unknown.ignored = Overrides([(name, True) for name in ignored])
        for monitor in self.monitors.values():
            monitor.period = parameters.warn_period
        self._schedule.apply(parameters.trigger, parameters.rate, parameters.min_period)
        self.cycle.period = 1.0 / parameters.rate
        self.status.update(self.status.answer)

    def _read_clock(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def now(self) -> int:
        """Return the time of the node's clock (ns), after the effects of a jump are applied."""
        return self.time.now()

    def _is_simulated(self) -> bool:
        clock = self.get_clock()
        return isinstance(clock, ROSClock) and clock.ros_time_is_active

    def _look_at_clock(self, _: TimeJump) -> None:
        """Detect a jump as soon as rclpy reports it, which it does for simulated time only."""
        self.now()

    def run_cycle(self) -> None:
        """Check what has arrived, and publish the report and the status."""
        self.cycle.run(self.now())
        with self.guard.catching("output robots"):
            self.robots.publish()
        with self.guard.catching("output collision_status"):
            self._update_status(cycle=True)
        self._schedule.last = perf_counter()

    def _update_status(self, cycle: bool = False) -> None:
        """Publish the current status of collisions; cycle: a cycle has just ended."""
        if not self.status.is_off:
            self.status.update(self.evidence.answer(), cycle)

    def _pause(self) -> None:
        """Withdraw the results about collisions, until the next check."""
        self.cycle.forget()
        with self.guard.catching("output markers"):
            self.outputs.withdraw(self.now())
        with self.guard.catching("output collision_status"):
            self._update_status()

    def _clear(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Remove all objects and forget all names."""
        try:
            self.robots.hold("all objects were removed")
            self.inputs.markers.apply()  # markers from before the call
            for newest in self.inputs.newest:
                newest.cleared()
            self.inputs.unknown.deleted(self.objects.table.slots, self.now())
            count = self.objects.clear()
            for monitor in self.monitors.values():
                monitor.cleared()
            self.robots.cleared()
            self.sources.add()
            self._update_status()
            response.success, response.message = True, f"{count} objects removed"
        except Exception as error:
            self.guard.caught("service clear", error)
            self.objects.broken = "service clear"
            response.success, response.message = False, f"{INTERNAL_ERROR}: {error}"
        return response

    def _enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Start or stop checks; states are stored meanwhile."""
        self.cycle.enabled = request.data
        self._pause()
        response.success = True
        response.message = (
            "checking" if request.data else "checks are disabled; states are still stored"
        )
        self.get_logger().info(response.message)
        return response

    def _clock_jumped(self, shift: int, now: int) -> None:
        self.get_logger().warning(
            f"the clock jumped by {shift / S_TO_NS:+.3f} s: ages and lifetimes of "
            f"{len(self.objects.table)} objects continue from the new time; stamps may restart"
        )
        inputs = self.inputs.markers, self.inputs.unknown, *self.inputs.newest, self.obstacles
        others = self.objects, self.robots, self.outputs.events.pairs, *self.monitors.values()
        parts: list[Any] = [*inputs, self.sources.left_out, *others]
        for part in parts:  # one that fails leaves none of the others in the old time
            self._change("clock jump", partial(part.clock_jumped, shift))

    def say_farewell(self) -> None:
        """Stop robots, and publish the status unknown: a signal waits, in another thread."""
        try:
            self._stop_robots()
            if self.gate is not None:
                self.gate.close()
        finally:
            self.status.close()
            with self.transition:  # the context ends after it
                pass

    def destroy_node(self) -> None:
        """Publish the status unknown, and end together with all other processes."""
        self._ending.close()
        super().destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Run the console script ``obb_collision_node``."""
    return run_node(
        NODE_NAME, lambda context, ending: CollisionNode(context=context, ending=ending), args
    )

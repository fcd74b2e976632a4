"""The collision node: callbacks store, one cycle computes and publishes.

``main`` is the console script ``obb_collision_node``; ``CollisionNode`` can stand in any process.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from importlib.metadata import version
from time import perf_counter
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from rclpy.clock import Clock, JumpThreshold, TimeJump
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import MultiDOFJointState, PointCloud2
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from obb_collision.geometry.shapes import Box
from obb_collision.node import diagnostics
from obb_collision.node.conversions import stamp_to_ros
from obb_collision.node.frames import FrameSource, make_frames
from obb_collision.node.inputs import Inputs
from obb_collision.node.markers import Markers
from obb_collision.node.monitors import CycleMonitor, InputMonitor
from obb_collision.node.objects import Objects
from obb_collision.node.outputs import Outputs
from obb_collision.node.parameters import Parameters
from obb_collision.scene.report import Report
from obb_collision.scene.scene import Scene

NODE_NAME = "obb_collision"
DIAGNOSTICS_PERIOD = 1.0
"""Seconds between two messages on /diagnostics."""
WARM_UP_OBJECTS = 64
"""Enough that one moved object of them takes the incremental way through the scene."""
SHORTEST_TIMER = 1e-4
"""Period (s) of the timer that ends a burst where min_period is zero."""

DEPTHS = {"objects": 100, "object_transform": 1000, "object_states": 10, "object_poses": 10}
"""Messages that may wait, by topic. Markers and single poses are for different objects, so more of
them wait; the bulk messages overtake themselves."""


class CollisionNode(Node):
    """Keeps the world boxes of a scene up to date and publishes which collide.

    frames: where frames are, by default tf2 where installed. All else goes to ``rclpy.node.Node``
    (context, namespace, parameter_overrides, cli_args...).
    """

    def __init__(self, *, frames: FrameSource | None = None, **node_options: Any) -> None:
        super().__init__(NODE_NAME, **node_options)
        self.parameters = Parameters(self)
        warm_up_seconds = warm_up()
        fixed_frame = self.parameters.fixed_frame
        self._frames = frames if frames is not None else make_frames(self, fixed_frame)
        self._monitors = {topic: InputMonitor(topic, self._warn) for topic in DEPTHS}
        self._mismatches: dict[str, int] = {}
        self._cycles = CycleMonitor()
        self._enabled = True
        self._last_cycle = float("-inf")
        self._report: Report | None = None
        self._outputs = Outputs(self, self.parameters, self._count_mismatch)
        self.objects = Objects(fixed_frame, self._frames, self._refuse_late)
        self.inputs = Inputs(self.objects, self._monitors, self._now)
        self._outputs.publish_namespaces([])
        self._apply_parameters()
        self._start_timers()
        self.parameters.on_change = self._apply_parameters
        self.create_service(Trigger, "~/clear", self._clear)
        self.create_service(SetBool, "~/enable", self._enable)
        self._jump = self.get_clock().create_jump_callback(
            JumpThreshold(
                min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True
            ),
            post_callback=self._clock_jumped,
        )
        inputs = self._subscribe()
        self.get_logger().info(
            f"ready: fixed frame '{fixed_frame}', frames by {self._frames.description}; "
            f"trigger {self.parameters.trigger} at {self.parameters.rate:g} Hz; backend numba "
            f"{version('numba')}, kernels ready in {warm_up_seconds:.1f} s; "
            f"in: {' '.join(inputs)}; out: {' '.join(self._outputs.topics)}"
        )

    def _subscribe(self) -> list[str]:
        """Subscribe to all inputs; returns the resolved topics."""
        takers: dict[str, tuple[type, Callable[[Any], None]]] = {
            "objects": (MarkerArray, self.inputs.take_markers),
            "object_transform": (TransformStamped, self.inputs.take_transform),
            "object_states": (MultiDOFJointState, self.inputs.take_states),
            "object_poses": (PointCloud2, self.inputs.take_poses),
        }
        topics = []
        for topic, (kind, take) in takers.items():
            subscription = self.create_subscription(
                kind,
                topic,
                self._storing(take),
                QoSProfile(depth=DEPTHS[topic]),
                event_callbacks=SubscriptionEventCallbacks(
                    incompatible_qos=self._mismatch_counter(topic)
                ),
                qos_overriding_options=QoSOverridingOptions(
                    [QoSPolicyKind.DEPTH, QoSPolicyKind.DURABILITY, QoSPolicyKind.RELIABILITY]
                ),
            )
            self._monitors[topic].topic = subscription.topic_name
            topics.append(subscription.topic_name)
        return topics

    def _storing(self, take: Callable[[Any], None]) -> Callable[[Any], None]:
        def store(message: Any) -> None:
            take(message)
            if self.parameters.trigger == "arrival":
                self._arrived()

        return store

    def _start_timers(self) -> None:
        # Steady time: a paused or missing simulation clock must not stop the checks.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(1.0 / self.parameters.rate, self._cycle, clock=steady)
        self._burst_timer = self.create_timer(SHORTEST_TIMER, self._end_burst, clock=steady)
        self._burst_timer.cancel()
        self._last_diagnostics = perf_counter()
        self.create_timer(DIAGNOSTICS_PERIOD, self._publish_diagnostics, clock=steady)

    def _apply_parameters(self) -> None:
        """Bring what was made from parameters up to date with them."""
        parameters, objects = self.parameters, self.objects
        objects.scene.padding = parameters.padding
        objects.max_objects = parameters.max_objects
        objects.transform_timeout = parameters.transform_timeout
        ignore = parameters.stale_policy == "ignore"
        if ignore != objects.ignore_stale:
            objects.set_ignore_stale(ignore)
        for monitor in self._monitors.values():
            monitor.warn_period = parameters.warn_period
        period = round(1e9 / parameters.rate)
        if hasattr(self, "_timer") and self._timer.timer_period_ns != period:
            self._timer.timer_period_ns = period
            self._timer.reset()

    def _now(self) -> int:
        """Time of the node's clock (ns)."""
        return int(self.get_clock().now().nanoseconds)

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text)

    def _refuse_late(self, reason: str, item: str, detail: str) -> None:
        """Count a pose that was stored but could not be placed at the cycle."""
        self._monitors["objects"].refuse(self._now(), reason, item, detail)

    def _mismatch_counter(self, topic: str) -> Callable[[Any], None]:
        def count(info: Any) -> None:
            self._monitors[topic].mismatches = info.total_count
            self._count_mismatch(topic, info.total_count)

        return count

    def _count_mismatch(self, topic: str, count: int) -> None:
        self._mismatches[topic] = count
        self._warn(f"{topic}: a publisher or subscriber asks for incompatible QoS; no data flows")

    def _arrived(self) -> None:
        """With trigger arrival: compute at once, or once the burst is over."""
        if perf_counter() - self._last_cycle >= self.parameters.min_period:
            self._cycle()
            self._timer.reset()
        elif self._burst_timer.is_canceled():
            rest = self.parameters.min_period - (perf_counter() - self._last_cycle)
            self._burst_timer.timer_period_ns = round(1e9 * max(rest, SHORTEST_TIMER))
            self._burst_timer.reset()

    def _end_burst(self) -> None:
        self._burst_timer.cancel()
        self._cycle()

    def _cycle(self) -> None:
        """Bring the scene up to date, check it, publish."""
        start = perf_counter()
        now = self._now()
        self.objects.update(now, self.parameters.object_timeout)
        stages = {"update": perf_counter() - start}
        if self._enabled:
            stages.update(self._check(now))
        else:
            self._outputs.publish_namespaces(self.objects.table.namespaces)
        self._last_cycle = perf_counter()
        self._cycles.add(stages, 1.0 / self.parameters.rate)

    def _check(self, now: int) -> dict[str, float]:
        """Check and publish; returns the seconds of each stage."""
        times = [perf_counter()]
        self._report = report = self.objects.scene.check()
        times.append(perf_counter())
        stamp = self.objects.newest_stamp(now)
        self._outputs.publish_report(report, self.objects, stamp)
        times.append(perf_counter())
        self._outputs.publish_markers(report, self.objects, stamp)
        times.append(perf_counter())
        return dict(zip(("check", "publish", "markers"), np.diff(times).tolist(), strict=True))

    def _publish_diagnostics(self) -> None:
        elapsed, now = perf_counter() - self._last_diagnostics, self._now()
        self._last_diagnostics += elapsed
        name = self.get_fully_qualified_name().lstrip("/")
        colliding = 0 if self._report is None else int(self._report.colliding.sum())
        message = DiagnosticArray()
        message.header.stamp = stamp_to_ros(now)
        message.status = [
            *(
                diagnostics.input_status(name, key, monitor, now, elapsed)
                for key, monitor in self._monitors.items()
            ),
            diagnostics.object_status(name, self.objects, self.parameters.stale_policy, colliding),
            diagnostics.cycle_status(name, self._cycles, self._enabled, elapsed),
            diagnostics.qos_status(name, self._mismatches),
        ]
        self._outputs.diagnostics.publish(message)

    def _clear(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        count = self.objects.remove_all()
        response.success, response.message = True, f"{count} objects removed"
        return response

    def _enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._enabled = request.data
        response.success = True
        response.message = "checking" if request.data else "not checking; states are still taken"
        self.get_logger().info(response.message)
        return response

    def _clock_jumped(self, jump: TimeJump) -> None:
        self.objects.forget_order(self._now())


def warm_up() -> float:
    """Compile or load every kernel a cycle calls; returns the seconds it took."""
    start = perf_counter()
    scene = Scene()
    for number in range(WARM_UP_OBJECTS):
        scene.add(str(number), Box((1.0, 1.0, 1.0)), (0.75 * number, 0, 0, 0, 0, 0.6, 0.8))
    for x in (0.0, 0.1):
        scene.move_indices(np.array([0]), np.array([(x, 0.1, 0, 0, 0.6, 0, 0.8)]))
        _ = scene.check().colliding
    keys = [("", number) for number in range(WARM_UP_OBJECTS)]
    Markers("").write(keys, scene.boxes, np.zeros(WARM_UP_OBJECTS, np.int64), 0, 0.0, None)
    return perf_counter() - start


def run(make_node: Callable[[Context], Node], args: Sequence[str] | None = None) -> int:
    """Spin a node until SIGINT, SIGTERM or a shutdown of its context; returns the exit code."""
    # rclpy's handlers wake the executor and then call these. Without them Python would raise
    # KeyboardInterrupt in whatever line runs just then, and a signal from before rclpy's handlers
    # stand would be lost or deadly.
    received: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: received.append(number))
    context = Context()
    arguments = None if args is None else list(args)
    rclpy.init(args=arguments, context=context, signal_handler_options=SignalHandlerOptions.ALL)
    node = None
    try:
        if received:
            return 0
        # first, for rclpy's executor can't be made half once the context is gone
        executor = SingleThreadedExecutor(context=context)
        try:
            node = make_node(context)
        except (ValueError, ParameterException) as error:  # a parameter that can't be used
            get_logger(NODE_NAME).fatal(str(error))
            return 1
        executor.add_node(node)
        executor.spin()
    except ExternalShutdownException:
        pass
    except Exception:
        if context.ok():  # what fails because the context is gone is no error
            raise
    finally:
        if node is not None:
            node.destroy_node()
        try_shutdown(context=context)
    return 0


def main(args: Sequence[str] | None = None) -> int:
    """Run the console script ``obb_collision_node``."""
    return run(lambda context: CollisionNode(context=context), args)


if __name__ == "__main__":
    raise SystemExit(main())

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

"""Runs the demo: a node, a publisher and a listener in one process, with topics between them.

The publisher plays the robots: it sends the objects of the scene, their motion, and what sensors
see. A robot slows down by its ``speed_scale``, if the scene has sensors.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState, MultiDOFJointState, PointCloud2
from std_msgs.msg import Float64, Header, String
from visualization_msgs.msg import MarkerArray

from obb_collision.demo.listener import NARRATORS, Listener
from obb_collision.demo.scene import DemoScene
from obb_collision.demo.sensing import SensorFrames, SensorPublishers
from obb_collision.demo.snapshot import DrawnScene, take_snapshot
from obb_collision.node.messages.clouds import poses_to_ros
from obb_collision.node.messages.conversions import pose_to_ros, stamp_to_ros, states_to_ros
from obb_collision.node.messages.marker_shapes import shape_to_ros
from obb_collision.node.messages.names import namespace_number
from obb_collision.node.node import NODE_NAME, CollisionNode
from obb_collision.node.topics.cloud import LATCHED
from obb_collision.node.topics.topics import TOPICS
from obb_collision.robots.description.urdf import description_text
from obb_collision.scene_files.description import SceneRobot

FRAME = "map"
DESCRIPTIONS = ("robot_description", "robot_description_semantic")


class ScenePublisher(Node):
    """Publishes a scene in motion.

    The node reads the objects of a scene file itself: only their states, poses with twists, are
    published. Random objects are published as markers, and their motion as a cloud of poses.
    node_options go to ``rclpy.node.Node`` (context, namespace...).
    """

    def __init__(self, scene: DemoScene, frames: SensorFrames, **node_options: Any) -> None:
        super().__init__("scene", **node_options)
        self.scene = scene
        self._objects: Any = None
        depth = QoSProfile(depth=10)
        if scene.file is not None:
            self._motion = self.create_publisher(MultiDOFJointState, "object_states", depth)
        else:
            self._objects = self.create_publisher(MarkerArray, "objects", LATCHED)
            self._motion = self.create_publisher(PointCloud2, "object_poses", depth)
        self._joints = {
            robot.name: self.create_publisher(JointState, f"{robot.name}/joint_states", depth)
            for robot in scene.robots
        }
        self._descriptions = {
            (robot.name, kind): self.create_publisher(String, f"{robot.name}/{kind}", LATCHED)
            for robot in scene.robots
            for kind in DESCRIPTIONS
        }
        self.sensors = SensorPublishers(self, scene.motions, frames)
        self._time, self.scales = 0.0, dict.fromkeys(scene.motions.robots, 1.0)
        for name in scene.motions.robots if scene.motions.sensors else ():
            take = partial(self._take_scale, name)
            self.create_subscription(Float64, f"{name}/speed_scale", take, 1)

    def _take_scale(self, robot: str, scale: Float64) -> None:
        self.scales[robot] = scale.data

    @property
    def matched(self) -> bool:
        """Whether the topics of the objects have subscribers."""
        used: list[Any] = [self._motion, *self._joints.values(), *self._descriptions.values()]
        used += [] if self._objects is None else [self._objects]
        return all(publisher.get_subscription_count() > 0 for publisher in used)

    def publish_all(self) -> int:
        """Publish all objects as they are at the start; returns the stamp (ns)."""
        rows = list(range(len(self.scene.names)))
        return self._publish_states(rows, 0.0) if self.scene.file else self._publish_markers()

    def publish_descriptions(self) -> None:
        """Publish URDF and SRDF of the robots."""
        for robot in self.scene.robots:
            texts = description_text(robot.urdf), robot.srdf and robot.srdf.read_text("utf-8")
            for kind, text in zip(DESCRIPTIONS, texts, strict=True):
                if text is not None:
                    self._descriptions[robot.name, kind].publish(String(data=text))

    def publish_joints(self, time: float) -> int | None:
        """Publish the robots' joints at a time; returns the stamp (ns), None without robots."""
        stamp, header = self._header()
        for robot in self.scene.robots:
            values, velocities = self.scene.motions.joints(robot, time)
            velocities = velocities * self.scales.get(robot.name, 1.0)
            state = {"position": values.tolist(), "velocity": velocities.tolist()}
            names = list(robot.robot.joint_names)
            self._joints[robot.name].publish(JointState(header=header, name=names, **state))
        return stamp if self.scene.robots else None

    def publish_objects(self, time: float) -> int | None:
        """Publish moving objects at a time; returns the stamp (ns), None if all are at rest."""
        rows = self.scene.motions.moving
        if not rows:
            return None
        return self._publish_states(rows, time) if self.scene.file else self._publish_poses(time)

    def publish_step(self, time: float) -> None:
        """Publish moving objects and joints, and what sensors see when it is due."""
        passed, self._time = time - self._time, time
        for robot, scale in self.scales.items():
            self.scene.motions.delays[robot] += (1.0 - scale) * passed
        self.publish_objects(time)
        self.sense(time)

    def sense(self, time: float, all_of_them: bool = False) -> None:
        """Publish joints, and what the sensors that are due, or all, see at a time."""
        stamp = self.publish_joints(time) or self._header()[0]
        self.sensors.publish(time, stamp, all_of_them)

    def _header(self) -> tuple[int, Header]:
        now = self.get_clock().now().nanoseconds
        return now, Header(stamp=stamp_to_ros(now), frame_id=FRAME)

    def _publish_markers(self) -> int:
        stamp, header = self._header()
        markers = []
        for key, obj in zip(self.scene.keys, self.scene.description.objects, strict=True):
            marker = shape_to_ros(obj.shape)
            marker.header, marker.pose, marker.color.a = header, pose_to_ros(obj.pose), 1.0
            marker.ns, marker.id = key
            markers.append(marker)
        self._objects.publish(MarkerArray(markers=markers))
        return stamp

    def _publish_states(self, rows: list[int], time: float) -> int:
        poses, twists = self.scene.motions.states(time)
        stamp, header = self._header()
        names = [self.scene.names[row] for row in rows]
        self._motion.publish(states_to_ros(names, poses[rows], header, twists[rows]))
        return stamp

    def _publish_poses(self, time: float) -> int:
        rows = self.scene.motions.moving
        keys = [self.scene.keys[row] for row in rows]
        namespaces = np.array([namespace_number(namespace) for namespace, _ in keys])
        ids = np.array([number for _, number in keys])
        stamp, header = self._header()
        poses = self.scene.motions.states(time)[0][rows]
        self._motion.publish(poses_to_ros(ids, poses, namespaces, header))
        return stamp


#: The namespace of the demo, which must not disturb a robot.
NAMESPACE = "/obb_collision_demo"
#: Seconds to wait for discovery or an answer: it takes less than one, unless kernels compile.
PATIENCE = 300.0
#: Seconds between two checks whether it is time to stop.
GLANCE = 0.05
#: Seconds from one message to the next while the node is awaited.
AGAIN = 0.2
#: Epoch (ns) with which all times are 0 s: the demo's clock starts with the motion.
NOT_YET = 2**63 - 1


def robot_parameters(robots: Sequence[SceneRobot]) -> dict[str, Any]:
    """Return the parameters of a node for the robots of a scene file, which may rest."""
    bases = [f"{robot.name}: {' '.join(map(repr, robot.pose))}" for robot in robots]
    folders = {str(robot.urdf.resolve().parent): None for robot in robots}
    return {
        "robots": [robot.name for robot in robots],
        "robot_bases": bases,
        "mesh_folders": list(folders),
        "joint_timeout": 0.0,
    }


def node_parameters(
    scene: DemoScene, effects: Collection[str], marker_rate: float
) -> dict[str, Any]:
    """Return the parameters of the demo's node; other effects than these are off."""
    values: dict[str, Any] = {
        "fixed_frame": FRAME,
        "trigger": "arrival",
        "marker_form": "cubes",
        "marker_rate": marker_rate,
    }
    if scene.file is not None:
        values["scene_file"] = str(scene.file.resolve())
    if scene.robots:
        values |= robot_parameters(scene.robots)
    # the first start need not compile those that are off
    return values | {f"effects.{name}": "off" for name in NARRATORS if name not in effects}


class Demo:
    """The three nodes of the demo for a scene (checker, publisher, listener), and their executor.

    rate: of publications of moving objects, Hz. report: prints a line. live: whether boxes are
    published at that rate, too, for a view. stopped: tells whether to end; until the scene moves,
    waiting for kernels or answers then raises ExternalShutdownException. Raises TimeoutError if the
    nodes do not find each other.
    """

    def __init__(
        self,
        context: Context,
        scene: DemoScene,
        rate: float,
        seconds: float,
        report: Callable[[str], None],
        live: bool = False,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self.scene, self.time = scene, 0.0
        self._stopped, self._has_begun = stopped, False
        self._rate, self._seconds = rate, seconds
        choices = scene.description.effects
        effects = [name for name in NARRATORS if name in choices and choices[name].mode != "off"]
        where: Any = {"context": context, "namespace": NAMESPACE}
        values = node_parameters(scene, effects, rate if live else 10.0)
        inputs = ["object_states"] if scene.file is not None else ["objects", "object_poses"]
        topics = [
            *inputs,
            *(f"{robot.name}/joint_states" for robot in scene.robots),
            *(sensor.name for sensor in scene.motions.sensors),
            "collisions",
            *(TOPICS[name].name for name in effects),
            f"{NODE_NAME}/markers",
        ]
        report("topics to watch: " + " ".join(f"{NAMESPACE}/{topic}" for topic in topics))
        report("starting; the first start compiles kernels and reports its progress")
        frames = SensorFrames()
        files = [] if scene.parameters is None else ["--params-file", str(scene.parameters)]
        self.checker = CollisionNode(
            frames=frames if scene.motions.sensors else None,
            parameter_overrides=[Parameter(name, value=value) for name, value in values.items()],
            cli_args=["--ros-args", "-r", "/diagnostics:=diagnostics", *files],
            ending=stopped,
            **where,
        )
        where["start_parameter_services"] = False  # six services less to discover
        self.publisher = ScenePublisher(scene, frames, **where)
        self.listener = Listener(report, effects, **where)
        if live or scene.robots:
            self.listener.watch_boxes(f"{NODE_NAME}/markers")
        if live:
            self.listener.watch_inputs()
        self._executor = SingleThreadedExecutor(context=context)
        for node in (self.checker, self.publisher, self.listener):
            self._executor.add_node(node)

    def run(self) -> None:
        """Move the scene for its time, or until stopped; the last state is then published."""
        self.begin()
        self._has_begun = True
        start = perf_counter()
        self.listener.epoch = self.listener.get_clock().now().nanoseconds
        timer = self.publisher.create_timer(
            1.0 / self._rate, lambda: self._step(perf_counter() - start)
        )
        self.spin_until(lambda: self._stopped() or perf_counter() - start >= self._seconds, np.inf)
        timer.cancel()
        # exactly the last time, so that equal commands end alike
        self.settle(self.time if self._stopped() else self._seconds)

    def begin(self) -> None:
        """Wait until the nodes have found each other, and publish all objects."""
        self.spin_until(lambda: self.publisher.matched and self.listener.matched)
        self.listener.start = self.publisher.publish_all()
        self.listener.epoch = NOT_YET
        self.spin_until(lambda: self.listener.cycles > 0)
        self._begin_robots()
        self.sense(0.0)
        stamps = self.listener.effect_stamps
        self.spin_until(lambda: min(stamps.values(), default=0) >= 0)

    def _begin_robots(self) -> None:
        """Publish descriptions, then joints until the node, which reads these, places all links."""
        if not self.scene.robots:
            return
        self.publisher.publish_descriptions()
        timer = self.publisher.create_timer(AGAIN, lambda: self.publisher.publish_joints(0.0))

        def all_placed() -> bool:
            boxes = self.listener.boxes
            return len(boxes.names) == len(self.scene.shapes) and not boxes.doubtful.any()

        self.spin_until(all_placed)
        self.publisher.destroy_timer(timer)

    def settle(self, time: float) -> None:
        """Publish the state at a time, and wait until the listener has the answers to it."""
        self.time = time
        for publish in (self.publisher.publish_objects, self.publisher.publish_joints):
            stamp = publish(time) or 0
            self.spin_until(lambda stamp=stamp: self.listener.stamp >= stamp)  # type: ignore[misc]
        seen = self.listener.stamp
        self.sense(time)
        last, stamps = self.listener.stamp, self.listener.effect_stamps
        wanted = dict.fromkeys(stamps, last) | {"points": seen}  # whose stamps are those of clouds
        self.spin_until(lambda: all(stamps[name] >= wanted[name] for name in stamps))

    def sense(self, time: float) -> None:
        """Publish what sensors see at a time, until the node has a cycle with all of it."""
        names = {sensor.name for sensor in self.scene.motions.sensors}
        monitors = [self.checker.monitors[name] for name in names & self.checker.monitors.keys()]
        if not monitors:
            return
        for monitor in monitors:
            monitor.last_cloud = {}
        self.publisher.sense(time, True)
        timer = self.publisher.create_timer(AGAIN, lambda: self.publisher.sense(time, True))
        self.spin_until(lambda: all(monitor.last_cloud for monitor in monitors))
        self.publisher.destroy_timer(timer)
        stamp = self.publisher.publish_joints(time) or self.publisher.publish_objects(time) or 0
        self.spin_until(lambda: self.listener.stamp >= stamp)

    def spin_until(self, reached: Callable[[], bool], patience: float = PATIENCE) -> None:
        """Spin the nodes until a condition holds; TimeoutError after ``patience`` seconds."""
        limit = perf_counter() + patience
        while not reached():
            if self._stopped() and not self._has_begun:
                raise ExternalShutdownException
            if perf_counter() > limit:
                raise TimeoutError(f"no answer on the demo's topics within {patience:g} s")
            self._executor.spin_once(timeout_sec=GLANCE)

    def _step(self, time: float) -> None:
        self.time = min(time, self._seconds)
        self.publisher.publish_step(self.time)
        if self.scene.motions.sensors:  # what the view draws
            self.listener.points = np.concatenate(self.publisher.sensors.seen())

    def summary(self) -> list[str]:
        """Return the lines to print at the end."""
        listener = self.listener
        lines = [
            f"{self.time:.1f} s, {len(self.scene.shapes)} objects, {self.scene.moving_count} "
            f"moving, {listener.cycles} cycles",
        ]
        if listener.latencies:
            median, p95 = 1e3 * np.percentile(listener.latencies, (50, 95))
            lines.append(f"publish to collisions: median {median:.1f} ms, p95 {p95:.1f} ms")
        lines += [
            f"{robot}: its speed_scale delayed it by {delay:.1f} s"
            for robot, delay in self.scene.motions.delays.items()
            if self.scene.motions.sensors
        ]
        narrators = (listener.pairs, *listener.effects.values())
        return lines + [line for narrator in narrators for line in narrator.summary()]

    def snapshot(self) -> DrawnScene:
        """Return the scene that the node published last, to draw."""
        listener, names = self.listener, self.scene.shapes
        if listener.boxes.stamp < 0:
            listener.watch_boxes(f"{NODE_NAME}/markers")

        def is_latest() -> bool:
            cycle = listener.cycle
            is_current = cycle is not None and cycle.boxes.stamp >= listener.stamp
            return is_current and names.keys() <= {*cycle.boxes.names}  # type: ignore[union-attr]

        self.spin_until(is_latest)
        cycle = listener.cycle
        assert cycle is not None
        seen, strange = self.publisher.sensors.seen()
        drawn = take_snapshot(cycle._replace(points=seen), self.scene.shapes, self.scene.zones)
        return replace(drawn, strangers=strange)

    def save_picture(self, file: Path) -> None:
        """Draw the latest state. ImportError without matplotlib, OSError for the file."""
        from obb_collision.demo.picture import save_picture

        snapshot, description = self.snapshot(), self.scene.description
        pairs = len(self.listener.pairs.rows)
        title = f"{description.name}: {pairs} colliding pair{'s' * (pairs != 1)}"
        subtitle = f"of {len(snapshot.names)} objects, at {self.time:.1f} s"
        save_picture(file, snapshot, title, subtitle, description.view)

    def close(self) -> None:
        """Destroy the nodes."""
        self._executor.shutdown()
        for node in (self.listener, self.publisher, self.checker):
            node.destroy_node()

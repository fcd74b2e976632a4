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

"""Runs the demo: checker, publisher and listener in one process, topics in between."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter

from obb_collision.geometry.boxes import Boxes
from obb_collision.node.demo.file_scene import FileScene
from obb_collision.node.demo.followers import EFFECTS
from obb_collision.node.demo.listener import TOUCH_DEPTH, CollisionListener
from obb_collision.node.demo.publisher import CHANNELS, FRAME, ScenePublisher
from obb_collision.node.demo.scene import DemoScene
from obb_collision.node.effects import TOPICS
from obb_collision.node.node import NODE_NAME, CollisionNode

#: Everything of the demo is in this namespace: it must not disturb a robot.
NAMESPACE = "/obb_collision_demo"
#: Seconds to wait for discovery or an answer: well below one, but for what compiles the first time.
PATIENCE = 300.0
#: Seconds after which the executor looks whether it is time to stop.
GLANCE = 0.05

#: Stamp (ns) before which all is told to be at 0 s: the clock starts when the motion does.
NOT_YET = 2**63 - 1


class Demo:
    """The three nodes and their executor, for a scene.

    rate: publications of what moves, Hz. ``tell`` gets each line to print. Raises TimeoutError
    where the nodes don't find each other.
    """

    def __init__(
        self,
        context: Context,
        scene: DemoScene | FileScene,
        rate: float,
        seconds: float,
        tell: Callable[[str], None],
    ) -> None:
        effects = _effects_of(scene)
        heard = ("collisions", *(TOPICS[name] for name in effects))
        topics = (*CHANNELS, *heard, f"{NODE_NAME}/markers")
        tell("topics to watch: " + " ".join(f"{NAMESPACE}/{topic}" for topic in topics))
        tell("starting; the first start on a machine compiles, and says how far it is")
        self._rate, self._seconds = rate, seconds
        self.scene = scene
        self.time = 0.0
        where: Any = {"context": context, "namespace": NAMESPACE}
        values = {"fixed_frame": FRAME, "trigger": "arrival", "marker_form": "cubes"}
        if isinstance(scene, FileScene):
            values["scene_file"] = str(scene.file.resolve())
        self._checker = CollisionNode(
            parameter_overrides=[Parameter(name, value=value) for name, value in values.items()],
            cli_args=["--ros-args", "-r", "/diagnostics:=diagnostics"],
            **where,
        )
        where["start_parameter_services"] = False  # six services less to wait for, each time
        self.publisher = ScenePublisher(self.scene, **where)
        self.listener = CollisionListener(tell, effects, **where)
        self._executor = SingleThreadedExecutor(context=context)
        for node in (self._checker, self.publisher, self.listener):
            self._executor.add_node(node)

    def run(self, stopped: Callable[[], bool] = lambda: False) -> None:
        """Show the scene for the time given or until ``stopped``, then bring it to rest."""
        self.begin()
        start = perf_counter()
        self.listener.epoch = self.listener.get_clock().now().nanoseconds
        timer = self.publisher.create_timer(
            1.0 / self._rate, lambda: self._step(perf_counter() - start)
        )
        self.spin_until(lambda: stopped() or perf_counter() - start >= self._seconds, np.inf)
        timer.cancel()
        # exactly the end, so that equal commands end alike
        self.settle(self.time if stopped() else self._seconds)

    def begin(self) -> None:
        """Wait for the match of the nodes and publish all objects."""
        self.spin_until(lambda: self.publisher.matched and self.listener.matched)
        self.listener.start = self.publisher.publish_all(0.0)
        self.listener.epoch = NOT_YET
        self.spin_until(lambda: self.listener.cycles > 0)
        self.publisher.publish_points(0.0)
        stamps = self.listener.effects.stamps
        self.spin_until(lambda: min(stamps.values(), default=0) >= 0)

    def settle(self, time: float) -> None:
        """Publish the state of a time, topic by topic, each after the last one's collisions.

        Afterwards what the listener knows is about exactly that state.
        """
        self.time = time
        for channel in CHANNELS:
            stamp = self.publisher.publish_channel(channel, time)
            if stamp is not None:
                self.spin_until(lambda stamp=stamp: self.listener.stamp >= stamp)  # type: ignore[misc]
        self.publisher.publish_points(time)
        last, stamps = self.listener.stamp, self.listener.effects.stamps
        self.spin_until(lambda: min(stamps.values(), default=last) >= last)

    def spin_until(self, reached: Callable[[], bool], patience: float = PATIENCE) -> None:
        """Spin until something is reached. Raises TimeoutError after ``patience`` seconds."""
        limit = perf_counter() + patience
        while not reached():
            if perf_counter() > limit:
                raise TimeoutError("the nodes of the demo did not hear each other in time")
            self._executor.spin_once(timeout_sec=GLANCE)

    def _step(self, time: float) -> None:
        self.time = min(time, self._seconds)
        self.publisher.publish_step(self.time)

    def summary(self) -> list[str]:
        """Return the lines that end the demo."""
        heard = self.listener
        channels = [item.channel for item in self.scene.items]
        lines = [
            f"{self.time:.1f} s, {len(channels)} objects, {len(channels) - channels.count('')} "
            f"moving, {heard.cycles} cycles",
        ]
        if heard.latencies:
            median, p95 = 1e3 * np.percentile(heard.latencies, (50, 95))
            lines.append(f"publish to collisions: median {median:.1f} ms, p95 {p95:.1f} ms")
        deep = sum(depth >= TOUCH_DEPTH for depth in heard.pairs.values())
        lines.append(
            f"{len(heard.seen)} pairs seen, at most {heard.most} at once; at the end "
            f"{len(heard.pairs)}, {deep} overlapping and {len(heard.pairs) - deep} touching"
        )
        return lines + heard.effects.summary()

    def fetch_boxes(self) -> Boxes:
        """Return the boxes of all objects as the checker's markers show them now."""
        heard, names = self.listener, self.scene.names
        heard.watch_boxes(f"{NODE_NAME}/markers")
        self.spin_until(lambda: heard.boxes_stamp >= heard.stamp and len(heard.boxes) == len(names))
        poses, sizes = zip(*(heard.boxes[name] for name in names), strict=True)
        return Boxes.from_poses(np.array(poses), 0.5 * np.array(sizes))

    def save_picture(self, file: Path) -> None:
        """Draw what the listener knows. ImportError without matplotlib, OSError for the file."""
        from obb_collision.node.demo.portrait import Portrait

        Portrait(self.scene, self.time, self.fetch_boxes(), self.listener).save(file)

    def close(self) -> None:
        """Take the nodes down."""
        self._executor.shutdown()
        for node in (self.listener, self.publisher, self._checker):
            node.destroy_node()


def _effects_of(scene: DemoScene | FileScene) -> list[str]:
    """Return the effects to listen to: those a scene file names and does not turn off."""
    said = scene.description.effects if isinstance(scene, FileScene) else {}
    return [name for name in EFFECTS if name in said and said[name].mode != "off"]

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

"""Faults of sensors: killed, frozen, late, without a transform, too fast, the clock set back."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import PointCloud2

from obb_collision.node.messages.names import namespace_number
from obb_collision.node.topics.topics import collisions_from_ros
from tools.faults.bench import Bench, check
from tools.faults.peers import CAMERA, CAMERA_PERIOD, SENSOR_QOS, cloud_at
from tools.faults.processes import LONGEST, MEBIBYTE, SECONDS, SLACK, TIMEOUT, measure
from tools.faults.resources import BEGIN
from tools.fuzz.process import status_of

SOURCES = f"sources:=['{CAMERA}']"
NUMBER = namespace_number(f"sources/{CAMERA}")
LATE, ORDERED = 2.0, 1.0
"""Seconds by which clouds are late, and for which older ones than the last are not used."""
BACK = 100.0
"""Seconds by which the clock is set back."""
AWAY = 500.0
"""Where a point is that collides with nothing (m)."""
MOST_GROWN = 100.0
"""Memory (MiB) by which the node may grow: a queue of clouds, and what is made of one."""


def kill_sensor(bench: Bench) -> str:
    """Kill a camera that sees an obstacle, and start another one."""
    return _silenced(bench, "it was killed", signal.SIGKILL, lambda: bench.peer("camera"))


def freeze_sensor(bench: Bench) -> str:
    """Freeze a camera that sees an obstacle, and let it go on."""
    return _silenced(bench, "it froze", signal.SIGSTOP, None)


def _silenced(
    bench: Bench, what: str, how: signal.Signals, renew: Callable[[], object] | None
) -> str:
    """Silence a camera by a signal; renew: starts another one, else it goes on."""
    bench.start(SOURCES)
    camera = bench.peer("camera")
    bench.until(lambda: _sees(bench), "pair of the camera")
    camera.send(how)
    stale = bench.until(lambda: bench.codes == {"stale"}, "STALE")
    check(stale <= TIMEOUT + SLACK, f"not known only after {stale:.2f} s")
    check(_collides(bench), "the pair was forgotten")
    if renew is None:
        camera.send(signal.SIGCONT)
    else:
        renew()
    right = bench.until(lambda: _sees(bench), "pair of the camera again")
    return f"`stale` {stale:.2f} s after {what}, beside its pair; right after {right:.2f} s more"


def _sees(bench: Bench) -> bool:
    """Return whether the last answer has a pair of the camera, and the status misses nothing."""
    return not bench.codes and _collides(bench)


def _collides(bench: Bench) -> bool:
    """Return whether the last answer has a pair of the camera."""
    rows = collisions_from_ros(bench.client.answers[-1].message)
    return bool(((rows["ns_a"] == NUMBER) | (rows["ns_b"] == NUMBER)).any())


class Camera:
    """A camera in this process, which sees one point, at the cubes of the probe or far from them.

    late: by how much its stamps are (s).
    """

    def __init__(self, bench: Bench, *parameters: str) -> None:
        self._bench, self.x, self.late, self.frame = bench, 0.0, 0.0, "map"
        self.clock: Callable[[], float] = time.time
        self._publisher = bench.client.node.create_publisher(PointCloud2, CAMERA, SENSOR_QOS)
        self._due = 0.0
        bench.start(SOURCES, *parameters)

    def see(self) -> None:
        """Publish a cloud, if one is due."""
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + CAMERA_PERIOD
            points = np.array([[self.x, 0.0, 0.0]])
            self._publisher.publish(cloud_at(points, self.clock() - self.late, self.frame))

    def until(self, codes: set[str], collides: bool, limit: float) -> float:
        """Publish until these reasons are said, and a pair or none; return the seconds it took."""

        def reached() -> bool:
            self.see()
            return self._bench.codes == codes and _collides(self._bench) == collides

        what = f"{codes or 'free'}, {'with' if collides else 'without'} a pair"
        took = self._bench.until(reached, what)
        check(took <= limit + SLACK, f"{what} only after {took:.2f} s")
        return took


def delay_sensor(bench: Bench) -> str:
    """Let a camera fall behind, as by a link that is too slow, and catch up."""
    camera = Camera(bench)
    camera.until(set(), True, TIMEOUT)
    camera.late, camera.x = LATE, AWAY
    bench.levels.clear()
    stale = camera.until({"stale"}, False, TIMEOUT + ORDERED)
    check(DiagnosticStatus.OK not in bench.levels, "it was free meanwhile")
    camera.late, camera.x = 0.0, 0.0
    right = camera.until(set(), True, TIMEOUT)
    return f"`stale` {stale:.2f} s after clouds were {LATE:g} s old; right {right:.2f} s after it"


def lose_frame(bench: Bench) -> str:
    """Let a camera send in a frame that has no transform."""
    camera = Camera(bench)
    camera.until(set(), True, TIMEOUT)
    camera.frame, camera.x = "camera", AWAY
    late = camera.until({"late_frame"}, True, TIMEOUT)
    camera.frame = "map"
    right = camera.until(set(), False, TIMEOUT)
    return (
        f"`late_frame` after {late:.2f} s, beside its pair; right {right:.2f} s after the next one"
    )


def flood(bench: Bench) -> str:
    """Let a camera send 4.9 MB as fast as a process can, for seconds."""
    node = bench.start(SOURCES)
    camera = bench.peer("flood")
    topic = f"input {CAMERA}"
    bench.until(lambda: bench.client.count("messages", topic) > 5, "clouds")
    memory = status_of(node.number, "VmRSS")
    during = measure(node, lambda: bench.probes(SECONDS), LONGEST, "between two answers")
    grown = (status_of(node.number, "VmRSS") - memory) / MEBIBYTE
    counts = [bench.client.count(key, topic) for key in ("messages", "lost", "superseded")]
    camera.kill()
    after = measure(node, bench.probe, LONGEST, "after it until it was right")
    check(grown < MOST_GROWN, f"memory grew by {grown:.1f} MiB")
    taken, lost, superseded = (f"{count:,.0f}" for count in counts)
    return (
        f"longest time between two answers {during:.3f} s; {taken} clouds taken, {lost} lost, "
        f"{superseded} superseded; right {after:.2f} s after it; memory grew by {grown:.1f} MiB"
    )


def set_clock_back(bench: Bench) -> str:
    """Set the clock of a simulation back while a camera sends."""
    now = BEGIN

    def tick() -> float:
        nonlocal now
        now += CAMERA_PERIOD
        bench.tick(now)
        return now

    camera = Camera(bench, "use_sim_time:=true")
    camera.clock = tick
    camera.until(set(), True, TIMEOUT)
    now, camera.x = now - BACK, AWAY
    right = camera.until(set(), False, TIMEOUT)
    return f"{BACK:g} s backwards: right after {right:.2f} s"

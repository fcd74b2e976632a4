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

"""Measures regions: 1 to 4 processes that share a scene, and objects far from a region.

``python -m tools.regions``. Boxes of which half a pair each collide move in a long hall that is
split along x; all processes read the same topic. A sample is the time from just before ``publish``
until the clouds of all regions of that state are there.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2

from obb_collision.cli import SEED, Parser, Progress, interruptible, option, real, whole
from obb_collision.node.messages.conversions import NANOSECONDS, stamp_from_ros
from obb_collision.node.parameters.entries import region_parameters
from obb_collision.node.topics.topics import COLLISIONS
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.region import RegionMerger, split_regions
from tools.fuzz.client import Client, FoundError
from tools.fuzz.process import Child, own_domain
from tools.latency import Hall
from tools.pages import as_markdown, table_of

LENGTH = 8.0
"""How many times longer than wide and high the hall is."""
HALO = 1.0
"""Halo of the regions (m)."""
WARM_SAMPLES = 5
PATIENCE = 120.0
"""Seconds to wait for processes that start, and for an answer."""


class Processes:
    """Collision nodes with a region each, in separate processes, and their messages."""

    def __init__(self, hall: Hall, count: int) -> None:
        self._hall, self._number = hall, 0
        domain = own_domain()
        root = f"/regions_{os.getpid()}_{count}"
        corners = " ".join(map(repr, [0.0] * 3)), " ".join(map(repr, hall.size.tolist()))
        regions = region_parameters(*corners, f"{count} 1 1", repr(HALO))
        self._folder = TemporaryDirectory()
        self.running = [
            Child(arguments_of(root, name, given), domain, Path(self._folder.name) / name)
            for name, given in regions.items()
        ]
        self._client = Client(domain, root, {})
        node = self._client.node
        self._publisher = node.create_publisher(PointCloud2, "object_boxes", 1)
        self._latest: dict[str, PointCloud2] = {}
        for name in regions:

            def take(message: PointCloud2, name: str = name) -> None:
                self._latest[name] = message

            node.create_subscription(PointCloud2, f"{name}/collisions", take, QoSProfile(depth=1))
        self._names = list(regions)

    def sample(self) -> tuple[float, int, int, int]:
        """Return seconds until all answers are there, pairs, and bytes in and out."""
        self._number += 1
        stamp = self._number * NANOSECONDS
        self._hall.move()
        message = self._hall.message(self._number)
        start = perf_counter()
        self._publisher.publish(message)
        while not self._has_all(stamp):
            self._client.spin(0.05)
            if perf_counter() - start > PATIENCE:
                raise FoundError("no answer from a collision node")
        took = perf_counter() - start
        answers = self._latest.values()
        pairs = sum(answer.width for answer in answers)
        sent = sum(len(serialize_message(answer)) for answer in answers)
        return took, pairs, len(serialize_message(message)), sent

    def _has_all(self, stamp: int) -> bool:
        return all(
            name in self._latest and stamp_from_ros(self._latest[name].header.stamp) == stamp
            for name in self._names
        )

    def begin(self) -> None:
        """Wait for all processes; the first samples load code and grow buffers."""
        node, inputs = self._client.node, self._publisher.get_subscription_count
        for child, name in zip(self.running, self._names, strict=True):
            topic = f"{name}/collisions"
            self._client.until(child, partial(node.count_publishers, topic), topic, PATIENCE)
        last, count = self.running[-1], len(self._names)
        self._client.until(last, lambda: inputs() == count, "inputs", PATIENCE)
        for _ in range(WARM_SAMPLES):
            self.sample()

    def cpu_seconds(self) -> list[float]:
        """Return the processor time of each process."""
        ticks = os.sysconf("SC_CLK_TCK")
        found = []
        for process in self.running:
            with open(f"/proc/{process.number}/stat", encoding="ascii") as file:
                words = file.read().rpartition(")")[2].split()
            found.append((int(words[11]) + int(words[12])) / ticks)
        return found

    def merge_seconds(self) -> float:
        """Return the time to merge the last answers."""
        merger = RegionMerger(self._names, timeout=0.5)
        for now in (0.0, 0.25, 0.5):
            for name in self._names:
                merger.mark_alive(name, len(self._hall.sizes), now)
        start = perf_counter()
        for name in self._names:
            merger.take(name, 1, COLLISIONS.from_ros(self._latest[name]), 0.5)
        return perf_counter() - start

    def close(self) -> None:
        """End all processes."""
        self._client.close()
        for process in self.running:
            process.end()
        self._folder.cleanup()


def arguments_of(root: str, name: str, given: dict[str, Any]) -> list[str]:
    """Return the arguments of the node of a region."""
    values = {
        **given,
        "trigger": "arrival",
        "min_period": 0.0,
        "max_objects": 1000000,
        "max_pairs": 1000000,
        "threads": 1,
        "rate": 1.0,
    }
    words = ["--ros-args", "-r", f"__ns:={root}/{name}", "--log-level", "error"]
    words += ["-r", f"object_boxes:={root}/object_boxes"]
    return words + [word for key, value in values.items() for word in ("-p", f"{key}:={value}")]


def measure(objects: int, count: int, seconds: float, seed: int) -> dict[str, Any]:
    """Return the latency of ``count`` processes with the same boxes."""
    hall = Hall(objects, seed, LENGTH)
    processes = Processes(hall, count)
    try:
        processes.begin()
        before, limit = processes.cpu_seconds(), perf_counter() + seconds
        samples: list[tuple[float, int, int, int]] = []
        while perf_counter() < limit or not samples:
            samples.append(processes.sample())
        after = processes.cpu_seconds()
        merge = processes.merge_seconds()
    finally:
        processes.close()
    times = np.array([sample[0] for sample in samples])
    cpu = [(end - start) / len(samples) for start, end in zip(before, after, strict=True)]
    return {
        "processes": count,
        "objects": objects,
        "pairs": samples[-1][1],
        "median (ms)": round(1e3 * float(np.median(times)), 2),
        "95 % (ms)": round(1e3 * float(np.percentile(times, 95)), 2),
        "CPU per state, busiest process (ms)": round(1e3 * max(cpu), 2),
        "CPU per state, all (ms)": round(1e3 * sum(cpu), 2),
        "in per node and state (kB)": round(samples[-1][2] / 1e3),
        "out of all per state (kB)": round(samples[-1][3] / 1e3),
        "merging (ms)": round(1e3 * merge, 2),
        "samples": len(samples),
    }


def far_costs(objects: int, seed: int, repeats: int = 15) -> dict[str, Any]:
    """Return the time of a check of all moving objects, of the whole space and of parts.

    Per object away from the region, by a region that no object is near to.
    """
    hall = Hall(objects, seed, LENGTH)
    parts = {n: split_regions([0] * 3, hall.size, (n, 1, 1), HALO)[0] for n in (1, 2, 4)}
    scenes = {f"1 of {n}": Scene(region=region) for n, region in parts.items()}
    scenes["far"] = Scene(region=split_regions([1e6] * 3, [2e6] * 3, (2, 1, 1), HALO)[1])
    rows: dict[str, list[tuple[float, float]]] = {name: [] for name in scenes}
    for scene in scenes.values():
        scene.add_boxes([str(n) for n in range(objects)], hall.sizes, hall.poses)
        scene.check()
    for _ in range(repeats):  # in turns, so that a busy machine is as busy for all
        poses = hall.move()
        for name, scene in scenes.items():
            start = perf_counter()
            scene.move_indices(scene.indices, poses)
            placed = perf_counter()
            scene.check()
            rows[name].append((placed - start, perf_counter() - placed))
    medians = {name: np.median(1e3 * np.array(times), axis=0) for name, times in rows.items()}
    return {
        name: {
            "near": len(scenes[name].objects.near),
            "moving (ms)": round(float(placing), 3),
            "check (ms)": round(float(check), 3),
        }
        for name, (placing, check) in medians.items()
    }


@interruptible("python -m tools.regions")
def main(args: Sequence[str] | None = None) -> int:
    """Run the measurements of the command line."""
    parser = Parser(
        prog="python -m tools.regions", description=__doc__.splitlines()[0] if __doc__ else None
    )
    option(parser, "--objects", whole(1, 1000000), 10000, "moving boxes")
    option(parser, "--processes", whole(1, 64), 4, "processes at most, from 1 on")
    option(parser, "--seconds", real(0.1, 86400.0), 5.0, "duration of each measurement")
    option(parser, "--seed", SEED, 1, "seed of the random scene")
    options = parser.parse_args(args)
    costs = far_costs(options.objects, options.seed)
    rows: list[dict[str, Any]] = [{"region": name, **row} for name, row in costs.items()]
    print(as_markdown(table_of(rows)), flush=True)
    rows = []
    with Progress() as progress:
        for count in range(1, options.processes + 1):
            progress.show(f"processes that share the hall: {count}")
            rows.append(measure(options.objects, count, options.seconds, options.seed))
    print(f"\n{as_markdown(table_of(rows))}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

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

"""Faults of resources: descriptors, memory, the cache of compiled kernels, and time."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import time
from pathlib import Path
from random import Random

import numpy as np
import trimesh
from geometry_msgs.msg import Point
from visualization_msgs.msg import Marker

from obb_collision._kernel_cache import places
from tools.faults.bench import STARTING, Bench, check, pairs_of
from tools.faults.peers import cube
from tools.fuzz.client import ANSWERING
from tools.fuzz.process import status_of

MORE = 64 * 2**20
"""Bytes of address space that a node gets beyond what it has."""
POINTS = 1_000_000
"""Points of a marker that do not fit into that."""
RIGHT = 1.0


def mesh_marker(folder: Path, number: int) -> Marker:
    """Return a marker of a mesh file of its own."""
    file = folder / f"mesh_{number}.stl"
    trimesh.creation.icosphere(subdivisions=2, radius=0.5).export(file)
    marker = cube(("mesh", number), (50.0 + 2.0 * number, 0.0, 0.0))
    marker.type, marker.mesh_resource = Marker.MESH_RESOURCE, f"file://{file}"
    return marker


def refusals(bench: Bench) -> str:
    """Return the reasons for which objects were refused or are not placed."""
    parts = [bench.client.part(name) for name in ("input objects", "objects")]
    keys = [pair.key for part in parts for pair in part.values]
    return ", ".join(key for key in keys if key.startswith(("rejected: ", "unplaceable: ")))


def few_descriptors(bench: Bench) -> str:
    """Use up a node's descriptors, have it load a mesh file, and free descriptors."""
    node = bench.start(f"mesh_folders:=['{bench.folder}']")
    node.limit(resource.RLIMIT_NOFILE, len(os.listdir(f"/proc/{node.number}/fd")))
    bench.send([mesh_marker(bench.folder, 1)])
    longest = max(bench.probe() for _ in range(10))
    bench.until(
        lambda: (
            bench.client.count("rejected", "input objects")
            + bench.client.count("unplaceable", "objects")
        ),
        "refusal",
    )
    reasons = refusals(bench)
    check(longest <= RIGHT, f"right only after {longest:.2f} s")
    node.limit(resource.RLIMIT_NOFILE, -1)
    markers = [mesh_marker(bench.folder, number) for number in (1, 2)]

    def is_built() -> bool:
        bench.send(markers)
        bench.probe()
        return bench.client.count("unplaceable", "objects") == 0

    built = bench.until(is_built, "mesh, once there are descriptors again")
    return (
        f"others right after {longest:.2f} s at most; the mesh: {reasons or 'waited'}; "
        f"{built:.1f} s after there were some again all was placed"
    )


def little_memory(bench: Bench) -> str:
    """Leave a node 64 MiB of address space, and send it a message that takes more."""
    node = bench.start()
    for _ in range(5):
        bench.probe()
    node.limit(resource.RLIMIT_AS, status_of(node.number, "VmSize") + MORE)
    marker = cube(("large", 1), (100.0, 0.0, 0.0))
    marker.type = Marker.LINE_LIST
    marker.points = np.full(POINTS, Point()).tolist()
    bench.send_apart([marker])  # what it waits for, the probe does not
    bench.spin(2.0)
    longest = max(bench.probe() for _ in range(10))
    check(longest <= RIGHT, f"right only after {longest:.2f} s")
    bench.spin(1.1)  # for /diagnostics of after that
    failures = bench.client.part("internal errors").message
    refused = refusals(bench)
    check(bool(refused) or failures != "none", "it is said nowhere that the message was given up")
    node.limit(resource.RLIMIT_AS, -1)
    after = bench.probe()
    return (
        f"others right after {longest:.2f} s at most; {refused or 'nothing refused'}; "
        f"internal errors: {failures}; {after:.2f} s with memory again"
    )


COLD = 1800.0
"""Seconds in which kernels that are not there are compiled, on a busy machine."""
DISK = 256 * 1024
"""Bytes of a disk that is soon full."""


def unwritable_cache(bench: Bench) -> str:
    """Start with a cache folder in which nothing can be created."""
    blocked = bench.folder / "file"
    blocked.write_text("no folder")
    return _cold(bench, blocked / "cache", "can't be kept")


def full_disk(bench: Bench) -> str:
    """Start with a cache folder on a disk that is full after 256 KiB."""
    folder = bench.folder / "disk"
    folder.mkdir()
    options = ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", str(folder)]
    mounted = os.geteuid() == 0 and shutil.which("mount") is not None
    mounted = mounted and subprocess.run(options, capture_output=True, check=False).returncode == 0
    try:
        limit = None if mounted else DISK // 16
        how = "a real one" if mounted else "files limited in its place"
        return f"{how}: {_cold(bench, folder, 'kernels', limit)}"
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=False)


def _cold(bench: Bench, cache: Path, warning: str, limit: int | None = None) -> str:
    start = time.monotonic()
    node = bench.start(wait=False, NUMBA_CACHE_DIR=str(cache))
    if limit is not None:
        node.limit(resource.RLIMIT_FSIZE, limit)
    bench.begin(COLD)
    took = time.monotonic() - start
    check(node.said(warning), "nothing in the log")
    return f"compiled in the process and right after {took:.0f} s, with a warning"


def corrupt_cache(bench: Bench) -> str:
    """Start with a cache of damaged files, each in another way."""
    cache, random = bench.folder / "cache", Random(1)
    copied = copy_cache(cache)
    check(copied > 0, "there is no cache to damage; start a node once")
    for number, file in enumerate(sorted(cache.rglob("*"))):
        if file.is_file():
            data = file.read_bytes()
            at = random.randrange(len(data))
            bad = bytes([data[at] ^ (1 << random.randrange(8))])
            damaged = (b"", data[: len(data) // 2], data[:at] + bad + data[at + 1 :], b"x" * 1000)
            file.write_bytes(damaged[number % len(damaged)])
    start = time.monotonic()
    bench.start(wait=False, NUMBA_CACHE_DIR=str(cache))
    bench.begin(COLD)
    first = time.monotonic() - start
    return f"{copied} kernels damaged; compiled anew, right after {first:.0f} s"


def copy_cache(to: Path) -> int:
    """Copy the kernels of this package from the cache; return their number."""
    for place in places:
        if place.is_dir():
            shutil.copytree(place, to / "obb_collision", dirs_exist_ok=True)
    return len(list(to.rglob("*.kernel")))


def two_on_a_cold_cache(bench: Bench) -> str:
    """Start two nodes at once on an empty cache, and then a third one."""
    cache = str(bench.folder / "cold")
    first = bench.client.namespace
    second = f"{first}_b"
    start = time.monotonic()
    nodes = [
        bench.start(namespace=namespace, wait=False, NUMBA_CACHE_DIR=cache)
        for namespace in (first, second)
    ]
    seen = []
    for namespace in (first, second):
        if namespace != first:
            bench.listen(namespace)
        bench.begin(COLD)
        seen.append(f"{time.monotonic() - start:.0f} s")
    for node in nodes:
        check(node.end() == 0, "a node did not end well")
    start = time.monotonic()
    bench.start(NUMBA_CACHE_DIR=cache)
    warm = time.monotonic() - start
    check(warm < STARTING, f"the third one took {warm:.0f} s")
    return f"both right, after {' and '.join(seen)}; a third one after {warm:.1f} s, by their cache"


BEGIN, JUMP = 1000.0, 500.0
"""Seconds of the simulation's clock at the start, and by which it jumps."""
STEP = 0.05
"""Seconds in which the node must be right again after a jump."""


class Simulation:
    """A clock that goes on while the node is asked: states have its time as their stamps."""

    def __init__(self, bench: Bench) -> None:
        self._bench, self.now = bench, BEGIN

    def probe(self) -> float:
        """Let the clock go on, and ask by states of now; returns the seconds until it is right."""
        self.now += STEP
        self._bench.tick(self.now)
        return self._bench.probe(ANSWERING, self.now)

    def run(self, count: int) -> float:
        """Ask several times; returns the longest time until the node was right."""
        return max(self.probe() for _ in range(count))


def jump_clock(bench: Bench) -> str:
    """Let the clock of a simulation jump forwards and backwards, as a bag does that loops."""
    bench.start("use_sim_time:=true")
    simulation = Simulation(bench)
    simulation.run(10)
    seen = []
    for name, jump in (("forwards", JUMP), ("backwards", -2.0 * JUMP), ("backwards", -100.0)):
        simulation.now += jump
        first = simulation.probe()
        rest = simulation.run(5)
        check(first <= RIGHT + 1.0 and rest <= RIGHT, f"{name}: right after {first:.2f} s")
        seen.append(f"{abs(jump):g} s {name}: right after {first:.2f} s")
    bench.spin(1.1)  # for /diagnostics of after that
    late = bench.client.count("rejected: older stamp", "input objects")
    return f"{'; '.join(seen)}; {late:g} states refused, which overtook the clock's message"


def stop_clock(bench: Bench) -> str:
    """Stop the clock of a simulation, while states still come, and then states, too."""
    bench.start("use_sim_time:=true", "input_timeout:=0.5")
    simulation = Simulation(bench)
    simulation.run(5)
    longest = max(bench.probe(ANSWERING, simulation.now) for _ in range(10))
    check(longest <= RIGHT, f"right only after {longest:.2f} s")
    stale = bench.until(lambda: "input_silent" in bench.codes, "silence")
    check(stale <= 0.5 + RIGHT, f"not known only after {stale:.2f} s")
    return (
        f"right after {longest:.2f} s at most while it stood still; `input_silent` "
        f"{stale:.2f} s after the last state, by the clock of the watchdog"
    )


def refuse_old(bench: Bench) -> str:
    """Send states that are older than those of the node, object by object."""
    bench.start("order_timeout:=30.0")
    now = time.time()
    bench.move("probe/2", 20.0, now)
    bench.move("probe/3", 40.0, now)
    bench.move("probe/3", 20.5, now - 1.0)  # late: would collide with the second
    bench.move("probe/1", 40.5, now + 0.01)  # newer than its last: collides with the third
    took = bench.until(
        lambda: pairs_of(bench.client.answers[-1]) == {(1, 3)}, "the pair of the newest states"
    )
    topic = "input object_transform"
    bench.until(lambda: bench.client.count("rejected: older stamp", topic) == 1.0, "one refusal")
    return f"1 of 4 states refused (`older stamp`), the others used, after {took:.2f} s"

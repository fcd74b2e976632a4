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

"""The node in a process of its own, a process that shows stalls, and the set-up of Fast DDS."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from statistics import median
from typing import IO, Any, NamedTuple
from unittest.mock import patch

ENDING = 30.0
"""Seconds that the process has to end after SIGINT, beside those it waits for a processor."""
WATCHING = 1.0
"""Seconds after which it is seen whether it waited."""
WAITING = 2
"""Threads that may wait for a processor one after the other: the cycle for the middleware."""


class Usage(NamedTuple):
    """Resources of a process: resident memory (bytes), that of children, descriptors, threads."""

    memory: float
    descriptors: float
    threads: float
    children: float = 0.0


WARM_UP, WINDOW = 0.5, 0.2
"""Shares of the samples before the first one that counts, and of those that are compared.

In the first half of an attack stores of objects, copies of them for effects and meshes fill up to
their limits: 60 MB that are no leak, after which the memory stays as it is."""
FEWEST = 40
"""Samples from which on growth is judged."""


class Usages:
    """Samples of the resources of a process; a share at the beginning is warm-up."""

    def __init__(self, warm_up: float = WARM_UP, window: float = WINDOW) -> None:
        self.samples: list[Usage] = []
        self._warm_up, self._window = warm_up, window

    def add(self, usage: Usage | None) -> None:
        """Add a sample, if there is one."""
        if usage is not None:
            self.samples.append(usage)

    def ends(self) -> tuple[Usage, Usage]:
        """Return the medians of samples after warm-up, and of as many at the end."""
        count = len(self.samples)
        start, size = int(self._warm_up * count), max(1, round(self._window * count))
        early, late = self.samples[start : start + size], self.samples[-size:]
        first, last = (Usage(*map(median, zip(*part, strict=True))) for part in (early, late))
        return first, last

    def growth(self) -> Usage | None:
        """Return the growth of a resource, None for too few samples."""
        if len(self.samples) < FEWEST:
            return None
        return Usage(*(round(after - before) for before, after in zip(*self.ends(), strict=True)))

    def course(self) -> list[float]:
        """Return the median memory (bytes) of each tenth of the samples, in their order."""
        size = max(1, len(self.samples) // 10)
        parts = [self.samples[k : k + size] for k in range(0, len(self.samples), size)]
        return [median(usage.memory for usage in part) for part in parts]


def status_of(number: int, field: str) -> int:
    """Return a size of a process (bytes), such as VmRSS; 0 after its end."""
    lines = Path(f"/proc/{number}/status").read_text().splitlines()
    return sum(1024 * int(line.split()[1]) for line in lines if line.startswith(f"{field}:"))


def last_lines(log: Path, count: int = 20) -> list[str]:
    """Return the last lines of the output of a process, empty before its start."""
    return log.read_text(errors="replace").splitlines()[-count:] if log.exists() else []


def own_domain() -> int:
    """Return a domain of this process: nodes of others on this machine must not answer."""
    return 1 + os.getpid() % 100


NODE = "obb_collision.commands"
ALLOCATOR = {"MALLOC_MMAP_THRESHOLD_": str(2**20)}
"""Blocks of a MiB and more are returned to the system. By default glibc keeps ever larger ones, up
to 32 MB: memory grows in steps where large messages come, which would hide what is lost."""


class Child:
    """A node's process; its output goes to ``log``. module: to run; more: its environment."""

    def __init__(
        self, arguments: Sequence[str], domain: int, log: Path, module: str = NODE, **more: str
    ) -> None:
        self.log = log
        self._output: IO[bytes] = log.open("wb")
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            env={**ALLOCATOR, **os.environ, "ROS_DOMAIN_ID": str(domain), **more},
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
        )

    @property
    def number(self) -> int:
        """Number of the process."""
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """Exit code, None while it runs; a negative one is the signal that ended it."""
        return self._process.poll()

    def usage(self) -> Usage | None:
        """Return its resources, None if the system does not report them."""
        folder = Path(f"/proc/{self._process.pid}")
        try:
            memory = status_of(self._process.pid, "VmRSS")
            files, tasks = (len(list((folder / name).iterdir())) for name in ("fd", "task"))
            lists = [(task / "children").read_text() for task in (folder / "task").iterdir()]
            children = sum(status_of(int(child), "VmRSS") for child in "".join(lists).split())
        except OSError:
            return None
        return Usage(memory, files, tasks, children) if memory else None

    def delays(self) -> dict[str, float]:
        """Return the time (s) that each thread waited for a processor, by its number."""
        waits = {}
        for file in Path(f"/proc/{self._process.pid}/task").glob("*/schedstat"):
            try:
                waits[file.parent.name] = int(file.read_text().split()[1]) * 1e-9
            except OSError:  # it has ended
                continue
        return waits

    def waited(self, before: dict[str, float]) -> float:
        """Return how long (s) the WAITING threads that waited most did so since ``delays``."""
        waits = sorted(delay - before.get(name, 0.0) for name, delay in self.delays().items())
        return sum(waits[-WAITING:])

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def end(self) -> int:
        """End it as Ctrl-C would, even if it is frozen, else by force; return its exit code."""
        if self.exit_code is None:
            self.send(signal.SIGCONT)
            self.send(signal.SIGINT)
        start, before = time.monotonic(), self.delays()
        while self.exit_code is None:
            if time.monotonic() - start > ENDING + self.waited(before):
                self._process.kill()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=WATCHING)
        return self.kill()

    def kill(self) -> int:
        """End it by force, at once; returns its exit code."""
        if self.exit_code is None:
            self._process.kill()
        self._output.close()
        return int(self._process.wait())

    def limit(self, what: int, most: int) -> None:
        """Limit a resource of the running process (RLIMIT_*); its parent's stays. -1: no more."""
        _, hard = resource.prlimit(self.number, what)
        resource.prlimit(self.number, what, (most if most >= 0 else hard, hard))

    def said(self, text: str) -> bool:
        """Return whether its output has a text."""
        return text in self.log.read_text(errors="replace")

    def lines(self) -> list[str]:
        """Return the last lines of its output."""
        return last_lines(self.log)


NAP = 0.005
"""Seconds of a sleep."""
LATE = 0.01
"""Seconds by which it wakes late that count."""
SLEEPER = f"""
import os, time
parent = os.getppid()
os.write(1, b"awake\\n")
while os.getppid() == parent:
    wanted = time.time() + {NAP}
    time.sleep({NAP})
    if (woken := time.time()) > wanted + {LATE}:
        os.write(1, f"{{wanted}} {{woken}}\\n".encode())
"""
"""Prints when it should have woken and when it did (s since 1970)."""


class Canary:
    """A process that only sleeps, and reports how late it woke.

    Whatever keeps it from running keeps others from it, too: other programs, a hypervisor that
    gives the processor away, memory that is being freed.
    """

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", SLEEPER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self._process.stdout is not None
        self._process.stdout.readline()
        os.set_blocking(self._process.stdout.fileno(), False)
        self._rest = b""

    def stalls(self) -> list[tuple[float, float]]:
        """Return the begin and end (s since 1970) of each stall since the last call."""
        assert self._process.stdout is not None
        *lines, self._rest = (self._rest + (self._process.stdout.read() or b"")).split(b"\n")
        return [(float(start), float(end)) for start, end in (line.split() for line in lines)]

    @property
    def number(self) -> int:
        """Number of the process."""
        return self._process.pid

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()


HEARTBEAT = """<data_writer profile_name="writer" is_default_profile="true">
<times><heartbeatPeriod><sec>0</sec><nanosec>20000000</nanosec></heartbeatPeriod></times>
<historyMemoryPolicy>DYNAMIC</historyMemoryPolicy></data_writer>
<data_reader profile_name="reader" is_default_profile="true">
<historyMemoryPolicy>DYNAMIC</historyMemoryPolicy></data_reader>"""
"""What is lost is sent again after a heartbeat only: by default up to 3 seconds later. And Fast DDS
keeps by default for each place in a queue the memory of its largest message: bounded, but as much
as a leak of a node would be."""
NO_SHARED_MEMORY = """<transport_descriptors><transport_descriptor>
<transport_id>loopback</transport_id><type>UDPv4</type>
<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>
</transport_descriptor></transport_descriptors>
<participant profile_name="participant" is_default_profile="true"><rtps>
<userTransports><transport_id>loopback</transport_id></userTransports>
<useBuiltinTransports>false</useBuiltinTransports></rtps></participant>"""
"""A process that is killed while it writes to a queue in shared memory leaves it locked, and others
wait up to a second for each such queue; see ``docs/faults.md``. This sends by UDP."""
PROFILE = """<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
{}
</profiles></dds>
"""
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
"""By UDP a message of 28 MB takes the middleware up to a minute on a busy machine, and what is
behind it waits: that is no fault of a node. LARGE_DATA sends by TCP."""
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
"""With LOCALHOST the layer of ROS chooses transports itself, shared memory among them."""


def for_large_messages(folder: Path) -> AbstractContextManager[Any]:
    """Set up participants that this process and its children make meanwhile: see the constants."""
    return _set_up(folder, HEARTBEAT, {TRANSPORTS: os.environ.get(TRANSPORTS, "LARGE_DATA")})


def for_killed_processes(folder: Path) -> AbstractContextManager[Any]:
    """Set up the first participant of this process, and those of its children, alike."""
    return _set_up(folder, f"{NO_SHARED_MEMORY}\n{HEARTBEAT}", {RANGE: "SYSTEM_DEFAULT"})


def _set_up(folder: Path, profiles: str, more: dict[str, str]) -> AbstractContextManager[Any]:
    profile = folder / "middleware.xml"
    profile.write_text(PROFILE.format(profiles))
    ours = {
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile),
        "RMW_FASTRTPS_USE_QOS_FROM_XML": "1",
    }
    return patch.dict(os.environ, ours | more)

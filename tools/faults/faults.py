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

"""The list of faults, and how one is tried."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tools.faults import caches, loads, processes, resources, times
from tools.faults.bench import Bench, FaultError
from tools.middleware import for_killed_processes


class Fault(NamedTuple):
    """A fault, what is expected of a node, and the function that makes it and says what it saw."""

    name: str
    expected: str
    make: Callable[[Bench], str]
    slow: bool = False
    """Whether kernels are compiled, which takes minutes."""

    @property
    def what(self) -> str:
        """What is done, in a sentence."""
        return (self.make.__doc__ or "").strip()


FAULTS = (
    Fault(
        "publisher-killed",
        "`input_silent` and `stale` within the timeout (0.5 s) and 1 s, beside the pairs that "
        "collided; right as soon as another one publishes",
        processes.kill_publisher,
    ),
    Fault(
        "tracker-silent",
        "`stale` within its limit (0.5 s) and 1 s, beside the pairs that collided",
        processes.silence_tracker,
    ),
    Fault(
        "nothing-heard",
        "STALE, never free; right within 1 s of the first objects",
        processes.hear_nothing,
    ),
    Fault(
        "input-unreadable",
        "STALE within 1 s, until the next message that can be read",
        processes.send_unreadable,
    ),
    Fault(
        "node-killed",
        "subscribers get a missed deadline within 1.5 s; then STALE, never free, until the objects "
        "are sent again",
        processes.kill_node,
    ),
    Fault("node-ended", "its last message says `shutting_down`; exit code 0", processes.end_node),
    Fault(
        "node-frozen",
        "subscribers get a missed deadline within 1.5 s; right within 1 s when it goes on",
        processes.freeze_node,
    ),
    Fault(
        "reader-stopped",
        "no answer later than 1 s, memory bounded",
        processes.stop_reader,
    ),
    Fault("clock-jumps", "right within 1 s after each jump", times.jump_clock),
    Fault(
        "clock-stops",
        "right while states come; `input_silent` when they stop, too, within 0.5 s and 1 s",
        times.stop_clock,
    ),
    Fault("old-states", "only what is older than its object's state is refused", times.refuse_old),
    Fault(
        "overload",
        "the newest state counts, no answer later than 1 s, drops counted, right within 1 s after",
        loads.overload,
    ),
    Fault("parameter-storm", "no answer later than 1 s", loads.storm_parameters),
    Fault(
        "few-descriptors",
        "the mesh is refused or waits, others right within 1 s; all right with descriptors again",
        resources.few_descriptors,
    ),
    Fault(
        "little-memory", "the message is given up, others right within 1 s", resources.little_memory
    ),
    Fault("cache-unwritable", "right, with a warning", caches.unwritable_cache, slow=True),
    Fault("cache-corrupt", "right, by kernels compiled anew", caches.corrupt_cache, slow=True),
    Fault("disk-full", "right, with a warning", caches.full_disk, slow=True),
    Fault("cold-cache", "both right, and so is a third", caches.two_on_a_cold_cache, slow=True),
)
BY_NAME = {fault.name: fault for fault in FAULTS}


class Outcome(NamedTuple):
    """What was seen, whether it was what was expected, and the seconds it took in all."""

    fault: Fault
    seen: str
    held: bool
    seconds: float


def attempt(fault: Fault, domain: int) -> Outcome:
    """Make a fault, with processes of its own.

    They do without shared memory, if this process has made no participant before.
    """
    start = time.monotonic()
    with (
        tempfile.TemporaryDirectory(prefix="obb_collision-faults-") as folder,
        for_killed_processes(Path(folder)),
    ):
        bench = Bench(Path(folder), domain)
        try:
            seen, held = fault.make(bench), True
        except FaultError as error:
            seen, held = f"{error}; last lines: {_last_lines(Path(folder))}", False
        finally:
            bench.close()
    return Outcome(fault, seen, held, time.monotonic() - start)


def _last_lines(folder: Path) -> str:
    lines = [log.read_text(errors="replace").splitlines()[-5:] for log in folder.glob("node_*.log")]
    return " / ".join(line for some in lines for line in some)

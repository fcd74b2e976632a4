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

"""The list of faults, how one is tried, and the console script ``python -m tools.faults``."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from obb_collision.cli import Parser, interruptible, new_file, option
from tools.faults import processes, resources, sensors
from tools.faults.bench import Bench
from tools.fuzz.client import FoundError
from tools.fuzz.process import for_killed_processes, last_lines, own_domain
from tools.pages import write_into


class Fault(NamedTuple):
    """A fault, the expected reaction of a node, and the function that makes the fault."""

    name: str
    expected: str
    make: Callable[[Bench], str]
    slow: bool = False
    """Whether kernels are compiled, which takes minutes."""

    @property
    def what(self) -> str:
        """The description of the fault."""
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
    Fault("clock-jumps", "right within 1 s after each jump", resources.jump_clock),
    Fault(
        "clock-stops",
        "right while states come; `input_silent` when they stop, too, within 0.5 s and 1 s",
        resources.stop_clock,
    ),
    Fault(
        "old-states", "only what is older than its object's state is refused", resources.refuse_old
    ),
    Fault(
        "overload",
        "the newest state counts, no answer later than 1 s, drops counted, right within 1 s after",
        processes.overload,
    ),
    Fault(
        "sensor-killed",
        "`stale` within its timeout (0.5 s) and 1 s, beside its pair; right with the next one",
        sensors.kill_sensor,
    ),
    Fault(
        "sensor-frozen",
        "`stale` within its timeout (0.5 s) and 1 s, beside its pair; right when it goes on",
        sensors.freeze_sensor,
    ),
    Fault(
        "sensor-late",
        "`stale` within 1.5 s and 1 s, never free; right when it has caught up",
        sensors.delay_sensor,
    ),
    Fault(
        "sensor-frame-lost",
        "`late_frame` within 0.5 s and 1 s, beside its pair; right with a frame that is known",
        sensors.lose_frame,
    ),
    Fault("sensor-flood", "no answer later than 1 s, memory bounded, drops counted", sensors.flood),
    Fault("sensor-clock-back", "right within 1.5 s", sensors.set_clock_back),
    Fault("parameter-storm", "no answer later than 1 s", processes.storm_parameters),
    Fault(
        "few-descriptors",
        "the mesh is refused or waits, others right within 1 s; all right with descriptors again",
        resources.few_descriptors,
    ),
    Fault(
        "little-memory", "the message is given up, others right within 1 s", resources.little_memory
    ),
    Fault("cache-unwritable", "right, with a warning", resources.unwritable_cache, slow=True),
    Fault("cache-corrupt", "right, by kernels compiled anew", resources.corrupt_cache, slow=True),
    Fault("disk-full", "right, with a warning", resources.full_disk, slow=True),
    Fault("cold-cache", "both right, and so is a third", resources.two_on_a_cold_cache, slow=True),
)
BY_NAME = {fault.name: fault for fault in FAULTS}


class Outcome(NamedTuple):
    """The observation, whether it was expected, and the seconds in all."""

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
            observed, held = fault.make(bench), True
        except FoundError as error:
            logs = Path(folder).glob("node_*.log")
            last = " / ".join(line for log in logs for line in last_lines(log, 5))
            observed, held = f"{error}; last lines: {last}", False
        finally:
            bench.close()
    return Outcome(fault, observed, held, time.monotonic() - start)


HEAD = ("| fault | what the node did |", "|---|---|")


def _parser() -> Parser:
    parser = Parser(
        prog="python -m tools.faults",
        description="Make faults around a node, each with real processes, and see what it does: "
        "publishers and nodes that are killed, clocks that jump, caches that are damaged, few "
        "resources, too much to do. The exit code is 0 only if all went as expected.",
    )
    text = "fault to make, all if none is given; may be given several times"
    parser.add_argument("--only", action="append", choices=sorted(BY_NAME), help=text)
    parser.add_argument("--quick", action="store_true", help="leave out what compiles for minutes")
    option(parser, "--markdown", new_file(".md"), text="page whose table is written anew")
    return parser


@interruptible("python -m tools.faults")
def main(args: Sequence[str] | None = None) -> int:
    """Make faults; returns 0 only if all reactions were expected."""
    options = _parser().parse_args(args)
    chosen = [BY_NAME[name] for name in options.only or BY_NAME]
    domain = own_domain()
    outcomes = []
    for fault in chosen:
        if options.quick and fault.slow:
            continue
        outcomes.append(attempt(fault, domain))
        print(line_of(outcomes[-1]), flush=True)
    if options.markdown:
        write_table(options.markdown, outcomes)
    return 0 if all(outcome.held for outcome in outcomes) else 1


def line_of(outcome: Outcome) -> str:
    """Return a line about a fault."""
    held = "as expected" if outcome.held else "NOT AS EXPECTED"
    fault = outcome.fault
    return (
        f"{fault.name}: {held}, {outcome.seconds:.1f} s\n  fault: {fault.what}\n"
        f"  expected: {fault.expected}\n  seen: {outcome.seen}"
    )


def row_of(outcome: Outcome) -> str:
    """Return a row of a table in Markdown."""
    fault = outcome.fault
    text = outcome.seen if outcome.held else f"**not as expected**: {outcome.seen}"
    return f"| `{fault.name}` | {text.replace('|', '/')} |"


def write_table(page: Path, outcomes: Sequence[Outcome]) -> None:
    """Write rows into the table of a page, in the order of the faults; those of others stay."""
    text = page.read_text(encoding="utf-8") if page.exists() else ""
    rows = {line.split("`")[1]: line for line in text.splitlines() if line.startswith("| `")}
    rows |= {outcome.fault.name: row_of(outcome) for outcome in outcomes}
    lines = [*HEAD, *(rows[name] for name in BY_NAME if name in rows)]
    write_into(page, {"faults": "\n".join(lines)})


if __name__ == "__main__":
    raise SystemExit(main())

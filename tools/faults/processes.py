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

"""Faults of processes and loads: programs killed, frozen or not reading; too much to do."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus

from tools.faults.bench import Bench, check
from tools.faults.peers import BURST
from tools.fuzz.process import Child, status_of

TIMEOUT = 0.5
"""Seconds after which a node takes input for stopped, in these faults."""
LIMIT = f"object_timeout_overrides:=['{BURST}={TIMEOUT}']"
SLACK = 1.0
"""Seconds more than what is promised that a busy machine may take."""
FROZEN = 2.0
"""Seconds for which a process is stopped."""
MEBIBYTE = 2**20


def kill_publisher(bench: Bench) -> str:
    """Kill a publisher in the middle of a burst, and start another one."""
    bench.start(LIMIT, f"input_timeout:={TIMEOUT}", "max_objects:=600")
    sender = bench.peer("sender")
    bench.until(lambda: bench.client.count("count", "objects") > 500, "objects of the burst")
    bench.until(lambda: not bench.codes, "answer while it sends")
    sender.kill()
    stale = bench.until(lambda: bench.codes == {"input_silent", "stale"}, "both reasons")
    check(stale <= TIMEOUT + SLACK, f"not known only after {stale:.2f} s")
    again = bench.peer("sender")
    right = bench.until(lambda: not bench.codes, "answer to the next publisher")
    again.kill()
    probe = bench.probe()
    return (
        f"`input_silent` and `stale` {stale:.2f} s after it was killed; right {right:.2f} s "
        f"after the next publisher was at work; then another question answered in {probe:.2f} s"
    )


def silence_tracker(bench: Bench) -> str:
    """Kill one of two publishers; the other one continues."""
    bench.start(LIMIT, "max_objects:=600")
    sender = bench.peer("sender")
    bench.until(
        lambda: bench.client.count("count", "objects") > 500, "objects of the other publisher"
    )
    bench.until(lambda: not bench.codes, "answer while both send")
    sender.kill()
    killed = time.monotonic()

    def is_stale() -> bool:
        bench.probe()
        return time.monotonic() > killed + TIMEOUT + SLACK or "stale" in bench.codes

    bench.until(is_stale, "STALE")
    seconds = time.monotonic() - killed
    check("stale" in bench.codes, f"not `stale` after {seconds:.2f} s")
    return f"`stale` {seconds:.2f} s after it was killed, while others went on"


def hear_nothing(bench: Bench) -> str:
    """Start a node to which nobody sends anything."""
    bench.start(wait=False)
    bench.meet()
    start = time.monotonic()
    bench.until(lambda: bench.is_stale("no_objects"), "STALE")
    bench.spin(FROZEN)
    check(bench.levels == {DiagnosticStatus.STALE}, f"levels {bench.levels}")
    return (
        f"STALE (`{min(bench.codes)}`), and nothing else in {time.monotonic() - start:.1f} s; "
        f"right {bench.probe():.2f} s after the first objects"
    )


def send_unreadable(bench: Bench) -> str:
    """Send a message that ends too early, as a sender with another version does."""
    bench.start()
    while bench.status.level != DiagnosticStatus.OK:  # a pair that collides would make it ERROR
        bench.probe()
        bench.spin(TIMEOUT)
    bench.send_cut()
    stale = bench.until(lambda: bench.is_stale("input_unreadable"), "STALE")
    check(stale <= SLACK, f"STALE only after {stale:.2f} s")
    bench.spin(SLACK)
    check(bench.is_stale("input_unreadable"), "it did not stay so")
    right = bench.probe()
    bench.until(lambda: not bench.codes, "answer after")
    return f"STALE (`input_unreadable`) after {stale:.2f} s; right {right:.2f} s after the next one"


def kill_node(bench: Bench) -> str:
    """Kill a node, and start it again, while states go on, but no objects are sent."""
    node = bench.start()
    bench.probes(1.0)
    bench.deadlines.clear()
    killed = time.monotonic()
    node.kill()
    bench.until(lambda: bench.deadlines, "missed deadline")
    missed = bench.deadlines[0] - killed
    check(missed <= 0.5 + SLACK, f"the deadline was missed only after {missed:.2f} s")
    bench.levels.clear()
    started = time.monotonic()
    bench.start(wait=False)
    bench.meet()

    def is_stale() -> bool:
        bench.move("probe/1", 0.0)
        return bench.is_stale("unknown_objects")

    bench.until(is_stale, "STALE")
    said = time.monotonic() - started
    end = time.monotonic() + FROZEN
    bench.until(lambda: is_stale() and time.monotonic() > end, "end of a time", FROZEN + SLACK)
    check(bench.levels == {DiagnosticStatus.STALE}, f"levels {bench.levels}")
    codes = ", ".join(f"`{code}`" for code in sorted(bench.codes))
    return (
        f"deadline missed {missed:.2f} s after it was killed; STALE ({codes}) {said:.1f} s after "
        f"it was started again, and nothing else for {FROZEN:g} s; right {bench.probe():.2f} s "
        "after its objects were sent again"
    )


def end_node(bench: Bench) -> str:
    """End a node by SIGTERM."""
    node = bench.start()
    start = time.monotonic()
    node.send(signal.SIGTERM)
    said = bench.until(lambda: "shutting_down" in bench.codes, "last message")
    bench.until(lambda: node.exit_code is not None, "end of the process")
    check(node.exit_code == 0, f"it ended with {node.exit_code}")
    return f"`shutting_down` after {said:.2f} s, ended after {time.monotonic() - start:.2f} s"


def freeze_node(bench: Bench) -> str:
    """Stop the process of a node for two seconds."""
    node = bench.start()
    bench.probe()
    bench.deadlines.clear()
    frozen = time.monotonic()
    node.send(signal.SIGSTOP)
    bench.until(lambda: bench.deadlines, "missed deadline")
    missed = bench.deadlines[0] - frozen
    check(missed <= 0.5 + SLACK, f"the deadline was missed only after {missed:.2f} s")
    bench.spin(FROZEN - (time.monotonic() - frozen))
    node.send(signal.SIGCONT)
    right = bench.probe()
    check(right <= SLACK, f"right only after {right:.2f} s")
    return f"deadline missed after {missed:.2f} s; right {right:.2f} s after it went on"


def stop_reader(bench: Bench) -> str:
    """Stop a subscriber of all topics, reliable and with long queues, that never reads."""
    node = bench.start("marker_rate:=50.0")
    reader = bench.peer("reader")
    bench.until(lambda: len(bench.client.answers) > 50, "answers with every effect", 120.0)
    before = bench.probes(2.0)
    memory = status_of(node.number, "VmRSS")
    reader.send(signal.SIGSTOP)
    bench.probes(2.0)
    middle = status_of(node.number, "VmRSS")
    during = bench.probes(4.0)
    grown = (status_of(node.number, "VmRSS") - middle) / MEBIBYTE
    check(during <= SLACK, f"{during:.2f} s between two answers")
    check(grown < 10.0, f"the node grew by {grown:.1f} MiB in 4 s")
    total = (status_of(node.number, "VmRSS") - memory) / MEBIBYTE
    return (
        f"longest time between two answers {during:.3f} s, {before:.3f} s before; memory of the "
        f"node grew by {total:.1f} MiB in 6 s, {grown:.1f} of them in the last 4"
    )


SECONDS = 5.0
LONGEST = RECOVERY = 1.0
"""Seconds between two answers under load, and those after it until the next one is right."""


def measure(node: Child, run: Callable[[], float], most: float, what: str) -> float:
    """Return what ``run`` measures (s); FoundError for more than a node may take.

    most: of a node with a processor of its own. It may take longer by as much as its main thread
    waited for one, because what makes the load runs on the same machine.
    """
    before = _scheduled(node)
    took = run()
    running, waiting = (now - then for now, then in zip(_scheduled(node), before, strict=True))
    most *= 1.0 + waiting / max(running, 1)
    check(took <= most, f"{took:.2f} s {what}, {most:.2f} allowed")
    return took


def _scheduled(node: Child) -> list[int]:
    """Return for how long the main thread has run, and has waited for a processor (ns)."""
    return [int(part) for part in Path(f"/proc/{node.number}/schedstat").read_text().split()[:2]]


def overload(bench: Bench) -> str:
    """Send as fast as two processes can, for seconds."""
    node = bench.start("max_objects:=600")
    senders = [bench.peer("sender") for _ in range(2)]
    bench.until(lambda: bench.client.count("count", "objects") > 500, "objects of the senders")
    memory = status_of(node.number, "VmRSS")
    during = measure(node, lambda: bench.probes(SECONDS), LONGEST, "between two answers")
    delay = bench.client.count("longest delay (s)", "cycle")
    for sender in senders:
        sender.send(signal.SIGINT)
    for sender in senders:
        sender.end()
    recovery = measure(node, bench.probe, RECOVERY, "after the load until it was right")
    grown = (status_of(node.number, "VmRSS") - memory) / 2**20
    bench.spin(1.1)  # for /diagnostics of after that
    topics = ("input objects", "input object_poses")
    lost, superseded, messages = (
        sum(bench.client.count(key, topic) for topic in topics)
        for key in ("lost", "superseded", "messages")
    )
    check(lost + superseded > 0, "no drop was counted")
    return (
        f"longest time between two answers {during:.3f} s, longest delay of a state {delay:.3f} s; "
        f"{messages:,.0f} messages taken, {lost:,.0f} lost, {superseded:,.0f} states superseded; "
        f"right {recovery:.2f} s after it ended; memory grew by {grown:.1f} MiB"
    )


def storm_parameters(bench: Bench) -> str:
    """Set valid and invalid parameters from three processes, for seconds."""
    node = bench.start()
    setters = [bench.peer("setter") for _ in range(3)]
    during = measure(node, lambda: bench.probes(SECONDS), LONGEST, "between two answers")
    for setter in setters:
        setter.kill()
    after = measure(node, bench.probe, RECOVERY, "after it until it was right")
    return f"longest time between two answers {during:.3f} s; right {after:.2f} s after it"

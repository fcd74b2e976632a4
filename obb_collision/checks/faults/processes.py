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

"""Faults of processes: publishers, nodes and subscribers that are killed, frozen or do not read."""

from __future__ import annotations

import signal
import time

from obb_collision.checks.faults.bench import Bench, check

TIMEOUT = 0.5
"""Seconds after which a node takes input for stopped, in these faults."""
SLACK = 1.0
"""Seconds more than what is promised that a busy machine may take."""
FROZEN = 2.0
"""Seconds for which a process is stopped."""
MEBIBYTE = 2**20


def kill_publisher(bench: Bench) -> str:
    """Kill a publisher in the middle of a burst, and start another one."""
    bench.start(f"object_timeout:={TIMEOUT}", f"input_timeout:={TIMEOUT}", "max_objects:=600")
    sender = bench.peer("sender")
    bench.until(lambda: bench.value("objects", "count") > 500, "objects of the burst")
    bench.until(lambda: not bench.is_stale(), "answer while it sends")
    sender.kill()
    stale = bench.until(lambda: bench.is_stale("no state placed", "no input"), "STALE")
    check(stale <= TIMEOUT + SLACK, f"STALE only after {stale:.2f} s")
    reason = bench.status.message.split(";")[0]
    again = bench.peer("sender")
    right = bench.until(lambda: not bench.is_stale(), "answer to the next publisher")
    again.kill()
    probe = bench.probe()
    return (
        f"STALE {stale:.2f} s after it was killed (`{reason}`); right {right:.2f} s after the next "
        f"publisher was at work; then another question answered in {probe:.2f} s"
    )


def kill_node(bench: Bench) -> str:
    """Kill a node, and start it again."""
    node = bench.start()
    bench.probes(1.0)
    bench.deadlines.clear()
    killed = time.monotonic()
    node.kill()
    bench.until(lambda: bench.deadlines, "missed deadline")
    missed = bench.deadlines[0] - killed
    check(missed <= 0.5 + SLACK, f"the deadline was missed only after {missed:.2f} s")
    started = time.monotonic()
    bench.start()
    return (
        f"deadline missed {missed:.2f} s after it was killed; right "
        f"{time.monotonic() - started:.1f} s after it was started again, with its objects sent anew"
    )


def end_node(bench: Bench) -> str:
    """End a node by SIGTERM."""
    node = bench.start()
    start = time.monotonic()
    node.send(signal.SIGTERM)
    said = bench.until(lambda: bench.is_stale("shutting down"), "last message")
    bench.until(lambda: node.exit_code is not None, "end of the process")
    check(node.exit_code == 0, f"it ended with {node.exit_code}")
    return (
        f"STALE (`shutting down`) after {said:.2f} s, ended after {time.monotonic() - start:.2f} s"
    )


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
    bench.until(lambda: len(bench.answers) > 50, "answers with every effect", 120.0)
    before = bench.probes(2.0)
    memory = node.status("VmRSS")
    reader.send(signal.SIGSTOP)
    bench.probes(2.0)
    middle = node.status("VmRSS")
    during = bench.probes(4.0)
    grown = (node.status("VmRSS") - middle) / MEBIBYTE
    check(during <= SLACK, f"{during:.2f} s between two answers")
    check(grown < 10.0, f"the node grew by {grown:.1f} MiB in 4 s")
    total = (node.status("VmRSS") - memory) / MEBIBYTE
    return (
        f"longest time between two answers {during:.3f} s, {before:.3f} s before; memory of the "
        f"node grew by {total:.1f} MiB in 6 s, {grown:.1f} of them in the last 4"
    )

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

"""Too much to do: more messages than a node can take, and parameters set without a pause."""

from __future__ import annotations

import signal

from tools.faults.bench import Bench, check

SECONDS = 5.0
LONGEST = 1.0
"""Seconds between two answers under load, at most, of a node with a processor of its own: more by
as much as it waited for one, because what makes the load runs on the same machine."""
RECOVERY = 1.0
"""Seconds in which a node must answer as soon as ever after a load."""


def overload(bench: Bench) -> str:
    """Send as fast as two processes can, for some seconds."""
    node = bench.start("max_objects:=600")
    senders = [bench.peer("sender") for _ in range(2)]
    bench.until(lambda: bench.value("objects", "count") > 500, "objects of the senders")
    memory = node.status("VmRSS")
    before = node.scheduled()
    during = bench.probes(SECONDS)
    most = LONGEST * node.crowding(before)
    check(during <= most, f"{during:.2f} s between two answers, {most:.2f} allowed")
    delay = bench.value("cycle", "longest delay (s)")
    for sender in senders:
        sender.send(signal.SIGINT)
    for sender in senders:
        sender.end()
    before = node.scheduled()
    recovery = bench.probe()
    most = RECOVERY * node.crowding(before)
    check(recovery <= most, f"right only {recovery:.2f} s after the load, {most:.2f} allowed")
    grown = (node.status("VmRSS") - memory) / 2**20
    bench.spin(1.1)  # for /diagnostics of after that
    topics = ("input objects", "input object_poses")
    lost, superseded, messages = (
        sum(bench.value(topic, key) for topic in topics)
        for key in ("lost", "superseded", "messages")
    )
    check(lost + superseded > 0, "no drop was counted")
    return (
        f"longest time between two answers {during:.3f} s, longest delay of a state {delay:.3f} s; "
        f"{messages:,.0f} messages taken, {lost:,.0f} lost, {superseded:,.0f} states superseded; "
        f"right {recovery:.2f} s after it ended; memory grew by {grown:.1f} MiB"
    )


def storm_parameters(bench: Bench) -> str:
    """Set parameters from three processes, right and wrong ones, for some seconds."""
    node = bench.start()
    setters = [bench.peer("setter") for _ in range(3)]
    before = node.scheduled()
    during = bench.probes(SECONDS)
    most = LONGEST * node.crowding(before)
    check(during <= most, f"{during:.2f} s between two answers, {most:.2f} allowed")
    for setter in setters:
        setter.kill()
    before = node.scheduled()
    after = bench.probe()
    most = RECOVERY * node.crowding(before)
    check(after <= most, f"right only {after:.2f} s after it, {most:.2f} allowed")
    return f"longest time between two answers {during:.3f} s; right {after:.2f} s after it"

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

"""Faults of time: a simulation's clock that jumps, stands still, or never comes."""

from __future__ import annotations

import time

from tools.faults.bench import ANSWERING, Bench, check

BEGIN, JUMP = 1000.0, 500.0
"""Seconds of the simulation's clock at the start, and by which it jumps."""
STEP = 0.05
RIGHT = 1.0
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
    late = bench.value("input objects", "rejected: older stamp")
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
    """Send states that are older than what the node has, object by object."""
    bench.start("order_timeout:=30.0")
    now = time.time()
    bench.move("probe/2", 20.0, now)
    bench.move("probe/3", 40.0, now)
    bench.move("probe/3", 20.5, now - 1.0)  # late: would collide with the second
    bench.move("probe/1", 40.5, now + 0.01)  # newer than its last: collides with the third
    took = bench.until(lambda: bench.answers[-1][1] == {(1, 3)}, "the pair of the newest states")
    topic = "input object_transform"
    bench.until(lambda: bench.value(topic, "rejected: older stamp") == 1.0, "one refusal")
    return f"1 of 4 states refused (`older stamp`), the others used, after {took:.2f} s"

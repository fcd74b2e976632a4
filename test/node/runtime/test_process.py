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

"""The executable as a process: other processes talk to it, signals end it with exit code 0."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import cycle
from typing import Any

import pytest
from each import each

pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from node_process import running
from processes import PATIENCE, limited, output_until
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rig import DOMAIN, NAMESPACE, Client, cube

from obb_collision.node.diagnostics.answer import COLLIDING, UNKNOWN
from obb_collision.node.topics.topics import DEADLINE

IN_NAMESPACE = ("--ros-args", "-r", f"__ns:={NAMESPACE}")


@contextmanager
def client(met: bool = True) -> Iterator[Client]:
    """Yield a client that has met the node of another process, unless that takes nothing in yet."""
    context = Context()
    context.init(domain_id=DOMAIN)
    executor = SingleThreadedExecutor(context=context)
    made = Client(context, executor)
    made.listen("collisions", "namespaces", "in_collision")
    made.patience = PATIENCE
    try:
        if met:
            made.wait_matched()
        yield made
    finally:
        executor.shutdown()
        made.client.destroy_node()
        context.try_shutdown()


def end(process: subprocess.Popen[str], number: signal.Signals) -> str:
    """Send a signal; returns the output once the process has ended with exit code 0."""
    process.send_signal(number)
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, output
    assert "Traceback" not in output, output
    return output


def test_another_process_configures_activates_and_deactivates_it() -> None:
    managed = (*IN_NAMESPACE, "-p", "autostart:=false")
    with running(*managed) as process, client(met=False) as other:
        other.says(UNKNOWN, "unconfigured")
        assert other.change(Transition.TRANSITION_CONFIGURE)
        other.wait_inputs()
        other.send(cube(("a", 1)), cube(("a", 2), (0.5, 0, 0)))
        other.says(UNKNOWN, "inactive")
        for _ in range(2):
            assert other.change(Transition.TRANSITION_ACTIVATE)
            other.says(COLLIDING, "1 pair collides")
            assert not other.change(Transition.TRANSITION_ACTIVATE)
            assert other.change(Transition.TRANSITION_DEACTIVATE)
            other.says(UNKNOWN, "inactive")
        assert other.change(Transition.TRANSITION_CLEANUP)
        other.says(UNKNOWN, "unconfigured")
        assert other.change(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
        other.says(UNKNOWN, "shutting_down")
        assert other.state() == "finalized"
        output = end(process, signal.SIGTERM)
    assert "ready:" in output


SCRIPT = ("-c", "from obb_collision.commands import node; raise SystemExit(node())")
STARTS = {
    "numpy": SCRIPT,
    "numba": SCRIPT,
    "rclpy.context": SCRIPT,
    "argparse": ("-m", "obb_collision.commands"),
    "rclpy": SCRIPT,
}
"""How a node is started, by a module that is imported on the way."""


@each("module, number", zip(STARTS, cycle((signal.SIGINT, signal.SIGTERM)), strict=False))
def test_a_signal_during_the_imports_ends_it_without_a_word(
    module: str, number: signal.Signals
) -> None:
    process = subprocess.Popen(
        [sys.executable, "-X", "importtime", *STARTS[module], *IN_NAMESPACE],
        env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)},
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    with limited(process):
        for line in process.stderr:
            if line.split("|")[-1].strip() == module:
                break
        process.send_signal(number)
        _, rest = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, rest
        assert "Traceback" not in rest
        assert "ready:" not in rest


def test_a_second_signal_ends_a_node_that_takes_long_to_be_made() -> None:
    code = """
import signal, sys, threading
from obb_collision.node.runtime.running import run
def make(context, ending):
    never = threading.Lock()
    never.acquire()
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))  # others take them
    sys.stdout.write("making\\n")
    sys.stdout.flush()
    never.acquire()  # as compiled code: no handler of Python's runs
run("slow", make, [])
"""
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with limited(process):
        assert output_until(process, "making") == "making\n"
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGTERM)  # another one, for two of a kind may arrive as one
        assert process.wait(PATIENCE) == 0


def test_a_program_has_its_signals_back_after_a_node() -> None:
    code = """
import os, signal
from threading import Thread
import rclpy
from obb_collision.node.runtime.running import run

calls, codes = [], []
handler = lambda *_: calls.append("Python's")
signal.signal(signal.SIGINT, handler)
rclpy.init()  # its handlers are of C: they end its context, and call those from before

def make(context, _):
    node = rclpy.create_node("short", context=context)
    node.create_timer(0.0, lambda: end(context))
    return node

end = lambda context: os.kill(os.getpid(), signal.SIGINT)
codes.append(run("short", make, []))
assert signal.getsignal(signal.SIGINT) is handler
end = lambda context: context.try_shutdown()
thread = Thread(target=lambda: codes.append(run("short", make, [])))  # signals are not a thread's
thread.start()
thread.join()
assert rclpy.ok() and (codes, calls) == ([0, 0], []), (codes, calls)
os.kill(os.getpid(), signal.SIGINT)
while rclpy.ok() or not calls:
    pass
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=PATIENCE)


def test_a_node_that_is_killed_or_hangs_is_told_by_the_deadline() -> None:
    missed: list[Any] = []
    told: list[DiagnosticArray] = []
    with running(*IN_NAMESPACE) as process, client() as other:
        other.client.create_subscription(
            DiagnosticArray,
            "collision_status",
            told.append,
            QoSProfile(depth=1, deadline=Duration(seconds=DEADLINE)),
            event_callbacks=SubscriptionEventCallbacks(deadline=missed.append),
        )
        for number in (signal.SIGSTOP, signal.SIGKILL):
            count = len(told)
            other.until(lambda n=count: len(told) > n + 3, "status")  # type: ignore[misc]
            process.send_signal(number)
            count = len(missed)
            other.until(lambda n=count: len(missed) > n + 1, "deadline")  # type: ignore[misc]
            process.send_signal(signal.SIGCONT)


def test_arguments_come_by_the_command_line_and_signals_may_go_on_until_the_last_word() -> None:
    more = "-r objects:=scene -p rate:=20.0 -p fixed_frame:=odom"
    with running(*IN_NAMESPACE, *more.split()) as process, client(met=False) as other:
        said = output_until(process, "ready:")
        other.known("no_objects")
        limit = time.monotonic() + PATIENCE
        while process.poll() is None:
            assert time.monotonic() < limit
            process.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                process.wait(0.002)  # as fast as no one can type, slow enough to let it end
        assert process.stdout is not None
        output = process.stdout.read()
        other.says(UNKNOWN, "shutting_down", True)
    assert process.returncode == 0, output
    assert "Traceback" not in output
    for word in (f"{NAMESPACE}/scene", "/collisions", "'odom'", "at 20 Hz", "/markers"):
        assert word in said


def test_what_is_there_at_ready_is_out_of_the_collectors_sight() -> None:
    code = """
import gc
from obb_collision.node.runtime.running import Garbage
given = gc.get_freeze_count()
Garbage.settle_more()
assert gc.get_freeze_count() == given  # not where the process is somebody else's
Garbage.settle()
before = gc.get_freeze_count()
more = [[] for _ in range(10000)]
Garbage.settle_more()
assert gc.get_freeze_count() >= before + 10000
assert len(gc.get_objects()) < 10000
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=PATIENCE)

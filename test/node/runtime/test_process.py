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

"""The executable as a process: others talk to it, signals end it with code 0, memory is kept."""

from __future__ import annotations

import os
import platform
import resource
import signal
import subprocess
import time
from contextlib import suppress
from itertools import cycle
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from each import each
from lifecycle_msgs.msg import Transition
from node_process import environment, running
from processes import PATIENCE, output_until, run_python, started
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile
from rig import DOMAIN, NAMESPACE, STATUS, client_apart, cube

from obb_collision.node.diagnostics.answer import COLLIDING, UNKNOWN
from obb_collision.node.topics.topics import DEADLINE

IN_NAMESPACE = ("--ros-args", "-r", f"__ns:={NAMESPACE}")


def test_another_process_manages_it_and_is_told_by_the_deadline_that_it_hangs() -> None:
    missed: list[Any] = []
    managed = (*IN_NAMESPACE, "-p", "autostart:=false")
    with running(*managed) as process, client_apart() as other:
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
        other.client.create_subscription(
            DiagnosticArray,
            STATUS,
            lambda _: None,
            QoSProfile(depth=1, deadline=Duration(seconds=DEADLINE)),
            event_callbacks=SubscriptionEventCallbacks(deadline=missed.append),
        )
        other.next(STATUS)
        process.send_signal(signal.SIGSTOP)
        missed.clear()
        other.until(lambda: len(missed) > 1, "deadline")
        process.send_signal(signal.SIGCONT)
        assert other.change(Transition.TRANSITION_CLEANUP)
        other.says(UNKNOWN, "unconfigured")
        assert other.change(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
        other.says(UNKNOWN, "shutting_down")
        assert other.state() == "finalized"
        process.send_signal(signal.SIGTERM)
        output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, output
    assert "Traceback" not in output, output
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
def test_a_signal_amid_imports_ends_it_without_a_word(module: str, number: signal.Signals) -> None:
    arguments = ("-X", "importtime", *STARTS[module], *IN_NAMESPACE)
    with started(*arguments, ROS_DOMAIN_ID=str(DOMAIN)) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.split("|")[-1].strip() == module:
                break
        process.send_signal(number)
        rest, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, rest
        assert "Traceback" not in rest
        assert "ready:" not in rest


def test_a_second_signal_ends_a_node_that_takes_long_to_be_made() -> None:
    code = """
import signal, sys, threading
from obb_collision.node.runtime.running import run_node
def make(context, ending):
    never = threading.Lock()
    never.acquire()
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))  # others take them
    sys.stdout.write("making\\n")
    sys.stdout.flush()
    never.acquire()  # as compiled code: no handler of Python's runs
run_node("slow", make, [])
"""
    with started("-c", code) as process:
        assert output_until(process, "making") == "making\n"
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGTERM)  # another one, for two of a kind may arrive as one
        assert process.wait(PATIENCE) == 0


def test_a_program_has_its_signals_back_after_a_node() -> None:
    code = """
import os, signal
from threading import Thread
import rclpy
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.runtime.running import run_node

calls, codes = [], []
handler = lambda *_: calls.append("Python's")
signal.signal(signal.SIGINT, handler)
rclpy.init()  # its handlers are of C: they end its context, and call those from before

def make(context, _):
    node = rclpy.create_node("short", context=context)
    node.create_timer(0.0, lambda: end(context))
    node.guard, node.say_farewell = Guard(print, context.ok), lambda: None
    return node

end = lambda context: os.kill(os.getpid(), signal.SIGINT)
codes.append(run_node("short", make, []))
assert signal.getsignal(signal.SIGINT) is handler
end = lambda context: context.try_shutdown()
# signals are not those of a thread
thread = Thread(target=lambda: codes.append(run_node("short", make, [])))
thread.start()
thread.join()
assert rclpy.ok() and (codes, calls) == ([0, 0], []), (codes, calls)
os.kill(os.getpid(), signal.SIGINT)
while rclpy.ok() or not calls:
    pass
"""
    run_python("-c", code)


UNSUPPORTED = """
class Meta(type):
    _TYPE_SUPPORT = None

    @classmethod
    def __import_type_support__(cls):
        {fault}

class {name}(metaclass=Meta):
    pass
"""
NOT_BUILT = "from rosidl_generator_py import import_type_support; import_type_support('nothing')"
BROKEN = {
    "vision_msgs.msg": UNSUPPORTED.format(name="Detection3DArray", fault="pass"),
    "moveit_msgs.msg": "class ContactInformation: pass",
    "moveit_msgs.srv": "raise OSError('libmoveit_msgs.so: cannot open')",
    "tf2_msgs.msg": UNSUPPORTED.format(name="TFMessage", fault=NOT_BUILT),
}
"""Modules of packages that are installed and cannot be used."""


def test_broken_packages_are_said_and_signals_may_go_on_until_the_last_word(tmp_path: Path) -> None:
    for name, text in BROKEN.items():
        package, _, part = name.partition(".")
        folder = tmp_path / package / part
        folder.mkdir(parents=True)
        (folder.parent / "__init__.py").touch()  # without, one that is installed comes first
        (folder / "__init__.py").write_text(text)
    path = os.pathsep.join([str(tmp_path), environment()["PYTHONPATH"]])
    more = "-r objects:=scene -p rate:=20.0 -p fixed_frame:=odom -p robots:=['arm']"
    arguments = (*IN_NAMESPACE, *more.split(), "-p", "expect_empty:=true")
    with running(*arguments, PYTHONPATH=path) as process, client_apart() as other:
        said = output_until(process, "ready:")
        other.known("robot_unknown")
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
    assert "Traceback" not in said + output
    for word in (f"{NAMESPACE}/scene", "/collisions", "'odom'", "at 20 Hz", "/markers"):
        assert word in said
    for package in ("vision_msgs", "moveit_msgs", "tf2_msgs"):
        assert f"{package} is installed but cannot be used" in said


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
    run_python("-c", code)


#: Steps of 20,000 boxes, some 10 MB each: prints the page faults of three, without and with it.
STEPS = """
import resource
import numpy as np
import obb_collision as oc
from obb_collision.node.runtime.running import keep_freed_memory

oc.set_threads(1)
rng = np.random.default_rng(0)
poses = np.concatenate([30 * rng.random((20_000, 3)), rng.normal(size=(20_000, 4))], axis=1)
poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1)[:, None]
sizes = rng.uniform(0.05, 0.5, (20_000, 3))
for prepare in (lambda: None, keep_freed_memory):
    prepare()
    for step in range(6):
        if step == 3:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        oc.find_pairs(oc.Boxes.from_poses(poses, sizes))
    print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's memory")
def test_a_node_keeps_what_it_frees_and_the_library_leaves_the_process_as_it_is() -> None:
    all_of_them = 3 * 10e6 / resource.getpagesize()
    without, kept = map(int, run_python("-c", STEPS).stdout.split())
    assert kept < all_of_them / 20 < without

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

"""Packages, variables of the environment and signals before rclpy is used."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""The signals that end a process."""
ACTION_BYTES = 256
"""At least the size of C's ``struct sigaction``, which has 152 bytes on Linux."""
BAD_USAGE = 2
"""Exit code for arguments that can't be used, as argparse has it."""


def in_main_thread() -> bool:
    """Return whether this thread may handle signals: elsewhere they are the main thread's."""
    return threading.current_thread() is threading.main_thread()


def handle_signals(handler: Callable[..., object] | signal.Handlers) -> None:
    """Set the handler of the signals that end a process, if that is possible in this thread."""
    for number in SIGNALS if in_main_thread() else ():
        signal.signal(number, handler)


@contextmanager
def restored_signals() -> Iterator[None]:
    """Give SIGINT and SIGTERM back at the end as they were.

    Handlers that are not from Python, such as those of ``rclpy.init``, are restored in the C
    library: Python's functions neither return nor set them.
    """
    if not in_main_thread():
        yield
        return
    library = ctypes.CDLL(None)
    actions = {number: ctypes.create_string_buffer(ACTION_BYTES) for number in SIGNALS}
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    for number, action in actions.items():
        library.sigaction(number, None, action)
    try:
        yield
    finally:
        for number, action in actions.items():
            if handlers[number] is not None:
                signal.signal(number, handlers[number])
            library.sigaction(number, action, None)


def end_at_once_on_signals() -> None:
    """Make signals end the process immediately, while it only imports modules.

    KeyboardInterrupt would be raised in whichever module is being imported.
    """
    handle_signals(lambda *_: os._exit(0))


def without_ros_arguments(arguments: Iterable[str]) -> list[str]:
    """Return the arguments that are not between ``--ros-args`` and ``--`` or the end."""
    own, of_ros = [], False
    for argument in arguments:
        if argument == "--ros-args":
            of_ros = True
        elif of_ros and argument == "--":
            of_ros = False
        elif not of_ros:
            own.append(argument)
    return own


def set_defaults() -> None:
    """Set what is unset: AMENT_PREFIX_PATH where ROS came by pip, and OpenBLAS to one thread.

    rclpy's wheels have the ament index in this Python's prefix, and looking it up raises where the
    variable is unset. Matrices here have three rows: further threads of numpy's and scipy's BLAS
    would never work.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if (Path(sys.prefix) / "share" / "ament_index").is_dir():
        os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)


def is_ros_here(program: str) -> bool:
    """Return whether rclpy and the messages can be imported, and set what they need by default.

    If not, print how to install them.
    """
    missing = [name for name in ("rclpy", "visualization_msgs") if find_spec(name) is None]
    if missing:
        sys.stderr.write(
            f"{program} needs rclpy and common_interfaces: source a ROS 2 installation, "
            "or install 'obb_collision[ros]' by pip\n"
        )
    else:
        set_defaults()
    return not missing

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

"""What must be installed, and set in the environment, before rclpy is used."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path

SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""The signals that end a process."""
BAD_USAGE = 2
"""Exit code for arguments that can't be used, as argparse has it."""


def end_at_once_on_signals() -> None:
    """Make signals end the process immediately, while it only imports modules.

    KeyboardInterrupt would be raised in whichever module is being imported.
    """
    for number in SIGNALS:
        signal.signal(number, lambda *_: os._exit(0))


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
    """Set AMENT_PREFIX_PATH to this Python's prefix where ROS came by pip and it is unset.

    rclpy's wheels have the ament index there, and looking it up raises where the variable is unset.
    """
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

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

"""Information that a launch file needs about a node before starting it."""

from __future__ import annotations

import os
from typing import Any

from rclpy.context import Context
from rclpy.node import Node

ALONE = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "ROS_STATIC_PEERS": ""}
"""Environment of a node that no other node discovers."""


def initial_parameters(name: str, namespace: str, *files: str) -> dict[str, Any]:
    """Return the parameters that a node would get from parameter files.

    A temporary node of that name, not discoverable by others, reads the files, because the rules
    of ROS for matching entries to nodes are complex. Raises RuntimeError where one can't be read.
    """
    before = {key: os.environ.get(key) for key in ALONE}
    os.environ.update(ALONE)
    context = Context()
    try:
        arguments = [word for file in files for word in ("--params-file", file)]
        context.init(args=["--ros-args", *arguments])
        node = Node(
            name,
            namespace=namespace,
            context=context,
            enable_rosout=False,
            start_parameter_services=False,
            automatically_declare_parameters_from_overrides=True,
        )
        try:
            found: dict[str, Any] = node.get_parameters_by_prefix("")
            return {key: parameter.value for key, parameter in found.items()}
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()
        for key, value in before.items():
            if value is None:
                del os.environ[key]
            else:
                os.environ[key] = value

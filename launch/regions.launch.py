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

"""Start collision nodes that share a scene by regions, and the merger of their messages.

ros2 launch obb_collision regions.launch.py parts:="3 1 1" minimum:="0 0 0" maximum:="30 20 5"

The nodes region_0, region_1, ... have their outputs in namespaces of these names, and all read the
same inputs. On several machines: the same arguments everywhere, and only:="0 1" on one of them.
"""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from obb_collision.node.parameters.entries import region_parameters, shared_inputs

ARGUMENTS = {
    "minimum": ("0 0 0", "Lower corner of the box that is split (m): x y z."),
    "maximum": ("10 10 10", "Upper corner of the box that is split (m): x y z."),
    "parts": ("2 1 1", "Regions along x, y and z. The outermost ones have no end outwards."),
    "halo": ("1.0", "Objects farther than this from a region take no part there (m)."),
    "only": ("", "Numbers of the regions started here, as 0 1. Empty: all."),
    "merge": ("true", "Start the merger here, too: true or false."),
    "timeout": ("0.5", "A region is missing if it is silent for longer than this (s)."),
    "namespace": ("", "Namespace of inputs and merged outputs."),
    "log_level": ("info", "debug, info, warn, error or fatal."),
}


def generate_launch_description() -> LaunchDescription:
    """Return the launch description with its arguments."""
    config = PathJoinSubstitution([FindPackageShare("obb_collision"), "config"])
    file = DeclareLaunchArgument(
        "params_file",
        default_value=PathJoinSubstitution([config, "obb_collision.yaml"]),
        description="YAML file of parameters, the same for all nodes.",
    )
    others = (
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    )
    return LaunchDescription([file, *others, OpaqueFunction(function=start)])


def start(context: LaunchContext) -> list[Node]:
    """Return the nodes of the regions, and the merger if asked."""

    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    def node(executable: str, namespace: str, parameters: list[object], **more: object) -> Node:
        return Node(
            package="obb_collision",
            executable=executable,
            namespace=namespace,
            parameters=parameters,
            arguments=["--ros-args", "--log-level", value("log_level")],
            output="screen",
            **more,
        )

    root = value("namespace").strip("/")
    regions = region_parameters(*map(value, ("minimum", "maximum", "parts", "halo")))
    here = [int(word) for word in value("only").split()] or range(len(regions))
    nodes = [
        node(
            "obb_collision_node",
            "/".join(part for part in (root, name) if part),
            [value("params_file"), given],
            name="obb_collision",
            remappings=shared_inputs(root),
        )
        for number, (name, given) in enumerate(regions.items())
        if number in here
    ]
    if value("merge") == "true":
        given = {"regions": list(regions), "timeout": float(value("timeout"))}
        files = [value("params_file"), given]  # the clock and unknown_is_collision are the merger's
        nodes.append(node("obb_collision_merge", root, files, name="obb_collision_merge"))
    return nodes

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

"""Start the collision node, and RViz with it if asked.

ros2 launch obb_collision obb_collision.launch.py rviz:=true namespace:=cell scene_file:=tabletop

Arguments that are left out do not change the values of params_file.
"""

from __future__ import annotations

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import Action, LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.events import matches_action
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from launch_ros.substitutions import FindPackageShare
from lifecycle_msgs.msg import Transition

from obb_collision.node.runtime.running import initial_parameters

NAME = "obb_collision"
CONFIG = PathJoinSubstitution([FindPackageShare("obb_collision"), "config"])


def generate_launch_description() -> LaunchDescription:
    """Return the launch description with its arguments."""
    as_in_file = "Empty: leaves params_file as it is."
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "namespace", default_value="", description="Namespace of the node and its topics."
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([CONFIG, "obb_collision.yaml"]),
                description="YAML file of parameters.",
            ),
            DeclareLaunchArgument(
                "scene_file",
                default_value="",
                description="Initial scene file: a path, or tabletop, warehouse, lidar_zone, "
                "arm_cell, camera. " + as_in_file,
            ),
            DeclareLaunchArgument(
                "robots",
                default_value="",
                description="Names of robots whose URDF and joints are on topics: arm, or "
                "'arm_left arm_right'. " + as_in_file,
            ),
            DeclareLaunchArgument(
                "fixed_frame",
                default_value="",
                description="Frame of everything published, and of RViz. " + as_in_file,
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="",
                choices=["", "true", "false"],
                description="Use /clock for stamps, ages and RViz. " + as_in_file,
            ),
            DeclareLaunchArgument(
                "autostart",
                default_value="",
                choices=["", "true", "false", "launch"],
                description="What configures and activates the node. true: itself. launch: launch, "
                "by events. false: others, a lifecycle manager for example. " + as_in_file,
            ),
            DeclareLaunchArgument(
                "log_level", default_value="info", description="debug, info, warn, error or fatal."
            ),
            DeclareLaunchArgument(
                "rviz",
                default_value="false",
                choices=["true", "false"],
                description="Start RViz with the boxes and the contacts.",
            ),
            OpaqueFunction(function=start),
        ]
    )


def start(context: LaunchContext) -> list[Action]:
    """Return the node, its activation, and RViz if asked for."""

    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    given: dict[str, object] = {
        name: text for name in ("scene_file", "fixed_frame") if (text := value(name))
    }
    if value("robots"):
        given["robots"] = value("robots").split()
    if value("use_sim_time"):
        given["use_sim_time"] = value("use_sim_time") == "true"
    if value("autostart"):
        given["autostart"] = value("autostart") == "true"
    node = LifecycleNode(
        package="obb_collision",
        executable="obb_collision_node",
        name=NAME,
        namespace=value("namespace"),
        parameters=[value("params_file"), *([given] if given else [])],
        arguments=["--ros-args", "--log-level", value("log_level")],
        output="screen",
    )
    actions = [node, *(activate(node) if value("autostart") == "launch" else ())]
    if value("rviz") == "false":
        return actions
    try:
        get_package_prefix("rviz2")
    except PackageNotFoundError:  # found out later, it would leave the node behind
        raise RuntimeError(
            "rviz:=true, but rviz2 is not installed: nothing was started. "
            "Install it (apt install ros-jazzy-rviz2), or start without rviz:=true"
        ) from None
    parameters = initial_parameters(NAME, value("namespace"), value("params_file")) | given
    return [*actions, rviz(value("namespace"), parameters)]


def activate(node: LifecycleNode) -> list[Action]:
    """Return actions that configure a node, then activate it."""

    def change(transition: int) -> EmitEvent:
        return EmitEvent(
            event=ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition)
        )

    return [
        RegisterEventHandler(
            OnStateTransition(
                target_lifecycle_node=node,
                start_state="configuring",
                goal_state="inactive",
                entities=[change(Transition.TRANSITION_ACTIVATE)],
            )
        ),
        change(Transition.TRANSITION_CONFIGURE),
    ]


def rviz(namespace: str, parameters: dict[str, object]) -> Node:
    """Return RViz with the frame and the clock of the node."""
    config = PathJoinSubstitution([CONFIG, "obb_collision.rviz"])
    return Node(
        package="rviz2",
        executable="rviz2",
        name="rviz_obb_collision",
        namespace=namespace,
        arguments=["-d", config, "-f", str(parameters.get("fixed_frame", "map"))],
        parameters=[{"use_sim_time": bool(parameters.get("use_sim_time", False))}],
    )

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

"""Parts of rclpy that it does not document, and what a node does where a version lacks them.

Nothing else in the package uses any. Each function does nothing where they are missing: the node
works, and its docstring says what is worse then.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rclpy.executors import Executor
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rosgraph_msgs.msg import Clock


def parameter_overrides(node: Node) -> Mapping[str, Any]:
    """Return parameters given at the start; none where missing: no hint at misspelt ones."""
    found: Mapping[str, Any] = getattr(node, "_parameter_overrides", {})
    return found


def refuse_clocks(node: Node, is_bad: Callable[[Clock], bool]) -> None:
    """Ignore messages of /clock that are bad.

    Where missing, rclpy raises exceptions for times before 1970, which the executor's guard counts.
    """
    source: Any = getattr(node, "_time_source", None)
    take = getattr(source, "clock_callback", None)
    if take is None:
        return

    def checked(message: Clock) -> None:
        if not is_bad(message):
            take(message)

    source.clock_callback = checked
    subscription = getattr(source, "_clock_sub", None)
    if subscription is not None:  # simulated time from the start
        subscription.callback = checked


def destroy_states(node: LifecycleNode) -> None:
    """Destroy a node's life cycle, which holds the handle of the node.

    Where missing, the node's name stays visible until the object is gone.
    """
    machine: Any = getattr(node, "_state_machine", None)
    if hasattr(machine, "destroy_when_not_in_use"):
        machine.destroy_when_not_in_use()


def release(executor: Executor) -> None:
    """Let callbacks run again after a message could not be taken.

    rclpy marks what it takes from, and its group, as busy, and leaves it so where that raises: no
    callback of the node would run any more. Where the marks are missing, none can be left.
    """
    for node in executor.get_nodes():
        ends = (node.subscriptions, node.timers, node.services, node.clients, node.waitables)
        for entity in (entity for some in ends for entity in some):
            if getattr(entity, "_executor_event", False):
                entity._executor_event = False
                group = entity.callback_group
                if getattr(group, "_active_entity", None) is entity:
                    group.ending_execution(entity)

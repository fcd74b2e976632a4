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

"""Undocumented parts of rclpy, and the behaviour of a node where a version lacks them.

Nothing else in the package uses any. Each function does nothing where they are missing: the node
works, and its docstring names the drawback.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import Any

import rclpy.subscription
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rosgraph_msgs.msg import Clock


def parameter_overrides(node: Node) -> Mapping[str, Any]:
    """Return parameters given at the start; none where missing: no hint at misspelt ones."""
    overrides: Mapping[str, Any] = getattr(node, "_parameter_overrides", {})
    return overrides


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
        for entity in (entity for entities in ends for entity in entities):
            if getattr(entity, "_executor_event", False):
                entity._executor_event = False
                group = entity.callback_group
                if getattr(group, "_active_entity", None) is entity:
                    group.ending_execution(entity)


class _Allocator(ctypes.Structure):
    """An rcutils_allocator_t."""

    _fields_ = (("functions", ctypes.c_void_p * 5),)


class _Bytes(ctypes.Structure):
    """An rcutils_uint8_array_t."""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


class _Info(ctypes.Structure):
    """An rmw_message_info_t of Jazzy, and room behind it."""

    _fields_ = (
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("publication_sequence_number", ctypes.c_uint64),
        ("reception_sequence_number", ctypes.c_uint64),
        ("implementation", ctypes.c_void_p),
        ("gid", ctypes.c_ubyte * 16),
        ("room", ctypes.c_ubyte * 64),
    )


NOTHING_TAKEN = 401
"""RCL_RET_SUBSCRIPTION_TAKE_FAILED: no message waits."""


@cache
def _taking() -> type | None:
    """Return a type of subscriptions whose messages come with the gid of their publisher.

    As those of rclpy do from Kilted on. None where it is not needed, or not possible.
    """
    info_type = getattr(rclpy.subscription, "MessageInfo", None)
    if "publisher_gid" in getattr(info_type, "__annotations__", ()):
        return None
    try:  # as rclpy has loaded it, with the libraries that it needs
        rcl = ctypes.PyDLL("librcl.so", mode=os.RTLD_NOLOAD | os.RTLD_NOW)
        take, free = rcl.rcl_take_serialized_message, rcl.rcutils_uint8_array_fini
        forget_error, default_allocator = rcl.rcutils_reset_error, rcl.rcutils_get_default_allocator
        identifier = rcl.rmw_get_implementation_identifier
    except (OSError, AttributeError):
        return None
    take.argtypes = [ctypes.c_void_p] * 4
    default_allocator.restype, identifier.restype = _Allocator, ctypes.c_void_p
    allocator, implementation = default_allocator(), identifier()

    class Taking(rclpy_implementation.Subscription):  # type: ignore[misc]
        """Takes messages with their publisher."""

        def take_message(self, kind: type, raw: bool) -> Any:
            if not raw:
                return super().take_message(kind, raw)
            data, info = _Bytes(None, 0, 0, allocator), _Info()
            try:
                code = take(self.pointer, ctypes.addressof(data), ctypes.addressof(info), None)
                if code == NOTHING_TAKEN:
                    return None
                if code:
                    forget_error()
                    raise MemoryError(f"a message could not be received: {code}")
                message = ctypes.string_at(data.buffer, data.length) if data.length else b""
            finally:
                free(ctypes.byref(data))
            message_info: dict[str, Any] = {
                "source_timestamp": info.source_timestamp,
                "received_timestamp": info.received_timestamp,
                "publication_sequence_number": info.publication_sequence_number,
            }
            if info.implementation == implementation:
                message_info["publisher_gid"] = {"data": bytes(info.gid)}
            return message, message_info

    return Taking


@contextmanager
def with_publishers() -> Iterator[None]:
    """Let subscriptions that are created meanwhile give messages with their publisher's gid.

    Where missing, senders of an input are indistinguishable: an unreadable message of one of them
    marks the input until ``~/clear``.
    """
    plain, taking = rclpy_implementation.Subscription, _taking()
    rclpy_implementation.Subscription = taking or plain
    try:
        yield
    finally:
        rclpy_implementation.Subscription = plain

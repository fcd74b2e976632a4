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

"""The services that set parameters: a value that raises an exception is refused.

Without this, rclpy raises it, and those of invalid types, from the executor.
"""

from __future__ import annotations

from collections.abc import Callable
from traceback import format_exc
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node

from obb_collision.words import shown

Callback = Callable[[Any, Any], Any]


def guard_parameter_services(node: Node) -> None:
    """Prevent requests to a node's parameter services from ending it."""
    for service in node.services:
        if service.srv_type is SetParameters:
            service.callback = _one_by_one(node, service.callback)
        elif service.srv_type is SetParametersAtomically:
            service.callback = _all_or_none(node, service.callback)


def _one_by_one(node: Node, callback: Callback) -> Callback:
    def set_each(request: Any, response: Any) -> Any:
        for parameter in request.parameters:
            one = SetParameters.Request(parameters=[parameter])
            try:
                response.results += callback(one, SetParameters.Response()).results
            except Exception as error:
                response.results.append(_refusal(node, error))
        return response

    return set_each


def _all_or_none(node: Node, callback: Callback) -> Callback:
    def set_all(request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:
            response.result = _refusal(node, error)
            return response

    return set_all


def _refusal(node: Node, error: Exception) -> SetParametersResult:
    reason = f"{type(error).__name__}: {shown(str(error))}"
    node.get_logger().error(f"a parameter could not be set: {format_exc()}", once=True)
    return SetParametersResult(successful=False, reason=reason)

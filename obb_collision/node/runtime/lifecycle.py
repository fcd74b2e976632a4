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

"""A node with a life cycle, as ROS has it: transitions by service calls, or by itself.

Two things that rclpy leaves out: it drops what a transition raises, and a transition that is not
possible in the present state ends the node (https://github.com/ros2/rclpy/issues/1209).
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from traceback import format_exception
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from obb_collision.node.runtime.inner import destroy_states
from obb_collision.node.runtime.running import UNUSABLE, in_one_line

SUCCESS, ERROR = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.ERROR


class ManagedNode(LifecycleNode):
    """Calls a method per transition; one that raises leaves the node unconfigured.

    Subclasses have ``configure``, ``activate``, ``deactivate``, ``release``, which undoes
    ``configure`` wherever that has ended, ``rest``, which reports that nothing is configured, and
    ``finish``. ``transition`` is held while one goes on that a service asked for: rclpy ends it by
    publishing, which in a context that was shut down meanwhile may end the process (in Kilted).
    """

    configure: Callable[[], None]
    activate: Callable[[], None]
    deactivate: Callable[[], None]
    release: Callable[[], None]
    rest: Callable[[str], None]
    finish: Callable[[], None]

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.transition = threading.Lock()
        self._failure: Exception | None = None
        self._reason = ""
        self._starting = False
        for service in self.services:
            if service.srv_type is ChangeState:
                service.callback = self._answering(service.callback)

    def start(self) -> None:
        """Configure and activate the node; raises what prevents it."""
        self._starting = True
        for transition in (self.trigger_configure, self.trigger_activate):
            transition()
            if self._failure is not None:
                raise self._failure
        self._starting = False

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create what the node needs to work."""
        return self._go("configure", self.configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to work."""
        return self._go("activate", self.activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Pause."""
        return self._go("deactivate", self.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Undo ``on_configure``."""
        return self._go("clean up", self.release, lambda: self.rest(""))

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the work for good; the process stays, with the services that tell the state."""
        return self._go("shut down", self.release, self.finish)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Undo all after a transition that failed; the next one may do better."""
        try:
            self.release()
            self.rest(f"the last transition failed: {self._reason}")
            return SUCCESS
        except Exception as error:
            self.get_logger().error("".join(format_exception(error)))
            self.finish()
            return ERROR  # finalized

    def destroy_node(self) -> None:
        """Destroy the node and its states, which hold the handle of the node and rclpy leaves."""
        super().destroy_node()
        destroy_states(self)

    def _go(self, what: str, *actions: Callable[[], None]) -> TransitionCallbackReturn:
        self._failure = None
        try:
            for action in actions:
                action()
        except Exception as error:
            self._failure, self._reason = error, in_one_line(error)
            if isinstance(error, ExternalShutdownException):  # as its user wanted
                return ERROR
            if not isinstance(error, (*UNUSABLE, OSError)):  # not foreseen
                self._reason = f"{type(error).__name__}: {self._reason}"
                self.get_logger().error("".join(format_exception(error)))
            if not self._starting:  # else it is raised
                self.get_logger().error(f"cannot {what}: {self._reason}")
            return ERROR
        return SUCCESS

    def _answering(self, callback: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Return a callback that refuses a transition which is not possible now."""

        def change_state(request: ChangeState.Request, response: ChangeState.Response) -> Any:
            try:
                with self.transition:
                    return callback(request, response)
            except Exception as error:
                self.get_logger().warning(f"transition refused: {in_one_line(error)}")
                response.success = False
                return response

        return change_state

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

"""Hostile requests to all services of a node; then everything is set back as it was."""

from __future__ import annotations

import time
from random import Random
from typing import Any

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters, SetParametersAtomically
from rclpy.parameter import parameter_value_to_python
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from obb_collision.node.messages.conversions import stamp_to_ros
from tools.fuzz.mutations.fields import hostile_value, mutate
from tools.fuzz.process.child import Child
from tools.fuzz.session.client import Client, FoundError

TEXTS = ("* *", "a/* b/*", "a/1: mesh", "*: hull", "a=sphere", "", "a", "[", "file:///dev/zero")
LONGEST_LIST = 3
MANY = 2000
"""Entries of the longest list."""
SIM_TIME = "use_sim_time"
ENDING = (
    Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
    Transition.TRANSITION_INACTIVE_SHUTDOWN,
    Transition.TRANSITION_ACTIVE_SHUTDOWN,
    Transition.TRANSITION_DESTROY,
)
"""Transitions from which no way leads back."""
BACK = {
    State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_CONFIGURE,
    State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_ACTIVATE,
}


class Services:
    """The services of a node, its parameters among them."""

    def __init__(self, client: Client, child: Child) -> None:
        self._client, self._child = client, child
        self._kinds: dict[str, type] = client.until(child, client.services, "services")
        names = self._call("list_parameters", ListParameters.Request()).result.names
        values = self._call("get_parameters", GetParameters.Request(names=names)).values
        self._given = dict(zip(names, values, strict=True))

    def given(self, name: str) -> Any:
        """Return the value that a parameter had at the start, and has between two attacks."""
        return parameter_value_to_python(self._given[name])

    def _call(self, name: str, request: Any) -> Any:
        return self._client.call(self._child, self._kinds[name], name, request)

    def attack(self, random: Random) -> str:
        """Make one hostile request, and undo what it did; returns its kind."""
        name = random.choice(("parameter", "parameter", "clock", *self._kinds))
        if name == "parameter":
            self._set_one(random)
        elif name == "clock":
            self._disturb_clock(random)
        else:
            request = _hostile_request(self._kinds[name], list(self._given), random)
            self._call(name, request)
            self._set_back(request)
        return name

    def _set_one(self, random: Random) -> None:
        """Set a parameter to anything, and back if that was accepted."""
        parameter = hostile_parameter(random.choice(list(self._given)), random)
        request = SetParameters.Request(parameters=[parameter])
        if self._call("set_parameters", request).results[0].successful:
            self._set_back(request)

    def _set_back(self, request: Any) -> None:
        """Undo what a request may have done."""
        if isinstance(request, (SetParameters.Request, SetParametersAtomically.Request)):
            names = {parameter.name for parameter in request.parameters} & self._given.keys()
            present = self._call("get_parameters", GetParameters.Request(names=sorted(names)))
            for name, value in zip(sorted(names), present.values, strict=True):
                if value != self._given[name]:
                    self._restore(name)
        elif isinstance(request, SetBool.Request):
            self._call("enable", SetBool.Request(data=True))
        elif isinstance(request, ChangeState.Request):
            self._activate()

    def _restore(self, name: str) -> None:
        parameters = [Parameter(name=name, value=self._given[name])]
        back = self._call("set_parameters", SetParameters.Request(parameters=parameters)).results[0]
        if not back.successful:
            raise FoundError(f"{name} can't be set back to {self.given(name)!r}: {back.reason}")

    def _activate(self) -> None:
        """Bring a managed node back to where it answers."""
        for _ in BACK:
            state = self._call("get_state", GetState.Request()).current_state.id
            if state not in BACK:
                return
            request = ChangeState.Request(transition=Transition(id=BACK[state]))
            if not self._call("change_state", request).success:
                raise FoundError(f"no way back from state {state}")

    def _disturb_clock(self, random: Random) -> None:
        """Switch to simulated time, and have it jump; then back."""
        parameter = Parameter(name=SIM_TIME, value=ParameterValue(type=1, bool_value=True))
        self._call("set_parameters", SetParameters.Request(parameters=[parameter]))
        clock = self._client.publishers["/clock"]
        self._client.until(self._child, clock.get_subscription_count, "subscription to /clock")
        now = time.time_ns()
        for _ in range(random.randint(1, 8)):
            message = Clock(clock=stamp_to_ros(now + random.randint(-(10**10), 10**10)))
            if random.random() < 0.5:
                mutate(message, random)
            clock.publish(serialize_message(message))
        self._call("get_parameters", GetParameters.Request(names=[SIM_TIME]))
        self._restore(SIM_TIME)


def hostile_parameter(name: str, random: Random) -> Parameter:
    """Return a parameter with a value of any type."""
    value = ParameterValue(type=random.randrange(10))
    value.bool_value = random.random() < 0.5
    value.integer_value = hostile_value("int64", random)
    value.double_value = hostile_value("double", random)
    value.string_value = hostile_value("string", random)
    value.byte_array_value = [b"\0"] * random.randint(0, LONGEST_LIST)
    value.bool_array_value = [True] * random.randint(0, LONGEST_LIST)
    value.integer_array_value = [1] * random.randint(0, LONGEST_LIST)
    value.double_array_value = [hostile_value("double", random)] * random.randint(0, LONGEST_LIST)
    length = MANY if random.random() < 0.02 else random.randint(0, LONGEST_LIST)
    texts = (*TEXTS, value.string_value)
    value.string_array_value = [random.choice(texts) for _ in range(length)]
    return Parameter(name=name, value=value)


def _hostile_request(kind: Any, names: list[str], random: Random) -> Any:
    """Return a request to a service: with names of parameters and hostile ones, and mutated."""
    request = kind.Request()
    for name, type_name in request.get_fields_and_field_types().items():
        if type_name == "sequence<string>":
            given = [random.choice((*names, hostile_value("string", random))) for _ in range(5)]
            setattr(request, name, given)
        elif type_name == "sequence<rcl_interfaces/Parameter>":
            some = [random.choice(names) for _ in range(random.randint(0, LONGEST_LIST))]
            setattr(request, name, [hostile_parameter(one, random) for one in some])
    for _ in range(random.randint(0, 3)):
        try:
            mutate(request, random)
        except (AssertionError, IndexError):  # rclpy refuses it, or there is nothing to mutate
            continue
    if isinstance(request, ChangeState.Request) and (
        request.transition.id in ENDING or request.transition.label
    ):
        request.transition.id, request.transition.label = random.randrange(5), ""
    return request

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

"""The client of an attacked node: publishers, what it receives, hostile requests to services.

After a request to a service everything is set back as it was.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from random import Random
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool

from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.topics.topics import TOPICS
from tools.fuzz.mutations import hostile_value, mutate
from tools.fuzz.process import Child

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STARTING = 300.0
"""Seconds until the node answers first: on a new machine it compiles its kernels."""
ANSWERING = 20.0
"""Seconds in which anything must be answered; longer means that the node is blocked or blind."""
ASKING = 4.0
"""Seconds after which a service is asked again."""
NODE = "obb_collision"
NEEDED = {"list_parameters", "get_parameters", "set_parameters", "clear", "enable"}
READ = ("collisions", "points", "collision_status", "diagnostics")
OUTPUTS = {
    topic.name.replace("~", NODE): topic.message
    for name, topic in TOPICS.items()
    if name not in READ
}


class FoundError(RuntimeError):
    """A finding of an attack."""


class Answer(NamedTuple):
    """A message of ``collisions``: time of publication (ns) and sequence number."""

    stamp: int
    number: int
    message: PointCloud2


class Client:
    """A client of a node in another process.

    types: message types of the topics to publish; latched: which of these topics are latched;
    robot: name of the robot whose answers about states are stored.
    """

    def __init__(
        self,
        domain: int,
        namespace: str,
        types: Mapping[str, type],
        latched: Collection[str] = (),
        robot: str = "",
    ) -> None:
        self.namespace = namespace
        self.answers: list[Answer] = []
        self._taken = 0
        self._clients: dict[str, Any] = {}
        self.points: list[PointCloud2] = []
        """The last messages of ``points_inside``."""
        self.diagnostics: DiagnosticArray | None = None
        self._context = Context()
        self._context.init(args=[], domain_id=domain)
        self._executor = SingleThreadedExecutor(context=self._context)
        self.node = Node("client", context=self._context, namespace=self.namespace)
        self._executor.add_node(self.node)
        self.publishers = {
            topic: self.node.create_publisher(kind, topic, LATCHED if topic in latched else 1000)
            for topic, kind in types.items()
        }
        subscribe: Any = self.node.create_subscription
        subscribe(PointCloud2, "collisions", self._take, 1000)
        subscribe(PointCloud2, "points_inside", self._take_points, 10)
        self.validity: list[PointCloud2] = []
        """The last messages of ``state_validity``."""
        if robot:
            subscribe(PointCloud2, f"{robot}/state_validity", self._take_validity, 1000)
        subscribe(DiagnosticArray, "/diagnostics", self._take_status, 10)
        self._audience = Node("audience", context=self._context, namespace=self.namespace)

    def listen_to_all(self) -> None:
        """Subscribe, so that every effect is computed; messages are not read, which takes time."""
        for topic, kind in OUTPUTS.items():
            self._audience.create_subscription(kind, topic, lambda message: None, 1, raw=True)

    def close(self) -> None:
        """Take the client down."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._audience.destroy_node()
        self._context.try_shutdown()

    def _take(self, message: PointCloud2, info: Any) -> None:
        self._taken += 1
        number = info["publication_sequence_number"] or 0  # not given by some middlewares
        self.answers.append(Answer(int(info["source_timestamp"]), number, message))

    def _take_points(self, message: PointCloud2) -> None:
        self._taken += 1
        self.points = [*self.points[-9:], message]

    def _take_validity(self, message: PointCloud2) -> None:
        self._taken += 1
        self.validity = [*self.validity[-99:], message]

    def answer_at(self, stamp: Any) -> PointCloud2 | None:
        """Return the answer to the states with a stamp, None before it arrives."""
        return next((one for one in self.validity if one.header.stamp == stamp), None)

    def _take_status(self, message: DiagnosticArray) -> None:
        self._taken += 1
        if message.status and message.status[0].name.startswith(self.namespace[1:]):
            self.diagnostics = message

    def spin(self, seconds: float = 0.0) -> None:
        """Take all messages that have arrived; if there are none, wait for one.

        On a busy machine a client that takes fewer than arrive would lag behind by a whole queue.
        """
        before = self._taken - 1
        while self._taken > before:
            before = self._taken
            self._executor.spin_once(timeout_sec=seconds)
            seconds = 0.0

    def until(
        self, child: Child, reached: Callable[[], Any], what: str, limit: float = ANSWERING
    ) -> Any:
        """Wait until ``reached`` returns a true value, and return it; FoundError after the limit.

        limit: seconds, to which the time is added that the node waited for a processor.
        """
        start, before = time.monotonic(), child.delays()
        while not (found := reached()):
            if child.exit_code is not None:
                raise FoundError(f"the node ended with {child.exit_code} before {what}")
            spent = time.monotonic() - start
            if spent > limit and spent > limit + child.waited(before):
                raise FoundError(f"no {what} within {limit:g} s")
            self.spin(0.05)
        return found

    def wait_for_start(self, child: Child) -> None:
        """Wait until the node answers, with all effects computed."""
        self.listen_to_all()
        self.until(child, self.have_subscribers, "inputs", STARTING)
        self.until(child, lambda: self.answers, "collisions", STARTING)
        self.until(child, lambda: self.diagnostics, "diagnostics")
        self.until(child, self.is_all_computed, "effects, all computed", STARTING)

    def have_subscribers(self) -> bool:
        """Return whether the node subscribes to its topics."""
        inputs = [p for topic, p in self.publishers.items() if not topic.startswith("/")]
        return all(publisher.get_subscription_count() for publisher in inputs)

    def is_all_computed(self) -> bool:
        """Return whether no effect waits for its kernels any more."""
        values = [pair for part in self.parts for pair in part.values]
        states = [pair.value for pair in values if pair.key.startswith("effect ")]
        return bool(states) and not any("ready" in state for state in states)

    def last_counts(self, child: Child) -> Iterator[tuple[str, int]]:
        """Yield the counts of new diagnostics; FoundError for internal errors of the node."""
        self.diagnostics = None
        for status in self.until(child, lambda: self.diagnostics, "diagnostics").status:
            if status.name.endswith("internal errors") and status.level != status.OK:
                counts = "; ".join(f"{pair.key}: {pair.value}" for pair in status.values)
                raise FoundError(f"the node counted internal errors: {counts}")
            for pair in status.values:
                if pair.key in ("messages", "lost") or pair.key.startswith("rejected: "):
                    yield pair.key, int(pair.value)

    @property
    def parts(self) -> Sequence[DiagnosticStatus]:
        """The last diagnostics of each part of the node."""
        return () if self.diagnostics is None else self.diagnostics.status

    def part(self, name: str) -> DiagnosticStatus:
        """Return the last diagnostics of a part, an empty status if there are none."""
        found = (status for status in self.parts if status.name.endswith(f": {name}"))
        return next(found, DiagnosticStatus())

    def count(self, key: str, part: str = "") -> float:
        """Return a count of a part in the last diagnostics, or the sum over all parts."""
        parts = [self.part(part)] if part else self.parts
        values = [pair for status in parts for pair in status.values if pair.key == key]
        return sum(float(pair.value) for pair in values)

    def status(self) -> str:
        """Return the last diagnostics in a line."""
        values = [f"{pair.key}: {pair.value}" for part in self.parts for pair in part.values]
        return f"diagnostics: {', '.join([*(part.message for part in self.parts), *values])}"

    def services(self) -> dict[str, type]:
        """Return the types of the node's services, by their names behind that of the node.

        None of them, while not all that are needed here are known.
        """
        head, found = f"{self.namespace}/{NODE}/", {}
        try:
            listed = self.node.get_service_names_and_types_by_node(NODE, self.namespace)
        except NodeNameNonExistentError:  # not discovered yet
            return {}
        for name, kinds in listed:
            package, _, kind = kinds[0].split("/")
            if name.startswith(head):
                found[name.removeprefix(head)] = getattr(
                    importlib.import_module(f"{package}.srv"), kind
                )
        return found if found.keys() >= NEEDED else {}

    def call(self, child: Child, kind: Any, name: str, request: Any) -> Any:
        """Call a service of the node, and again if no answer comes.

        The middleware drops an answer to a client that it has not discovered.
        """
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, f"{NODE}/{name}")
        client, futures, next_time = self._clients[name], [], 0.0
        self.until(child, client.service_is_ready, f"service {name}")

        def answered() -> Any:
            nonlocal next_time
            if time.monotonic() > next_time:
                futures.append(client.call_async(request))
                next_time = time.monotonic() + ASKING
            return next((future.result() for future in futures if future.done()), None)

        return self.until(child, answered, f"answer {name}")


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
        """Return the value of a parameter at the start, which is restored after each attack."""
        return parameter_value_to_python(self._given[name])

    def _call(self, name: str, request: Any) -> Any:
        return self._client.call(self._child, self._kinds[name], name, request)

    def attack(self, random: Random) -> str:
        """Make a hostile request, and undo its effect; return its kind."""
        name = random.choice(("parameter", "parameter", "clock", *self._kinds))
        if name == "clock":
            self._disturb_clock(random)
            return name
        if name == "parameter":
            parameter = hostile_parameter(random.choice(list(self._given)), random)
            request: Any = SetParameters.Request(parameters=[parameter])
        else:
            request = _hostile_request(self._kinds[name], list(self._given), random)
        self._call("set_parameters" if name == "parameter" else name, request)
        self._set_back(request)
        return name

    def _set_back(self, request: Any) -> None:
        """Undo the effect of a request."""
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
        """Activate a managed node again."""
        for _ in BACK:
            state = self._call("get_state", GetState.Request()).current_state.id
            if state not in BACK:
                return
            request = ChangeState.Request(transition=Transition(id=BACK[state]))
            if not self._call("change_state", request).success:
                raise FoundError(f"no way back from state {state}")

    def _disturb_clock(self, random: Random) -> None:
        """Switch to simulated time, make it jump, and switch back."""
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

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

"""States to check, by topic and by MoveIt's service: none is valid where anything is unknown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from operator import attrgetter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from each import each
from rig import FakeFrames, Patch, cube, pose
from robot_rig import CRATE, EDGES, REASONS, SRDF, URDF, AskingRig, box
from std_msgs.msg import String
from std_srvs.srv import SetBool
from test_attached_and_hostile import TOOL, held, put
from visualization_msgs.msg import Marker

import obb_collision as oc
from obb_collision.node import namespace_number
from obb_collision.node.messages.clouds import cloud_to_ros
from obb_collision.node.robots import validity


def test_each_state_is_valid_or_says_why_not(arm: AskingRig) -> None:
    arm.put((0.0, 1.0, 0.7))
    states = [[0.0, 0.0], [0.2, np.pi / 2], [5.0, 0.0], [np.nan, 0.0], [0.2, 0.0]]
    rows = arm.ask(states)
    assert arm.reasons(states) == ["valid", "collides", "out of limits", "bad state", "valid"]
    keys = [rows[name][1] for name in ("ns_a", "id_a", "ns_b", "id_b")]
    assert keys == [namespace_number("arm/hand"), 0, namespace_number("crate"), 1]
    assert np.isnan(rows["distance"]).all()
    assert len(arm.ask(np.empty((0, 2)))) == 0


def test_answers_are_those_of_the_library(arm: AskingRig) -> None:
    rng = np.random.default_rng(0)
    arm.set(state_validity_distance=10.0)
    bulky = URDF.replace("</link>", f"{box(0.9)}</link>", 1)
    arm.start_robot(bulky, lift=0.4)
    scene, markers = oc.Scene(), []
    places = rng.uniform(-1.2, 1.2, (30, 3))
    for number, place in enumerate(places[np.hypot(*places[:, :2].T) > 0.85]):
        markers.append(cube(("crate", number), place, (0.2, 0.2, 0.2)))
        scene.add(f"crate/{number}", oc.shapes.Box((0.2, 0.2, 0.2)), pose(*place))
    arm.send(*markers).answer()
    robot = oc.Robot.from_urdf(bulky)
    checker = oc.RobotScene([robot], scene)
    states = rng.uniform((-1.0, -3.0), (1.5, 3.2), (500, 2))
    rows, report = arm.ask(states), checker.check(states)
    np.testing.assert_array_equal(rows["valid"] == 1, report.valid)
    assert 50 < report.valid.sum() < 450
    expected = checker.distances(states, max_distance=10.0).distances
    np.testing.assert_allclose(rows["distance"], expected, atol=1e-9)


def test_a_path_is_valid_all_the_way_or_says_where_not(arm: AskingRig) -> None:
    arm.put((0.0, 1.0, 0.5))
    ways = np.linspace((0.0, 0.0), (0.0, 2.5), 11)
    row = arm.ask_path(ways)
    robot, scene = oc.Robot.from_urdf(URDF), oc.Scene()
    scene.add("crate/1", oc.shapes.Box(EDGES), pose(0.0, 1.0, 0.5))
    first = oc.RobotScene([robot], scene).check_path(ways, first=True)
    number = first.first_invalid
    assert number is not None
    assert (row["valid"], REASONS[row["reason"]], row["index"]) == (0, "collides", number)
    assert row["fraction"] == pytest.approx(first.fractions[number], abs=1e-9)
    keys = [row[name] for name in ("ns_a", "id_a", "ns_b", "id_b")]
    assert keys == [namespace_number("arm/hand"), 0, namespace_number("crate"), 1]
    jump = arm.ask_path([[0.0, 0.0], [0.0, 3.0]])
    assert (jump["reason"], jump["index"]) == (1, 0), "between its states"
    assert 0.4 < jump["fraction"] < 0.6
    for path, reason, index in (
        (ways[:4], "valid", 0),
        ([[0.5, 0.5]], "valid", 0),
        ([*ways[:3], [5.0, 0.0], *ways], "out of limits", 2),
        ([*ways[:3], [np.nan, 0.0]], "bad state", 3),
        (np.empty((0, 2)), "bad state", 0),
    ):
        row = arm.ask_path(path)
        assert (REASONS[row["reason"]], row["index"]) == (reason, index)
        assert row["valid"] == (reason == "valid")
        assert np.isnan(row["fraction"])
    arm.send_joints(lift=float("nan"))
    arm.until(lambda: arm.robot.fault, "the fault")
    assert REASONS[arm.ask_path(ways[:4])["reason"]] == "unknown"


@each("padded", ["arm/*", "arm/hand/1", "crate/*"])
def test_the_padding_of_links_counts_as_that_of_objects_does(arm: AskingRig, padded: str) -> None:
    arm.put((0.0, 1.2, 0.5))  # 0.05 m beyond the hand
    there = [[0.0, np.pi / 2]]
    assert arm.reasons(there) == ["valid"]
    arm.set(padding_overrides=[f"{padded}: 0.06"])
    arm.send_joints(lift=0.0, turn=np.pi / 2)
    assert set(map(frozenset, arm.pairs())) == {frozenset(("arm/hand/1", "crate/1"))}
    assert arm.reasons(there) == ["collides"]


def test_states_are_where_the_base_is() -> None:
    frames = FakeFrames()
    frames.known["odom"] = pose(2.0)
    with AskingRig({"robot_bases": ["arm: object_transform"]}, frames=frames) as rig:
        rig.describe()
        rig.send_transform("arm", pose(5.0))
        rig.until(lambda: rig.robot.links is not None, "the robot")
        rig.send_joints(lift=0.0, turn=0.0)
        rig.put((6.0, 0.0, 0.0))
        assert rig.reasons([[0.0, 0.0], [-0.5, 0.0]]) == ["valid", "collides"]
        rig.send_transform("arm", pose(9.0)).answer()
        assert rig.reasons([[0.0, 0.0], [-0.5, 0.0]]) == ["valid", "valid"]
        rig.send_transform("arm", pose(3.0), "odom").answer()
        assert rig.reasons([[0.0, 0.0], [-0.5, 0.0]]) == ["valid", "collides"]


@each(
    "rules, reason",
    [
        ({}, "collides"),
        ({"allowed_pairs": ["arm/hand/* crate/1"]}, "valid"),
        ({"allowed_pairs": ["arm/hand/0 crate/*"]}, "collides"),
        ({"check_only_pairs": ["arm/hand/1 crate/1"]}, "collides"),
        ({"allowed_within": ["*"]}, "collides"),
    ],
)
def test_rules_count_for_states(arm: AskingRig, rules: dict[str, Any], reason: str) -> None:
    arm.set(**rules)
    arm.put((0.0, 1.0, 0.5))
    assert arm.reasons([[0.0, np.pi / 2]]) == [reason]


def test_without_knowing_everything_no_state_is_valid() -> None:
    state = [[0.0, 0.0]]
    with AskingRig() as rig:
        assert rig.reasons(state) == ["unknown"]
        rig.describe()
        rig.until(lambda: rig.robot.links is not None, "the robot")
        assert rig.reasons(state) == ["unknown"]
        rig.send_joints(lift=0.0, turn=0.0).answer()
        assert rig.reasons(state) == ["valid"]
        for names in (("lift",), ("lift", "turn", "tail"), ("lift", "bend")):
            assert rig.reasons(np.zeros((1, len(names))), names=names) == ["unknown"]
        assert rig.reasons(state, kind="<f4") == ["unknown"]
        rig.send(cube(CRATE, (9, 0, 0), (0, 1, 1)))
        rig.send_joints(lift=0.0, turn=0.0).answer()
        assert rig.reasons(state) == ["unknown"]
        rig.send(cube(CRATE, (9, 0, 0))).answer()
        assert rig.reasons(state) == ["valid"]
        rig.call(SetBool, "obb_collision/enable", SetBool.Request(data=False))
        assert rig.reasons(state) == ["unknown"]
        rig.call(SetBool, "obb_collision/enable", SetBool.Request(data=True))
        rig.cycles(2)
        assert rig.reasons(state) == ["valid"]
        rig.send_joints(lift=float("nan"))
        rig.until(lambda: rig.robot.fault, "the fault")
        assert rig.reasons(state) == ["unknown"]


def test_objects_beyond_a_region_or_refused_make_states_unknown(arm: AskingRig) -> None:
    state = [[0.0, 0.0]]
    arm.send(cube(CRATE, (9, 0, 0))).answer()
    arm.set(region=["x: -5.0 to 5.0"])
    arm.cycles(2)
    assert arm.reasons(state) == ["unknown"]
    arm.set(region=[""])
    arm.cycles(2)
    assert arm.reasons(state) == ["valid"]
    arm.send_transform("crate/1", [float("nan"), *pose(0.0)[1:]])
    arm.cycles(2)
    assert arm.reasons(state) == ["unknown"]
    arm.send(cube(CRATE, (9, 0, 0))).answer()
    assert arm.reasons(state) == ["valid"]


def test_more_states_than_a_cycle_can_do_are_refused(arm: AskingRig, monkeypatch: Patch) -> None:
    monkeypatch.setattr(validity, "LONGEST_CHECK", 0.0)  # a few are checked, whatever the time
    times = iter(range(10))
    monkeypatch.setattr(validity, "monotonic", lambda: float(max(0, next(times) - 2)))
    reasons = arm.reasons(np.zeros((100, 2)))
    assert set(reasons[: reasons.index("unknown")]) == {"valid"}
    assert set(reasons[reasons.index("unknown") :]) == {"unknown"}
    monitor = arm.monitor("arm/states_to_check")
    assert dict(monitor.refused) == {validity.TOO_SLOW: 1}
    arm.questions.publish(cloud_to_ros(np.zeros(validity.MAX_STATES + 1, [("lift", "u1")])))
    arm.until(lambda: "too many points" in monitor.refused, "the refusal")


ROBOT_LINK, WORLD_OBJECT, ROBOT_ATTACHED = range(3)
"""Of moveit_msgs/ContactInformation."""
QUARTER = {"lift": 0.0, "turn": np.pi / 2}
TOP = '<group name="top"><link name="hand"/></group>'
LOWER = '<group name="lower"><joint name="lift"/></group>'


def request_of(values: Mapping[str, float], group: str = "") -> Any:
    """Return what looks like a request."""
    joints = SimpleNamespace(name=list(values), position=list(values.values()))
    state = SimpleNamespace(
        joint_state=joints,
        multi_dof_joint_state=SimpleNamespace(joint_names=[], transforms=[]),
        attached_collision_objects=[],
    )
    kinds = ("joint", "position", "orientation", "visibility")
    constraints = SimpleNamespace(**{f"{kind}_constraints": [] for kind in kinds})
    return SimpleNamespace(robot_state=state, group_name=group, constraints=constraints)


def contact() -> Any:
    header = SimpleNamespace(stamp=None, frame_id="")
    return SimpleNamespace(header=header, position=SimpleNamespace(), normal=SimpleNamespace())


class ServiceRig(AskingRig):
    """A rig that calls the service without moveit_msgs; the robot has a crate in its way."""

    def __init__(self) -> None:
        super().__init__()
        self.semantics.publish(String(data=SRDF.replace("</robot>", TOP + LOWER + "</robot>")))
        self.start_robot()
        self.until(lambda: self.robot.links.robot.groups, "the SRDF")
        monitor = self.monitor("arm/states_to_check")
        self.service = validity.StateService(self.ends.checked, monitor, contact)

    def call_it(self, request: Any) -> Any:
        response = SimpleNamespace(valid=True, contacts=[], cost_sources=[])
        return self.service.answer(request, response)

    def is_valid(self, values: Mapping[str, float], group: str = "") -> bool:
        return bool(self.call_it(request_of(values, group)).valid)


@pytest.fixture(scope="module")
def shared() -> Iterator[ServiceRig]:
    with ServiceRig() as made:
        yield made


@pytest.fixture
def rig(shared: ServiceRig) -> ServiceRig:
    """Return the rig with the robot at rest, nothing attached and nothing refused so far."""
    put(shared, Marker(action=Marker.DELETEALL), cube(CRATE, (0.0, 1.0, 0.5), EDGES))
    shared.monitor("arm/states_to_check").refused.clear()
    return shared


def test_a_state_is_valid_or_has_contacts(rig: ServiceRig) -> None:
    assert rig.is_valid({"lift": 0.0, "turn": 0.0})
    assert rig.is_valid({})  # as it is now
    response = rig.call_it(request_of({"turn": np.pi / 2}))  # the other joint as it is now
    assert not response.valid
    assert response.cost_sources == []
    (found,) = response.contacts
    assert (found.contact_body_1, found.body_type_1) == ("hand", ROBOT_LINK)
    assert (found.contact_body_2, found.body_type_2) == ("crate/1", WORLD_OBJECT)
    assert found.header.frame_id == "map"
    assert found.depth > 0.09
    place, normal = (np.array([at.x, at.y, at.z]) for at in (found.position, found.normal))
    assert np.abs(place - (0.0, 1.0, 0.5)).max() < 0.15
    np.testing.assert_allclose(np.linalg.norm(normal), 1.0)
    assert rig.refused("arm/states_to_check") == {}
    response = rig.call_it(request_of({"turn": 3.1}))  # out of limits
    assert (response.valid, response.contacts) == (False, [])


def test_a_group_counts_alone_with_what_it_moves(rig: ServiceRig) -> None:
    assert not rig.is_valid(QUARTER, "top")
    assert not rig.is_valid(QUARTER, "lower")  # it moves the hand
    put(rig, cube(("wall", 1), size=EDGES))  # in the base
    assert not rig.is_valid({"turn": 0.0})
    assert rig.is_valid({"turn": 0.0}, "top")


def test_what_is_attached_is_named(rig: ServiceRig) -> None:
    put(rig, held(), cube(CRATE, (0.0, 1.3, 0.5), EDGES))
    (found,) = rig.call_it(request_of(QUARTER, "top")).contacts
    assert (found.contact_body_1, found.body_type_1) == (f"{TOOL[0]}/1", ROBOT_ATTACHED)
    assert found.contact_body_2 == "crate/1"


SEVERAL = "robot_state.multi_dof_joint_state"


@each(
    "field, value, reason",
    [
        ("robot_state.joint_state.name", ["elbow", "turn"], "unknown joint"),
        ("robot_state.joint_state.name", ["turn", "turn"], "repeated joint"),
        ("robot_state.joint_state.position", [0.0, 0.0, 1.0], "array lengths differ"),
        ("robot_state.joint_state.position", [float("nan"), 0.0], "bad state"),
        ("group_name", "legs", "unknown group"),
        ("constraints.joint_constraints", [SimpleNamespace()], "not evaluated"),
        (f"{SEVERAL}.joint_names", ["world"], "not evaluated"),
        (f"{SEVERAL}.transforms", [SimpleNamespace()], "not evaluated"),
        ("robot_state.attached_collision_objects", [SimpleNamespace()], "not evaluated"),
    ],
)
def test_what_is_undecided_is_invalid(field: str, value: Any, reason: str, rig: ServiceRig) -> None:
    rig.monitor("arm/states_to_check").refused.clear()
    request = request_of({"lift": 0.0, "turn": 0.0})
    outer, _, name = field.rpartition(".")
    setattr(attrgetter(outer)(request) if outer else request, name, value)
    assert not rig.call_it(request).valid
    assert rig.refused("arm/states_to_check") == {reason: 1}
    assert rig.is_valid({"lift": 0.0, "turn": 0.0})


def test_where_the_scene_is_unknown_or_the_service_fails_no_state_is_valid(rig: ServiceRig) -> None:
    assert not rig.call_it(SimpleNamespace()).valid
    rig.send_joints(lift=float("nan"))
    rig.until(lambda: rig.robot.fault, "the fault")
    assert not rig.is_valid({"lift": 0.0, "turn": 0.0})
    assert rig.refused("arm/states_to_check") == {"internal error": 1, "scene not known": 1}


def test_the_service_of_moveit(rig: ServiceRig) -> None:
    srv = pytest.importorskip("moveit_msgs.srv")
    request = srv.GetStateValidity.Request()
    request.robot_state.joint_state.name = ["turn"]
    for turn, valid in ((0.0, True), (np.pi / 2, False)):
        request.robot_state.joint_state.position = [turn]
        response = rig.call(srv.GetStateValidity, "arm/check_state_validity", request)
        assert response.valid is valid
        bodies = [(each.contact_body_1, each.contact_body_2) for each in response.contacts]
        assert bodies == ([] if valid else [("hand", "crate/1")])
    request.robot_state.joint_state.name = ["elbow"]
    response = rig.call(srv.GetStateValidity, "arm/check_state_validity", request)
    assert not response.valid

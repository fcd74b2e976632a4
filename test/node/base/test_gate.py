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


"""The gate of a base over topics: what nav2_collision_monitor does, sentence by sentence."""

from __future__ import annotations

import time
from pkgutil import resolve_name
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from base_rig import SCAN, SQUARE, BaseRig, zone
from each import each
from geometry_msgs.msg import (
    Point32,
    Polygon,
    PolygonInstance,
    PolygonInstanceStamped,
    PolygonStamped,
)
from lifecycle_msgs.msg import Transition
from rig import A1, NAMESPACE, SHARED, Patch, cube, pose
from sensor_msgs.msg import LaserScan, PointCloud2, Range
from sensor_rig import cloud_of
from std_msgs.msg import Float32, Header, String
from std_srvs.srv import SetBool
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.diagnostics.answer import CODES, Answer, Reason
from obb_collision.node.messages.clouds import cloud_to_ros
from obb_collision.node.messages.conversions import stamp_to_ros

GATE = "obb_collision.node.base.gate"
SMALL = "[[0.3, 0.3], [0.3, -0.3], [-0.3, -0.3], [-0.3, 0.3]]"
ZERO = (0.0, 0.0, 0.0)
GO = (0.5, 0.1, -0.2)
AS_NAV2: dict[str, Any] = {"fail_closed": False}
CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
DEACTIVATE, CLEANUP = Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP


@pytest.fixture
def rig(one_robot: None) -> Any:
    """Return a gate with zones for slow and stop, as strict as by default, that sees nothing."""
    if not SHARED:
        SHARED.append(BaseRig({"Slow": zone("slowdown"), "Stop": zone("stop", SMALL)}))
    SHARED[0].see_points((5.0, 0.0))
    assert SHARED[0].answer_to(*GO) == GO, SHARED[0].gate.text
    return SHARED[0]


def header(rig: BaseRig, frame: str = "lidar", age: float = 0.0) -> Header:
    """Return a header of now."""
    stamp = rig.node.get_clock().now().nanoseconds - int(age * 1e9)
    return Header(stamp=stamp_to_ros(stamp), frame_id=frame)


def give(rig: BaseRig, message: Any, name: str = "front") -> None:
    """Publish a message of a sensor, and wait until it is taken in."""
    topic = rig.sensors[name].topic_name.rpartition("/")[2]
    before = rig.monitor(topic).messages
    rig.sensors[name].publish(message)
    rig.until(lambda: rig.monitor(topic).messages > before, "the message")


def test_zones_act_by_their_actions(rig: BaseRig) -> None:
    rig.says_state(action="none", zone="", reason="")
    rig.see_points((0.4, 0.0))
    assert rig.answer_to(*GO) == (0.25, 0.05, -0.1)
    rig.says_state(action="slowdown", zone="Slow", who="front", reason="")
    rig.see_points((0.2, 0.1), (0.25, 0.0))
    assert rig.answer_to(*GO) == ZERO
    said = rig.says_state(action="stop", zone="Stop", who="front")
    near = [float(value) for value in said["nearest point (m)"].split()]
    assert near == pytest.approx([0.2, 0.1, 0.0], abs=2e-3)


def test_other_axes_are_zero_and_one_command_has_one_answer(rig: BaseRig) -> None:
    (safe,) = rig.order(*GO, linear_z=1.0, angular_x=2.0)
    assert (safe.linear.z, safe.angular.x, safe.angular.y) == ZERO
    for _ in range(5):
        assert len(rig.order(*GO)) == 1
    rig.cycles(3)
    assert len(rig.safe) == 1, "never by a timer"


def test_points_of_the_zone_that_acts_are_shown_once_per_command(rig: BaseRig) -> None:
    shown: dict[str, list[Any]] = {"collision_points_marker": [], "triggering_points": []}
    subscribed = [
        rig.client.create_subscription(MarkerArray, f"obb_collision/{name}", came.append, 10)
        for name, came in shown.items()
    ]
    rig.until(lambda: all(rig.node.count_subscribers(s.topic_name) for s in subscribed), "met")
    rig.see_points((0.4, 0.0), (0.0, 3.0))
    rig.order(*GO)
    rig.until(lambda: all(shown.values()), "markers")
    (every,) = shown["collision_points_marker"][0].markers
    assert (every.ns, every.type, len(every.points)) == ("collision_points_front", Marker.POINTS, 2)
    gone, points = shown["triggering_points"][0].markers
    assert gone.action == Marker.DELETEALL
    assert (points.ns, points.id, points.frame_locked) == ("Slow/front", 0, True)
    assert points.header.frame_id == "base_footprint"
    assert (points.color.r, points.color.g, points.color.b, points.color.a) == (1.0, 1.0, 0.0, 1.0)
    for subscription in subscribed:
        rig.client.destroy_subscription(subscription)


def test_diagnostics_have_the_same_state(rig: BaseRig) -> None:
    rig.see_points((0.2, 0.0))
    rig.answer_to(*GO)
    said = rig.status(": base")
    assert (said["zone"], said["who"], said["message"]) == ("Stop", "front", "stop by Stop: front")
    assert float(said["longest answer (ms)"]) < 1e4
    rig.see_points((5.0, 0.0), age=3.0)
    rig.answer_to(*GO)
    assert rig.status(": base")["message"].startswith("stale front")


def test_a_bond_tells_a_lifecycle_manager_that_the_node_lives(monkeypatch: Patch) -> None:
    class Status(SimpleNamespace):
        """Stands in for bond/Status."""

        def __init__(self, **fields: Any) -> None:
            super().__init__(header=SimpleNamespace(stamp=None), **fields)

    monkeypatch.setattr("obb_collision.node.base.bond.Status", Status)
    node, sent = Mock(), list[Any]()
    node.get_name.return_value, node.create_publisher.return_value.publish = "monitor", sent.append
    bond = resolve_name("obb_collision.node.base.bond:Bond")(node, 0.1)
    assert node.create_publisher.call_args.args == (Status, "bond", 10)
    bond.begin()
    period, beat = node.create_timer.call_args.args
    beat()
    bond.end()
    assert [status.active for status in sent] == [True, True, False]
    times = {(status.id, status.heartbeat_timeout, status.heartbeat_period) for status in sent}
    assert times == {("monitor", 4.0, 0.1)}
    assert len({status.instance_id for status in sent}) == 1
    assert period == 0.1
    node.destroy_timer.assert_called_once()


def test_live_parameters(rig: BaseRig) -> None:
    rig.see_points((0.2, 0.0))
    rig.set(**{"Stop.enabled": False})
    assert rig.answer_to(*GO) == (0.25, 0.05, -0.1)
    rig.set(**{"Slow.min_points": 2})
    assert rig.answer_to(*GO) == GO
    assert not rig.set(**{"Slow.min_points": 0})[0].successful
    rig.set(**{"Stop.enabled": True, "Slow.min_points": 1})
    assert rig.answer_to(*GO) == ZERO
    rig.set(**{"front.enabled": False})
    assert rig.answer_to(*GO) == GO, "a source that is off is neither seen nor missed"
    rig.set(**{"front.enabled": True, "Stop.points": "[[1, 1], [1, 2], [2, 2], [2, 1]]"})
    assert rig.answer_to(*GO) == (0.25, 0.05, -0.1), "the zone is elsewhere"
    assert not rig.set(**{"Slow.type": "circle"})[0].successful, "read at the start"


@each("name, value", [("allow_leaving", True), ("sources_names", ["nobody"]), ("points", "[]")])
def test_what_zones_cannot_be_made_of_is_refused_and_others_stay_live(
    rig: BaseRig, name: str, value: Any
) -> None:
    rig.see_points((0.2, 0.0))
    assert not rig.set(**{f"Stop.{name}": value})[0].successful
    rig.set(**{"Stop.enabled": False})
    assert rig.answer_to(*GO) == (0.25, 0.05, -0.1)


def toggled(rig: BaseRig, on: bool) -> None:
    """Switch the zones on or off."""
    assert rig.call(SetBool, "obb_collision/toggle", SetBool.Request(data=on)).success


def test_toggled_off_it_passes_commands_but_not_invalid_sources(rig: BaseRig) -> None:
    rig.see_points((0.2, 0.0))
    toggled(rig, on=False)
    assert rig.answer_to(*GO) == GO
    rig.see_points((0.2, 0.0), age=3.0)
    assert rig.answer_to(*GO) == ZERO
    rig.says_state(reason="stale", who="front")
    toggled(rig, on=True)


def test_what_is_missing_stops_with_its_code(rig: BaseRig) -> None:
    rig.see_points((5.0, 0.0), age=3.0)
    assert rig.answer_to(*GO) == ZERO
    rig.says_state(reason="stale", who="front", action="stop")
    rig.see_points((5.0, 0.0), age=-1.0)
    assert rig.answer_to(*GO) == ZERO
    rig.says_state(reason="refused", who="front")
    rig.see_points((5.0, 0.0))
    rig.frames.spans = {"base_footprint": (1, 2)}
    assert rig.answer_to(*GO) == ZERO
    rig.says_state(reason="late_frame", who="front")
    rig.frames.spans = {}
    rig.see_points()
    assert rig.answer_to(*GO) == GO
    give(rig, rig_scan(rig, [np.nan, 0.001]))
    assert rig.answer_to(*GO) == ZERO
    rig.says_state(reason="refused", who="front")
    give(rig, rig_scan(rig, [np.nan, 4.0], angle_increment=np.nan))
    assert rig.answer_to(*GO) == ZERO
    rig.says_state(reason="input_unreadable", who="front")
    rig.see_points((5.0, 0.0))
    assert rig.answer_to(*GO) == GO
    rig.says_state(reason="", action="none")
    rig.set(fail_closed=False)
    give(rig, rig_scan(rig, [np.nan, 0.001]))
    assert rig.answer_to(*GO) == GO, "as nav2"
    rig.set(fail_closed=True)


def rig_scan(rig: BaseRig, ranges: Any, **fields: Any) -> Any:
    """Return a scan of some rays."""
    values = {"range_min": 0.01, "range_max": 30.0, "angle_increment": 0.1} | fields
    return LaserScan(header=header(rig), ranges=[float(value) for value in ranges], **values)


@each("code", [code for code in CODES if code not in ("starting", "no_objects")])
def test_whatever_the_status_lacks_is_zero_with_its_code(
    rig: BaseRig, code: str, monkeypatch: Patch
) -> None:
    reasons = Reason("starting"), Reason("no_objects"), Reason(code, ("a/1",), 1)
    with monkeypatch.context() as patch:
        patch.setattr(rig.node.evidence, "answer", lambda: Answer(reasons))
        rig.see_points((5.0, 0.0))
        assert rig.answer_to(*GO) == ZERO
        rig.says_state(reason=code, who="a/1")


def test_a_command_that_is_no_number_is_zero(rig: BaseRig) -> None:
    for name in ("linear_x", "linear_z", "angular_y"):
        for value in (np.nan, np.inf, 1e200):
            (safe,) = rig.order(**{name: value})
            assert (safe.linear.x, safe.linear.y, safe.angular.z) == ZERO
    rig.says_state(reason="command_invalid")


def test_without_a_command_in_time_it_stops(rig: BaseRig) -> None:
    rig.set(command_timeout=0.2)
    rig.safe.clear()
    rig.until(lambda: rig.safe, "a zero")
    assert not rig.safe[0].linear.x
    rig.says_state(reason="command_silent")
    rig.set(command_timeout=0.0)
    assert rig.answer_to(*GO) == GO


def test_a_blocked_node_stops(rig: BaseRig) -> None:
    rig.set(command_timeout=0.2)
    rig.safe.clear()
    limit = time.monotonic() + rig.patience
    while rig.gate.values.get("reason") != "command_silent":  # nothing spins
        assert time.monotonic() < limit
        time.sleep(0.01)
    rig.until(lambda: rig.safe, "a zero")
    rig.set(command_timeout=0.0)
    assert rig.answer_to(*GO) == GO


def test_an_answer_that_comes_too_late_is_zero(rig: BaseRig) -> None:
    rig.set(command_timeout=1e-6)
    assert rig.answer_to(*GO) == ZERO
    rig.says_state(reason="overload")
    rig.set(command_timeout=0.0)


def test_a_clock_that_stands_still_is_zero(rig: BaseRig, monkeypatch: Patch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(rig.node.time, "now", rig.node.time.now)
        patch.setattr(rig.node.time, "seconds", lambda: -1e6)
        patch.setattr(rig.node.time, "moved", -1e6)
        stopped = rig.node.get_clock().now().nanoseconds
        patch.setattr(rig.node.time, "now", lambda: stopped)
        assert rig.answer_to(*GO) == ZERO
        rig.says_state(reason="clock_stopped")


def test_an_error_inside_is_zero(rig: BaseRig, monkeypatch: Patch) -> None:
    with monkeypatch.context() as broken:
        broken.setattr(f"{GATE}.decide", lambda *_: 1 / 0)
        assert rig.answer_to(*GO) == ZERO
        rig.says_state(reason="internal_error")
    assert rig.answer_to(*GO) == GO
    rig.node.guard.counts.clear()


def test_objects_of_the_scene_count_too(rig: BaseRig) -> None:
    rig.send(cube(A1, (0.6, 0.0, 0.0), (0.4, 0.4, 0.4), frame="odom"))
    rig.until(lambda: len(rig.node.objects.table) == 1, "the object")
    assert rig.answer_to(*GO) == (0.25, 0.05, -0.1)
    rig.says_state(action="slowdown", who="a/1")
    for name, value, normal in (("own_objects", "a/*", ""), ("zone_objects", "b/*", "*")):
        rig.set(**{name: [value]})
        assert rig.answer_to(*GO) == GO, name
        rig.set(**{name: [normal]})
        assert rig.answer_to(*GO) == (0.25, 0.05, -0.1)
    rig.send(cube(A1, (0.6, 0.0, 0.0), (0.4, 0.4, 0.4), frame="nowhere"))

    def is_late() -> bool:
        return rig.answer_to(*GO) == ZERO

    rig.until(is_late, "no place")
    rig.says_state(reason="late_frame", who="a/1")
    rig.node.objects.clear()
    rig.cycles(2)
    assert rig.answer_to(*GO) == GO


@each("accuracy", ["obb", "hull"])
def test_round_objects_count_by_their_boxes_or_hulls(rig: BaseRig, accuracy: str) -> None:
    rig.set(accuracy=accuracy)
    rig.send(cube(A1, (0.88, 0.88, 0.0), (1.0, 1.0, 1.0), frame="odom", type=Marker.CYLINDER))
    rig.until(lambda: len(rig.node.objects.table) == 1, "the object")
    slow = (0.25, 0.05, -0.1)
    rig.see_points((5.0, 0.0))
    assert rig.answer_to(*GO) == (slow if accuracy == "obb" else GO)
    rig.send(cube(A1, (0.82, 0.82, 0.0), (1.0, 1.0, 1.0), frame="odom", type=Marker.CYLINDER))
    rig.until(lambda: rig.answer_to(*GO) == slow, "nearer")
    rig.node.objects.clear()
    rig.cycles(2)
    rig.set(accuracy="obb")


def test_a_node_that_ends_stops_the_base() -> None:
    given = {"odom_frame_id": "odometry", "Stop.velocity_polygons": None}  # [] in a file
    with BaseRig({"Stop": zone("stop")}, given=given) as rig:
        assert rig.node.parameters.fixed_frame == "odometry"
        rig.see_points((5.0, 0.0))
        assert rig.answer_to(*GO) == GO
        rig.safe.clear()
        rig.node.say_farewell()
        rig.until(lambda: rig.safe, "a zero")
        assert rig.safe[0].linear.x == 0.0
        rig.says_state(reason="shutting_down")


def test_stamped_commands_keep_their_header() -> None:
    with BaseRig({"Slow": zone("slowdown")}, stamped=True) as rig:
        rig.see_points((0.4, 0.0))
        (safe,) = rig.order(*GO)
        assert safe.twist.linear.x == 0.25
        assert safe.header.frame_id == "base_footprint"
        assert safe.header.stamp == stamp_to_ros(rig.stamp)


class StateLookAlike(String):  # type: ignore[misc]
    """Stands in for nav2_msgs/CollisionMonitorState."""

    def __init__(self, action_type: int = 0, polygon_name: str = "") -> None:
        super().__init__(data=f"{action_type} {polygon_name}")


def test_the_state_of_nav2_is_published_when_the_zone_changes(monkeypatch: Patch) -> None:
    monkeypatch.setattr(f"{GATE}.StateMessage", StateLookAlike)
    zones = {"Slow": zone("slowdown"), "Stop": zone("stop", SMALL)}
    with BaseRig(zones, given={"state_topic": "state"}, **AS_NAV2) as rig:
        came: list[Any] = []
        rig.client.create_subscription(String, "state", came.append, 10)
        rig.until(lambda: rig.node.count_subscribers(f"{NAMESPACE}/state"), "met")
        for distance, age in ((5.0, 0), (0.2, 0), (0.21, 0), (0.4, 0), (5.0, 0), (5.0, 3)):
            rig.see_points((distance, 0.0), age=age)
            rig.order(*GO)
        toggled(rig, on=False)
        rig.see_points((0.2, 0.0))
        rig.order(*GO)
        toggled(rig, on=True)
        rig.order(*GO)
        expected = ["1 Stop", "2 Slow", "0 ", "1 invalid source", "1 Stop"]
        rig.until(lambda: len(came) >= len(expected), "states")
        assert [message.data for message in came] == expected, (
            "first free is silence, and so is toggled off"
        )


def test_zeros_end_as_those_of_nav2() -> None:
    with BaseRig({"Stop": zone("stop")}, stop_pub_timeout=0.3, **AS_NAV2) as rig:
        clock, seconds = rig.gate.now, [0]
        rig.gate.now = lambda: clock() + seconds[0]
        rig.see_points((5.0, 0.0))
        assert len(rig.order()) == 1, "the first zero after the activation"
        assert len(rig.order(*GO)) == 1
        assert len(rig.order()) == 1, "commanded"
        seconds[0] = 250_000_000
        assert len(rig.order()) == 1
        seconds[0] = 600_000_000
        rig.see_points((0.2, 0.0), age=-0.6)
        assert rig.order() == []
        assert rig.order(*GO) == [], "or enforced: it makes no difference"
        rig.see_points((5.0, 0.0), age=-0.6)
        assert len(rig.order(*GO)) == 1
        rig.see_points((0.2, 0.0), age=-0.6)
        assert len(rig.order(*GO)) == 1
        assert rig.order(np.nan) == [], "ignored"
        rig.gate.now = clock
        rig.cycles(60)
        assert rig.safe == [], "and no command is no reason to say anything"


def test_the_same_topic_for_commands_and_answers_is_refused() -> None:
    with pytest.raises(ValueError, match="cmd_vel_in_topic and cmd_vel_out_topic"):
        BaseRig({}, cmd_vel_out_topic="cmd_vel_smoothed")


def test_in_other_states_each_command_is_zero() -> None:
    with BaseRig({"Stop": zone("stop")}, autostart=False) as rig:
        assert rig.state() == "unconfigured"
        assert rig.answer_to(*GO) == ZERO
        rig.says_state(reason="unconfigured")
        rig.go_through(CONFIGURE)
        assert rig.answer_to(*GO) == ZERO
        rig.says_state(reason="inactive")
        rig.change(ACTIVATE)
        assert rig.answer_to(*GO) == ZERO
        rig.says_state(reason="input_silent", who="front")
        rig.wait_sensors()
        rig.see_points((5.0, 0.0))
        assert rig.answer_to(*GO) == GO
        rig.safe.clear()
        rig.go_through(DEACTIVATE)
        rig.until(lambda: rig.safe, "a zero at once")
        rig.says_state(reason="inactive")
        rig.go_through(CLEANUP)
        assert rig.answer_to(*GO) == ZERO
        rig.says_state(reason="unconfigured")
        rig.go_through(CONFIGURE, ACTIVATE)
        rig.wait_sensors()
        rig.see_points((5.0, 0.0))
        assert rig.answer_to(*GO) == GO


def test_as_nav2_it_is_silent_in_other_states_and_a_bad_zone_leaves_it_unconfigured() -> None:
    bad = {"Stop": zone("stop", "[[0, 0]]")}
    with BaseRig(bad, autostart=False, **AS_NAV2) as rig:
        assert not rig.change(CONFIGURE)
        assert rig.state() == "unconfigured"
        assert rig.order(*GO) == []
        rig.set(**{"Stop.points": SQUARE})
        rig.go_through(CONFIGURE)
        assert rig.order(*GO) == []
        rig.change(ACTIVATE)
        rig.wait_sensors()
        rig.see_points((5.0, 0.0))
        assert rig.answer_to(*GO) == GO


def test_an_integer_for_a_double_of_the_node_leaves_it_unconfigured() -> None:
    with BaseRig({"Stop": zone("stop")}, autostart=False, source_timeout=2) as rig:
        assert not rig.change(CONFIGURE)
        assert rig.state() == "unconfigured"
        rig.set(source_timeout=2.0)
        rig.go_through(CONFIGURE)


def test_a_source_that_is_killed_stops_within_its_limit() -> None:
    source = SCAN | {"source_timeout": 0.3}
    with BaseRig({"Stop": zone("stop")}, {"front": source}) as rig:
        rig.see_points((5.0, 0.0))
        last = time.monotonic()
        assert rig.answer_to(*GO) == GO
        while rig.answer_to(*GO) == GO:
            went_on = time.monotonic()
        assert went_on - last < 0.3 + 0.2
        rig.says_state(reason="stale", who="front")


def test_the_first_invalid_source_counts_and_those_without_a_limit_do_not() -> None:
    sources = {
        "front": SCAN,
        "rear": SCAN | {"topic": "rear", "source_timeout": 0.0},
        "top": SCAN | {"topic": "top"},
    }
    with BaseRig({"Stop": zone("stop")}, sources) as rig:
        assert rig.answer_to(*GO) == ZERO
        rig.says_state(reason="input_silent", who="front")
        rig.see_points((5.0, 0.0))
        assert rig.answer_to(*GO) == ZERO
        rig.says_state(reason="input_silent", who="top")
        rig.see_points((5.0, 0.0), name="top")
        assert rig.answer_to(*GO) == GO
        rig.see_points((0.2, 0.0), name="rear", age=100.0)
        assert rig.answer_to(*GO) == ZERO, "of any age"
        rig.says_state(action="stop", who="rear")


def test_points_move_with_the_base_since_their_stamp(monkeypatch: Patch) -> None:
    with BaseRig({"Stop": zone("stop")}) as rig:
        rig.see_points((1.0, 0.0))
        assert rig.answer_to(*GO) == GO
        known, lookup = rig.frames, rig.frames.lookup
        behind = rig.node.get_clock().now().nanoseconds

        def moved(frame: str, stamp: int) -> Any:
            if frame == "base_footprint" and stamp > behind:
                return np.array(pose(0.7)), stamp
            return lookup(frame, stamp)

        with monkeypatch.context() as patch:
            patch.setattr(known, "lookup", moved)
            assert rig.answer_to(*GO) == ZERO, "it has come 0.7 m nearer"
            rig.set(base_shift_correction=False)
            assert rig.answer_to(*GO) == GO
        rig.set(base_shift_correction=True)
        now = rig.node.get_clock().now().nanoseconds
        known.spans = {"base_footprint": (1, now)}
        rig.set(transform_tolerance=100.0)
        assert rig.answer_to(*GO) == GO, "the latest transform is not too old"
        rig.see_points((0.55, 0.0))
        rig.until(lambda: rig.answer_to(*GO) == ZERO, "it goes on as commanded since then")
        rig.set(transform_tolerance=0.0)
        assert rig.answer_to(*GO) == ZERO


def heights(rig: BaseRig, *rows: tuple[float, ...]) -> PointCloud2:
    """Return a cloud of rows (x, y, z, height)."""
    cloud = np.zeros(len(rows), [(name, "<f4") for name in ("x", "y", "z", "height")])
    for row, values in enumerate(rows):
        cloud[row] = values
    return cloud_to_ros(cloud, header(rig))


def test_clouds_count_between_heights() -> None:
    source = {"type": "pointcloud", "topic": "cloud", "min_range": 0.1}
    with BaseRig({"Stop": zone("stop")}, {"front": source}) as rig:
        for z, stops in ((0.02, 0), (0.05, 1), (0.5, 1), (0.6, 0)):
            give(rig, cloud_of([[0.2, 0.0, z]], header(rig), "<f8"))
            assert rig.answer_to(*GO) == (ZERO if stops else GO), z
        give(rig, cloud_of([[0.05, 0.0, 0.06], [np.nan] * 3], header(rig)))
        assert rig.answer_to(*GO) == GO, "nearer than min_range"
        rig.set(**{"front.max_height": 1.0})
        give(rig, cloud_of([[0.2, 0.0, 0.6]], header(rig)))
        assert rig.answer_to(*GO) == ZERO
        rig.set(**{"front.use_global_height": True})
        give(rig, heights(rig, (0.2, 0.0, 3.0, 0.3)))
        assert rig.answer_to(*GO) == ZERO
        give(rig, heights(rig, (0.2, 0.0, 0.3, 3.0)))
        assert rig.answer_to(*GO) == GO
        rig.set(fail_closed=False)
        give(rig, cloud_of([[0.2, 0.0, 0.3]], header(rig)))
        assert rig.answer_to(*GO) == ZERO, "without the field it is invalid"


def test_a_range_is_an_arc_and_one_that_sees_nothing_stops() -> None:
    source = {"type": "range", "topic": "sonar"}
    with BaseRig({"Stop": zone("stop")}, {"front": source}, **AS_NAV2) as rig:
        limits = {"min_range": 0.1, "max_range": 1.0}

        def measure(distance: float, view: float = 0.2) -> tuple[float, ...]:
            message = Range(range=distance, field_of_view=view, header=header(rig), **limits)
            give(rig, message)
            return rig.answer_to(*GO)

        assert measure(0.4) == ZERO
        assert measure(0.7) == GO
        assert measure(0.7, 0.5 * np.pi + 0.01) == ZERO, "its end is 0.495 m ahead and aside"
        for unseen in (0.05, 1.1, np.inf):
            assert measure(0.7) == GO
            assert measure(unseen) == ZERO


def test_polygons_are_sampled_along_their_borders_until_they_are_old() -> None:
    source = {"type": "polygon", "topic": "people", "source_timeout": 1.0}
    zones = {"Stop": zone("stop", min_points=4)}
    with BaseRig(zones, {"front": source}) as rig:

        def tell(number: int, x: float, age: float = 0.0, size: float = 0.2) -> tuple[float, ...]:
            places = ((0.0, 0.0), (size, 0.0), (size, size), (0.0, size))
            corners = [Point32(x=x + a, y=b) for a, b in places]
            polygon = PolygonInstance(polygon=Polygon(points=corners), id=number)
            give(rig, PolygonInstanceStamped(header=header(rig, age=age), polygon=polygon))
            return rig.answer_to(*GO)

        assert rig.answer_to(*GO) == ZERO, "nothing stored"
        assert tell(1, 5.0) == GO
        assert tell(2, 0.2) == ZERO
        assert tell(2, 5.0) == GO, "the same id replaces"
        assert tell(2, 0.2, age=2.0) == GO, "too old, and dropped"
        assert tell(1, 5.0, age=2.0) == ZERO
        rig.says_state(reason="stale", who="front")
        for size in (1e20, np.nan, np.inf):
            assert tell(1, 5.0) == GO
            assert tell(1, 5.0, size=size) == ZERO
            rig.says_state(reason="input_unreadable", who="front")


@each("kind", ["circle", "polygon", "footprint"])
def test_shapes_by_topics(kind: str) -> None:
    bare = {"action_type": "stop", "min_points": 1, "polygon_sub_topic": "shape"}
    group: dict[str, Any] = bare | {"type": "circle" if kind == "circle" else "polygon"}
    if kind == "footprint":
        group = {"type": "polygon", "action_type": "approach", "footprint_topic": "shape"}
        group |= {"min_points": 1}
    with BaseRig({"Zone": group}) as rig:
        rig.see_points((0.3, 0.0))
        assert rig.answer_to(*GO) == ZERO
        rig.says_state(reason="unplaced", who="Zone")
        rig.set(fail_closed=False)
        assert rig.answer_to(*GO) == GO, "skipped"
        message = PolygonStamped if kind != "circle" else Float32
        publisher = rig.client.create_publisher(message, "shape", 10)
        rig.until(publisher.get_subscription_count, "the subscription")
        (made,) = rig.gate.zones
        for size, x in ((0.4, 0.0), (0.2, 0.0), (0.4, 2.0)):
            if kind == "circle":
                publisher.publish(Float32(data=size - x))
            else:
                corners = [
                    Point32(x=x + size * a, y=size * b) for a, b in ((1, 1), (1, -1), (-2, 0))
                ]
                frame = "odom" if x else "base_footprint"
                rig.frames.known["base_footprint"] = pose(x)
                rig.frames.known["lidar"] = pose(x)
                points = Polygon(points=corners)
                publisher.publish(PolygonStamped(header=header(rig, frame), polygon=points))
            expected = size - x if kind == "circle" else size
            stops = expected > 0.3

            def arrived(stops: bool = stops) -> bool:
                return (rig.answer_to(*GO) == ZERO) == stops and made.outline is not None

            if expected > 0.0:
                rig.until(arrived, f"the shape {size}")


def test_a_zone_is_shown() -> None:
    zones = {"Zone": zone("stop", visualize=True, polygon_pub_topic="shown")}
    with BaseRig(zones) as rig:
        came: list[Any] = []
        rig.client.create_subscription(PolygonStamped, "shown", came.append, 10)
        rig.until(lambda: rig.node.count_subscribers(f"{NAMESPACE}/shown"), "met")
        rig.see_points((5.0, 0.0))
        rig.order(*GO)
        rig.until(lambda: came, "the zone")
        assert came[0].header.frame_id == "base_footprint"
        assert next((p.x, p.y) for p in came[0].polygon.points) == (0.5, 0.5)


def test_points_in_an_exclusion_do_not_count_unless_it_cannot_be_placed() -> None:
    given = {
        "exclusions": ["dock"],
        "dock.points": "[[0.1, 1], [0.1, -1], [-1, -1], [-1, 1]]",
        "dock.frame_id": "station",
    }
    with BaseRig({"Stop": zone("stop")}, given=given) as rig:
        rig.see_points((0.4, 0.0))
        assert rig.answer_to(*GO) == ZERO, "the station is not known"
        rig.frames.known["station"] = pose(0.35)
        assert rig.answer_to(*GO) == GO
        rig.see_points((0.4, 0.0), (0.48, 0.1))
        assert rig.answer_to(*GO) == ZERO


SIZES = {"scan": (1080, 5e-3), "cloud": (24_000, 10e-3)}
"""Points, and the most seconds of a thread for a decision, with 100 boxes."""


@pytest.mark.slow
@each("kind", SIZES)
def test_decisions_take_milliseconds(kind: str, monkeypatch: Patch) -> None:
    count, most = SIZES[kind]
    zones = {"Stop": zone("stop", SMALL), "Slow": zone("slowdown"), "Near": zone("approach", SMALL)}
    source = SCAN if kind == "scan" else {"type": "pointcloud", "topic": "cloud"}
    rng, took = np.random.default_rng(0), list[float]()
    with BaseRig(zones, {"front": source}) as rig:
        turns = rng.uniform(0.0, 2.0 * np.pi, 100)
        places = rng.uniform(2.0, 4.0, 100) * (np.cos(turns), np.sin(turns))
        size, frame = (0.3, 0.3, 1.0), "odom"
        boxes = [cube(("a", k), (x, y, 0.5), size, frame) for k, (x, y) in enumerate(places.T)]
        rig.send(*boxes)
        rig.until(lambda: len(rig.node.objects.table) == 100, "the boxes")
        answer = rig.gate.decision

        def timed(*arguments: Any) -> Any:
            start = time.thread_time()
            try:
                return answer(*arguments)
            finally:
                took.append(time.thread_time() - start)

        monkeypatch.setattr(rig.gate, "decision", timed)
        for _ in range(20):
            angles = rng.uniform(-np.pi, np.pi, count)
            if kind == "scan":
                rig.see_points(*(2.0 * np.column_stack([np.cos(angles), np.sin(angles)])))
            else:
                ring = [np.cos(angles), np.sin(angles), 0.05 + 0.0 * angles]
                give(rig, cloud_of(2.0 * np.column_stack(ring), header(rig)))
            rig.answer_to(0.5, 0.0, 0.3)
    assert min(took) < most

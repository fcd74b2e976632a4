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

"""The node's life cycle, by its services: each state, failures, and what it never says."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from each import each
from lifecycle_msgs.msg import Transition
from objects_rig import Gate, triangle
from rclpy.executors import SingleThreadedExecutor
from rig import A1, A2, LATCHED, NAMESPACE, STATUS, Patch, Rig, cube, own_context, pose, spy, sync
from std_msgs.msg import Bool
from visualization_msgs.msg import Marker

from obb_collision import Accuracy
from obb_collision.node.diagnostics.answer import COLLIDING, FREE, UNKNOWN
from obb_collision.node.node import CollisionNode
from obb_collision.node.objects.conditions import RESHAPED

PAIR = (cube(A1), cube(A2, (0.5, 0, 0)))
NAMED = {("a/1", "a/2")}
CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
DEACTIVATE, CLEANUP = Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP
STATES: dict[str, tuple[tuple[int, ...], set[int], int]] = {
    "unconfigured": ((), {CONFIGURE}, Transition.TRANSITION_UNCONFIGURED_SHUTDOWN),
    "inactive": ((CONFIGURE,), {ACTIVATE, CLEANUP}, Transition.TRANSITION_INACTIVE_SHUTDOWN),
    "active": ((CONFIGURE, ACTIVATE), {DEACTIVATE}, Transition.TRANSITION_ACTIVE_SHUTDOWN),
}
"""The way to each, what is possible there, and its shut down."""
MARKERS = "obb_collision/markers"
SCENE = """
padding: {padding}
objects:
  - {{name: part/1, shape: box, size: [1, 1, 1], position: [0, 0, 0]}}
"""


def managed(*transitions: int, **parameters: Any) -> Rig:
    """Return a rig with a node that others manage, after some transitions."""
    rig = Rig(deaf=True, autostart=False, given=parameters)
    rig.listen("collisions", "in_collision", "namespaces", STATUS)
    rig.go_through(*transitions)
    return rig


BROKEN = Mock(side_effect=KeyError("broken"))


def test_unconfigured_it_takes_nothing_in_and_knows_nothing() -> None:
    with managed() as rig:
        assert rig.state() == "unconfigured"
        rig.says(UNKNOWN, "unconfigured", True)
        inputs = [rig.client.count_subscribers(topic) for topic in rig.pubs]
        assert not any(inputs)
        names = dict(rig.client.get_service_names_and_types())
        assert f"{NAMESPACE}/obb_collision/clear" not in names
        rig.next(STATUS)  # repeated, so that its deadline holds
        assert rig.change(0, "configure"), "labels work as well as numbers"
        assert rig.change(0, "activate")
        assert rig.state() == "active"


def test_deactivated_is_not_known_and_active_again_is_up_to_date(monkeypatch: Patch) -> None:
    with managed(CONFIGURE, ACTIVATE) as rig:
        rig.send(cube(A1), cube(A2, (3, 0, 0))).answer()
        rig.says(FREE, "free", False)
        check = spy(monkeypatch, rig.node.objects.scene, "check")
        assert rig.change(DEACTIVATE)
        rig.says(UNKNOWN, "inactive", True)
        late: list[Any] = []
        rig.client.create_subscription(Bool, "in_collision", late.append, LATCHED)
        rig.until(lambda: late, "latched")
        assert late[0].data is True, "no old free"
        rig.last.pop("collisions", None)
        check.reset_mock()
        rig.send_transform("a/2", pose(0.5))
        rig.until(lambda: rig.pose_of(A2)[0] == 0.5, "moved")
        rig.cycles(3)
        check.assert_not_called()
        assert "collisions" not in rig.last
        assert rig.change(ACTIVATE)
        assert rig.pairs() == NAMED
        rig.says(COLLIDING, "1 pair", True)


@each("form", ["cubes", "lines"])
def test_boxes_are_not_shown_any_more_when_nothing_is_known(form: str) -> None:
    with managed(CONFIGURE, ACTIVATE, marker_lifetime=0.0, marker_form=form) as rig:
        rig.listen(MARKERS)
        rig.send(*PAIR)
        rig.until(lambda: MARKERS in rig.last and rig.last[MARKERS].markers, "boxes")
        shown = {(marker.ns, marker.id) for marker in rig.last[MARKERS].markers}
        assert rig.change(DEACTIVATE)

        def deleted() -> bool:
            markers = rig.last[MARKERS].markers
            return {marker.action for marker in markers} == {Marker.DELETE}

        rig.until(deleted, "deleted")
        assert {(marker.ns, marker.id) for marker in rig.last[MARKERS].markers} == shown


def test_cleaned_up_and_configured_again_it_starts_anew(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE.format(padding=0.25))
    with managed(CONFIGURE, ACTIVATE, scene_file=str(scene)) as rig:
        rig.send(*PAIR)
        assert rig.pairs() >= NAMED
        rig.set(rate=40.0)
        rig.node.cycle.enabled = False
        rig.go_through(DEACTIVATE, CLEANUP)
        rig.says(UNKNOWN, "unconfigured", True)
        rig.until(lambda: not any(p.get_subscription_count() for p in rig.pubs.values()), "none")
        assert rig.node.get_parameter("padding").value == 0.0, "the file's, not the user's"
        scene.write_text(SCENE.format(padding=0.125))
        rig.go_through(CONFIGURE, ACTIVATE)
        rig.says(FREE, "free", False)
        assert rig.node.objects.table.keys(rig.node.objects.scene.indices) == [("part", 1)]
        assert rig.node.objects.scene.padding == 0.125
        assert rig.node.get_parameter("rate").value == 40.0
        assert not any(rig.monitor(topic).messages for topic in rig.pubs)
        rig.send(*PAIR)
        assert rig.pairs() >= NAMED
        assert rig.namespaces("a", "part").keys() == rig.namespaces("a").keys()


def test_transitions_while_a_shape_is_built_leave_nothing_behind() -> None:
    with managed(CONFIGURE, ACTIVATE) as rig:
        before = rig.node.objects
        gate = Gate(rig)
        rig.send(cube(A1), triangle())
        sync(rig)
        assert before.table.has(RESHAPED).any()
        rig.go_through(DEACTIVATE, ACTIVATE)
        rig.says(UNKNOWN, "body/1", True)
        rig.go_through(DEACTIVATE, CLEANUP, CONFIGURE, ACTIVATE)
        gate.open()
        rig.says(UNKNOWN, "no_objects", True)
        assert len(rig.node.objects.table) == 0
        rig.send(cube(A1), triangle())
        rig.built(("body", 1))
        rig.says(COLLIDING, "1 pair", True)


def test_activated_and_cleaned_up_many_times_it_keeps_nothing(rig: Rig) -> None:
    def held() -> tuple[int, ...]:
        node = rig.node
        kinds = (node.timers, node.services, node.subscriptions, node.publishers)
        return (*(len([*kind]) for kind in kinds), threading.active_count())

    first = held()
    rig.go_through(*(DEACTIVATE, CLEANUP, CONFIGURE, ACTIVATE) * 5)
    assert held() == first


def test_parameters_count_once_it_is_configured() -> None:
    with managed(expect_empty=True) as rig:
        given: dict[str, Any] = {"padding": 0.5, "unknown_is_collision": False, "accuracy": "mesh"}
        assert all(result.successful for result in rig.set(**given))
        rig.says(UNKNOWN, flag=False)
        rig.go_through(CONFIGURE, ACTIVATE)
        assert rig.node.objects.scene.accuracy == Accuracy.MESH
        rig.says(FREE, "free", False)
        rig.send(cube(A1), cube(A2, (2.0, 0, 0)))
        assert rig.pairs() == NAMED


@each("state", STATES)
def test_impossible_transitions_change_nothing_and_a_shut_down_is_for_good(state: str) -> None:
    way, possible, shutdown = STATES[state]
    with managed(*way) as rig:
        others = {*range(12), 255} - possible - {shutdown}
        assert not any(rig.change(transition) for transition in others)
        assert not rig.change(0, "no such transition")
        assert rig.state() == state
        assert rig.change(shutdown)
        assert rig.state() == "finalized"
        rig.says(UNKNOWN, "shutting down", True)
        assert not rig.change(CONFIGURE)
        assert all(result.successful for result in rig.set(rate=40.0))
        assert not any(thread.name == STATUS for thread in threading.enumerate())


def test_a_scene_file_that_cannot_be_read_fails_a_transition_with_a_reason(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    with managed(scene_file=str(scene)) as rig:
        assert not rig.change(CONFIGURE)
        assert rig.state() == "unconfigured"
        rig.says(UNKNOWN, "the last transition failed", True)
        said = rig.last[STATUS].status[0].message
        assert str(scene) in said
        assert "Error" not in said, "a mistake of who starts it, no defect"
        scene.write_text(SCENE.format(padding=0.0))
        rig.go_through(CONFIGURE, ACTIVATE)
        rig.says(FREE, "free", False)


@each(
    "part, way, transition",
    [
        ("_make_cycle", (), CONFIGURE),
        ("_begin", (), CONFIGURE),
        ("activate", (CONFIGURE,), ACTIVATE),
        ("deactivate", (CONFIGURE, ACTIVATE), DEACTIVATE),
    ],
)
def test_what_fails_in_a_transition_leaves_nothing_configured_and_the_next_one_works(
    part: str, way: tuple[int, ...], transition: int, monkeypatch: Patch
) -> None:
    with managed(*way) as rig:
        with monkeypatch.context() as patch:
            patch.setattr(rig.node, part, BROKEN)
            assert not rig.change(transition)
        assert rig.state() == "unconfigured"
        rig.says(UNKNOWN, "KeyError: 'broken'", True)
        assert not any(rig.client.count_subscribers(topic) for topic in rig.pubs)
        assert not [*rig.node.timers], "nothing is called any more"
        rig.go_through(CONFIGURE, ACTIVATE)
        rig.send(*PAIR)
        assert rig.pairs() == NAMED


def test_a_node_that_cannot_even_be_released_is_finalized(monkeypatch: Patch) -> None:
    with managed(CONFIGURE, ACTIVATE) as rig:
        monkeypatch.setattr(rig.node.outputs, "withdraw", BROKEN)
        monkeypatch.setattr(rig.node, "deactivate", BROKEN)
        assert not rig.change(DEACTIVATE)
        assert rig.state() == "finalized"
        rig.says(UNKNOWN, "shutting down", True)
        monkeypatch.undo()


def test_nothing_is_left_of_a_node_that_cannot_start(tmp_path: Path) -> None:
    arguments = ["--ros-args", "-p", f"scene_file:={tmp_path}/missing.yaml"]
    before = threading.active_count()
    with own_context() as context, pytest.raises(ValueError, match="missing"):
        CollisionNode(context=context, cli_args=arguments)
    assert threading.active_count() == before


def test_two_nodes_on_threads_of_a_process_check_while_one_of_them_changes_its_state() -> None:
    """They share the caches of kernels and the threads that check, and nothing else."""
    with managed(CONFIGURE, ACTIVATE) as rig:
        other = CollisionNode(
            context=rig.context,
            namespace=f"{NAMESPACE}/cell",
            cli_args=["--ros-args", "-r", f"{NAMESPACE}/cell/objects:={NAMESPACE}/objects"],
        )
        executor = SingleThreadedExecutor(context=rig.context)
        executor.add_node(other)
        thread = threading.Thread(target=executor.spin)
        thread.start()
        try:
            rig.until(lambda: rig.pubs["objects"].get_subscription_count() == 2, "both")
            boxes = [cube(("b", number), (0.75 * number, 0, 0)) for number in range(300)]
            for turn in range(3):
                boxes[0].pose.position.y = float(5 * (turn % 2))
                expected = 299 - turn % 2
                rig.send(*boxes)
                assert len(rig.pairs()) == expected
                rig.go_through(DEACTIVATE, CLEANUP, CONFIGURE, ACTIVATE)

                def has_them(expected: int = expected) -> bool:
                    return len(other.cycle.report or ()) == expected

                rig.until(has_them, "the other's pairs")
                assert not other.status.answer.reasons
            assert other.guard.total == rig.node.guard.total == 0
        finally:
            executor.shutdown()
            thread.join()
            other.destroy_node()

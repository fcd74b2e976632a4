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

"""Transitions that are not possible or fail, and nodes that cannot start."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from each import each

pytest.importorskip("rclpy")
from lifecycle_rig import (
    ACTIVATE,
    CLEANUP,
    CONFIGURE,
    DEACTIVATE,
    NAMED,
    PAIR,
    SCENE,
    SHUTDOWN,
    STATUS,
    WAYS,
    managed,
    said,
)
from rclpy.context import Context
from rig import DOMAIN, Rig

from obb_collision.node.diagnostics.answer import FREE, UNKNOWN
from obb_collision.node.node import CollisionNode


@each("way", [*WAYS])
def test_a_transition_that_is_not_possible_is_refused_and_changes_nothing(way: str) -> None:
    with managed(*WAYS[way]) as rig:
        possible = {
            "unconfigured": {CONFIGURE},
            "inactive": {ACTIVATE, CLEANUP},
            "active": {DEACTIVATE},
        }[way] | {SHUTDOWN[way]}
        others = {*range(12), 255, *SHUTDOWN.values()} - possible
        assert not any(rig.change(transition) for transition in others)
        assert not rig.change(0, "no such transition")
        assert rig.state() == way


def test_a_scene_file_that_cannot_be_read_is_a_transition_that_failed_with_the_reason(
    tmp_path: Path,
) -> None:
    scene = tmp_path / "scene.yaml"
    with managed(scene_file=str(scene)) as rig:
        assert not rig.change(CONFIGURE)
        assert rig.state() == "unconfigured"
        said(rig, UNKNOWN, "the last transition failed", True)
        assert str(scene) in rig.last[STATUS].status[0].message
        scene.write_text(SCENE.format(padding=0.0))
        assert rig.change(CONFIGURE)
        assert rig.change(ACTIVATE)
        said(rig, FREE, "free", False)
    with pytest.raises(ValueError, match="missing"):
        Rig(scene_file=str(tmp_path / "missing.yaml"))


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
    part: str, way: tuple[int, ...], transition: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    with managed(*way) as rig:

        def fail(*_: object) -> None:
            raise KeyError("broken")

        with monkeypatch.context() as patch:
            patch.setattr(rig.node, part, fail)
            assert not rig.change(transition)
        assert rig.state() == "unconfigured"
        said(rig, UNKNOWN, "broken", True)
        assert not any(rig.client.count_subscribers(topic) for topic in rig.pubs)
        assert not [*rig.node.timers], "nothing is called any more"
        for again in (CONFIGURE, ACTIVATE):
            assert rig.change(again)
        rig.wait_inputs()
        rig.send(*PAIR)
        assert rig.pairs() == NAMED


def test_a_node_that_cannot_even_be_released_is_finalized(monkeypatch: pytest.MonkeyPatch) -> None:
    with managed(CONFIGURE, ACTIVATE) as rig:

        def fail(*_: object) -> None:
            raise KeyError("broken")

        monkeypatch.setattr(rig.node._outputs, "withdraw", fail)
        monkeypatch.setattr(rig.node, "deactivate", fail)
        assert not rig.change(DEACTIVATE)
        assert rig.state() == "finalized"
        said(rig, UNKNOWN, "shutting down", True)
        monkeypatch.undo()


def test_nothing_is_left_of_a_node_that_cannot_start(tmp_path: Path) -> None:
    context = Context()
    context.init(domain_id=DOMAIN)
    make: Callable[[], CollisionNode] = lambda: CollisionNode(  # noqa: E731
        context=context,
        cli_args=["--ros-args", "-p", f"scene_file:={tmp_path}/missing.yaml"],
    )
    before = threading.active_count()
    with pytest.raises(ValueError, match="missing"):
        make()
    assert threading.active_count() == before
    context.shutdown()

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

"""Kernels made ready beside the cycles: once, in their own time, and what then waits for them."""

from __future__ import annotations

from threading import Event
from typing import Any

import pytest

pytest.importorskip("rclpy")
from rig import Rig, cube
from test_node_accuracy import ring, rungs

from obb_collision.node import warm_up
from obb_collision.node.warm_up import WarmUp
from obb_collision.queries.accuracy import Accuracy


class Log:
    """Lines said and complained about."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.complained: list[str] = []

    def warm_up(self) -> WarmUp:
        return WarmUp(self.said.append, self.complained.append)


def wait_for(warm: WarmUp, thing: Accuracy | str) -> None:
    """Wait until a thing is ready; the test hangs if it never is."""
    done = Event()
    while not warm.is_ready(thing):
        done.wait(0.01)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Note what would be made ready, in place of doing so."""
    things: list[Any] = []
    monkeypatch.setattr(warm_up, "warm_up_rung", things.append)
    monkeypatch.setattr(warm_up, "warm_up_effect", things.append)
    return things


def test_boxes_are_ready_and_all_else_is_made_so_once(made: list[Any]) -> None:
    log = Log()
    warm = log.warm_up()
    assert all(warm.is_ready(rung) for rung in Accuracy if rung <= Accuracy.OBB)
    warm.finish([Accuracy.MESH, Accuracy.OBB, Accuracy.MESH])
    assert warm.is_ready(Accuracy.MESH)
    for thing in ("sweep", Accuracy.HULL, "sweep"):
        wait_for(warm, thing)
    assert made == [Accuracy.MESH, "sweep", Accuracy.HULL]
    assert [line for line in log.said if line.startswith("accuracy mesh ready")]
    assert log.complained == []


def test_what_cannot_be_made_ready_is_said_and_not_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(name: str) -> None:
        raise OSError("no disk")

    monkeypatch.setattr(warm_up, "warm_up_effect", broken)
    log = Log()
    warm = log.warm_up()
    wait_for(warm, "sweep")
    assert log.complained == ["effect sweep: OSError: no disk"]


def test_pairs_stay_on_obb_and_cycles_go_on_until_an_accuracy_is_ready(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    compiling, done = Event(), Event()

    def slow(rung: Accuracy) -> None:
        compiling.set()
        done.wait()

    monkeypatch.setattr(warm_up, "warm_up_rung", slow)
    with Rig() as rig:
        rig.patience = 300.0  # then the cycle itself compiles, here
        rig.send(ring(), cube(("box", 1), size=(0.5, 0.5, 0.5)))
        assert rig.pairs() == {("mesh/1", "box/1")}
        rig.set(accuracy="mesh")
        rig.until(compiling.is_set, "thread")
        rig.cycles(5)
        assert rungs(rig) == ["obb"]
        done.set()
        rig.until(lambda: rungs(rig) == [], "mesh")


def test_an_effect_is_silent_until_it_is_ready(monkeypatch: pytest.MonkeyPatch) -> None:
    compiling, done = Event(), Event()

    def slow(name: str) -> None:
        compiling.set()
        done.wait()

    monkeypatch.setattr(warm_up, "warm_up_effect", slow)
    with Rig() as rig:
        rig.patience = 300.0
        rig.listen("/diagnostics", "contacts")
        rig.until(compiling.is_set, "thread")
        rig.cycles(5)
        assert "contacts" not in rig.last
        assert rig.status(": cycle")["effect contacts"] == "auto, being made ready"
        done.set()
        rig.until(lambda: "contacts" in rig.last, "contacts")

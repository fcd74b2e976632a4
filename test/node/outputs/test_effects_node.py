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

"""Pay for what you use: what nobody calls for costs no call of a kernel, no row and no message."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any
from unittest.mock import Mock

import pytest
from each import each
from rig import Patch, Rig, cube, pose, spy

from obb_collision.node import collisions_from_ros, contacts_from_ros
from obb_collision.node.inputs import clouds as obstacles
from obb_collision.node.messages.box_markers import Markers
from obb_collision.node.outputs import Events, outputs
from obb_collision.node.status import reporting
from obb_collision.node.topics.cloud import Cloud
from obb_collision.node.topics.topics import TOPICS, mode_names
from obb_collision.scene.effects import EFFECTS, clearance, contacts, points, separations, sweep

KERNELS = {
    "separations": (separations, "pair_separations"),
    "contacts": (contacts, "pair_contacts"),
    "clearance": (clearance, "near_pairs"),
    "sweep": (sweep, "box_sweeps"),
    "points": (points, "points_in_bodies"),
}
"""What an effect of the scene calls to compute."""
BUILDERS = {
    "text": (outputs, "text_from_rows"),
    "markers": (Markers, "write"),
    "events": (Events, "rows"),
    "cloud": (obstacles, "points_from_ros"),
}
"""What makes a message that is no cloud or is not due at every cycle, or takes in the points."""
UNHEARD = ("in_collision", "collision_status", "diagnostics")
"""Topics that say something also where nobody subscribes, or have no rows."""
RUNNING = tuple(name for name in TOPICS if name not in UNHEARD)
NAMES = {name: topic.name.replace("~", "obb_collision") for name, topic in TOPICS.items()}


@pytest.fixture
def calls(monkeypatch: Patch) -> Counter[str]:
    """Count what is called: ``run`` of effects, their kernels, builders of rows."""
    counted: Counter[str] = Counter()

    def counting(original: Any, key: str) -> Any:
        def call(*args: Any, **options: Any) -> Any:
            counted[key] += 1
            return original(*args, **options)

        return call

    def count(owner: Any, name: str, key: str) -> None:
        monkeypatch.setattr(owner, name, counting(getattr(owner, name), key))

    for effect in EFFECTS.values():
        count(type(effect), "run", f"run {effect.name}")
    for effect_name, (module, name) in KERNELS.items():
        count(module, name, f"kernel {effect_name}")
    for topic_name, (owner, name) in BUILDERS.items():
        count(owner, name, f"build {topic_name}")
    for topic_name, topic in TOPICS.items():
        if isinstance(topic, Cloud):
            make = counting(topic.make_rows, f"build {topic_name}")
            monkeypatch.setitem(vars(topic), "make_rows", make)
    return counted


class Scene:
    """A scene in which every effect has something to do, at every step."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        rig.send(cube(("a", 1)), cube(("a", 2), (0.5, 0, 0)), cube(("b", 1), (2.1, 0, 0)))
        self.number = 0

    def step(self, count: int = 1) -> None:
        """Move something, and wait until the node has checked."""
        for _ in range(count):
            self.number += 1
            shift = 0.01 * (self.number % 2)
            poses, twists = [pose(0.5 + shift), pose(2.1 + 100.0 * shift)], [[0.5] * 6] * 2
            self.rig.send_states(["a/2", "b/1"], poses, twists=twists)
            self.rig.send_points([[0.25, 0.0, 0.0], [9.0, 9.0, 9.0]])
            self.rig.until(self.is_taken, "state")
            self.rig.cycles(2)

    def is_taken(self) -> bool:
        """Whether the scene has the last state, sent before the last cloud."""
        return self.rig.node.objects.newest_stamp(self.rig.now()) == self.rig.stamp - 1_000_000


def of(calls: Counter[str], effect: str) -> int:
    """Return how often anything of an effect was called."""
    return sum(calls[f"{kind} {effect}"] for kind in ("run", "kernel", "build"))


def settled(scene: Scene, calls: Counter[str]) -> Counter[str]:
    """Return what some more steps call."""
    scene.step()
    calls.clear()
    scene.step(3)
    return calls


@pytest.fixture
def scene(calls: Counter[str]) -> Iterator[Scene]:
    """Yield a scene whose node nobody listens to."""
    with Rig(deaf=True, marker_rate=100.0, rate=200.0) as rig:
        made = Scene(rig)
        assert settled(made, calls) == Counter(), "what nobody subscribes to costs no call"
        assert len(rig.node.cycle.report or ()) == 1, "but what collides is known"
        assert rig.node.cycle.report is not None
        assert rig.node.cycle.report.costs == {}
        yield made


@each("effect", RUNNING)
def test_subscribers_start_and_end_effects(scene: Scene, calls: Counter[str], effect: str) -> None:
    rig, topic = scene.rig, NAMES[effect]
    rig.next(topic)
    settled(scene, calls)
    assert of(calls, effect) > 0
    described = effect in ("collisions", "text", "events")
    others = {name for name in (*TOPICS, "separations") if of(calls, name)} - {effect}
    assert others == ({"separations", "collisions"} - {effect} if described else set())
    assert bool(calls["build cloud"]) == (effect == "points")
    rig.ignore(topic)
    rig.until(lambda: not rig.node.effects.is_requested(effect), "unsubscribed")
    assert settled(scene, calls) == Counter()


@each("effect", [*EFFECTS, "collisions", "text", "markers"])
def test_modes_change_at_run_time(scene: Scene, calls: Counter[str], effect: str) -> None:
    rig = scene.rig

    def mode(word: str) -> bool:
        (result,) = rig.set(**{f"effects.{effect}": word})
        return bool(result.successful)

    needs_rows = ("text", "events") if effect == "collisions" else ()
    topics = [topic for name, topic in NAMES.items() if name not in needs_rows]
    assert mode("off")
    rig.listen(*topics)
    settled(scene, calls)
    assert of(calls, effect) == 0, "off, though somebody subscribes"
    rig.ignore(*topics)
    rig.until(lambda: not rig.node.effects.of_cycle(), "unsubscribed")
    assert settled(scene, calls) == Counter()
    assert mode("on")
    settled(scene, calls)
    assert of(calls, effect) > 0, "on, though nobody subscribes"
    assert mode("auto")
    assert settled(scene, calls) == Counter()


def test_the_latched_flag_is_sent_when_it_changes_or_is_subscribed(monkeypatch: Patch) -> None:
    with Rig(deaf=True) as rig:
        rig.cycles(1)
        publish = spy(monkeypatch, rig.node.outputs.publishers["in_collision"], "publish")

        def sent() -> list[bool]:
            return [call.args[0].data for call in publish.call_args_list]

        rig.send(cube(("a", 1)), cube(("a", 2), (9, 0, 0)))
        rig.until(lambda: sent()[-1:] == [False], "flag")
        rig.send_transform("a/2", pose(0.5))
        rig.until(lambda: sent()[-1:] == [True], "flag")
        rig.cycles(3)
        assert sent() == [False, True], "sent where it changes"
        assert rig.next("in_collision").data is True
        rig.until(lambda: len(sent()) > 3, "every cycle")
        rig.set(**{"effects.in_collision": "off"})
        publish.reset_mock()
        rig.send_transform("a/2", pose(9.0))
        rig.cycles(3)
        publish.assert_not_called()


def test_diagnostics_say_what_is_computed_and_what_it_took() -> None:
    with Rig(given={"effects.contacts": "on", "effects.points": "off"}) as rig:
        scene = Scene(rig)
        times = {"effect contacts mean (ms)", "effect contacts max (ms)"}
        for _ in range(20):  # what it took since the last message, in which nothing may have moved
            scene.step(3)
            status = rig.status(": cycle")
            if times <= set(status):
                break
        assert status["effect contacts"] == "on, computed"
        assert status["effect contacts ran on"] == "1"
        assert times <= set(status)
        assert status["effect points"] == "off"
        assert status["effect clearance"] == "auto, not requested"
        assert status["effect separations"] == "auto, computed"
        assert {f"effect {name}" for name in mode_names()} <= set(status)


def test_diagnostics_off_or_unheard_are_not_built(monkeypatch: Patch) -> None:
    built = spy(monkeypatch, reporting, "make_status")
    with Rig(deaf=True) as rig:
        publish = rig.node.reporting.publish
        publish()
        built.assert_not_called()
        rig.next("/diagnostics")
        built.assert_called()
        rig.set(**{"effects.diagnostics": False})  # what YAML makes of an unquoted off
        built.reset_mock()
        publish()
        built.assert_not_called()


def test_an_effect_that_fails_is_reported_and_the_cycle_goes_on(monkeypatch: Patch) -> None:
    with Rig() as rig:
        scene = Scene(rig)
        rig.next("contacts")
        broken = Mock(side_effect=FloatingPointError("no patch today"))
        monkeypatch.setattr(contacts, "pair_contacts", broken)

        def failed() -> dict[str, str] | None:  # cycles may be late, too, which is said instead
            scene.step()
            status = rig.status(": cycle")
            return status if "effects failed" in status["message"] else None

        status = rig.until(failed, "warning")
        assert status["level"] == "01"
        assert "no patch today" in status["effect contacts last failure"]
        assert int(status["effect contacts failures"]) >= 1
        rig.send_transform("a/2", pose(0.75))
        assert collisions_from_ros(rig.answer())["depth"].tolist() == [pytest.approx(0.25)]


def test_only_objects_that_call_for_an_effect_get_it() -> None:
    with Rig(given={"effects.contacts_objects": ["a/2"]}) as rig:
        rig.send(*(cube(("a", k), (0.5 * k, 0, 0)) for k in range(4))).answer()
        rig.until(lambda: rig.next("contacts").width > 0, "contacts")
        rows = contacts_from_ros(rig.next("contacts"))
        ids = set(zip(rows["id_a"].tolist(), rows["id_b"].tolist(), strict=True))
        assert ids == {(0, 2), (1, 2), (2, 3)}
        rig.set(**{"effects.contacts_objects": ["b/*"]})
        rig.until(lambda: rig.next("contacts").width == 0, "nobody calls")

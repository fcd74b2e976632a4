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

"""A node is active only with all kernels that its parameters allow; later ones are refused."""

from __future__ import annotations

import json
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from each import each
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from node_process import cached, environment, running
from processes import PATIENCE, output_until, run_python
from rclpy.executors import ExternalShutdownException
from rclpy.parameter import Parameter
from rig import OUTPUTS, STATUS, Patch, Rig, client_apart, cube, own_context, pose

from obb_collision import _kernel_cache
from obb_collision.node.diagnostics.answer import UNKNOWN
from obb_collision.node.node import CollisionNode
from obb_collision.node.parameters import ready
from obb_collision.scene.effects import EFFECTS
from obb_collision.warm_up import processes, steps
from obb_collision.warm_up.steps import BOUNDS, BOXES, MESSAGES, STEPS

ON_BOXES = {BOXES, BOUNDS, MESSAGES, *map(steps.effect_step, EFFECTS)}
"""What the node's defaults allow."""


class Cache:
    """A cache that has some steps; the rest can be compiled, unless it fails.

    meanwhile: called while they are compiled.
    """

    def __init__(self) -> None:
        self.kept: set[str] = set()
        self.compiled: list[str] = []
        self.here: list[str] = []
        self.failures: dict[str, str] = {}
        self.private: list[Path | None] = []
        self.meanwhile: Callable[[], None] = lambda: None

    def clear(self) -> None:
        for kept in (self.kept, self.compiled, self.here):
            kept.clear()

    def run(self, step: str) -> None:
        if step in self.kept:
            return
        if _kernel_cache.only_loads():
            raise _kernel_cache.KernelMissingError(step)
        self.here.append(step)

    def compile_steps(self, wanted: list[str], **options: Any) -> processes.CompileProgress:
        progress = processes.CompileProgress(tuple(wanted), running=wanted[:1])
        options["look"](progress)
        self.meanwhile()
        if options["stopped"]():
            progress.stopped = True
            return progress
        progress.done += [step for step in wanted if step not in self.failures]
        progress.failed = {step: why for step, why in self.failures.items() if step in wanted}
        self.compiled += wanted
        self.private.append(options["private"])
        self.kept |= set(wanted) - progress.failed.keys()
        options["look"](progress)
        return progress


@pytest.fixture
def cache(monkeypatch: Patch) -> Cache:
    made = Cache()
    monkeypatch.setattr(steps, "run", made.run)
    monkeypatch.setattr(ready, "compile_steps", made.compile_steps)
    return made


def steps_of(**parameters: Any) -> set[str]:
    """Return what a node with parameters has ready."""
    given = [Parameter(name.replace("__", "."), value=value) for name, value in parameters.items()]
    with own_context() as context:
        node = CollisionNode(context=context, parameter_overrides=given)
        try:
            return set(node.kernels._loaded)
        finally:
            node.destroy_node()


def on(level: str, *names: str) -> set[str]:
    """Return the steps of effects on a level."""
    return {f"{name} at {level}" for name in names}


HULLS = on("hull", "clearance", "contacts", "points", "separations", "sweep")
MESHES = on("mesh", "clearance", "contacts", "points", "separations", "sweep")


@each(
    "parameters, more, less",
    [
        ({}, set(), set()),
        ({"effects__contacts": "off"}, set(), {"effect contacts"}),
        ({"effects__separations": "off"}, set(), set()),
        ({"accuracy": "sphere"}, {"accuracy below obb"}, set()),
        ({"accuracy": "hull"}, {"accuracy hull"} | HULLS, set()),
        ({"accuracy_overrides": ["a/*: mesh"]}, {"accuracy mesh"} | HULLS | MESHES, set()),
        ({"accuracy": "mesh", "time_budget": 0.01}, {"accuracy mesh"} | HULLS | MESHES, set()),
        ({"accuracy": "hull", "effects__points_accuracy": "obb"}, {"accuracy hull"}, set()),
        ({"effects__clearance_accuracy": "hull"}, on("hull", "clearance"), set()),
        ({"robots": ["arm"]}, {"robots", "accuracy hull"} | HULLS, set()),
    ],
)
def test_configured_it_has_all_that_its_parameters_allow(
    cache: Cache, parameters: dict[str, Any], more: set[str], less: set[str]
) -> None:
    cache.clear()
    found = steps_of(**parameters)
    assert found == cache.kept
    parts = {part for some in steps.PARTS.values() for part in some}
    expected = (ON_BOXES | more) - less
    if "effects__points_accuracy" in parameters:
        expected |= HULLS - on("hull", "points")
    assert found - parts == expected - parts


def test_what_is_cached_is_loaded_silently(cache: Cache, capfd: pytest.CaptureFixture[str]) -> None:
    cache.kept = set(STEPS)
    assert steps_of() == ON_BOXES, "nothing more, which costs memory and time"
    assert cache.compiled == []
    assert "compiling" not in capfd.readouterr().err


def test_until_all_is_compiled_it_is_not_active_and_says_how_far_it_is(
    cache: Cache, rig: Rig, monkeypatch: Patch
) -> None:
    monkeypatch.setattr(ready, "FIRST_WORD", 0.0)
    said: dict[str, Any] = {}
    for topic in (STATUS, "/diagnostics"):
        name = topic if topic.startswith("/") else f"/cell/{topic}"

        def take(message: Any, topic: str = topic) -> None:
            if message.status[0].name.startswith("cell/"):
                said[topic] = message.status[0]

        rig.client.create_subscription(OUTPUTS[topic].message, name, take, 10)

    def meanwhile() -> None:
        rig.until(lambda: len(said) == 2, "status and diagnostics")
        assert said[STATUS].level == UNKNOWN
        for status in said.values():
            assert "compiling: 0 kernels and 0 of" in status.message
        assert "boxes" in said["/diagnostics"].message
        assert not rig.client.count_subscribers("/cell/objects")

    def listened() -> None:
        publishers = made[0].outputs.publishers
        rig.until(lambda: publishers["diagnostics"].get_subscription_count(), "match")

    made: list[Any] = []
    outputs = CollisionNode._make_outputs

    def noted(node: CollisionNode) -> None:
        outputs(node)
        made.append(node)
        listened()

    monkeypatch.setattr(CollisionNode, "_make_outputs", noted)
    cache.meanwhile = meanwhile
    other = CollisionNode(context=rig.context, namespace="cell")
    try:
        assert set(cache.compiled) == ON_BOXES
        assert other.cycle.active
        rig.executor.add_node(other)
        contacts = OUTPUTS["contacts"].message
        rig.client.create_subscription(contacts, "/cell/contacts", lambda _: None, 10)
        rig.until(lambda: "contacts" in other.effects.of_cycle(), "an effect that is subscribed to")
        rig.until(lambda: other.cycle.report is not None, "a check")
        assert set(cache.compiled) == ON_BOXES, "nothing more"
    finally:
        rig.executor.remove_node(other)
        other.destroy_node()


@each(
    "start, later, missing",
    [
        ({}, {"accuracy": "mesh"}, "accuracy mesh"),
        ({}, {"accuracy": "aabb"}, "accuracy below obb"),
        ({}, {"accuracy_overrides": ["a/*: hull"]}, "accuracy hull"),
        ({}, {"effects.clearance_accuracy": "hull"}, "clearance at hull"),
        ({"effects.contacts": "off"}, {"effects.contacts": "auto"}, "effect contacts"),
    ],
)
def test_a_later_parameter_is_refused_without_its_kernels_and_taken_with_them(
    cache: Cache, start: dict[str, Any], later: dict[str, Any], missing: str
) -> None:
    cache.clear()
    with Rig(given=start) as rig:
        (name,) = later
        before = rig.node.get_parameter(name).value
        (result,) = rig.set(**later)
        assert not result.successful
        assert missing in result.reason
        assert "obb_collision warm-up" in result.reason
        assert rig.node.get_parameter(name).value == before
        rig.send(cube(("a", 1)), cube(("a", 2), (0.5, 0.0, 0.0)))
        assert rig.pairs() == {("a/1", "a/2")}
        cache.kept = set(STEPS)  # as after ``obb_collision warm-up``
        (result,) = rig.set(**later)
        assert result.successful
        assert rig.node.get_parameter(name).value == later[name]
        rig.send_transform("a/2", pose(0.6))
        assert rig.pairs() == {("a/1", "a/2")}
        assert set(cache.compiled) <= ON_BOXES
        assert rig.node.guard.total == 0


def test_cleaned_up_any_parameter_is_taken_and_compiled_when_it_is_configured(
    cache: Cache,
) -> None:
    with Rig(deaf=True, autostart=False) as rig:
        assert cache.compiled == [], "unconfigured"
        rig.go_through(Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP)
        assert all(result.successful for result in rig.set(accuracy="hull"))
        assert "accuracy hull" not in cache.kept
        rig.go_through(Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)
        assert "accuracy hull" in cache.kept


@each("failing", [("boxes",), tuple(STEPS)])
def test_what_others_cannot_compile_this_process_does(
    cache: Cache, failing: tuple[str, ...], capfd: pytest.CaptureFixture[str]
) -> None:
    cache.clear()
    cache.failures = dict.fromkeys(failing, "no folder takes kernels")
    assert steps_of() == ON_BOXES
    assert set(cache.here) == ON_BOXES & set(failing)
    assert "no folder takes kernels" in capfd.readouterr().err


def test_a_private_folder_is_made_only_where_the_cache_does_not_take_kernels(
    cache: Cache, monkeypatch: Patch, tmp_path: Path
) -> None:
    private = tmp_path / "private"
    monkeypatch.setattr(_kernel_cache, "private_place", lambda: private)
    (tmp_path / "file").write_text("")
    for place, expected in (("cache", None), ("file/cache", private)):
        monkeypatch.setattr(_kernel_cache, "places", [tmp_path / place])
        cache.clear()
        steps_of()
        assert cache.private.pop() == expected


def test_a_start_that_is_given_up_compiles_nothing_more(cache: Cache) -> None:
    stopped: list[bool] = []
    cache.meanwhile = lambda: stopped.append(True)
    with own_context() as context, pytest.raises(ExternalShutdownException):
        CollisionNode(context=context, ending=lambda: bool(stopped))
    assert cache.compiled == cache.here == []


EVERYTHING = Path(__file__).parents[1] / "everything.py"


def test_no_cycle_loads_a_kernel(tmp_path: Path) -> None:
    """Whatever can be asked for is loaded before, or when a parameter is set."""
    pytest.importorskip("lxml")
    pytest.importorskip("trajectory_msgs")
    done = run_python(str(EVERYTHING), str(tmp_path), **environment())
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert lines == [{"new": []}, *[{"new": [], "compiled": []}] * 2]


@pytest.mark.slow  # test_kernel_cache damages single files, in many ways
def test_a_damaged_cache_is_said_and_built_anew(tmp_path: Path) -> None:
    for source in _kernel_cache.places[0].iterdir():
        if source.is_dir():
            shutil.copytree(source, tmp_path / "obb_collision" / source.name)
    for file in tmp_path.rglob("*.kernel"):
        file.write_bytes(file.read_bytes()[:-1])
    with running(**cached(tmp_path)) as process:
        output = output_until(process, "ready:")
        assert f"kernels in {tmp_path / 'obb_collision'} are damaged" in output
        assert "compiling kernels for boxes" in output
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
    with running(**cached(tmp_path)) as process:
        assert "compiling" not in output_until(process, "ready:")


@pytest.mark.slow
def test_where_the_cache_takes_nothing_a_temporary_folder_does(tmp_path: Path) -> None:
    file, temporary = tmp_path / "file", tmp_path / "temporary"
    file.write_text("no folder")
    temporary.mkdir()
    with running(TMPDIR=str(temporary), **cached(file)) as process:
        output = output_until(process, "ready:")
        assert f"kernels can't be kept in {file / 'obb_collision'}" in output
        assert list(temporary.glob("obb_collision-kernels-*/*/*.kernel"))
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
    assert not list(temporary.glob("obb_collision-kernels-*"))


@each("autostart", [True, False])
def test_configuring_says_how_far_it_is_and_can_be_interrupted(
    tmp_path: Path, autostart: bool
) -> None:
    arguments = ("--ros-args", "-p", f"autostart:={str(autostart).lower()}")
    with client_apart() as client, running(*arguments, **cached(tmp_path)) as process:
        if not autostart:
            service = client.client.create_client(ChangeState, "/obb_collision/change_state")
            client.until(service.service_is_ready, "a node")
            change = Transition(id=Transition.TRANSITION_CONFIGURE)
            service.call_async(ChangeState.Request(transition=change))
        first = output_until(process, "compiling kernels for")
        assert str(tmp_path / "obb_collision") in first
        assert "kernels and" in output_until(process, "steps done")
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, output
        assert "Traceback" not in output
        assert "ready:" not in output

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

"""Kernels made ready at the start and beside the cycles; nothing is compiled after "ready"."""

from __future__ import annotations

import json
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event, Thread
from time import monotonic
from typing import Any
from unittest.mock import Mock

import pytest
from node_process import cached, environment, running
from objects_rig import RING, crate, levels, ring
from processes import PATIENCE, output_until, run_python
from rig import Patch, Rig, cube, sync
from visualization_msgs.msg import Marker

from obb_collision import Accuracy, _kernel_cache
from obb_collision.node.runtime import warm_up
from obb_collision.warm_up import processes, steps
from obb_collision.warm_up.steps import BOXES, MESSAGES, NODE_STEPS, STEPS


class Cache:
    """A cache that has what every cycle needs; the rest can be compiled, unless it fails."""

    def __init__(self) -> None:
        self.kept = {BOXES, MESSAGES, "effect separations"}
        self.compiled: list[str] = []
        self.here: list[str] = []
        self.failures: dict[str, str] = {}
        self.unsaved: list[str] = []
        self.private: list[Path | None] = []
        self.may_go_on = Event()
        self.may_go_on.set()
        self.asked = Event()

    def run(self, step: str) -> None:
        if step in self.kept:
            return
        if _kernel_cache.only_loads():
            raise _kernel_cache.KernelMissingError(step)
        self.here.append(step)

    def compile_steps(self, wanted: list[str], **options: Any) -> processes.CompileProgress:
        self.asked.set()
        progress, limit = processes.CompileProgress(tuple(wanted)), monotonic() + PATIENCE
        while not self.may_go_on.wait(0.01):
            assert monotonic() < limit, "may not go on"
            options["look"](progress)
        progress.done += [step for step in wanted if step not in self.failures]
        self.compiled += wanted
        progress.failed = {step: why for step, why in self.failures.items() if step in wanted}
        progress.unsaved = self.unsaved
        self.private.append(options["private"])
        self.kept |= set(wanted) - progress.failed.keys()
        options["look"](progress)
        return progress


class Log:
    """Lines said and complained about, of a WarmUp that is closed at the end."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.complained: list[str] = []
        self.warm = warm_up.WarmUp(self.said.append, self.complained.append)


def wait_for(reached: Callable[[], bool]) -> None:
    done, limit = Event(), monotonic() + PATIENCE
    while not reached():
        assert monotonic() < limit, "not reached"
        done.wait(0.01)


@pytest.fixture
def log() -> Iterator[Log]:
    made = Log()
    yield made
    made.warm.close()


@pytest.fixture
def cache(monkeypatch: Patch) -> Cache:
    made = Cache()
    monkeypatch.setattr(steps, "run", made.run)
    monkeypatch.setattr(warm_up, "compile_steps", made.compile_steps)
    return made


def test_what_is_compiled_already_is_loaded_when_asked_for_silently(cache: Cache, log: Log) -> None:
    cache.kept = set(NODE_STEPS)
    log.warm.start([Accuracy.HULL])
    assert log.warm.is_ready(Accuracy.HULL)
    assert not log.warm.has("sweep"), "it takes memory and time"
    wait_for(lambda: all(log.warm.is_ready(thing) for thing in (*Accuracy, "sweep")))
    assert (cache.compiled, log.said, log.complained) == ([], [], [])


def test_what_is_compiled_already_waits_for_nothing_else(late_cache: Cache, log: Log) -> None:
    late_cache.kept.add("effect sweep")
    log.warm.start([])
    assert not log.warm.is_ready("points")
    assert late_cache.asked.wait(PATIENCE)
    wait_for(lambda: log.warm.is_ready("sweep"))
    assert not log.warm.is_ready("points")
    late_cache.may_go_on.set()
    wait_for(lambda: log.warm.is_ready("points"))


def test_what_is_asked_for_later_is_compiled_once_beside_the_cycles(cache: Cache, log: Log) -> None:
    log.warm.start([])
    for thing in ("sweep", Accuracy.HULL, "sweep"):
        wait_for(lambda thing=thing: log.warm.is_ready(thing))  # type: ignore[misc]
    assert cache.compiled == ["effect sweep", "accuracy hull"]
    assert cache.here == []
    assert log.complained == []


def test_what_cannot_be_compiled_is_tried_again(cache: Cache, log: Log, monkeypatch: Patch) -> None:
    cache.failures["effect sweep"] = "no folder takes kernels"
    log.warm.start([])
    assert not log.warm.is_ready("sweep")
    wait_for(lambda: bool(log.complained))
    assert "no folder takes kernels" in log.complained[0]
    assert "no folder takes kernels" in log.warm.why_not("sweep")
    assert len(log.said) == 1, "nothing was compiled, so that no number of kernels is logged"
    assert "effects stay off or on boxes, and pairs on 'obb' meanwhile" in log.said[0]
    assert not log.warm.is_ready("sweep")
    assert cache.compiled == ["effect sweep"]
    assert cache.here == []
    cache.failures.clear()
    monkeypatch.setattr(warm_up, "perf_counter", lambda: float("inf"))  # much later
    wait_for(lambda: log.warm.is_ready("sweep"))
    assert cache.compiled == ["effect sweep", "effect sweep"]


def test_what_does_not_start_is_tried_again(cache: Cache, log: Log, monkeypatch: Patch) -> None:
    log.warm.start([])
    fails = Mock(side_effect=RuntimeError("can't start new thread"))
    for number, (what, name) in enumerate(((Thread, "start"), (warm_up, "compile_steps")), 1):
        with monkeypatch.context() as patch:
            patch.setattr(what, name, fails)
            assert not log.warm.is_ready("sweep")
            wait_for(lambda number=number: len(log.complained) == number)  # type: ignore[misc]
            assert "can't start new thread" in log.complained[-1]
            assert "can't start new thread" in log.warm.why_not("sweep")
        monkeypatch.setattr(warm_up, "RETRY", 0.0)
        monkeypatch.setattr(warm_up, "perf_counter", lambda: float("inf"))  # much later
    wait_for(lambda: log.warm.is_ready("sweep"))


def test_where_nothing_can_be_kept_all_is_compiled_before_the_start(cache: Cache, log: Log) -> None:
    cache.kept = set()
    cache.failures = dict.fromkeys(STEPS, "no folder takes kernels")
    log.warm.start([])
    assert cache.here == list(NODE_STEPS)
    assert "no folder takes kernels" in log.complained[0]
    assert all(log.warm.is_ready(thing) for thing in (*Accuracy, "sweep", "points"))


def test_a_private_folder_is_made_only_where_the_cache_does_not_take_kernels(
    cache: Cache, log: Log, monkeypatch: Patch, tmp_path: Path
) -> None:
    monkeypatch.setattr(_kernel_cache, "private_place", lambda: tmp_path / "private")
    monkeypatch.setattr(_kernel_cache, "places", [tmp_path / "cache"])
    cache.kept, cache.unsaved = set(), ["a kernel"]
    log.warm.start([])
    cache.unsaved = []
    for thing in ("sweep", "points"):
        wait_for(lambda thing=thing: log.warm.is_ready(thing))  # type: ignore[misc]
    assert cache.private == [None, tmp_path / "private", tmp_path / "private"]
    cache.private.clear()
    (tmp_path / "file").write_text("")
    for place, private in (("cache", None), ("file/cache", tmp_path / "private")):
        monkeypatch.setattr(_kernel_cache, "places", [tmp_path / place])
        cache.kept.clear()
        other = Log()
        other.warm.start([])
        other.warm.close()
        assert cache.private.pop() == private


def test_a_start_that_is_given_up_compiles_nothing_more(cache: Cache, monkeypatch: Patch) -> None:
    def stopped(wanted: list[str], **options: Any) -> processes.CompileProgress:
        assert options["stopped"]()
        return processes.CompileProgress(tuple(wanted), stopped=True)

    monkeypatch.setattr(warm_up, "compile_steps", stopped)
    cache.kept = set()
    warm = warm_up.WarmUp(print, print, lambda: True)
    warm.start([])
    assert cache.here == []
    warm.close()


def test_closing_waits_until_none_is_compiled(cache: Cache, log: Log, monkeypatch: Patch) -> None:
    begun, ended = Event(), Event()

    def compile_until_stopped(wanted: list[str], **options: Any) -> processes.CompileProgress:
        begun.set()
        wait_for(options["stopped"])
        ended.set()  # here the processes are ended
        return processes.CompileProgress(tuple(wanted), stopped=True)

    monkeypatch.setattr(warm_up, "compile_steps", compile_until_stopped)
    monkeypatch.setattr(warm_up, "ENDING", 3600.0)
    log.warm.start([])
    assert not log.warm.is_ready("sweep")
    assert begun.wait(PATIENCE)
    log.warm.close()
    assert ended.is_set()


@pytest.fixture
def late_cache(cache: Cache) -> Cache:
    """Return a cache that lets nothing be compiled yet."""
    cache.may_go_on.clear()
    return cache


def test_cycles_go_on_with_obb_and_no_effect_until_these_are_ready(late_cache: Cache) -> None:
    with Rig() as rig:
        rig.send(ring(), crate())
        rig.built(RING)
        assert sync(rig) == {("mesh/1", "box/1")}
        rig.set(accuracy="mesh")
        rig.listen("/diagnostics", "contacts")
        rig.until(late_cache.asked.is_set, "thread")
        rig.cycles(5)
        assert levels(rig) == ["obb"]
        assert "contacts" not in rig.last
        assert rig.status(": cycle")["effect contacts"] == "auto, kernels being compiled"
        late_cache.may_go_on.set()
        rig.until(lambda: levels(rig) == [], "mesh")
        rig.until(lambda: "contacts" in rig.last, "contacts")


def test_a_level_below_obb_that_is_not_ready_takes_nothing_from_others(late_cache: Cache) -> None:
    late_cache.kept.add("accuracy mesh")
    with Rig(accuracy="mesh") as rig:
        rig.send(ring(), crate())  # in the hole of the ring
        rig.built(RING)
        rig.send(cube(("near", 1), (20.0, 0.0, 0.0)), cube(("near", 2), (21.2, 0.0, 0.0)))
        rig.until(lambda: levels(rig) == [], "mesh")
        rig.set(accuracy_overrides=["near/*: sphere"])
        rig.until(late_cache.asked.is_set, "thread")
        rig.cycles(5)
        assert rig.pairs() == set()
        late_cache.may_go_on.set()
        rig.until(lambda: rig.pairs() == {("near/1", "near/2")}, "spheres")


def test_an_effect_is_on_boxes_until_the_level_of_its_pairs_is_ready(late_cache: Cache) -> None:
    late_cache.kept |= {"accuracy hull", "effect contacts"}
    with Rig(accuracy="hull") as rig:
        ball = {"type": Marker.SPHERE}
        rig.send(cube(("a", 1), **ball), cube(("b", 1), (0.6, 0.6, 0.0), **ball))
        rig.listen("/diagnostics", "contacts")
        rig.until(late_cache.asked.is_set, "thread")
        rig.cycles(5)

        def depths() -> list[float]:
            report = rig.node.cycle.report
            assert report is not None
            return report.contacts.depths.tolist()

        assert depths() == pytest.approx([0.4])
        wanted = "auto, computed on obb: kernels being compiled"
        rig.until(lambda: rig.status(": cycle")["effect contacts"] == wanted, "its state")
        late_cache.may_go_on.set()
        rig.until(lambda: depths() == pytest.approx([1.0 - 0.6 * 2**0.5]), "shapes")
        wanted = "auto, computed"
        rig.until(lambda: rig.status(": cycle")["effect contacts"] == wanted, "its state")
        assert late_cache.compiled.count("contacts at hull") == 1


def test_a_start_compiles_effects_that_are_on_for_the_level_of_the_pairs(cache: Cache) -> None:
    parameters: dict[str, Any] = {"effects.clearance": "on"}
    with Rig(accuracy="mesh", **parameters):
        assert {"effect clearance", "clearance at hull", "clearance at mesh"} <= set(cache.compiled)
        assert "contacts at hull" not in cache.compiled


def test_an_effect_that_cannot_be_compiled_says_why_in_the_diagnostics(late_cache: Cache) -> None:
    late_cache.failures["effect contacts"] = "the disk is full"
    late_cache.may_go_on.set()
    with Rig() as rig:
        rig.listen("/diagnostics", "contacts")
        rig.until(lambda: "full" in rig.status(": cycle")["effect contacts"], "the reason")
        assert "contacts" not in rig.last


EVERYTHING = Path(__file__).with_name("everything.py")
LONGEST_SHARE = 0.2
"""Of the time that others compile: a cycle that waits for them takes about all of it."""


def ask_everything(folder: Path, *stages: str, **more: str) -> list[dict[str, Any]]:
    """Run the script that asks for everything; returns what it found of a robot and of a node."""
    done = run_python(str(EVERYTHING), str(folder), *stages, **environment(**more))
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def test_no_cycle_loads_a_kernel(tmp_path: Path) -> None:
    """Whatever is asked for is loaded before the node is ready, or beside its cycles."""
    pytest.importorskip("lxml")
    pytest.importorskip("trajectory_msgs")
    of_robot, found = ask_everything(tmp_path)
    assert of_robot["new"] == found["new"] == found["compiled"] == []
    assert found["threads"] == ["warm-up"], "none would show nothing, and others run cycles"


@pytest.mark.slow  # test_warm_up.py holds up what compiles, and cycles go on
def test_cycles_go_on_while_an_effect_is_compiled(tmp_path: Path) -> None:
    stages = "4"  # one object, more of them, contacts, and all of them moved
    (found,) = ask_everything(tmp_path, stages, **cached(tmp_path))
    assert found["new"] == found["compiled"] == []
    (numbers,) = (numbers for stage, numbers in found["stages"] if stage == "effect contacts")
    assert numbers["seconds"] > 2.0, "it takes so long to compile"
    assert numbers["longest"] < LONGEST_SHARE * numbers["seconds"]


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


def test_a_start_that_compiles_says_how_far_it_is_and_can_be_interrupted(tmp_path: Path) -> None:
    with running(**cached(tmp_path)) as process:
        first = output_until(process, "compiling kernels for")
        assert str(tmp_path / "obb_collision") in first
        assert "kernels and" in output_until(process, "steps done")
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, output
        assert "Traceback" not in output
        assert "ready:" not in output

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

"""Kernels are ready when the node is configured; a later parameter needs those that it has.

numba compiles under one lock, for which cycles would wait, so that other processes compile into the
cache (see ``warm_up``), and this one loads: 0.1 s for a question. That is all of what parameters
allow: effects that are not off, with or without subscribers, and the levels they may be on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import perf_counter

from rclpy.executors import ExternalShutdownException

from obb_collision import _kernel_cache
from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.runtime.running import Garbage
from obb_collision.scene.effects import EFFECTS, LEVELS
from obb_collision.scene.effects.base import ACCURACY
from obb_collision.scene.effects.settings import OFF
from obb_collision.scene.refinement.placed_shapes import AS_PAIRS
from obb_collision.warm_up import steps
from obb_collision.warm_up.processes import CompileProgress, NoteHandler, compile_steps
from obb_collision.words import command_line

FIRST_WORD, NEXT_WORD = 2.0, 4.0
"""Seconds until the first line about the progress, and between two lines."""
WARM_UP = command_line("obb_collision warm-up")


def allowed_steps(parameters: Parameters) -> list[str]:
    """Return the steps that compile all that parameters allow."""
    pairs = {level for _, level in parameters.accuracy_overrides}
    pairs.add(as_accuracy(parameters.accuracy))
    wanted = {steps.BOXES, steps.MESSAGES, steps.effect_step("separations")}  # of every cycle
    wanted.update(map(steps.accuracy_step, pairs))
    if parameters.robots:
        wanted.add(steps.ROBOTS)
    if parameters.gate is not None:
        wanted.add(steps.ZONES)
    if parameters.source_settings:
        wanted.update((steps.SOURCES, steps.CLOUDS))
        if max(pairs) == Accuracy.MESH:
            wanted.add(steps.CLOUDS_AT_MESH)
    if any(source.shadows for source in parameters.source_settings):
        wanted.add(steps.BODY_QUERIES)
    if any(source.leave_out for source in parameters.source_settings):
        wanted.add(steps.effect_step("points"))
        if max(pairs) > Accuracy.OBB:
            wanted.add(steps.effect_level_step("points", Accuracy.HULL))
    for name in EFFECTS:
        if parameters.mode(name) != OFF:
            choice = parameters.setting(name).get(ACCURACY, Accuracy.OBB.label)
            highest = max(pairs) if choice == AS_PAIRS else as_accuracy(choice)
            levels = [level for level in LEVELS[name] if level <= highest]
            wanted.add(steps.effect_step(name))
            wanted.update(steps.effect_level_step(name, level) for level in levels)
    return steps.with_parts(wanted)


class Kernels:
    """Loads kernels, and compiles the kernels that the cache lacks.

    info, warning: log a line; report: takes how far compiling is; stopped: whether to give it up.
    """

    def __init__(
        self,
        info: Callable[[str], None],
        warning: Callable[[str], None],
        report: Callable[[str], None],
        stopped: Callable[[], bool],
    ) -> None:
        self._info, self._warning = info, warning
        self._report, self._stopped = report, stopped
        self._loaded: set[str] = set()
        self._handler = NoteHandler(warning)
        _kernel_cache.logger.addHandler(self._handler)

    def prepare(self, parameters: Parameters) -> None:
        """Load or compile kernels for all allowed values; ExternalShutdownException if stopped."""
        missing = self._load(allowed_steps(parameters))
        if missing:
            progress = self._compile(missing)
            left = [] if progress.stopped else self._load(missing)
            if left:
                self._compile_here(left, progress.failed.get(left[0], "it is not in the cache"))
        if self._stopped():
            raise ExternalShutdownException("stopped while kernels were compiled")

    def check(self, parameters: Parameters) -> None:
        """Load the kernels that other parameters need; ValueError if the cache lacks some."""
        missing = self._load(allowed_steps(parameters))
        if missing:
            raise ValueError(
                f"kernels for {', '.join(missing)} are not compiled: run {WARM_UP}, or set it "
                "before the node is configured"
            )

    def close(self) -> None:
        """Forward no more log records."""
        _kernel_cache.logger.removeHandler(self._handler)

    def _load(self, names: Iterable[str]) -> list[str]:
        """Load the steps that the cache has all of; return the others."""
        missing = []
        for step in names:
            if step in self._loaded:
                continue
            try:
                with _kernel_cache.only_loading():
                    steps.run(step)
            except _kernel_cache.KernelMissingError:
                missing.append(step)
                continue
            except Exception as error:  # it would fail in a cycle, too, where it is counted
                self._warning(f"kernels for {step}: {type(error).__name__}: {error}")
            self._loaded.add(step)
        Garbage.settle_more()
        return missing

    def _compile(self, missing: list[str]) -> CompileProgress:
        kept = f"cached in {_kernel_cache.places[0]}" if _kernel_cache.places else "not cached"
        self._info(
            f"compiling kernels for {', '.join(missing)} (up to a minute on first use), {kept}; "
            f"{WARM_UP} compiles all beforehand"
        )
        self._report("compiling kernels (up to a minute on first use)")
        start = perf_counter()
        due, noted, done = start + FIRST_WORD, 0, 0

        def look(progress: CompileProgress) -> None:
            nonlocal due, noted, done
            self._load(progress.done[done:])
            done = len(progress.done)
            for note in progress.notes[noted:]:
                self._warning(note)
            noted = len(progress.notes)
            if perf_counter() >= due:
                due = perf_counter() + NEXT_WORD
                text = (
                    f"compiling: {len(progress.kernels)} kernels and {len(progress.done)} of "
                    f"{len(progress.steps)} steps done after {perf_counter() - start:.0f} s, "
                    f"now {', '.join(progress.running)}"
                )
                self._info(text)
                self._report(text)

        private = _kernel_cache.private_place() if _kernel_cache.why_not_kept() else None
        progress = compile_steps(missing, private=private, look=look, stopped=self._stopped)
        if progress.done and not progress.stopped:
            self._info(
                f"compiled {len(progress.kernels)} kernels for {', '.join(progress.done)} in "
                f"{perf_counter() - start:.1f} s"
            )
        return progress

    def _compile_here(self, names: list[str], reason: str) -> None:
        self._warning(
            f"cannot compile kernels in another process: {reason}; this one compiles them, and "
            "answers nothing meanwhile"
        )
        for step in names:
            if not self._stopped():
                start, before = perf_counter(), len(_kernel_cache.compiled.names)
                steps.run(step)
                self._loaded.add(step)
                self._info(
                    f"compiled {len(_kernel_cache.compiled.names) - before} kernels for {step} in "
                    f"{perf_counter() - start:.1f} s"
                )

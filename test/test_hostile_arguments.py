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

"""Nothing that is handed to the library ends the process, or is read out of bounds.

    python test_hostile_arguments.py [STEP]

Runs the calls of ``test_wrong_kinds`` and some more, one after another, with a step only one of so
many. Each case replaces one argument of a call that works. Before a case its number and name go to
standard output, so that whatever ends the process is known. Anything but an answer or an error of
ERRORS is said as a failure.
"""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_wrong_kinds import FUNCTIONS

import obb_collision as oc
from obb_collision.shapes import Box, Hull, Mesh

ERRORS = (ValueError, TypeError, KeyError)
#: What is no boxes (or the like) at all has no attributes of them.
OBJECTS = ("a", "b", "boxes", "start", "end")
TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])

NUMBERS: list[Any] = [
    *(0, -1, -2, 1, 2, 3, 4, 7, 8, 63, 64, 65, 255, 256, 2**31 - 1, 2**31, 2**32, 2**62, 2**63),
    *(2**64, -(2**31), -(2**63), 0.5, 1.0, -0.5, 1e300, 1e308, 5e-324, float("nan")),
    *(float("inf"), -float("inf"), True, False, None, "1", "", b"1", [], [1], (), {}, object()),
    *(np.int8(-1), np.uint64(2**64 - 1), np.float32(2.0), np.bool_(True), np.array(3), 1j),
    np.datetime64("2020-01-01"),
]
ARRAYS: list[Any] = [
    np.empty(0), np.empty((0, 2)), np.empty((0, 3)), np.zeros((1, 1)), np.zeros((2, 2, 2)),
    [[0, 1]], [[0, -1]], [[0, 9]], [[2**31, 2**32]], [[2**62, 1]], [[-(2**63), 0]], [[0.0, 1.0]],
    [[0, 1, 2]], [[0], [1]], [0, 1], [-1], [9], [2**40], [[0, 1], [1]], [["a", "b"]], [[None, 0]],
    np.array([[0, 1]], np.uint64) + np.uint64(2**63), np.array([[0, 1]], np.int8),
    np.array([[0, 1]], ">i8"), np.array([[True, False]]), np.asfortranarray([[0, 1], [1, 0]]),
    np.array([[0, 1], [1, 0], [0, 0]])[::2], np.ma.array([[0, 1]]), np.array([[0, 1]], object),
    np.full((2, 3), np.nan), np.full((2, 3), np.inf), np.full((2, 3), 1e300), np.ones((3, 3)),
    np.ones((2, 3), np.complex128), np.zeros((2, 3), "S1"), np.lib.stride_tricks.as_strided(
        np.zeros(3), (2, 3), (0, 8)
    ), np.zeros((2, 7)), np.full((2, 7), -1e300), np.zeros((2, 6)), np.full((2, 6), 1e300),
    np.zeros((1 << 10, 0)), np.zeros((2, 3, 3)), np.zeros((4, 3)), np.zeros(7), np.full(7, np.nan),
]  # fmt: skip
HOSTILE = NUMBERS + ARRAYS


def trees() -> oc.MeshTrees:
    """Return two small trees."""
    tree = oc.MeshTrees.build(TETRAHEDRON, FACES)
    return oc.MeshTrees.join([tree, tree])


def scene() -> oc.Scene:
    """Return a scene of two boxes and a mesh that overlap."""
    made = oc.Scene()
    made.add("a", Box([1.0, 1.0, 1.0]))
    made.add("b", Box([1.0, 1.0, 1.0]))
    made.add("c", Mesh(TETRAHEDRON, FACES), accuracy="mesh")
    made.obstacle_points = np.zeros((3, 3))
    return made


EVERY = ["separations", "contacts", "clearance", "sweep", "points"]


def changed(change: Callable[[oc.Scene, Any], None]) -> Callable[[Any], Any]:
    """Return a call that changes a new scene and checks it."""

    def call(value: Any) -> Any:
        made = scene()
        change(made, value)
        report = made.check(effects=EVERY)
        return report.names(), report.colliding

    return call


def assign(made: oc.Scene, path: str, value: Any) -> None:
    """Set a property of a scene or of a part of it."""
    *parts, name = path.split(".")
    setattr(reduce(getattr, parts, made), name, value)


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a call of a method of a scene, which is checked after it; others as they are."""
    owner = getattr(function, "__self__", None)
    if not isinstance(owner, oc.Scene):
        return function
    return lambda **given: (function(**given), owner.check(effects=EVERY).colliding)


SHAPES: dict[str, tuple[Callable[[Any], Any], Any]] = {
    "box": (Box, [1.0, 1.0, 1.0]),
    "mesh": (lambda value: Mesh(value, FACES), TETRAHEDRON),
    "faces": (lambda value: Mesh(TETRAHEDRON, value), FACES),
    "scale": (lambda value: Hull(TETRAHEDRON, value), [1.0, 1, 1]),
}
OPTIONS = {
    "max_points": ("contacts", 4),
    "max_distance": ("clearance", 1.0),
    "horizon": ("sweep", 1.0),
    "margin": ("points", 0.1),
}


def written(value: Any) -> Any:
    """Write into what a report gives, then have its effects computed."""
    report = scene().check()
    for name in ("pairs", "verdicts", "accuracies"):
        array = getattr(report, name)
        try:
            array[...] = value
        except (*ERRORS, OverflowError):
            continue
        raise AssertionError(f"report.{name} can be written")
    return report.separations, report.contacts, report.colliding


def calls() -> Iterator[tuple[str, Callable[..., Any], dict[str, Any]]]:
    """Yield name, function and good arguments."""
    for name, (function, good) in FUNCTIONS.items():
        if name == "set_threads" or "none." in str(good.get("path", "")):
            continue
        if name.endswith(" ="):  # a property of a scene
            (value,) = good.values()
            path = name.removeprefix("Scene.").removesuffix(" =")

            def put(made: oc.Scene, given: Any, path: str = path) -> None:
                assign(made, path, given)

            yield name, changed(put), {"value": value}
        else:
            yield name, checked(function), good
    for name, (make, value) in SHAPES.items():
        add = changed(lambda made, given, make=make: made.add("d", make(given), accuracy="mesh"))  # type: ignore[misc]
        yield name, add, {"value": value}
    for option, (effect, value) in OPTIONS.items():

        def setting(made: oc.Scene, given: Any, effect: str = effect, option: str = option) -> None:
            made.set_effect(effect, **{option: given})

        yield option, changed(setting), {"value": value}
    for name, value in vars(trees()).items():
        if name != "arrays":
            yield from tree_calls(name, value)
    yield "Report", written, {"value": 10**9}


def tree_calls(name: str, good: Any) -> Iterator[tuple[str, Callable[..., Any], dict[str, Any]]]:
    """Yield the making and the use of trees with one array changed, also within."""
    arrays = {key: value for key, value in vars(trees()).items() if key != "arrays"}

    def whole(value: Any) -> Any:
        return used(oc.MeshTrees(**arrays | {name: value}))

    def entry(value: Any) -> Any:
        changed = good.copy()
        try:
            changed[-1] = value
        except (*ERRORS, OverflowError):
            return None  # no such array
        return used(oc.MeshTrees(**arrays | {name: changed}))

    yield f"MeshTrees {name}", whole, {"value": good}
    yield f"MeshTrees {name}[-1]", entry, {"value": good[-1]}


def used(made: oc.MeshTrees) -> Any:
    """Let the kernels go over trees."""
    bodies = oc.PlacedMeshes(made, [0, 1], np.zeros((2, 3)), [np.eye(3)] * 2)
    return oc.verdicts(bodies, bodies, [[0, 1]]), oc.verdicts(bodies, bodies, depth=3)


def say(line: str) -> None:
    """Write a line at once: the process may end at the next call."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    """Run the cases; print what is no answer and no clear error."""
    number, step = 0, int(sys.argv[1]) if len(sys.argv) > 1 else 1
    for name, function, good in calls():
        function(**good)  # what is good must work
        for argument in good:
            for which, value in enumerate(HOSTILE):
                number += 1
                if number % step:
                    continue
                say(f"{number} {name}({argument}=HOSTILE[{which}])")
                try:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")
                        function(**{**good, argument: value})
                except ERRORS as error:
                    if type(error).__module__.startswith("numba"):
                        say(f"FAILED {type(error).__name__}: {value!r}")
                except AttributeError as error:
                    if argument not in OBJECTS:
                        say(f"FAILED {error} for {value!r}")
                except BaseException as error:
                    say(f"FAILED {type(error).__name__}: {error} for {value!r}")
    say(f"done {number}")


#: One case in so many is run; all of them take a minute or two.
@pytest.mark.parametrize("step", [8, pytest.param(1, marks=pytest.mark.slow)])
def test_hostile_arguments_are_answered_or_refused(step: int) -> None:
    """In a process of its own: what it was doing when it ended is in the last line."""
    source, support = Path(oc.__file__).parents[1], Path(__file__).parent / "support"
    ran = subprocess.run(
        [sys.executable, __file__, str(step)],
        env={**os.environ, "PYTHONPATH": f"{source}{os.pathsep}{support}"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    lines = ran.stdout.splitlines()
    failed = [f"{case}: {line}" for case, line in pairwise(lines) if line.startswith("FAILED")]
    assert failed == []
    assert ran.returncode == 0, f"ended by {ran.returncode} in {lines[-1:]}: {ran.stderr[-2000:]}"
    assert lines[-1].startswith("done ")
    assert len(lines) > 12000 // step


if __name__ == "__main__":
    main()

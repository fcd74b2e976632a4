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

"""Hostile arguments to the whole public API, one after another: run by ``test_hostile_arguments``.

    python hostile_arguments.py [STEP]

With a step only one of so many cases is run. Each case replaces one argument of a call that works.
Before a case its number and name go to standard output, so that whatever ends the process is known.
Anything but an answer or an error of ERRORS is said as a failure.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import obb_collision as oc
from obb_collision.shapes import Box, Hull, Mesh, Sphere

ERRORS = (ValueError, TypeError, KeyError)
#: What is no boxes (or the like) at all has no attributes of them.
OBJECTS = ("a", "b", "boxes", "start", "end")
IDENTITY = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
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


def scene_calls() -> Iterator[tuple[str, Callable[..., Any], dict[str, Any]]]:
    """Yield calls that change a scene and check it."""

    def checked(change: Callable[[oc.Scene, Any], None]) -> Callable[[Any], Any]:
        def call(value: Any) -> Any:
            made = scene()
            change(made, value)
            report = made.check(effects=["separations", "contacts", "clearance", "sweep", "points"])
            return report.names(), report.colliding

        return call

    changes: dict[str, tuple[Callable[[oc.Scene, Any], Any], Any]] = {
        "move_indices": (lambda s, v: s.move_indices(v, [IDENTITY] * 2), [0, 1]),
        "move_indices poses": (lambda s, v: s.move_indices([0, 1], v), [IDENTITY] * 2),
        "poses_of": (lambda s, v: s.poses_of(v), [0, 1]),
        "move": (lambda s, v: s.move("a", v), IDENTITY),
        "set_twists": (lambda s, v: s.set_twists(v, np.zeros((2, 6))), [0, 1]),
        "set_twists twists": (lambda s, v: s.set_twists([0, 1], v), np.zeros((2, 6))),
        "name": (lambda s, v: s.name(v), 0),
        "padding": (lambda s, v: setattr(s, "padding", v), 0.1),
        "max_pairs": (lambda s, v: setattr(s, "max_pairs", v), 3),
        "accuracy": (lambda s, v: setattr(s, "accuracy", v), "obb"),
        "points": (lambda s, v: setattr(s, "obstacle_points", v), np.zeros((3, 3))),
        "allowed": (lambda s, v: setattr(s, "allowed", v), [("a", "b", True)]),
        "check_only": (lambda s, v: setattr(s, "check_only", v), [("a", "b")]),
        "allowed_within": (lambda s, v: setattr(s, "allowed_within", v), ["a"]),
        "padding_overrides": (lambda s, v: setattr(s, "padding_overrides", v), [("a", 0.1)]),
        "set_padding": (lambda s, v: s.set_padding("a", v), 0.1),
        "max_points": (lambda s, v: s.set_effect("contacts", max_points=v), 4),
        "max_distance": (lambda s, v: s.set_effect("clearance", max_distance=v), 1.0),
        "horizon": (lambda s, v: s.set_effect("sweep", horizon=v), 1.0),
        "margin": (lambda s, v: s.set_effect("points", margin=v), 0.1),
        "box": (lambda s, v: s.add("d", Box(v)), [1.0, 1.0, 1.0]),
        "mesh": (lambda s, v: s.add("d", Mesh(v, FACES), accuracy="mesh"), TETRAHEDRON),
        "faces": (lambda s, v: s.add("d", Mesh(TETRAHEDRON, v), accuracy="mesh"), FACES),
        "scale": (
            lambda s, v: s.add("d", Hull(TETRAHEDRON, v), accuracy="mesh"),
            [1.0, 1, 1],
        ),
        "pose": (lambda s, v: s.add("d", Sphere(1.0), v), IDENTITY),
        "cast_rays": (lambda s, v: s.cast_rays(v, [[1, 0, 0]]), [[0, 0, 0]]),
        "cast_rays directions": (lambda s, v: s.cast_rays([[0, 0, 0]], v), [[1, 0, 0]]),
        "cast_rays accuracy": (
            lambda s, v: s.cast_rays([[0, 0, 0]], [[1, 0, 0]], accuracy=v),
            "hull",
        ),
    }
    for name, (change, good) in changes.items():
        yield f"Scene.{name}", checked(change), {"value": good}


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
    boxes = oc.Boxes(np.zeros((2, 3)), [np.eye(3)] * 2, np.ones((2, 3)))
    turned = oc.Boxes.from_poses([[0.1, 0, 0, 0, 0, 0.6, 0.8]] * 2, np.ones((2, 3)))
    capsules = oc.Capsules(np.zeros((2, 3)), np.ones((2, 3)), np.ones(2))
    pairs = np.array([[0, 1]])
    bodies = oc.PlacedMeshes(trees(), [0, 1], np.zeros((2, 3)), [np.eye(3)] * 2)
    box: dict[str, Any] = {"centers": np.zeros((2, 3)), "rotations": [np.eye(3)] * 2}
    yield "Boxes", oc.Boxes, {**box, "half_extents": np.ones((2, 3))}
    yield "Boxes.from_poses", oc.Boxes.from_poses, {
        "poses": [IDENTITY] * 2, "half_extents": np.ones((2, 3)),
    }  # fmt: skip
    yield "OBB", oc.OBB, {"center": [0, 0, 0], "rotation": np.eye(3), "half_extents": [1, 1, 1]}
    yield "OBB.from_points", oc.OBB.from_points, {"points": TETRAHEDRON, "fit": "best"}
    yield "Boxes.from_points", oc.Boxes.from_points, {
        "points": TETRAHEDRON, "offsets": [0, 2, 4], "fit": "best"
    }  # fmt: skip
    yield "AABB", oc.AABB, {"minimum": [0, 0, 0], "maximum": [1, 1, 1]}
    yield "Capsules", oc.Capsules, {
        "starts": np.zeros((2, 3)), "ends": np.ones((2, 3)), "radii": np.ones(2)
    }  # fmt: skip
    yield "verdicts", oc.verdicts, {"a": boxes, "b": turned, "pairs": pairs}
    yield "iou", oc.iou, {"a": boxes, "b": turned, "pairs": pairs}
    yield "overlap_volumes", oc.overlap_volumes, {"a": boxes, "b": turned, "pairs": pairs}
    yield "nms", oc.nms, {"boxes": boxes, "scores": np.ones(len(boxes)), "threshold": 0.5}
    yield "find_pairs", oc.find_pairs, {"a": boxes, "b": boxes, "exact": False, "accuracy": "obb"}
    yield "any_collision", oc.any_collision, {"a": boxes, "b": boxes, "exact": False}
    both = {"a": boxes, "b": turned, "pairs": pairs}
    yield "separations", oc.separations, both
    yield "contacts", oc.contacts, {**both, "max_points": 4}
    yield "clearances", oc.clearances, {**both, "max_distance": 1.0}
    moving = oc.MovingBoxes(boxes, turned)
    yield "MovingBoxes", oc.MovingBoxes, {"start": boxes, "end": turned}
    yield "MovingBoxes.from_twists", oc.MovingBoxes.from_twists, {
        "boxes": boxes, "twists": np.ones((2, 6)), "duration": 1.0, "origins": np.zeros((2, 3))
    }  # fmt: skip
    yield "sweeps", oc.sweeps, {"a": moving, "b": boxes, "pairs": pairs, "tolerance": 1e-3}
    yield "points_inside", oc.points_inside, {
        "boxes": boxes, "points": np.zeros((5, 3)), "margin": 0.1, "each_point": True
    }  # fmt: skip
    rays = {"origins": np.zeros((2, 3)), "directions": np.ones((2, 3)), "max_distance": 1.0}
    yield "cast_rays", oc.cast_rays, {"boxes": boxes, **rays}
    ends = {"starts": np.zeros((2, 3)), "ends": np.ones((2, 3))}
    yield "cast_segments", oc.cast_segments, {"boxes": boxes, **ends}
    planes = {"points": np.zeros((2, 3)), "normals": np.ones((2, 3))}
    yield "HalfSpaces", oc.HalfSpaces, planes
    for question in (oc.verdicts, oc.separations):
        spaces = {"a": boxes, "b": oc.HalfSpaces(**planes), "pairs": pairs}
        yield "half-spaces", question, spaces
    yield "clearances of capsules", oc.clearances, {
        "a": capsules, "b": boxes, "pairs": pairs, "max_distance": 1.0
    }  # fmt: skip
    mesh = {"vertices": TETRAHEDRON, "faces": FACES, "solid": None, "leaf": 1, "root": None}
    yield "MeshTrees.build", oc.MeshTrees.build, mesh
    yield "MeshTrees.from_half_extents", oc.MeshTrees.from_half_extents, {"half_extents": [1, 1, 1]}
    yield "MeshTrees.boxes", trees().boxes, {"index": 1, "depth": 1}
    for name, value in vars(trees()).items():
        if name != "arrays":
            yield from tree_calls(name, value)
    yield "PlacedMeshes", oc.PlacedMeshes, {"trees": trees(), "meshes": [0, 1], **box}
    sides = {"a": bodies, "b": bodies, "pairs": pairs}
    yield "verdicts of meshes", oc.verdicts, {**sides, "exact": True, "effort": 100}
    yield "verdicts of trees", oc.verdicts, {**sides, "depth": 2}
    yield "cast_rays meshes", oc.cast_rays, {"boxes": bodies, **rays}
    yield "cast_segments meshes", oc.cast_segments, {"boxes": bodies, **ends}
    yield "points_inside meshes", oc.points_inside, {
        "boxes": bodies, "points": np.zeros((5, 3)), "margin": 0.1, "each_point": True
    }  # fmt: skip
    yield "clearances of meshes", oc.clearances, {
        **sides, "max_distance": 1.0, "radii_a": 0.1, "radii_b": [0.1, 0.2]
    }  # fmt: skip
    yield "sweeps of meshes", oc.sweeps, {
        **sides, "duration": 1.0, "twists_a": 0.1, "twists_b": [0.1] * 6, "radii_a": 0.1,
        "radii_b": [0.1, 0.2], "tolerance": 1e-4,
    }  # fmt: skip
    radii = {"radii_a": 0.1, "radii_b": [0.1, 0.2]}
    yield "separations of meshes", oc.separations, {**sides, **radii}
    yield "contacts of meshes", oc.contacts, {**sides, **radii, "max_points": 8}
    yield "triangle_pairs", oc.triangle_pairs, {**sides, "capacity": 4}
    yield "Report", written, {"value": 10**9}
    yield from scene_calls()


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


if __name__ == "__main__":
    main()

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

"""Calls of every public function, class and method, with an argument of use for each parameter.

A parameter means the same wherever it has the same name, so most arguments stand in one table; what
differs stands beside the name of the call. A name "f of bodies" is another call of f.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from enum import Enum
from functools import cache
from typing import Any, NamedTuple

import numpy as np

import obb_collision as oc
from obb_collision.shapes import Box, Sphere

#: For the code of this package, which takes what is known to be right.
INTERNAL = {
    "trusted", "row", "take", "local_box", "fitted", "build_outside", "single", "of", "rows",
    "place", "compute", "renew_indices", "begin_boxes", "resize_boxes", "rename_indices",
    "grow_indices", "speeds_of",
}  # fmt: skip


def public_objects() -> Iterator[tuple[str, Any]]:
    """Yield name and value of all public classes and functions."""
    for name in oc.__all__:
        if name not in ("regions", "shapes"):
            yield name, getattr(oc, name)
    for name in oc.shapes.__all__:
        yield f"shapes.{name}", getattr(oc.shapes, name)
    for name in oc.regions.__all__:
        yield f"regions.{name}", getattr(oc.regions, name)


def public_methods() -> Iterator[tuple[str, Any]]:
    """Yield name and function of all public methods of public classes."""
    for name, kind in public_objects():
        if not inspect.isclass(kind) or issubclass(kind, Enum):
            continue
        for method in dir(kind):
            value = getattr(kind, method)
            if method.startswith("_") or method in INTERNAL or not callable(value):
                continue
            if str(getattr(value, "__module__", "")).startswith("obb_collision"):
                yield f"{name}.{method}", value


POSE = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
ROCK = '<robot name="rock"><link name="rock"/></robot>'
POINTS, UNITS, STATES = np.zeros((2, 3)), np.ones((2, 3)), np.zeros((2, 0))
BOX, AROUND = oc.OBB(half_extents=[1, 1, 1]), oc.AABB([-1] * 3, [1] * 3)
BOXES = oc.Boxes.from_poses([POSE, POSE], np.ones((2, 3)))
TREES = oc.MeshTrees.build(np.eye(3), [[0, 1, 2]])
PLACED = oc.PlacedMeshes.from_poses(TREES, [0], [POSE])
REGION = oc.regions.Region([0] * 3, [1] * 3, 1.0)


def scene() -> oc.Scene:
    """Return a scene of two boxes that overlap."""
    made = oc.Scene()
    made.add("a", Box([1, 1, 1]))
    made.add("b", Box([1, 1, 1]))
    return made


@cache
def rock() -> oc.Robot:
    """Return a robot of one link without a shape, and a group without joints."""
    srdf = ROCK.replace('<link name="rock"/>', '<group name="all"><link name="rock"/></group>')
    return oc.Robot.from_urdf(ROCK, srdf)


def with_cup() -> oc.RobotScene:
    """Return a robot's scene in which it holds a cup."""
    made = oc.RobotScene(rock(), scene())
    made.attach("cup", Box([1] * 3), "rock")
    return made


#: What methods are called on.
INSTANCES: dict[str, Callable[[], Any]] = {
    "AABB": lambda: AROUND,
    "OBB": lambda: oc.OBB(half_extents=[1, 1, 1]),
    "Boxes": lambda: BOXES,
    "MeshTrees": lambda: TREES,
    "Report": lambda: scene().check(),
    "Robot": rock,
    "RobotScene": with_cup,
    "Scene": scene,
    "Scene.objects": lambda: scene().objects,
    "SceneDescription": lambda: oc.SceneDescription("x", ()),
    "regions.Region": lambda: REGION,
    "regions.RegionMerger": lambda: oc.regions.RegionMerger(["west"]),
}
#: Nobody makes these by hand, but for one from arrays that are checked as well.
RESULTS = {
    "Accuracy", "MeshTrees", "Report", "Robot", "SceneDescription", "Verdict", "shapes.Shape",
}  # fmt: skip

#: Arguments of use by their names.
ARGUMENTS: dict[str, Any] = {
    "a": BOXES, "b": BOXES, "boxes": BOXES, "start": BOXES, "end": BOXES, "pairs": [[0, 1]],
    "aabb": AROUND, "obbs": [BOX, BOX], "trees": TREES, "meshes": [0], "region": REGION,
    "center": [0.0] * 3, "centers": POINTS, "rotation": np.eye(3), "rotations": [np.eye(3)] * 2,
    "half_extents": UNITS, "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0], "matrix": np.eye(4),
    "pose": POSE, "poses": [POSE, POSE], "minimum": [0.0] * 3, "maximum": [1.0] * 3,
    "points": POINTS, "normals": UNITS, "origins": POINTS, "directions": UNITS, "starts": POINTS,
    "ends": UNITS, "vertices": np.eye(3), "faces": [[0, 1, 2]], "offsets": [0, 2],
    "size": [1.0] * 3, "sizes": UNITS, "scale": [1.0] * 3, "radius": 1.0, "length": 1.0,
    "radii": [1.0, 1.0], "shape": Sphere(1), "shapes": [None, Sphere(0.5)], "fit": "best",
    "i": 0, "index": 0, "indices": [0], "depth": 1, "exact": False, "accuracy": "hull",
    "accuracies": ["obb"] * 2, "padding": 0.1, "margin": 0.1, "halo": 1.0, "time_budget": 0.01,
    "max_pairs": 9, "max_points": 4, "max_distance": 1.0, "tolerance": 1e-4, "contacts": True,
    "duration": 1.0, "twist": [0.0] * 6, "twists": np.zeros((2, 6)), "each_point": True,
    "scores": [0.5, 0.5], "classes": [1, "b"], "generalized": True, "threshold": 0.5,
    "number": 2, "name": "a", "names": ["p", "q"],
    "first": "a", "second": "b", "allowed": True, "enabled": True, "objects": ["a"],
    "sides": [("a", "*")],
    "mode": "on", "effects": ["contacts"], "effect": "contacts", "ignore": ["a"],
    "urdf": ROCK, "srdf": ROCK, "package_dirs": ["."], "move_virtual_joint": False,
    "robots": [rock()], "bases": [POSE], "states": STATES,
    "deviations": STATES, "all_pairs": True, "self_pairs": True, "resolution": 1e-3,
    "group": "all", "base_state": [], "jacobian": True, "still_pairs": True,
    "time_limit": 1.0, "link": "rock", "touch_links": ["rock"], "regions": ["west", "east"],
    "timeout": 0.5, "parts": [2, 1, 1], "now": 1.0, "stamp": 1, "topic": "a", "time": 0.0,
    "rows": np.zeros(1, [("ns", "i4"), ("id", "i4")]), "scene": scene(),
}  # fmt: skip
MESHES = {"a": PLACED, "b": PLACED, "pairs": [[0, 0]], "radii_a": 0.1, "radii_b": 0.1}
#: Those of one call, or of all methods of a class; None: it is not given.
OTHERS: dict[str, dict[str, Any]] = {
    "OBB": {"half_extents": [1.0] * 3, "other": BOX, "points": [0.0] * 3, "point": [0.0] * 3},
    "RobotScene.own_points": {"state": np.zeros(0), "sensor": [0.0, 0.0, 1.0]},
    "AABB": {"other": AROUND, "points": [0.0] * 3},
    "AABB.from_points": {"points": np.eye(3)},
    "OBB.from_points": {"points": np.eye(3)},
    "Boxes.from_poses": {"half_extents": [[1.0] * 3] * 2},
    "Boxes.from_matrices": {"matrices": [np.eye(4)] * 2},
    "Boxes.from_yaw": {"yaw": [0.0] * 2},
    "Boxes.contains": {"points": [0.0] * 3},
    "MeshTrees.join": {"trees": [TREES]},
    "PlacedMeshes": {"centers": [[0.0] * 3], "rotations": [np.eye(3)], "poses": [POSE]},
    "RobotScene": {"name": "cup", "starts": STATES, "ends": STATES, "first": True},
    "RobotScene.attach": {"name": "other"},
    "RobotScene.attach_object": {"name": "a"},
    "Scene.add": {"name": "c"},
    "Scene.move_indices": {"poses": [POSE]},
    "Scene.set_effect": {"name": "clearance", "options": None, "max_distance": 1.0},
    "Scene": {"accuracy": "obb"},
    "find_pairs": {"accuracy": "obb"},
    "shapes.Box": {"size": [1.0] * 3, "half_extents": None},
    "shapes.Box of half extents": {"size": None, "half_extents": [1.0] * 3},
    "shapes.Ellipsoid": {"radii": [1.0] * 3},
    "shapes.Hull": {"points": np.eye(3)},
    "shapes.Mesh.from_file": {"path": "none.stl"},
    "load_scene": {"path": "none.yaml"},
    "regions.RegionMerger": {"region": "west", "objects": 3},
    "verdicts of half-spaces": {"b": oc.HalfSpaces(POINTS, UNITS)},
    "clearances of capsules": {"a": oc.Capsules(POINTS, UNITS, np.ones(2))},
    "triangle_pairs": {**MESHES, "capacity": 9},
    "verdicts of meshes": {**MESHES, "effort": 99},
    "separations of meshes": MESHES,
    "clearances of meshes": MESHES,
    "contacts of meshes": MESHES,
    "sweeps of meshes":
        MESHES | {"duration": 1.0, "twists_a": 0.1, "twists_b": 0.1, "contacts": None},
    "Scene.move of several": {"name": ["a"], "pose": [POSE]},
    "Scene.objects.poses_of": {},
    "Scene.objects.set_twists": {"twists": [[0.0] * 6]},
    "Scene.objects.set_enabled": {"enabled": [True]},
    "Scene.objects.remove": {},
    "Scene.objects.shape_of": {},
}  # fmt: skip
#: Only for bodies of another kind, and what is a function or is made beforehand.
SPECIAL = {"effort", "duration", "capacity", "region"}
#: Properties of a scene, and of its parts.
PROPERTIES: dict[str, Any] = {
    "padding": 0.1, "accuracy": "obb", "time_budget": 0.1, "obstacle_points": POINTS,
    "watched": {"a": POINTS},
    "max_pairs": 9, "region": REGION, "rules.allowed": [("a", "b", True)],
    "rules.check_only": [("a", "b")], "rules.allowed_within": ["a"],
    "objects.padding_overrides": [("a", 0.1)],
}  # fmt: skip


class Call(NamedTuple):
    """A call that works: a function of keyword arguments, and these."""

    function: Callable[..., Any]
    good: dict[str, Any]

    @property
    def works(self) -> bool:
        """Whether it does, as without a file."""
        return "none." not in str(self.good.get("path", ""))


def _call(label: str, function: Any) -> Call:
    """Return a call of a public name; ``KeyError`` for an argument that no table has."""
    owner, _, method = re.sub(" of .*", "", label).rpartition(".")
    others = OTHERS.get(owner, {}) | OTHERS.get(label.partition(" of ")[0], {})
    others |= OTHERS.get(label, {})
    parameters = inspect.signature(function).parameters
    good = {}
    for name, parameter in parameters.items():
        needed = parameter.default is parameter.empty and parameter.kind != parameter.VAR_KEYWORD
        usual = name in ARGUMENTS and name not in SPECIAL
        if name != "self" and name not in others and (needed or usual):
            good[name] = ARGUMENTS[name]
    for name, value in others.items():
        if value is not None and (name in parameters or "options" in parameters):
            good[name] = value
    bound = owner in INSTANCES and "self" in parameters

    def run(**given: Any) -> Any:
        if not bound:
            return function(**given)
        made = INSTANCES[owner]()
        found = getattr(made, method)(**given)
        return made if found is None and owner == "Scene" else found  # changed, maybe

    return Call(run, good)


def _assignment(path: str, value: Any) -> Call:
    *parts, last = path.split(".")

    def run(**given: Any) -> None:
        made = scene()
        setattr(getattr(made, parts[0]) if parts else made, last, given[last])
        made.check()

    return Call(run, {last: value})


def public_calls() -> dict[str, Call]:
    """Return calls of all that is public, by name."""
    names = {name: value for name, value in public_objects() if name not in RESULTS}
    names |= dict(public_methods())
    for label in OTHERS:
        if label.startswith("Scene.objects."):
            names[label] = getattr(type(scene().objects), label.rpartition(".")[2])
        elif " of " in label:
            names[label] = names[label.partition(" of ")[0]]
    found = {label: _call(label, function) for label, function in names.items()}
    return found | {f"Scene.{p} =": _assignment(p, value) for p, value in PROPERTIES.items()}

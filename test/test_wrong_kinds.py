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

"""Arguments of a wrong kind are refused by the name of the argument, whichever function gets them.

Every public function and method is called with each of its arguments replaced by things of every
kind. It may be of use (a list of numbers is an array); if not, it is a ValueError, TypeError or
KeyError that names the argument, and never an AttributeError out of something private.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from each import each

import obb_collision as oc
from obb_collision.scene.effects import EFFECTS
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Sphere

POSE = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
WRONG: list[Any] = [
    None, True, -1, 3, 1.5, float("nan"), 10**400, 1j, "x", "\ud800", b"a", {}, {"a": 1}, [], [1],
    ["a"], [None], [[1, 2], [3]], (), set(), object(), object, range(3), lambda: 0, np.zeros(3),
    np.array("x"), np.array([None, {}], object), np.zeros((2, 2, 2)), np.array([True]), [[0, 99]],
]  # fmt: skip


def boxes() -> oc.Boxes:
    return oc.Boxes.from_poses([POSE, POSE], np.ones((2, 3)))


def capsules() -> oc.Capsules:
    return oc.Capsules(np.zeros((2, 3)), np.ones((2, 3)), np.ones(2))


def trees() -> oc.MeshTrees:
    return oc.MeshTrees.build(np.eye(3), [[0, 1, 2]])


def placed() -> oc.PlacedMeshes:
    return oc.PlacedMeshes.from_poses(trees(), [0], [POSE])


def scene() -> oc.Scene:
    made = oc.Scene()
    made.add("a", Box([1, 1, 1]))
    made.add("b", Box([1, 1, 1]))
    return made


def setting(name: str) -> Callable[..., None]:
    """Return what sets a property of a scene."""

    def assign(**values: Any) -> None:
        made = scene()
        *parts, last = name.split(".")
        setattr(getattr(made, parts[0]) if parts else made, last, values[last])

    return assign


def with_cup(name: str) -> None:
    made = oc.RobotScene(oc.Robot.from_urdf(ROCK))
    made.attach("cup", Box([1] * 3), "rock")
    made.detach(name)


BOX, AROUND = oc.OBB(half_extents=[1, 1, 1]), oc.AABB([-1] * 3, [1] * 3)
REGION = oc.regions.Region([0] * 3, [1] * 3, 1.0)
MESHES = {"a": placed(), "b": placed(), "pairs": [[0, 0]]}
ROCK = '<robot name="rock"><link name="rock"/></robot>'
PAIRS = {"pairs": [[0, 1]]}
BOTH = {"a": boxes(), "b": boxes(), **PAIRS}
POINTS, UNITS = np.zeros((2, 3)), np.ones((2, 3))
FUNCTIONS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "OBB": (oc.OBB, {"center": [0] * 3, "rotation": np.eye(3), "half_extents": [1] * 3}),
    "OBB.from_quaternion": (
        oc.OBB.from_quaternion,
        {"center": [0] * 3, "quaternion_xyzw": [0, 0, 0, 1], "half_extents": [1] * 3},
    ),
    "OBB.from_aabb": (oc.OBB.from_aabb, {"aabb": AROUND}),
    "OBB.from_points": (oc.OBB.from_points, {"points": np.eye(3), "fit": "best"}),
    "OBB.edge_direction": (BOX.edge_direction, {"i": 0}),
    "OBB.face_normal": (BOX.face_normal, {"i": 0}),
    "OBB.transformed": (BOX.transformed, {"matrix": np.eye(4)}),
    "OBB.padded": (BOX.padded, {"margin": 0.1}),
    "OBB.contains": (BOX.contains, {"points": [0] * 3}),
    "OBB.intersects": (BOX.intersects, {"other": BOX}),
    "OBB.separation": (BOX.separation, {"other": BOX}),
    "OBB.overlap_volume": (BOX.overlap_volume, {"other": BOX}),
    "OBB.iou": (BOX.iou, {"other": BOX}),
    "AABB": (oc.AABB, {"minimum": [0] * 3, "maximum": [1] * 3}),
    "AABB.from_points": (oc.AABB.from_points, {"points": np.eye(3)}),
    "AABB.intersects": (AROUND.intersects, {"other": AROUND}),
    "AABB.contains": (AROUND.contains, {"points": [0] * 3}),
    "Boxes": (
        oc.Boxes, {"centers": POINTS, "rotations": [np.eye(3)] * 2, "half_extents": UNITS}
    ),
    "Boxes.from_poses": (oc.Boxes.from_poses, {"poses": [POSE], "half_extents": [[1, 1, 1]]}),
    "Boxes.from_points": (
        oc.Boxes.from_points, {"points": np.eye(3), "offsets": [0, 3], "fit": "best"}
    ),
    "Boxes.from_obbs": (oc.Boxes.from_obbs, {"obbs": [BOX, BOX]}),
    "Boxes.transformed": (boxes().transformed, {"matrix": np.eye(4)}),
    "Boxes.contains": (boxes().contains, {"points": [0] * 3, "exact": False}),
    "Boxes.padded": (boxes().padded, {"margin": 0.1}),
    "Capsules": (oc.Capsules, {"starts": POINTS, "ends": UNITS, "radii": [1, 1]}),
    "Capsules.spheres": (oc.Capsules.spheres, {"centers": POINTS, "radii": [1, 1]}),
    "Box": (Box, {"size": [1] * 3, "scale": [1] * 3}),
    "Sphere": (Sphere, {"radius": 1, "scale": [1] * 3}),
    "Ellipsoid": (Ellipsoid, {"radii": [1] * 3, "scale": [1] * 3}),
    "Cylinder": (Cylinder, {"radius": 1, "length": 1, "scale": [1] * 3}),
    "Cone": (Cone, {"radius": 1, "length": 1, "scale": [1] * 3}),
    "Capsule": (Capsule, {"radius": 1, "length": 1, "scale": [1] * 3}),
    "Hull": (Hull, {"points": np.eye(3), "scale": [1] * 3, "fit": "best"}),
    "Mesh": (
        Mesh, {"vertices": np.eye(3), "faces": [[0, 1, 2]], "scale": [1] * 3, "fit": "best"}
    ),
    "Mesh.from_file": (Mesh.from_file, {"path": "none.stl"}),
    "MeshTrees.build": (oc.MeshTrees.build, {"vertices": np.eye(3), "faces": [[0, 1, 2]]}),
    "MeshTrees.from_half_extents": (
        oc.MeshTrees.from_half_extents, {"half_extents": [[1, 1, 1]]}
    ),
    "MeshTrees.join": (oc.MeshTrees.join, {"trees": [trees()]}),
    "MeshTrees.boxes": (trees().boxes, {"index": 0, "depth": 1}),
    "PlacedMeshes": (
        oc.PlacedMeshes,
        {"trees": trees(), "meshes": [0], "centers": [[0] * 3], "rotations": [np.eye(3)]},
    ),
    "PlacedMeshes.from_poses": (
        oc.PlacedMeshes.from_poses, {"trees": trees(), "meshes": [0], "poses": [POSE]}
    ),
    "verdicts": (oc.verdicts, {"a": boxes(), "b": boxes(), **PAIRS, "exact": False}),
    "overlap_volumes": (oc.overlap_volumes, {"a": boxes(), "b": boxes(), **PAIRS}),
    "iou": (oc.iou, {"a": boxes(), "b": boxes(), **PAIRS}),
    "nms": (oc.nms, {"boxes": boxes(), "scores": [0.5] * len(boxes()), "threshold": 0.5}),
    "find_pairs": (
        oc.find_pairs, {"a": boxes(), "b": boxes(), "exact": False, "accuracy": "obb"}
    ),
    "any_collision": (oc.any_collision, {"a": boxes(), "b": boxes(), "exact": False}),
    "separations": (oc.separations, BOTH),
    "contacts": (oc.contacts, {**BOTH, "max_points": 4}),
    "clearances": (oc.clearances, {**BOTH, "max_distance": 1.0}),
    "MovingBoxes": (oc.MovingBoxes, {"start": boxes(), "end": boxes()}),
    "MovingBoxes.from_twists": (
        oc.MovingBoxes.from_twists,
        {"boxes": boxes(), "twists": np.zeros((2, 6)), "duration": 1.0, "origins": POINTS},
    ),
    "set_threads": (oc.set_threads, {"number": 2}),
    "threads": (oc.threads, {}),
    "sweeps": (oc.sweeps, {**BOTH, "tolerance": 1e-4, "contacts": True}),
    "points_inside": (
        oc.points_inside,
        {"boxes": boxes(), "points": POINTS, "margin": 0.1, "each_point": True},
    ),
    "cast_rays": (
        oc.cast_rays,
        {"boxes": boxes(), "origins": POINTS, "directions": UNITS, "max_distance": 1.0},
    ),
    "cast_segments": (oc.cast_segments, {"boxes": boxes(), "starts": POINTS, "ends": UNITS}),
    "HalfSpaces": (oc.HalfSpaces, {"points": POINTS, "normals": UNITS}),
    "verdicts of half-spaces": (
        oc.verdicts, {"a": boxes(), "b": oc.HalfSpaces(POINTS, UNITS), **PAIRS}
    ),
    "clearances of capsules": (oc.clearances, {"a": capsules(), "b": boxes(), **PAIRS}),
    "clearances of meshes": (
        oc.clearances, {**MESHES, "max_distance": 1.0, "radii_a": 0.1, "radii_b": 0.1}
    ),
    "triangle_pairs": (oc.triangle_pairs, {**MESHES, "capacity": 9}),
    "sweeps of meshes": (
        oc.sweeps,
        {
            **MESHES, "duration": 1.0, "twists_a": 0.1, "twists_b": 0.1, "radii_a": 0.1,
            "radii_b": 0.1, "tolerance": 1e-4,
        },
    ),
    "contacts of meshes": (
        oc.contacts, {**MESHES, "max_points": 4, "radii_a": 0.1, "radii_b": 0.1}
    ),
    "separations of meshes": (oc.separations, {**MESHES, "radii_a": 0.1, "radii_b": 0.1}),
    "verdicts of meshes": (
        oc.verdicts, {**MESHES, "exact": False, "effort": 99, "depth": None}
    ),
    "Robot.from_urdf": (
        oc.Robot.from_urdf,
        {
            "urdf": ROCK, "srdf": ROCK, "package_dirs": ["."], "move_virtual_joint": False,
            "read_mesh": Mesh.from_file,
        },
    ),
    "RobotScene": (
        oc.RobotScene,
        {
            "robots": [oc.Robot.from_urdf(ROCK)], "scene": scene(), "accuracy": "hull",
            "padding": 0.1, "bases": [POSE],
        },
    ),
    "RobotScene.check": (
        oc.RobotScene(oc.Robot.from_urdf(ROCK)).check,
        {"configurations": np.zeros((2, 0)), "all_pairs": True},
    ),
    "RobotScene.distances": (
        oc.RobotScene(oc.Robot.from_urdf(ROCK)).distances,
        {"configurations": np.zeros((2, 0)), "max_distance": 0.1, "self_pairs": True},
    ),
    "RobotScene.displacements": (
        oc.RobotScene(oc.Robot.from_urdf(ROCK)).displacements,
        {"states": np.zeros((2, 0)), "deviations": np.zeros((2, 0))},
    ),
    "RobotScene.check_motions": (
        oc.RobotScene(oc.Robot.from_urdf(ROCK)).check_motions,
        {"starts": np.zeros((2, 0)), "ends": np.zeros((2, 0)), "resolution": 1e-3},
    ),
    "RobotScene.check_path": (
        oc.RobotScene(oc.Robot.from_urdf(ROCK)).check_path,
        {"configurations": np.zeros((2, 0)), "resolution": 1e-3},
    ),
    "RobotScene.attach": (
        oc.RobotScene(oc.Robot.from_urdf(ROCK)).attach,
        {
            "name": "cup", "shape": Box([1] * 3), "link": "rock", "pose": POSE,
            "touch_links": ["rock"], "padding": 0.1,
        },
    ),
    "RobotScene.attach_object": (
        oc.RobotScene(oc.Robot.from_urdf(ROCK), scene()).attach_object,
        {"name": "a", "link": "rock", "pose": POSE, "touch_links": ["rock"]},
    ),
    "RobotScene.detach": (with_cup, {"name": "cup"}),
    "Robot.prove_pairs": (oc.Robot.from_urdf(ROCK).prove_pairs, {"time_limit": 1.0}),
    "Robot.link_poses": (oc.Robot.from_urdf(ROCK).link_poses, {"states": np.zeros((2, 0))}),
    "load_scene": (oc.load_scene, {"path": "none.yaml"}),
    "SceneDescription.states": (oc.SceneDescription("x", ()).states, {"time": 0.0}),
    "Scene": (
        oc.Scene,
        {"padding": 0.1, "exact": False, "accuracy": "obb",
         "time_budget": 0.01, "max_pairs": 9},
    ),
    "Scene.add": (
        scene().add,
        {"name": "a", "shape": Sphere(1), "pose": POSE, "padding": 0.1, "accuracy": "hull"},
    ),
    "Scene.add_boxes": (
        scene().add_boxes,
        {"names": ["p", "q"], "sizes": UNITS, "poses": [POSE] * 2, "accuracies": ["obb"] * 2,
         "shapes": [None, Sphere(0.5)]},
    ),
    "Scene.move": (scene().move, {"name": "a", "pose": POSE}),
    "Scene.move of several": (scene().move, {"name": ["a"], "pose": [POSE]}),
    "Scene.move_indices": (scene().move_indices, {"indices": [0], "poses": [POSE]}),
    "Scene.objects.poses_of": (scene().objects.poses_of, {"indices": [0]}),
    "Scene.set_twist": (scene().set_twist, {"name": "a", "twist": [0] * 6}),
    "Scene.objects.set_twists": (scene().objects.set_twists, {"indices": [0], "twists": [[0] * 6]}),
    "Scene.set_enabled": (scene().set_enabled, {"name": "a", "enabled": True}),
    "Scene.objects.set_enabled": (
        scene().objects.set_enabled, {"indices": [0], "enabled": [True]}
    ),
    "Scene.set_padding": (scene().set_padding, {"name": "a", "padding": 0.1}),
    "Scene.set_accuracy": (scene().set_accuracy, {"name": "a", "accuracy": "obb"}),
    "Scene.remove": (lambda name: scene().remove(name), {"name": "a"}),
    "Scene.objects.remove": (lambda indices: scene().objects.remove(indices), {"indices": [0]}),
    "Scene.index": (scene().index, {"name": "a"}),
    "Scene.name": (scene().name, {"index": 0}),
    "Scene.pose": (scene().pose, {"name": "a"}),
    "Scene.query": (
        scene().query,
        {"shape": Sphere(1), "pose": POSE, "padding": 0.1, "accuracy": "hull", "ignore": ["a"]},
    ),
    "Scene.cast_rays": (
        scene().cast_rays,
        {"origins": POINTS, "directions": UNITS, "max_distance": 1.0, "accuracy": "mesh"},
    ),
    "Scene.obb": (scene().obb, {"name": "a"}),
    "Scene.objects.shape_of": (scene().objects.shape_of, {"name": "a"}),
    "Scene.allow": (scene().allow, {"first": "a", "second": "b", "allowed": True}),
    "Scene.set_effect": (
        scene().set_effect,
        {"name": "clearance", "mode": "on", "objects": ["a"], "max_distance": 1.0},
    ),
    "Scene.check": (scene().check, {"effects": ["contacts"]}),
    "regions.Region": (oc.regions.Region, {"minimum": [0] * 3, "maximum": [1] * 3, "halo": 1.0}),
    "regions.RegionMerger": (
        oc.regions.RegionMerger, {"regions": ["west", "east"], "timeout": 0.5}
    ),
    "regions.RegionMerger.mark_alive": (
        oc.regions.RegionMerger(["west"]).mark_alive, {"region": "west", "objects": 3, "now": 1.0}
    ),
    "regions.RegionMerger.missing": (oc.regions.RegionMerger(["west"]).missing, {"now": 1.0}),
    "regions.RegionMerger.take": (
        oc.regions.RegionMerger(["west"]).take,
        {
            "region": "west", "stamp": 1, "now": 1.0, "topic": "a",
            "rows": np.zeros(1, [("ns", "i4"), ("id", "i4")]),
        },
    ),
    "regions.Region.holds": (REGION.holds, {"points": POINTS}),
    "regions.split_regions": (
        oc.regions.split_regions,
        {"minimum": [0] * 3, "maximum": [1] * 3, "parts": [2, 1, 1], "halo": 1.0},
    ),
    "Report.result": (scene().check().result, {"effect": "contacts"}),
    **{
        f"Scene.{name} =": (setting(name), {name.split(".")[-1]: value})
        for name, value in {
            "padding": 0.1, "accuracy": "obb", "time_budget": 0.1,
            "obstacle_points": POINTS, "max_pairs": 9, "region": REGION,
            "rules.allowed": [("a", "b", True)], "rules.check_only": [("a", "b")],
            "rules.allowed_within": ["a"], "objects.padding_overrides": [("a", 0.1)],
        }.items()
    },
}  # fmt: skip
#: Results, and values that name others: nobody makes them by hand.
RESULTS = {"Accuracy", "Report", "SceneDescription", "Shape", "Verdict"}
#: Left for where they come from: arrays that were checked, or no argument at all.
UNTRIED = {
    "trusted", "prepare", "clear", "corners", "world_bounds", "reset", "set", "counted",
    "any_collision", "single", "place", "rows", "local_box", "aabb", "of", "world_state",
}  # fmt: skip


def test_every_public_function_is_tried() -> None:
    public = {*oc.__all__, *oc.shapes.__all__} - {"shapes"}
    assert {re.split(r"\.| of ", name)[0] for name in FUNCTIONS} | RESULTS == public
    kinds = (
        oc.OBB, oc.AABB, oc.Boxes, oc.Capsules, oc.Scene, oc.MeshTrees, oc.PlacedMeshes, oc.Robot,
        oc.RobotScene,
    )  # fmt: skip
    for kind in kinds:
        methods = {name for name, _ in inspect.getmembers(kind, callable) if name[0] != "_"}
        tried = {name.split(".")[1] for name in FUNCTIONS if name.startswith(f"{kind.__name__}.")}
        assert methods - tried - UNTRIED == set(), kind


@pytest.mark.filterwarnings("ignore:.*far from unit length", "ignore:time_budget")
@pytest.mark.parametrize("label", FUNCTIONS)
def test_arguments_of_a_wrong_kind_are_refused_by_name(label: str) -> None:
    function, good = FUNCTIONS[label]
    if "none." not in str(good.get("path", "")):
        function(**good)
    for name in good:
        for wrong in WRONG:
            try:
                function(**{**good, name: wrong})
            except (ValueError, TypeError, KeyError) as error:
                text = str(error)
                words = [one.rstrip("s") for one in (name, *good)]  # lengths are told of others
                words = words if re.search("length|shape|one row", text) else words[:1]
                found = any(
                    re.search(rf"\b{word}", text)
                    for word in ("index", "accuracy", "effect", "no such file", "utf-8", *words)
                )
                assert found, (name, wrong, text)
                assert "._" not in text, text
                assert len(text) < 1000


def test_one_effect_may_be_asked_for_by_its_name_alone() -> None:
    report = scene().check(effects="contacts")
    assert list(report.costs) == ["contacts"]
    with pytest.raises(ValueError, match=r"effect must be one of .*, got 'contact'"):
        scene().check(effects="contact")


@each("name", ["acuracy", "time_buget", "paddings", "points", "anything"])
def test_what_a_scene_has_not_cannot_be_set(name: str) -> None:
    made = scene()
    with pytest.raises(AttributeError, match=rf"Scene has no '{name}'") as error:
        setattr(made, name, "mesh")
    near = {"acuracy": "accuracy", "time_buget": "time_budget", "paddings": "padding"}
    assert name not in near or f"did you mean {near[name]}?" in str(error.value)
    made.accuracy = "sphere"
    assert made.accuracy == oc.Accuracy.SPHERE


def test_a_budget_that_can_only_be_milliseconds_is_warned_about() -> None:
    with pytest.warns(UserWarning, match=r"time_budget is in seconds, got 5: 5 ms are 0\.005"):
        made = oc.Scene(time_budget=5)
    assert made.time_budget == 5.0
    made.time_budget = 0.005
    assert made.time_budget == 0.005


@pytest.mark.parametrize("length", [2.0, 1e-3, 1e200, 0.89, 1.11])
def test_a_quaternion_far_from_unit_length_is_warned_about_once(length: float) -> None:
    poses = np.tile(POSE, (3, 1))
    poses[1, 6] = length
    said = r"^poses \(quaternion\) far from unit length in row 1: .*; taken as normalised$"
    with pytest.warns(UserWarning, match=said) as caught:
        found = oc.Boxes.from_poses(poses, np.ones((3, 3)))
    assert [warning.filename for warning in caught] == [__file__]
    np.testing.assert_array_equal(found.rotations[1], np.eye(3))
    with pytest.warns(UserWarning, match="quaternion_xyzw far from unit length:"):
        oc.OBB.from_quaternion([0, 0, 0], [0, 0, 0, length], [1, 1, 1])
    made = oc.Scene(accuracy="mesh")
    for name in "abc":
        made.add(name, Sphere(1.0))
    with pytest.warns(UserWarning, match=said):
        made.move_indices([2, 0, 1], poses[[0, 1, 2]])
    made.check()  # not again
    moved = poses.copy()
    moved[0, 6], moved[2, 0], moved[2, 6] = -1.0, 1.0, 0.0
    with pytest.raises(ValueError, match="zero quaternion in row 2"):  # row 1 has not moved
        made.move_indices([2, 0, 1], moved)


@pytest.mark.parametrize("length", [0.7 * 2**0.5, 0.91, 1.09, 1.0])
def test_a_quaternion_near_unit_length_is_taken_as_it_is(length: float) -> None:
    oc.Boxes.from_poses([[*POSE[:6], length]], [[1, 1, 1]])


def test_a_level_is_a_name_a_number_or_itself() -> None:
    assert {level.label: int(level) for level in oc.Accuracy} == {
        "sphere": 0, "aabb": 1, "obb": 3, "hull": 5, "mesh": 6
    }  # fmt: skip
    for level in oc.Accuracy:
        values: tuple[Any, ...] = level.label, int(level), level
        for value in values:
            assert oc.Scene(accuracy=value).accuracy == level
    assert set(EFFECTS) == {"separations", "contacts", "clearance", "sweep", "points"}

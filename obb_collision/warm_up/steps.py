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

"""Steps that use kernels: running a step compiles or loads the kernels that it is named after.

A kernel is compiled for each type of argument. So a step calls the functions that users call, with
arrays of every layout: contiguous or not, read-only or not, of one object or many.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from importlib.util import find_spec
from pkgutil import resolve_name

import numpy as np

import obb_collision as oc
from obb_collision import shapes
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import quaternions_from_matrices
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.numerics.sorting import FEWEST_NUMBERS
from obb_collision.queries.convex.contacts import convex_contacts
from obb_collision.queries.convex.distances import (
    convex_distances,
    convex_may_collide,
    mesh_body_distances,
)
from obb_collision.queries.mesh_contacts.surfaces import within
from obb_collision.queries.meshes.hull_hull import PlacedHulls, hulls_may_collide
from obb_collision.queries.primitives.capsules import capsule_verdicts
from obb_collision.queries.sweep.convex_convex import BodyMotion, convex_sweeps
from obb_collision.queries.verdict.verdict import Separations
from obb_collision.scene.broad_phase.broad_phase import UNLIMITED, KeptTree, find_candidates
from obb_collision.scene.broad_phase.find_pairs import pairs_of_keys
from obb_collision.scene.effects import EFFECTS, LEVELS
from obb_collision.scene.refinement.budget import ABOVE
from obb_collision.warm_up.samples import (
    ARM,
    FEW_OBJECTS,
    OBJECTS,
    TETRAHEDRON,
    TETRAHEDRON_FACES,
    TURNED,
    batch,
    clouds,
    convex_bodies,
    row_of_boxes,
    triangle_tree,
    zoo,
)

BOXES = "boxes"
"""The step that every check of a scene needs."""
COARSE = "accuracy below obb"
"""The step of the levels below obb."""
BOUNDS, TREES, HULLS = "bounds of boxes", "trees", "pairs of capsules and hulls"
SWEPT = "motion of convex bodies"
SURFACES, CONVEX_PAIRS = "distances of meshes", "pairs of convex bodies"
"""Parts of other steps."""
MESSAGES = "messages"
"""The step that every message of a node needs."""

CLOUDS, CLOUDS_AT_MESH = "clouds", "clouds at mesh"
"""The steps of clouds beside other objects, up to "hull" and on "mesh", with all effects."""
SOURCES = "points of sensors"
"""The step that every source of a node needs."""
ZONES = "zones of a base"
"""The step of the gate of a mobile base."""
BODY_QUERIES = "queries of meshes"
"""The step of rays against shapes."""
ROBOTS = "robots"
"""The step that robots need."""


def effect_step(name: str) -> str:
    """Return the name of the step of an effect."""
    return f"effect {name}"


def accuracy_step(level: Accuracy) -> str:
    """Return the name of the step for objects on a level."""
    if level in ABOVE:
        return f"accuracy {level.name.lower()}"
    return BOXES if level == Accuracy.OBB else COARSE


def effect_level_step(name: str, level: Accuracy) -> str:
    """Return the name of the step of an effect on a level above OBB."""
    return f"{name} at {level.name.lower()}"


def task_of(step: str) -> Callable[[], None]:
    """Return the function of a step; KeyError for an unknown step."""
    task = STEPS[step]
    return resolve_name(task) if isinstance(task, str) else task


@cache
def run(step: str) -> None:
    """Run a step, once per process; KeyError for an unknown step."""
    task_of(step)()


def possible_steps() -> list[str]:
    """Return the steps that can be run here; that of messages needs ROS."""
    ros = all(find_spec(name) for name in ("rclpy", "visualization_msgs"))
    return [step for step in STEPS if ros or step not in NEEDS_ROS]


def _boxes() -> None:
    """Run checks of all kinds of objects, on the level "obb"."""
    row_of_boxes(FEW_OBJECTS).check()
    scene = row_of_boxes()  # another process compiles ``_bounds`` meanwhile
    quaternions_from_matrices(scene.boxes.arrays.rotations)  # of markers
    for moved in (0, 1, 1, OBJECTS // 3, OBJECTS // 2):  # the last one builds a new tree
        poses = scene.objects.poses_of(range(moved)) + np.array((0.1, 0, 0, 0, 0, 0, 0))
        scene.move_indices(np.arange(moved), poses)
        _ = scene.check().colliding
    scene.add("at the origin", oc.OBB((0.0, 0.0, 0.0), np.eye(3), (0.1, 0.1, 0.1)))
    _add_zoo(scene)
    scene.padding = 0.01
    scene.allow("1*", "2*")
    scene.check()
    scene.remove("at the origin")
    scene.check()
    crowded, names = oc.Scene(max_pairs=1), [str(number) for number in range(2 * OBJECTS)]
    crowded.add_boxes(names, np.ones((2 * OBJECTS, 3)), np.tile(TURNED, (2 * OBJECTS, 1)))
    assert crowded.check().truncated
    pairs_of_keys(batch(), np.zeros(2 * FEWEST_NUMBERS, np.int64), False)
    _bounds()  # in this process, too
    scene.region = oc.regions.Region((-np.inf,) * 3, (1.0, np.inf, np.inf), 1.0)
    scene.check()


def _add_zoo(scene: oc.Scene) -> None:
    for kind, members in zoo().items():
        for number, shape in enumerate(members):
            scene.add(f"{kind} {number}", shape)


def _coarse() -> None:
    """Run the levels below "obb"."""
    scene = row_of_boxes()
    _add_zoo(scene)
    for level in Accuracy:
        if level <= Accuracy.OBB:
            scene.accuracy = level
            scene.check()
            scene.move_indices(np.array([1]), np.array([(0.7, 0.0, 0.1 * level, 0, 0, 0, 1)]))
            scene.check()
            oc.find_pairs(scene.boxes, accuracy=level)


def _meshes() -> None:
    """Run the level "mesh", first the kernels that need no tree."""
    body = oc.PlacedMeshes.from_poses(triangle_tree(), np.zeros(1, np.int64), [TURNED])
    oc.verdicts(body, body)
    _level(Accuracy.MESH)


def _level(level: Accuracy) -> None:
    """Run a level above "obb" on all kinds of shapes, also with exact verdicts.

    Levels to which a time budget may fall back, and effects on the level, are other steps.
    """
    for exact, padding in ((False, 0.0), (True, 0.0), (False, 0.01)):
        scene = oc.Scene(accuracy=level, exact=exact)
        _add_crowd(scene, padding)
        scene.check()
        scene.move("1", TURNED)
        scene.check()


def _add_crowd(scene: oc.Scene, padding: float) -> None:
    """Add shapes of all kinds that overlap."""
    for number, shape in enumerate(shape for kind in zoo().values() for shape in kind):
        pose = (0.02 * number, 0.01 * number, 0.0, 0.0, 0.0, 0.6, 0.8)
        scene.add(str(number), shape, pose, padding=padding)
    scene.add("padded", shapes.Sphere(0.2), padding=0.01)


def _clouds(*levels: Accuracy) -> None:
    """Check clouds beside shapes of all kinds, with all effects but those of points."""
    for level in levels:
        scene = oc.Scene(accuracy=level)
        _add_crowd(scene, 0.0)
        for number, points in enumerate(clouds()):
            scene.add(f"cloud {number}", shapes.Cloud(points, 0.1 * number))
        scene.add("far", shapes.Cloud(np.eye(3)), (9.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        scene.set_twist("far", (-9.0, 0.0, 0.0, 0.1, 0.0, 0.0))
        for name in EFFECTS:
            scene.set_effect(name, "on")
        scene.check()
        scene.move("far", (-9.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        scene.check()
        scene.cast_rays(np.zeros((1, 3)), np.ones((1, 3)))


def _hulls() -> None:
    """Run the level "hull", first the kernels that take longest."""
    bodies, row = convex_bodies(), np.zeros(1, np.int64)
    convex_may_collide(bodies, bodies, row, row)
    _level(Accuracy.HULL)


def _effect_on(name: str, level: Accuracy) -> None:
    """Run an effect on a level above "obb", first the slowest kernels; pairs stay on boxes."""
    if name == "points":
        return _points_on(level)
    if name == "sweep":
        return _sweep_on(level)
    if level == Accuracy.MESH and name == "clearance":
        _surfaces()
    elif level == Accuracy.MESH and name == "contacts":
        _mesh_depths()  # another process compiles ``_convex_pairs`` meanwhile
    bodies, row = convex_bodies(), np.zeros(1, np.int64)
    if name == "contacts":
        _convex_pairs()
    convex_distances(bodies, bodies, row, row)
    if level == Accuracy.MESH and name == "contacts":
        body = oc.PlacedMeshes.from_poses(triangle_tree(), row, [TURNED])
        oc.contacts(body, body)  # another process compiles ``_trees`` meanwhile
    for padding in (0.0, 0.01):
        scene = oc.Scene()
        scene.set_effect(name, accuracy=level.name.lower())
        _add_crowd(scene, padding)
        scene.check(name)
        scene.move("1", TURNED)
        scene.check(name)


def _points_on(level: Accuracy) -> None:
    """Find points in shapes, with clouds of every layout."""
    scene = oc.Scene()
    _add_crowd(scene, 0.0)
    scene.set_effect("points", "on", accuracy=level.name.lower())
    for points in clouds():
        scene.obstacle_points = points
        scene.check()


def _sweep_boxes() -> None:
    boxes = batch()
    moving = oc.MovingBoxes(
        boxes, oc.Boxes(boxes.centers + 0.1, boxes.rotations, boxes.half_extents)
    )
    oc.sweeps(moving, moving)


def _effect(name: str) -> None:
    """Run an effect on boxes that move, with clouds of every layout."""
    FIRST.get(name, row_of_boxes)()
    scene = row_of_boxes()
    scene.set_effect(name, "on")
    scene.objects.set_twists(np.arange(OBJECTS), np.full((OBJECTS, 6), 0.1))
    for number, points in enumerate(clouds() if name == "points" else [np.zeros((4, 3))] * 4):
        scene.obstacle_points = points
        scene.check()
        poses = np.zeros((OBJECTS, 7))
        poses[:, 0] = (0.25, 3.0, 0.9, 1.0)[number % 4] * np.arange(OBJECTS)
        poses[:, 6] = 1.0
        scene.move_indices(np.arange(OBJECTS), poses)
    scene.check()
    scene.set_effect(name, objects=["1"])
    if name == "contacts":
        scene.set_effect(name, max_points=8)
    scene.check()
    scene.move_indices(np.array([1]), np.array([(0.7, 0.0, 0.1, 0, 0, 0, 1)]))
    scene.objects.set_twists(np.array([1]), np.array([(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)]))
    scene.check()


def _fits() -> None:
    """Fit boxes, and run all queries of single boxes."""
    rng = np.random.default_rng(0)
    first = oc.OBB.from_points(rng.random((20, 3)))
    oc.OBB(*shapes.Box((1.0, 1.0, 1.0)).local_box)
    oc.OBB((0.0, 0.0, 0.0), np.eye(3) * (1.0 + 1e-9), (1.0, 1.0, 1.0))  # axes to be corrected
    second = oc.OBB.from_quaternion((0.1, 0.2, 0.3), (0.0, 0.0, 0.6, 0.8), (1.0, 1.0, 1.0))
    third = oc.OBB.from_aabb(oc.AABB((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
    _ = first.separation(second), second.intersects(third), first.quaternion, first.corners()
    _ = second.contains(np.zeros(3)), second.contains(np.zeros((2, 3)))
    second.transformed(np.diag([1.0, 2.0, 1.0, 1.0]))
    _ = shapes.Hull(TETRAHEDRON).local_box, shapes.Mesh(TETRAHEDRON, TETRAHEDRON_FACES).local_box


def _pair_queries() -> None:
    """Run all queries of pairs of boxes."""
    boxes, pairs = batch(), np.array([(0, 1), (0, 2), (2, 3)])
    again = oc.Boxes(boxes.centers + 0.1, boxes.rotations, boxes.half_extents)
    oc.verdicts(boxes, again, exact=True)
    oc.find_pairs(boxes, exact=True)
    oc.find_pairs(boxes, again)
    oc.iou(boxes, again)
    oc.any_collision(boxes)
    oc.any_collision(boxes, again, exact=True)
    oc.contacts(boxes, again, pairs)
    oc.clearances(boxes, again, pairs)
    oc.separations(boxes, again)
    for with_contacts in (True, False):
        for moving in (
            oc.MovingBoxes(boxes, again),
            oc.MovingBoxes.from_twists(boxes, np.full((4, 6), 0.1), 1.0),
        ):
            oc.sweeps(moving, boxes, pairs, contacts=with_contacts)
            oc.sweeps(moving, moving, pairs, contacts=with_contacts)


def _other_queries() -> None:
    """Run the queries of rays, planes, points and capsules."""
    boxes, zeros = batch(), np.zeros((4, 3))
    oc.cast_rays(boxes, zeros, zeros + 1.0)
    oc.cast_segments(boxes, zeros, zeros + 1.0)
    oc.separations(boxes, oc.HalfSpaces(zeros, zeros + 1.0))
    oc.points_inside(boxes, zeros, each_point=True)
    capsules = oc.Capsules(zeros, zeros + 1.0, np.full(4, 0.1))
    for other in (capsules, boxes):
        oc.separations(capsules, other)


def _mesh_queries() -> None:
    """Run the queries of meshes without a scene."""
    trees = oc.MeshTrees.build(np.array(TETRAHEDRON), np.array(TETRAHEDRON_FACES))
    poses = np.tile(TURNED, (2, 1))
    bodies = oc.PlacedMeshes.from_poses(trees, np.zeros(2, np.int64), poses)
    oc.triangle_pairs(bodies, bodies)
    oc.clearances(bodies, bodies)
    oc.sweeps(bodies, bodies, duration=1.0)
    oc.contacts(bodies, bodies)
    oc.cast_rays(bodies, np.zeros((1, 3)), np.ones((1, 3)))
    oc.points_inside(bodies, np.zeros((1, 3)))
    oc.verdicts(bodies, bodies, exact=True)
    scene = oc.Scene()
    _add_crowd(scene, 0.01)
    for level in ("hull", "mesh"):
        scene.cast_rays(np.zeros((1, 3)), np.ones((1, 3)), accuracy=level)


def _sweep_on(level: Accuracy) -> None:
    """Sweep shapes on a level above "obb", first the slowest kernels; pairs stay on boxes."""
    if level == Accuracy.MESH:
        body = oc.PlacedMeshes.from_poses(triangle_tree(), np.zeros(1, np.int64), [TURNED])
        oc.sweeps(body, body, duration=1.0)
    else:
        _swept_hulls()
    scene = oc.Scene()
    scene.set_effect("sweep", "on", accuracy=level.name.lower())
    _add_crowd(scene, 0.01)
    scene.add("far", shapes.Cone(0.2, 0.4), (9.0, 0.0, 0.0, 0.0, 0.0, 0.6, 0.8))
    scene.check()
    for x in (-9.0, 9.0):
        scene.move("far", (x, 0.0, 0.0, 0.0, 0.6, 0.0, 0.8))
        scene.set_twist("far", (-x, 0.0, 0.0, 0.1, 0.1, 0.1))
        assert scene.check().swept.passed.pairs.size


def _bounds() -> None:
    """Find overlapping bounds, of all boxes and of a few that move."""
    low = np.random.default_rng(0).random((OBJECTS, 3))
    find_candidates(low, low + 0.2)
    many = np.arange(2 * FEWEST_NUMBERS)
    line = np.column_stack([many, many, many]).astype(np.float64)
    find_candidates(line, line + 0.5)
    tree = KeptTree(low, low + 0.2)
    row = np.zeros(1, np.int64)
    tree.update(row)
    tree.pairs_of(row, UNLIMITED)


def _surfaces() -> None:
    """Compute the distance of a mesh from another, and from a convex body."""
    row = np.zeros(1, np.int64)
    bodies = oc.PlacedMeshes.from_poses(triangle_tree(), row, [TURNED])
    oc.clearances(bodies, bodies)
    mesh_body_distances(bodies, np.zeros(1), convex_bodies(), row, row)


def _mesh_depths() -> None:
    """Compute how deep two meshes overlap."""
    body = oc.PlacedMeshes.from_poses(triangle_tree(), np.zeros(1, np.int64), [TURNED])
    pairs, along = np.zeros((1, 2), np.int64), np.eye(3)[:1]
    outer = Separations(pairs, np.full(1, -1.0), along, along.copy())
    within(outer, body, np.zeros(1), body, np.zeros(1))


def _trees() -> None:
    """Build a tree."""
    oc.MeshTrees.build(np.array(TETRAHEDRON), np.array(TETRAHEDRON_FACES))


def _hulls_of_pairs() -> None:
    """Decide pairs of capsules, boxes and hulls."""
    zeros = np.zeros((4, 3))
    capsules = oc.Capsules(zeros, zeros + 1.0, np.full(4, 0.1))
    for other in (batch(), capsules):
        capsule_verdicts(capsules, other)
    row = np.zeros(1, np.int64)
    hull = PlacedHulls(Hulls.of(np.array(TETRAHEDRON)), row, zeros[:1], np.eye(3)[None])
    hulls_may_collide(hull, hull, row, row)


def _convex_pairs() -> None:
    """Compute distance, depth and contacts of two convex bodies."""
    bodies, row = convex_bodies(), np.zeros(1, np.int64)
    distances, _ = convex_distances(bodies, bodies, row, row)
    convex_contacts(bodies, bodies, np.zeros((1, 2), np.int64), row, row, 4, distances)


def _swept_hulls() -> None:
    """Sweep two convex bodies."""
    bodies, row, ones = convex_bodies(), np.zeros((1, 3)), np.ones(1)
    motion = BodyMotion(row, row, 1.0, np.eye(3)[None], row, row, ones, ones)
    convex_sweeps(bodies, motion, np.zeros((1, 2), np.int64), np.zeros(1), 1e-4)


def _robots() -> None:
    """Run checks, distances, motions and proofs of a robot, with every kind of shape."""
    robot = oc.Robot.from_urdf(ARM)
    robot.link_poses(np.zeros(3))
    scene = oc.Scene()
    scene.add("floor", oc.shapes.Box((4.0, 4.0, 0.1)), (0.0, 0.0, -0.3, 0.0, 0.0, 0.0, 1.0))
    scene.add("ball", oc.shapes.Sphere(0.1), (0.3, 0.0, 0.6, 0.0, 0.0, 0.0, 1.0))
    scene.add("pole", oc.shapes.Cylinder(0.1, 1.0), (0.5, 0.0, 0.6, 0.0, 0.0, 0.0, 1.0))
    checker = oc.RobotScene([robot], scene)
    states = np.array([[0.0, 0.0, 0.0], [1.5, 0.5, 1.0], [0.5, 1.9, 1.9]])
    for accuracy in ("sphere", "aabb", "obb", "hull", "mesh"):
        checker.accuracy = accuracy
        checker.check(states)
        checker.check(states, all_pairs=True)
        checker.check_motions(states[:2], states[1:])
        checker.distances(states)
    checker.distances(states, jacobian=True)
    checker.check_path(states)
    checker.displacements(states, states)
    robot.prove_pairs(1.0)


EFFECT_LEVELS = tuple((name, level) for name, levels in LEVELS.items() for level in levels)
"""Effects, each on a level above OBB."""
FIRST: dict[str, Callable[[], object]] = {
    "sweep": _sweep_boxes,
    "separations": lambda: oc.separations(batch(), batch()),
}
"""The slowest kernels of effects, to run first while another process compiles the rest."""
STEPS: dict[str, Callable[[], None] | str] = {
    # in this order two processes compile the fewest kernels twice
    BOXES: _boxes,
    BOUNDS: _bounds,
    accuracy_step(Accuracy.MESH): _meshes,
    TREES: _trees,
    HULLS: _hulls_of_pairs,
    effect_step("sweep"): lambda: _effect("sweep"),
    **{effect_step(name): (lambda name=name: _effect(name)) for name in EFFECTS},  # type: ignore[misc]
    accuracy_step(Accuracy.HULL): _hulls,
    **{
        effect_level_step(*on): (lambda on=on: _effect_on(*on))  # type: ignore[misc]
        for on in EFFECT_LEVELS
    },
    SWEPT: _swept_hulls,
    SURFACES: _surfaces,
    CONVEX_PAIRS: _convex_pairs,
    COARSE: _coarse,
    "queries of pairs": _pair_queries,
    "queries of rays, planes, points, capsules": _other_queries,
    BODY_QUERIES: _mesh_queries,
    "fits": _fits,
    CLOUDS: lambda: _clouds(Accuracy.OBB, Accuracy.HULL),
    CLOUDS_AT_MESH: lambda: _clouds(Accuracy.MESH),
    ROBOTS: _robots,
    # by name, as these are in layers above
    ZONES: "obb_collision.zones.gate:compile_kernels",
    SOURCES: "obb_collision.node.inputs.cuts:compile_kernels",
    MESSAGES: "obb_collision.node.inputs.batch:compile_kernels",
}
"""The function of each step, or its name."""
NEEDS_ROS = (MESSAGES, SOURCES)
PARTS = {
    BOXES: (BOUNDS,),
    accuracy_step(Accuracy.HULL): (HULLS,),
    accuracy_step(Accuracy.MESH): (SURFACES, TREES, HULLS),
    effect_level_step("clearance", Accuracy.MESH): (TREES,),
    effect_level_step("contacts", Accuracy.MESH): (CONVEX_PAIRS, TREES),
    effect_level_step("points", Accuracy.MESH): (TREES,),
    effect_level_step("separations", Accuracy.MESH): (SURFACES, TREES),
    effect_level_step("sweep", Accuracy.MESH): (SWEPT,),
}
"""Parts of the longest steps for a second process: kernels that these call last."""


def with_parts(wanted: Iterable[str]) -> list[str]:
    """Return steps and their parts, in the order of ``STEPS``."""
    chosen = {part for step in wanted for part in (step, *PARTS.get(step, ()))}
    return [step for step in STEPS if step in chosen]

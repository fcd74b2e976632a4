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

"""Peers that check states of a robot: pinocchio with coal, and MuJoCo.

Both get the same pairs, and import their libraries when they are made: ``ImportError`` where there
are none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from obb_collision.geometry.poses import rotate_vectors
from obb_collision.robots.kinematics.kinematics import FIXED, PRISMATIC
from obb_collision.robots.robot import Robot
from obb_collision.scene_files.description import SceneObject
from obb_collision.shapes import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from obb_collision.typing import Floats, Integers, Mask

#: Before the names of links in MuJoCo, which has a body "world" of its own.
LINK = "link "
#: Whether states (n, joints) collide, (n,).
CheckStates = Callable[[Floats], Mask]


@dataclass(frozen=True, eq=False)
class Case:
    """A robot in a world, and which pairs count: of its shapes (p, 2), and each with the world.

    Shapes are numbered link by link; allowed (shapes, objects): pairs that do not count.
    """

    robot: Robot
    file: str
    world: Sequence[SceneObject]
    pairs: Integers
    allowed: Mask

    @property
    def shapes(self) -> list[tuple[int, Shape, Any]]:
        """Link, shape and pose of all shapes of the robot."""
        robot = self.robot
        return [(row, *placed) for row, shapes in enumerate(robot.shapes) for placed in shapes]

    def joint_values(self, states: Floats) -> dict[str, Floats]:
        """Return the values (n,) of all joints with one, those that mimic others, too."""
        tree, rows = self.robot.tree, {name: k for k, name in enumerate(self.robot.link_names)}
        values = {}
        for joint in self.robot.joints:
            row = rows[joint.child]
            if tree.kinds[row] not in (FIXED,):
                column = states[:, tree.columns[row]]
                values[joint.name] = tree.multipliers[row] * column + tree.offsets[row]
        return values


def vertices_of(mesh: Mesh) -> Floats:
    """Return the vertices of a mesh, scaled."""
    return np.asarray(mesh.vertices * np.array(mesh.scale))


def configurations(model: Any, case: Case, states: Floats) -> Floats:
    """Return states as pinocchio has them, for a model of its own of the same robot."""
    rows = np.zeros((len(states), model.nq))
    for name, values in case.joint_values(states).items():
        joint = model.getJointId(name)
        first = model.idx_qs[joint]
        if model.nqs[joint] == 2:  # pinocchio has cosine and sine of continuous joints
            rows[:, first], rows[:, first + 1] = np.cos(values), np.sin(values)
        else:
            rows[:, first] = values
    return rows


def pinocchio_kinematics(case: Case) -> Callable[[Floats], None]:
    """Return pinocchio's kinematics of states, one after the other: the poses of the joints."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(case.file)
    data = model.createData()

    def compute(states: Floats) -> None:
        for row in configurations(model, case, states):
            pin.forwardKinematics(model, data, row)

    return compute


def coal_checker(case: Case, triangles: bool) -> CheckStates:
    """Return pinocchio's check with a broad phase that stops at the first pair."""
    import coal
    import pinocchio as pin

    def geometry(shape: Shape) -> Any:
        if isinstance(shape, Box):
            return coal.Box(*shape.size)
        if isinstance(shape, Sphere):
            return coal.Sphere(shape.radius)
        if isinstance(shape, Cylinder):
            return coal.Cylinder(shape.radius, shape.length)
        if isinstance(shape, Capsule):
            return coal.Capsule(shape.radius, shape.length)
        if not isinstance(shape, Mesh):
            raise NotImplementedError(type(shape).__name__)
        points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        for point in vertices_of(shape):
            points.append(point)
        for face in shape.faces.tolist():
            faces.append(coal.Triangle(*face))
        model = coal.BVHModelOBBRSS()
        model.beginModel(len(faces), len(points))
        model.addSubModel(points, faces)
        model.endModel()
        if triangles:
            return model
        model.buildConvexHull(True, "Qt")
        return model.convex

    model = pin.buildModelFromUrdf(case.file)
    shapes = pin.GeometryModel()
    for number, (link, shape, pose) in enumerate(case.shapes):
        frame = model.frames[model.getBodyId(case.robot.link_names[link])]
        place = frame.placement * pin.XYZQUATToSE3(np.array(pose))
        joint, parent = frame.parentJoint, model.getBodyId(case.robot.link_names[link])
        name = f"shape{number}"
        shapes.addGeometryObject(pin.GeometryObject(name, joint, parent, place, geometry(shape)))
    count = len(case.shapes)
    for item in case.world:
        place = pin.XYZQUATToSE3(np.array(item.pose))
        shapes.addGeometryObject(pin.GeometryObject(item.name, 0, 0, place, geometry(item.shape)))
    for i, j in case.pairs.tolist():
        shapes.addCollisionPair(pin.CollisionPair(i, j))
    for i, j in np.argwhere(~case.allowed).tolist():
        shapes.addCollisionPair(pin.CollisionPair(i, count + j))
    data, found = model.createData(), shapes.createData()
    manager = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(model, shapes, found)

    kept = shapes, found  # pinocchio does not, and reads freed memory

    def check(states: Floats) -> Mask:
        assert kept
        rows = configurations(model, case, states)
        return np.array([pin.computeCollisions(model, data, manager, row, True) for row in rows])

    return check


def mujoco_checker(case: Case) -> CheckStates:
    """Return MuJoCo's check: all contacts of each state."""
    import mujoco

    spec = mujoco.MjSpec()
    names, tree = case.robot.link_names, case.robot.tree
    joints = {joint.child: joint.name for joint in case.robot.joints}
    bodies: list[Any] = []

    def add(body: Any, name: str, shape: Shape, pose: Any) -> None:
        geom = body.add_geom()
        geom.name, geom.pos = name, pose[:3]
        geom.quat = [pose[6], *pose[3:6]]
        kinds = mujoco.mjtGeom
        if isinstance(shape, Box):
            geom.type, geom.size = kinds.mjGEOM_BOX, np.array(shape.size) / 2
        elif isinstance(shape, Sphere):
            geom.type, geom.size = kinds.mjGEOM_SPHERE, [shape.radius, 0, 0]
        elif isinstance(shape, (Cylinder, Capsule)):
            capsule = isinstance(shape, Capsule)
            geom.type = kinds.mjGEOM_CAPSULE if capsule else kinds.mjGEOM_CYLINDER
            geom.size = [shape.radius, shape.length / 2, 0]
        elif isinstance(shape, Mesh):
            mesh = spec.add_mesh()
            mesh.name, mesh.uservert = name, vertices_of(shape).ravel()
            mesh.userface = shape.faces.ravel()
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            geom.type, geom.meshname = kinds.mjGEOM_MESH, name
        else:
            raise NotImplementedError(type(shape).__name__)

    for row, name in enumerate(names):
        parent = spec.worldbody if row == 0 else bodies[tree.parents[row]]
        body = parent.add_body()
        body.name, body.pos = LINK + name, tree.translations[row]
        x, y, z, w = tree.rotations[row]
        body.quat, body.mass, body.inertia = [w, x, y, z], 1.0, [1.0, 1.0, 1.0]
        body.explicitinertial = True
        if tree.kinds[row] != FIXED:
            joint = body.add_joint()
            hinge = tree.kinds[row] < PRISMATIC
            kind = mujoco.mjtJoint
            joint.type = kind.mjJNT_HINGE if hinge else kind.mjJNT_SLIDE
            joint.name = joints[name]
            turn = tree.rotations[row] * (-1.0, -1.0, -1.0, 1.0)
            joint.axis = rotate_vectors(turn, tree.directions[row])
        bodies.append(body)
    for number, (link, shape, pose) in enumerate(case.shapes):
        add(bodies[link], f"shape{number}", shape, pose)
    for item in case.world:
        add(spec.worldbody, item.name, item.shape, item.pose)
    owners = [link for link, _, _ in case.shapes]
    checked = {tuple(sorted((owners[i], owners[j]))) for i, j in case.pairs.tolist()}
    for i in range(len(names)):
        for j in range(i + 1, len(names)):
            if (i, j) not in checked:
                exclude = spec.add_exclude()
                exclude.bodyname1, exclude.bodyname2 = LINK + names[i], LINK + names[j]
    model = spec.compile()
    data = mujoco.MjData(model)

    def check(states: Floats) -> Mask:
        rows = np.zeros((len(states), model.nq))
        for name, values in case.joint_values(states).items():
            rows[:, model.joint(name).qposadr[0]] = values
        found = np.empty(len(states), np.bool_)
        for n, row in enumerate(rows):
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            found[n] = data.ncon > 0
        return found

    return check


PEERS: dict[str, tuple[Callable[[Case], CheckStates], str]] = {
    "pinocchio + coal, hulls": (lambda case: coal_checker(case, False), "pin"),
    "pinocchio + coal, triangles": (lambda case: coal_checker(case, True), "pin"),
    "MuJoCo": (mujoco_checker, "mujoco"),
}
"""What makes each peer, and the distribution it comes with."""
TRUTH = "pinocchio + coal, triangles"

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

"""Contestants of the full step, this library and its peers, and the scenes that they get.

Each is built once from half extents and first poses, because a tree is only as good as the poses
it is built from. ``step`` takes a frame in the form that suits it, sets the poses of the
moved boxes, updates, and returns its raw answer; ``pairs`` turns that into rows outside the timing.

Scenes have every form that a broad phase meets. A box collides with an eighth to two others on
average. All that move do so a little in each frame, as in a simulation or at the rate of a robot:
broad phases that update a tree are designed for that.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from obb_collision.boxes import Boxes
from obb_collision.geometry.poses import matrices_from_quaternions
from obb_collision.scene.broad_phase.find_pairs import find_pairs
from obb_collision.scene.scene import Scene
from obb_collision.typing import Floats, Rows

#: Half extents of ordinary boxes, metres, and their mean.
EXTENTS = (0.05, 0.5)
MEAN = 0.275
#: Cubic metres per box, and per box of a cluster; square metres in a plane, metres on a line.
VOLUME_PER_BOX, CLUSTER_VOLUME, AREA_PER_BOX, LENGTH_PER_BOX = 1.75, 0.6, 1.75, 1.5
#: Boxes of a cluster, metres between clusters, and walls and floors through a scene.
CLUSTER_BOXES, CLUSTER_DISTANCE, WALLS = 50, 20.0, 12
#: Half thickness of a wall, metres.
THICKNESS = 0.05
#: Edge of a crate and distance of their centres, metres.
CRATE, PITCH = 0.5, 0.51
#: Coordinates far from the origin, metres; decades of sizes around a metre, each way.
FAR_OFFSET, DECADES = 1e7, 3.0
#: Maximum displacement of a box of mean size along each axis per frame, metres, and maximum
#: rotation about each, radians. Smaller boxes move less.
FRAME_STEP, FRAME_TURN = 0.02, 0.05
#: Frames of motion, which are gone through there and back.
MOTION_FRAMES = 8


@dataclass(frozen=True)
class Frame:
    """Poses (n, 7) of all boxes at one moment, and the rows (k,) of those that moved."""

    poses: Floats
    rows: Rows

    @cached_property
    def moved(self) -> Floats:
        """Poses (k, 7) of those that moved."""
        return self.poses[self.rows]

    @cached_property
    def rotations(self) -> Floats:
        """Rotation matrices (k, 3, 3) of those that moved."""
        return matrices_from_quaternions(self.moved[:, 3:])


def _extents(rng: np.random.Generator, n: int) -> Floats:
    return rng.uniform(*EXTENTS, (n, 3))


def _in_room(rng: np.random.Generator, n: int, volume: float) -> Floats:
    half = 0.5 * volume ** (1 / 3)
    return rng.uniform(-half, half, (n, 3))


def uniform(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Boxes of 0.1 to 1 m all over a room."""
    return _extents(rng, n), _in_room(rng, n, VOLUME_PER_BOX * n)


def plane(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Boxes with their centres in a plane."""
    half = 0.5 * np.sqrt(AREA_PER_BOX * n)
    return _extents(rng, n), rng.uniform(-half, half, (n, 3)) * [1.0, 1.0, 0.0]


def line(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Boxes with their centres on a line."""
    return _extents(rng, n), rng.uniform(0.0, LENGTH_PER_BOX * n, (n, 1)) * [1.0, 0.0, 0.0]


def walls(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Walls and floors across a room of small boxes."""
    half_extents, centers = uniform(rng, n)
    count = min(WALLS, n // 2)
    half_extents[:count] = 0.5 * (VOLUME_PER_BOX * n) ** (1 / 3)
    half_extents[np.arange(count), np.arange(count) % 3] = THICKNESS
    across = np.arange(count) % 3 == np.arange(3)[:, None]
    centers[:count] *= across.T
    return half_extents, centers


def clusters(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Tight clusters, far from one another."""
    count = -(-n // CLUSTER_BOXES)
    places = _in_room(rng, count, count * CLUSTER_DISTANCE**3)
    inside = _in_room(rng, n, CLUSTER_BOXES * CLUSTER_VOLUME)
    return _extents(rng, n), places[np.arange(n) % count] + inside


def identical(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Equal crates side by side and on top of each other, in a grid."""
    side = int(np.ceil(n ** (1 / 3)))
    cells = np.stack(np.unravel_index(np.arange(n), (side, side, side)), axis=1)
    return np.full((n, 3), 0.5 * CRATE), PITCH * cells.astype(np.float64)


def decades(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Sizes over six decades, from millimetres to kilometres."""
    sizes = 10.0 ** rng.uniform(-DECADES, DECADES, (n, 1))
    reach = np.mean((sizes + rng.permutation(sizes)) ** 3) / (2.0 * MEAN) ** 3
    return sizes * rng.uniform(0.5, 1.0, (n, 3)), _in_room(rng, n, n * VOLUME_PER_BOX * reach)


def far(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Boxes all over a room, with coordinates of ten million metres."""
    half_extents, centers = uniform(rng, n)
    return half_extents, centers + FAR_OFFSET


#: Half extents (n, 3) and centres (n, 3) by name.
FORMS: dict[str, Callable[[np.random.Generator, int], tuple[Floats, Floats]]] = {
    maker.__name__: maker
    for maker in (uniform, plane, line, walls, clusters, identical, decades, far)
}
#: Forms whose boxes stay parallel to the axes.
PARALLEL_FORMS = {"identical"}


def make_frames(form: str, count: int, moving: float, seed: int) -> tuple[Floats, list[Frame]]:
    """Return half extents (n, 3) and frames in which a share of the boxes moves."""
    rng = np.random.default_rng(seed)
    half_extents, centers = FORMS[form](rng, count)
    rotations = Rotation.identity(count) if form in PARALLEL_FORMS else Rotation.random(count, rng)
    if form == "walls":
        straight = np.arange(count) < min(WALLS, count // 2)
        rotations = Rotation.from_quat(
            np.where(straight[:, None], [0.0, 0.0, 0.0, 1.0], rotations.as_quat())
        )
    rows = np.sort(rng.choice(count, round(moving * count), replace=False))
    steps = FRAME_STEP * np.minimum(1.0, half_extents[rows].mean(axis=1, keepdims=True) / MEAN)
    turns = np.minimum(FRAME_TURN, FRAME_STEP / half_extents[rows].max(axis=1, keepdims=True))
    turns *= form not in PARALLEL_FORMS
    poses = np.concatenate([centers, rotations.as_quat()], axis=1)
    frames = [Frame(poses, rows)]
    for _ in range(MOTION_FRAMES - 1):
        poses = poses.copy()
        poses[rows, :3] += steps * rng.uniform(-1.0, 1.0, (len(rows), 3))
        if len(rows):  # scipy before 1.15 makes no empty rotations
            turned = Rotation.from_rotvec(turns * rng.uniform(-1.0, 1.0, (len(rows), 3)))
            poses[rows, 3:] = (turned * Rotation.from_quat(poses[rows, 3:])).as_quat()
        frames.append(Frame(poses, rows))
    return half_extents, frames + frames[-2:0:-1]  # there and back: no jump at the end


#: More contacts than there are: the searches of coal and python-fcl end at a maximum.
MOST_CONTACTS = 10**8
#: Share of moved boxes below which the broad phase is updated box by box.
FEW_MOVED = 0.5
#: The broad phases of coal by a short name: those that miss no pair, and are best somewhere.
COAL_MANAGERS = {
    "tree": "DynamicAABBTreeCollisionManager",
    "SSaP": "SSaPCollisionManager",
    "naive": "NaiveCollisionManager",
}
#: Columns of a pose as MuJoCo has them.
WXYZ = [0, 1, 2, 6, 3, 4, 5]


class Stepper(Protocol):
    """A way to do the step."""

    def step(self, frame: Frame) -> Any:
        """Set the poses and find the pairs."""

    def pairs(self, answer: Any) -> Rows:
        """Return the pairs (m, 2) of what ``step`` returned, in any order."""


class OurPairs:
    """``find_pairs`` of this package from poses, validated as always."""

    def __init__(self, half_extents: Floats, poses: Floats) -> None:
        self._half_extents = half_extents

    def step(self, frame: Frame) -> Any:
        """Build the boxes and find the pairs."""
        return find_pairs(Boxes.from_poses(frame.poses, self._half_extents))

    def pairs(self, answer: Any) -> Rows:
        """Return the colliding pairs of the last step."""
        return answer


class OurScene:
    """``Scene`` of this package: named objects, with the effects asked for."""

    def __init__(self, effects: tuple[str, ...], half_extents: Floats, poses: Floats) -> None:
        self._effects = effects
        self._scene = Scene()
        names = [f"box/{k}" for k in range(len(poses))]
        self._indices = self._scene.add_boxes(names, 2.0 * half_extents, poses)

    def step(self, frame: Frame) -> Any:
        """Move what moved and check."""
        if len(frame.rows):
            self._scene.move_indices(self._indices[frame.rows], frame.moved)
        return self._scene.check(self._effects)

    def pairs(self, answer: Any) -> Rows:
        """Return the pairs of the report."""
        return answer.pairs


class Contestant(NamedTuple):
    """A library that does the step: its name, module and distribution, and how it is built.

    threads: how many it uses, None for as many as this library is set to.
    """

    name: str
    module: str
    make: Callable[[Floats, Floats], Stepper]
    distribution: str = ""
    threads: int | None = 1

    @property
    def installed(self) -> bool:
        """Whether its module is there."""
        return importlib.util.find_spec(self.module) is not None


class Mujoco:
    """MuJoCo: free bodies, kinematics and collision only; makes contact manifolds."""

    def __init__(self, half_extents: Floats, poses: Floats) -> None:
        self._mujoco = importlib.import_module("mujoco")
        bodies = "".join(
            f'<body><freejoint/><geom type="box" size="{x!r} {y!r} {z!r}"/></body>'
            for x, y, z in half_extents.tolist()
        )
        xml = f'<mujoco><size memory="1G"/><worldbody>{bodies}</worldbody></mujoco>'
        self._model = self._mujoco.MjModel.from_xml_string(xml)
        self._data = self._mujoco.MjData(self._model)
        self._poses = self._data.qpos.reshape(-1, 7)
        self._poses[:] = poses[:, WXYZ]

    def step(self, frame: Frame) -> Any:
        """Set the poses, update, collide."""
        self._poses[frame.rows] = frame.moved[:, WXYZ]
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_collision(self._model, self._data)
        return self._data.contact.geom.copy()

    def pairs(self, answer: Any) -> Rows:
        """Return the pairs of the contacts."""
        return pair_array(answer)


def pair_array(pairs: Any) -> Rows:
    """Return pairs (m, 2) from an iterable of them."""
    return np.array(list(pairs), np.int64).reshape(-1, 2)


class Managed:
    """Objects in a manager with a broad phase, as in python-fcl and coal."""

    def __init__(
        self, shapes: Sequence[Any], poses: Floats, kinds: tuple[Any, Any], manager: Any
    ) -> None:
        """Make the objects; kinds: the classes of a transform and of an object."""
        self._transform, kind = kinds
        rotations = Rotation.from_quat(poses[:, 3:]).as_matrix()
        transforms = map(self._transform, rotations, poses[:, :3])
        self._objects = list(map(kind, shapes, transforms))
        self._manager = manager
        for item in self._objects:
            manager.registerObject(item)
        manager.setup()

    def _move(self, frame: Frame) -> None:
        """Set the transforms and update the broad phase."""
        moved = [self._objects[row] for row in frame.rows]
        transform = self._transform
        for item, rotation, center in zip(moved, frame.rotations, frame.moved[:, :3], strict=True):
            item.setTransform(transform(rotation, center))
            self._bound(item)
        if len(moved) < FEW_MOVED * len(self._objects):
            for item in moved:
                self._manager.update(item)
        else:
            self._manager.update()

    def _bound(self, item: Any) -> None:
        """Update the bounds of a moved object, if the library does not."""


class PythonFcl(Managed):
    """python-fcl: dynamic AABB tree, box-box collision without contacts."""

    def __init__(self, half_extents: Floats, poses: Floats) -> None:
        self._fcl = fcl = importlib.import_module("fcl")
        geometries = [fcl.Box(*edges) for edges in 2.0 * half_extents]
        self._number = {id(geometry): k for k, geometry in enumerate(geometries)}
        kinds = fcl.Transform, fcl.CollisionObject
        super().__init__(geometries, poses, kinds, fcl.DynamicAABBTreeCollisionManager())

    def step(self, frame: Frame) -> Any:
        """Set the transforms, update the tree, collide."""
        self._move(frame)
        request = self._fcl.CollisionRequest(num_max_contacts=MOST_CONTACTS)
        data = self._fcl.CollisionData(request=request)
        self._manager.collide(data, self._fcl.defaultCollisionCallback)
        return data.result.contacts

    def pairs(self, answer: Any) -> Rows:
        """Return the pairs of the contacts."""
        return pair_array((self._number[id(c.o1)], self._number[id(c.o2)]) for c in answer)


class Coal(Managed):
    """coal: one of its broad phases, and a contact per pair."""

    def __init__(self, manager: str, half_extents: Floats, poses: Floats) -> None:
        self._coal = coal = importlib.import_module("coal")
        shapes = [coal.Box(*edges) for edges in 2.0 * half_extents]
        for number, shape in enumerate(shapes):
            shape.cost_density = number  # contacts refer to their shapes by value only
        kinds = coal.Transform3s, coal.CollisionObject
        super().__init__(shapes, poses, kinds, getattr(coal, manager)())

    def _bound(self, item: Any) -> None:
        item.computeAABB()

    def step(self, frame: Frame) -> Any:
        """Set the transforms, update the broad phase, collide."""
        self._move(frame)
        callback = self._coal.CollisionCallBackDefault()
        callback.data.request.num_max_contacts = MOST_CONTACTS
        self._manager.collide(callback)
        return callback.data.result

    def pairs(self, answer: Any) -> Rows:
        """Return the pairs of the contacts."""
        contacts = (answer.getContact(k) for k in range(answer.numContacts()))
        return pair_array((c.o1.cost_density, c.o2.cost_density) for c in contacts)


def _ours(name: str, make: Callable[[Floats, Floats], Stepper]) -> Contestant:
    return Contestant(name, "numba", make, threads=None)


FIND_PAIRS = _ours("find_pairs", OurPairs)
SCENE_PAIRS = _ours("Scene", partial(OurScene, ()))
SCENE_SEPARATIONS = _ours("Scene, separations", partial(OurScene, ("separations",)))
SCENE_CONTACTS = _ours("Scene, contacts", partial(OurScene, ("contacts",)))
OURS = (FIND_PAIRS, SCENE_PAIRS, SCENE_SEPARATIONS, SCENE_CONTACTS)
OUR_NAMES = {contestant.name for contestant in OURS}

MUJOCO = Contestant("MuJoCo", "mujoco", Mujoco, "mujoco")
COAL = tuple(
    Contestant(f"coal {short}", "coal", partial(Coal, manager), "coal")
    for short, manager in COAL_MANAGERS.items()
)
PEERS = (MUJOCO, *COAL, Contestant("python-fcl", "fcl", PythonFcl, "python-fcl"))

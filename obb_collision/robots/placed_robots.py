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

"""PlacedRobots: robots in a scene, with their bases, paddings and attached objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.poses import IDENTITY_POSE, compose_poses, inverse_poses, unit_poses
from obb_collision.geometry.validation import as_array, check_kind
from obb_collision.geometry.values import Changing
from obb_collision.obb import OBB
from obb_collision.robots.checks.bodies import WorldState, padding_of
from obb_collision.robots.checks.model import Attached, Model, Prepared
from obb_collision.robots.kinematics.kinematics import checked_states, link_poses
from obb_collision.robots.robot import Robot
from obb_collision.scene.objects import as_padding
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.allowed import guess
from obb_collision.shapes import Cloud, Shape
from obb_collision.typing import Floats, Mask
from obb_collision.words import MAX_OBJECT_NAME, check_name, shown


class PlacedRobots(Changing):
    """Robots in a scene: what a ``RobotScene`` checks, with the same parameters."""

    standing: Mask | None = None
    """(slots,) objects at rest, None for all: see ``Prepared.without_still_pairs``."""
    warns = True
    """Whether a check warns of a robot without collision geometry."""

    def __init__(
        self,
        robots: Robot | Sequence[Robot] | Mapping[str, Robot],
        scene: Scene | None,
        padding: float | Mapping[str, float],
        bases: ArrayLike | None,
    ) -> None:
        members, names = _named(robots)
        check_kind(scene, Scene, "scene", type(None))
        poses = np.tile(IDENTITY_POSE, (len(members), 1)) if bases is None else bases
        checked = as_array(poses, "bases", (len(members), 7))
        self._scene = Scene() if scene is None else scene
        self._model = Model(members, names, unit_poses(checked, "bases"))
        self._model.warns = self.warns
        self._joint_count = len(self._model.joint_names)
        self.padding = padding

    @property
    def robots(self) -> tuple[Robot, ...]:
        """The robots, in the order of their joints in a state."""
        return self._model.robots

    @property
    def scene(self) -> Scene:
        """The scene that robots are checked against."""
        return self._scene

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The columns of a state, with the name of the robot in front where robots have names."""
        return self._model.joint_names

    @property
    def link_names(self) -> tuple[str, ...]:
        """The names of all links, in the order of the robots."""
        return self._model.link_names

    @property
    def padding(self) -> dict[str, float]:
        """Padding of each link by name, metres.

        Can be set to a number for all links, or to a mapping by link; other links get 0.
        """
        return dict(zip(self._model.link_names, self._model.paddings.tolist(), strict=True))

    @padding.setter
    def padding(self, value: float | Mapping[str, float]) -> None:
        paddings = np.zeros(len(self._model.link_names))
        if isinstance(value, Mapping):
            for name, metres in value.items():
                paddings[self._link(name, "padding")] = as_padding(metres)
        else:
            paddings[:] = as_padding(value)
        self._model.set_paddings(paddings)

    @property
    def bases(self) -> Floats:
        """The poses (r, 7) of the robots' root links in the scene; can be set."""
        return self._model.bases.copy()

    @bases.setter
    def bases(self, value: ArrayLike) -> None:
        checked = as_array(value, "bases", (len(self._model.robots), 7))
        poses = unit_poses(checked, "bases")
        if not np.array_equal(poses, self._model.bases):
            self._model.set_bases(poses)

    def world_state(self) -> WorldState:
        """Return a snapshot of the scene, whose ``is_current`` tells whether checks still see it.

        Objects that are links, or attached, do not count.
        """
        return WorldState(self._scene, self._model.left_out)

    @property
    def link_objects(self) -> dict[str, tuple[str, ...]]:
        """By link, the names of the objects that stand for it in the scene; can be set.

        They are not obstacles. The rules of the scene about them hold for the link, and the largest
        of their paddings is added to its own.
        """
        return dict(self._model.link_objects)

    @link_objects.setter
    def link_objects(self, value: Mapping[str, Sequence[str]]) -> None:
        check_kind(value, Mapping, "link_objects")
        objects = {}
        for link, names in value.items():
            self._link(link, "link_objects")
            objects[link] = tuple(
                check_name(name, "link_objects", MAX_OBJECT_NAME)
                for name in ([names] if isinstance(names, str) else names)
            )
        self._model.set_link_objects(objects)

    @property
    def attached(self) -> dict[str, str]:
        """The link of each attached object, by the name of the object."""
        links = self._model.link_names
        return {name: links[attached.link] for name, attached in self._model.attached.items()}

    def attach(
        self,
        name: str,
        shape: Shape | OBB,
        link: str,
        pose: ArrayLike | None = None,
        *,
        touch_links: Sequence[str] | Set[str] = (),
        padding: float = 0.0,
    ) -> None:
        """Attach an object to a link, or replace the attached one of that name.

        It moves with the link and is checked against the scene and all links but that one, those
        that never move against it, and ``touch_links``. An object of the same name in the scene
        stays there: remove it.

        Parameters
        ----------
        name : str
        shape : Shape or OBB
        link : str
        pose : (7,) array_like, optional
            In the frame of the link; the identity by default.
        touch_links : str, or sequence or set of str
            Links that it may touch, such as fingers.
        padding : float
            Metres, added to the padding of the link.

        Examples
        --------
        >>> arm = oc.Robot.from_urdf('<robot name="arm"><link name="hand"/></robot>')
        >>> checker = oc.RobotScene([arm])
        >>> checker.attach("cup", oc.shapes.Sphere(0.1), "hand")
        >>> checker.attached
        {'cup': 'hand'}
        """
        check_name(name, "name", MAX_OBJECT_NAME)
        check_kind(shape, Shape, "shape", OBB)
        metres = as_padding(padding)
        self._attach(name, shape, link, pose, touch_links, metres, of_scene=False)

    def attach_object(
        self,
        name: str,
        link: str,
        pose: ArrayLike | None = None,
        *,
        state: ArrayLike | None = None,
        touch_links: Sequence[str] | Set[str] = (),
    ) -> None:
        """Attach an object of the scene, with the shape and padding that it has there now.

        Give its pose on the link, or the state of the robots at the grasp, in which it stays where
        it is. While it is attached, the object in the scene is not an obstacle. Otherwise as
        ``attach``.

        Parameters
        ----------
        name : str
            Name of the object.
        link : str
        pose : (7,) array_like, optional
            In the frame of the link.
        state : (joints,) array_like, optional
            The state at the grasp.
        touch_links : str, or sequence or set of str
            Links that it may touch, such as fingers.

        Examples
        --------
        >>> arm = oc.Robot.from_urdf('<robot name="arm"><link name="hand"/></robot>')
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> checker = oc.RobotScene([arm], scene)
        >>> checker.attach_object("cup", "hand", state=[])
        >>> checker.attached
        {'cup': 'hand'}
        """
        shape = self._scene.objects.shape_of(name)
        padding = padding_of(self._scene, name)
        if (pose is None) == (state is None):
            raise ValueError(
                "pose (on the link) or state (of the robot at the grasp) must be given"
            )
        if state is not None:
            states = self._states(as_array(state, "state", (self._joint_count,)), "state")
            where = link_poses(self._model.tree, states)[0, self._link(link, "link")]
            where[:3] += self._model.origin
            pose = compose_poses(inverse_poses(where), self._scene.pose(name))
        self._attach(name, shape, link, pose, touch_links, padding, of_scene=True)

    def _attach(
        self,
        name: str,
        shape: Shape | OBB,
        link: str,
        pose: ArrayLike | None,
        touch_links: Sequence[str] | Set[str],
        padding: float,
        of_scene: bool,
    ) -> None:
        if name in self._model.link_names:
            raise ValueError(f"name must not be the name of a link, got {shown(name)}")
        if isinstance(shape, Cloud):
            raise ValueError("shape must not be a Cloud: attach the body that it shows, as a Hull")
        where = as_array(IDENTITY_POSE if pose is None else pose, "pose", (7,))
        check_kind(touch_links, Sequence, "touch_links", Set)
        links = [touch_links] if isinstance(touch_links, str) else touch_links
        touching = frozenset(self._link(name, "touch_links") for name in links)
        row = self._link(link, "link")
        placed = unit_poses(where, "pose")
        self._model.attach(name, Attached(shape, row, placed, touching, padding, of_scene))

    def detach(self, name: str) -> None:
        """Remove an attached object.

        Examples
        --------
        >>> arm = oc.Robot.from_urdf('<robot name="arm"><link name="hand"/></robot>')
        >>> checker = oc.RobotScene([arm])
        >>> checker.attach("cup", oc.shapes.Sphere(0.1), "hand")
        >>> checker.detach("cup")
        """
        if not isinstance(name, str) or name not in self._model.attached:
            raise KeyError(f"name must be the name of an attached object, got {shown(name)}")
        self._model.detach(name)

    def _states(self, value: ArrayLike, name: str) -> Floats:
        """Return checked states (n, joints)."""
        rows: ArrayLike = value[None] if type(value) is np.ndarray and value.ndim == 1 else value
        if self._model.limits.hold(rows):
            return np.asarray(rows)
        try:
            states, _ = checked_states(self._model.tree, value, self._joint_count, name)
        except ValueError as error:
            raise with_joints(error, self.joint_names) from None
        return states

    @property
    def _prepared(self) -> Prepared:
        """Robots and scene as arrays for kernels."""
        return self._model.prepared(self._scene)

    def _link(self, name: str, argument: str) -> int:
        """Return the number of a link; ValueError naming the argument for an unknown one."""
        row = self._model.link_rows.get(name) if isinstance(name, str) else None
        if row is None:
            hint = guess(str(name), self._model.link_names)
            raise ValueError(f"{argument} must name links, got {shown(name)}{hint}")
        return row


def _named(
    robots: Robot | Sequence[Robot] | Mapping[str, Robot],
) -> tuple[list[Robot], list[str | None]]:
    """Return robots and their names, None for those without."""
    names: list[str | None]
    if isinstance(robots, Mapping):
        members, names = list(robots.values()), [check_name(name, "robots") for name in robots]
    else:
        check_kind(robots, Robot, "robots", Sequence)
        members = [robots] if isinstance(robots, Robot) else list(robots)
        names = [None] * len(members)
    for robot in members:
        check_kind(robot, Robot, "robots")
    if not members:
        raise ValueError("robots must not be empty")
    return members, names


def with_joints(error: ValueError, joints: Sequence[str]) -> ValueError:
    """Return an error about states, with the names of the joints if their number is wrong."""
    if "must have shape" not in str(error):
        return error
    return ValueError(f"{error}; the joints are {', '.join(joints)}")

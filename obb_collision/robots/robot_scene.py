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

"""RobotScene: checks of states of robots against themselves, each other and a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from difflib import get_close_matches

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.geometry.poses import IDENTITY_POSE, compose_poses, inverse_poses, unit_poses
from obb_collision.geometry.shapes.primitives import positive_number
from obb_collision.geometry.validation import NotCopied, as_array, as_flag, check_kind, is_single
from obb_collision.obb import OBB
from obb_collision.robots.checks.arrays import check_turns
from obb_collision.robots.checks.bodies import WorldState, padding_of
from obb_collision.robots.checks.distances import state_distances
from obb_collision.robots.checks.model import Attached, Model, Prepared
from obb_collision.robots.checks.motion_checks import check_motions, displacements
from obb_collision.robots.checks.reports import MotionReport, StateDistances, StateReport
from obb_collision.robots.checks.states import check_states
from obb_collision.robots.kinematics.kinematics import PLANAR, checked_states, link_poses
from obb_collision.robots.robot import Robot
from obb_collision.scene.objects import check_padding
from obb_collision.scene.scene import Scene
from obb_collision.shapes import Shape
from obb_collision.typing import Floats
from obb_collision.words import MAX_OBJECT_NAME, check_name, shown

#: Metres within which a motion may stay undecided.
DEFAULT_RESOLUTION = 1e-4


class RobotScene(NotCopied):
    """Robots in a scene, whose states are checked against each other, themselves and the scene.

    Parameters
    ----------
    robots : Robot, or sequence or mapping of them
        A state has their joints one after another. In a mapping from names, links are named
        ``NAME/LINK``; otherwise as in the URDF, and no two may share a name.
    scene : Scene, optional
        The world. It may change between checks: each one sees it as it is then. Its rules about
        pairs (``allow``, ``check_only``, ``allowed_within``) count for links, too. Its
        ``obstacle_points`` are not checked against robots: with any, this and checks raise.
    accuracy : Accuracy or str
        Of all pairs, whatever the objects of the scene have.
    padding : float or mapping
        Metres by which links are grown, of all or by name: a ball around each point.
    bases : (r, 7) array_like, optional
        The poses of the robots' roots in the scene; the identity by default.

    Raises
    ------
    ValueError
        Naming the argument.

    Examples
    --------
    >>> arm = oc.Robot.from_urdf('''<robot name="arm">
    ...   <link name="base"/>
    ...   <link name="hand">
    ...     <collision><geometry><sphere radius="0.1"/></geometry></collision>
    ...   </link>
    ...   <joint name="lift" type="prismatic">
    ...     <parent link="base"/><child link="hand"/><axis xyz="0 0 1"/>
    ...     <limit lower="0" upper="2" effort="1" velocity="1"/>
    ...   </joint>
    ... </robot>''')
    >>> scene = oc.Scene()
    >>> _ = scene.add("shelf", oc.shapes.Box([1, 1, 0.1]), [0, 0, 1, 0, 0, 0, 1])
    >>> checker = oc.RobotScene([arm], scene)
    >>> report = checker.check([[0.5], [1.0], [2.5]])
    >>> report.valid.tolist(), report.pairs
    ([True, False, False], [None, ('hand', 'shelf'), None])
    """

    ignores_points = False
    """Whether obstacle points of the scene are none for robots; else a scene with some raises."""

    def __init__(
        self,
        robots: Robot | Sequence[Robot] | Mapping[str, Robot],
        scene: Scene | None = None,
        accuracy: Accuracy | str = "hull",
        *,
        padding: float | Mapping[str, float] = 0.0,
        bases: ArrayLike | None = None,
    ) -> None:
        several, names = _named(robots)
        check_kind(scene, Scene, "scene", type(None))
        poses = np.tile(IDENTITY_POSE, (len(several), 1)) if bases is None else bases
        checked = as_array(poses, "bases", (len(several), 7))
        self.accuracy = accuracy
        self._scene = Scene() if scene is None else scene
        self._check_points()
        self._model = Model(several, names, unit_poses(checked))
        self._joint_count = len(self._model.joint_names)
        self.padding = padding

    @property
    def robots(self) -> tuple[Robot, ...]:
        """The robots, in the order of their joints in a state."""
        return self._model.robots

    @property
    def scene(self) -> Scene:
        """The world."""
        return self._scene

    @property
    def accuracy(self) -> Accuracy:
        """The level on which pairs are decided; may be set."""
        return self._accuracy

    @accuracy.setter
    def accuracy(self, value: Accuracy | str) -> None:
        self._accuracy = as_accuracy(value)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The columns of a state, with the name of the robot in front where robots have names."""
        return self._model.joint_names

    @property
    def link_names(self) -> tuple[str, ...]:
        """All links, in the order of the robots."""
        return self._model.link_names

    @property
    def padding(self) -> dict[str, float]:
        """Metres by which each link is grown; may be set, to a number or some links' by name."""
        return dict(zip(self._model.link_names, self._model.paddings.tolist(), strict=True))

    @padding.setter
    def padding(self, value: float | Mapping[str, float]) -> None:
        paddings = np.zeros(len(self._model.link_names))
        if isinstance(value, Mapping):
            for name, metres in value.items():
                check_padding(metres)
                paddings[self._link(name, "padding")] = metres
        else:
            check_padding(value)
            paddings[:] = value
        self._model.set_paddings(paddings)

    @property
    def bases(self) -> Floats:
        """The poses (r, 7) of the robots' roots in the scene; may be set."""
        return self._model.bases.copy()

    @bases.setter
    def bases(self, value: ArrayLike) -> None:
        given = unit_poses(as_array(value, "bases", (len(self._model.robots), 7)))
        if not np.array_equal(given, self._model.bases):
            self._model.set_bases(given)

    def world_state(self) -> WorldState:
        """Return what its checks depend on in the scene as it is, to see whether that changes.

        Not the objects that are links or attached. Its ``is_current`` says whether it is the same.
        """
        return WorldState(self._scene, self._model.left_out)

    @property
    def link_objects(self) -> dict[str, tuple[str, ...]]:
        """The objects of the scene that are links themselves, by link; may be set.

        They are no obstacles. What the rules of the scene say of them counts for the link, and so
        does the largest of their paddings, besides its own.
        """
        return dict(self._model.link_objects)

    @link_objects.setter
    def link_objects(self, value: Mapping[str, Sequence[str]]) -> None:
        check_kind(value, Mapping, "link_objects")
        found = {}
        for link, names in value.items():
            self._link(link, "link_objects")
            several = [names] if isinstance(names, str) else list(names)
            found[link] = tuple(
                check_name(name, "link_objects", MAX_OBJECT_NAME) for name in several
            )
        self._model.set_link_objects(found)

    @property
    def attached(self) -> dict[str, str]:
        """What is attached, and the link that it is attached to, by name."""
        links = self._model.link_names
        return {name: links[each.link] for name, each in self._model.attached.items()}

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
            Metres, besides that of the link.

        Raises
        ------
        ValueError
            Naming the argument.
        TypeError
            For another kind of shape.

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
        check_padding(padding)
        self._attach(name, shape, link, pose, touch_links, padding, of_scene=False)

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

        Either its pose on the link is given, or the state of the robots in which it stays where it
        is in the scene.

        While it is attached it is no obstacle, wherever it is in the scene. Else as ``attach``.

        Parameters
        ----------
        name : str
            Of the object.
        link : str
        pose : (7,) array_like, optional
            In the frame of the link.
        state : (joints,) array_like, optional
            In which it is grasped.
        touch_links : str, or sequence or set of str
            Links that it may touch, such as fingers.

        Raises
        ------
        KeyError
            For an unknown object.
        ValueError
            Naming the argument; without pose and state, and with both.

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
                "pose, on the link, or state, in which it stays in place, must be given"
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
            raise ValueError(f"name must not be that of a link, got {shown(name)}")
        where = as_array(IDENTITY_POSE if pose is None else pose, "pose", (7,))
        check_kind(touch_links, Sequence, "touch_links", Set)
        touched = [touch_links] if isinstance(touch_links, str) else list(touch_links)
        touching = frozenset(self._link(each, "touch_links") for each in touched)
        row = self._link(link, "link")
        each = Attached(shape, row, unit_poses(where), touching, padding, of_scene)
        self._model.attach(name, each)

    def detach(self, name: str) -> None:
        """Remove what is attached.

        Parameters
        ----------
        name : str

        Raises
        ------
        KeyError
            Naming what is not attached.

        Examples
        --------
        >>> arm = oc.Robot.from_urdf('<robot name="arm"><link name="hand"/></robot>')
        >>> checker = oc.RobotScene([arm])
        >>> checker.attach("cup", oc.shapes.Sphere(0.1), "hand")
        >>> checker.detach("cup")
        """
        if not isinstance(name, str) or name not in self._model.attached:
            raise KeyError(f"name must be that of something attached, got {shown(name)}")
        self._model.detach(name)

    def check(
        self,
        states: ArrayLike,
        *,
        all_pairs: bool = False,
        group: str | None = None,
        base_state: ArrayLike | None = None,
    ) -> StateReport:
        """Return which states are valid, and what collides in those that are not.

        Parameters
        ----------
        states : (n, joints) or (joints,) array_like
            The columns as in ``joint_names``, or of the joints of a group.
        all_pairs : bool
            Find every colliding pair; else a state is done with when one is found.
        group : str, optional
            A group of the SRDF, with the name of the robot in front where robots have names. See
            ``states_of_group``.
        base_state : (joints,) array_like, optional
            What the other joints have.

        Returns
        -------
        StateReport

        Raises
        ------
        ValueError
            Naming the row.

        Examples
        --------
        With ``checker`` as in the example of ``RobotScene``:

        >>> checker.check([[0.5], [2.5]]).out_of_limits.tolist()
        [[False], [True]]
        """
        if group is not None:
            states = self.states_of_group(group, states, base_state)
        given, every = self._states(states, "states"), as_flag(all_pairs, "all_pairs")
        return check_states(self._prepared, self._accuracy, given, every)

    def states_of_group(
        self, group: str, states: ArrayLike, base_state: ArrayLike | None = None
    ) -> Floats:
        """Return states of all joints from those of a group of the SRDF, the rest from a base.

        Parameters
        ----------
        group : str
            As in ``Robot.groups``, with the name of the robot in front where robots have names.
        states : (n, k) or (k,) array_like
            The joints of the group that are in ``joint_names``, in that order.
        base_state : (joints,) array_like, optional
            By default zeros, or what is next to them within the limits; no turn of floating joints.

        Returns
        -------
        (n, joints) numpy.ndarray

        Raises
        ------
        KeyError
            For an unknown group.
        ValueError
            Naming the argument and the row.

        Examples
        --------
        >>> robot = oc.Robot.from_urdf("config/arm.urdf", "config/arm.srdf")
        >>> checker = oc.RobotScene([robot])
        >>> checker.states_of_group("gripper", [[0.01]]).tolist()
        [[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.01]]
        """
        check_kind(group, str, "group")
        columns = self._model.group_columns(group)
        names = [self.joint_names[column] for column in columns]
        given = _named_joints(states, names, "states")
        base = self._model.middle if base_state is None else base_state
        full = np.tile(self._states(base, "base_state")[:1], (len(given), 1))
        full[:, columns] = given
        return full

    def distances(
        self,
        states: ArrayLike,
        *,
        max_distance: float = np.inf,
        self_pairs: bool = True,
        all_pairs: bool = False,
        jacobian: bool = False,
    ) -> StateDistances:
        """Return the least distance in each state, with its pair, points and direction.

        Of all pairs that are checked: of their triangles at the accuracy "mesh", their hulls at
        "hull", and their boxes at what is below. Limits of joints do not matter.

        Parameters
        ----------
        states : (n, joints) or (joints,) array_like
            The columns as in ``joint_names``.
        max_distance : float
            Metres, positive: what is farther apart does not count. Small ones take less time.
        self_pairs : bool
            Whether pairs of links, of all robots and what is attached, count.
        all_pairs : bool
            Return the distance of every pair within ``max_distance``, which must be finite.
        jacobian : bool
            Return the gradients of distances by the joints, too.

        Returns
        -------
        StateDistances

        Raises
        ------
        ValueError
            Naming the argument and the row.

        Examples
        --------
        With ``checker`` as in the example of ``RobotScene``:

        >>> found = checker.distances([[0.5], [1.0]])
        >>> found.distances.round(6).tolist(), found.directions[0].round(6).tolist()
        ([0.35, -0.15], [0.0, 0.0, 1.0])
        """
        given = self._states(states, "states")
        everything = isinstance(max_distance, float) and max_distance == np.inf
        limit = max_distance if everything else positive_number(max_distance, "max_distance")
        links, every = as_flag(self_pairs, "self_pairs"), as_flag(all_pairs, "all_pairs")
        slopes = as_flag(jacobian, "jacobian")
        if every and everything:
            raise ValueError("max_distance must be given for all_pairs")
        asked = self._accuracy, given, limit, links, every, slopes
        return state_distances(self._prepared, *asked)

    def check_motions(
        self,
        starts: ArrayLike,
        ends: ArrayLike,
        *,
        first: bool = False,
        resolution: float = DEFAULT_RESOLUTION,
    ) -> MotionReport:
        """Return which motions from state to state are valid, between the two as well.

        All joints move linearly from start to end; a continuous joint turns by the difference of
        its values, not the shorter way. A motion that is valid is certainly free all the way. One
        that is decided nowhere within ``resolution`` stays undecided; it counts as colliding.

        Parameters
        ----------
        starts, ends : (n, joints) or (joints,) array_like
            States, row by row.
        first : bool
            Find where each motion collides first, within ``resolution``; else any place where it
            collides ends its check, which takes a third of the time.
        resolution : float
            Metres, positive: parts of a motion in which a pair moves less are not divided.

        Returns
        -------
        MotionReport

        Raises
        ------
        ValueError
            Naming the argument and the row.

        Examples
        --------
        With ``checker`` as in the example of ``RobotScene``:

        >>> report = checker.check_motions([[0], [0]], [[0.8], [2]], first=True)
        >>> report.valid.tolist(), report.parameters.round(3).tolist()
        ([True, False], [nan, 0.425])
        """
        begins, finishes = self._states(starts, "starts"), self._states(ends, "ends")
        if len(begins) != len(finishes):
            raise ValueError(
                f"starts and ends must be as many, got {len(begins)} and {len(finishes)}"
            )
        check_turns(self._model.limits.floating, begins, finishes)
        finest, where = positive_number(resolution, "resolution"), as_flag(first, "first")
        return check_motions(self._prepared, self._accuracy, begins, finishes, finest, where)

    def displacements(self, states: ArrayLike, deviations: ArrayLike) -> Floats:
        """Return how far any point of a link moves at most if its joints do.

        Parameters
        ----------
        states : (m, joints) array_like
            All joints stay within the largest magnitudes of these.
        deviations : (n, joints) array_like
            By how much each joint moves at most.

        Returns
        -------
        (n,) numpy.ndarray
            Metres.

        Raises
        ------
        ValueError
            For robots with planar or floating joints.

        Examples
        --------
        With ``checker`` as in the example of ``RobotScene``:

        >>> checker.displacements([[0], [1]], [[0.2]]).round(6).tolist()
        [0.2]
        """
        if (self._model.tree.kinds >= PLANAR).any():
            raise ValueError("robots must have no planar or floating joints")
        moved = as_array(deviations, "deviations", (None, self._joint_count))
        given = self._states(states, "states")
        return displacements(self._prepared, given, moved)

    def check_path(
        self,
        states: ArrayLike,
        *,
        first: bool = False,
        resolution: float = DEFAULT_RESOLUTION,
    ) -> MotionReport:
        """Return whether a path is valid, between its states as well: the motions between them.

        Parameters
        ----------
        states : (n, joints) array_like
            At least one state.
        first : bool
        resolution : float
            As in ``check_motions``.

        Returns
        -------
        MotionReport
            Of the n - 1 motions; ``first_invalid`` is the first that is not valid. For one state,
            of the motion that stays there.

        Raises
        ------
        ValueError
            Naming the argument and the row.

        Examples
        --------
        With ``checker`` as in the example of ``RobotScene``:

        >>> checker.check_path([[0], [0.8], [2]]).first_invalid
        1
        """
        given = self._states(states, "states")
        if len(given) == 0:
            raise ValueError("states must have at least one state")
        ends = given[1:] if len(given) > 1 else given
        return self.check_motions(given[: len(ends)], ends, first=first, resolution=resolution)

    def _check_points(self) -> None:
        points = self._scene.obstacle_points
        if points is not None and len(points) and not self.ignores_points:
            raise ValueError(
                f"scene must have no obstacle_points, got {len(points)}: they are not checked "
                "against robots; set scene.obstacle_points = None"
            )

    def _states(self, value: ArrayLike, name: str) -> Floats:
        """Return checked states (n, joints)."""
        self._check_points()
        given: ArrayLike = value[None] if type(value) is np.ndarray and value.ndim == 1 else value
        if self._model.limits.hold(given):
            return np.asarray(given)
        try:
            states, _ = checked_states(self._model.tree, value, self._joint_count, name)
        except ValueError as error:
            raise _with_joints(error, self.joint_names) from None
        return states

    @property
    def _prepared(self) -> Prepared:
        """What kernels take."""
        return self._model.prepared(self._scene)

    def _link(self, name: str, argument: str) -> int:
        """Return the number of a link; ValueError naming the argument for an unknown one."""
        row = self._model.link_rows.get(name) if isinstance(name, str) else None
        if row is None:
            close = get_close_matches(str(name), self._model.link_names, 1)
            hint = f"; did you mean {close[0]}?" if close else ""
            raise ValueError(f"{argument} must name links, got {shown(name)}{hint}")
        return row


def _named(
    robots: Robot | Sequence[Robot] | Mapping[str, Robot],
) -> tuple[list[Robot], list[str | None]]:
    """Return robots and their names, None for those without."""
    names: list[str | None]
    if isinstance(robots, Mapping):
        several, names = list(robots.values()), [check_name(name, "robots") for name in robots]
    else:
        check_kind(robots, Robot, "robots", Sequence)
        several = [robots] if isinstance(robots, Robot) else list(robots)
        names = [None] * len(several)
    for robot in several:
        check_kind(robot, Robot, "robots")
    if not several:
        raise ValueError("robots must not be empty")
    return several, names


def _named_joints(states: ArrayLike, joints: Sequence[str], name: str) -> Floats:
    """Return values of joints (n, k) or (k,) as (n, k)."""
    try:
        if is_single(states):
            return as_array(states, name, (len(joints),))[None]
        return as_array(states, name, (None, len(joints)))
    except ValueError as error:
        raise _with_joints(error, joints) from None


def _with_joints(error: ValueError, joints: Sequence[str]) -> ValueError:
    """Return an error about states; one about their shape names the joints."""
    if "must have shape" not in str(error):
        return error
    return ValueError(f"{error}; the joints are {', '.join(joints)}")

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

"""RobotScene: are states of robots valid? Self, world and other robots, many states at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from difflib import get_close_matches

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._threads import run
from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.geometry.kinds import as_flag, check_kind
from obb_collision.geometry.poses import IDENTITY_POSE, unit_poses
from obb_collision.geometry.shapes.primitives import positive_number
from obb_collision.geometry.validation import as_array, is_single
from obb_collision.obb import OBB
from obb_collision.robots.bodies.robot_arrays import Attached
from obb_collision.robots.bodies.state_arrays import Bodies, Tests
from obb_collision.robots.bodies.world import WorldState
from obb_collision.robots.checks.distances import distances_kernel
from obb_collision.robots.checks.meshes import collide_as_meshes
from obb_collision.robots.checks.model import Arrays, Model
from obb_collision.robots.checks.motions import motions_kernel
from obb_collision.robots.checks.reports import (
    MotionReport,
    StateDistances,
    StatePairs,
    StateReport,
)
from obb_collision.robots.checks.states import all_pairs_kernel, first_pairs_kernel
from obb_collision.robots.description.robot import Robot
from obb_collision.robots.kinematics.kinematics import PLANAR, Tree
from obb_collision.scene.objects import check_padding
from obb_collision.scene.scene import Scene
from obb_collision.shapes import Shape
from obb_collision.typing import Floats, Integers, Rows
from obb_collision.words import MAX_OBJECT_NAME, check_name, shown

#: States below which a second thread does not pay: 0.1 ms of them.
FEWEST_STATES = 64
#: States with distances below which it does not pay.
FEWEST_DISTANCES = 8
#: Motions below which it does not pay: each takes many states.
FEWEST_MOTIONS = 4
#: Metres within which a motion may stay undecided.
DEFAULT_RESOLUTION = 1e-4


class RobotScene:
    """Robots in a scene, whose states are checked against each other, themselves and the scene.

    Parameters
    ----------
    robots : Robot, or sequence or mapping of them
        A state has their joints one after another. In a mapping from names, links are named
        ``NAME/LINK``; otherwise as in the URDF, and no two may share a name.
    scene : Scene, optional
        The world. It may change between checks: each one sees it as it is then. Its rules about
        pairs (``allow``, ``check_only``, ``allowed_within``) count for links, too.
    accuracy : Accuracy or str
        Of all pairs, whatever the objects of the scene have. Pairs that are padded, and all motions
        and distances, are decided at "hull" also where it is "mesh".
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
        self._model = Model(several, names, unit_poses(checked))
        self._joint_count = len(self._model.lower)
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

        They are no obstacles, and what the rules of the scene say of them counts for the link.
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
        touch_links: Sequence[str] | Set[str] = (),
    ) -> None:
        """Attach an object of the scene, with the shape and padding that it has there now.

        While it is attached it is no obstacle, wherever it is in the scene. Else as ``attach``.

        Parameters
        ----------
        name : str
            Of the object.
        link : str
        pose : (7,) array_like, optional
            In the frame of the link; the identity by default.
        touch_links : str, or sequence or set of str
            Links that it may touch, such as fingers.

        Raises
        ------
        KeyError
            For an unknown object.
        ValueError
            Naming the argument.

        Examples
        --------
        >>> arm = oc.Robot.from_urdf('<robot name="arm"><link name="hand"/></robot>')
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> checker = oc.RobotScene([arm], scene)
        >>> checker.attach_object("cup", "hand")
        >>> checker.attached
        {'cup': 'hand'}
        """
        shape = self._scene.shape_of(name)
        padding = float(self._scene._store.paddings[self._scene._store.slot(name)])
        self._attach(name, shape, link, pose, touch_links, padding, of_scene=True)

    def _attach(
        self, name: str, shape: Shape | OBB, link: str, pose: ArrayLike | None,
        touch_links: Sequence[str] | Set[str], padding: float, of_scene: bool,
    ) -> None:  # fmt: skip
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

    def check(self, configurations: ArrayLike, *, all_pairs: bool = False) -> StateReport:
        """Return which states are valid, and what collides in those that are not.

        Parameters
        ----------
        configurations : (n, joints) or (joints,) array_like
            States, the columns as in ``joint_names``.
        all_pairs : bool
            Find every colliding pair; else a state is done with when one is found.

        Returns
        -------
        StateReport

        Raises
        ------
        ValueError
            Naming the row.

        Examples
        --------
        >>> arm = oc.Robot.from_urdf('''<robot name="arm"><link name="base"/><link name="hand"/>
        ...   <joint name="lift" type="prismatic">
        ...     <parent link="base"/><child link="hand"/>
        ...     <limit lower="0" upper="2" effort="1" velocity="1"/>
        ...   </joint>
        ... </robot>''')
        >>> oc.RobotScene([arm]).check([[0.5], [2.5]]).out_of_limits.tolist()
        [[False], [True]]
        """
        states = self._states(configurations, "configurations")
        every = as_flag(all_pairs, "all_pairs")
        arrays = self._model.arrays(self._scene)
        checks = (arrays.tree, arrays.bodies, arrays.tests)
        level = int(self._accuracy)
        out_of_limits = self._model.out_of_limits(states)
        first = np.empty((len(states), 2), np.int64)
        run(first_pairs_kernel, len(states), FEWEST_STATES, *checks, level, states, first)
        report = StateReport(out_of_limits, arrays.owners_of(first), arrays.names)
        if self._accuracy in (Accuracy.OBB_TREE, Accuracy.MESH):
            found = self._decide_meshes(arrays, states, np.flatnonzero(first[:, 0] >= 0))
            pairs = np.full_like(first, -1)
            rows, places = np.unique(found.states, return_index=True)
            pairs[rows] = found.pairs[places]
            return replace(report, first_pairs=pairs, all_pairs=found if every else None)
        if every:
            report = replace(
                report, all_pairs=_named_pairs(arrays, *_all_pairs(*checks, level, states))
            )
        return report

    def _decide_meshes(self, arrays: Arrays, states: Floats, rows: Rows) -> StatePairs:
        """Return the pairs that collide as meshes, or as trees of boxes, in the states of rows."""
        checks = arrays.tree, arrays.bodies, arrays.tests
        some = np.ascontiguousarray(states[rows])
        numbers, pairs = _all_pairs(*checks, int(self._accuracy), some)
        kept = collide_as_meshes(
            self._model.mesh_bodies(), self._scene, arrays.world, arrays.tree, some[numbers],
            pairs, self._model.origin, self._accuracy,
        )  # fmt: skip
        return _named_pairs(arrays, rows[numbers[kept]], pairs[kept])

    def distances(
        self,
        configurations: ArrayLike,
        *,
        max_distance: float = np.inf,
        self_pairs: bool = True,
    ) -> StateDistances:
        """Return the least distance in each state, with its pair, points and direction.

        Of all pairs that are checked, at the accuracy "hull" whatever it is here; limits of joints
        do not matter.

        Parameters
        ----------
        configurations : (n, joints) or (joints,) array_like
            States, the columns as in ``joint_names``.
        max_distance : float
            Metres, positive: what is farther apart does not count. Small ones take less time.
        self_pairs : bool
            Whether pairs of links, of all robots and what is attached, count.

        Returns
        -------
        StateDistances

        Raises
        ------
        ValueError
            Naming the argument and the row.

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
        >>> found = oc.RobotScene([arm], scene).distances([[0.5], [1.0]])
        >>> found.distances.round(6).tolist(), found.directions[0].round(6).tolist()
        ([0.35, -0.15], [0.0, 0.0, 1.0])
        """
        states = self._states(configurations, "configurations")
        everything = isinstance(max_distance, float) and max_distance == np.inf
        limit = max_distance if everything else positive_number(max_distance, "max_distance")
        with_links = as_flag(self_pairs, "self_pairs")
        arrays = self._model.arrays(self._scene)
        tests = arrays.tests
        if not with_links:
            tests = tests._replace(pairs=np.empty((0, 2), np.int64))
        count = len(states)
        bounds, bodies = np.empty((count, 2)), np.empty((count, 2), np.int64)
        vectors = np.full((count, 3, 3), np.nan)
        run(
            *(distances_kernel, count, FEWEST_DISTANCES, arrays.tree, arrays.bodies, tests),
            *(states, limit, bounds, bodies, vectors),
        )
        vectors[:, :2] += self._model.origin
        swapped = arrays.owners[bodies[:, 0]] > arrays.owners[bodies[:, 1]]
        vectors[swapped, :2] = vectors[swapped, 1::-1]
        vectors[swapped, 2] *= -1.0
        return StateDistances(
            bounds[:, 0], bounds[:, 1], arrays.owners_of(bodies), vectors[:, :2], vectors[:, 2],
            arrays.names,
        )  # fmt: skip

    def check_motions(
        self, starts: ArrayLike, ends: ArrayLike, *, resolution: float = DEFAULT_RESOLUTION
    ) -> MotionReport:
        """Return which motions from state to state are valid, between the two as well.

        All joints move linearly from start to end; a continuous joint turns by the difference of
        its values, not the shorter way. A motion that is valid is certainly free. One that comes
        nearer to a collision than ``resolution`` may stay undecided; it counts as colliding.

        Parameters
        ----------
        starts, ends : (n, joints) or (joints,) array_like
            States, row by row.
        resolution : float
            Metres, positive: half of it takes up to twice the time of motions that scrape along.

        Returns
        -------
        MotionReport

        Raises
        ------
        ValueError
            Naming the argument and the row.

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
        >>> report = oc.RobotScene([arm], scene).check_motions([[0], [0]], [[0.8], [2]])
        >>> report.valid.tolist(), report.parameters.round(3).tolist()
        ([True, False], [nan, 0.425])
        """
        first, last = self._states(starts, "starts"), self._states(ends, "ends")
        if len(first) != len(last):
            raise ValueError(f"starts and ends must be as many, got {len(first)} and {len(last)}")
        self._model.check_turns(first, last)
        finest = positive_number(resolution, "resolution")
        arrays = self._model.arrays(self._scene)
        reaches = self._model.joint_reaches(arrays, first, last)
        count = len(first)
        parameters, undecided = np.empty(count), np.empty(count, np.bool_)
        pairs = np.empty((count, 2), np.int64)
        run(
            *(motions_kernel, count, FEWEST_MOTIONS, arrays.tree, arrays.bodies, arrays.tests),
            *(int(self._accuracy), reaches, first, last, finest, parameters, undecided, pairs),
        )
        return MotionReport(
            parameters, undecided,
            self._model.out_of_limits(first) | self._model.out_of_limits(last),
            arrays.owners_of(pairs), arrays.names,
        )  # fmt: skip

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
        >>> oc.RobotScene([arm]).displacements([[0], [1]], [[0.2]]).round(6).tolist()
        [0.2]
        """
        if (self._model.tree.kinds >= PLANAR).any():
            raise ValueError("robots must have no planar or floating joints")
        moved = as_array(deviations, "deviations", (None, self._joint_count))
        given = self._states(states, "states")
        return self._model.displacements(self._model.arrays(self._scene), given, moved)

    def check_path(
        self, configurations: ArrayLike, *, resolution: float = DEFAULT_RESOLUTION
    ) -> MotionReport:
        """Return whether a path is valid, between its states as well: the motions between them.

        Parameters
        ----------
        configurations : (n, joints) array_like
            At least one state.
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
        >>> arm = oc.Robot.from_urdf('<robot name="arm"><link name="hand"/></robot>')
        >>> oc.RobotScene([arm]).check_path(np.zeros((3, 0))).first_invalid is None
        True
        """
        states = self._states(configurations, "configurations")
        if len(states) == 0:
            raise ValueError("configurations must have at least one state")
        ends = states[1:] if len(states) > 1 else states
        return self.check_motions(states[: len(ends)], ends, resolution=resolution)

    def _states(self, value: ArrayLike, name: str) -> Floats:
        """Return checked states (n, joints)."""
        count = self._joint_count
        single = is_single(value)
        states = as_array(value, name, (count,) if single else (None, count))
        states = states[None] if single else states
        self._model.check_quaternions(states, name)
        return states if states.flags.writeable else states.copy()  # kernels are for one kind

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


def _all_pairs(
    tree: Tree, bodies: Bodies, tests: Tests, level: int, states: Floats
) -> tuple[Rows, Integers]:
    """Return the states (m,), ascending, of all pairs (m, 2) of bodies that may collide."""
    checks = tree, bodies, tests, level, states
    counts = np.zeros(len(states), np.int64)
    none = np.empty((0, 2), np.int64)
    run(all_pairs_kernel, len(states), FEWEST_STATES, *checks, counts, counts, none)
    ends = np.cumsum(counts)
    pairs = np.empty((int(ends[-1]) if len(ends) else 0, 2), np.int64)
    run(all_pairs_kernel, len(states), FEWEST_STATES, *checks, counts, ends, pairs)
    return np.repeat(np.arange(len(states)), counts), pairs


def _named_pairs(arrays: Arrays, states: Rows, pairs: Integers) -> StatePairs:
    """Return pairs of bodies as those of links and objects, each once per state."""
    unique = np.unique(np.column_stack([states, arrays.owners_of(pairs)]), axis=0)
    return StatePairs(unique[:, 0], unique[:, 1:])

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

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.geometry.shapes.primitives import positive_number
from obb_collision.geometry.validation import as_array, as_flag, check_kind, is_single
from obb_collision.robots.checks.arrays import check_turns
from obb_collision.robots.checks.distances import state_distances
from obb_collision.robots.checks.motion_checks import check_motions, displacements
from obb_collision.robots.checks.reports import MotionReport, StateDistances, StateReport
from obb_collision.robots.checks.states import check_states
from obb_collision.robots.kinematics.kinematics import PLANAR
from obb_collision.robots.placed_robots import PlacedRobots, with_joints
from obb_collision.robots.robot import Robot
from obb_collision.scene.scene import Scene
from obb_collision.typing import Floats

#: Metres within which a motion may stay undecided.
DEFAULT_RESOLUTION = 1e-4


class RobotScene(PlacedRobots):
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
        super().__init__(robots, scene, padding, bases)
        self.accuracy = accuracy

    @property
    def accuracy(self) -> Accuracy:
        """The level on which pairs are decided; may be set."""
        return self._accuracy

    @accuracy.setter
    def accuracy(self, value: Accuracy | str) -> None:
        self._accuracy = as_accuracy(value)

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
        still_pairs: bool = False,
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
        still_pairs : bool
            Whether the least distance is also of pairs whose distance no joint changes: of a link
            that no joint moves with an object, or with another such link. They collide as others
            do, and ``all_pairs`` has them in any case.

        Returns
        -------
        StateDistances

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
            raise ValueError("all_pairs=True needs max_distance")
        prepared = self._prepared
        if not (as_flag(still_pairs, "still_pairs") or every):
            prepared = prepared.without_still_pairs(self.standing)
        return state_distances(prepared, self._accuracy, given, limit, links, every, slopes)

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

        Examples
        --------
        With ``checker`` as in the example of ``RobotScene``:

        >>> report = checker.check_motions([[0], [0]], [[0.8], [2]], first=True)
        >>> report.valid.tolist(), report.fractions.round(3).tolist()
        ([True, False], [nan, 0.425])
        """
        begins, finishes = self._states(starts, "starts"), self._states(ends, "ends")
        if len(begins) != len(finishes):
            raise ValueError(
                f"starts and ends must have the same length, got {len(begins)} and {len(finishes)}"
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
            raise ValueError("robots must not have planar or floating joints")
        moved = as_array(deviations, "deviations", (None, self._joint_count))
        given = self._states(states, "states")
        return displacements(self._prepared, given, moved)

    def check_path(
        self, states: ArrayLike, *, first: bool = False, resolution: float = DEFAULT_RESOLUTION
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

        Examples
        --------
        With ``checker`` as in the example of ``RobotScene``:

        >>> checker.check_path([[0], [0.8], [2]]).first_invalid
        1
        """
        given = self._states(states, "states")
        if len(given) == 0:
            raise ValueError("states must not be empty")
        ends = given[1:] if len(given) > 1 else given
        return self.check_motions(given[: len(ends)], ends, first=first, resolution=resolution)


def _named_joints(states: ArrayLike, joints: Sequence[str], name: str) -> Floats:
    """Return values of joints (n, k) or (k,) as (n, k)."""
    try:
        if is_single(states):
            return as_array(states, name, (len(joints),))[None]
        return as_array(states, name, (None, len(joints)))
    except ValueError as error:
        raise with_joints(error, joints) from None

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
from obb_collision.geometry.validation import as_array, as_flag, as_points, check_kind, is_single
from obb_collision.queries.points.points import points_in_bodies
from obb_collision.queries.rays.hidden import add_hidden
from obb_collision.robots.checks.arrays import check_turns
from obb_collision.robots.checks.distances import state_distances
from obb_collision.robots.checks.motions import check_motions, displacements
from obb_collision.robots.checks.reports import MotionReport, StateDistances, StateReport
from obb_collision.robots.checks.states import check_states
from obb_collision.robots.kinematics.kinematics import PLANAR
from obb_collision.robots.placed_robots import PlacedRobots, with_joints
from obb_collision.robots.robot import Robot
from obb_collision.scene.objects import as_padding
from obb_collision.scene.scene import Scene
from obb_collision.typing import Floats, Mask

#: Metres within which a motion may stay undecided.
DEFAULT_RESOLUTION = 1e-4


class RobotScene(PlacedRobots):
    """Robots in a scene: checks of their states against themselves, each other and the scene.

    Methods raise KeyError for an unknown group or object.

    Parameters
    ----------
    robots : Robot, or sequence or mapping of them
        A state has their joints one after another. In a mapping from names, links are named
        ``NAME/LINK``; otherwise as in the URDF, and no two may share a name.
    scene : Scene, optional
        The world, which may change between checks. Its rules about pairs (``allow``,
        ``check_only``, ``allowed_within``) hold for links, too.
    accuracy : Accuracy or str
        The level of all pairs; levels of objects in the scene do not count.
    padding : float or mapping
        Metres added around every link, or around links by name.
    bases : (r, 7) array_like, optional
        The poses of the robots' root links in the scene; the identity by default.

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
        """The level of all pairs; can be set."""
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
        """Return which states are valid, and a colliding pair of those that are not.

        Parameters
        ----------
        states : (n, joints) or (joints,) array_like
            The columns as in ``joint_names``, or of the joints of a group.
        all_pairs : bool
            Whether to find every colliding pair; otherwise one pair ends the check of a state.
        group : str, optional
            A group of the SRDF, with the name of the robot in front where robots have names. See
            ``states_of_group``.
        base_state : (joints,) array_like, optional
            Values of the joints outside the group.

        Examples
        --------
        With ``checker`` as in the example of ``RobotScene``:

        >>> checker.check([[0.5], [2.5]]).out_of_limits.tolist()
        [[False], [True]]
        """
        if group is not None:
            states = self.states_of_group(group, states, base_state)
        rows, every = self._states(states, "states"), as_flag(all_pairs, "all_pairs")
        return check_states(self._prepared, self._accuracy, rows, every)

    def states_of_group(
        self, group: str, states: ArrayLike, base_state: ArrayLike | None = None
    ) -> Floats:
        """Return full states (n, joints): joints of a group of the SRDF, others from a base state.

        Parameters
        ----------
        group : str
            As in ``Robot.groups``, with the name of the robot in front where robots have names.
        states : (n, k) or (k,) array_like
            The joints of the group that are in ``joint_names``, in that order.
        base_state : (joints,) array_like, optional
            By default zeros, or the limits nearest to zero; floating joints do not turn.

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
        shape = (len(names),) if is_single(states) else (None, len(names))
        try:
            values = np.atleast_2d(as_array(states, "states", shape))
        except ValueError as error:
            raise with_joints(error, names) from None
        base = self._model.middle if base_state is None else base_state
        full = np.tile(self._states(base, "base_state")[:1], (len(values), 1))
        full[:, columns] = values
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

        Distances are of triangles at the accuracy "mesh", of hulls at "hull", and of boxes at lower
        levels. Limits of joints do not matter.

        Parameters
        ----------
        states : (n, joints) or (joints,) array_like
            The columns as in ``joint_names``.
        max_distance : float
            Metres, positive; pairs farther apart are ignored. A small one takes less time.
        self_pairs : bool
            Whether to include pairs of links and attached objects, also of two robots.
        all_pairs : bool
            Return the distance of every pair within ``max_distance``, which must be finite.
        jacobian : bool
            Return the gradients of distances by the joints, too.
        still_pairs : bool
            Whether to include pairs whose distance no joint changes, such as a base and its table.
            ``all_pairs`` includes them always.

        Examples
        --------
        With ``checker`` as in the example of ``RobotScene``:

        >>> found = checker.distances([[0.5], [1.0]])
        >>> found.distances.round(6).tolist(), found.directions[0].round(6).tolist()
        ([0.35, -0.15], [0.0, 0.0, 1.0])
        """
        rows = self._states(states, "states")
        unlimited = isinstance(max_distance, float) and max_distance == np.inf
        limit = max_distance if unlimited else positive_number(max_distance, "max_distance")
        links, every = as_flag(self_pairs, "self_pairs"), as_flag(all_pairs, "all_pairs")
        slopes = as_flag(jacobian, "jacobian")
        if every and unlimited:
            raise ValueError("all_pairs=True needs max_distance")
        prepared = self._prepared
        if not (as_flag(still_pairs, "still_pairs") or every):
            prepared = prepared.without_still_pairs(self.standing)
        return state_distances(prepared, self._accuracy, rows, limit, links, every, slopes)

    def check_motions(
        self,
        starts: ArrayLike,
        ends: ArrayLike,
        *,
        first: bool = False,
        resolution: float = DEFAULT_RESOLUTION,
    ) -> MotionReport:
        """Return which motions from state to state are valid all the way.

        All joints move linearly from start to end; a continuous joint turns by the difference of
        its values, not the shorter way. A valid motion is proved free. A motion that cannot be
        decided down to ``resolution`` is undecided and counts as colliding.

        Parameters
        ----------
        starts, ends : (n, joints) or (joints,) array_like
            States, row by row.
        first : bool
            Whether to find the first collision of each motion, within ``resolution``; otherwise
            any collision ends its check, in a third of the time.
        resolution : float
            Metres, positive; an interval in which a pair moves less is not divided.

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
        """Return upper bounds (n,) of how far, in metres, a point of a link moves with the joints.

        Robots must not have planar or floating joints.

        Parameters
        ----------
        states : (m, joints) array_like
            Each joint stays within its largest magnitude in these states.
        deviations : (n, joints) array_like
            Upper bounds of how much each joint moves, metres or radians.

        Examples
        --------
        With ``checker`` as in the example of ``RobotScene``:

        >>> checker.displacements([[0], [1]], [[0.2]]).round(6).tolist()
        [0.2]
        """
        if (self._model.tree.kinds >= PLANAR).any():
            raise ValueError("robots must not have planar or floating joints")
        moved = as_array(deviations, "deviations", (None, self._joint_count))
        return displacements(self._prepared, self._states(states, "states"), moved)

    def own_points(
        self,
        state: ArrayLike,
        points: ArrayLike,
        padding: float = 0.0,
        sensor: ArrayLike | None = None,
    ) -> Mask:
        """Return which points of a cloud are on the robots or on what is attached to them.

        Parameters
        ----------
        state : (joints,) array_like
            The state in which a sensor saw the points.
        points : (n, 3) array_like
            Metres, in the frame of the scene; points that are not finite are on nothing.
        padding : float
            Metres within which a point is still on the hull of a shape.
        sensor : (3,) array_like, optional
            Where the sensor is: points behind the robots, seen from there, count, too. A shape that
            contains the sensor hides nothing; if only its padding does, it hides without padding.

        Returns
        -------
        (n,) bool array

        Examples
        --------
        With ``checker`` as in the example of ``RobotScene``:

        >>> points = [[0, 0, 0.45], [0, 0, 0.7], [0, 0, 0]]
        >>> checker.own_points([0.5], points, sensor=[0, 0, 2]).tolist()
        [True, False, True]
        """
        cloud, metres = as_points(points, "points"), as_padding(padding)
        states = self._states(as_array(state, "state", (self._joint_count,))[None], "state")
        boxes, bodies = self._prepared.own.placed(states[0], self._model.origin)
        inside = points_in_bodies(boxes, bodies, cloud, metres, each_point=True)
        assert inside.boxes is not None
        own = inside.boxes >= 0
        if sensor is not None:
            add_hidden(own, as_array(sensor, "sensor", (3,)), cloud, boxes, bodies, metres)
        return own

    def check_path(
        self, states: ArrayLike, *, first: bool = False, resolution: float = DEFAULT_RESOLUTION
    ) -> MotionReport:
        """Return which of the n - 1 motions from each state of a path to the next are valid.

        A single state is a motion that stays there.

        Parameters
        ----------
        states : (n, joints) array_like
            At least one state.
        first : bool
        resolution : float
            As in ``check_motions``.

        Examples
        --------
        With ``checker`` as in the example of ``RobotScene``:

        >>> checker.check_path([[0], [0.8], [2]]).first_invalid
        1
        """
        path = self._states(states, "states")
        if len(path) == 0:
            raise ValueError("states must not be empty")
        ends = path[1:] if len(path) > 1 else path
        return self.check_motions(path[: len(ends)], ends, first=first, resolution=resolution)

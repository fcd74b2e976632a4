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

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.shapes.primitives import positive_number
from obb_collision.geometry.validation import as_array, as_flag
from obb_collision.robots.checks.distance_checks import least_distances
from obb_collision.robots.checks.motion_checks import check_motions
from obb_collision.robots.checks.reports import MotionReport, StateDistances, StateReport
from obb_collision.robots.checks.scene_robots import SceneRobots
from obb_collision.robots.checks.state_checks import check_states
from obb_collision.robots.kinematics.kinematics import PLANAR
from obb_collision.typing import Floats

#: Metres within which a motion may stay undecided.
DEFAULT_RESOLUTION = 1e-4


class RobotScene(SceneRobots):
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
        Of all pairs, whatever the objects of the scene have. At "obb_tree" motions and distances
        are those of boxes.
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
        With ``checker`` as in the example of ``RobotScene``:

        >>> checker.check([[0.5], [2.5]]).out_of_limits.tolist()
        [[False], [True]]
        """
        states = self._states(configurations, "configurations")
        every = as_flag(all_pairs, "all_pairs")
        return check_states(self._model, self._scene, self._accuracy, states, every)

    def distances(
        self,
        configurations: ArrayLike,
        *,
        max_distance: float = np.inf,
        self_pairs: bool = True,
    ) -> StateDistances:
        """Return the least distance in each state, with its pair, points and direction.

        Of all pairs that are checked: of their triangles at the accuracy "mesh", their hulls at
        "hull", and their boxes at what is below. Limits of joints do not matter.

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
        With ``checker`` as in the example of ``RobotScene``:

        >>> found = checker.distances([[0.5], [1.0]])
        >>> found.distances.round(6).tolist(), found.directions[0].round(6).tolist()
        ([0.35, -0.15], [0.0, 0.0, 1.0])
        """
        states = self._states(configurations, "configurations")
        everything = isinstance(max_distance, float) and max_distance == np.inf
        limit = max_distance if everything else positive_number(max_distance, "max_distance")
        with_links = as_flag(self_pairs, "self_pairs")
        return least_distances(self._model, self._scene, self._accuracy, states, limit, with_links)

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
        With ``checker`` as in the example of ``RobotScene``:

        >>> report = checker.check_motions([[0], [0]], [[0.8], [2]])
        >>> report.valid.tolist(), report.parameters.round(3).tolist()
        ([True, False], [nan, 0.425])
        """
        first, last = self._states(starts, "starts"), self._states(ends, "ends")
        if len(first) != len(last):
            raise ValueError(f"starts and ends must be as many, got {len(first)} and {len(last)}")
        self._model.check_turns(first, last)
        finest = positive_number(resolution, "resolution")
        return check_motions(self._model, self._scene, self._accuracy, first, last, finest)

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
        With ``checker`` as in the example of ``RobotScene``:

        >>> checker.check_path([[0], [0.8], [2]]).first_invalid
        1
        """
        states = self._states(configurations, "configurations")
        if len(states) == 0:
            raise ValueError("configurations must have at least one state")
        ends = states[1:] if len(states) > 1 else states
        return self.check_motions(states[: len(ends)], ends, resolution=resolution)

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

"""A robot from its description: names, limits, shapes, pairs to check, and kinematics."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from typing import Any

from numpy.typing import ArrayLike

from obb_collision.geometry.shapes.primitives import positive_number
from obb_collision.geometry.validation import as_flag, check_kind, warn_caller
from obb_collision.geometry.values import SetOnce
from obb_collision.robots.description.joints import (
    adjacent_pairs,
    driven,
    ordered_joints,
    tree_of,
    variables_of,
    virtual_joint_of,
)
from obb_collision.robots.description.srdf import (
    NO_SEMANTICS,
    Group,
    Pairs,
    Semantics,
    VirtualJoint,
    read_srdf,
    sorted_pair,
)
from obb_collision.robots.description.urdf import (
    Description,
    Joint,
    MeshSource,
    PackageDirs,
    ReadMesh,
    read_urdf,
)
from obb_collision.robots.description.xml_values import parse, read_source
from obb_collision.robots.kinematics.kinematics import checked_states, link_poses
from obb_collision.robots.proofs.proved_pairs import PairProof, prove_pairs
from obb_collision.typing import Floats

Source = str | bytes | PathLike[str]
#: Unknown links that a warning names.
MOST_NAMED = 5


class Robot(SetOnce):
    """A robot of rigid links and joints, made by ``from_urdf``. It does not change.

    Attributes
    ----------
    name : str
        Name in the URDF.
    link_names : tuple of str
        All links, the root's first, depth first in the order of the URDF.
    joint_names : tuple of str
        The variables of a state: joints that move and do not mimic, in the order of the links. A
        planar joint has three, ``NAME/x``, ``NAME/y``, ``NAME/theta``, a floating one
        ``NAME/trans_x``, ``trans_y``, ``trans_z``, ``rot_x``, ``rot_y``, ``rot_z``, ``rot_w``.
    lower, upper : (joints,) numpy.ndarray
        Limits, metres or radians; infinite where there are none, -1 and 1 for ``rot_``.
    velocity_limits : (joints,) numpy.ndarray
        Metres or radians per second; infinite where there are none.
    joints : tuple of Joint
        As in the URDF, parents before children; a virtual joint that moves is the first.
    shapes : tuple of tuples
        By link: (shape, pose in the frame of the link), meshes included.
    tree : Tree
        The kinematics as arrays, for kernels.
    disabled_pairs : frozenset of (str, str)
        Pairs of links, each sorted, that the SRDF excludes from checks: those of
        ``disable_collisions``, and those with a link of ``disable_default_collisions`` that no
        ``enable_collisions`` names.
    adjacent_pairs : frozenset of (str, str)
        Pairs of links with shapes that one joint connects, or several joints through links without
        shapes.
    default_disabled : tuple of str
        The links of ``disable_default_collisions``.
    groups : dict of Group
        Joints and links of each group of the SRDF.
    group_states : dict
        By (group, state): the values of each joint, by its name.
    end_effectors : dict
        The group of each end effector of the SRDF.
    virtual_joint : VirtualJoint or None
        The joint between world and root link, from the SRDF.
    doubts : tuple of str
        Faults of the files that were ignored, one line each: unknown names, geometries without
        extent, limits, prefixes.

    Examples
    --------
    >>> robot = oc.Robot.from_urdf('''<robot name="arm">
    ...   <link name="base"/>
    ...   <link name="hand">
    ...     <collision><geometry><sphere radius="0.1"/></geometry></collision>
    ...   </link>
    ...   <joint name="lift" type="prismatic">
    ...     <parent link="base"/><child link="hand"/><axis xyz="0 0 1"/>
    ...     <limit lower="0" upper="2" effort="1" velocity="1"/>
    ...   </joint>
    ... </robot>''')
    >>> robot.joint_names, robot.link_names
    (('lift',), ('base', 'hand'))
    >>> robot.link_poses([0.5])[1].tolist()
    [0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0]
    """

    def __init__(
        self,
        description: Description,
        semantics: Semantics,
        root: str,
        joints: list[Joint],
        virtual: Joint | None,
    ) -> None:
        shapes = description.shapes
        moving = joints if virtual is None else [virtual, *joints]
        variables = variables_of(moving)
        self.name = description.name
        self.joint_names = variables.names
        self.lower, self.upper = variables.lower, variables.upper
        self.velocity_limits = variables.velocity
        self.link_names, self.tree = tree_of(root, joints, variables, virtual)
        self.shapes = tuple(shapes[link] for link in self.link_names)
        self.joints = tuple(moving)
        self.adjacent_pairs = adjacent_pairs(joints, shapes)
        self.virtual_joint: VirtualJoint | None = semantics.virtual_joint
        self.groups: dict[str, Group] = semantics.groups
        self.group_states = semantics.group_states
        self.end_effectors = semantics.end_effectors
        self.default_disabled = semantics.default_disabled
        self.doubts = description.doubts + semantics.doubts
        defaults = {
            sorted_pair(link, other)
            for link in semantics.default_disabled
            for other in self.link_names
            if other != link
        }
        self.disabled_pairs: Pairs = semantics.disabled | (defaults - semantics.enabled)

    @classmethod
    def from_urdf(
        cls,
        urdf: Source,
        srdf: Source | None = None,
        package_dirs: PackageDirs | None = None,
        *,
        move_virtual_joint: bool = False,
        read_mesh: ReadMesh | None = None,
    ) -> Robot:
        """Return the robot that a URDF describes.

        Warns, once, of links in the SRDF that the URDF does not have.

        Parameters
        ----------
        urdf : str, bytes or path
            A file, or the text itself, which begins with ``<``.
        srdf : str, bytes or path, optional
            The semantic description that MoveIt's setup assistant writes.
        package_dirs : mapping or iterable of paths, optional
            Folders for package:// URIs: by the name of the package, or folders that contain
            packages. Installed packages, and the URDF's own, need no entry. Meshes are read only
            from these folders and packages.
        move_virtual_joint : bool
            Whether states begin with the planar or floating virtual joint of the SRDF. Link poses
            are then in its parent frame.
        read_mesh : callable, optional
            Called with path and scale in place of ``Mesh.from_file``; returns the mesh.

        Raises
        ------
        ValueError
            ``RobotError``, naming file, line and element; also for the SRDF of another robot.

        Examples
        --------
        >>> oc.Robot.from_urdf('<robot name="rock"><link name="rock"/></robot>')
        Robot('rock': 1 links, 0 joints)
        """
        moves = as_flag(move_virtual_joint, "move_virtual_joint")
        check_kind(urdf, str, "urdf", bytes, PathLike)
        data, file, path = read_source(urdf, "urdf")
        source = MeshSource(path, package_dirs, read_mesh)
        doubts: list[str] = []
        description = read_urdf(parse(data, file, doubts), source, doubts)
        root, joints = ordered_joints(description)
        for joint in joints:
            driven(joint, description.joints)
        semantics = NO_SEMANTICS
        if srdf is not None:
            check_kind(srdf, str, "srdf", bytes, PathLike)
            data, file, _ = read_source(srdf, "srdf")
            links = (root, *(joint.child for joint in joints))
            semantics = read_srdf(parse(data, file), description.name, links, joints)
        virtual = virtual_joint_of(semantics.virtual_joint, description) if moves else None
        if semantics.unknown:
            names = ", ".join(map(repr, semantics.unknown[:MOST_NAMED]))
            more = ", ..." if len(semantics.unknown) > MOST_NAMED else ""
            warn_caller(f"the SRDF names links that the URDF does not have: {names}{more}")
        return cls(description, semantics, root, joints, virtual)

    def link_poses(self, states: ArrayLike) -> Floats:
        """Return the poses of links, (n, links, 7) or (links, 7), in the frame of the root link.

        A pose is ``x y z qx qy qz qw``; the links are in the order of ``link_names``.

        Parameters
        ----------
        states : (n, joints) or (joints,) array_like
            The values of ``joint_names``; limits do not matter. Quaternions of floating joints are
            normalised.

        Examples
        --------
        >>> robot = oc.Robot.from_urdf('<robot name="rock"><link name="rock"/></robot>')
        >>> robot.link_poses(np.empty((5, 0))).shape
        (5, 1, 7)
        """
        checked, single = checked_states(self.tree, states, len(self.joint_names))
        poses = link_poses(self.tree, checked)
        return poses[0] if single else poses

    def prove_pairs(
        self, time_limit: float = 60.0, progress: Callable[[PairProof], None] | None = None
    ) -> list[PairProof]:
        """Return proofs of which pairs of links can collide within the limits of the joints.

        Links have the bodies of accuracy ``hull``. A joint without limits makes one full turn; a
        pair whose prismatic, planar or floating joint has no limits is undecided. The SRDF is not
        used.

        Parameters
        ----------
        time_limit : float
            Seconds for all pairs; pairs that are left then are undecided.
        progress : callable, optional
            Called with each ``PairProof`` as soon as it is done.

        Examples
        --------
        >>> ball = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
        >>> links = "".join(f'<link name="{name}">{ball}</link>' for name in "abc")
        >>> joints = "".join(
        ...     f'<joint name="{a}{b}" type="revolute"><parent link="{a}"/><child link="{b}"/>'
        ...     '<origin xyz="0.3 0 0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint>'
        ...     for a, b in ("ab", "bc")
        ... )
        >>> robot = oc.Robot.from_urdf(f'<robot name="r">{links}{joints}</robot>')
        >>> for proof in robot.prove_pairs():
        ...     print(*proof.links, proof.verdict)
        a b adjacent
        a c never
        b c adjacent
        """
        limit = positive_number(time_limit, "time_limit")
        return prove_pairs(self, limit, progress)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the attributes; unpickled arrays become read-only again."""
        vars(self).update(state)
        for array in (*self.tree, self.lower, self.upper, self.velocity_limits):
            array.setflags(write=False)

    def __repr__(self) -> str:
        return f"Robot({self.name!r}: {len(self.link_names)} links, {len(self.joint_names)} joints)"

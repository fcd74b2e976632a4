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

"""The states of a scene's objects: names, poses, twists, and which take part in collisions."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import NotCopied, as_any_array, as_array, as_flag
from obb_collision.obb import OBB
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Floats
from obb_collision.words import shown


class SceneStates(NotCopied):
    """The states of named objects; what they are is set by ``SceneObjects``."""

    _store: ObjectStore

    def move(self, name: str, pose: ArrayLike) -> None:
        """Give one object a new pose.

        Parameters
        ----------
        name : str
        pose : (7,) array_like
            x y z (metres) qx qy qz qw.

        Raises
        ------
        KeyError
            For an unknown name.
        ValueError
            For a bad pose.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.move("cup", [5, 0, 0, 0, 0, 0, 1])
        >>> scene.pose("cup")[0].item()
        5.0
        """
        slot = self._store.slot(name)
        self._store.move_indices(np.array([slot]), as_array(pose, "pose", (7,))[None])

    def move_many(self, names: Iterable[str], poses: ArrayLike) -> None:
        """Give objects new poses by name; all or, on an error, none.

        Parameters
        ----------
        names : iterable of str
        poses : (n, 7) array_like
            x y z (metres) qx qy qz qw.

        Raises
        ------
        KeyError
            For an unknown name.
        ValueError
            For bad poses.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.move_many(["cup"], [[5, 0, 0, 0, 0, 0, 1]])
        >>> scene.pose("cup")[0].item()
        5.0
        """
        self._store.move_indices(self._store.slots_of(names), poses)

    def move_indices(self, indices: ArrayLike, poses: ArrayLike) -> None:
        """Give objects new poses by index.

        Parameters
        ----------
        indices : (n,) array_like of int
            Of objects.
        poses : (n, 7) array_like
            x y z (metres) qx qy qz qw.

        Raises
        ------
        KeyError
            For an index without object; then none is changed.
        ValueError
            Naming the argument and the row; then none is changed.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.move_indices([0], [[5, 0, 0, 0, 0, 0, 1]])
        >>> scene.pose("cup")[0].item()
        5.0
        """
        self._store.move_indices(indices, poses)

    def place(self, indices: NDArray[np.int64], poses: Floats) -> None:
        """Give objects new poses as ``move_indices`` does, but check nothing.

        The indices are in use and distinct, the poses finite, their quaternions not zero.
        """
        self._store.place(indices, poses)

    def poses_of(self, indices: ArrayLike) -> Floats:
        """Return the poses (n, 7) of objects as they were given, by index.

        Parameters
        ----------
        indices : (n,) array_like of int
            Of objects.

        Raises
        ------
        KeyError
            For an index without object.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.poses_of([0]).shape
        (1, 7)
        """
        return self._store.poses[self._store.check_slots(indices)]

    def set_twist(self, name: str, twist: ArrayLike) -> None:
        """Set the twist of an object, valid until the next one; the effect ``sweep`` uses it.

        Parameters
        ----------
        name : str
        twist : (6,) array_like
            Linear x y z (m/s), angular x y z (rad/s), in the frame of the poses, of the point that
            the pose places.

        Raises
        ------
        KeyError
            For an unknown name.
        ValueError
            For a bad twist.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.set_twist("cup", [1, 0, 0, 0, 0, 0])
        """
        slot = self._store.slot(name)
        self._store.twists[slot] = as_array(twist, "twist", (6,))

    def set_twists(self, indices: ArrayLike, twists: ArrayLike) -> None:
        """Set the twists of objects by index.

        Parameters
        ----------
        indices : (n,) array_like of int
            Of objects.
        twists : (n, 6) array_like

        Raises
        ------
        KeyError
            For an index without object; then none is changed.
        ValueError
            Naming the argument and the row; then none is changed.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.set_twists([0], [[1, 0, 0, 0, 0, 0]])
        """
        slots = self._store.check_slots(indices)
        self._store.twists[slots] = as_array(twists, "twists", (len(slots), 6))

    def set_enabled(self, name: str, enabled: bool) -> None:
        """Include an object in collisions or exclude it; its box is retained.

        Parameters
        ----------
        name : str
        enabled : bool

        Raises
        ------
        KeyError
            For an unknown name.
        TypeError
            For anything but True or False.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> _ = scene.add("plate", oc.shapes.Sphere(0.1))
        >>> scene.set_enabled("cup", False)
        >>> len(scene.check())
        0
        """
        slot = self._store.slot(name)
        if self._store.enabled[slot] != as_flag(enabled, "enabled"):
            self._store.mark(slot)
            self._store.enable(slot, enabled)

    def set_enabled_indices(self, indices: ArrayLike, enabled: ArrayLike) -> None:
        """Include objects in collisions or exclude them, by index.

        Parameters
        ----------
        indices : (n,) array_like of int
            Of objects.
        enabled : (n,) array_like of bool

        Raises
        ------
        KeyError
            For an index without object; then none is changed.
        ValueError
            Naming the argument and the row; then none is changed.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> _ = scene.add("plate", oc.shapes.Sphere(0.1))
        >>> scene.set_enabled_indices([0], [False])
        >>> len(scene.check())
        0
        """
        slots = self._store.check_slots(indices)
        if as_any_array(enabled, "enabled", "True or False for each").dtype != np.bool_:
            raise TypeError(f"enabled must be True or False for each, got {shown(enabled)}")
        changed = self._store.enabled[slots] != enabled
        self._store.mark(slots[changed])
        self._store.enable(slots, enabled)

    def __len__(self) -> int:
        return len(self._store)

    def __contains__(self, name: object) -> bool:
        return name in self._store.slots

    def index(self, name: str) -> int:
        """Return the index of an object.

        Parameters
        ----------
        name : str

        Raises
        ------
        KeyError
            For an unknown name.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.index("cup")
        0
        """
        return self._store.slot(name)

    def name(self, index: int) -> str:
        """Return the name of the object with an index.

        Parameters
        ----------
        index : int

        Raises
        ------
        KeyError
            For an unknown index.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.name(0)
        'cup'
        """
        return str(self._store.names[self._store.check_slots([index])[0]])

    @property
    def names(self) -> list[str]:
        """The names of the objects, in the order of ``indices``."""
        return [str(self._store.names[slot]) for slot in self.indices]

    @property
    def indices(self) -> NDArray[np.int64]:
        """(n,) the indices of the objects, ascending."""
        return self._store.live()

    @property
    def boxes(self) -> Boxes:
        """The world boxes, padding included, in the order of ``indices``."""
        return self._store.boxes(self.indices)

    def pose(self, name: str) -> Floats:
        """Return the pose of one object.

        Parameters
        ----------
        name : str

        Returns
        -------
        (7,) array
            x y z (metres) qx qy qz qw, as given.

        Raises
        ------
        KeyError
            For an unknown name.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1), [1, 2, 3, 0, 0, 0, 1])
        >>> scene.pose("cup").tolist()
        [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]
        """
        return self._store.poses[self._store.slot(name)].copy()

    def obb(self, name: str) -> OBB:
        """Return the world box of one object, padding included.

        Parameters
        ----------
        name : str

        Raises
        ------
        KeyError
            For an unknown name.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.obb("cup").half_extents.tolist()
        [0.1, 0.1, 0.1]
        """
        return self._store.all_boxes()[self._store.slot(name)]

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

"""The objects of a scene: they come, get poses and settings of their own, and go."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.kinds import as_flag, check_kind
from obb_collision.geometry.poses import IDENTITY_POSE
from obb_collision.geometry.validation import as_any_array, as_array, as_half_extents
from obb_collision.obb import OBB
from obb_collision.scene.building.shape_cache import ShapeCache
from obb_collision.scene.store.kinds import BOX
from obb_collision.scene.store.store import LocalBox, ObjectStore
from obb_collision.shapes import Shape
from obb_collision.typing import Floats
from obb_collision.words import MAX_OBJECT_NAME, check_name, check_names, shown

if TYPE_CHECKING:
    from obb_collision.scene.building.builder import Builder
    from obb_collision.scene.building.outside import OutsideTrees


class SceneObjects:
    """A store of named objects: shapes, poses, twists, padding and accuracy."""

    def __init__(self, padding: float, accuracy: Accuracy | str) -> None:
        self._cache = ShapeCache()
        self.clear()
        self._padding = 0.0
        self.padding = padding
        self._accuracy = as_accuracy(accuracy)

    def add(
        self,
        name: str,
        shape: Shape | OBB,
        pose: ArrayLike | None = None,
        *,
        padding: float | None = None,
        accuracy: Accuracy | str | None = None,
    ) -> int:
        """Add an object, or replace the one of that name, and return its index.

        name: text that can be printed, of at most 300 characters. shape: a value of
        ``geometry.shapes`` or an OBB, in the object's own frame; its local box is fitted once.
        pose (7,): x y z qx qy qz qw, identity if not given. padding, metres, and accuracy: in
        place of the scene's. Raises ValueError for bad values of any of them.

        Parameters
        ----------
        name : str
        shape : Shape or OBB
        pose : (7,) array_like, optional
        padding : float, optional
            Metres.
        accuracy : Accuracy or str, optional

        Returns
        -------
        int
            The index, which stays while the object is there.

        Raises
        ------
        ValueError
            Naming the argument.
        TypeError
            For another kind of shape.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> scene.add("cup", oc.shapes.Sphere(0.1), [1, 0, 0, 0, 0, 0, 1])
        0
        """
        check_name(name, "name", MAX_OBJECT_NAME)
        check_kind(shape, Shape, "shape", OBB)
        where = IDENTITY_POSE if pose is None else as_array(pose, "pose", (7,))
        pad = self._padding if padding is None else padding
        check_padding(pad)
        level = None if accuracy is None else as_accuracy(accuracy)
        slot = self._store.put(name, local_box(shape), where, pad)
        self._store.kinds[slot] = self._cache.put(slot, shape)
        self._set_accuracy(slot, level)
        if padding is None:
            self._own_padding.discard(slot)
        else:
            self._own_padding.add(slot)
        return slot

    def add_boxes(
        self,
        names: Sequence[str],
        sizes: ArrayLike,
        poses: ArrayLike,
        accuracies: Sequence[Accuracy | str | None] | None = None,
        shapes: Sequence[Shape | None] | None = None,
    ) -> NDArray[np.int64]:
        """Add boxes, or replace the objects of those names; returns their indices (n,).

        As ``add`` with ``Box(size)`` for each, in a fraction of the time. names: n distinct ones.
        sizes (n, 3): edge lengths. poses (n, 7). accuracies: (n,), None for the scene's. shapes:
        (n,), what has that box, None for the box itself. Raises ValueError for bad values; then
        none is added.

        Parameters
        ----------
        names : sequence of str
        sizes : (n, 3) array_like
            Metres.
        poses : (n, 7) array_like
        accuracies : sequence, optional
        shapes : sequence, optional

        Raises
        ------
        ValueError
            Naming the argument; then none is added.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> scene.add_boxes(["a", "b"], np.ones((2, 3)), [[0, 0, 0, 0, 0, 0, 1]] * 2).tolist()
        [0, 1]
        """
        edges = as_half_extents(sizes, "sizes", (None, 3))
        where = as_array(poses, "poses", (None, 7))
        levels = None
        if accuracies is not None:
            check_kind(accuracies, Sequence, "accuracies")
            levels = [None if level is None else as_accuracy(level) for level in accuracies]
        if shapes is not None:
            check_kind(shapes, Sequence, "shapes")
            for shape in shapes:
                check_kind(shape, Shape, "shapes", type(None))
        check_kind(names, Sequence, "names")
        check_names(names, "names", MAX_OBJECT_NAME)
        given = (names, edges, where, names if levels is None else levels, shapes or names)
        lengths = {len(values) for values in given}
        if len(lengths) > 1 or len(set(names)) < len(names):
            raise ValueError("names, sizes, poses, accuracies and shapes must be one per object")
        slots = self._store.put_boxes(names, _halves(edges), where, self._padding)
        self._store.kinds[slots] = BOX
        self._forget(slots)
        if levels is None:
            ranks = np.full(len(slots), self._accuracy, np.int8)
        else:
            self._own_accuracy.update(
                slot
                for slot, level in zip(slots.tolist(), levels, strict=True)
                if level is not None
            )
            ranks = np.array([self._accuracy if r is None else r for r in levels], np.int8)
        self._store.accuracies[slots] = ranks
        for slot, shape in zip(slots.tolist(), shapes or (), strict=False):
            if shape is not None:
                self._store.kinds[slot] = self._cache.put(slot, shape)
        return slots

    def begin_boxes(
        self,
        names: Sequence[str],
        sizes: Floats,
        poses: Floats,
        levels: Sequence[Accuracy | None] | None = None,
    ) -> NDArray[np.int64]:
        """Add boxes of new names as ``add_boxes`` does, but check nothing; returns their indices.

        The names are valid and distinct, sizes and poses finite, sizes not negative, quaternions
        not zero.
        """
        slots = self._store.begin(names)
        self._store.kinds[slots], self._store.accuracies[slots] = BOX, self._accuracy
        self._store.poses[slots] = np.nan  # none is where it is to be
        self.resize_boxes(slots, sizes)
        self._store.place(slots, poses)
        for slot, level in zip(slots.tolist(), levels or (), strict=False):
            self._set_accuracy(slot, level)
        return slots

    def resize_boxes(self, indices: NDArray[np.int64], sizes: Floats) -> None:
        """Give boxes with the scene's padding other edge lengths (n, 3); nothing is checked."""
        self._store.shape_boxes(indices, _halves(sizes), self._padding)

    def rename_indices(self, indices: NDArray[np.int64], names: Sequence[str]) -> None:
        """Give objects other names, which are valid, new and distinct; nothing is checked."""
        self._store.rename(indices, names)

    def _forget(self, slots: NDArray[np.int64]) -> None:
        """Drop what was kept of the objects that slots had."""
        gone = slots.tolist()
        self._cache.drop_many(gone)
        self._own_padding.difference_update(gone)
        self._own_accuracy.difference_update(gone)

    def renew_indices(self, indices: ArrayLike) -> None:
        """Make objects new ones, by index array (n,): nothing relates them to what they were."""
        self._store.renew(self._store.check_slots(indices))

    def move(self, name: str, pose: ArrayLike) -> None:
        """Give one object a new pose (7,). KeyError for an unknown name.

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
        """Give objects new poses (n, 7), by name; all or, on an error, none.

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
        """Give objects new poses (n, 7), by index array (n,); all or, on an error, none.

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
        """Return the poses (n, 7) of objects as they were given, by index array (n,).

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
        """Say how an object moves: (6,) linear x y z (m/s), angular x y z (rad/s).

        In the frame of the poses, of the point that the pose places. It holds until the next one;
        the effect ``sweep`` predicts with it. KeyError for an unknown name.

        Parameters
        ----------
        name : str
        twist : (6,) array_like

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
        """Give objects twists (n, 6), by index array (n,); all or, on an error, none.

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

    def remove(self, name: str) -> None:
        """Take an object out. KeyError for an unknown name.

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
        >>> scene.remove("cup")
        >>> len(scene)
        0
        """
        slot = self._store.remove(name)
        self._own_padding.discard(slot)
        self._own_accuracy.discard(slot)
        self._cache.drop(slot)

    def remove_indices(self, indices: ArrayLike) -> None:
        """Take objects out, by index array (n,); all or, on a KeyError, none.

        Parameters
        ----------
        indices : (n,) array_like of int
            Of objects.

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
        >>> scene.remove_indices([0])
        >>> len(scene)
        0
        """
        slots = np.unique(self._store.check_slots(indices))
        self._store.remove_rows(slots)
        self._forget(slots)

    def build_outside(self, builder: Builder) -> OutsideTrees:
        """Have the trees and hulls of large shapes built by another process.

        Then no check waits for them: their pairs stay on "obb" until they are there. Returns what
        is being built. The builder must serve nobody else; close it in the end.
        """
        from obb_collision.scene.building.outside import OutsideTrees

        self._cache.outside = OutsideTrees(builder)
        return self._cache.outside

    def clear(self) -> None:
        """Take all objects out; what is set stays."""
        self._store = ObjectStore()
        self._cache.clear()
        self._own_padding: set[int] = set()
        self._own_accuracy: set[int] = set()

    def set_enabled(self, name: str, enabled: bool) -> None:
        """Let an object take part in collisions or not; it keeps its box either way.

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
        if self._store.active[slot] != as_flag(enabled, "enabled"):
            self._store.active[slot] = enabled
            self._store.mark(slot)

    def set_enabled_indices(self, indices: ArrayLike, enabled: ArrayLike) -> None:
        """Let objects take part in collisions or not (n,), by index array (n,).

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
        changed = self._store.active[slots] != enabled
        self._store.active[slots] = enabled
        self._store.mark(slots[changed])

    @property
    def padding(self) -> float:
        """Metres by which boxes without a padding of their own are grown on every side."""
        return self._padding

    @padding.setter
    def padding(self, value: float) -> None:
        check_padding(value)
        self._padding = float(value)
        rows = np.setdiff1d(self._store.live(), sorted(self._own_padding)).astype(np.int64)
        self._store.pad(rows, self._padding)

    @property
    def accuracy(self) -> Accuracy:
        """The level of the objects without one of their own; may be set, also by name."""
        return self._accuracy

    @accuracy.setter
    def accuracy(self, value: Accuracy | str) -> None:
        self._accuracy = as_accuracy(value)
        for slot in np.setdiff1d(self._store.live(), sorted(self._own_accuracy)).tolist():
            self._set_accuracy(int(slot), None)

    def set_accuracy(self, name: str, accuracy: Accuracy | str | None) -> None:
        """Give an object a level of its own, or with None the scene's. KeyError, ValueError.

        Parameters
        ----------
        name : str
        accuracy : Accuracy, str or None

        Raises
        ------
        KeyError
            For an unknown name.
        ValueError
            For an unknown accuracy.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.set_accuracy("cup", "mesh")
        """
        level = None if accuracy is None else as_accuracy(accuracy)
        self._set_accuracy(self._store.slot(name), level)

    def _set_accuracy(self, slot: int, own: Accuracy | None) -> None:
        if own is None:
            self._own_accuracy.discard(slot)
        else:
            self._own_accuracy.add(slot)
        value = self._accuracy if own is None else own
        if self._store.accuracies[slot] != value:
            self._store.accuracies[slot] = value
            self._store.mark(slot)

    def __len__(self) -> int:
        return len(self._store)

    def __contains__(self, name: object) -> bool:
        return name in self._store.slots

    def index(self, name: str) -> int:
        """Return the index of an object. KeyError for an unknown name.

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
        """Return the name of the object with an index. KeyError for an unknown one.

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


def _halves(edges: Floats) -> Floats:
    """Return half extents that are not too small for edge lengths."""
    half = 0.5 * edges
    return np.where(half + half < edges, np.nextafter(half, np.inf), half)  # if subnormal


def check_padding(padding: float) -> None:
    """Raise ValueError unless a padding is not negative."""
    if as_array(padding, "padding", ()) < 0.0:
        raise ValueError("padding must not be negative")


def local_box(shape: Shape | OBB) -> LocalBox:
    """Return the box of a shape in its own frame."""
    if isinstance(shape, OBB):
        return shape.center, shape.rotation, shape.half_extents
    return shape.local_box

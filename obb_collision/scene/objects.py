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

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.geometry.kinds import check_kind
from obb_collision.geometry.poses import IDENTITY_POSE
from obb_collision.geometry.validation import as_array, as_half_extents
from obb_collision.obb import OBB
from obb_collision.scene.building.shape_cache import ShapeCache
from obb_collision.scene.object_settings import ObjectSettings, check_padding
from obb_collision.scene.store.kinds import BOX
from obb_collision.scene.store.placed import as_slice
from obb_collision.scene.store.store import NO_ROWS, LocalBox, ObjectStore
from obb_collision.shapes import Shape
from obb_collision.typing import Floats
from obb_collision.words import MAX_OBJECT_NAME, check_name, check_names

if TYPE_CHECKING:
    from obb_collision.scene.building.builder import Builder
    from obb_collision.scene.building.outside import OutsideTrees


class SceneObjects(ObjectSettings):
    """A store of named objects that come and go, with their shapes."""

    def __init__(self, padding: float, accuracy: Accuracy | str) -> None:
        self._cache = ShapeCache()
        self.clear()
        super().__init__(padding, accuracy)

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

        Parameters
        ----------
        name : str
            Printable, of at most 300 characters.
        shape : Shape or OBB
            In the object's own frame; its local box is fitted once.
        pose : (7,) array_like, optional
            x y z (metres) qx qy qz qw; the identity by default.
        padding : float, optional
            Metres; by default the scene's.
        accuracy : Accuracy or str, optional
            By default the scene's.

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
        pad = self._padding_of(name) if padding is None else padding
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

        As ``add`` with ``Box(size)`` for each, in a fraction of the time.

        Parameters
        ----------
        names : sequence of str
            n distinct ones.
        sizes : (n, 3) array_like
            Edge lengths, metres.
        poses : (n, 7) array_like
        accuracies : sequence, optional
            n levels, None for the scene's.
        shapes : sequence, optional
            n shapes that have these boxes, None for the box itself.

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
        slots = self._store.put_boxes(names, _halves(edges), where, self._paddings_of(names))
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
        instead: NDArray[np.int64] = NO_ROWS,
    ) -> NDArray[np.int64]:
        """Add boxes of new names as ``add_boxes`` does, but check nothing; returns their indices.

        The names are valid and distinct, sizes and poses finite, sizes not negative, quaternions
        not zero. instead: indices of objects to remove, distinct; only as many of them, the first
        ones, are removed as boxes are added.
        """
        self._forget(instead[: len(names)])
        slots = self._store.begin(names, instead)
        rows = as_slice(slots)
        self._store.kinds[rows], self._store.accuracies[rows] = BOX, self._accuracy
        self._store.poses[rows] = np.nan  # none is where it is to be
        self._store.own_paddings[rows] = self._paddings_of(names)
        self.resize_boxes(slots, sizes)
        self._store.place(slots, poses)
        for slot, level in zip(slots.tolist(), levels or (), strict=False):
            self._set_accuracy(slot, level)
        return slots

    def resize_boxes(self, indices: NDArray[np.int64], sizes: Floats) -> None:
        """Give boxes other edge lengths (n, 3); nothing is checked."""
        self._store.shape_boxes(indices, _halves(sizes))

    def grow_indices(self, indices: NDArray[np.int64], growths: Floats) -> None:
        """Grow boxes beyond their padding by (n,) metres on every side; nothing is checked.

        In place of what they were grown by before: zeros take it back.
        """
        self._store.set_growths(indices, growths)

    def speeds_of(self, indices: NDArray[np.int64], twists: Floats) -> Floats:
        """Return the maximum speed (n,) of any point of objects; nothing is checked.

        By twists (n, 6) or those that they have, whichever is faster. A point at a distance of at
        most r from where the pose places the object moves with at most v + w r.
        """
        store = self._store
        radii = _lengths(store.local_centers[indices]) + _lengths(store.local_half_extents[indices])
        speeds = [
            _lengths(twist[:, :3]) + _lengths(twist[:, 3:]) * radii
            for twist in (twists, store.twists[indices])
        ]
        return np.maximum(*speeds)

    def rename_indices(self, indices: NDArray[np.int64], names: Sequence[str]) -> None:
        """Give objects other names, which are valid, new and distinct; nothing is checked."""
        self._store.rename(indices, names)
        if self._paddings:
            self._pad_again()

    def _forget(self, slots: NDArray[np.int64]) -> None:
        """Drop what is stored beside the store of the objects that slots had."""
        gone = slots.tolist()
        self._cache.drop_many(gone)
        self._own_padding.difference_update(gone)
        self._own_accuracy.difference_update(gone)

    def renew_indices(self, indices: ArrayLike) -> None:
        """Make objects new ones, by index array (n,): nothing relates them to what they were."""
        self._store.renew(self._store.check_slots(indices))

    def remove(self, name: str) -> None:
        """Remove an object.

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
        """Remove objects by index.

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
        """Remove all objects; settings are retained."""
        self._store = ObjectStore()
        self._cache.clear()
        super().clear()

    @property
    def shape_revision(self) -> int:
        """A number that changes with shapes, sizes and paddings, and not with poses."""
        return self._store.revision

    def shape_of(self, name: str) -> Shape | OBB:
        """Return the shape of an object, an OBB where it is a box.

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
        >>> scene.shape_of("cup").radius
        0.1
        """
        store, slot = self._store, self._store.slot(name)
        box = store.local_centers, store.local_rotations, store.local_half_extents
        return self._cache.shape(slot) or OBB(*(each[slot] for each in box))


def _halves(edges: Floats) -> Floats:
    """Return half extents that are not too small for edge lengths."""
    half = 0.5 * edges
    return np.where(half + half < edges, np.nextafter(half, np.inf), half)  # if subnormal


def _lengths(vectors: Floats) -> Floats:
    """Return the lengths (n,) of vectors (n, 3)."""
    lengths: Floats = np.linalg.norm(vectors, axis=1)
    return lengths


def local_box(shape: Shape | OBB) -> LocalBox:
    """Return the box of a shape in its own frame."""
    if isinstance(shape, OBB):
        return shape.center, shape.rotation, shape.half_extents
    return shape.local_box

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
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.geometry.poses import IDENTITY_POSE
from obb_collision.geometry.shapes.primitives import LocalBox
from obb_collision.geometry.validation import as_array, as_flag, as_half_extents, check_kind
from obb_collision.obb import OBB
from obb_collision.scene.building.shape_cache import ShapeCache, SlotShape
from obb_collision.scene.object_settings import ObjectSettings, check_padding
from obb_collision.scene.store.completed import completed
from obb_collision.scene.store.kinds import BOX
from obb_collision.scene.store.placed import LocalBoxes, about_origins, extents, placed
from obb_collision.scene.store.store import NO_ROWS, ObjectStore
from obb_collision.shapes import Shape
from obb_collision.typing import Floats, Rows
from obb_collision.words import MAX_OBJECT_NAME, check_name, check_names, shown

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
        replace: bool = True,
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
        replace : bool
            Whether it may take the place of another one; with False that is a ValueError.

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
        if not as_flag(replace, "replace") and name in self:
            raise ValueError(f"name must be new, as replace is False, got {shown(name)}")
        where = IDENTITY_POSE if pose is None else as_array(pose, "pose", (7,))
        if padding is not None:
            check_padding(padding)
        level = None if accuracy is None else as_accuracy(accuracy)
        box = local_boxes(shape)
        columns = placed(box, where[None], "pose")
        slots = self._put([name], box[2], columns, [level], [shape], padding)
        return int(slots[0])

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
        box = about_origins(_halves(edges))
        return self._put(names, box[2], placed(box, where), levels, shapes)

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
        box = about_origins(_halves(sizes))
        return self._put(names, box[2], placed(box, poses), levels, instead=instead)

    def _put(
        self, names: Sequence[str], half_extents: Floats, columns: dict[str, Any],
        levels: Sequence[Accuracy | None] | None,
        shapes: Sequence[Shape | OBB | None] | None = None,
        padding: float | None = None, instead: NDArray[np.int64] = NO_ROWS,
    ) -> NDArray[np.int64]:  # fmt: skip
        """Add objects, or replace those of their names; all or, on an error, none.

        half_extents (n, 3): of their local boxes; columns: of their places. padding: their own,
        None for that of the scene; the rest as for ``begin_boxes``. Returns their slots.
        """
        store = self._store
        slots = np.array([store.slots.get(name, -1) for name in names], np.int64)
        new = slots < 0
        begun = [name for name, is_new in zip(names, new.tolist(), strict=True) if is_new]
        if len(instead):
            instead = instead[~np.isin(instead, slots)][: len(begun)]
        if begun:
            slots[new] = np.append(instead, store.free_rows(len(begun) - len(instead)))
        kinds = np.full(len(slots), BOX, np.int8)
        bodies = []
        for row, shape in enumerate(shapes or ()):
            if shape is not None:
                bodies.append(self._cache.shape_for(int(slots[row]), shape))
                kinds[row] = bodies[-1].kind
        growths = np.where(new, 0.0, store.growths[slots])
        paddings = np.full(len(slots), self._paddings_of(names) if padding is None else padding)
        columns |= extents(half_extents, paddings, growths)
        ranks = [self._accuracy if level is None else level for level in levels or ()]
        columns |= {
            "padded": padding is not None,
            "accuracies": np.array(ranks, np.int8) if levels else self._accuracy,
            "levelled": [level is not None for level in levels] if levels else False,
            "kinds": kinds,
        }
        gone = [str(store.names[slot]) for slot in instead.tolist()]
        self._commit(slots, columns, slots[new], begun, gone, bodies)
        return slots

    @completed
    def _commit(
        self, slots: Rows, columns: dict[str, Any], new: Rows, names: list[str],
        gone: list[str], bodies: list[SlotShape],
    ) -> None:  # fmt: skip
        """Write what ``_put`` made: nothing here fails but for want of memory, at first."""
        self._store.put(slots, columns, new, names, gone)
        self._cache.drop_many(slots.tolist())
        for body in bodies:
            self._cache.put(body)

    def resize_boxes(self, indices: NDArray[np.int64], sizes: Floats) -> None:
        """Give boxes other edge lengths (n, 3); nothing is checked."""
        self._cache.drop_many(indices.tolist())
        self._store.resize(indices, _halves(sizes))

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

    @completed
    def rename_indices(self, indices: NDArray[np.int64], names: Sequence[str]) -> None:
        """Give objects other names, which are valid, new and distinct; nothing is checked."""
        self._store.rename(indices, names)
        if self._paddings:
            self._pad_again(self._padding, self._paddings)

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
        self._remove(np.array([self._store.slot(name)]))

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
        self._remove(np.unique(self._store.check_slots(indices)))

    @completed
    def _remove(self, slots: Rows) -> None:
        self._store.remove_rows(slots)
        self._cache.drop_many(slots.tolist())

    def build_outside(self, builder: Builder) -> OutsideTrees:
        """Have the trees and hulls of large shapes built by another process.

        Then no check waits for them: their pairs stay on "obb" until they are there. Returns what
        is being built. The builder must serve nobody else; close it in the end.
        """
        from obb_collision.scene.building.outside import OutsideTrees

        self._cache.outside = OutsideTrees(builder)
        return self._cache.outside

    @completed
    def clear(self) -> None:
        """Remove all objects; settings are retained."""
        self._store = ObjectStore()
        self._cache.clear()

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


def local_boxes(shape: Shape | OBB) -> LocalBoxes:
    """Return the same as one of several, in arrays of its own."""
    center, rotation, half_extents = local_box(shape)
    return np.array(center)[None], np.array(rotation)[None], np.array(half_extents)[None]

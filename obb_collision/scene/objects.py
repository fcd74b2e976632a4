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

"""The objects of a scene by index: their store, shapes, paddings and levels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.geometry.shapes.primitives import LocalBox
from obb_collision.geometry.validation import as_any_array, as_array
from obb_collision.obb import OBB
from obb_collision.scene.building.shape_cache import BOX, ShapeCache, SlotShape
from obb_collision.scene.refinement.mesh_pairs import prepare_shapes
from obb_collision.scene.store.patterns import Overrides, as_patterns, as_tuples
from obb_collision.scene.store.placing import LocalBoxes, about_origins, extents, placed
from obb_collision.scene.store.store import NO_ROWS, ObjectStore
from obb_collision.shapes import Shape
from obb_collision.typing import Floats, Rows
from obb_collision.words import shown

if TYPE_CHECKING:
    from obb_collision.scene.building.builder import Builder
    from obb_collision.scene.building.outside import OutsideTrees


class SceneObjects:
    """Objects by index; an object keeps its index until it is removed.

    Methods raise KeyError for an index without object and ValueError for a bad value, and then
    change nothing, unless they say that nothing is checked.

    Examples
    --------
    >>> scene = oc.Scene()
    >>> cups = scene.add_boxes(["a", "b"], np.ones((2, 3)), [[0, 0, 0, 0, 0, 0, 1]] * 2)
    >>> scene.objects.set_enabled(cups, [True, False])
    >>> scene.objects.poses_of(cups).shape
    (2, 7)
    """

    __slots__ = ("_accuracy", "_padding", "_paddings", "cache", "store")

    def __init__(self, padding: float, accuracy: Accuracy | str) -> None:
        self.cache = ShapeCache()
        self.store = ObjectStore()
        self._paddings: Overrides[float] = Overrides()
        self.padding = padding
        self._accuracy = as_accuracy(accuracy)

    def __getstate__(self) -> tuple[Any, ...]:
        shapes = self.cache.lend_shapes()
        return self.store.columns(), shapes, self._paddings.overrides, self._padding, self._accuracy

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        columns, shapes, paddings, self._padding, self._accuracy = state
        self.store, self.cache = ObjectStore.of_columns(columns), ShapeCache().with_shapes(shapes)
        self._paddings = Overrides(paddings)

    def begin_boxes(
        self,
        names: Sequence[str],
        sizes: Floats,
        poses: Floats,
        levels: Sequence[Accuracy | None] | None = None,
        instead: NDArray[np.int64] = NO_ROWS,
    ) -> NDArray[np.int64]:
        """Add boxes of new names, as ``Scene.add_boxes``; return their indices; nothing is checked.

        The names are valid and distinct, sizes and poses finite, sizes not negative, quaternions
        not zero. instead: distinct indices of objects to replace; the first are removed, one for
        each new box.
        """
        box = about_origins(halves(sizes))
        return self.put(names, box[2], placed(box, poses), levels, instead=instead)

    def put(
        self,
        names: Sequence[str],
        half_extents: Floats,
        columns: dict[str, Any],
        levels: Sequence[Accuracy | None] | None,
        shapes: Sequence[Shape | OBB | None] | None = None,
        padding: float | None = None,
        instead: NDArray[np.int64] = NO_ROWS,
    ) -> NDArray[np.int64]:
        """Add objects or replace objects of the same names, none on an error; return their slots.

        half_extents (n, 3): of the local boxes; columns: of the places; shapes: None for boxes;
        padding: None for that of the scene; the others as for ``begin_boxes``.
        """
        store = self.store
        slots = np.array([store.slots.get(name, -1) for name in names], np.int64)
        new = slots < 0
        new_names = [name for name, is_new in zip(names, new.tolist(), strict=True) if is_new]
        if len(instead):
            instead = instead[~np.isin(instead, slots)][: len(new_names)]
        if new_names:
            slots[new] = np.append(instead, store.free_rows(len(new_names) - len(instead)))
        kinds = np.full(len(slots), BOX, np.int8)
        bodies = []
        for row, shape in enumerate(shapes or ()):
            if shape is not None:
                bodies.append(self.cache.shape_for(int(slots[row]), shape))
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
        self._commit(slots, columns, slots[new], new_names, gone, bodies)
        return slots

    def _commit(
        self, slots: Rows, columns: dict[str, Any], new: Rows, names: list[str],
        gone: list[str], bodies: list[SlotShape],
    ) -> None:  # fmt: skip
        """Write the columns of ``put``: only lack of memory fails here, before the first write."""
        shaped = {body.slot for body in bodies}  # the cache has room for them
        others = [slot for slot in slots.tolist() if slot not in shaped]
        self.cache.own(others)
        self.store.put(slots, columns, new, names, gone)
        self.cache.drop_many(others)
        for body in bodies:
            self.cache.put(body)

    def resize_boxes(self, indices: NDArray[np.int64], sizes: Floats) -> None:
        """Set the edge lengths (n, 3) of boxes; nothing is checked."""
        store = self.store
        own, growths = store.own_paddings[indices], store.growths[indices]
        box = {"local_centers": 0.0, "local_rotations": np.eye(3)}
        numbers = indices.tolist()
        store.write(indices, {**box, **extents(halves(sizes), own, growths)})
        self.cache.drop_many(numbers)

    def grow(self, indices: NDArray[np.int64], growths: Floats) -> None:
        """Set growths (n,) of boxes, metres on every side beyond the padding; nothing is checked.

        They replace earlier growths.
        """
        store, other = self.store, growths != self.store.growths[indices]
        rows, own = indices[other], store.own_paddings[indices[other]]
        store.write(rows, extents(store.local_half_extents[rows], own, growths[other]))

    def speeds_of(self, indices: NDArray[np.int64], twists: Floats) -> Floats:
        """Return the maximum speed (n,), m/s, of any point of each object; nothing is checked.

        By twists (n, 6) or their own, whichever is faster. A point within r of the object's origin
        moves at v + w r at most.
        """
        store = self.store
        radii = _lengths(store.local_centers[indices]) + _lengths(store.local_half_extents[indices])
        speeds = [
            _lengths(twist[:, :3]) + _lengths(twist[:, 3:]) * radii
            for twist in (twists, store.twists[indices])
        ]
        return np.maximum(*speeds)

    def rename(self, indices: NDArray[np.int64], names: Sequence[str]) -> None:
        """Set names of objects. Names must be valid, new and distinct; they are not checked."""
        store, columns = self.store, {}
        if self._paddings:
            own, wanted = store.own_paddings[indices], self._paddings_of(names)
            paddings = np.where(store.padded[indices], own, wanted)
            columns = extents(store.local_half_extents[indices], paddings, store.growths[indices])
        store.rename(indices, names, columns)

    def renew(self, indices: ArrayLike) -> None:
        """Treat objects (n,) as new, without relation to earlier states."""
        self.store.renew(self.store.check_slots(indices))

    def remove(self, indices: ArrayLike) -> None:
        """Remove objects."""
        self.remove_slots(np.unique(self.store.check_slots(indices)))

    def remove_slots(self, slots: Rows) -> None:
        """Remove objects by indices that are in use and distinct."""
        numbers = slots.tolist()
        self.cache.own(numbers)
        self.store.remove_rows(slots)
        self.cache.drop_many(numbers)

    def build_outside(self, builder: Builder) -> OutsideTrees:
        """Let a child process build the trees and hulls of large shapes.

        Then no check waits for them: meanwhile their pairs stay on "obb". The builder must serve
        this scene only; close it in the end.
        """
        from obb_collision.scene.building.outside import OutsideTrees

        self.cache.outside = OutsideTrees(builder)
        return self.cache.outside

    def prepare(self) -> None:
        """Build the trees and hulls of all shapes now, instead of in the first checks."""
        prepare_shapes(self.store, self.cache)

    def clear(self, store: ObjectStore) -> None:
        """Remove all objects, with an empty store; settings are retained."""
        self.cache.clear()
        self.store = store

    @property
    def revision(self) -> int:
        """A number that changes with shapes, sizes and paddings, but not with poses."""
        return self.store.revision

    @property
    def near(self) -> NDArray[np.int64]:
        """(k,) the objects near the region at the last check; all without a region."""
        return np.flatnonzero(self.store.used & self.store.near)

    def shape_of(self, name: str) -> Shape | OBB:
        """Return the shape of an object, an OBB where it is a box; KeyError for an unknown name."""
        store, slot = self.store, self.store.slot(name)
        box = store.local_centers, store.local_rotations, store.local_half_extents
        return self.cache.shape(slot) or OBB(*(column[slot] for column in box))

    def place(self, indices: NDArray[np.int64], poses: Floats) -> None:
        """Set poses of objects, as ``Scene.move_indices``; nothing is checked.

        The indices are in use and distinct, the poses finite, their quaternions not zero.
        """
        self.store.place(indices, poses)

    def poses_of(self, indices: ArrayLike) -> Floats:
        """Return the poses (n, 7) of objects as they were set."""
        return self.store.poses[self.store.check_slots(indices)]

    def set_twists(self, indices: ArrayLike, twists: ArrayLike) -> None:
        """Set the twists (n, 6) of objects, as ``Scene.set_twist`` does."""
        slots = self.store.check_slots(indices)
        self.store.twists[slots] = as_array(twists, "twists", (len(slots), 6))

    def set_enabled(self, indices: ArrayLike, enabled: ArrayLike) -> None:
        """Include objects in checks or exclude them: (n,) True or False."""
        slots = self.store.check_slots(indices)
        flags = as_any_array(enabled, "enabled", "True or False, or one of them per object")
        if flags.dtype != np.bool_:
            raise TypeError(
                f"enabled must be True or False, or one of them per object, got {shown(enabled)}"
            )
        if flags.shape not in ((), slots.shape):
            raise ValueError(f"enabled must have the shape of indices, got {shown(enabled)}")
        changed = self.store.enabled[slots] != flags
        self.store.mark(slots[changed])
        self.store.enable(slots, flags)

    @property
    def padding(self) -> float:
        """Metres by which boxes without their own padding grow on every side; can be set."""
        return self._padding

    @padding.setter
    def padding(self, value: float) -> None:
        self._pad_again(as_padding(value), self._paddings)

    @property
    def padding_overrides(self) -> list[tuple[str, float]]:
        """Paddings by name or pattern, such as (``gripper/*``, metres); can be set.

        The last one that an object matches counts, also for later objects. The padding of an object
        itself, from ``Scene.add`` or ``Scene.set_padding``, comes before.
        """
        return list(self._paddings.overrides)

    @padding_overrides.setter
    def padding_overrides(self, overrides: Iterable[tuple[str, float]]) -> None:
        new: list[tuple[str, float]] = []
        for pattern, padding in as_tuples(overrides, "padding_overrides", 2):
            metres = as_padding(padding, "padding_overrides")
            new += [(name, metres) for name in as_patterns(pattern, "padding_overrides")]
        self._pad_again(self._padding, Overrides(new))

    def set_padding(self, slot: int, padding: float | None) -> None:
        """Set the padding of an object; None: the padding of its override, else of the scene."""
        names = [str(self.store.names[slot])]
        wanted = self._paddings_of(names) if padding is None else as_padding(padding)
        self.store.pad(np.array([slot]), np.full(1, wanted, np.float64), padding is not None)

    def _paddings_of(self, names: Sequence[str]) -> float | Floats:
        return paddings_of(names, self._padding, self._paddings)

    def _pad_again(self, padding: float, overrides: Overrides[float]) -> None:
        """Set the padding of all objects without a padding of their own."""
        store = self.store
        rows = np.flatnonzero(store.used & ~store.padded)
        wanted = paddings_of([str(store.names[row]) for row in rows.tolist()], padding, overrides)
        wanted = np.broadcast_to(wanted, rows.shape)
        other = wanted != store.own_paddings[rows]
        store.pad(rows[other], wanted[other])
        self._padding, self._paddings = padding, overrides

    @property
    def accuracy(self) -> Accuracy:
        """The accuracy level of objects without their own; can be set, also as text."""
        return self._accuracy

    @accuracy.setter
    def accuracy(self, value: Accuracy | str) -> None:
        store, level = self.store, as_accuracy(value)
        rows = np.flatnonzero(store.used & ~store.levelled & (store.accuracies != level))
        store.write(rows, {"accuracies": level})
        self._accuracy = level

    def set_accuracy(self, slot: int, accuracy: Accuracy | str | None) -> None:
        """Set the accuracy level of an object; None: the level of the scene."""
        store, level = self.store, self._accuracy if accuracy is None else as_accuracy(accuracy)
        if store.accuracies[slot] != level:
            store.write(np.array([slot]), {"accuracies": level})
        store.levelled[slot] = accuracy is not None


def paddings_of(
    names: Sequence[str], padding: float, overrides: Overrides[float]
) -> float | Floats:
    """Return the paddings (n,) of objects, metres, or one number for all."""
    if not overrides:
        return padding
    values = [overrides.value(name) for name in names]
    return np.array([padding if value is None else value for value in values], np.float64)


def as_padding(padding: float, name: str = "padding") -> float:
    """Return a padding; ValueError for a negative one."""
    metres = float(as_array(padding, name, ()))
    if metres < 0.0:
        raise ValueError(f"{name} must not be negative")
    return metres


def halves(edges: Floats) -> Floats:
    """Return half of the edge lengths, rounded up where inexact."""
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
    """Return the local box of a shape as arrays of length 1."""
    center, rotation, half_extents = local_box(shape)
    return np.array(center)[None], np.array(rotation)[None], np.array(half_extents)[None]

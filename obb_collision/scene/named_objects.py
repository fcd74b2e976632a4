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

"""The objects of a scene by name: adding, moving, setting and removing them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.boxes import Boxes
from obb_collision.geometry.poses import IDENTITY_POSE
from obb_collision.geometry.validation import as_array, as_flag, as_half_extents, check_kind
from obb_collision.geometry.values import Changing
from obb_collision.obb import OBB
from obb_collision.scene.objects import SceneObjects, as_padding, halves, local_boxes
from obb_collision.scene.store.placing import about_origins, placed
from obb_collision.shapes import Shape
from obb_collision.typing import Floats
from obb_collision.words import MAX_OBJECT_NAME, check_name, check_names, shown


class NamedObjects(Changing):
    """Objects by name: the part of a scene that adds, moves, sets and removes them.

    Methods raise KeyError for an unknown name or index.
    """

    def __init__(self, padding: float, accuracy: Accuracy | str) -> None:
        self._objects = SceneObjects(padding, accuracy)

    @property
    def objects(self) -> SceneObjects:
        """The objects by index, many at once."""
        return self._objects

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
        """Add an object, or replace the one of that name; return its index, which it keeps.

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
            Whether it may replace an object; with False that is a ValueError.

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
            padding = as_padding(padding)
        level = None if accuracy is None else as_accuracy(accuracy)
        box = local_boxes(shape)
        columns = placed(box, where[None], "pose")
        slots = self._objects.put([name], box[2], columns, [level], [shape], padding)
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
            n distinct names.
        sizes : (n, 3) array_like
            Edge lengths, metres.
        poses : (n, 7) array_like
            x y z (metres) qx qy qz qw.
        accuracies : sequence, optional
            n levels, None for the scene's.
        shapes : sequence, optional
            n shapes that have these boxes, None for the box itself.

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
        columns = (names, edges, where, names if levels is None else levels, shapes or names)
        lengths = {len(column) for column in columns}
        if len(lengths) > 1 or len(set(names)) < len(names):
            raise ValueError("names, sizes, poses, accuracies and shapes must be one per object")
        box = about_origins(halves(edges))
        return self._objects.put(names, box[2], placed(box, where), levels, shapes)

    def set_shape(self, name: str, shape: Shape | OBB) -> None:
        """Give an object another shape; it keeps its index, pose, padding, accuracy and rules.

        Parameters
        ----------
        name : str
        shape : Shape or OBB
            In the object's own frame.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("camera", oc.shapes.Cloud([[1, 0, 0]]))
        >>> scene.set_shape("camera", oc.shapes.Cloud([[2, 0, 0], [3, 0, 0]]))
        """
        check_kind(shape, Shape, "shape", OBB)
        store = self._objects.store
        slot, box = store.slot(name), local_boxes(shape)
        padding = float(store.own_paddings[slot]) if store.padded[slot] else None
        level = Accuracy(store.accuracies[slot]) if store.levelled[slot] else None
        columns = placed(box, store.poses[slot][None], "pose")
        self._objects.put([name], box[2], columns, [level], [shape], padding)

    def remove(self, name: str) -> None:
        """Remove an object.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.remove("cup")
        >>> len(scene)
        0
        """
        self._objects.remove_slots(np.array([self._objects.store.slot(name)]))

    def move(self, name: str | Iterable[str], pose: ArrayLike) -> None:
        """Give one or several objects new poses; on an error none is moved.

        Parameters
        ----------
        name : str or iterable of str
        pose : (7,) or (n, 7) array_like
            x y z (metres) qx qy qz qw.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.move("cup", [5, 0, 0, 0, 0, 0, 1])
        >>> scene.pose("cup")[0].item()
        5.0
        """
        store = self._objects.store
        if isinstance(name, str):
            store.move_indices(np.array([store.slot(name)]), as_array(pose, "pose", (7,))[None])
        else:
            store.move_indices(store.slots_of(name), pose)

    def move_indices(self, indices: ArrayLike, poses: ArrayLike) -> None:
        """Give objects new poses by index.

        Parameters
        ----------
        indices : (n,) array_like of int
            Indices of objects.
        poses : (n, 7) array_like
            x y z (metres) qx qy qz qw.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.move_indices([0], [[5, 0, 0, 0, 0, 0, 1]])
        >>> scene.pose("cup")[0].item()
        5.0
        """
        self._objects.store.move_indices(indices, poses)

    def set_twist(self, name: str, twist: ArrayLike) -> None:
        """Set the twist of an object, for the effect ``sweep``; it is valid until the next twist.

        Parameters
        ----------
        name : str
        twist : (6,) array_like
            Linear x y z (m/s) of the object's origin, angular x y z (rad/s), in the frame of the
            poses.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.set_twist("cup", [1, 0, 0, 0, 0, 0])
        """
        slot = self._objects.store.slot(name)
        self._objects.store.twists[slot] = as_array(twist, "twist", (6,))

    def set_enabled(self, name: str, enabled: bool) -> None:
        """Include an object in checks or exclude it.

        Parameters
        ----------
        name : str
        enabled : bool

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> _ = scene.add("plate", oc.shapes.Sphere(0.1))
        >>> scene.set_enabled("cup", False)
        >>> len(scene.check())
        0
        """
        slot = self._objects.store.slot(name)
        self._objects.set_enabled([slot], as_flag(enabled, "enabled"))

    def set_padding(self, name: str, padding: float | None) -> None:
        """Set the padding of an object; None: the padding of its override, else of the scene.

        Parameters
        ----------
        name : str
        padding : float or None
            Metres.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.set_padding("cup", 0.5)
        >>> scene.obb("cup").half_extents.round(9).tolist()
        [0.6, 0.6, 0.6]
        """
        self._objects.set_padding(self._objects.store.slot(name), padding)

    def set_accuracy(self, name: str, accuracy: Accuracy | str | None) -> None:
        """Set the accuracy level of an object; None: the level of the scene.

        Parameters
        ----------
        name : str
        accuracy : Accuracy, str or None

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.set_accuracy("cup", "mesh")
        """
        self._objects.set_accuracy(self._objects.store.slot(name), accuracy)

    @property
    def padding(self) -> float:
        """Metres by which boxes without their own padding grow on every side; can be set."""
        return self._objects.padding

    @padding.setter
    def padding(self, value: float) -> None:
        self._objects.padding = value

    @property
    def accuracy(self) -> Accuracy:
        """The accuracy level of objects without their own; can be set, also as text."""
        return self._objects.accuracy

    @accuracy.setter
    def accuracy(self, value: Accuracy | str) -> None:
        self._objects.accuracy = value

    def __len__(self) -> int:
        return len(self._objects.store)

    def __contains__(self, name: object) -> bool:
        return name in self._objects.store.slots

    def index(self, name: str) -> int:
        """Return the index of an object.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.index("cup")
        0
        """
        return self._objects.store.slot(name)

    def name(self, index: int) -> str:
        """Return the name of the object with an index.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.name(0)
        'cup'
        """
        return str(self._objects.store.names[self._objects.store.check_slots([index])[0]])

    @property
    def names(self) -> list[str]:
        """The names of the objects, in the order of ``indices``."""
        return [str(self._objects.store.names[slot]) for slot in self.indices]

    @property
    def indices(self) -> NDArray[np.int64]:
        """(n,) the indices of the objects, ascending."""
        return self._objects.store.live()

    @property
    def boxes(self) -> Boxes:
        """The world boxes, with padding, in the order of ``indices``."""
        return self._objects.store.boxes(self.indices)

    def pose(self, name: str) -> Floats:
        """Return the pose (7,) of an object: x y z (metres) qx qy qz qw, as it was set.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1), [1, 2, 3, 0, 0, 0, 1])
        >>> scene.pose("cup").tolist()
        [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]
        """
        return self._objects.store.poses[self._objects.store.slot(name)].copy()

    def obb(self, name: str) -> OBB:
        """Return the world box of an object, with padding.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.obb("cup").half_extents.tolist()
        [0.1, 0.1, 0.1]
        """
        return self._objects.store.all_boxes()[self._objects.store.slot(name)]

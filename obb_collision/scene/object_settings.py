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

"""What is set of the objects of a scene, for all or by name: padding and accuracy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from obb_collision.accuracy import Accuracy, as_accuracy
from obb_collision.geometry.validation import as_array
from obb_collision.scene.states import SceneStates
from obb_collision.scene.store.completed import completed
from obb_collision.scene.store.overrides import Overrides
from obb_collision.scene.store.patterns import as_patterns, as_tuples
from obb_collision.typing import Floats


class ObjectSettings(SceneStates):
    """Named objects, their padding and their accuracy."""

    def __init__(self, padding: float, accuracy: Accuracy | str) -> None:
        self._paddings: Overrides[float] = Overrides()
        self.padding = padding
        self._accuracy = as_accuracy(accuracy)

    @property
    def padding(self) -> float:
        """Metres by which boxes without another padding are grown on every side; may be set."""
        return self._padding

    @padding.setter
    def padding(self, value: float) -> None:
        check_padding(value)
        self._pad_again(float(value), self._paddings)

    @property
    def padding_overrides(self) -> list[tuple[str, float]]:
        """Padding in place of the scene's, by name or pattern: (``gripper/*``, metres); may be set.

        The last one that an object matches counts, also for objects to come. An object's own, as
        given to ``add`` or ``set_padding``, goes before.
        """
        return list(self._paddings.overrides)

    @padding_overrides.setter
    def padding_overrides(self, overrides: Iterable[tuple[str, float]]) -> None:
        new: list[tuple[str, float]] = []
        for pattern, padding in as_tuples(overrides, "padding_overrides", 2):
            check_padding(padding, "padding_overrides")
            new += [(one, float(padding)) for one in as_patterns(pattern, "padding_overrides")]
        self._pad_again(self._padding, Overrides(new))

    def set_padding(self, name: str, padding: float | None) -> None:
        """Set the padding of one object; None: that of its override or of the scene.

        Parameters
        ----------
        name : str
        padding : float or None
            Metres.

        Raises
        ------
        KeyError
            For an unknown name.
        ValueError
            For a negative padding.

        Examples
        --------
        >>> scene = oc.Scene()
        >>> _ = scene.add("cup", oc.shapes.Sphere(0.1))
        >>> scene.set_padding("cup", 0.5)
        >>> scene.obb("cup").half_extents.round(9).tolist()
        [0.6, 0.6, 0.6]
        """
        rows = np.array([self._store.slot(name)])
        if padding is not None:
            check_padding(padding)
        wanted = self._paddings_of([name]) if padding is None else padding
        self._store.pad(rows, np.full(1, wanted, np.float64), padding is not None)

    def _paddings_of(self, names: Sequence[str]) -> float | Floats:
        """Return the paddings (n,) of objects without one of their own; one for all, if it is."""
        return paddings_of(names, self._padding, self._paddings)

    @completed
    def _pad_again(self, padding: float, overrides: Overrides[float]) -> None:
        """Set the padding, and give it to all objects without one of their own."""
        store = self._store
        rows = np.flatnonzero(store.used & ~store.padded)
        wanted = paddings_of([str(store.names[row]) for row in rows.tolist()], padding, overrides)
        wanted = np.broadcast_to(wanted, rows.shape)
        other = wanted != store.own_paddings[rows]
        store.pad(rows[other], wanted[other])
        self._padding, self._paddings = padding, overrides

    @property
    def accuracy(self) -> Accuracy:
        """The level of the objects without one of their own; may be set, also by name."""
        return self._accuracy

    @accuracy.setter
    def accuracy(self, value: Accuracy | str) -> None:
        self._set_all(as_accuracy(value))

    @completed
    def _set_all(self, value: Accuracy) -> None:
        store = self._store
        rows = np.flatnonzero(store.used & ~store.levelled & (store.accuracies != value))
        store.write(rows, {"accuracies": value})
        self._accuracy = value

    def set_accuracy(self, name: str, accuracy: Accuracy | str | None) -> None:
        """Set the level of one object; None: that of the scene.

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
        store, slot = self._store, self._store.slot(name)
        value = self._accuracy if level is None else level
        if store.accuracies[slot] != value:
            columns = {"accuracies": value, "levelled": level is not None}
            store.write(np.array([slot]), columns)
        else:
            store.levelled[slot] = level is not None


def paddings_of(
    names: Sequence[str], padding: float, overrides: Overrides[float]
) -> float | Floats:
    """Return what objects are padded by, (n,) or one number for all."""
    if not overrides:
        return padding
    values = [overrides.value(name) for name in names]
    return np.array([padding if value is None else value for value in values], np.float64)


def check_padding(padding: float, name: str = "padding") -> None:
    """Raise ValueError unless a padding is not negative."""
    if as_array(padding, name, ()) < 0.0:
        raise ValueError(f"{name} must not be negative")

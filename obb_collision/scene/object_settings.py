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
from obb_collision.scene.store.overrides import Overrides
from obb_collision.scene.store.patterns import as_patterns, as_tuples
from obb_collision.typing import Floats


class ObjectSettings(SceneStates):
    """Named objects, their padding and their accuracy."""

    def __init__(self, padding: float, accuracy: Accuracy | str) -> None:
        self._padding = 0.0
        self._paddings: Overrides[float] = Overrides()
        self.padding = padding
        self._accuracy = as_accuracy(accuracy)

    def clear(self) -> None:
        """Forget which objects have settings of their own; those for all stay."""
        self._own_padding: set[int] = set()
        self._own_accuracy: set[int] = set()

    @property
    def padding(self) -> float:
        """Metres by which boxes without another padding are grown on every side; may be set."""
        return self._padding

    @padding.setter
    def padding(self, value: float) -> None:
        check_padding(value)
        self._padding = float(value)
        self._pad_again()

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
        self._paddings = Overrides(new)
        self._pad_again()

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
        slot = self._store.slot(name)
        if padding is not None:
            check_padding(padding)
            self._own_padding.add(slot)
            self._store.pad(np.array([slot]), padding)
        else:
            self._own_padding.discard(slot)
            self._store.pad(np.array([slot]), self._padding_of(name))

    def _padding_of(self, name: str) -> float:
        """Return the padding of an object without one of its own."""
        value = self._paddings.value(name)
        return self._padding if value is None else value

    def _paddings_of(self, names: Sequence[str]) -> float | Floats:
        """Return the paddings (n,) of objects without one of their own; one for all, if it is."""
        if not self._paddings:
            return self._padding
        return np.array([self._padding_of(name) for name in names], np.float64)

    def _pad_again(self) -> None:
        """Give all objects without a padding of their own the one that they have now."""
        rows = np.setdiff1d(self._store.live(), sorted(self._own_padding)).astype(np.int64)
        wanted = self._paddings_of([str(self._store.names[row]) for row in rows.tolist()])
        wanted = np.broadcast_to(wanted, rows.shape)
        other = wanted != self._store.own_paddings[rows]
        self._store.pad(rows[other], wanted[other])

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
        self._set_accuracy(self._store.slot(name), level)

    def _set_accuracy(self, slot: int, own: Accuracy | None) -> None:
        if own is None:
            self._own_accuracy.discard(slot)
        else:
            self._own_accuracy.add(slot)
        value = self._accuracy if own is None else own
        if self._store.accuracies[slot] != value:
            self._store.mark(slot)
            self._store.accuracies[slot] = value


def check_padding(padding: float, name: str = "padding") -> None:
    """Raise ValueError unless a padding is not negative."""
    if as_array(padding, name, ()) < 0.0:
        raise ValueError(f"{name} must not be negative")

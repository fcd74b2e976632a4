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

"""Shapes with a formula: box, sphere, cylinder, capsule, cone, ellipsoid.

Every shape has its own frame and is scaled by ``scale`` along the axes of that frame. Its local box
is axis-aligned there and certainly contains it: half extents are exact or the next double above.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.fitting.enclosing import round_up
from obb_collision.geometry.validation import as_array, as_half_extents
from obb_collision.geometry.values import SetOnce
from obb_collision.numerics.constants import MAX_MAGNITUDE
from obb_collision.typing import Floats

Triple = tuple[float, float, float]
#: Centre (3,), rotation (3, 3) and half extents (3,) of a box in the frame of its shape.
LocalBox = tuple[Floats, Floats, Floats]
#: Half extents before scaling, exactly: doubles, or fractions where these are not exact.
Reach = tuple[float | Fraction, float | Fraction, float | Fraction]

Kind = TypeVar("Kind", bound="Shape")

#: The scale that changes nothing.
NO_SCALE: Triple = (1.0, 1.0, 1.0)


def positive_triple(value: ArrayLike, name: str) -> Triple:
    """Return three positive finite numbers; ValueError naming the argument otherwise."""
    if value is NO_SCALE:
        return NO_SCALE
    array = as_array(value, name, (3,))
    if not (array > 0.0).all():
        raise ValueError(f"{name} must be positive, got {array.tolist()}")
    return tuple(array.tolist())


def positive_number(value: ArrayLike, name: str) -> float:
    """Return a positive finite number; ValueError naming the argument otherwise."""
    if isinstance(value, float) and 0.0 < value <= MAX_MAGNITUDE:  # nearly all are
        return float(value)
    number = float(as_array(value, name, ()))
    if not number > 0.0:
        raise ValueError(f"{name} must be positive, got {number!r}")
    return number


class Shape(ABC, SetOnce):
    """A body in its own frame, metres; ``scale`` (3,) stretches it along the axes of that frame.

    Examples
    --------
    >>> isinstance(oc.shapes.Sphere(1), oc.shapes.Shape)
    True
    """

    scale: Triple

    @property
    @abstractmethod
    def local_box(self) -> LocalBox:
        """Centre (3,), rotation (3, 3), half extents (3,): read-only arrays, fitted once."""

    @classmethod
    def trusted(cls: type[Kind], **values: object) -> Kind:
        """Return a shape of valid attributes by name, neither checked nor copied."""
        shape = object.__new__(cls)
        shape._store(**{"scale": NO_SCALE} | values)
        return shape

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes without the hash, which differs in another process."""
        return {name: value for name, value in vars(self).items() if name != "_hash"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the attributes, with read-only arrays."""
        for value in state.values():
            for array in value if isinstance(value, tuple) else (value,):
                if isinstance(array, np.ndarray):
                    array.setflags(write=False)
        vars(self).update(state)

    def _store(self, **values: object) -> None:
        vars(self).update(values)  # past the guard of frozen dataclasses


class Primitive(Shape):
    """A shape whose half extents before scaling are known exactly."""

    @abstractmethod
    def _reach(self) -> Reach: ...

    @cached_property
    def local_box(self) -> LocalBox:
        """Centre (3,), rotation (3, 3), half extents (3,): read-only arrays, fitted once."""
        factors = zip(self.scale, self._reach(), strict=True)
        scaled = (reach if s == 1.0 else Fraction(s) * Fraction(reach) for s, reach in factors)
        try:
            sizes = [x if isinstance(x, float) else round_up(*x.as_integer_ratio()) for x in scaled]
            half_extents = np.array(sizes)
        except OverflowError:
            half_extents = np.full(3, np.inf)
        if half_extents.max() > MAX_MAGNITUDE:
            raise ValueError(f"size times scale must not exceed {MAX_MAGNITUDE:g}")
        return read_only(np.zeros(3), np.eye(3), half_extents)


def _half(length: float) -> float | Fraction:
    half = 0.5 * length
    return half if 2.0 * half == length else Fraction(length) / 2  # of the smallest doubles


def read_only(center: Floats, rotation: Floats, half_extents: Floats) -> LocalBox:
    """Make three arrays read-only and return them: a local box is shared."""
    for array in (center, rotation, half_extents):
        array.setflags(write=False)
    return center, rotation, half_extents


@dataclass(frozen=True, init=False)
class Box(Primitive):
    """A box, by its full edge lengths or half of them; zero is allowed: a flat box.

    Parameters
    ----------
    size : (3,) array_like
        Full edge lengths, metres.
    scale : (3,) array_like
    half_extents : (3,) array_like
        Half the edge lengths, metres, instead of ``size``.

    Examples
    --------
    >>> oc.shapes.Box(size=[2, 1, 0.5]).local_box[2].tolist()  # half extents
    [1.0, 0.5, 0.25]
    """

    size: Triple
    scale: Triple

    def __init__(
        self,
        size: ArrayLike | None = None,
        scale: ArrayLike = NO_SCALE,
        *,
        half_extents: ArrayLike | None = None,
    ) -> None:
        if size is not None and half_extents is None:
            edges = as_half_extents(size, "size", (3,))
        elif size is None and half_extents is not None:
            edges = 2.0 * as_half_extents(half_extents, "half_extents", (3,))
        else:
            both = "both" if size is not None else "neither"
            raise TypeError(f"Box needs size (full edge lengths) or half_extents, got {both}")
        self._store(size=tuple(edges.tolist()), scale=positive_triple(scale, "scale"))

    def _reach(self) -> Reach:
        x, y, z = map(_half, self.size)
        return x, y, z


@dataclass(frozen=True, init=False)
class Sphere(Primitive):
    """A sphere; an ellipsoid when scaled differently along its axes.

    Parameters
    ----------
    radius : float
        Metres.
    scale : (3,) array_like

    Examples
    --------
    >>> oc.shapes.Sphere(radius=0.5).local_box[2].tolist()
    [0.5, 0.5, 0.5]
    """

    radius: float
    scale: Triple

    def __init__(self, radius: float, scale: ArrayLike = NO_SCALE) -> None:
        self._store(radius=positive_number(radius, "radius"), scale=positive_triple(scale, "scale"))

    def _reach(self) -> Reach:
        return self.radius, self.radius, self.radius


@dataclass(frozen=True, init=False)
class Ellipsoid(Primitive):
    """An ellipsoid with half axes ``radii`` (3,) along x, y, z.

    Parameters
    ----------
    radii : (3,) array_like
        Metres.
    scale : (3,) array_like

    Examples
    --------
    >>> oc.shapes.Ellipsoid(radii=[1, 2, 3]).local_box[2].tolist()
    [1.0, 2.0, 3.0]
    """

    radii: Triple
    scale: Triple

    def __init__(self, radii: ArrayLike, scale: ArrayLike = NO_SCALE) -> None:
        self._store(radii=positive_triple(radii, "radii"), scale=positive_triple(scale, "scale"))

    def _reach(self) -> Reach:
        return self.radii


@dataclass(frozen=True, init=False)
class _Revolved(Primitive):
    """A solid of revolution along z, centred at half its length."""

    radius: float
    length: float
    scale: Triple

    def __init__(self, radius: float, length: float, scale: ArrayLike = NO_SCALE) -> None:
        self._store(
            radius=positive_number(radius, "radius"),
            length=positive_number(length, "length"),
            scale=positive_triple(scale, "scale"),
        )

    def _reach(self) -> Reach:
        return self.radius, self.radius, _half(self.length)


class Cylinder(_Revolved):
    """A cylinder along z, centred; ``length`` is its height.

    Parameters
    ----------
    radius : float
        Metres.
    length : float
        Metres.
    scale : (3,) array_like

    Examples
    --------
    >>> oc.shapes.Cylinder(radius=0.5, length=2).local_box[2].tolist()
    [0.5, 0.5, 1.0]
    """

    def __init__(self, radius: float, length: float, scale: ArrayLike = NO_SCALE) -> None:
        super().__init__(radius, length, scale)  # errors about arguments name this class


class Cone(_Revolved):
    """A cone along z with its apex at +length / 2 and its base of ``radius`` at -length / 2.

    Parameters
    ----------
    radius : float
        Metres.
    length : float
        Metres.
    scale : (3,) array_like

    Examples
    --------
    >>> oc.shapes.Cone(radius=0.5, length=2).local_box[2].tolist()
    [0.5, 0.5, 1.0]
    """

    def __init__(self, radius: float, length: float, scale: ArrayLike = NO_SCALE) -> None:
        super().__init__(radius, length, scale)  # errors about arguments name this class


class Capsule(_Revolved):
    """A capsule along z, centred; ``length`` does not include the two caps.

    Parameters
    ----------
    radius : float
        Metres.
    length : float
        Metres.
    scale : (3,) array_like

    Examples
    --------
    >>> oc.shapes.Capsule(radius=0.5, length=2).local_box[2].tolist()
    [0.5, 0.5, 1.5]
    """

    def __init__(self, radius: float, length: float, scale: ArrayLike = NO_SCALE) -> None:
        super().__init__(radius, length, scale)  # errors about arguments name this class

    def _reach(self) -> Reach:
        x, y, half = super()._reach()
        return x, y, Fraction(half) + Fraction(self.radius)

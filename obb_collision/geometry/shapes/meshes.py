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

"""Shapes made of points: convex hulls and triangle meshes, from arrays or files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from functools import cached_property
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.geometry.fitting.fit import check_fit, fit_points
from obb_collision.geometry.formats.parts import Triangles, shortened
from obb_collision.geometry.shapes.files import read_file, read_mesh, resolve_path
from obb_collision.geometry.shapes.primitives import (
    NO_SCALE,
    LocalBox,
    Shape,
    Triple,
    positive_triple,
    read_only,
)
from obb_collision.geometry.validation import (
    as_array,
    as_half_extents,
    as_indices,
    as_rotations,
    check_kind,
    check_magnitude,
)
from obb_collision.numerics.constants import ROUNDOFF, SPLITTER
from obb_collision.typing import Floats
from obb_collision.words import printable

#: Products and their errors are exact above this magnitude (no underflow) ...
SMALLEST_EXACT = 2.0**-900
#: ... and factors up to this one can be split without overflow.
LARGEST_EXACT = 2.0**990


class _PointsShape(Shape):
    """A shape whose local box is that of its scaled points."""

    fit: str

    def _points(self) -> Floats:
        raise NotImplementedError

    def __eq__(self, other: object) -> bool:
        if not (isinstance(other, _PointsShape) and type(self) is type(other)):
            return NotImplemented
        return self is other or all(map(np.array_equal, self._value(), other._value()))

    def _value(self) -> Iterator[Any]:
        values = (getattr(self, field.name) for field in fields(self))  # type: ignore[arg-type]
        return chain(values, self.local_box)

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        points = self._points() + 0.0  # -0 equals 0
        return hash((type(self), self.scale, self.fit, points.tobytes()))

    @cached_property
    def local_box(self) -> LocalBox:
        """Centre (3,), rotation (3, 3), half extents (3,): read-only arrays, fitted once."""
        points = self._points()
        scale = np.array(self.scale)
        with np.errstate(over="ignore"):
            scaled = points * scale
        check_magnitude(scaled, "points times scale", by_row=True)
        center, rotation, half_extents = fit_points(scaled, self.fit)
        inexact = ~_exact_products(points, scale, scaled)
        if inexact.any():
            error = np.where(inexact, np.abs(scaled), 0.0).max(axis=0) * ROUNDOFF
            smallest = np.finfo(float).smallest_subnormal
            error = np.where(inexact.any(axis=0), np.maximum(error, smallest), 0.0)
            # |R^-1 e| exceeds |R|^T |e| by roundoffs of it at most, which the factor covers.
            wider = half_extents + (np.abs(rotation).T @ error) * (1.0 + 64.0 * ROUNDOFF)
            half_extents = np.nextafter(wider, np.inf)
        return read_only(center, rotation, half_extents)


def _exact_products(a: Floats, b: Floats, product: Floats) -> NDArray[np.bool_]:
    """Return whether a * b == product exactly (Dekker's product); False where undecided."""
    with np.errstate(over="ignore", invalid="ignore"):
        a_high, b_high = (x * SPLITTER - (x * SPLITTER - x) for x in (a, b))
        a_low, b_low = a - a_high, b - b_high
        error = a_high * b_high - product + a_high * b_low + a_low * b_high + a_low * b_low
        size = np.abs(product)
        small = np.maximum(np.abs(a), b) <= LARGEST_EXACT
    exact: NDArray[np.bool_] = (error == 0.0) & (size >= SMALLEST_EXACT) & small
    return exact | (a == 0.0)


@dataclass(frozen=True, init=False, eq=False)
class Hull(_PointsShape):
    """The convex hull of points (n, 3), n >= 1; ``fit`` as in ``OBB.from_points``.

    Parameters
    ----------
    points : (n, 3) array_like
        Metres.
    scale : (3,) array_like
    fit : str
        As in ``OBB.from_points``.

    Examples
    --------
    >>> oc.shapes.Hull([[0, 0, 0], [2, 4, 6]], fit="aabb").local_box[2].tolist()
    [1.0, 2.0, 3.0]
    """

    points: Floats
    scale: Triple
    fit: str

    def __init__(self, points: ArrayLike, scale: ArrayLike = NO_SCALE, fit: str = "best") -> None:
        self._store(
            points=_owned_points(points, "points"),
            scale=positive_triple(scale, "scale"),
            fit=check_fit(fit),
        )

    @classmethod
    def fitted(cls, points: Floats, local_box: LocalBox) -> Hull:
        """Return the hull of points whose local box is known; both are checked."""
        hull = cls(points)
        hull._store(local_box=_checked_box(*local_box))
        return hull

    def _points(self) -> Floats:
        return self.points


class Triangulation(Protocol):
    """Anything with vertices (n, 3) and faces (m, 3), such as a ``trimesh.Trimesh``."""

    @property
    def vertices(self) -> ArrayLike:
        """(n, 3) metres."""

    @property
    def faces(self) -> ArrayLike:
        """(m, 3) indices of vertices."""


@dataclass(frozen=True, init=False, eq=False)
class Mesh(_PointsShape):
    """Triangles: vertices (n, 3), metres, and faces (m, 3), the indices of their vertices.

    The local box is that of the triangles; unused vertices are ignored. Without faces it is the box
    of all vertices.

    Parameters
    ----------
    vertices : (n, 3) array_like or mesh
        Metres, at least one; or a ``trimesh.Trimesh``, or anything with ``vertices`` and ``faces``.
    faces : (m, 3) array_like of int, optional
        Indices of vertices; left out with a mesh.
    scale : (3,) array_like
    fit : str
        As in ``OBB.from_points``.

    Examples
    --------
    >>> import trimesh
    >>> len(oc.shapes.Mesh(trimesh.creation.box((1, 2, 3))).faces)
    12
    """

    vertices: Floats
    faces: Triangles = field(repr=False)
    scale: Triple
    fit: str

    def __init__(
        self,
        vertices: ArrayLike | Triangulation,
        faces: ArrayLike | None = None,
        scale: ArrayLike = NO_SCALE,
        fit: str = "best",
    ) -> None:
        if faces is None:
            mesh: Any = vertices
            try:
                vertices, faces = mesh.vertices, mesh.faces
            except AttributeError:
                raise TypeError(
                    "faces must be given, unless vertices is a mesh such as trimesh's"
                ) from None
        points = _owned_points(vertices, "vertices")
        self._store(
            vertices=points,
            faces=_checked_faces(faces, len(points)),
            scale=positive_triple(scale, "scale"),
            fit=check_fit(fit),
        )

    @classmethod
    def fitted(cls, vertices: Floats, faces: Triangles, scale: Floats, local_box: LocalBox) -> Mesh:
        """Return a mesh whose local box is known; all of it is checked."""
        mesh = cls(vertices, faces, scale)
        mesh._store(local_box=_checked_box(*local_box))
        return mesh

    @classmethod
    def from_file(cls, path: str | Path, scale: ArrayLike = NO_SCALE, fit: str = "best") -> Mesh:
        """Return the mesh of a file: STL, OBJ, PLY, OFF, DAE, GLB or glTF.

        All that it declares is read, or ValueError names the file and what is wrong with it; it has
        at most a gigabyte. The parts of a scene are joined, each where the scene places it. Lengths
        are metres; a file that names another unit (DAE) is converted. Polygons become triangles
        that cover them. Only the file itself is read: no materials, textures or buffers in other
        files.

        Parameters
        ----------
        path : str or path
            A path, a file:// or a package:// URI (the latter needs ROS).
        scale : (3,) array_like
        fit : str
            As in ``OBB.from_points``.

        Examples
        --------
        >>> import tempfile, trimesh
        >>> with tempfile.NamedTemporaryFile(suffix=".stl") as file:
        ...     _ = trimesh.creation.box((1, 2, 3)).export(file.name)
        ...     len(oc.shapes.Mesh.from_file(file.name).faces)
        12
        """
        check_kind(path, str, "path", PathLike)
        file = resolve_path(path)
        try:
            return cls(*read_mesh(read_file(file)[0], file.name), scale, fit)
        except (ValueError, MemoryError) as error:
            reason = "there is not enough memory" if isinstance(error, MemoryError) else error
            where = printable(shortened(str(file)))
            raise ValueError(f"mesh file {where}: {printable(str(reason))}") from error

    def _points(self) -> Floats:
        return self.vertices[np.unique(self.faces)] if len(self.faces) else self.vertices


def _owned_points(value: Any, name: str) -> Floats:
    points = as_array(value, name, (None, 3)).copy()
    if len(points) == 0:
        raise ValueError(f"{name} must not be empty")
    points.setflags(write=False)
    return points


def _checked_box(center: Floats, rotation: Floats, half_extents: Floats) -> LocalBox:
    return read_only(
        as_array(center, "center", (3,)),
        as_rotations(rotation, "rotation", (3, 3)),
        as_half_extents(half_extents, "half_extents", (3,)),
    )


def _checked_faces(value: ArrayLike, vertices: int) -> Triangles:
    faces = as_indices(value, "faces", "integers of shape (n, 3)")
    if faces.size == 0:
        faces = np.empty((0, 3), np.int64)
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise ValueError(
            f"faces must be integers of shape (n, 3), got {faces.dtype} of shape {faces.shape}"
        )
    wrong = ((faces < 0) | (faces >= vertices)).any(axis=1)
    if wrong.any():
        row = int(wrong.argmax())
        raise ValueError(
            f"faces must index vertices 0 to {vertices - 1} in row {row}, got {faces[row].tolist()}"
        )
    checked = faces.astype(np.int64, copy=False)
    checked.setflags(write=False)
    return checked

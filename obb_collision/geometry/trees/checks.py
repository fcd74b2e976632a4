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

"""Validation of the arrays of mesh trees: kernels follow the indices in them unchecked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.trees.node_fit import NODE

Arrays = Mapping[str, NDArray[Any]]

#: Kind and shape of each array: f triangles, m nodes, k meshes, p pieces, s = k + 1.
KINDS: Mapping[str, tuple[type, tuple[str | int, ...]]] = {
    "triangles": (np.float64, ("f", 9)),
    "faces": (np.int64, ("f",)),
    "counted": (np.bool_, ("f",)),
    "nodes": (np.float64, ("m", NODE)),
    "children": (np.int64, ("m",)),
    "starts": (np.int64, ("m", 2)),
    "levels": (np.int64, ("m",)),
    "roots": (np.int64, ("k",)),
    "solid": (np.bool_, ("k",)),
    "winding": (np.bool_, ("k",)),
    "radii": (np.float64, ("k",)),
    "pieces": (np.float64, ("p", 6, 3)),
    "piece_starts": (np.int64, ("s",)),
}
#: Maximum number of levels of a tree: 2^31 triangles have 75, stacks have room for 128 per tree.
MAX_LEVELS = 100


def checked_arrays(given: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Return copies of the arrays of ``MeshTrees`` by name; ValueError naming what is wrong.

    Copies, for what is checked must not change behind our back.
    """
    arrays = {name: np.array(given[name], order="C") for name in KINDS}
    sizes: dict[str, int] = {}
    for name, (kind, shape) in KINDS.items():
        array = arrays[name]
        if array.dtype != kind or array.ndim != len(shape):
            raise ValueError(f"{name} must be {kind.__name__} of {len(shape)} dimensions")
        for size, got in zip(shape, array.shape, strict=True):
            if got != (size if isinstance(size, int) else sizes.setdefault(size, got)):
                raise ValueError(f"{name} must have as many rows as the arrays it belongs to")
    if sizes["k"] < 1 or sizes["s"] != sizes["k"] + 1:
        raise ValueError("piece_starts must have one row more than roots, which must not be empty")
    _check_nodes(arrays, sizes)
    _within(arrays["roots"], sizes["m"] - 1, "roots")
    _within(arrays["piece_starts"], sizes["p"], "piece_starts")
    if (np.diff(arrays["piece_starts"]) < 0).any():
        raise ValueError("piece_starts must not decrease")
    if (arrays["faces"] < 0).any():
        raise ValueError("faces must not be negative")
    for name in ("triangles", "nodes", "radii", "pieces"):
        if not np.isfinite(arrays[name]).all():
            raise ValueError(f"{name} must be finite")
    return arrays


def _check_nodes(arrays: Arrays, sizes: Mapping[str, int]) -> None:
    children, levels, starts = arrays["children"], arrays["levels"], arrays["starts"]
    parents = np.flatnonzero(children >= 0)
    first = children[parents]
    if (children < -1).any() or (first >= sizes["m"] - 1).any() or (first <= parents).any():
        raise ValueError("children must be -1 or the first of two rows after their parent's")
    if len(np.unique(first)) < len(first):
        raise ValueError("children must have one parent")
    _within(levels, MAX_LEVELS, "levels")
    if any((levels[first + k] != levels[parents] + 1).any() for k in range(2)):
        raise ValueError("levels must be one more than their parents'")
    _within(starts, sizes["f"], "starts")
    if (starts[:, 0] > starts[:, 1]).any():
        raise ValueError("starts must be ranges of triangles, the first not above the last")


def _within(array: NDArray[Any], maximum: int, name: str) -> None:
    if ((array < 0) | (array > maximum)).any():
        raise ValueError(f"{name} must be from 0 to {maximum}")

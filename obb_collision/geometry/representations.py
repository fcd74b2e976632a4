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

"""Other representations of a box.

This package computes with centre, rotation and half extents (15 numbers). The others are for
storing, sending or drawing boxes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import as_array
from obb_collision.typing import Floats


def face_planes(boxes: Boxes) -> Floats:
    """Return six planes (n, 6, 4), outward unit normal and offset: inside is n.x <= offset.

    Faces in the order +x, -x, +y, -y, +z, -z of the box's own axes.
    """
    normals = np.stack([boxes.rotations, -boxes.rotations], axis=-1).transpose(0, 2, 3, 1)
    normals = normals.reshape(-1, 6, 3)
    reach = np.repeat(boxes.half_extents, 2, axis=1)
    offsets = np.einsum("nfk,nk->nf", normals, boxes.centers) + reach
    return np.concatenate([normals, offsets[..., None]], axis=-1)


def corner_and_edges(boxes: Boxes) -> Floats:
    """Return the corner with all minus signs, then the three full edge vectors, (n, 4, 3)."""
    edges = 2.0 * boxes.half_extents[:, :, None] * boxes.rotations.transpose(0, 2, 1)
    corner = boxes.centers - 0.5 * edges.sum(axis=1)
    return np.concatenate([corner[:, None], edges], axis=1)


def to_compact(boxes: Boxes) -> Floats:
    """Return rows (n, 12): centre, half extents, two axes; their cross product is the third."""
    axes = boxes.rotations.transpose(0, 2, 1)[:, :2].reshape(-1, 6)
    return np.concatenate([boxes.centers, boxes.half_extents, axes], axis=1)


def from_compact(numbers: ArrayLike) -> Boxes:
    """Return the boxes of rows (n, 12) from ``to_compact``; ValueError where a row is not a box."""
    array = as_array(numbers, "numbers", (None, 12))
    x, y = array[:, 6:9], array[:, 9:12]
    rotations = np.stack([x, y, np.cross(x, y)], axis=-1)
    return Boxes(array[:, :3], rotations, array[:, 3:6])

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

"""Volume that two boxes share, and intersection over union.

The smaller box is clipped by the six half-spaces of the other. What is certain is
exact: 0 where ``verdicts`` does not say OVERLAP and for flat boxes, which have no volume; the whole
volume, and 1, for boxes that are the same set. The answer for b and a is that for a and b, bit for
bit.

Accuracy: a volume is off by at most VOLUME_BOUND. So the volume of a thin box has
as many digits as its thickness has relative to the size of the pair.

Faces are loops of directed edges, in no order. A plane cuts each face between an edge that leaves
and one that enters: the cut closes the face, and reversed it is an edge of the new face in the
plane. Both faces of an edge compute its cut from the same end to the other, so the surface stays
closed bit for bit, whatever rounding does, and its volume is off only as far as its points are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays, Boxes, box_volumes
from obb_collision.geometry.validation import as_flag, check_kind
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.vec3 import dot, dot_abs, vector_at, write_at
from obb_collision.queries.verdict.pair_rows import as_pairs, as_sides, one_set
from obb_collision.queries.verdict.sat import BoxPair, box_at, enter_frame
from obb_collision.queries.verdict.verdict import OVERLAP, SEPARATE, pair_verdicts
from obb_collision.typing import Floats, Integers, Vector


def overlap_volumes(a: Boxes, b: Boxes, pairs: ArrayLike | None = None) -> Floats:
    """Return the volume that boxes share.

    Parameters
    ----------
    a, b : Boxes
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.

    Returns
    -------
    (m,) array
        Cubic metres. Exactly 0 where ``verdicts`` does not say OVERLAP and for flat boxes; exactly
        the volume of both for boxes that are the same set, also with axes swapped or reversed.
        Positive otherwise. Infinite beyond 1.8e308.

    References
    ----------
    Sutherland, Hodgman, Reentrant Polygon Clipping (CACM 1974).

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [1, 0, 0], [9, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.overlap_volumes(boxes, boxes, [[0, 0], [0, 1], [0, 2]]).tolist()
    [8.0, 4.0, 0.0]
    """
    return _overlaps(a, b, pairs)[0]


def iou(a: Boxes, b: Boxes, pairs: ArrayLike | None = None, *, generalized: bool = False) -> Floats:
    """Return intersection over union: the volume that boxes share by the volume that they cover.

    Parameters
    ----------
    a, b : Boxes
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.
    generalized : bool
        Subtract the share of the smallest box about both, along the axes of one of them, that they
        do not cover: boxes that are apart get -1 to 0, by how far.

    Returns
    -------
    (m,) array
        From 0 to 1. Exactly 0 where ``overlap_volumes`` is, and exactly 1 for boxes that are the
        same set, also with axes swapped or reversed. Flat boxes have 1 with themselves, else 0.

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [1, 0, 0], [9, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.iou(boxes, boxes, [[0, 0], [0, 1], [0, 2]]).round(6).tolist()
    [1.0, 0.333333, 0.0]
    >>> oc.iou(boxes, boxes, [[0, 0], [0, 1], [0, 2]], generalized=True).round(6).tolist()
    [1.0, 0.333333, -0.636364]
    """
    shared, ratios = _overlaps(a, b, pairs)
    if not as_flag(generalized, "generalized"):
        return ratios
    first, second = as_sides(a, b, pairs)
    sides = [boxes[rows].arrays for boxes, rows in ((a, first), (b, second))]
    union = box_volumes(sides[0].half_extents) + box_volumes(sides[1].half_extents) - shared
    around = np.minimum(_volume_about(*sides), _volume_about(*sides[::-1]))
    with np.errstate(divide="ignore", invalid="ignore"):
        uncovered = np.nan_to_num(1.0 - union / around, posinf=0.0, neginf=0.0)
    return np.where(ratios == 1.0, 1.0, ratios - np.clip(uncovered, 0.0, 1.0))


def _volume_about(a: BoxArrays, b: BoxArrays) -> Floats:
    """Return the volumes (m,) of the boxes along the axes of a about a and b, row by row."""
    turns = np.einsum("nki,nkj->nij", a.rotations, b.rotations)
    middle = np.einsum("nki,nk->ni", a.rotations, b.centers - a.centers)
    reach = np.einsum("nij,nj->ni", np.abs(turns), b.half_extents)
    high = np.maximum(a.half_extents, middle + reach)
    low = np.minimum(-a.half_extents, middle - reach)
    return box_volumes(0.5 * (high - low))


def _overlaps(a: Boxes, b: Boxes, pairs: ArrayLike | None) -> tuple[Floats, Floats]:
    check_kind(a, Boxes, "a")
    check_kind(b, Boxes, "b")
    rows = as_pairs(a, b, pairs)
    verdicts = pair_verdicts(a, rows[:, 0].copy(), b, rows[:, 1].copy())
    boxes, rows = one_set(a, b, rows)
    sizes, out = box_volumes(boxes.half_extents), np.zeros((2, len(rows)))
    solid = np.asarray((boxes.half_extents > 0.0).all(axis=1))
    clipped = np.flatnonzero(verdicts == OVERLAP)
    clipped = clipped[solid[rows[clipped, 0]] & solid[rows[clipped, 1]]]
    overlap_kernel(boxes.arrays, sizes, _in_order(boxes, sizes, rows[clipped]), clipped, out)
    same = np.flatnonzero(verdicts != SEPARATE)
    same = same[_same_sets(boxes, rows[same])]
    out[0, same], out[1, same] = sizes[rows[same, 0]], 1.0
    return out[0], out[1]


def _same_sets(boxes: Boxes, pairs: Integers) -> Integers:
    """Return which pairs (m, 2) are the same set: their axes may be swapped and reversed."""
    centers, rotations, half_extents = boxes.arrays
    same = np.flatnonzero((centers[pairs[:, 0]] == centers[pairs[:, 1]]).all(axis=1))
    (h, f), (r, s) = (np.moveaxis(x[pairs[same]], 1, 0) for x in (half_extents, rotations))
    x, y = r.transpose(0, 2, 1)[:, :, None], s.transpose(0, 2, 1)[:, None]
    parallel = (x == y).all(axis=3) | (x == -y).all(axis=3)
    matched = (parallel & (h[:, :, None] == f[:, None])).any(axis=2)
    matched |= h == 0.0  # the direction of such an axis doesn't matter
    flat = [(x == 0.0).sum(axis=1) for x in (h, f)]
    return same[matched.all(axis=1) & (flat[0] == flat[1])]


def _in_order(boxes: Boxes, sizes: Floats, pairs: Integers) -> Integers:
    """Return pairs (m, 2), the smaller box first, which is clipped; ties by their numbers."""
    left, right = sizes[pairs[:, 0]], sizes[pairs[:, 1]]
    later, equal = right < left, np.flatnonzero(left == right)
    if len(equal):
        centers, rotations, half_extents = (x[pairs[equal]] for x in boxes.arrays)
        places = np.stack([centers, half_extents], axis=3).reshape(-1, 2, 6)
        keys = np.concatenate([places, rotations.reshape(-1, 2, 9)], axis=2)
        first = (keys[:, 0] != keys[:, 1]).argmax(axis=1)
        left, right = (keys[np.arange(len(equal)), side, first] for side in (0, 1))
        later[equal] = right < left
    return np.where(later[:, None], pairs[:, ::-1], pairs)


#: Bound of a volume, relative to T S: T the offset of the centres (components summed) and the half
#: extents, S the surface of the smaller box, by which the volume changes when a plane moves.
VOLUME_BOUND = 32 * ROUNDOFF
#: Faces of a box clipped by six planes.
CLIPPED_FACES = 12
#: Edges of a face: four, or a cut through each of 11 others, and one more for each further plane;
#: as many again where rounding bends a face.
FACE_EDGES = 32
#: Cuts of one face by a plane: one, or more by rounding.
FACE_CUTS = FACE_EDGES
#: The least positive volume: that of boxes which overlap, though rounding says they don't.
LEAST_OVERLAP = 5e-324


@njit
def overlap_kernel(
    boxes: BoxArrays, sizes: Floats, pairs: np.ndarray, rows: np.ndarray, out: Floats
) -> None:
    """Write overlap volumes and intersections over unions of pairs (m, 2) to rows of (2, n).

    sizes (n,): volumes of the boxes. Pairs overlap, and boxes are not flat.
    """
    edges = np.empty((CLIPPED_FACES, FACE_EDGES, 6))
    counts = np.empty(CLIPPED_FACES, np.int64)
    cuts = np.empty((2, FACE_CUTS, 3))
    for n in range(len(pairs)):
        i, j = pairs[n, 0], pairs[n, 1]
        pair, _, scale = enter_frame(box_at(boxes, i), box_at(boxes, j))
        size, other = _volume_of(pair.h), _volume_of(pair.f)
        common = min(_clipped_volume(pair, edges, counts, cuts), size, other)
        larger, smaller = max(size, other), min(size, other)
        ratio = common / (larger + (smaller - common)) if common > 0.0 else 0.0
        volume = common / scale / scale / scale
        out[0, rows[n]] = max(min(volume, sizes[i], sizes[j]), LEAST_OVERLAP)
        out[1, rows[n]] = max(ratio, LEAST_OVERLAP)


@njit
def _volume_of(h: Vector) -> float:
    """Return the volume of a box, whatever the order of its half extents."""
    small, large = min(h[0], h[1], h[2]), max(h[0], h[1], h[2])
    middle = max(min(h[0], h[1]), min(max(h[0], h[1]), h[2]))
    return (2.0 * small) * (2.0 * middle) * (2.0 * large)


@njit
def _clipped_volume(pair: BoxPair, edges: Floats, counts: np.ndarray, cuts: Floats) -> float:
    """Return the volume of box a within box b, in the frame of a."""
    _fill_box(pair.h, edges, counts)
    faces = 6
    for k in range(3):
        axis = pair.r[k]
        middle = dot(axis, pair.d)
        reach = dot_abs(pair.h, axis)
        for sign in (-1.0, 1.0):
            if reach - sign * middle <= pair.f[k]:
                continue  # all of a is within
            normal = sign * axis[0], sign * axis[1], sign * axis[2]
            _clip(normal, sign * middle + pair.f[k], faces, edges, counts, cuts)
            faces += 1
    return _volume(faces, edges, counts)


@njit
def _fill_box(h: Vector, edges: Floats, counts: np.ndarray) -> None:
    """Write the six faces of a box about the origin, counterclockwise seen from outside."""
    corner = np.empty(3)
    for face in range(6):
        k = face // 2
        side = 1.0 if face % 2 == 0 else -1.0
        for n in range(4):
            for end in range(2):
                turn = (n + end) % 4
                u = 1.0 if turn in (1, 2) else -1.0
                v = 1.0 if turn in (2, 3) else -1.0
                corner[k] = side * h[k]
                corner[(k + 1) % 3] = u * h[(k + 1) % 3]
                corner[(k + 2) % 3] = v * h[(k + 2) % 3]
                first = 3 * end if side > 0.0 else 3 - 3 * end
                for m in range(3):
                    edges[face, n, first + m] = corner[m]
        counts[face] = 4


@njit
def _clip(
    normal: Vector, offset: float, faces: int, edges: Floats, counts: np.ndarray, cuts: Floats
) -> None:
    """Clip all faces by normal . x <= offset, and write the face in that plane as the last."""
    counts[faces] = 0
    for face in range(faces):
        kept, leaving, entering = 0, 0, 0
        for n in range(counts[face]):
            edge = edges[face, n]
            p, q = (edge[0], edge[1], edge[2]), (edge[3], edge[4], edge[5])
            above_p, above_q = dot(normal, p) - offset, dot(normal, q) - offset
            if above_p > 0.0 and above_q > 0.0:
                continue
            if above_q > 0.0:
                q = _cut(p, q, above_p, above_q)
                write_at(cuts[0], leaving, q)
                leaving += 1
            elif above_p > 0.0:
                p = _cut(q, p, above_q, above_p)
                write_at(cuts[1], entering, p)
                entering += 1
            _put_edge(edges[face], kept, p, q)
            kept += 1
        for n in range(min(leaving, entering)):
            p, q = vector_at(cuts[0], n), vector_at(cuts[1], n)
            if p != q and kept < FACE_EDGES and counts[faces] < FACE_EDGES:
                _put_edge(edges[face], kept, p, q)
                kept += 1
                _put_edge(edges[faces], counts[faces], q, p)
                counts[faces] += 1
        counts[face] = kept


@njit
def _cut(inside: Vector, outside: Vector, below: float, above: float) -> Vector:
    """Return where an edge passes a plane; below <= 0 < above are its ends' distances from it."""
    t = below / (below - above)
    x = inside[0] + t * (outside[0] - inside[0])
    y = inside[1] + t * (outside[1] - inside[1])
    return x, y, inside[2] + t * (outside[2] - inside[2])


@njit
def _put_edge(rows: Floats, n: int, p: Vector, q: Vector) -> None:
    rows[n, 0], rows[n, 1], rows[n, 2] = p
    rows[n, 3], rows[n, 4], rows[n, 5] = q


@njit
def _volume(faces: int, edges: Floats, counts: np.ndarray) -> float:
    """Return the volume within a closed surface, by tetrahedra from the origin (Gauss)."""
    total = 0.0
    for face in range(faces):
        if counts[face] < 3:
            continue
        x, y, z = edges[face, 0, 0], edges[face, 0, 1], edges[face, 0, 2]
        for n in range(1, counts[face]):
            p, q, r, s, t, u = edges[face, n]
            total += x * (q * u - r * t) + y * (r * s - p * u) + z * (p * t - q * s)
    return total / 6.0

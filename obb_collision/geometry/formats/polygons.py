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

"""Triangulates polygons: the triangles cover a polygon exactly.

A polygon is projected along the coordinate axis nearest to its normal (Newell's), which changes no
coordinate. Most polygons become a fan about a corner; the others are triangulated by ear clipping
(Meisters 1975). Corners may coincide, as where two edges along one line join a hole to the outline.
A polygon that crosses itself becomes the fan about its first corner, which covers it and perhaps
more. A polygon that is not flat is triangulated in its projection.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from obb_collision.geometry.formats.parts import NO_FACES, MeshError, Triangles, check_corners
from obb_collision.typing import Floats, Mask

#: Corners of polygons that are cut at once.
TOGETHER = 1 << 18
#: Limit of corners examined in all tests of ears, half a minute; and the price of a test of few
#: corners, in corners.
MOST_LOOKS, FEWEST_LOOKS = 1_000_000_000, 1000
#: Limits of pairs of corners between which a hole may be joined to an outline, and of those tried.
MOST_PAIRS, MOST_TRIES = 10_000_000, 1000


def triangulated(points: Floats, corners: Triangles, counts: Triangles) -> Triangles:
    """Return triangles (m, 3) of polygons, in no special order.

    points: (n, 3); corners: (sum of counts,) indices of points, polygon after polygon; counts: how
    many corners each has. Polygons of fewer than three are left out. ValueError for an index out
    of range, and where triangulation would take too long.
    """
    check_corners(corners, len(points))
    firsts = np.cumsum(counts) - counts
    cutter, made = _Cutter(), [NO_FACES]
    order = np.argsort(counts, kind="stable")
    sizes, starts = np.unique(counts[order], return_index=True)
    for count, polygons in zip(sizes.tolist(), np.split(order, starts[1:]), strict=False):
        if count < 3:
            continue
        rows = firsts[polygons]
        step = max(1, TOGETHER // count)
        for start in range(0, len(rows), step):
            ring = corners[rows[start : start + step, None] + np.arange(count)]
            made.append(ring if count == 3 else cutter.cut(points, ring))
    return np.concatenate(made)


def with_holes(points: Floats, loops: list[Triangles]) -> Triangles:
    """Return the corners of one polygon: the first loop, joined to the others, which are holes.

    ValueError where a hole can't be joined to the outline by a line that crosses nothing.
    """
    axes = _axes(points[loops[0]][None])[0]
    flat = points[:, axes]
    walls = [(flat[loop], flat[np.roll(loop, -1)]) for loop in loops]
    starts, ends = (np.concatenate(parts) for parts in zip(*walls, strict=True))
    outline = loops[0]
    for hole in loops[1:]:
        if _area(flat[hole]) > 0.0:  # holes run round the other way
            hole = hole[::-1]
        corner, first = _bridge(flat[outline], flat[hole], starts, ends)
        order = np.r_[first : len(hole), 0 : first + 1]
        outline = np.concatenate([outline[: corner + 1], hole[order], outline[corner:]])
        bridge = flat[hole[first]][None], flat[outline[corner]][None]
        starts, ends = (np.concatenate(pair) for pair in zip((starts, ends), bridge, strict=True))
    return outline


class _Cutter:
    """Triangulates many polygons with equal numbers of corners at once; limits the total work."""

    def __init__(self) -> None:
        self._looks = 0

    def cut(self, points: Floats, rings: Triangles) -> Triangles:
        """Return triangles (k (n - 2), 3) of polygons (k, n), n > 3."""
        count = rings.shape[1]
        flat, local = _flat(points[rings]), np.empty((len(rings), count - 2, 3), np.int64)
        local[:] = fan = _fan(count, 0)
        waiting = np.flatnonzero(~_is_fan(flat, 0))
        others = flat[waiting]
        as_second = _is_fan(others, 1)
        local[waiting[as_second]] = _fan(count, 1)
        waiting, others = waiting[~as_second], others[~as_second]
        # a flat line stays a fan; so does a quadrangle that is no fan, as it crosses itself
        solid = _area(others) > 0.0
        if count > 4 and solid.any():
            local[waiting[solid]] = self._ears(others[solid], fan)
        return rings[np.arange(len(rings))[:, None, None], local].reshape(-1, 3)

    def _ears(self, flat: Floats, fan: Triangles) -> Triangles:
        """Return triangles (k, n - 2, 3) of polygons (k, n, 2); ``fan`` for one without ears."""
        polygons, count, _ = flat.shape
        made = np.tile(fan, (polygons, 1, 1))
        rows, left = np.arange(polygons), np.tile(np.arange(count), (polygons, 1))
        start = 1
        for length in range(count, 2, -1):
            ears = self._find_ears(flat, start % length)
            start = int(ears[0]) if len(ears) else 0  # the next one is tried at the next corner
            crossing = ears < 0
            if crossing.any():
                made[rows[crossing]] = fan
                rows, left = rows[~crossing], left[~crossing]
                flat, ears = flat[~crossing], ears[~crossing]
            if len(rows) == 0:
                break
            polygon = np.arange(len(rows))[:, None]
            around = np.stack([ears - 1, ears, ears + 1], axis=1) % length
            made[rows, count - length] = left[polygon, around]
            keep = np.arange(length) != ears[:, None]
            left = left[keep].reshape(-1, length - 1)
            flat = flat[keep].reshape(-1, length - 1, 2)
        return made

    def _find_ears(self, flat: Floats, start: int) -> Triangles:
        """Return an ear of each polygon (k, n, 2), else a corner on a line, else -1.

        The triangle of an ear and its neighbours holds no other corner.
        """
        count = flat.shape[1]
        ears, on_line = np.full((2, len(flat)), -1)
        waiting = np.arange(len(flat))
        for at in (start + np.arange(count)) % count:
            a, b, c = (flat[waiting, (at + step) % count] for step in (-1, 0, 1))
            turn = _turn(a, b, c)
            on_line[waiting[turn == 0.0]] = at
            bulges = turn > 0.0
            convex = waiting[bulges]
            self._count(len(convex) * count)
            if len(convex):
                ear = np.stack([a, b, c])[:, bulges, None]
                free = count == 3 or ~_holds(ear[0], ear[1], ear[2], flat[convex])
                ears[convex[free]] = at
            waiting = waiting[ears[waiting] < 0]
            if len(waiting) == 0:
                break
        return np.where(ears < 0, on_line, ears)

    def _count(self, looks: int) -> None:
        self._looks += looks + FEWEST_LOOKS
        if self._looks > MOST_LOOKS:
            raise MeshError("its concave faces take too long to cut: export it as triangles")


def _fan(count: int, first: int) -> Triangles:
    """Return the triangles (count - 2, 3) of a fan about corner ``first`` of a polygon."""
    steps = np.arange(1, count - 1)
    return (first + np.stack([0 * steps, steps, steps + 1], axis=1)) % count


def _is_fan(flat: Floats, first: int) -> Mask:
    """Return (k,) whether the fan about a corner triangulates polygons (k, n, 2) exactly."""
    around = np.roll(flat, -first, axis=1)
    root, rest = around[:, :1], around[:, 1:]
    turns = _turn(root, rest[:, :-1], rest[:, 1:])
    good: Mask = (turns >= 0.0).all(axis=1)
    if flat.shape[1] > 4:  # two triangles make no full turn; more of them do in a half-plane only
        good &= (_turn(root, rest[:, :1], rest) >= 0.0).all(axis=1)
    return good


def _turn(a: Floats, b: Floats, c: Floats) -> Any:
    """Return twice the area of triangles; positive where they run anticlockwise."""
    u, v = b - a, c - a
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def _holds(a: Floats, b: Floats, c: Floats, points: Floats) -> Any:
    """Return whether triangles hold any points (k, n, 2) besides their corners."""
    inside = (_turn(a, b, points) >= 0.0) & (_turn(b, c, points) >= 0.0)
    inside &= _turn(c, a, points) >= 0.0
    for corner in (a, b, c):
        inside &= (points != corner).any(axis=-1)
    return inside.any(axis=-1)


def _normals(around: Floats) -> Floats:
    """Return normals (k, 3) of polygons (k, n, 3), as long as twice the area."""
    spokes = around - around[:, :1]
    return np.cross(spokes[:, 1:-1], spokes[:, 2:]).sum(axis=1)


def _axes(around: Floats) -> Triangles:
    """Return the two coordinate axes (k, 2) in whose plane each polygon runs anticlockwise."""
    normals = _normals(around)
    along = np.abs(normals).argmax(axis=1)
    back = normals[np.arange(len(along)), along] < 0.0
    axes = (along[:, None] + np.where(back[:, None], (2, 1), (1, 2))) % 3
    return np.asarray(axes)


def _flat(around: Floats) -> Floats:
    """Return polygons (k, n, 2), anticlockwise, projected along a coordinate axis."""
    return np.take_along_axis(around, _axes(around)[:, None, :], axis=2)


def _area(flat: Floats) -> Any:
    """Return twice the area of polygons (..., n, 2)."""
    spokes = flat - flat[..., :1, :]
    return _turn(np.zeros(2), spokes[..., 1:-1, :], spokes[..., 2:, :]).sum(axis=-1)


def _bridge(outline: Floats, hole: Floats, starts: Floats, ends: Floats) -> tuple[int, int]:
    """Return the nearest corners of two loops (n, 2) that an inner line joins, crossing no wall.

    starts, ends (k, 2): ends of the walls, which include the edges of both loops.
    """
    if len(outline) * len(hole) > MOST_PAIRS:
        raise MeshError("a hole of a face has too many corners: export it as triangles")
    away = np.square(outline[:, None] - hole).sum(axis=-1)
    before, after = np.roll(outline, 1, axis=0), np.roll(outline, -1, axis=0)
    for pair in np.argsort(away, axis=None, kind="stable")[:MOST_TRIES].tolist():
        corner, first = divmod(pair, len(hole))
        p, q = outline[corner], hole[first]
        lefts = _turn(before[corner], p, q) > 0.0, _turn(p, after[corner], q) > 0.0
        bulges = _turn(before[corner], p, after[corner]) >= 0.0
        if not (all(lefts) if bulges else any(lefts)):
            continue
        meets = (_turn(p, q, starts) * _turn(p, q, ends) <= 0.0) & (
            _turn(starts, ends, p) * _turn(starts, ends, q) <= 0.0
        )
        for end in (p, q):
            meets &= (starts != end).any(axis=1) & (ends != end).any(axis=1)
        if not meets.any():
            return corner, first
    raise MeshError("a hole of a face crosses its outline: export it as triangles")

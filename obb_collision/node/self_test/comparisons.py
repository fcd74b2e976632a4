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

"""Comparisons of kernels with exact arithmetic: each yields what differs.

It yields after each piece of work of less than a millisecond or so, "" where all is right, so that
whoever runs it can pause and stop. Everything goes through a ``Scene``, as in the node.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.numerics.exact import (
    Vector,
    contains_exactly,
    cross,
    dot,
    exact_axes,
    exact_integers,
)
from obb_collision.queries.verdict.verdict import Verdict, exact_verdict
from obb_collision.scene.report import Report
from obb_collision.scene.scene import Scene
from obb_collision.shapes import Mesh
from obb_collision.typing import Floats

FEW, MANY = 8, 120
"""Boxes of scenes that are checked by one call of a kernel, and by a broad phase."""
MARGIN = Fraction(1, 10**9)
"""Metres, for boxes of about one: far above rounding, far below what matters."""
FINE = Fraction(1, 10**15)
"""What an entry of a rotation may be off."""
HORIZON = 1.0
"""Seconds that predictions reach ahead, by default."""
CORNERS = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
FACES = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])

Rng = np.random.Generator
Differences = Iterator[str]


class Comparison(NamedTuple):
    """A comparison: its name, what a piece of it is, and how many there are at the most."""

    name: str
    pieces: str
    run: Callable[[Rng], Differences]


def _poses(rng: Rng, count: int, side: float) -> Floats:
    poses = rng.normal(size=(count, 7))
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    poses[:, :3] = rng.uniform(0.0, side, (count, 3))
    return poses


def _scene(rng: Rng, count: int, side: float) -> Scene:
    scene = Scene()
    sizes = rng.uniform(0.2, 1.0, (count, 3))
    scene.add_boxes([str(number) for number in range(count)], sizes, _poses(rng, count, side))
    return scene


def _hard(rng: Rng, boxes: Floats) -> Floats:
    """Return poses of boxes that touch, or nearly, with axes that are parallel, or nearly."""
    poses = np.zeros((len(boxes), 7))
    poses[:, 6] = 1.0
    poses[1:, 3:6] = rng.choice((0.0, 1e-3, 1e-9, 1e-16), (len(boxes) - 1, 3))
    ends = np.cumsum(boxes[:, 0])
    poses[:, 0] = ends - 0.5 * boxes[:, 0] + rng.choice((0.0, 1e-12, -1e-16), len(boxes))
    poses[:, :3] += rng.choice((0.0, 1e6))
    return poses


def _pairs(scene: Scene, report: Report, is_hard: bool) -> Differences:
    """Compare all pairs that may collide, by bounds wider than theirs."""
    boxes, rows = scene.boxes, map(tuple, report.pairs.tolist())
    found = dict(zip(rows, report.verdicts.tolist(), strict=True))
    reach = np.linalg.norm(boxes.half_extents, axis=1) + 1e-6
    apart = np.linalg.norm(boxes.centers[:, None] - boxes.centers, axis=2)
    near = np.argwhere(np.triu(apart <= reach[:, None] + reach, 1))
    missing = set(found) - set(map(tuple, near.tolist()))
    if missing:
        yield f"boxes {missing.pop()} are far apart and collide"
    for a, b in near.tolist():
        verdict, truth = found.get((a, b), Verdict.SEPARATE), exact_verdict(boxes, a, boxes, b)
        undecided = is_hard and verdict == Verdict.TOUCHING
        right = verdict == truth or undecided
        yield "" if right else f"{Verdict(verdict).name}, not {Verdict(truth).name}: {a} {b}"


def few_boxes(rng: Rng) -> Differences:
    """Compare the pairs of small scenes, every second one as hard as can be."""
    for number in range(20):
        scene = _scene(rng, FEW, 1.5)
        is_hard = number % 2 == 1
        if is_hard:
            sizes = 2.0 * scene.boxes.half_extents
            scene.move_indices(np.arange(FEW), _hard(rng, sizes))
        yield from _pairs(scene, scene.check(), is_hard)


def many_boxes(rng: Rng) -> Differences:
    """Compare the pairs of a large scene, of which all, some and one move."""
    scene = _scene(rng, MANY, 5.0)
    for moving in (MANY, MANY // 4, 1):
        scene.move_indices(np.arange(moving), _poses(rng, moving, 5.0))
        yield from _pairs(scene, scene.check(), False)


def poses(rng: Rng) -> Differences:
    """Compare the boxes that poses lead to."""
    scene = _scene(rng, FEW, 1.0)
    for _ in range(20):
        given = _poses(rng, FEW, 1e6)
        scene.move_indices(np.arange(FEW), given)
        for row, pose in enumerate(given):
            entries = scene.boxes.rotations[row].ravel().tolist()
            truths = rotation_of(pose[3:])
            off = max(abs(Fraction(e) - t) for e, t in zip(entries, truths, strict=True))
            right = off <= FINE and (scene.boxes.centers[row] == pose[:3]).all()
            yield "" if right else f"a box is {float(off):.1e} off its pose {pose.tolist()}"


def depths(rng: Rng) -> Differences:
    """Compare depths with the least overlap, and overlaps along normals with depths."""
    for _ in range(10):
        scene = _scene(rng, 2 * FEW, 1.5)
        found = scene.check(effects=["separations"]).result("separations")
        for (a, b), depth, normal in zip(
            found.pairs.tolist(), -found.separations, found.normals, strict=True
        ):
            least = min(overlap_squares(scene.boxes, a, b))
            (along,) = overlap_squares(scene.boxes, a, b, normal)
            low, high = _bounds(depth)
            right = low <= least <= high and low <= along <= high and _is_unit(normal)
            yield "" if right else f"depth {depth} of {a} {b}, not {float(least) ** 0.5}"


def contacts(rng: Rng) -> Differences:
    """Compare points of contact with both boxes."""
    for _ in range(10):
        scene = _scene(rng, 2 * FEW, 1.5)
        found = scene.check(effects=["contacts"]).result("contacts")
        for row, pair in enumerate(found.pairs.tolist()):
            places = found.positions[row, : found.counts[row]]
            right = len(places) > 0 and all(_inside(scene.boxes, box, places).all() for box in pair)
            yield "" if right else f"contacts of {pair} are not in both boxes"


def clearances(rng: Rng) -> Differences:
    """Compare closest points with both boxes, distances with the gap along normals."""
    for _ in range(10):
        scene = _scene(rng, FEW, 2.5)
        scene.set_effect("clearance", max_distance=1.0)
        found = scene.check(effects=["clearance"]).result("clearance")
        for row, (a, b) in enumerate(found.pairs.tolist()):
            distance, p, q = found.distances[row], found.positions_a[row], found.positions_b[row]
            if distance <= 1e-6:
                continue
            low, high = _bounds(distance)
            apart = zip(p.tolist(), q.tolist(), strict=True)
            right = low <= sum((Fraction(x) - Fraction(y)) ** 2 for x, y in apart) <= high
            right &= all(_inside(scene.boxes, *one)[0] for one in ((a, p[None]), (b, q[None])))
            right &= -overlap_squares(scene.boxes, a, b, found.normals[row])[0] >= low
            yield "" if right else f"distance {distance} of {a} {b}"


def points(rng: Rng) -> Differences:
    """Compare how many points are in boxes; those on their faces, but for rounding, may count."""
    for _ in range(6):
        scene = _scene(rng, FEW, 1.5)
        boxes = scene.boxes
        on_faces = boxes.centers + boxes.half_extents[:, :1] * boxes.rotations[:, :, 0]
        cloud = np.vstack((rng.uniform(0.0, 1.5, (60, 3)), on_faces))
        scene.obstacle_points = cloud
        found = scene.check(effects=["points"]).result("points")
        counts = dict(zip(found.indices.tolist(), found.counts.tolist(), strict=True))
        for row in range(FEW):
            least, most = (_inside(boxes, row, cloud, by).sum() for by in (-MARGIN, MARGIN))
            right = least <= counts.get(row, 0) <= most
            yield "" if right else f"{counts.get(row, 0)} points in {row}, not {least}"


def predictions(rng: Rng) -> Differences:
    """Compare predicted collisions with boxes that have moved so far."""
    for _ in range(6):
        scene = _scene(rng, FEW, 4.0)
        twists = np.zeros((FEW, 6))
        twists[:, :3] = rng.uniform(-2.0, 2.0, (FEW, 3))
        scene.objects.set_twists(np.arange(FEW), twists)
        report = scene.check(effects=["sweep"])
        found = report.result("sweep").predicted
        times = dict(zip(map(tuple, found.pairs.tolist()), found.times.tolist(), strict=True))
        now = set(map(tuple, report.pairs.tolist()))
        for a, b in combinations(range(FEW), 2):
            if (a, b) not in now:
                right = _met(scene.boxes, twists[:, :3], a, b, times.get((a, b)))
                yield "" if right else f"{a} {b} at {times.get((a, b))} s"


def meshes(rng: Rng) -> Differences:
    """Compare tetrahedra on the levels that distinguish them from their boxes."""
    for level in (Accuracy.HULL, Accuracy.MESH):
        scene = Scene(accuracy=level)
        shape = Mesh(CORNERS, FACES)
        for number in range(FEW):
            scene.add(str(number), shape)
        for _ in range(4):
            given = _poses(rng, FEW, 1.5)
            scene.move_indices(np.arange(FEW), given)
            found = set(map(tuple, scene.check().pairs.tolist()))
            bodies = [_placed(pose) for pose in given]
            for a, b in combinations(range(FEW), 2):
                truth = bodies_collide(bodies[a], bodies[b])
                yield "" if ((a, b) in found) == truth else f"{level.name.lower()} {a} {b}"


def _placed(pose: Floats) -> Floats:
    rotation = np.array([float(entry) for entry in rotation_of(pose[3:])]).reshape(3, 3)
    return CORNERS @ rotation.T + pose[:3]


def _met(boxes: Boxes, velocities: Floats, a: int, b: int, time: float | None) -> bool:
    """Return whether two boxes are apart until a time, all along if None, and collide then."""
    end = HORIZON if time is None else time

    def verdict(at: float) -> int:
        moved = Boxes(boxes.centers + at * velocities, boxes.rotations, boxes.half_extents)
        return exact_verdict(moved, a, moved, b)

    apart = all(verdict(share * end - 1e-6) == Verdict.SEPARATE for share in (0.5, 0.9, 1.0))
    # boxes that graze each other are apart again a moment later
    collide = time is None or any(verdict(end + at) != Verdict.SEPARATE for at in (1e-12, 1e-6))
    return apart and collide


def _inside(boxes: Boxes, row: int, cloud: Floats, by: Fraction = MARGIN) -> Any:
    grown = boxes.half_extents[row] + float(by)
    return contains_exactly(boxes.centers[row], boxes.rotations[row], grown, cloud)


def _bounds(length: float) -> tuple[Fraction, Fraction]:
    """Return squares between which that of a length is, up to ``MARGIN``."""
    exact = Fraction(float(length))
    return max(exact - MARGIN, Fraction(0)) ** 2, (exact + MARGIN) ** 2


def _is_unit(normal: Floats) -> bool:
    return abs(float(normal @ normal) - 1.0) <= float(MARGIN)


COMPARISONS = (
    Comparison("pairs of few boxes", "pairs", few_boxes),
    Comparison("pairs of many boxes", "pairs", many_boxes),
    Comparison("poses", "boxes", poses),
    Comparison("depths", "pairs", depths),
    Comparison("contacts", "pairs", contacts),
    Comparison("clearances", "pairs", clearances),
    Comparison("points", "boxes", points),
    Comparison("predictions", "pairs", predictions),
    Comparison("hulls and meshes", "pairs", meshes),
)


def overlap_squares(boxes: Boxes, a: int, b: int, normal: Floats | None = None) -> list[Fraction]:
    """Return the squares of the overlaps of two boxes along all axes that can separate them.

    Or along a normal that leads from a to b. Negative where the boxes are apart. Exact.
    """
    (axes_a, power_a), (axes_b, power_b) = (exact_axes(boxes.rotations[row]) for row in (a, b))
    parts = boxes.centers[a], boxes.centers[b], boxes.half_extents[a], boxes.half_extents[b]
    numbers, power = exact_integers([number for part in parts for number in part.tolist()])
    offset = numbers[3] - numbers[0], numbers[4] - numbers[1], numbers[5] - numbers[2]
    edges = [
        *((axis, power_a, extent) for axis, extent in zip(axes_a, numbers[6:9], strict=True)),
        *((axis, power_b, extent) for axis, extent in zip(axes_b, numbers[9:], strict=True)),
    ]
    axes = [*axes_a, *axes_b, *(cross(u, v) for u, v in product(axes_a, axes_b))]
    if normal is not None:
        x, y, z = exact_integers(normal.tolist())[0]
        axes = [(x, y, z)]
    squares = []
    for axis in axes:
        if axis == (0, 0, 0):
            continue
        reaches = (Fraction(h * abs(dot(axis, edge)), 1 << k) for edge, k, h in edges)
        reach = sum(reaches, Fraction(0))
        apart = dot(axis, offset) if normal is not None else abs(dot(axis, offset))
        overlap = (reach - apart) / (1 << power)
        squares.append(abs(overlap) * overlap / dot(axis, axis))
    return squares


def rotation_of(quaternion: Floats) -> list[Fraction]:
    """Return the nine entries, row by row, of the rotation that a quaternion x y z w means."""
    x, y, z, w = map(Fraction, quaternion.tolist())
    square = x * x + y * y + z * z + w * w
    entries = (
        *(w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )
    return [entry / square for entry in entries]


def bodies_collide(first: Floats, second: Floats) -> bool:
    """Return whether the convex hulls of two sets of points, tetrahedra for example, collide."""
    numbers = iter(exact_integers([*first.ravel().tolist(), *second.ravel().tolist()])[0])
    points: list[Vector] = list(zip(numbers, numbers, numbers, strict=True))
    bodies = points[: len(first)], points[len(first) :]
    edges = [
        [(p[0] - q[0], p[1] - q[1], p[2] - q[2]) for p, q in combinations(body, 2)]
        for body in bodies
    ]
    axes = [cross(u, v) for own in edges for u, v in combinations(own, 2)]
    axes += [cross(u, v) for u, v in product(*edges)]
    for axis in axes:
        low, high = ([dot(axis, point) for point in body] for body in bodies)
        if axis != (0, 0, 0) and (max(low) < min(high) or max(high) < min(low)):
            return False
    return True

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

"""Sweeps of boxes that move straight, and of drills that turn about their axis."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from convex_bodies import CORNER_SIGNS, pool_of
from each import each
from hypothesis import given, settings
from scipy.spatial.transform import Rotation
from support import any_pairs, family, joined, refused, row_of, sizes, sweep, sweep_twists
from sweep_motions import Twisting, drills, motion_of_boxes, pair_rows
from sweep_oracle import ExactMotion, certain_overlap

import obb_collision as oc
from obb_collision import Boxes, MeshTrees
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, BOX_FACES
from obb_collision.queries.convex.support import BOX_CORE, HULL_CORE, ConvexBodies
from obb_collision.queries.sweep import TOLERANCE, Sweeps, convex_sweeps
from obb_collision.typing import Floats, Integers
from tools.cases.families import FAMILIES
from tools.cases.placement import log_uniform

#: Promised: how far apart boxes may be at the time given, of T (see ``sweep_linear``).
GAP = 4e-15
#: Promised relative error of times where the way to the contact is a hundredth of T or more.
RELATIVE = 1e-12

Motion = tuple[Boxes, Boxes, np.ndarray]


def moving(name: str, n: int, seed: int = 0) -> Motion:
    """Pairs of a family that fly through their poses: start, end, rows.

    Lengths of a thousandth to a thousand times the size, some along an edge (sliding, grazing);
    the pose of the family is at the start, the end, or anywhere between. Either box or both move,
    in some pairs none.
    """
    rng = np.random.default_rng([seed, 17])
    a, b = family(name, n, seed)
    way = rng.normal(size=(n, 3))
    along = rng.random(n) < 0.4
    way[along] = a.rotations[along, :, 0]
    size = np.maximum(sizes(a, b), 1e-200)[:, None]
    way *= size * log_uniform(rng, -3.0, 3.0, (n, 1)) / np.linalg.norm(way, axis=1, keepdims=True)
    when = np.where(rng.random((n, 1)) < 0.5, rng.integers(0, 2, (n, 1)), rng.random((n, 1)))
    way[rng.random(n) < 0.1] = 0.0
    share = rng.integers(0, 3, (n, 1)) / 2.0
    moves = ((a, way * share), (b, way * (share - 1.0)))
    starts = [Boxes(s.centers + when * w, s.rotations, s.half_extents) for s, w in moves]
    ends = [Boxes(s.centers - (1.0 - when) * w, s.rotations, s.half_extents) for s, w in moves]
    start, rows = joined(*starts)
    return start, joined(*ends)[0], rows


def check_against_truth(start: Boxes, end: Boxes, rows: np.ndarray, found: Sweeps) -> int:
    """Assert the promise for every row; return how many near misses count as hits."""
    near_misses = 0
    for n, (i, j) in enumerate(rows):
        exact = ExactMotion.of(
            (row_of(start, i), row_of(start, j)), (row_of(end, i), row_of(end, j))
        )
        truth = exact.first_contact()
        if truth is not None:
            assert found.hits[n]
            assert Fraction(found.times[n]) <= truth
            if exact.way(truth) > 0.01:
                assert truth - Fraction(found.times[n]) <= RELATIVE * truth
        near_misses += truth is None and found.hits[n]
        if found.hits[n]:
            assert exact.gap(found.times[n]) <= GAP
            assert np.isfinite(found.positions[n]).all()
        else:
            assert found.times[n] == np.inf
    return near_misses


@each("name", FAMILIES)
def test_exact_without_turning(name: str, pairs: int) -> None:
    n = max(45, pairs // len(FAMILIES))
    start, end, rows = moving(name, n)
    found = sweep(start, end, rows)
    near_misses = check_against_truth(start, end, rows, found)
    assert 0.1 < found.hits.mean() < 1.0 or name == "exact resting contact"
    print(f"{name}: {n} motions, {found.hits.sum()} hits, {near_misses} misses by rounding only")  # noqa: T201


@each("name", ["ordinary scene", "edge against edge", "axes relabelled and mirrored"])
def test_contact_is_in_both_boxes_and_the_normal_between_them(name: str) -> None:
    start, end, rows = moving(name, 400)
    found = sweep(start, end, rows)
    hits = np.flatnonzero(found.hits & (found.times > 0.0))
    assert len(hits) > 50
    way = end.centers - start.centers
    size = start.half_extents[rows[hits]].sum(axis=(1, 2))
    centers = [
        start.centers[rows[hits, s]] + found.times[hits, None] * way[rows[hits, s]] for s in (0, 1)
    ]
    for side in (0, 1):
        box = start[rows[hits, side]]
        local = np.einsum("nji,nj->ni", box.rotations, found.positions[hits] - centers[side])
        slack = 1e-9 * size + 1e-12 * np.abs(way[rows[hits]]).sum(axis=(1, 2))
        assert ((np.abs(local) - box.half_extents).max(axis=1) <= slack).all()
    normals = found.normals[hits]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=0.0, atol=1e-14)
    assert (np.einsum("ni,ni->n", normals, centers[1] - centers[0]) > 0.0).all()
    closing = np.einsum("ni,ni->n", normals, way[rows[hits, 1]] - way[rows[hits, 0]])
    assert (closing < 0.0).all()


def test_a_bullet_never_passes_a_paper_wall() -> None:
    rng = np.random.default_rng(2)
    n = 2000
    size = rng.uniform(1e-6, 1e-3, (n, 3))
    target = np.column_stack([np.zeros(n), *rng.uniform(-0.99, 0.99, (2, n))])
    way = rng.normal(size=(n, 3)) * 1e4
    share = rng.random((n, 1))
    walls = Boxes(np.zeros((n, 3)), [np.eye(3)] * n, [[0.0, 1.0, 1.0]] * n)
    ends = (target - share * way, target + (1.0 - share) * way)
    found = oc.sweeps(walls, oc.MovingBoxes(*(Boxes(x, walls.rotations, size) for x in ends)))
    assert found.hits.all()
    np.testing.assert_allclose(found.times, share[:, 0], rtol=0.0, atol=1e-2)


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@settings(max_examples=60)
@given(any_pairs(), any_pairs())
def test_any_doubles_at_all(pair: tuple[Boxes, Boxes], other: tuple[Boxes, Boxes]) -> None:
    """Whatever is accepted gives a whole answer: no NaN where there is a hit, none elsewhere."""
    (a, b), (there, _) = pair, other
    start = joined(a, b)[0]
    for rotations in (a.rotations, there.rotations):
        end = joined(Boxes(there.centers, rotations, a.half_extents), b)[0]
        found = sweep(start, end, [[0, 1]])
        assert found.hits[0] == np.isfinite(found.times[0])
        if found.hits[0]:
            assert 0.0 <= found.times[0] <= 1.0
            assert np.isfinite(found.positions).all()
            np.testing.assert_allclose(np.linalg.norm(found.normals), 1.0, rtol=0.0, atol=1e-14)
        if rotations is a.rotations:
            check_against_truth(start, end, np.array([[0, 1]]), found)


def test_bad_input_is_refused_with_the_reason() -> None:
    start, end, rows = moving("ordinary scene", 3)
    grown = Boxes(end.centers, end.rotations, end.half_extents + np.eye(6)[4][:, None])
    refused(r"half extents of start.*row 4", sweep, start, grown, rows)
    refused("same length", sweep, start, end[:3], rows)
    for tolerance in (0.0, -1.0, 2.0, np.nan):
        refused("tolerance", sweep, start, end, rows, tolerance)
    for twists, match in (
        (np.zeros((5, 6)), "twists"),
        (np.zeros((6, 3)), "twists"),
        (np.full((6, 6), np.nan), "twists must be finite in row 0"),
        (np.full((6, 6), 1e300), "twists times duration"),
    ):
        refused(match, sweep_twists, start, twists, rows, 10.0)
    for horizon in (0.0, -1.0, np.inf, np.nan):
        refused("duration", sweep_twists, start, np.zeros((6, 6)), rows, horizon)


def test_times_alone_are_those_with_contacts() -> None:
    rng = np.random.default_rng(12)
    turns = Rotation.random(80, random_state=rng)
    start = Boxes(rng.uniform(-2, 2, (80, 3)), turns.as_matrix(), rng.uniform(0, 1, (80, 3)))
    pairs = rng.permutation(80).reshape(-1, 2)
    for rotations in (start.rotations, Rotation.random(80, random_state=rng).as_matrix()):
        end = Boxes(rng.uniform(-2, 2, (80, 3)), rotations, start.half_extents)
        full, alone = sweep(start, end, pairs), sweep(start, end, pairs, contacts=False)
        assert alone.times.tolist() == full.times.tolist()
        assert alone.hits.tolist() == full.hits.tolist()
        assert alone.positions.shape == alone.normals.shape == (0, 3)


CHUNK = 2500
#: Until when pairs of rows are certainly apart.
FreeUntil = Callable[[Twisting, Integers], Floats]


def by_boxes(motion: Twisting, rows: Integers) -> Floats:
    moving = oc.MovingBoxes.from_twists(motion.boxes, motion.twists, 1.0, origins=motion.origins)
    return oc.sweeps(moving, moving, rows).free_until


def by_hulls(motion: Twisting, rows: Integers) -> Floats:
    """Every other pair with the formula of a box, the others with corners."""
    boxes, count = motion.boxes, len(motion.boxes)
    pool = pool_of(CORNER_SIGNS * boxes.half_extents[:, None])
    kinds = np.where(np.arange(count) % 4 < 2, BOX_CORE, HULL_CORE).astype(np.int8)
    bodies = ConvexBodies(
        kinds, np.pad(boxes.half_extents, ((0, 0), (0, 1))), np.zeros(count), pool,
        np.arange(count), boxes.centers, boxes.rotations,
    )  # fmt: skip
    begin = np.zeros(len(rows))
    return convex_sweeps(bodies, motion_of_boxes(motion), rows, begin, TOLERANCE).free_until


def corners_from_origins(motion: Twisting) -> Floats:
    """Corners (n, 8, 3) in the frames that turn with the boxes about their origins."""
    boxes = motion.boxes
    arms = np.einsum("nji,nj->ni", boxes.rotations, boxes.centers - motion.origins)
    return np.asarray(arms[:, None] + BOX_CORNERS * boxes.half_extents[:, None])


def by_meshes(motion: Twisting, rows: Integers) -> Floats:
    trees = MeshTrees.join([MeshTrees.build(c, BOX_FACES) for c in corners_from_origins(motion)])
    every = np.arange(len(motion.boxes))
    placed = oc.PlacedMeshes(trees, every, motion.origins, motion.boxes.rotations)
    found = oc.sweeps(
        placed, placed, rows, duration=1.0, twists_a=motion.twists, twists_b=motion.twists
    )
    return found.free_until


def in_scene(level: str) -> FreeUntil:
    """Predict impacts of meshes on a level, pairs 16 m from each other."""

    def predicted(motion: Twisting, rows: Integers) -> Floats:
        scene, places = oc.Scene(accuracy=level), motion.origins.copy()
        for k, pair in enumerate(rows):
            places[pair] += 16.0 * np.array([k % 16, k // 16 % 16, k // 256])
        turns = Rotation.from_matrix(motion.boxes.rotations.copy()).as_quat()
        for k, corners in enumerate(corners_from_origins(motion)):
            scene.add(str(k), oc.shapes.Mesh(corners, BOX_FACES), [*places[k], *turns[k]])
        scene.objects.set_twists(np.arange(len(places)), motion.twists)
        scene.set_effect("sweep", "on", horizon=1.0)
        report, until = scene.check(), np.full(len(rows), np.inf)
        until[report.pairs[:, 0] // 2] = 0.0
        ahead = report.swept.predicted
        until[ahead.pairs[:, 0] // 2] = ahead.free_until
        return until

    return predicted


SWEEPS: dict[str, FreeUntil] = {"boxes": by_boxes, "hulls": by_hulls, "meshes": by_meshes}
SWEEPS |= {f"scene at {level}": in_scene(level) for level in ("obb", "hull", "mesh")}


@each("name", SWEEPS)
def test_none_that_certainly_collides_is_called_free(name: str, pairs: int) -> None:
    rng = np.random.default_rng(1)
    left = total = 2 * pairs if name == "boxes" else pairs // 10
    certain = missed = free = 0
    while left > 0:
        motion = drills(rng, min(left, CHUNK))
        rows = pair_rows(len(motion.boxes) // 2)
        half = motion.boxes.half_extents
        truth = certain_overlap(motion_of_boxes(motion), half, rows, rng, 30)
        until = SWEEPS[name](motion, rows)
        missed += int((until > truth).sum())
        certain += int(np.isfinite(truth).sum())
        free += int(np.isinf(until).sum())
        left -= len(rows)
    print(f"{name}: {total} motions, {certain} certainly collide, {free} free")  # noqa: T201
    assert missed == 0
    assert certain > 0.4 * total
    assert free > 0.2 * total

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

"""Every effect from level to level, and beside the verdicts: in order, without contradictions."""

from __future__ import annotations

import numpy as np
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_zoo import zoo
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.accuracy import Accuracy

#: By how much a distance or a depth of a coarser level may be out of order, of the size of a pair;
ORDER = 1e-9
#: and by how much planes of hulls are moved outwards, from which corners move the more the sharper.
OUTWARDS = 2e-11
LEVELS = ("obb", "hull", "mesh")
MESHES = ("torus0", "hull1", "open_sphere1", "star0")


def shape_of(kind: int, size: np.ndarray) -> oc.shapes.Shape:
    """Return a shape of one of nine kinds; size (3,)."""
    x, y, _ = size.tolist()
    if kind < 6:
        return (
            oc.shapes.Box(2.0 * size), oc.shapes.Sphere(x), oc.shapes.Capsule(x, y),
            oc.shapes.Cylinder(x, y), oc.shapes.Cone(x, y), oc.shapes.Ellipsoid(size),
        )[kind]  # fmt: skip
    vertices, faces = zoo()[MESHES[kind % len(MESHES)]]
    if kind == 6:
        return oc.shapes.Cylinder(x, y, scale=[1.0, 2.0, 0.5])
    if kind == 7:
        return oc.shapes.Hull(vertices * size)
    return oc.shapes.Mesh(vertices * size, faces)


def crowd(seed: int, accuracy: str, padding: float, thin: float) -> oc.Scene:
    """Return shapes of all kinds, crowded enough to collide; thin: their least size by the rest."""
    rng = np.random.default_rng(seed)
    scene = oc.Scene(accuracy=accuracy)
    scene.set_effect("clearance", max_distance=10.0)
    for number in range(14):
        kind, size = int(rng.integers(0, 10)), rng.uniform(0.1, 0.3, 3)
        size[rng.integers(0, 3)] *= thin
        turn = rng.normal(size=4) if rng.random() < 0.7 else np.array([0.0, 0.0, 0.0, 1.0])
        place = rng.uniform(-0.35, 0.35, 3)
        place = np.round(place, 1) if rng.random() < 0.3 else place  # touching, coplanar
        pose = [*place, *(turn / np.linalg.norm(turn))]
        padded = padding if number % 2 else 0.0
        scene.add(str(number), shape_of(kind, size), pose, padding=padded)
    scene.obstacle_points = rng.uniform(-1, 1, (300, 3))
    return scene


worlds = given(
    st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.05]), st.sampled_from([1.0, 0.03, 1e-3])
)


@settings(max_examples=12, deadline=None)
@worlds
def test_a_coarser_level_is_never_farther_less_deep_or_without_a_point(
    seed: int, padding: float, thin: float
) -> None:
    order = ORDER + OUTWARDS / thin
    reports = [
        crowd(seed, level, padding, thin).check(["clearance", "separations", "points"])
        for level in LEVELS
    ]
    for coarse, fine in ((reports[0], reports[1]), (reports[1], reports[2])):
        there = set(map(tuple, coarse.pairs.tolist()))
        assert there >= set(map(tuple, fine.pairs.tolist()))
        known = near(coarse)
        for pair, distance in near(fine).items():
            assert known[pair] <= max(distance, 0.0) + order
        deep = dict(zip(map(tuple, coarse.pairs.tolist()), coarse.depths, strict=True))
        for pair, depth in zip(map(tuple, fine.pairs.tolist()), fine.depths, strict=True):
            assert deep[pair] >= depth - order
        assert (coarse.points_inside.counts >= fine.points_inside.counts).all()


@settings(max_examples=12, deadline=None)
@worlds
def test_verdicts_and_effects_never_contradict(seed: int, padding: float, thin: float) -> None:
    for level in LEVELS[1:]:
        report = crowd(seed, level, padding, thin).check(["clearance", "separations", "contacts"])
        colliding = set(map(tuple, report.pairs.tolist()))
        high = report.accuracies >= Accuracy.HULL
        assert (report.separations[high] <= 0.0).all()
        for pair, distance in near(report).items():
            assert (distance <= 0.0) == (pair in colliding)


def near(report: oc.Report) -> dict[tuple[int, ...], float]:
    found = report.clearances
    return dict(zip(map(tuple, found.pairs.tolist()), found.distances.tolist(), strict=True))


@each("accuracy", ["hull", "mesh"])
def test_round_shapes_collide_as_they_are(accuracy: str) -> None:
    """A polygon about a circle reaches farther at its corners; the circle does not."""
    vertices, faces = zoo()["torus0"]
    top = vertices[vertices[:, 2].argmax()]
    others = oc.shapes.Mesh(vertices, faces), oc.shapes.Hull(vertices), oc.shapes.Box(2.0 * top)
    for other in others:
        scene = oc.Scene(accuracy=accuracy)
        scene.add("other", other, [*-top, 0, 0, 0, 1])
        for shape in (oc.shapes.Cylinder(0.3, 0.5), oc.shapes.Ellipsoid([0.3, 0.3, 0.2])):
            for half in np.linspace(0.0, 1.5, 9):
                turn = Rotation.from_euler("xz", [np.pi / 2, half]) * Rotation.from_euler("z", half)
                for gap, met in ((1e-6, False), (-1e-6, True)):
                    scene.add("round", shape, [0, 0, 0.3 + gap, *turn.as_quat()])
                    assert bool(scene.check().names()) == met
                    scene.remove("round")

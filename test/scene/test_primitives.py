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

"""Primitives on the levels above OBB: spheres and capsules exactly, others by a convex mesh."""

from __future__ import annotations

import numpy as np
from each import each
from mesh_zoo import zoo
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.geometry.capsules import Capsules
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Shape, Sphere

ZOO = zoo()
FINE = ("hull", "mesh")
UPRIGHT = [0.0, 0.0, 0.0, 1.0]


def random_poses(count: int, spread: float, rng: np.random.Generator) -> NDArray[np.float64]:
    quaternions = Rotation.random(count, rng).as_quat()
    return np.concatenate([rng.uniform(-spread, spread, (count, 3)), quaternions], axis=1)


def shapes(rng: np.random.Generator) -> list[Shape]:
    return [
        Sphere(rng.uniform(0.1, 0.4)),
        Sphere(0.2, scale=[1.5, 1.5, 1.5]),
        Sphere(0.2, scale=[1.0, 0.5, 2.0]),
        Capsule(rng.uniform(0.05, 0.2), rng.uniform(0.2, 0.8)),
        Capsule(0.2, 0.3, scale=[1.0, 1.0, 2.0]),
        Cylinder(rng.uniform(0.1, 0.3), rng.uniform(0.2, 0.8)),
        Cone(0.3, 0.6),
        Ellipsoid(rng.uniform(0.1, 0.4, 3)),
        Box(rng.uniform(0.1, 0.7, 3)),
        Mesh(*ZOO["torus1"]),
        Mesh(*ZOO["open_sphere1"]),
        Hull(ZOO["hull1"][0]),
    ]


def scene_of(count: int, seed: int, **options: object) -> oc.Scene:
    rng = np.random.default_rng(seed)
    scene = oc.Scene(**options)  # type: ignore[arg-type]
    kinds = shapes(rng)
    for k, pose in enumerate(random_poses(count, 0.3 * count ** (1 / 3), rng)):
        scene.add(f"{k}", kinds[k % len(kinds)], pose)
    return scene


@each("seed", [1, 2])
def test_the_order_of_the_levels_holds_with_all_shapes(seed: int) -> None:
    scene = scene_of(480, seed)
    reported = {}
    for name in ("obb", *FINE):
        scene.accuracy = name
        report = scene.check()
        reported[name] = set(report.names())
        if name == "hull":
            assert report.verdicts[report.accuracies > oc.Accuracy.OBB].max() == oc.Verdict.TOUCHING
    assert reported["mesh"] < reported["hull"] < reported["obb"]
    assert len(reported["mesh"]) < 0.8 * len(reported["obb"])


def test_spheres_and_capsules_are_decided_by_their_distances() -> None:
    """Against the distances of capsules in numpy, boxes by a fine walk along the capsule."""
    rng = np.random.default_rng(3)
    scene = oc.Scene(accuracy="mesh")
    places = random_poses(200, 1.5, rng)
    radii, halves = rng.uniform(0.05, 0.4, 200), np.where(rng.random(200) < 0.5, 0.0, 0.3)
    for k, pose in enumerate(places):
        shape = Capsule(radii[k], 2.0 * halves[k]) if halves[k] else Sphere(radii[k])
        scene.add(f"{k}", shape, pose)
    axes = Rotation.from_quat(places[:, 3:]).as_matrix()[:, :, 2] * halves[:, None]
    capsules = Capsules(places[:, :3] - axes, places[:, :3] + axes, radii)
    i, j = np.triu_indices(200, 1)
    gaps = oc.clearances(capsules[i], capsules[j]).distances
    assert np.abs(gaps).min() > 1e-12
    expected = np.stack([i, j], axis=1)[gaps < 0.0]
    report = scene.check()
    assert report.pairs.tolist() == expected.tolist()
    assert (report.verdicts == oc.Verdict.OVERLAP).all()
    assert (report.accuracies == oc.Accuracy.MESH).all()


def test_spheres_in_the_corners_of_boxes_are_free_and_padding_counts() -> None:
    scene = oc.Scene(accuracy="mesh")
    scene.add("box", Box([1.0, 1.0, 1.0]))
    near = 0.5 + 0.25 * np.sqrt(1.0 / 3.0)  # of the corner: as far as the radius
    scene.add("ball", Sphere(0.25), [near + 1e-3] * 3 + UPRIGHT)
    assert len(scene.check()) == 0
    scene.set_accuracy("ball", "obb")
    assert scene.check().names() == [("box", "ball")]
    scene.set_accuracy("ball", None)
    scene.move("ball", [near - 1e-3] * 3 + UPRIGHT)
    assert scene.check().verdicts.tolist() == [oc.Verdict.OVERLAP]
    scene.move("ball", [near + 1e-3] * 3 + UPRIGHT)
    scene.padding = 0.002
    report = scene.check()
    assert report.accuracies.tolist() == [oc.Accuracy.MESH]
    assert report.names() == [("box", "ball")]
    scene.padding = 0.0
    scene.add("ball", Sphere(0.25), [0.75, 0.0, 0.0, *UPRIGHT])
    assert scene.check().verdicts.tolist() == [oc.Verdict.TOUCHING]  # rests on it


def test_what_is_padded_and_no_sphere_capsule_or_box_goes_to_hulls_and_meshes_to_triangles() -> (
    None
):
    for shape, level in (
        (Cylinder(0.2, 0.5), oc.Accuracy.HULL),
        (Mesh(*ZOO["torus1"]), oc.Accuracy.MESH),
        (Hull(ZOO["hull1"][0]), oc.Accuracy.HULL),
    ):
        scene = oc.Scene(accuracy="mesh", padding=0.01)
        scene.add("a", shape)
        scene.add("b", Sphere(0.5))
        assert scene.check().accuracies.tolist() == [level]


@each("name", FINE)
def test_round_shapes_leave_the_corners_of_their_boxes_free(name: str) -> None:
    """A sphere, cylinder, cone, ellipsoid beside a mesh, each in a corner of the other's box."""
    ball = Mesh(*ZOO["sphere2"])
    for shape in (
        Sphere(0.45),
        Cylinder(0.45, 0.9),
        Ellipsoid([0.4, 0.45, 0.5]),
    ):
        scene = oc.Scene(accuracy=name)
        scene.add("ball", ball)
        scene.add("other", shape, [0.75, 0.75, 0.0, *UPRIGHT])
        assert len(scene.check()) == 0, shape
        scene.move("other", [0.55, 0.55, 0.0, *UPRIGHT])
        report = scene.check()
        assert report.names() == [("ball", "other")]
        assert report.accuracies.tolist() == [oc.Accuracy[name.upper()]]

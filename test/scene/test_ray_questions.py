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

"""Rays in a scene: each object at its accuracy, and what is nearest of all."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo

import obb_collision as oc
from obb_collision.shapes import Box, Cone, Cylinder, Hull, Mesh, Sphere

AHEAD = [[1.0, 0.0, 0.0]]


def test_a_ray_goes_through_a_ring_and_hits_what_is_behind() -> None:
    """At obb the ring is a box; its hull has no hole either."""
    vertices, faces = zoo()["torus0"]
    scene = oc.Scene()
    scene.add("ring", Mesh(vertices, faces), [2, 0, 0, 0, 0.5**0.5, 0, 0.5**0.5])
    scene.add("wall", Box([1.0, 4.0, 4.0]), [5, 0, 0, 0, 0, 0, 1])
    for accuracy, name in (("obb", "ring"), ("hull", "ring"), ("mesh", "wall")):
        found = scene.cast_rays([[0, 0, 0]], AHEAD, accuracy=accuracy)
        assert scene.name(found.boxes[0]) == name
    assert found.distances[0] == pytest.approx(4.5)
    scene.accuracy = "mesh"
    np.testing.assert_array_equal(scene.cast_rays([[0, 0, 0]], AHEAD).boxes, found.boxes)
    assert scene.cast_rays([[0, 0, 0]], AHEAD, 4.0).boxes.tolist() == [-1]
    hit = scene.cast_rays([[0, 0, 0.4]], AHEAD)
    assert scene.name(hit.boxes[0]) == "ring"
    assert hit.distances[0] == pytest.approx(1.95, abs=0.01)


def test_a_padded_ring_has_a_hole_yet() -> None:
    vertices, faces = zoo()["torus0"]
    scene = oc.Scene(accuracy="mesh", padding=0.1)
    scene.add("ring", Mesh(vertices, faces), [2, 0, 0, 0, 0.5**0.5, 0, 0.5**0.5])
    scene.add("wall", Box([1.0, 4.0, 4.0]), [5, 0, 0, 0, 0, 0, 1])
    origins = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.4], [2.0, 0.0, 0.4], [2.0, 0.0, 0.3]]
    found = scene.cast_rays(origins, AHEAD * 4)
    assert [scene.name(row) for row in found.boxes] == ["wall", "ring", "ring", "ring"]
    truth = [4.4, 2.0 - 0.05 - 0.1, 0.0, 0.0]
    np.testing.assert_allclose(found.distances, truth, atol=0.005)
    np.testing.assert_allclose(found.normals[1], [-1, 0, 0], atol=0.3)
    assert scene.name(scene.cast_rays(origins[:1], AHEAD, accuracy="hull").boxes[0]) == "ring"


@each("padding", [0.0, 0.07])
def test_coarser_is_never_later(padding: float) -> None:
    rng = np.random.default_rng(51)
    scene = oc.Scene(padding=padding)
    names = ["star0", "bumpy1", "hull1", "open_sphere1"]
    for n in range(24):
        vertices, faces = zoo()[names[n % 4]]
        shape = (Mesh(vertices, faces), Hull(vertices), Sphere(0.3), Box([0.3, 0.4, 0.5]))[n % 3]
        turn = rng.normal(size=4)
        scene.add(f"a/{n}", shape, [*rng.uniform(-3, 3, 3), *(turn / np.linalg.norm(turn))])
    origins, ways = rng.uniform(-5, 5, (2, 400, 3))
    found = [scene.cast_rays(origins, ways, accuracy=level) for level in ("obb", "hull", "mesh")]
    for coarse, fine in (found[:2], found[1:]):
        assert (coarse.distances <= fine.distances + 1e-9).all()
        assert (coarse.hits >= fine.hits).all()
    assert 0 < found[2].hits.sum() < found[0].hits.sum() < 400


def test_objects_that_move_or_go_are_hit_where_they_are() -> None:
    vertices, faces = zoo()["sphere2"]
    scene = oc.Scene(accuracy="mesh")
    scene.add("ball", Mesh(vertices, faces, fit="aabb"), [2, 0, 0, 0, 0, 0, 1])
    assert scene.cast_rays([[0, 0, 0]], AHEAD).distances[0] == pytest.approx(1.55, abs=0.01)
    scene.move("ball", [3, 0, 0, 0, 0, 0, 1])
    assert scene.cast_rays([[0, 0, 0]], AHEAD).distances[0] == pytest.approx(2.55, abs=0.01)
    scene.padding = 0.1
    assert scene.cast_rays([[0, 0, 0]], AHEAD).distances[0] == pytest.approx(2.45, abs=0.02)
    scene.padding = 0.0
    scene.remove("ball")
    assert not scene.cast_rays([[0, 0, 0]], AHEAD).hits.any()


def test_round_shapes_and_padding_are_exact_and_objects_can_be_chosen() -> None:
    scene = oc.Scene(accuracy="hull")
    scene.add("ball", Sphere(0.5), [3, 0, 0, 0, 0, 0, 1])
    scene.add("cone", Cone(1.0, 2.0), [6, 0, 0, 0, 0, 0, 1])
    scene.add("can", Cylinder(1.0, 2.0), [9, 0, 0, 0, 0, 0, 1], padding=0.25)
    at = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.75], [0.0, 0.6, 1.2], [0.0, 0.3, 0.0]]
    found = scene.cast_rays(at, AHEAD * 4)
    assert [scene.name(row) for row in found.boxes] == ["ball", "cone", "can", "ball"]
    edge = 9.0 - np.sqrt((1.0 + np.sqrt(0.25**2 - 0.2**2)) ** 2 - 0.6**2)
    truth = [2.5, 6.0 - 0.125, edge, 2.6]
    np.testing.assert_allclose(found.distances, truth, atol=1e-8)
    assert (found.distances <= truth).all()
    np.testing.assert_allclose(found.normals[0], [-1, 0, 0], atol=1e-9)
    chosen = scene.cast_rays(at, AHEAD * 4, objects=["c*"])
    assert [scene.name(row) for row in chosen.boxes] == ["cone", "cone", "can", "cone"]
    assert not scene.cast_rays(at, AHEAD * 4, objects=[]).hits.any()
    with pytest.raises(ValueError, match="objects must be names"):
        scene.cast_rays(at, AHEAD * 4, objects=[3])  # type: ignore[list-item]

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

"""The demo's picture: bodies, their oriented boxes by state, and what is known about them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from obb_collision.geometry.boxes import Boxes
from obb_collision.node.demo import overlay, raster
from obb_collision.node.demo.bodies import Body, corner_normals
from obb_collision.node.demo.camera import SAMPLES, SIZE, WAREHOUSE, Camera
from obb_collision.node.demo.raster import FloatArray, Pixels

IntArray = npt.NDArray[np.int64]

#: Pixels each way of the map of what the light sees, and how many of them are a metre.
SHADOW_PIXELS, SHADOW_SCALE = 2048, 120.0

FREE, TOUCHING, COLLIDING = 0, 1, 2
STATE_NAMES = ("free", "touching", "colliding")
STATE_COLORS = np.array(((0.05, 0.56, 0.34), (0.93, 0.60, 0.05), (0.86, 0.10, 0.14)))
#: How much of a box's faces covers what is inside, by state.
FACE_ALPHAS = np.array((0.06, 0.10, 0.30))
#: Half the width of a box's edges by state, pixels of the picture.
EDGE_RADII = np.array((0.95, 1.1, 1.45))
#: How much is seen of an edge behind something.
HIDDEN_EDGE = 0.16
#: Radius of the dot at a contact, pixels of the picture, and of the white around it.
DOT_RADII = (5.5, 8.0)
#: Half the width of a line between closest points, and of the white around it.
LINE_RADII = (1.6, 3.2)
#: Radius of a point of a cloud, outside and inside of what asks for points.
CLOUD_RADII = np.array((0.8, 1.7))
#: Colours of closest points, of contacts to come, and of points outside and inside.
NEAR_COLOR, COMING_COLOR = (0.10, 0.38, 0.75), (0.55, 0.20, 0.65)
CLOUD_COLORS = np.array(((0.36, 0.47, 0.60), (0.86, 0.10, 0.14)))

TO_LIGHT = np.array((-0.38, -0.52, 0.98)) / np.linalg.norm((-0.38, -0.52, 0.98))

#: The signs of a box's corners, and its edges and faces by the numbers of their corners.
SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
EDGES = np.array([(a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit])
FACES = np.array(
    [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
)


def _none(*shape: int) -> FloatArray:
    return np.empty(shape)


@dataclass(frozen=True)
class Marks:
    """What is drawn over the bodies, metres.

    contacts (k, 3) and contacts to come (p, 3); closest points (c, 2, 3) of near pairs; a cloud
    (m, 3) and which of it is inside of something that asks for points (m,).
    """

    contacts: FloatArray = field(default_factory=lambda: _none(0, 3))
    coming: FloatArray = field(default_factory=lambda: _none(0, 3))
    near: FloatArray = field(default_factory=lambda: _none(0, 2, 3))
    cloud: FloatArray = field(default_factory=lambda: _none(0, 3))
    inside: npt.NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))


def render(
    bodies: list[Body], boxes: Boxes, states: IntArray, marks: Marks, camera: Camera = WAREHOUSE
) -> npt.NDArray[np.uint8]:
    """Return the picture (h, w, 3) without its texts.

    states (n,): FREE, TOUCHING or COLLIDING, of each body and its box.
    """
    width, height = SIZE[0] * SAMPLES, SIZE[1] * SAMPLES
    view = camera.view
    solid = [body for body in bodies if body.opacity == 1.0]
    world = np.concatenate(
        [_none(0, 3, 3), *(camera.place(body.vertices)[body.faces] for body in solid)]
    )
    normals = np.concatenate(
        [_none(0, 3, 3), *(corner_normals(body.vertices, body.faces) for body in solid)]
    )
    colors = np.concatenate(
        [_none(0, 3), *(np.tile(body.color, (len(body.faces), 1)) for body in solid)]
    )
    screen = view.project(world)
    closest = np.zeros((height, width), np.float32)
    face = np.full((height, width), -1, np.int32)
    raster.fill(screen, closest, face)
    light, shadow_map = _shadows(world, camera.target)
    rays = np.asarray(np.linalg.inv(view.matrix[:, :3]), np.float64)
    image = np.empty((height, width, 3), np.float32)
    raster.shade_floor(image, face, camera.eye, rays, light.matrix, shadow_map)
    raster.shade_faces(
        image, face, screen, world, normals, colors, TO_LIGHT, light.matrix, shadow_map
    )
    _draw_cloud(camera, marks, closest, image)
    _draw_boxes(view, camera.place_boxes(boxes), states, bodies, closest, image)
    _draw_marks(camera, marks, closest, image)
    small = image.reshape(SIZE[1], SAMPLES, SIZE[0], SAMPLES, 3).mean(axis=(1, 3))
    # steps of two: nobody sees them, and the file is a third smaller
    return np.minimum(2.0 * np.round(127.5 * small), 255.0).astype(np.uint8)


def compile_kernels() -> None:
    """Draw next to nothing, so that what draws is compiled."""
    box = Boxes(np.zeros((1, 3)), np.eye(3)[None], np.ones((1, 3)))
    body = Body(box.centers, np.zeros((0, 3), np.int64), STATE_COLORS[FREE])
    render([body], box, np.array([FREE]), Marks())


def _shadows(world: FloatArray, target: FloatArray) -> tuple[raster.View, Pixels]:
    """Return the light's view and the closeness of what it sees, per pixel."""
    size = (SHADOW_PIXELS, SHADOW_PIXELS)
    view = raster.look(target + 30.0 * TO_LIGHT, target, SHADOW_SCALE, size, False)
    closest = np.full(size, -np.inf, np.float32)
    raster.fill(view.project(world), closest, np.empty(size, np.int32))
    return view, closest


def _draw_boxes(
    view: raster.View,
    boxes: Boxes,
    states: IntArray,
    bodies: list[Body],
    closest: Pixels,
    image: Pixels,
) -> None:
    colors, alphas, radii = STATE_COLORS[states], FACE_ALPHAS[states], EDGE_RADII[states]
    for row, body in enumerate(bodies):
        if body.opacity < 1.0:  # a region: what is in it makes it stand out, it does not collide
            colors[row] = body.color
            alphas[row] = body.opacity * (0.5 if states[row] == FREE else 1.0)
    reach = SIGNS[None] * boxes.half_extents[:, None]
    corners = boxes.centers[:, None] + np.einsum("nij,nkj->nki", boxes.rotations, reach)
    quads = corners[:, FACES].reshape(-1, 4, 3)
    out = np.cross(quads[:, 1] - quads[:, 0], quads[:, 3] - quads[:, 0])
    front = np.einsum("nk,nk->n", out, view.eye - quads.mean(axis=1)) > 0.0
    far_first = np.argsort(-np.linalg.norm(quads.mean(axis=1) - view.eye, axis=1))
    rows = far_first[front[far_first]]
    halves = quads[rows][:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
    of_half = np.repeat(rows // len(FACES), 2)
    overlay.blend_triangles(view.project(halves), colors[of_half], alphas[of_half], closest, image)
    order = np.argsort(states, kind="stable")  # the colliding last, on top
    of_edge = np.repeat(order, len(EDGES))
    edges = view.project(corners[order][:, EDGES].reshape(-1, 2, 3))
    overlay.blend_lines(
        edges, colors[of_edge], radii[of_edge] * SAMPLES, HIDDEN_EDGE, closest, image
    )


def _draw_cloud(camera: Camera, marks: Marks, closest: Pixels, image: Pixels) -> None:
    kinds = marks.inside.astype(np.int64)
    ends = np.repeat(camera.view.project(camera.place(marks.cloud))[:, None], 2, axis=1)
    radii = CLOUD_RADII[kinds] * SAMPLES
    overlay.blend_lines(ends, CLOUD_COLORS[kinds], radii, 0.0, closest, image)


def _draw_marks(camera: Camera, marks: Marks, closest: Pixels, image: Pixels) -> None:
    """Draw lines and dots, white around, over everything: contacts are inside of things."""
    dots = [
        (np.repeat(points[:, None], 2, axis=1), DOT_RADII, color)
        for points, color in (
            (marks.coming, COMING_COLOR),
            (marks.contacts, tuple(STATE_COLORS[COLLIDING])),
        )
    ]
    for ends, (inner, outer), color in ((marks.near, LINE_RADII, NEAR_COLOR), *dots):
        lines = camera.view.project(camera.place(ends))
        for radius, shade in ((outer, (1.0, 1.0, 1.0)), (inner, color)):
            radii = np.full(len(lines), radius * SAMPLES)
            overlay.blend_lines(lines, np.tile(shade, (len(lines), 1)), radii, 1.0, closest, image)

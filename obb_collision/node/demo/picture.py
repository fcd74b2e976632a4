"""The demo's picture: bodies, their oriented boxes by state, and the contact points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.poses import as_poses
from obb_collision.node.demo import overlay, raster
from obb_collision.node.demo.raster import FloatArray, Pixels
from obb_collision.node.demo.scene import DemoScene
from obb_collision.node.demo.shapes import triangles_of

IntArray = npt.NDArray[np.int64]

#: Width and height of the picture, pixels.
SIZE = (1600, 900)
#: Pixels drawn for each pixel of the picture, each way: smooth edges.
SAMPLES = 2
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

EYE, TARGET = np.array((6.4, -11.2, 7.0)), np.array((0.38, -0.05, 0.75))
#: Pixels of the picture per unit of slope.
FOCAL = 1730.0
TO_LIGHT = np.array((-0.38, -0.52, 0.98)) / np.linalg.norm((-0.38, -0.52, 0.98))

#: The signs of a box's corners, and its edges and faces by the numbers of their corners.
SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
EDGES = np.array([(a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit])
FACES = np.array(
    [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
)


@dataclass(frozen=True)
class Body:
    """What an object looks like: vertices (n, 3) in the world, metres; faces (m, 3); rgb 0..1."""

    vertices: FloatArray
    faces: IntArray
    color: tuple[float, float, float]


def corner_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return unit normals (m, 3, 3) at the corners of faces: round where faces meet flatly.

    A corner's normal is the mean over the faces around its vertex within 40 degrees.
    """
    corners = vertices[faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30)
    _, same = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    owner = same.reshape(-1)[faces].reshape(-1)  # of each corner: which place it is at
    order = np.argsort(owner, kind="stable")
    starts = np.flatnonzero(np.diff(owner[order], prepend=-1))
    result = np.empty((len(owner), 3))
    for group in np.split(order, starts[1:]):
        around = unit[group // 3]
        near = around @ around.T > np.cos(np.radians(40.0))
        result[group] = near @ flat[group // 3]
    lengths = np.linalg.norm(result, axis=1, keepdims=True)
    return (result / np.maximum(lengths, 1e-30)).reshape(-1, 3, 3)


def bodies_of(scene: DemoScene, time: float) -> list[Body]:
    """Return the bodies of a scene at a time."""
    centers, rotations = as_poses(scene.poses(time))
    bodies = []
    for row, (item, shape) in enumerate(zip(scene.items, scene.shapes(time), strict=True)):
        vertices, faces = triangles_of(shape)
        bodies.append(Body(vertices @ rotations[row].T + centers[row], faces, item.color))
    return bodies


def render(
    bodies: list[Body], boxes: Boxes, states: IntArray, contacts: FloatArray
) -> tuple[npt.NDArray[np.uint8], FloatArray]:
    """Return the picture (h, w, 3) without its texts, and where (k, 2) on it the contacts are.

    states (n,): FREE, TOUCHING or COLLIDING, of each body and its box; contacts (k, 3) metres.
    """
    width, height = SIZE[0] * SAMPLES, SIZE[1] * SAMPLES
    view = raster.look(EYE, TARGET, FOCAL * SAMPLES, (width, height), True)
    world = np.concatenate([body.vertices[body.faces] for body in bodies])
    normals = np.concatenate([corner_normals(body.vertices, body.faces) for body in bodies])
    colors = np.repeat([body.color for body in bodies], [len(b.faces) for b in bodies], axis=0)
    screen = view.project(world)
    closest = np.zeros((height, width), np.float32)
    face = np.full((height, width), -1, np.int32)
    raster.fill(screen, closest, face)
    light, shadow_map = _shadows(world)
    rays = np.asarray(np.linalg.inv(view.matrix[:, :3]), np.float64)
    image = np.empty((height, width, 3), np.float32)
    raster.shade_floor(image, face, EYE, rays, light.matrix, shadow_map)
    raster.shade_faces(
        image, face, screen, world, normals, colors, TO_LIGHT, light.matrix, shadow_map
    )
    _draw_boxes(view, boxes, states, closest, image)
    _draw_contacts(view, contacts, closest, image)
    small = image.reshape(SIZE[1], SAMPLES, SIZE[0], SAMPLES, 3).mean(axis=(1, 3))
    # steps of two: nobody sees them, and the file is a third smaller
    pixels = np.minimum(2.0 * np.round(127.5 * small), 255.0).astype(np.uint8)
    return pixels, view.project(contacts)[:, :2] / SAMPLES


def _shadows(world: FloatArray) -> tuple[raster.View, Pixels]:
    """Return the light's view and the closeness of what it sees, per pixel."""
    size = (SHADOW_PIXELS, SHADOW_PIXELS)
    view = raster.look(TARGET + 30.0 * TO_LIGHT, TARGET, SHADOW_SCALE, size, False)
    closest = np.full(size, -np.inf, np.float32)
    raster.fill(view.project(world), closest, np.empty(size, np.int32))
    return view, closest


def _draw_boxes(
    view: raster.View, boxes: Boxes, states: IntArray, closest: Pixels, image: Pixels
) -> None:
    reach = SIGNS[None] * boxes.half_extents[:, None]
    corners = boxes.centers[:, None] + np.einsum("nij,nkj->nki", boxes.rotations, reach)
    quads = corners[:, FACES].reshape(-1, 4, 3)
    out = np.cross(quads[:, 1] - quads[:, 0], quads[:, 3] - quads[:, 0])
    front = np.einsum("nk,nk->n", out, EYE - quads.mean(axis=1)) > 0.0
    far_first = np.argsort(-np.linalg.norm(quads.mean(axis=1) - EYE, axis=1))
    rows = far_first[front[far_first]]
    kinds = np.repeat(states, len(FACES))[rows]
    halves = quads[rows][:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
    twice = np.repeat(kinds, 2)
    overlay.blend_triangles(
        view.project(halves), STATE_COLORS[twice], FACE_ALPHAS[twice], closest, image
    )
    order = np.argsort(states, kind="stable")  # the colliding last, on top
    kinds = np.repeat(states[order], len(EDGES))
    edges = view.project(corners[order][:, EDGES].reshape(-1, 2, 3))
    radii = EDGE_RADII[kinds] * SAMPLES
    overlay.blend_lines(edges, STATE_COLORS[kinds], radii, HIDDEN_EDGE, closest, image)


def _draw_contacts(view: raster.View, contacts: FloatArray, closest: Pixels, image: Pixels) -> None:
    """Draw dots, white around, over everything: contacts are inside of things."""
    dots = np.repeat(view.project(contacts.reshape(-1, 1, 3)), 2, axis=1)
    for radius, color in ((DOT_RADII[1], (1.0, 1.0, 1.0)), (DOT_RADII[0], STATE_COLORS[COLLIDING])):
        radii = np.full(len(dots), radius * SAMPLES)
        overlay.blend_lines(dots, np.tile(color, (len(dots), 1)), radii, 1.0, closest, image)

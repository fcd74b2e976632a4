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

"""The shapes of links as convex bodies, placed in the frames of their links: see ``Bodies``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.trees.circumscribed import excess
from obb_collision.geometry.trees.convex_proxy import box_corners, hull_mesh
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.intrinsics import in_blocks
from obb_collision.obb import OBB
from obb_collision.robots.bodies.state_arrays import Bodies
from obb_collision.scene.objects import local_box
from obb_collision.scene.store.kinds import BOX, BOXED, ROUND, kind_of, round_sizes
from obb_collision.shapes import Capsule, Shape
from obb_collision.typing import Floats, Integers

#: Relative growth of radii: more than their roundings.
RADIUS_GROWTH = 1.0 + 64 * ROUNDOFF
#: The same of balls within bodies; slivers among faces are off by more.
NARROWER = 1.0 - 2.0**-10


class Body(NamedTuple):
    """One body: as a row of ``Bodies``, with its corners (k, 3), also in ``blocks``."""

    frame: int
    center: Floats
    rotation: Floats
    half_extents: Floats
    sphere: float
    inner: float
    round: float
    reach: float
    corners: Floats
    radius: float
    blocks: Floats
    excess: float


def body_of(
    shape: Shape | OBB, pose: ArrayLike, frame: int = 0, padding: float = 0.0, chain: float = 0.0
) -> Body:
    """Return the body of a shape at a pose (7,) in a frame, padded as in a scene.

    chain: length of the chain up to the frame, metres.
    """
    positions, rotations = as_poses(np.array(pose, np.float64)[None], "pose")
    center, rotation, half_extents = local_box(shape)
    corners, radius, inner = _core(shape, padding)
    return placed_body(
        corners @ rotations[0].T + positions[0], radius, frame, chain,
        (rotations[0] @ center + positions[0], rotations[0] @ rotation, half_extents + padding),
        inner, excess(shape, corners),
    )  # fmt: skip


def placed_body(
    corners: Floats, radius: float, frame: int, chain: float, box: tuple[Floats, Floats, Floats],
    inner: float = 0.0, beyond: float = 0.0,
) -> Body:  # fmt: skip
    """Return the body of corners (k, 3), a radius around them and a box, all in a frame.

    inner: radius of a ball within it, around the centre of the box; beyond: how far it reaches
    beyond a curved shape.
    """
    center, rotation, half_extents = box
    sphere = (float(np.linalg.norm(corners - center, axis=1).max()) + radius) * RADIUS_GROWTH
    farthest = float(np.abs(corners).sum(axis=1).max())
    return Body(
        frame, center, rotation, half_extents, sphere, inner, radius, chain + farthest + radius,
        corners, farthest, in_blocks(corners), beyond,
    )  # fmt: skip


def _core(shape: Shape | OBB, padding: float) -> tuple[Floats, float, float]:
    """Return the corners (k, 3) of a shape, the radius around each point, and that of a ball.

    Padding makes boxes larger, and is a radius around others. The ball is within the hull, around
    the centre of its box.
    """
    kind = kind_of(shape)
    if kind == ROUND:
        radius, half = round_sizes(shape)
        ends = (-half, half) if isinstance(shape, Capsule) else (0.0,)
        return np.array([(0.0, 0.0, z) for z in ends]), radius + padding, radius * NARROWER
    if kind in (BOX, BOXED):
        center, rotation, half_extents = local_box(shape)
        half_extents = half_extents + padding
        corners = box_corners(half_extents) @ rotation.T + center
        return corners, 0.0, float(half_extents.min()) * NARROWER
    assert isinstance(shape, Shape)
    corners, faces = hull_mesh(shape)
    a, b, c = (corners - local_box(shape)[0])[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    heights = np.einsum("ij,ij->i", normals, a) / np.linalg.norm(normals, axis=1)
    return corners, padding, max(float(heights.min()), 0.0) * NARROWER


def joined(bodies: Sequence[Body]) -> Bodies:
    """Return bodies as arrays."""
    blocks = [body.blocks for body in bodies]

    def column(values: Iterable[object], *shape: int) -> Floats:
        return np.array(list(values), np.float64).reshape(len(bodies), *shape)

    return Bodies(
        np.array([body.frame for body in bodies], np.int64),
        column((body.center for body in bodies), 3),
        column((body.rotation for body in bodies), 3, 3),
        column((body.half_extents for body in bodies), 3),
        column(body.sphere for body in bodies),
        column(body.inner for body in bodies),
        np.zeros(len(bodies), np.bool_),
        column(body.round for body in bodies),
        column(body.radius for body in bodies),
        column(body.reach for body in bodies),
        column(body.excess for body in bodies),
        np.concatenate([np.empty((0, 3, 8)), *blocks]),
        np.cumsum([0, *map(len, blocks)]),
    )


def enclosing_spheres(bodies: Sequence[Body], starts: Integers) -> tuple[Floats, Floats]:
    """Return centres (l, 3) and radii (l,) of spheres around bodies ``starts[k]:starts[k + 1]``."""
    centers, radii = np.zeros((len(starts) - 1, 3)), np.zeros(len(starts) - 1)
    for k, (first, last) in enumerate(pairwise(starts.tolist())):
        some = bodies[first:last]
        places = np.array([body.center for body in some])
        spheres = np.array([body.sphere for body in some])
        centers[k] = places.mean(axis=0)
        radii[k] = (np.linalg.norm(places - centers[k], axis=1) + spheres).max() * RADIUS_GROWTH
    return centers, radii


def merged(first: Bodies, second: Bodies) -> Bodies:
    """Return the bodies of both, those of the first first."""
    arrays: dict[str, Any] = {
        name: np.concatenate([values, getattr(second, name)])
        for name, values in first._asdict().items()
    }
    arrays["starts"] = np.append(first.starts, second.starts[1:] + first.starts[-1])
    return Bodies(**arrays)

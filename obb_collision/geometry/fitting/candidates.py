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

"""Candidate orientations for the box of a point set.

Every function takes points (n, 3) about the origin and of size about 1 (see ``fit``) and returns
rotations (3, 3), columns are axes, determinant +1, orthonormal to a few roundoffs. They are
compared by volume only: any frame gives a box that contains the points (see ``enclosing``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import QhullError

from obb_collision.geometry.fitting.convex_hull import (
    convex_hull,
    hull_polygon,
    minimum_rectangle_direction,
)
from obb_collision.geometry.poses import matrices_from_quaternions
from obb_collision.numerics.constants import DEPENDENT
from obb_collision.numerics.vec3 import cross
from obb_collision.typing import Floats

#: Refining ends when it saves less than this fraction of the volume.
WORTHWHILE = 1e-9

#: Orientations from which those to refine are chosen. Of 256 the best four, with the best two of
#: the principal and axis-aligned ones, gave 1.003 times the minimum volume found by 100
#: refinements, in the worst case 1.02; those two and two more principal ones alone 1.01, in the
#: worst case 1.07.
SPREAD = 256

#: Rounds of refining; on all meshes tried it converged in 3 to 6.
MAX_ROUNDS = 20


def complete_frame(first: Floats, second: Floats) -> Floats:
    """Return the rotation whose first column is along ``first``, the second towards ``second``.

    Gram and Schmidt, each step done twice ("twice is enough", Kahan, in Parlett 1980, 6.9). Zero
    components stay exactly zero. A second vector that is parallel or zero is replaced.
    """
    a = _unit(first)
    b = _orthogonal_to(a, second)
    if b is None:
        b = _orthogonal_to(a, np.eye(3)[np.abs(a).argmin()])
        assert b is not None  # at least 54 degrees from the least aligned coordinate axis
    c = _unit(_cross(a, b))
    return np.column_stack([a, b, c]) + 0.0  # no -0.0


def _cross(a: Floats, b: Floats) -> Floats:
    return np.array(cross(tuple(a.tolist()), tuple(b.tolist())))


def _unit(vector: Floats) -> Floats:
    scaled: Floats = vector / np.abs(vector).max()
    unit: Floats = scaled / np.sqrt(scaled @ scaled)
    return unit


def _orthogonal_to(a: Floats, vector: Floats) -> Floats | None:
    if not vector.any():
        return None
    b = _unit(vector)
    b = b - (a @ b) * a
    if b @ b < DEPENDENT**2:
        return None
    b = _unit(b)
    return _unit(b - (a @ b) * a)


def keep_flat(frame: Floats, flat: NDArray[np.bool_]) -> Floats:
    """Return the frame turned by roundoffs so that flat coordinates stay exactly flat.

    flat (3,): which coordinates are the same for all points. A set in a plane z = const gets an
    axis that is exactly z, hence a half extent that is exactly zero.
    """
    if flat.sum() >= 2:
        return np.eye(3)
    if not flat.any():
        return frame
    normal = np.eye(3)[int(flat.argmax())]
    keep = 1 if np.abs(normal @ frame).argmax() == 0 else 0
    within = np.where(flat, 0.0, frame[:, keep])
    return complete_frame(within, _cross(normal, within))


def covariance_frame(points: Floats) -> Floats:
    """Return the principal axes of the points, the longest spread first.

    Two passes: the mean is subtracted first; the axes come from the singular vectors of the
    centred points, which keep twice the digits of the covariance matrix.
    """
    centered = points - points.mean(axis=0)
    if not centered.any():
        return np.eye(3)
    _, _, axes = np.linalg.svd(centered, full_matrices=False)
    second = axes[1] if len(axes) > 1 else np.zeros(3)
    return complete_frame(axes[0], second)


def hull_covariance_frame(points: Floats) -> Floats | None:
    """Return the principal axes of the surface of the convex hull; None if that is flat.

    Weighted by area, so that the density of the points does not matter (Gottschalk, Lin,
    Manocha 1996, section 3): triangle p q r of area A with centroid m adds
    A / 12 (9 m m^T + p p^T + q q^T + r r^T) about the mean.
    """
    hull = convex_hull(points)
    if hull is None:
        return None
    triangles = points[hull.simplices]
    return _surface_frame(triangles)


def polygon_covariance_frame(points: Floats, frame: Floats) -> Floats | None:
    """Return the principal axes of the hull of a flat set, projected along the last axis."""
    polygon = hull_polygon(points @ frame[:, :2])
    if polygon is None:
        return None
    first = np.broadcast_to(polygon[0], (len(polygon) - 2, 2))
    fan = np.stack([first, polygon[1:-1], polygon[2:]], axis=1)
    inner = _surface_frame(np.concatenate([fan, np.zeros((len(fan), 3, 1))], axis=2))
    return complete_frame(frame @ inner[:, 0], frame @ inner[:, 1])


def _surface_frame(triangles: Floats) -> Floats:
    edges = triangles[:, 1:] - triangles[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    weights = areas / areas.sum()
    about = triangles - weights @ triangles.mean(axis=1)
    samples = np.concatenate([3.0 * about.mean(axis=1)[:, None], about], axis=1)
    second_moment = np.einsum("n,nki,nkj->ij", weights / 12.0, samples, samples)
    _, axes = np.linalg.eigh(second_moment)
    return complete_frame(axes[:, 2], axes[:, 1])


def minimum_volume_frame(points: Floats) -> Floats | None:
    """Return the axes of trimesh's oriented bounds; None where it fails."""
    import trimesh  # here, as it takes half a second

    hull = convex_hull(points)
    if hull is None:
        return None
    # As a mesh: of bare points trimesh repairs the hull's winding, sometimes by networkx, which
    # it does not require.
    mesh = trimesh.Trimesh(points, hull.simplices, process=False)
    try:
        to_box, _ = trimesh.bounds.oriented_bounds(mesh, ordered=False)
    except (QhullError, ValueError, IndexError, TypeError, ImportError, np.linalg.LinAlgError):
        return None  # nearly flat sets; the other candidates are used
    if not np.isfinite(to_box).all():
        return None
    return complete_frame(to_box[0, :3], to_box[1, :3])


def refined_frame(points: Floats, frame: Floats, floor: float) -> Floats:
    """Return the frame turned about its own axes while that makes the box smaller.

    Projected along an axis, the minimum rectangle has a side on an edge of the outline; each
    round tries those of the three projections.
    """
    best, size, done = frame, box_size(points, frame, floor), -1
    for _ in range(MAX_ROUNDS):
        tried = {axis: _turned(points, best, axis) for axis in range(3) if axis != done}
        sizes = {axis: box_size(points, turned, floor) for axis, turned in tried.items()}
        axis = min(sizes, key=lambda key: sizes[key])
        if sizes[axis] >= size * (1.0 - WORTHWHILE):
            break
        best, size, done = tried[axis], sizes[axis], axis
    return best


def _turned(points: Floats, frame: Floats, axis: int) -> Floats:
    """Return the frame turned about one of its axes to the minimum rectangle in the projection."""
    u, v = frame[:, (axis + 1) % 3], frame[:, (axis + 2) % 3]
    polygon = hull_polygon(points @ np.column_stack([u, v]))
    if polygon is None:
        return frame
    x, y = minimum_rectangle_direction(polygon)
    turned = complete_frame(x * u + y * v, x * v - y * u)
    return np.roll(turned, axis + 1, axis=1)  # each axis keeps its column


def spread_frames() -> Floats:
    """Return (n, 3, 3) orientations spread over all rotations, always the same ones.

    Random quaternions from a fixed seed (Shoemake 1992), turned into matrices.
    """
    quaternions = np.random.default_rng(0).normal(size=(SPREAD, 4))
    return matrices_from_quaternions(quaternions / np.linalg.norm(quaternions, axis=1)[:, None])


def box_size(points: Floats, frame: Floats, floor: float) -> float:
    """Return the volume of the box of the points, extents below ``floor`` taken as ``floor``.

    Flat sets therefore compare by area and lines by length, if their boxes are as flat.
    """
    along = points @ frame
    return float(np.prod(np.maximum(along.max(axis=0) - along.min(axis=0), floor)))

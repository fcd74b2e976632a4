"""Candidate orientations for the box of a point set.

Every function takes points (n, 3) about the origin and of size about 1 (see fitting.py) and
returns rotations (3, 3), columns are axes, determinant +1, orthonormal to a few roundoffs. How
well they suit is a matter of volume alone: whether the box contains the points is settled
afterwards, whatever the frame (enclosing.py).
"""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from obb_collision.geometry.validation import Floats

#: A vector whose length fell below this fraction when made square to another was parallel to it.
PARALLEL = 1e-8

#: A refined frame must save more than this fraction of the volume, or refining ends.
WORTHWHILE = 1e-9

#: Up to this many points Qhull may merge the pieces of flat faces, see convex_hull.
MANY_HULL_POINTS = 1000

#: Refining turned to a few roundoffs within 3 to 6 rounds on all meshes tried.
MAX_ROUNDS = 20


def complete_frame(first: Floats, second: Floats) -> Floats:
    """Return the rotation whose first column is along ``first``, the second towards ``second``.

    Gram and Schmidt, each step done twice ("twice is enough", Kahan, in Parlett 1980, 6.9). Zero
    components stay exactly zero. A second vector that is parallel or zero is replaced.
    """
    a = _unit(first)
    b = _square_to(a, second)
    if b is None:
        b = _square_to(a, np.eye(3)[np.abs(a).argmin()])
        assert b is not None  # at least 54 degrees from the least aligned coordinate axis
    c = _unit(np.cross(a, b))
    return np.column_stack([a, b, c]) + 0.0  # no -0.0


def _unit(vector: Floats) -> Floats:
    scaled: Floats = vector / np.abs(vector).max()
    unit: Floats = scaled / np.sqrt(scaled @ scaled)
    return unit


def _square_to(a: Floats, vector: Floats) -> Floats | None:
    if not vector.any():
        return None
    b = _unit(vector)
    b = b - (a @ b) * a
    if b @ b < PARALLEL**2:
        return None
    b = _unit(b)
    return _unit(b - (a @ b) * a)


def keep_flat(frame: Floats, flat: NDArray[np.bool_]) -> Floats:
    """Return the frame turned by roundoffs so that flat coordinates stay exactly flat.

    ``flat`` (3,) tells the coordinates that are the same for all points: a set in a plane
    z = const gets an axis that is exactly z, hence a half extent that is exactly zero.
    """
    if flat.sum() >= 2:
        return np.eye(3)
    if not flat.any():
        return frame
    normal = np.eye(3)[int(flat.argmax())]
    keep = 1 if np.abs(normal @ frame).argmax() == 0 else 0
    within = np.where(flat, 0.0, frame[:, keep])
    return complete_frame(within, np.cross(normal, within))


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

    Weighted by area, so that how densely each side is sampled does not matter (Gottschalk, Lin,
    Manocha 1996, section 3): triangle p q r of area A with centroid m adds
    A / 12 (9 m m^T + p p^T + q q^T + r r^T) about the mean.
    """
    hull = convex_hull(points)
    if hull is None:
        return None
    triangles = points[hull.simplices]
    return _surface_frame(triangles)


def polygon_covariance_frame(points: Floats, frame: Floats) -> Floats | None:
    """Return the same for a flat set: the hull polygon, seen along the last axis of a frame."""
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
    """Return trimesh's oriented bounds: over hull faces, the least rectangle. None if it fails."""
    try:
        to_box, _ = trimesh.bounds.oriented_bounds(points, ordered=False)
    except (QhullError, ValueError, IndexError, TypeError, np.linalg.LinAlgError):
        return None  # nearly flat sets; the other candidates are used
    if not np.isfinite(to_box).all():
        return None
    return complete_frame(to_box[0, :3], to_box[1, :3])


def refined_frame(points: Floats, frame: Floats, floor: float) -> Floats:
    """Return the frame turned about its own axes while that makes the box smaller.

    Seen along an axis, the least rectangle has a side on an edge of the outline; so each round
    tries those of the three outlines.
    """
    best, size = frame, box_size(points, frame, floor)
    for _ in range(MAX_ROUNDS):
        tried = [turned for axis in range(3) for turned in _turned(points, best, axis)]
        sizes = [box_size(points, turned, floor) for turned in tried]
        if not sizes or min(sizes) >= size * (1.0 - WORTHWHILE):
            break
        size = min(sizes)
        best = tried[sizes.index(size)]
    return best


def _turned(points: Floats, frame: Floats, axis: int) -> list[Floats]:
    others = frame[:, (axis + 1) % 3], frame[:, (axis + 2) % 3]
    polygon = hull_polygon(points @ np.column_stack(others))
    if polygon is None:
        return []
    x, y = least_rectangle_direction(polygon)
    first = x * others[0] + y * others[1]
    return [complete_frame(first, np.cross(frame[:, axis], first))]


def box_size(points: Floats, frame: Floats, floor: float) -> float:
    """Return the volume of the box of the points, extents below ``floor`` counted as that.

    So flat sets compare by their area and lines by their length, if their box is as flat.
    """
    along = points @ frame
    return float(np.prod(np.maximum(along.max(axis=0) - along.min(axis=0), floor)))


def convex_hull(points: Floats) -> ConvexHull | None:
    """Return the convex hull of points (n, 2) or (n, 3); None where they are too flat for it.

    Scaled to a cube (QbB), so that thin sets work. Qhull takes quadratic time on faces with
    thousands of corners (2.3 s for a cylinder of 10,000 points) unless it moves them by roundoffs
    (QJ, 0.1 s); both are good enough to choose axes by.
    """
    options = "QbB Qt" if len(points) <= MANY_HULL_POINTS or points.shape[1] == 2 else "QbB QJ"
    try:
        return ConvexHull(points, qhull_options=options)
    except (QhullError, ValueError):
        return None


def hull_polygon(points: Floats) -> Floats | None:
    """Return the hull (m, 2) of points (n, 2), counter-clockwise; None where they are a line."""
    hull = convex_hull(points)
    return None if hull is None else points[hull.vertices]


def least_rectangle_direction(polygon: Floats) -> Floats:
    """Return the direction (2,) of a side of the least-area rectangle about a convex polygon.

    Rotating calipers (Toussaint 1983): a side of the rectangle lies on an edge of the polygon
    (Freeman and Shapira 1975), and the extreme corners for an edge are found by its angle.
    """
    edges = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    polygon, edges = polygon[lengths > 0.0], edges[lengths > 0.0] / lengths[lengths > 0.0, None]
    angles = np.arctan2(edges[:, 1], edges[:, 0])
    start = int(angles.argmin())
    order = np.r_[start : len(angles), 0:start]
    polygon, edges = polygon[order], edges[order]
    angles = np.maximum.accumulate(angles[order])

    def farthest(directions: Floats) -> Floats:
        # Corner k is extreme between the outward normals of the edges before and after it.
        turned = np.arctan2(directions[:, 0], -directions[:, 1])  # + 90 degrees: along the edge
        corner = np.searchsorted(angles, turned) % len(polygon)
        result: Floats = np.einsum("ij,ij->i", polygon[corner], directions)
        return result

    across = np.column_stack([edges[:, 1], -edges[:, 0]])
    length = farthest(edges) + farthest(-edges)
    width = farthest(across) + farthest(-across)
    direction: Floats = edges[int((length * width).argmin())]
    return direction

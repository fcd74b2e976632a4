"""Two boxes in the frame of one, as tuples of numbers: compiled, they live in registers.

Small arrays and loops over them cost five to ten times as much: kernels that spend their time on
one pair at a time are written with these.
"""

from __future__ import annotations

from typing import NamedTuple

from obb_collision._jit import njit

Vector = tuple[float, float, float]


class Pair(NamedTuple):
    """Boxes a, b in the frame of a. A point of a is s, abs(s) <= h; of b d + r t, abs(t) <= f."""

    d: Vector  #: centre of b
    r: tuple[Vector, Vector, Vector]  #: axes of b
    h: Vector  #: half extents of a
    f: Vector  #: half extents of b


@njit
def dot(u: Vector, v: Vector) -> float:
    """Return the scalar product."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@njit
def dot_abs(u: Vector, v: Vector) -> float:
    """Return sum_i u_i abs(v_i): for u half extents, half the length of a box along v."""
    return u[0] * abs(v[0]) + u[1] * abs(v[1]) + u[2] * abs(v[2])


@njit
def plus(u: Vector, v: Vector) -> Vector:
    """Return u + v."""
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


@njit
def minus(u: Vector, v: Vector) -> Vector:
    """Return u - v."""
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


@njit
def clamp(x: float, limit: float) -> float:
    """Return the number from -limit to limit that is closest to x."""
    return min(max(x, -limit), limit)


@njit
def clamped(v: Vector, limits: Vector) -> Vector:
    """Return the point of a centred box closest to v."""
    return clamp(v[0], limits[0]), clamp(v[1], limits[1]), clamp(v[2], limits[2])


@njit
def pick(v: Vector, i: int) -> float:
    """Return component i, not known when compiling."""
    return v[0] if i == 0 else v[1] if i == 1 else v[2]


@njit
def replaced(v: Vector, i: int, x: float) -> Vector:
    """Return v with x for component i."""
    return x if i == 0 else v[0], x if i == 1 else v[1], x if i == 2 else v[2]


@njit
def along_b(pair: Pair, v: Vector) -> Vector:
    """Return the components of a vector along the axes of b."""
    return dot(pair.r[0], v), dot(pair.r[1], v), dot(pair.r[2], v)


@njit
def point_of_b(pair: Pair, t: Vector) -> Vector:
    """Return d + r t."""
    d, (x, y, z) = pair.d, pair.r
    return (
        d[0] + (x[0] * t[0] + y[0] * t[1] + z[0] * t[2]),
        d[1] + (x[1] * t[0] + y[1] * t[1] + z[1] * t[2]),
        d[2] + (x[2] * t[0] + y[2] * t[1] + z[2] * t[2]),
    )


@njit
def closest_on_a(pair: Pair, t: Vector) -> Vector:
    """Return s of the point of a closest to that of b."""
    return clamped(point_of_b(pair, t), pair.h)


@njit
def closest_on_b(pair: Pair, s: Vector) -> Vector:
    """Return t of the point of b closest to that of a."""
    return clamped(along_b(pair, minus(s, pair.d)), pair.f)


@njit
def gap_along(pair: Pair, n: Vector) -> float:
    """Return the gap along a unit vector from a to b: at most the distance."""
    return dot(n, pair.d) - dot_abs(pair.h, n) - dot_abs(pair.f, along_b(pair, n))

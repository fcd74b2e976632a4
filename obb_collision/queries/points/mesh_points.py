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

"""Whether a point is inside a placed mesh, or within a margin of it.

What doubles cannot tell from the surface counts as inside, so no point of a body is ever reported
as outside: points within 2^-41 of the reach of the mesh and the offset from its origin, and those
of which every ray passes too near to an edge (``inside``), as some beside slivers do. Of a surface
the first are all.
"""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.numerics.constants import MESH_UNDERFLOW
from obb_collision.numerics.vec3 import components, minus, scaled, sum_abs
from obb_collision.queries.meshes.inside import OUTSIDE, point_side
from obb_collision.queries.meshes.tree_boxes import POINT_BOUND, node_at
from obb_collision.queries.meshes.tree_descent import Bodies, body_at
from obb_collision.queries.meshes.triangle_distance import triangle_bounds
from obb_collision.queries.meshes.triangle_signs import triangle_at
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.typing import Vector

#: Relative slack of a margin: squares, sums and roots of distances are off by 8 roundoffs.
DISTANCE_ROUNDING = 2.0**-48


@njit
def body_holds(bodies: Bodies, i: int, point: Vector, margin: float, stack: np.ndarray) -> bool:
    """Return whether a point is inside body i, or not certainly farther from it than a margin."""
    trees, body = bodies.trees, body_at(bodies, i)
    d = minus(point, body.place.center)
    p = components(body.place.axes, d)
    error = POINT_BOUND * (sum_abs(d) + trees.radii[body.mesh]) + MESH_UNDERFLOW
    if trees.solid[body.mesh]:
        if point_side(trees, body.mesh, p, error, stack) != OUTSIDE:
            return True
        if margin == 0.0:
            return False
    reach = margin * (1.0 + DISTANCE_ROUNDING) + 4.0 * error
    unit, _ = unit_scale(trees.radii[body.mesh] + reach)
    return _surface_within(trees, trees.roots[body.mesh], p, reach, unit, stack)


@njit
def _surface_within(
    trees: TreeArrays, root: int, p: Vector, reach: float, unit: float, stack: np.ndarray
) -> bool:
    """Return False only where no triangle is within ``reach`` of a point of the same frame."""
    stack[0, 0] = root
    waiting = 1
    while waiting > 0:
        waiting -= 1
        node = stack[waiting, 0]
        if _box_apart(trees, node, p, reach, unit):
            continue
        if trees.children[node] >= 0:
            stack[waiting, 0], stack[waiting + 1, 0] = (
                trees.children[node],
                trees.children[node] + 1,
            )
            waiting += 2
            continue
        for n in range(trees.starts[node, 0], trees.starts[node, 1]):
            a, b, c = triangle_at(trees.triangles, n)
            a, b, c = (
                scaled(minus(a, p), unit),
                scaled(minus(b, p), unit),
                scaled(minus(c, p), unit),
            )
            zero = 0.0, 0.0, 0.0
            lower, _, _ = triangle_bounds((a, b, c), (zero, zero, zero), a, 2.0 * unit * reach)
            if not lower > unit * reach:
                return True
    return False


@njit
def _box_apart(trees: TreeArrays, n: int, p: Vector, reach: float, unit: float) -> bool:
    """Return whether the box of a node is farther from a point than ``reach``."""
    center, axes, half = node_at(trees.nodes, n)
    d = components(axes, minus(p, center))
    square = 0.0
    for k in range(3):
        beyond = unit * (abs(d[k]) - half[k])
        square += beyond * beyond if beyond > 0.0 else 0.0
    return math.sqrt(square) > unit * reach

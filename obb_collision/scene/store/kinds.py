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

"""Kinds of shapes: what a shape is to the levels above OBB."""

from __future__ import annotations

from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.shapes.primitives import Box, Capsule, Shape, Sphere
from obb_collision.obb import OBB

#: Decided by their boxes only, boxes, spheres and capsules, other convex shapes, triangles.
BOXED, BOX, ROUND, CONVEX, TRIANGLES = range(5)


def kind_of(shape: Shape | OBB) -> int:
    """Return the kind of a shape; a Mesh without faces has no triangles."""
    if isinstance(shape, (Box, OBB)):
        return BOX
    if isinstance(shape, Mesh):
        return TRIANGLES if len(shape.faces) else BOXED
    round_one = isinstance(shape, (Sphere, Capsule)) and len(set(shape.scale)) == 1
    return ROUND if round_one else CONVEX

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

"""The shapes of objects: sizes as URDF and RViz say them, full lengths of edges and axes.

Each lives in its own frame, about its own origin, and has a ``local_box`` there, which contains it.
``OBB`` and ``Boxes``, which are computed with, have half extents instead.
"""

from __future__ import annotations

from obb_collision.geometry.shapes.meshes import Hull, Mesh
from obb_collision.geometry.shapes.primitives import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Shape,
    Sphere,
)
from obb_collision.geometry.trees.clouds import Cloud

__all__ = [
    "Box",
    "Capsule",
    "Cloud",
    "Cone",
    "Cylinder",
    "Ellipsoid",
    "Hull",
    "Mesh",
    "Shape",
    "Sphere",
]

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

"""Distances, depths and contacts of convex bodies."""

from obb_collision.queries.convex.contacts import FlatFrame, convex_contacts, frame_of
from obb_collision.queries.convex.distance import CONVEX_ROUNDING
from obb_collision.queries.convex.distances import (
    ConvexDistances,
    convex_distances,
    convex_may_collide,
    mesh_body_distances,
)

__all__ = [
    "CONVEX_ROUNDING",
    "ConvexDistances",
    "FlatFrame",
    "convex_contacts",
    "convex_distances",
    "convex_may_collide",
    "frame_of",
    "mesh_body_distances",
]

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

"""Placed meshes and hulls: verdicts, distances, and the trees behind them."""

from obb_collision.queries.meshes.hull_hull import GAP_BOUND, PlacedHulls, hulls_may_collide
from obb_collision.queries.meshes.inside import SLAB_SLACK, outside_box
from obb_collision.queries.meshes.mesh_mesh import MeshClearances
from obb_collision.queries.meshes.trees import DISTANCE_BOUND

__all__ = [
    "DISTANCE_BOUND",
    "GAP_BOUND",
    "SLAB_SLACK",
    "MeshClearances",
    "PlacedHulls",
    "hulls_may_collide",
    "outside_box",
]

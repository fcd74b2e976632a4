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

"""Oriented bounding box collision checking.

Conventions, everywhere in this package
---------------------------------------
Numbers are float64, lengths are metres, angles radians, times seconds.
Frames: all boxes of a call or scene are in one common frame.
Quaternions are ordered x y z w; poses are x y z qx qy qz qw.
Rotations are (3, 3) matrices whose columns are the box axes.
Extents are half extents, never negative; zero makes a flat box, which is legal.
A box is the set {centre + sum_i t_i h_i a_i, abs(t_i) <= 1}, for the doubles as stored.
Boxes are closed: touching is a collision. What doubles can't tell from touching counts as such.
Separations are signed: positive apart, negative overlapping; the depth is its negative.
Normals have unit length and point from the first box, a, to the second, b.
Pairs are sorted: i < j in a pair, and the pairs in lexicographic order.
Corners come in one order: on the +z face left-top, left-bottom, right-bottom, right-top, then on
the -z face right-top, right-bottom, left-bottom, left-top (right is +x, top is +y).

Layers, each importing only those before it: ``geometry`` (what a box is), ``queries`` (one file a
question about boxes), ``obb`` (one box as a value), ``scene`` (the store, the broad phase, the
check), ``node`` (ROS), and ``benchmarks`` beside it.
"""

from obb_collision.geometry.aabb import AABB
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.capsules import Capsules
from obb_collision.geometry.mesh_tree import MeshTrees
from obb_collision.geometry.shapes import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Hull,
    Mesh,
    Shape,
    Sphere,
)
from obb_collision.obb import OBB, Separation
from obb_collision.queries.accuracy import Accuracy
from obb_collision.queries.capsules import CapsuleDistances, capsule_distances, capsule_verdicts
from obb_collision.queries.clearance import Clearances, clearances, clearances_within
from obb_collision.queries.contacts import Contacts, contacts
from obb_collision.queries.mesh_collision import (
    PlacedMeshes,
    mesh_collisions,
    mesh_contacts,
    mesh_verdicts,
    tree_collisions,
)
from obb_collision.queries.planes import PlaneDistances, aabb_verdicts, plane_distances
from obb_collision.queries.points import PointsInside, points_inside
from obb_collision.queries.rays import RayHits, cast_rays, cast_segments, segments_intersect
from obb_collision.queries.separation import Verdict, verdicts
from obb_collision.queries.sweep import Sweeps, sweep, sweep_twists
from obb_collision.scene.files import SceneDescription, load_scene
from obb_collision.scene.pairs import find_pairs
from obb_collision.scene.report import Report
from obb_collision.scene.scene import Scene

__version__ = "0.1.0"

__all__ = [
    "AABB",
    "OBB",
    "Accuracy",
    "Box",
    "Boxes",
    "Capsule",
    "CapsuleDistances",
    "Capsules",
    "Clearances",
    "Cone",
    "Contacts",
    "Cylinder",
    "Ellipsoid",
    "Hull",
    "Mesh",
    "MeshTrees",
    "PlacedMeshes",
    "PlaneDistances",
    "PointsInside",
    "RayHits",
    "Report",
    "Scene",
    "SceneDescription",
    "Separation",
    "Shape",
    "Sphere",
    "Sweeps",
    "Verdict",
    "aabb_verdicts",
    "capsule_distances",
    "capsule_verdicts",
    "cast_rays",
    "cast_segments",
    "clearances",
    "clearances_within",
    "contacts",
    "find_pairs",
    "load_scene",
    "mesh_collisions",
    "mesh_contacts",
    "mesh_verdicts",
    "plane_distances",
    "points_inside",
    "segments_intersect",
    "sweep",
    "sweep_twists",
    "tree_collisions",
    "verdicts",
]

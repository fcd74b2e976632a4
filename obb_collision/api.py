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

"""All public names of the library; ``obb_collision`` loads them from here when first used.

What functions return is public with them; its classes are in the modules of the functions.
"""

from obb_collision import shapes
from obb_collision._threads import set_threads, threads
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.aabb import AABB
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.capsules import Capsules
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.obb import OBB
from obb_collision.queries.clearance.clearance import clearances
from obb_collision.queries.contacts.contacts import contacts
from obb_collision.queries.mesh_contacts.surfaces import mesh_patches, mesh_separations
from obb_collision.queries.meshes.mesh_clearance import mesh_clearances
from obb_collision.queries.meshes.meshes import mesh_collisions, mesh_contacts, mesh_verdicts
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.points.points import points_inside
from obb_collision.queries.primitives.capsules import capsule_distances
from obb_collision.queries.primitives.planes import plane_distances
from obb_collision.queries.rays.rays import cast_rays, cast_segments
from obb_collision.queries.sweep.meshes import mesh_sweeps
from obb_collision.queries.sweep.moving import MovingBoxes
from obb_collision.queries.sweep.sweep import sweeps
from obb_collision.queries.verdict.overlap import iou, overlap_volumes
from obb_collision.queries.verdict.separations import separations
from obb_collision.queries.verdict.verdict import Verdict, verdicts
from obb_collision.robots.checks.robot_scene import RobotScene
from obb_collision.robots.description.robot import Robot
from obb_collision.robots.proofs.proved_pairs import prove_pairs
from obb_collision.scene.broad_phase.any_collision import any_collision
from obb_collision.scene.broad_phase.find_pairs import find_pairs
from obb_collision.scene.broad_phase.nms import nms
from obb_collision.scene.region_merger import RegionMerger
from obb_collision.scene.report import Report
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.region import Region, split_regions
from obb_collision.scene_files import SceneDescription, load_scene

__all__ = [
    "AABB",
    "OBB",
    "Accuracy",
    "Boxes",
    "Capsules",
    "MeshTrees",
    "MovingBoxes",
    "PlacedMeshes",
    "Region",
    "RegionMerger",
    "Report",
    "Robot",
    "RobotScene",
    "Scene",
    "SceneDescription",
    "Verdict",
    "any_collision",
    "capsule_distances",
    "cast_rays",
    "cast_segments",
    "clearances",
    "contacts",
    "find_pairs",
    "iou",
    "load_scene",
    "mesh_clearances",
    "mesh_collisions",
    "mesh_contacts",
    "mesh_patches",
    "mesh_separations",
    "mesh_sweeps",
    "mesh_verdicts",
    "nms",
    "overlap_volumes",
    "plane_distances",
    "points_inside",
    "prove_pairs",
    "separations",
    "set_threads",
    "shapes",
    "split_regions",
    "sweeps",
    "threads",
    "verdicts",
]

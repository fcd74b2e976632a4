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

from obb_collision import regions, shapes
from obb_collision._threads import set_threads, threads
from obb_collision.accuracy import Accuracy
from obb_collision.boxes import Boxes
from obb_collision.geometry.boxes import AABB
from obb_collision.geometry.capsules import Capsules
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.obb import OBB
from obb_collision.queries.meshes.mesh_mesh import triangle_pairs
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.points.points import points_inside
from obb_collision.queries.primitives.planes import HalfSpaces
from obb_collision.queries.questions import clearances, contacts, separations, sweeps, verdicts
from obb_collision.queries.rays.rays import cast_rays, cast_segments
from obb_collision.queries.sweep.motion import MovingBoxes
from obb_collision.queries.verdict.overlap import iou, overlap_volumes
from obb_collision.queries.verdict.verdict import Verdict
from obb_collision.robots.robot import Robot
from obb_collision.robots.robot_scene import RobotScene
from obb_collision.scene.broad_phase.find_pairs import any_collision, find_pairs, iou_matrix, nms
from obb_collision.scene.report import Report
from obb_collision.scene.scene import Scene
from obb_collision.scene_files import SceneDescription, load_scene

__all__ = [
    "AABB",
    "OBB",
    "Accuracy",
    "Boxes",
    "Capsules",
    "HalfSpaces",
    "MeshTrees",
    "MovingBoxes",
    "PlacedMeshes",
    "Report",
    "Robot",
    "RobotScene",
    "Scene",
    "SceneDescription",
    "Verdict",
    "any_collision",
    "cast_rays",
    "cast_segments",
    "clearances",
    "contacts",
    "find_pairs",
    "iou",
    "iou_matrix",
    "load_scene",
    "nms",
    "overlap_volumes",
    "points_inside",
    "regions",
    "separations",
    "set_threads",
    "shapes",
    "sweeps",
    "threads",
    "triangle_pairs",
    "verdicts",
]

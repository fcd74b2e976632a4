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

"""The node's own kernels, used once: a step of ``obb_collision.warm_up``."""

from __future__ import annotations

import numpy as np

from obb_collision.geometry.boxes import Boxes
from obb_collision.node.inputs.batch import Faults, gather, settle
from obb_collision.node.messages.box_markers import FREE, Markers
from obb_collision.node.messages.cdr import markers_from_bytes
from obb_collision.node.messages.conversions import pose_kinds


def compile_kernels() -> None:
    """Write markers and take them in."""
    boxes = Boxes(np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), np.ones((2, 3)))
    keys = [("", 1), ("", 2)]
    data = Markers("").write(keys, boxes, np.full(2, FREE), 0, 0.0, None)
    markers = gather([markers_from_bytes(data)], [0])
    pose_kinds(markers.poses)
    settle(markers, Faults(len(markers)), 0, 0)

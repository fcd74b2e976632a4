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

"""All that can be asked of a robot in the node, in a process of its own.

``python all_of_a_robot.py`` prints, as JSON, the kernels that the process compiled or loaded after
the node was ready, without a step of warming up.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from node_process import kernels_of_steps
from rig import cube
from robot_rig import URDF, AskingRig
from std_msgs.msg import Float64
from visualization_msgs.msg import Marker

from obb_collision import _jit

SHAPES = (
    '<sphere radius="0.1"/>',
    '<cylinder radius="0.1" length="0.2"/>',
    '<capsule radius="0.1" length="0.2"/>',
    '<mesh filename="file://{0}/finger.obj"/>',
)
MESH = "v 0 0 0\nv 0.2 0 0\nv 0 0.2 0\nv 0 0 0.2\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def ask(rig: AskingRig) -> None:
    """Ask for everything once."""
    rig.move()
    scales: list[object] = []
    rig.client.create_subscription(Float64, "arm/speed_scale", scales.append, 10)
    for kind in (Marker.CUBE, Marker.SPHERE, Marker.CYLINDER, Marker.ARROW):
        rig.send(cube(("crate", kind), (0.3 * kind, 0.9, 0.5), (0.2, 0.3, 0.4), type=kind))
    rig.answer()
    rig.move({"lift": 0.1, "turn": 0.5}, lift=0.1, turn=0.2)
    rig.until(lambda: scales, "a scale")
    states = np.random.default_rng(0).uniform(-2.0, 2.0, (200, 2))
    for count in (0, 1, 3, 200):
        rig.ask(states[:count])
    rig.set(state_validity_distance=1.0)
    rig.ask(states)
    rig.set(trajectory_margin=1e-4)
    still = [0.0, 0.0]
    rig.publish([(500.0 * n, [lift, 0.2], still) for n, lift in enumerate((0.1, 0.2, 0.1))])
    rig.until(lambda: rig.said, "the trajectory")
    rig.send(cube(("crate", 7), (1.0, 0.2, 0.6), (0.5, 0.5, 0.5)))
    rig.answer()
    rig.cycles(3)


def main(folder: str) -> None:
    """Run it."""
    Path(folder, "finger.obj").write_text(MESH)
    shapes = "".join(
        f"<collision><geometry>{shape.format(folder)}</geometry></collision>" for shape in SHAPES
    )
    urdf = URDF.replace('<link name="column">', f'<link name="column">{shapes}', 1)
    loaded = kernels_of_steps()
    with AskingRig({"mesh_folders": [folder]}) as rig:
        before = _jit.loaded_kernels()
        rig.describe(urdf)
        rig.until(lambda: rig.robot.links is not None, rig.robot.fault)
        ask(rig)
        new = sorted(_jit.loaded_kernels() - before - loaded)
    sys.stdout.write(json.dumps(new) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])

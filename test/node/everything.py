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

"""Everything that can be asked of a robot, and of a node, each in a process of its own.

``python everything.py FOLDER`` prints three lines of JSON: which kernels the process compiled or
loaded after "ready" without a step of warming up, and of the node what each thing asked for took.
"""

from __future__ import annotations

import json
import os
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from node_process import kernels_of_steps
from rig import Rig, cube, pose
from robot_rig import URDF, AskingRig
from sensor_msgs.msg import Range
from sensor_rig import Sensing, parameters_of
from std_msgs.msg import Float64
from visualization_msgs.msg import Marker

from obb_collision import Accuracy, _jit, _kernel_cache
from obb_collision.node.messages.clouds import cloud_to_ros
from obb_collision.node.messages.names import namespace_number
from obb_collision.node.topics.topics import TOPICS

RATE = 200.0
MANY = 70
"""Objects: enough for the incremental ways, and for the scene to grow."""
BUILT = (Marker.TRIANGLE_LIST, Marker.LINE_LIST)
LISTS = (Marker.CUBE_LIST, Marker.SPHERE_LIST)
CORNERS = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
FACES = (0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3)
SHOWN = ("text", "markers", "diagnostics")
"""Effects without kernels, whose messages take longer than all else."""
EFFECTS = {
    name: TOPICS[name].name.replace("~", "obb_collision")
    for name in ("contacts", "clearance", "sweep", "points", *SHOWN)
}
CHANGES: tuple[dict[str, Any], ...] = (
    {"time_budget": 0.005},
    {"accuracy": "mesh"},
    {"time_budget": 0.0, "padding": 0.01},
    {"padding": 0.0, "accuracy_overrides": ["many/*: sphere", "9/*: hull"]},
    {"accuracy_overrides": [], "allowed_pairs": ["many/1* many/2*"]},
    {
        "effects.contacts_max_points": 8,
        "effects.contacts_objects": ["many/*"],
        "effects.clearance_max_distance": 0.5,
        "effects.sweep_horizon": 3.0,
        "effects.points_margin": 0.1,
        "marker_form": "lines",
        "stale_policy": "ignore",
    },
    {"region": ["x: -inf to 0.5"]},
    {"region": [""], "max_pairs": 3},
)


class Everything(Rig):
    """A rig that moves things by every topic."""

    def move(self) -> None:
        """Move things by each topic, all of them and few; send points of each layout."""
        self.send(*(cube(("many", n), (0.85 * n, 5.0, 0.0)) for n in range(3, MANY))).answer()
        for step in (0.1, 0.2):
            self.send_transform("many/5", pose(0.85 * 5 + step, 5.0)).answer()
        twists = np.array([(1.0, 0, 0, 0, 0, 0), (0, 1.0, 0, 0, 0, 2.0)])
        self.send_states(["many/6", "many/7"], [pose(5.0, 5.0), pose(6.0, 5.0)], twists=twists)
        self.answer()
        for single in (True, False):
            poses = [pose(5.0, 5.0, 0.1), pose(6.0 + single, 5.0)]
            self.send_poses([8, 9], poses, [namespace_number("many")] * 2, single=single)
            self.send_boxes([1, 2 + single], [pose(30), pose(30.5)], 1.0 + single, single=single)
            self.answer()
        clouds = self.monitor("points")
        for kind in ("<f4", "<f8"):
            for more in ([], [("intensity", kind)]):
                rows = np.zeros(40, [(name, kind) for name in "xyz"] + more)
                count = clouds.messages
                self.pubs["points"].publish(cloud_to_ros(rows, self.header()))
                self.until(lambda n=count: clouds.messages > n, "points")  # type: ignore[misc]
                self.cycles(1)


def marker(kind: int, number: int) -> Marker:
    """Return a marker of a kind beside the others, so that neighbours overlap."""
    made = cube((str(kind), number), (0.4 * number, 0.1 * kind, 0.0), (0.5, 0.4, 0.3))
    made.type = kind
    if kind in BUILT + LISTS:
        made.points = [Point(x=x, y=y, z=z) for x, y, z in (CORNERS[row] for row in FACES)]
    return made


def objects() -> list[Marker]:
    """Return objects of every kind that the levels tell apart, and enough of them."""
    kinds = (Marker.CUBE, Marker.SPHERE, Marker.CYLINDER, Marker.ARROW, *BUILT, *LISTS)
    few = [marker(kind, number) for kind in kinds for number in range(3)]
    return few + [cube(("many", n), (0.9 * n, 5.0, 0.0)) for n in range(MANY)]


def switch_everything(rig: Everything) -> None:
    """Ask for one thing after the other."""
    rig.send(cube(("alone", 1))).answer()
    rig.send(*objects())
    for kind in BUILT:
        rig.built(*((str(kind), number) for number in range(3)))
    rig.answer()
    rig.move()
    for effect, topic in EFFECTS.items():
        rig.listen(topic)
        rig.until(lambda topic=topic: topic in rig.last, topic)  # type: ignore[misc]
        if effect not in SHOWN:
            rig.move()
    rig.ignore(*(EFFECTS[effect] for effect in SHOWN))
    for level in (*(level.label for level in Accuracy), "obb"):
        rig.set(accuracy=level)
        rig.cycles(5)
        rig.move()
    for values in CHANGES:
        if "marker_form" in values:
            rig.listen(EFFECTS["markers"])
        assert all(result.successful for result in rig.set(**values)), values
        rig.cycles(2)
        rig.move()
    rig.send(*(cube(("crowd", n), (0.0, -5.0, 0.0)) for n in range(200))).answer()
    rig.move()
    rig.send(Marker(ns="many", action=Marker.DELETEALL))
    rig.send(*(Marker(ns="crowd", id=n, action=Marker.DELETE) for n in range(200)))
    rig.move()


SHAPES = (
    '<sphere radius="0.1"/>',
    '<cylinder radius="0.1" length="0.2"/>',
    '<capsule radius="0.1" length="0.2"/>',
    '<mesh filename="file://{0}/finger.obj"/>',
)
MESH = "v 0 0 0\nv 0.2 0 0\nv 0 0.2 0\nv 0 0 0.2\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def urdf_of(folder: Path) -> str:
    """Return a robot with shapes of all kinds; the mesh is in a folder."""
    shapes = "".join(
        f"<collision><geometry>{shape.format(folder)}</geometry></collision>" for shape in SHAPES
    )
    fast = URDF.replace('upper="3"', 'upper="3" velocity="1"')
    return fast.replace('<link name="column">', f'<link name="column">{shapes}', 1)


def ask(rig: AskingRig) -> None:
    """Ask everything of a robot once."""
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
    rig.ask_path(states[:50])
    rig.set(joint_decelerations=["arm/*: 2.0"])
    for lift, turn in ((0.0, 0.0), (0.1, 0.5), (-0.1, -0.5)):  # at rest, towards and away
        rig.move({"lift": lift, "turn": turn}, lift=0.1, turn=0.2)
        rig.cycles(2)
    rig.set(joint_decelerations=[""])
    rig.set(trajectory_margin=1e-4)
    still = [0.0, 0.0]
    rig.publish([(500.0 * n, [lift, 0.2], still) for n, lift in enumerate((0.1, 0.2, 0.1))])
    rig.until(lambda: rig.said, "the trajectory")
    rig.send(cube(("crate", 7), (1.0, 0.2, 0.6), (0.5, 0.5, 0.5))).answer()
    rig.cycles(3)


def all_of_a_robot(folder: Path) -> dict[str, Any]:
    """Ask for all that can be asked of a robot; returns the kernels that no step has loaded."""
    loaded = kernels_of_steps()
    with AskingRig({"mesh_folders": [str(folder)]}) as rig:
        before = _jit.loaded_kernels()
        rig.describe(urdf_of(folder))
        rig.until(lambda: rig.robot.links is not None, rig.robot.fault)
        ask(rig)
        return {"new": sorted(_jit.loaded_kernels() - before - loaded)}


def all_of_a_node() -> dict[str, Any]:
    """Ask for all that can be asked of a node; returns the kernels that no step has loaded."""
    loaded = kernels_of_steps()
    with Everything(rate=RATE, trigger="timer") as rig:
        before, compiled = _jit.loaded_kernels(), len(_kernel_cache.compiled.names)
        switch_everything(rig)
        new = sorted(_jit.loaded_kernels() - before - loaded)
    return {"new": new, "compiled": _kernel_cache.compiled.names[compiled:]}


SENSORS: dict[str, dict[str, Any]] = {
    "front": {"leave_out": ["arm", "held/*"], "shadows": True, "voxel": 0.01, "max_height": 5.0},
    "laser": {"type": "scan"},
    "sonar": {"type": "range"},
    "watched": {"use": "watch", "voxel": 0.01},
}


class Watching(Sensing, AskingRig):
    """A node with a robot and sensors."""


def all_of_sensors(folder: Path) -> dict[str, Any]:
    """Use each kind of sensor; returns the kernels that no step has loaded."""
    loaded = kernels_of_steps()
    given = parameters_of(SENSORS) | {"mesh_folders": [str(folder)]}
    with Watching(given, trigger="timer", rate=RATE) as rig:
        rig.start_sensors(SENSORS)
        before, compiled = _jit.loaded_kernels(), len(_kernel_cache.compiled.names)
        rig.read(urdf_of(folder))
        rig.move()
        rig.send(*objects(), cube(("held", 1), (0.2, 0.1, 0.0), (0.1, 0.1, 0.1)))
        for kind in BUILT:
            rig.built(*((str(kind), number) for number in range(3)))
        points = np.random.default_rng(1).uniform(-1.0, 3.0, (500, 3))
        for number in range(3):
            for name in ("front", "watched"):
                for kind in ("<f4", "<f8"):
                    rig.see(points + 0.01 * number, name, kind=kind)
                    rig.cycles(2)
            rig.scan([1.0, 1.5, 0.2, np.inf], name="laser")
            message = Range(header=rig.header(), range=1.0, max_range=2.0, field_of_view=0.3)
            rig.sensors["sonar"].publish(message)
            rig.cycles(2)
            for effect in ("contacts", "clearance", "sweep", "points")[number:]:
                rig.listen(EFFECTS[effect])
            ask(rig)
            rig.set(accuracy=("hull", "mesh", "obb")[number])
        new = sorted(_jit.loaded_kernels() - before - loaded)
    return {"new": new, "compiled": _kernel_cache.compiled.names[compiled:]}


def main(folder: str) -> None:
    """Run each part in a forked process of its own; all share the modules imported before."""
    (Path(folder) / "finger.obj").write_text(MESH)
    of_folder = partial(all_of_a_robot, Path(folder)), partial(all_of_sensors, Path(folder))
    for part in (*of_folder, all_of_a_node):
        child = os.fork()
        if not child:
            sys.stdout.write(json.dumps(part()) + "\n")
            sys.stdout.flush()
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0, part


if __name__ == "__main__":
    main(*sys.argv[1:])

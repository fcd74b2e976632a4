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

"""Small robots, and parts of their URDF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

import obb_collision as oc

SHAPES = (
    '<box size="{a} {b} {c}"/>',
    '<sphere radius="{a}"/>',
    '<cylinder radius="{a}" length="{c}"/>',
    '<capsule radius="{a}" length="{c}"/>',
)
KINDS = ("revolute", "continuous", "prismatic", "fixed")


def numbers(values: object) -> str:
    """Return numbers for an attribute."""
    return " ".join(f"{value:.6f}" for value in np.atleast_1d(np.asarray(values, float)))


def cup(folder: Path) -> str:
    """Write the mesh of two bars with a gap between them, and return its geometry."""
    box = trimesh.creation.box((0.05, 0.4, 0.1))
    bars = [box.copy().apply_translation((x, 0.0, 0.0)) for x in (-0.15, 0.15)]
    trimesh.util.concatenate(bars).export(folder / "cup.obj")
    return f'<mesh filename="{folder}/cup.obj"/>'


def random_arm(
    rng: np.random.Generator, links: int, name: str = "arm", shapes: Sequence[str] = SHAPES
) -> str:
    """Return the URDF of a random tree of links with one to three random shapes each."""
    parts = [f'<robot name="{name}">']
    for link in range(links):
        bodies = []
        for _ in range(int(rng.integers(1, 4))):
            a, b, c = rng.uniform(0.03, 0.2, 3)
            shape = rng.choice(shapes).format(a=f"{a:.4f}", b=f"{b:.4f}", c=f"{c:.4f}")
            origin = f'xyz="{numbers(rng.normal(0, 0.1, 3))}" rpy="{numbers(rng.normal(0, 1, 3))}"'
            bodies.append(f"<collision><origin {origin}/><geometry>{shape}</geometry></collision>")
        parts.append(f'<link name="{name}_{link}">{"".join(bodies)}</link>')
    for link in range(1, links):
        kind = KINDS[0] if link == 1 else str(rng.choice(KINDS, p=(0.5, 0.2, 0.2, 0.1)))
        parent = int(rng.integers(max(0, link - 2), link))
        axis = rng.normal(size=3)
        parts.append(
            f'<joint name="{name}_j{link}" type="{kind}"><parent link="{name}_{parent}"/>'
            f'<child link="{name}_{link}"/><axis xyz="{numbers(axis / np.linalg.norm(axis))}"/>'
            f'<origin xyz="{numbers(rng.normal(0, 0.25, 3))}" '
            f'rpy="{numbers(rng.normal(0, 1, 3))}"/>'
            '<limit lower="-0.5" upper="0.8" velocity="1" effort="1"/></joint>'
        )
    return "".join([*parts, "</robot>"])


def random_world(rng: np.random.Generator, count: int) -> oc.Scene:
    """Return a scene of random shapes of all kinds around the origin."""
    scene = oc.Scene(accuracy="hull")
    for number in range(count):
        a, b, c = rng.uniform(0.05, 0.3, 3)
        shape = (
            oc.shapes.Box([a, b, c]),
            oc.shapes.Sphere(a),
            oc.shapes.Cylinder(a, c),
            oc.shapes.Capsule(a, c),
            oc.shapes.Hull(rng.normal(0, 0.15, (12, 3))),
        )[number % 5]
        pose = np.append(rng.normal(0, 0.5, 3), rng.normal(size=4))
        pose[3:] /= np.linalg.norm(pose[3:])
        scene.add(f"thing{number}", shape, pose)
    return scene


def arm_in_world(
    seed: int, links: int, things: int, accuracy: str = "hull"
) -> tuple[np.random.Generator, oc.Robot, oc.RobotScene]:
    """Return a random arm in a random world, and the generator of both."""
    rng = np.random.default_rng(seed)
    robot = oc.Robot.from_urdf(random_arm(rng, links))
    return rng, robot, oc.RobotScene([robot], random_world(rng, things), accuracy)


def random_states(rng: np.random.Generator, robot: oc.Robot, count: int) -> np.ndarray:
    """Return states within the limits, a turn where there are none."""
    low = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    high = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    return np.asarray(rng.uniform(low, high, (count, len(low))))


LIMIT = '<limit lower="-1" upper="2" velocity="3" effort="1"/>'


def urdf(*elements: str) -> str:
    """Return a robot of some elements, each on a line of its own: the first one on line 2."""
    return '<robot name="r">\n' + "\n".join(elements) + "\n</robot>"


def slider(geometry: str, axis: str = "1 0 0") -> str:
    """Return a robot ``r`` of one body that slides along an axis from the world."""
    way = f'<axis xyz="{axis}"/><limit lower="-9" upper="9" velocity="1" effort="1"/>'
    return urdf(
        link("world"), link("body", geometry), joint("x", "prismatic", "world", "body", way)
    )


def link(name: str, *geometries: str) -> str:
    """Return a link with collision geometries."""
    inner = "".join(f"<collision><geometry>{one}</geometry></collision>" for one in geometries)
    return f'<link name="{name}">{inner}</link>'


def joint(name: str, kind: str, parent: str, child: str, inner: str = LIMIT) -> str:
    """Return a joint."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inner}</joint>"
    )

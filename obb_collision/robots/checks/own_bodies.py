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

"""The bodies of links and of what is attached to them, those of a link in a row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from obb_collision.obb import OBB
from obb_collision.robots.bodies.bodies import enclosing_spheres, joined
from obb_collision.robots.bodies.robot_arrays import Attached, attached_body, link_bodies
from obb_collision.robots.bodies.state_arrays import Bodies
from obb_collision.robots.checks.mesh_bodies import MeshBodies
from obb_collision.robots.description.robot import Robot
from obb_collision.shapes import Shape
from obb_collision.typing import Floats, Integers, Rows


class OwnBodies(NamedTuple):
    """The bodies of links and what is attached, those of a link in a row; see ``Tests``."""

    bodies: Bodies
    owners: Rows
    links: Rows
    starts: Integers
    centers: Floats
    spheres: Floats


def own_bodies(
    robots: Sequence[Robot], grown: Floats, attached: Sequence[Attached], paddings: Floats,
    chains: Floats,
) -> OwnBodies:  # fmt: skip
    """Return the bodies of links grown by (links,), and those of what is attached.

    paddings (links,): of links, which count for what is attached; chains (links,): their lengths.
    """
    bodies, owners = link_bodies(robots, grown, chains)
    for row, each in enumerate(attached, start=len(grown)):
        bodies.append(attached_body(each, chains, float(paddings[each.link])))
        owners.append(row)
    order = np.argsort([body.frame for body in bodies], kind="stable")
    bodies = [bodies[n] for n in order]
    frames = np.array([body.frame for body in bodies], np.int64)
    links, starts = np.unique(frames, return_index=True)
    starts = np.append(starts, len(bodies)).astype(np.int64)
    return OwnBodies(
        joined(bodies), np.array(owners, np.int64)[order], links, starts,
        *enclosing_spheres(bodies, starts),
    )  # fmt: skip


def mesh_bodies(
    robots: Sequence[Robot], grown: Floats, attached: Sequence[Attached], paddings: Floats
) -> MeshBodies:
    """Return the same bodies as meshes, in the same order."""
    placed: list[tuple[Shape | OBB, Sequence[float], int, float]] = [
        (shape, pose, link, float(grown[link]))
        for link, each in enumerate(part for robot in robots for part in robot.shapes)
        for shape, pose in each
    ]
    for each in attached:
        padding = each.padding + float(paddings[each.link])
        placed.append((each.shape, each.pose.tolist(), each.link, padding))
    placed.sort(key=lambda one: one[2])
    frames = np.array([link for _, _, link, _ in placed], np.int64)
    amounts = np.array([padding for *_, padding in placed])
    poses = np.array([pose for _, pose, _, _ in placed]).reshape(-1, 7)
    return MeshBodies([shape for shape, *_ in placed], poses, frames, amounts)

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

"""Peers that look for points in spheres of a robot: crate capt in Rust, and SciPy's k-d tree.

They get 59 spheres that cover the hulls of links, already placed. capt computes in single
precision; cargo compiles it here.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.spatial import ConvexHull, cKDTree

from obb_collision.geometry.poses import as_poses
from obb_collision.robots.robot import Robot
from obb_collision.typing import Floats, Mask
from tools.clouds.room import points_of
from tools.peers.parry import build
from tools.robot_motions import least_times

#: Spheres of a robot; how many capt takes at once; points on each face that they cover.
SPHERES, GROUP, ON_FACES = 59, 8, 6


class Figures(NamedTuple):
    """Seconds of a peer; colliding: the share of states whose spheres meet a point."""

    name: str
    build: float
    state: float
    colliding: float


def spheres_of(robot: Robot) -> tuple[Floats, Floats, Floats]:
    """Return links (s,), centres (s, 3) in their frames and radii of spheres that cover a robot.

    Without its root, whose spheres would meet the desk in every state.

    The surface of each hull is cut into clusters, as many as it is long.
    """
    weights = np.random.default_rng(0).dirichlet((1.0, 1.0, 1.0), ON_FACES)
    weights = np.concatenate([np.eye(3), weights])
    parts = []
    for link, placed in enumerate(robot.shapes):
        for shape, pose in placed if robot.tree.parents[link] >= 0 else ():
            (position,), (turn,) = as_poses(np.asarray(pose)[None])
            hull = ConvexHull(points_of(shape))
            on_it = np.einsum("wk,fkj->wfj", weights, hull.points[hull.simplices]).reshape(-1, 3)
            parts.append((link, on_it @ turn.T + position))
    lengths = np.array([np.ptp(on_it, axis=0).max() for _, on_it in parts])
    ends = np.round(np.cumsum(lengths) / lengths.sum() * (SPHERES - len(parts))).astype(int)
    rows = []
    for (link, on_it), count in zip(parts, np.diff(ends, prepend=0) + 1, strict=True):
        _, labels = kmeans2(on_it, count, minit="++", seed=0)
        for some in (on_it[labels == k] for k in range(count)):
            center = 0.5 * (some.min(axis=0) + some.max(axis=0))
            rows.append((link, *center, np.linalg.norm(some - center, axis=1).max()))
    table = np.array(rows)
    return table[:, 0].astype(int), table[:, 1:4], table[:, 4]


def placed_spheres(robot: Robot, states: Floats) -> Floats:
    """Return the spheres (n, s, 4) of states (n, joints): centre and radius."""
    links, centers, radii = spheres_of(robot)
    poses = robot.link_poses(states)[:, links]
    positions, turns = as_poses(poses.reshape(-1, 7))
    turned = np.einsum("nij,nj->ni", turns, np.tile(centers, (len(states), 1)))
    places = (positions + turned).reshape(len(states), -1, 3)
    return np.concatenate([places, np.broadcast_to(radii[:, None], (*places.shape[:2], 1))], 2)


def measure_capt(points: Floats, spheres: Floats) -> list[Figures]:
    """Return the figures of capt, with one sphere at once and with eight; spheres (n, s, 4)."""
    count = spheres.shape[1]
    filled = np.concatenate([spheres, spheres[:, : -count % GROUP]], axis=1)
    with tempfile.TemporaryDirectory() as folder:
        program, path = build(Path(folder), "capt"), Path(folder) / "numbers"
        with path.open("wb") as file:
            file.write(np.array([len(points), len(spheres), count, filled.shape[1]], "<u8"))
            file.write(points.astype("<f4").tobytes())
            file.write(filled.astype("<f4").tobytes())
        found = json.loads(subprocess.check_output([program, path], text=True))
    return [
        Figures(
            f"crate capt, {name}", found["build"], found[key] / len(spheres), hits / len(spheres)
        )
        for key, name, hits in zip(
            ("one", "eight"), ("one sphere at once", "eight"), found["colliding"], strict=True
        )
    ]


def measure_scipy(points: Floats, spheres: Floats) -> Figures:
    """Return the figures of SciPy's tree: all spheres of a state in one call."""
    tree, radii = cKDTree(points), spheres[0, :, 3]

    def check() -> Mask:
        found = [
            tree.query(state[:, :3], distance_upper_bound=radii.max())[0] <= radii
            for state in spheres
        ]
        return np.asarray(np.array(found).any(axis=1))

    made, each = least_times([lambda: cKDTree(points), check])
    return Figures("SciPy's cKDTree", made, each / len(spheres), float(check().mean()))

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

"""A made room that sensors see: what is in it, rays that meet it, a cloud and a frame of it.

A robot stands at the origin, 2 cm above a desk, beside shelves and the hand of a person, in a room
of 3.5 by 3.6 by 2.9 m. All is made of convex solids, which rays meet by formulas of planes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from obb_collision.geometry.poses import as_poses
from obb_collision.robots.robot import Robot
from obb_collision.shapes import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from obb_collision.typing import Floats, Rows
from tools.peers.robots import vertices_of

#: Standard deviation of a measured range, metres.
NOISE = 0.001
#: Where the cameras of a mapper are, and the camera of the frame; what they look at, metres.
MAPPERS, EYE = ((1.8, -1.6, 1.6), (-1.3, 1.6, 1.4), (1.6, 1.6, 0.9)), (1.5, -1.2, 1.1)
AIM = (0.2, 0.0, 0.3)
#: Pixels and focal lengths in pixels: of each camera of the mapper, and of the frame.
MAPPER, FRAME = ((500, 500), 300.0), ((480, 640), 525.0)
#: The mapper keeps what is this near to the robot, metres.
NEAR = 1.25
#: Rays that meet a face at less than this cosine, and this share of all, give no range.
GRAZING, HOLES = 0.15, 0.05
#: Directions in which a round shape has a point.
ROUND = 400
#: Sizes and places of what is in the room, metres: its six sides, a desk, four shelves, a hand.
SIDES = [
    *(((0.1, 3.6, 2.9), (x, 0.0, 0.65)) for x in (-1.45, 2.15)),
    *(((3.5, 0.1, 2.9), (0.35, y, 0.65)) for y in (-1.85, 1.85)),
    *(((3.5, 3.6, 0.1), (0.35, 0.0, z)) for z in (-0.85, 2.15)),
]
FURNITURE = [
    ((1.4, 1.2, 0.04), (0.35, -0.1, -0.04)),
    *(((0.05, 0.05, 0.74), (0.35 + x, y, -0.43)) for x in (-0.6, 0.6) for y in (-0.6, 0.4)),
    *(((0.9, 0.3, 0.02), (0.2, 0.9, z)) for z in (0.0, 0.4, 0.8, 1.2)),
    *(((0.02, 0.3, 2.0), (x, 0.9, 0.2)) for x in (-0.26, 0.66)),
]
HAND = [
    ((0.3, 0.07, 0.06), (0.75, -0.5, 0.35)),
    ((0.11, 0.09, 0.03), (0.55, -0.5, 0.35)),
    *(((0.08, 0.017, 0.017), (0.455, -0.535 + 0.023 * k, 0.35)) for k in range(4)),
]


class Solid(NamedTuple):
    """A convex solid: its points have at most these offsets along the normals."""

    normals: Floats  #: (k, 3) unit, outwards
    offsets: Floats  #: (k,) metres

    def placed(self, pose: Floats) -> Solid:
        """Return the same at a pose (7,)."""
        (position,), (rotation,) = as_poses(np.asarray(pose)[None])
        normals = self.normals @ rotation.T
        return Solid(normals, self.offsets + normals @ position)

    def spans(self, origin: Floats, ways: Floats) -> tuple[Floats, Floats, Rows]:
        """Return where rays (n,) from one origin enter and leave, and the face of each entry.

        In multiples of their ways (n, 3); a ray that enters after it leaves misses.
        """
        speeds, ahead = ways @ self.normals.T, self.offsets - self.normals @ origin
        with np.errstate(divide="ignore", invalid="ignore"):
            at = ahead / speeds
        enters, leaves = np.where(speeds < 0.0, at, -np.inf), np.where(speeds > 0.0, at, np.inf)
        enters[(speeds == 0.0) & (ahead < 0.0)] = np.inf
        faces = enters.argmax(axis=1)
        return enters[np.arange(len(ways)), faces], leaves.min(axis=1), faces


class Seen(NamedTuple):
    """What rays (n,) meet first."""

    ranges: Floats  #: (n,) in multiples of their ways, infinite for nothing
    solids: Rows  #: (n,) -1 for nothing
    cosines: Floats  #: (n,) of the angle to the normal


def see(solids: Sequence[Solid], origin: Floats, ways: Floats) -> Seen:
    """Return what rays of ways (n, 3) from an origin (3,) outside of all solids meet first."""
    count = len(ways)
    found = Seen(np.full(count, np.inf), np.full(count, -1), np.ones(count))
    lengths = np.linalg.norm(ways, axis=1)
    for number, solid in enumerate(solids):
        enters, leaves, faces = solid.spans(origin, ways)
        rows = np.flatnonzero((enters <= leaves) & (enters > 0.0) & (enters < found.ranges))
        found.ranges[rows], found.solids[rows] = enters[rows], number
        along = np.einsum("ij,ij->i", ways[rows], solid.normals[faces[rows]])
        found.cosines[rows] = -along / lengths[rows]
    return found


def box_solid(size: Sequence[float], center: Sequence[float]) -> Solid:
    """Return a box along the axes."""
    half, normals = 0.5 * np.array(size), np.vstack([np.eye(3), -np.eye(3)])
    return Solid(normals, np.tile(half, 2) + normals @ np.array(center))


def room() -> list[Solid]:
    """Return what is in the room but for a robot."""
    return [box_solid(*one) for one in (*SIDES, *FURNITURE, *HAND)]


def points_of(shape: Shape) -> Floats:
    """Return points (n, 3) whose hull is a shape, or is in it and nearly as large."""
    if isinstance(shape, Mesh):
        return vertices_of(shape)
    if isinstance(shape, Box):
        signs = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3), -1).reshape(-1, 3)
        return np.asarray(signs * np.array(shape.size))
    if not isinstance(shape, (Sphere, Capsule, Cylinder)):
        raise NotImplementedError(type(shape).__name__)
    steps = np.arange(ROUND)
    heights, turns = (1.0 - 2.0 * (steps + 0.5) / ROUND), steps * np.pi * (3.0 - 5.0**0.5)
    heights *= not isinstance(shape, Cylinder)
    ring = np.sqrt(1.0 - heights**2)
    points = shape.radius * np.stack([ring * np.cos(turns), ring * np.sin(turns), heights], 1)
    up = np.array([0.0, 0.0, 0.5 * getattr(shape, "length", 0.0)])
    return np.concatenate([points + up, points - up])


def hull_of(points: Floats) -> Solid:
    """Return the hull of points (n, 3)."""
    planes = np.unique(ConvexHull(points).equations, axis=0)
    return Solid(planes[:, :3], -planes[:, 3])


def robot_hulls(robot: Robot) -> list[tuple[int, Solid]]:
    """Return the links and hulls of the shapes of a robot, in the frames of their links."""
    return [
        (link, hull_of(points_of(shape)).placed(np.asarray(pose)))
        for link, placed in enumerate(robot.shapes)
        for shape, pose in placed
    ]


def placed_hulls(robot: Robot, state: Floats) -> list[Solid]:
    """Return the hulls of the shapes of a robot in a state (joints,)."""
    poses = robot.link_poses(state)
    return [solid.placed(poses[link]) for link, solid in robot_hulls(robot)]


def camera_pose(eye: Floats) -> tuple[Floats, Floats]:
    """Return the origin (3,) and rotation (3, 3) of a camera: x right, y down, z ahead."""
    ahead = np.array(AIM) - eye
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    return np.array(eye), np.stack([right, np.cross(ahead, right), ahead], axis=1)


def pixel_rays(pixels: tuple[int, int], focal: float) -> Floats:
    """Return the ways (height * width, 3) of the pixels of a camera, a metre deep."""
    v, u = np.indices(pixels).reshape(2, -1) - (np.array(pixels)[:, None] - 1) / 2
    return np.stack([u / focal, v / focal, np.ones(len(u))], axis=1)


def room_points(count: int, seed: int, camera: tuple[tuple[int, int], float] = MAPPER) -> Floats:
    """Return points (count, 3) around the robot in float32, as a mapper with three cameras has."""
    rng, parts, ways = np.random.default_rng(seed), [], pixel_rays(*camera)
    for place in MAPPERS:
        eye, turn = camera_pose(np.array(place))
        there = ways @ turn.T
        ranges = see(room(), eye, there).ranges + rng.normal(0.0, NOISE, len(ways))
        parts.append(eye + ranges[:, None] * there)
    points = np.concatenate(parts)
    points = points[np.linalg.norm(points, axis=1) < NEAR]
    return points[rng.choice(len(points), count, replace=False)].astype(np.float32)


def depth_frame(
    robot: Robot, state: Floats, seed: int, camera: tuple[tuple[int, int], float] = FRAME
) -> tuple[Floats, Floats, Floats]:
    """Return an organised frame (height, width, 3) of the room with a robot, in float32.

    In the frame of its camera, with NaN where no range is measured; and the origin (3,) and
    rotation (3, 3) of the camera.
    """
    rng, ways = np.random.default_rng(seed), pixel_rays(*camera)
    eye, turn = camera_pose(np.array(EYE))
    seen = see([*room(), *placed_hulls(robot, state)], eye, ways @ turn.T)
    points = (seen.ranges + rng.normal(0.0, NOISE, len(ways)))[:, None] * ways
    points[(seen.cosines < GRAZING) | (rng.random(len(ways)) < HOLES)] = np.nan
    return points.reshape(*camera[0], 3).astype(np.float32), eye, turn

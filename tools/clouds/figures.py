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

"""The times of clouds: in a scene, from a frame, beside moving boxes, around a robot."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np

from obb_collision.benchmarks.measuring import Show
from obb_collision.geometry.poses import quaternions_from_matrices
from obb_collision.robots.robot import Robot
from obb_collision.robots.robot_scene import RobotScene
from obb_collision.scene.scene import Scene
from obb_collision.shapes import Box, Cloud
from obb_collision.typing import Floats
from tools.clouds.peers import measure_capt, measure_scipy, placed_spheres
from tools.clouds.room import FRAME, depth_frame, room_points
from tools.robot_motions import boxes_of, ends_of, free_states, least_times

#: Boxes that move in steps of this length, how many steps are timed, and their clearances, metres.
BOXES, STEP, STEPS, REACH = 100, 0.02, 20, 0.2
#: Length of motions, of which all that are free are timed, rad; padding of the self-filter, metres.
LENGTH, PADDING = 0.3, 0.02
#: Of the frame: range and voxel that the node cuts to, metres.
RANGE, VOXEL = 2.5, 0.01
#: Where a box lies in the points of the desk.
ON_DESK = (0.5, 0.0, -0.02, 0.0, 0.0, 0.0, 1.0)
#: Edge of cells of which one point stays, metres.
THIN = 0.012


class Row(NamedTuple):
    """A figure, what was seen, and what it may be at most (empty where nothing is said)."""

    figure: str
    seen: str
    most: str = ""


def thinned(points: Floats, edge: float) -> Floats:
    """Return the first point in each cell of a grid."""
    return points[np.unique(np.floor(points / edge), axis=0, return_index=True)[1]]


def cloud_rows(points: Floats, frame: Floats, camera: Floats) -> Iterator[Row]:
    """Measure a new cloud in a scene, up to the verdict of a box; camera (7,): of the frame."""
    rows, scenes = frame.reshape(-1, 3), {}
    for name, pose in (("room", None), ("frame", camera)):
        scenes[name] = Scene()
        scenes[name].add("box", Box((0.3, 0.3, 0.1)), ON_DESK)
        scenes[name].add("camera", Cloud(points), pose)

    def use(name: str, cloud: Cloud) -> None:
        scenes[name].set_shape("camera", cloud)
        if not len(scenes[name].check()):
            raise RuntimeError("the box does not touch the desk")

    of_room, of_frame = least_times([
        lambda: use("room", Cloud(points)),
        lambda: use("frame", Cloud(rows)),
    ])  # fmt: skip
    yield Row(f"{len(points):,} points to a cloud in a scene", f"{1e3 * of_room:.1f} ms", "15 ms")
    missing = f"{np.isnan(rows[:, 0]).mean():.0%}"
    what = f"frame of {len(rows):,} points, {missing} NaN, to a cloud in a scene"
    yield Row(what, f"{1e3 * of_frame:.1f} ms", "25 ms")
    if find_spec("rclpy") is None:
        return
    from obb_collision.node.inputs.cuts import Limits, select, thin_out

    def cut() -> None:
        near, _ = select(rows, Limits(0.0, RANGE))
        kept, moved = thin_out(near, VOXEL)
        use("frame", Cloud(near.take(kept, axis=0), moved))

    (time,) = least_times([cut])
    what = f"the same, cut to {RANGE} m and cells of {1e3 * VOXEL:g} mm as in the node"
    yield Row(what, f"{1e3 * time:.1f} ms", "25 ms")


def box_rows(points: Floats, seed: int) -> Iterator[Row]:
    """Measure moving boxes beside a cloud: verdicts, and clearances."""
    rng, scene = np.random.default_rng(seed), Scene()
    boxes = boxes_of(BOXES, rng)
    for one in boxes:
        scene.add(one.name, one.shape, one.pose)
    scene.add("camera", Cloud(points))
    scene.check_only([("camera", "*")])
    indices = np.array([scene.index(one.name) for one in boxes])
    poses, frames = np.array([one.pose for one in boxes]), []
    for _ in range(STEPS):
        poses = poses + np.pad(rng.normal(0.0, STEP, (BOXES, 3)), ((0, 0), (0, 4)))
        frames.append(poses)

    def step(*effects: str) -> None:
        for frame in frames:
            scene.move_indices(indices, frame)
            len(scene.check(*effects))

    scene.set_effect("clearance", "auto", max_distance=REACH)
    plain, near = least_times([step, lambda: step("clearance")])
    what = f"{BOXES} moving boxes against {len(points):,} points"
    yield Row(f"{what}: check", f"{1e3 * plain / STEPS:.2f} ms", "1 ms")
    yield Row(f"{what}: with clearances within {REACH} m", f"{1e3 * near / STEPS:.2f} ms", "3 ms")


def robot_rows(robot: Robot, points: Floats, count: int, seed: int) -> Iterator[Row]:
    """Measure free states among points, motions, and distances, beside peers."""
    rng, clouds = np.random.default_rng(seed), {"": points}
    clouds[f", a point per {1e3 * THIN:g} mm"] = thinned(points, THIN)
    for extra, some in clouds.items():
        scene = Scene()
        scene.add("camera", Cloud(some))
        checker = RobotScene([robot], scene)
        where = f"{len(some):,} points{extra}"
        states = free_states(checker, count, rng)
        ends = ends_of(robot, states, LENGTH, rng)
        free = checker.check_motions(states, ends).valid
        begins, ends = states[free], ends[free]
        state, motion, near = least_times([
            lambda c=checker, q=states: c.check(q),  # type: ignore[misc]
            lambda c=checker, a=begins, b=ends: c.check_motions(a, b),  # type: ignore[misc]
            lambda c=checker, q=states: c.distances(q, max_distance=REACH, jacobian=True),  # type: ignore[misc]
        ])  # fmt: skip
        us = f"{1e6 * state / len(states):.1f} us"
        in_states = f"{motion / len(begins) / state * len(states):.1f} states"
        limits = ("8 us", "8 states", "5 states") if not extra else ("", "", "")
        yield Row(f"{robot.name} state, hulls, among {where}, free", us, limits[0])
        yield Row(f"motion of {LENGTH} rad proved free", in_states, limits[1])
        yield Row(f"distances within {REACH} m, gradients", f"{near / state:.1f} states", limits[2])
        spheres = placed_spheres(robot, states)
        peers = measure_capt(some, spheres) if shutil.which("cargo") else []
        for peer in [*peers, measure_scipy(some, spheres)]:
            what = f"{peer.name}, {spheres.shape[1]} spheres, {peer.colliding:.0%} collide"
            seen = f"{1e6 * peer.state:.1f} us a state, built in {1e3 * peer.build:.0f} ms"
            yield Row(what, seen)


def filter_rows(robot: Robot, state: Floats, points: Floats, eye: Floats) -> Iterator[Row]:
    """Measure the self-filter of points (n, 3) in the frame of the robot."""
    checker = RobotScene([robot])
    own, hidden = least_times([
        lambda: checker.own_points(state, points, PADDING),
        lambda: checker.own_points(state, points, PADDING, eye),
    ])  # fmt: skip
    what = f"self-filter of {len(points):,} points with {1e2 * PADDING:g} cm padding"
    yield Row(what, f"{1e3 * own:.1f} ms", "33 ms")
    yield Row("the same with what is behind the robot", f"{1e3 * hidden:.1f} ms", "33 ms")


def resting(robot: Robot) -> Floats:
    """Return the middle of all limits, a turn of no angle for joints without."""
    return np.nan_to_num(0.5 * (robot.lower + robot.upper))


def measure(robot: Robot, count: int, states: int, seed: int, show: Show) -> list[Row]:
    """Measure all with that many points and states."""
    show("a room and a frame of it")
    points, state = room_points(count, seed), resting(robot)
    frame, eye, turn = depth_frame(robot, state, seed, FRAME)
    show("clouds in a scene")
    camera = np.concatenate([eye, *quaternions_from_matrices(turn[None])])
    rows = [*cloud_rows(points, frame, camera), *box_rows(points, seed)]
    show("a robot")
    rows += robot_rows(robot, points, states, seed)
    seen = frame.reshape(-1, 3) @ turn.T + eye
    return [*rows, *filter_rows(robot, state, seen, eye)]

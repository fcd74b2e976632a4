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

"""What stands and moves in the demo's warehouse, part by part.

Resting things touch exactly what they rest on: those heights are multiples of 1/64 m.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from obb_collision.geometry.shapes import Box, Cylinder, Ellipsoid, Shape, Sphere
from obb_collision.node.demo import shapes
from obb_collision.node.demo.motion import (
    Motion,
    Pose,
    around,
    attached,
    hovering,
    joint,
    pose,
    resting,
    shuttling,
    swinging,
    travelling,
)

Random = np.random.Generator
Color = tuple[float, float, float]

#: The whole warehouse; more objects than these fill a store behind it.
DEFAULT_OBJECTS = 52
#: With fewer there would be nothing to see; these hold every kind of shape.
MIN_OBJECTS = 12
#: A seed with much going on at the end of ten seconds.
DEFAULT_SEED = 94

CARD, WOOD, STEEL = (0.82, 0.70, 0.55), (0.86, 0.77, 0.62), (0.72, 0.75, 0.79)
BLUE, NAVY, WHITE = (0.45, 0.60, 0.80), (0.30, 0.37, 0.50), (0.93, 0.93, 0.94)
VIOLET, STONE = (0.66, 0.60, 0.80), (0.66, 0.64, 0.62)

#: Height of a vehicle's deck and of the conveyor's rollers.
DECK, BELT = 0.3125, 0.75
#: Gap under things that are near what carries them but shall be free of it.
CLEARANCE = 0.008


@dataclass(frozen=True)
class Item:
    """One object: name, shape, colour, and its pose as a function of time.

    channel: the topic that carries its motion, empty for what never moves; ``stretch`` gives the
    shape at a time for what changes its shape (channel ``objects``). opacity: below 1 only the box
    is drawn, as of a zone.
    """

    namespace: str
    id: int
    shape: Shape
    color: Color
    motion: Motion
    channel: str = ""
    stretch: Callable[[float], Shape] | None = None
    opacity: float = 1.0

    @property
    def name(self) -> str:
        """The name of the object everywhere: namespace/id."""
        return f"{self.namespace}/{self.id}"


def _vehicles(random: Random) -> Iterator[Item]:
    """Yield two vehicles with loads on their decks, one going round the pallets."""
    ring = travelling((-2.2, -1.55), (2.4, 1.95), 0.8, 1.0, random.uniform(0.0, 0.6))
    aisle = shuttling((-3.9, 0.72, 0.0), (1.2, 0.72, 0.0), 11.0, random.uniform(0.0, 0.4))
    for k, (motion, load) in enumerate(
        ((ring, Box((0.625, 0.5625, 0.5))), (aisle, Box((0.75, 0.5, 0.4375))))
    ):
        yield Item("agv", k, shapes.vehicle(1.0, 0.7, DECK), NAVY, motion, "object_poses")
        height = load.size[2] / 2
        rides = attached(motion, pose(0.0, 0.0, DECK + height))
        yield Item("load", k, load, CARD, rides, "object_poses")


def _conveyor(random: Random) -> Iterator[Item]:
    """Yield a roller conveyor with one parcel of every kind of shape."""
    yield Item("conveyor", 0, shapes.conveyor(4.4, 0.8, BELT), STEEL, resting(pose(3.3, -0.55, 0)))
    parcels: list[tuple[Shape, Color, float]] = [
        (Box((0.5, 0.4, 0.3)), CARD, 0.15),
        (Sphere(0.22), BLUE, 0.22),
        (Cylinder(0.2, 0.45), WHITE, 0.225),
        (Ellipsoid((0.3, 0.2, 0.16)), VIOLET, 0.16),
        (shapes.capsule(0.16, 0.3), WHITE, 0.16),
    ]
    for k, (shape, color, height) in enumerate(parcels):
        start = (1.15, -0.55, BELT + CLEARANCE + height)
        motion = shuttling(
            start, (5.45, -0.55, start[2]), 11.0, k / len(parcels), random.uniform(-0.6, 0.6), True
        )
        yield Item("parcel", k, shape, color, motion, "object_poses")


def _arm(random: Random) -> Iterator[Item]:
    """Yield a turning arm of stacked links that reaches over the conveyor."""
    phase = random.uniform(-0.2, 0.2)
    yield Item("arm", 0, Cylinder(0.22, 1.4), WHITE, resting(pose(3.2, 0.75, 0.7)))
    shoulder = joint(resting(pose(3.2, 0.75, 1.4)), 1.1, 7.0, phase, -np.pi / 2)
    elbow = joint(attached(shoulder, pose(0.8, 0.0, 0.17)), 1.3, 4.6, phase + 0.5)
    bodies: list[tuple[Shape, Color, Motion, Pose]] = [
        (Box((1.05, 0.24, 0.15)), BLUE, shoulder, pose(0.4, 0, 0.083)),
        (Box((0.85, 0.2, 0.13)), BLUE, elbow, pose(0.3, 0, 0.065)),
        (Cylinder(0.07, 0.32), STEEL, elbow, pose(0.62, 0, -0.167)),
        (Box((0.26, 0.3, 0.12)), NAVY, elbow, pose(0.62, 0, -0.395)),
    ]
    for k, (shape, color, frame, place) in enumerate(bodies, start=1):
        yield Item("arm", k, shape, color, attached(frame, place), "object_states")


def _flying(random: Random) -> Iterator[Item]:
    """Yield a drone, and a crane's swinging load: orientations about all axes."""
    motion = hovering((0.9, 0.9, 1.9), (1.4, 1.1, 0.45), 9.0, random.uniform(0.0, 1.0))
    yield Item("drone", 0, shapes.drone(), WHITE, motion, "object_transform")
    swing = swinging((-2.3, -1.5, 4.0), 0.5, 3.9, random.uniform(0.0, 1.0))
    hung = Box((0.7, 0.55, 0.5))
    hook, length = -2.45, 1.2
    rope = attached(swing, pose(0, 0, hook + length / 2))
    yield Item("crane", 0, Cylinder(0.03, length), STEEL, rope, "object_poses")
    load = attached(swing, pose(0, 0, hook - CLEARANCE - 0.25))
    yield Item("crane", 1, hung, CARD, load, "object_poses")


def _lift(random: Random) -> Iterator[Item]:
    """Yield a lift that changes its height, the drum on it, and a pipe in the drum's way."""

    def height(time: float) -> float:
        wave = 0.5 - 0.5 * np.cos(2 * np.pi * (time / 8.0 + phase))
        return float(np.round((0.25 + 0.75 * wave) * 64) / 64)

    phase, x, y = random.uniform(0.2, 0.3), 3.4, -2.35
    yield Item(
        "lift", 0, Box((0.9, 0.8, 0.25)), NAVY, lambda t: pose(x, y, height(t) / 2), "objects",
        lambda t: Box((0.9, 0.8, height(t))),
    )  # fmt: skip
    drum = Cylinder(0.3, 0.75)
    yield Item("drum", 0, drum, BLUE, lambda t: pose(x, y, height(t) + 0.375), "objects")
    quarter = pose(x + 0.15, y, 1.78, 0.0, np.pi / 2)
    yield Item("pipe", 0, Cylinder(0.08, 2.6), STEEL, resting(quarter))
    yield Item("post", 0, Cylinder(0.06, 1.68), STEEL, resting(pose(x + 0.15, -1.25, 0.84)))


def _rack(random: Random) -> Iterator[Item]:
    """Yield a rack of two bays and two levels."""
    left, bay, y, depth = -4.5, 2.3, 2.3, 0.9
    for k in range(3):
        frame = shapes.rack_frame(2.5, depth, 0.08)
        yield Item("frame", k, frame, BLUE, resting(pose(left + k * bay, y, 0)))
    for k in range(4):
        x, top = left + (k % 2 + 0.5) * bay, (0.95, 1.8)[k // 2]
        board = Box((bay - 0.1, depth, 0.05))
        yield Item("board", k, board, WOOD, resting(pose(x, y, top - 0.025)))


def _goods(random: Random) -> Iterator[Item]:
    """Yield what lies on the rack's levels and under them."""
    cubes = [Box(size) for size in ((0.6, 0.5, 0.5), (0.5, 0.55, 0.4), (0.55, 0.6, 0.45))]
    goods: list[tuple[str, Shape, Color, float, float, float]] = [
        ("crate", cubes[0], CARD, -3.57, 0.95, 0.25),
        ("crate", cubes[1], CARD, -3.05, 0.95, 0.2),
        ("jug", shapes.jug(), WHITE, -1.7, 0.95, 0.25),
        ("ball", Sphere(0.24), VIOLET, -0.7, 0.95, 0.24),
        ("tyre", shapes.tyre(), NAVY, -3.8, 1.8, 0.11),
        ("crate", cubes[2], CARD, -2.85, 1.8, 0.225),
        ("tank", shapes.capsule(0.22, 0.6), WHITE, -1.2, 1.8, 0.22),
        ("reel", shapes.reel(), WOOD, -3.4, 0.0, 0.32),
        ("barrel", Cylinder(0.28, 0.8), BLUE, -1.5, 0.0, 0.4),
        ("barrel", Cylinder(0.28, 0.8), BLUE, -0.75, 0.0, 0.4),
    ]
    seen: dict[str, int] = {}
    for name, shape, color, x, level, height in goods:
        number = seen[name] = seen.get(name, -1) + 1
        y, turn = 2.3 + random.uniform(-0.08, 0.08), random.uniform(-0.3, 0.3)
        place = pose(x, y, level + height + CLEARANCE, turn)
        yield Item(name, number, shape, color, resting(place))


def _pallets(random: Random) -> Iterator[Item]:
    """Yield two pallets of resting boxes that touch exactly, and what stands about on the floor."""
    box = Box((0.5625, 0.75, 0.5))
    for k, (x, y) in enumerate(((-3.25, -1.5), (-1.5, -1.625))):
        yield Item("pallet", k, shapes.pallet(), WOOD, resting(pose(x, y, 0)))
        for j, (dx, z) in enumerate(((-0.28125, 0.375), (0.28125, 0.375), (0.0, 0.875))[: 2 + k]):
            yield Item("box", 3 * k + j, box, CARD, resting(pose(x + dx, y, z)))
    for k, (x, y) in enumerate(((0.6, -2.9), (0.6, -0.4))):
        place = pose(x, y, CLEARANCE, random.uniform(-0.4, 0.4))
        yield Item("cone", k, shapes.traffic_cone(), VIOLET, resting(place))
    yield Item("rock", 0, shapes.rock(random, 0.8), STONE, resting(pose(1.9, -2.6, 0.33)))
    for k, (x, y) in enumerate(((4.7, 2.1), (5.4, 1.8), (5.0, 2.8))):
        yield Item("buoy", k, Ellipsoid((0.3, 0.3, 0.5)), WOOD, resting(pose(x, y, 0.5)))
    yield Item("bottle", 0, shapes.bottle(), STEEL, resting(pose(0.55, 2.35, CLEARANCE)))


def _store(random: Random) -> Iterator[Item]:
    """Yield any number of crates and balls in rows behind the rack, every third one going about."""
    columns, pitch = 24, 1.1
    for k in range(1_000_000):
        shape: Shape = Sphere(random.uniform(0.15, 0.4))
        if k % 2:
            shape = Box(random.uniform(0.2, 0.8, 3))
        x, y = (k % columns - columns / 2) * pitch, 4.5 + (k // columns) * pitch
        place = (x, y, random.uniform(0.5, 1.0))
        moves = k % 3 == 0
        motion = around(place, 0.5, random.uniform(4.0, 9.0)) if moves else resting(pose(*place))
        yield Item("store", k, shape, CARD, motion, "object_poses" if moves else "")


#: In the order in which a smaller number of objects takes them.
PARTS: tuple[Callable[[Random], Iterator[Item]], ...] = (
    _vehicles, _conveyor, _arm, _flying, _lift, _pallets, _rack, _goods, _store,
)  # fmt: skip

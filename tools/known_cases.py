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

"""Bugs that users of other libraries reported, as pairs with their exact answers.

The distances are those of exact arithmetic, rounded once: the tests compute them again with an
oracle that shares no code with the library.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from obb_collision.geometry.boxes import Boxes
from obb_collision.typing import Floats

#: Seed and number of the pairs of convex meshes in place of those of mujoco#3383.
SEED, HULLS = 7, 200


class PlacedBox(NamedTuple):
    """Centre (3,), rotation (3, 3) whose columns are the axes, half extents (3,)."""

    center: Floats
    rotation: Floats
    half_extents: Floats


#: A box, or the convex hull of corners (n, 3).
Body = PlacedBox | Floats


@dataclass(frozen=True)
class KnownBug:
    """A report: the pair it is about, or the closest one that can be stated exactly.

    report: its sentence; source: where the numbers are from; pairs: boxes or hulls. distances
    (metres): the exact one of each pair, negative for the depth of those that overlap; if they are
    ``least``, the exact one is at least that. tolerance (metres): what may be wrong with it.
    """

    name: str
    url: str
    report: str
    source: str
    pairs: tuple[tuple[Body, Body], ...] = ()
    distances: tuple[float, ...] = ()
    tolerance: float = 1e-6
    least: bool = False


def placed(center: list[float], rows: object, sizes: list[float]) -> PlacedBox:
    """Return the box of edge lengths ``sizes`` as the library stores it."""
    boxes = Boxes([center], np.array([rows], np.float64), 0.5 * np.array([sizes]))
    return PlacedBox(boxes.centers[0], boxes.rotations[0], boxes.half_extents[0])


def _turned(angle: float) -> Floats:
    """Return the rotation by an angle about z (rad)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


STRAIGHT = np.eye(3)
THIN = (
    placed(
        [2.821825771308448e-05, -0.013292121195706197, 0.02925607203779027],
        [
            [0.999984277481925, -0.002299445579784584, 0.005114424598973962],
            [0.005607461311880932, 0.4156025484078403, -0.9095290419412373],
            [-3.415536179583994e-05, 0.9095434207925067, 0.4156089081413883],
        ],
        [0.094, 0.064, 0.0007],
    ),
    placed(
        [-5.352194487262811e-05, 0.01427117523229726, 0.029254416229696868],
        [
            [0.9999995654965241, 0.0003998777453206644, 0.0008420834589797611],
            [-0.0009321048184122195, 0.41564819056887203, 0.909524992981188],
            [1.3688337473195908e-05, -0.9095253826994668, 0.4156483826962617],
        ],
        [0.094, 0.064, 0.0007],
    ),
)
#: As the report says: equal boxes, 71 wide, flush, a corner 0.056 deep (units as given: mm).
FLUSH = (
    placed([0.0, 0.0, 0.0], STRAIGHT, [120.0, 71.0, 40.0]),
    placed([0.0, 71.004, 0.0], _turned(0.001), [120.0, 71.0, 40.0]),
)
TABLE = (
    placed(
        [1.10164554, -0.11389316, 0.74],
        [
            [-0.7573562222849164, 0.6530019544888981, 0.0],
            [-0.6530019544888981, -0.7573562222849164, 0.0],
            [0.0, 0.0, 1.0],
        ],
        [1.3, 0.96, 0.08],
    ),
    placed([1.4, 0.0, 1.425], STRAIGHT, [0.2, 2.4, 2.8]),
)
STACK = (
    placed([0.0, 0.0, 0.19972974], STRAIGHT, [0.4, 0.4, 0.4]),
    placed([0.0, 0.0, 0.49947918], STRAIGHT, [0.2, 0.2, 0.2]),
)
TILTED_493 = [
    [0.96193976625564348026, 0.15401279915737359216, 0.22572537250328919556],
    [-0.19134171618254486313, 0.96936494951283913579, 0.15401279915737359216],
    [-0.19509032201612822033, -0.19134171618254486313, 0.96193976625564348026],
]
KISSING = (
    placed(
        [2.0770063995786869349, 0.48468247475641951239, 1.1543291419087275962],
        TILTED_493,
        [0.5] * 3,
    ),
    placed([2.0, 0.0, 1.25], TILTED_493, [0.5] * 3),
)
TILTED_495 = [
    [0.94096063217417758029, 0.29296840037289501035, 0.16959541586174811667],
    [-0.23569836841299879326, 0.92661523595848427348, -0.29296840037289506586],
    [-0.2429801799032638987, 0.23569836841299884878, 0.94096063217417758029],
]
APART = (
    placed(
        [0.073242100093223821977, 0.2316538089896212349, 1.3089245921032497399],
        TILTED_495,
        [0.25] * 3,
    ),
    placed([0.0, 0.0, 1.25], TILTED_495, [0.25] * 3),
)
NEAR = (
    placed(
        [1.503354966, -0.8531707835, 0.7700092418],
        [
            [0.9999195703, 0.01021849413, 0.007512347878],
            [-0.01021878248, 0.9999477869, -3.329855922e-17],
            [-0.007511955635, -7.676704888e-05, 0.9999717819],
        ],
        [0.363, 0.277, 0.363],
    ),
    placed(
        [1.48838308, -1.102020834, 0.4497073799],
        [
            [0.9998670967, -0.01297708324, 0.009868343982],
            [0.01297771517, 0.9999157859, 5.255670031e-17],
            [-0.009867512928, 0.0001280685574, 0.9999513067],
        ],
        [0.363, 0.363, 0.277],
    ),
)
CUBE = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
SHIFTED = CUBE + np.array([1.5, 0.25, 0.125])
CUBES = (
    0.1 * CUBE,
    np.array(
        [
            [0.0794482, -0.00830481, -0.149648],
            [0.173392, 0.0137847, -0.123445],
            [0.0814828, -0.164745, -0.025059],
            [0.175427, -0.142656, 0.00114352],
            [-0.0233202, 0.166461, 0.071476],
            [0.0706238, 0.18855, 0.0976785],
            [-0.0212856, 0.0100205, 0.196065],
            [0.0726585, 0.03211, 0.222267],
        ]
    ),
)


def _random_hulls() -> tuple[tuple[tuple[Floats, Floats], ...], tuple[float, ...]]:
    """Return pairs of convex bodies that planes separate, and by how much at least (m).

    Corners are whole millimetres, and the planes are normal to x, so that both are exact.
    """
    rng = np.random.default_rng(SEED)
    pairs, gaps = [], []
    for _ in range(HULLS):
        a, b = (np.round(rng.uniform(-0.2, 0.2, (16, 3)), 3) for _ in range(2))
        b[:, 0] = np.round(b[:, 0] + rng.uniform(0.45, 0.8), 3)
        a, b = a[ConvexHull(a).vertices], b[ConvexHull(b).vertices]
        pairs.append((a, b))
        gaps.append(float(b[:, 0].min() - a[:, 0].max()))
    return tuple(pairs), tuple(gaps)


_HULLS, _GAPS = _random_hulls()
GITHUB = "https://github.com"
MUJOCO, FCL = f"{GITHUB}/google-deepmind/mujoco", f"{GITHUB}/flexible-collision-library/fcl"
COAL = f"{GITHUB}/coal-library/coal"
AS_REPORTED = "The numbers of the report."

KNOWN_BUGS = (
    KnownBug(
        "mujoco#3476",
        f"{MUJOCO}/issues/3476",
        "A contact as deep as a whole box, between boxes that rest flush on each other.",
        "The thin plates of the test that came with its repair (commit 8655446f), and two boxes "
        "made by the description; the poses of the report were not at hand.",
        (THIN, FLUSH),
        (1.9349042691488285e-05, -0.05598224000147506),
    ),
    KnownBug(
        "mujoco#1800",
        f"{MUJOCO}/issues/1800",
        "No contact between two boxes that overlap deeply.",
        AS_REPORTED,
        (TABLE,),
        (-0.6073680226398669,),
    ),
    KnownBug(
        "mujoco#3383",
        f"{MUJOCO}/issues/3383",
        "Distance exactly 0 for convex meshes that are clearly apart.",
        f"{HULLS} pairs of random convex meshes, each with a plane that proves a least distance: "
        "the script of the report draws its own.",
        _HULLS,
        _GAPS,
        least=True,
    ),
    KnownBug(
        "mujoco_warp#1526",
        f"{GITHUB}/google-deepmind/mujoco_warp/issues/1526",
        "A contact of stacked boxes is dropped at 0.25 mm depth.",
        "The state of the report. MuJoCo Warp is not among the peers.",
        (STACK,),
        (-0.000250559999999983,),
    ),
    KnownBug(
        "fcl#493",
        f"{FCL}/issues/493",
        "An exception for the signed distance of equal tilted cubes that touch face to face.",
        f"{AS_REPORTED} As stored they overlap by 4e-17.",
        (KISSING,),
        (-3.774779431868089e-17,),
    ),
    KnownBug(
        "fcl#495",
        f"{FCL}/issues/495",
        "The same where the cubes are apart by a rounding: one half of the algorithm says "
        "touching, the other separate.",
        f"{AS_REPORTED} As stored they are 2e-16 apart.",
        (APART,),
        (1.811831458502539e-16,),
    ),
    KnownBug(
        "coal#604",
        f"{COAL}/issues/604",
        "A wrong distance of two boxes that are very near, at a tolerance of 1e-6.",
        f"{AS_REPORTED} The rotations, given to ten digits, are made orthonormal.",
        (NEAR,),
        (3.5754502108607955e-06,),
    ),
    KnownBug(
        "coal#636",
        f"{COAL}/issues/636",
        "Not known: the thread was not at hand.",
        "Nothing is tried, and nothing claimed.",
    ),
    KnownBug(
        "coal#823",
        f"{COAL}/issues/823",
        "Wrong closest points of convex meshes that penetrate.",
        "Two cubes as convex meshes, of which the depth is exact; the report has the meshes of a "
        "robot, without their files.",
        ((CUBE, SHIFTED),),
        (-0.5,),
    ),
    KnownBug(
        "openGJK#13",
        f"{GITHUB}/MattiaMontanari/openGJK/issues/13",
        "Cubes that penetrate are apart by centimetres.",
        "The corners in commit 981540a, made from the report; its maintainer found no bug in them. "
        "openGJK is not among the peers.",
        (CUBES,),
        (float("nan"),),
    ),
)

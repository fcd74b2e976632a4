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

"""Distances and depths of other libraries beside the effects on every level, on the same pairs.

The peers are asked one by one from Python, with shapes, transforms and requests made beforehand,
and have no times of impact of shapes that can be compared. One that is not installed is left out.

    python -m tools.peers.effects [--pairs N] [--seconds S] [--meshes FOLDER] [--json FILE]
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from obb_collision.benchmarks.accuracy import EFFECT_PAIRS, effect_table
from obb_collision.benchmarks.contest import coal_hull, coal_mesh, fcl_hull, fcl_mesh
from obb_collision.benchmarks.corpora import file_corpus, generated_corpus
from obb_collision.benchmarks.effects import Peers, PlacedPairs, measure_effects
from obb_collision.benchmarks.measuring import as_text
from obb_collision.cli import SEED, Parser, interruptible, mesh_folder, option, real, whole
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.shapes import Shape
from obb_collision.typing import Floats

Ask = Callable[[], Floats]
Make = Callable[[Any, Shape], Any]
#: Metres beyond which MuJoCo need not search.
FARTHEST = 3.0


def coal_distances(make: Make, coal: Any, query: PlacedPairs) -> Ask:
    """Return a function that asks coal for distances with closest points; negative: depths."""
    made = [make(coal, shape) for shape in query.shapes]
    places = list(map(coal.Transform3s, query.rotations, query.centers))
    calls = [
        (made[r], places[i], made[s], places[j])
        for (i, j), (r, s) in zip(query.pairs, query.rows, strict=True)
    ]
    request, result = coal.DistanceRequest(True), coal.DistanceResult()

    def distance(call: tuple[Any, ...]) -> float:
        result.clear()
        return float(coal.distance(*call, request, result))

    return lambda: np.array(list(map(distance, calls)))


def fcl_distances(make: Make, fcl: Any, query: PlacedPairs) -> Ask:
    """Return a function that asks python-fcl for distances with closest points."""
    objects = _fcl_objects(fcl, make, query)
    request = fcl.DistanceRequest(enable_nearest_points=True)
    return lambda: np.array(
        [fcl.distance(*both, request, fcl.DistanceResult()) for both in objects]
    )


def fcl_depths(fcl: Any, query: PlacedPairs) -> Ask:
    """Return a function that asks python-fcl for contacts of hulls."""
    objects = _fcl_objects(fcl, fcl_hull, query)
    request = fcl.CollisionRequest(num_max_contacts=4, enable_contact=True)

    def depth(both: tuple[Any, Any]) -> float:
        result = fcl.CollisionResult()
        fcl.collide(*both, request, result)
        return max((contact.penetration_depth for contact in result.contacts), default=0.0)

    return lambda: np.array(list(map(depth, objects)))


def _fcl_objects(fcl: Any, make: Make, query: PlacedPairs) -> list[tuple[Any, Any]]:
    made = [make(fcl, shape) for shape in query.shapes]

    def placed(row: int, body: int) -> Any:
        where = fcl.Transform(query.rotations[body], query.centers[body])
        return fcl.CollisionObject(made[row], where)

    return [
        (placed(r, i), placed(s, j)) for (i, j), (r, s) in zip(query.pairs, query.rows, strict=True)
    ]


def mujoco_distances(mujoco: Any, query: PlacedPairs) -> Ask:
    """Return a function that asks MuJoCo for distances of hulls, negative in overlap."""
    spec = mujoco.MjSpec()
    for row, shape in enumerate(query.shapes):
        assert isinstance(shape, Mesh)
        spec.add_mesh(
            name=f"{row}", uservert=shape.vertices.ravel(), userface=shape.faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )  # fmt: skip
        for end in "ab":
            body = spec.worldbody.add_body(name=f"{row}{end}")
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{row}", name=f"{row}{end}")
    model = spec.compile()
    data = mujoco.MjData(model)
    calls = []
    for (i, j), (r, s) in zip(query.pairs.tolist(), query.rows.tolist(), strict=True):
        ends = []
        for row, body, end in ((r, i, "a"), (s, j, "b")):
            geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, f"{row}{end}")
            mesh = model.geom_dataid[geom]
            turn = Rotation.from_quat(np.roll(model.mesh_quat[mesh], -1)).as_matrix()
            rotation = query.rotations[body]
            center = query.centers[body] + rotation @ model.mesh_pos[mesh]
            ends.append((geom, center, (rotation @ turn).ravel()))
        calls.append(ends)

    def run() -> Floats:
        values, segment = [], np.zeros((6, 1))
        places, turns = data.geom_xpos, data.geom_xmat
        for (a, p, m), (b, q, n) in calls:
            places[a], turns[a], places[b], turns[b] = p, m, q, n
            values.append(mujoco.mj_geomDistance(model, data, a, b, FARTHEST, segment))
        return np.array(values)

    return run


def depths(distances: Callable[[Any, PlacedPairs], Ask], module: Any, query: PlacedPairs) -> Ask:
    """Return a function that asks for depths, which are negative distances."""
    ask = distances(module, query)
    return lambda: -ask()


#: By effect and by what stands for a shape: the module, and how it is asked.
ASKED: dict[str, dict[str, tuple[str, Callable[[Any, PlacedPairs], Ask]]]] = {
    "clearance": {
        "coal hull": ("coal", partial(coal_distances, coal_hull)),
        "coal mesh": ("coal", partial(coal_distances, coal_mesh)),
        "python-fcl hull": ("fcl", partial(fcl_distances, fcl_hull)),
        "python-fcl mesh": ("fcl", partial(fcl_distances, fcl_mesh)),
        "MuJoCo hull": ("mujoco", mujoco_distances),
    },
    "contacts": {
        "coal hull": ("coal", partial(depths, partial(coal_distances, coal_hull))),
        "python-fcl hull": ("fcl", fcl_depths),
        "MuJoCo hull": ("mujoco", partial(depths, mujoco_distances)),
    },
}


def installed(effect: str, query: PlacedPairs) -> Peers:
    """Return the installed peers of an effect."""
    found: dict[str, Ask] = {}
    for label, (module, ask) in ASKED.get(effect, {}).items():
        if importlib.util.find_spec(module):
            found[label] = ask(importlib.import_module(module), query)
    return found


@interruptible("python -m tools.peers.effects")
def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table of the effects on each level and of the peers."""
    parser = Parser(prog="python -m tools.peers.effects", description="effects beside peers")
    option(parser, "--pairs", whole(1, 10**6), EFFECT_PAIRS, "pairs per effect")
    option(parser, "--meshes", mesh_folder, text="folder of mesh files to measure on instead")
    option(parser, "--seconds", real(0.001, 1e6), 60.0, "approximate time (s)")
    option(parser, "--seed", SEED, 0, "seed of the random poses")
    options = parser.parse_args(arguments)
    corpus = generated_corpus(options.seed)
    if options.meshes:
        corpus = file_corpus(options.meshes, 0.2 * options.seconds)
    show = partial(print, file=sys.stderr)
    rows = measure_effects(corpus, options.pairs, options.seconds, options.seed, show, installed)
    print(as_text(effect_table(rows)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

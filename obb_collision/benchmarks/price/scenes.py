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

"""The corpora on which accuracy is measured: boxes, meshes that trimesh makes, real meshes.

All shapes are scaled to a bounding box with a diagonal of one metre, so that a corpus is about
shapes and not about sizes, and thrown at random poses into a room.
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from obb_collision.benchmarks.price.generated import make_meshes
from obb_collision.geometry.fitting.convex_hull import hull_volume
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.shapes import Box
from obb_collision.typing import Floats

#: Full edges of the boxes of corpus (a) before scaling, metres.
EDGES = (0.1, 1.0)
#: Real meshes have this many triangles: fewer are boxes or signs, more take their time to read.
REAL_FACES = (100, 25_000)
#: Sizes of files that are read, bytes: as many triangles need.
REAL_BYTES = (5_000, 3_000_000)
#: At most this many real meshes of each package.
REAL_MESHES = 20
#: Below this volume, cubic metres at one metre of diagonal, a shape is flat: no volume to compare.
LEAST_VOLUME = 1e-6

#: Distributions with real meshes, and the folder of them in each.
SOURCES = {"example-robot-data": "robots", "pybullet": "pybullet_data"}


@dataclass(frozen=True, eq=False)
class Corpus:
    """Shapes by name, and a note about their origin."""

    name: str
    shapes: dict[str, Mesh | Box]
    note: str = ""

    @property
    def boxes_only(self) -> bool:
        """Whether all shapes are boxes, which have no level above ``obb``."""
        return all(isinstance(shape, Box) for shape in self.shapes.values())


def box_corpus(count: int, seed: int) -> Corpus:
    """Return ``count`` boxes with random edges."""
    edges = np.random.default_rng(seed).uniform(*EDGES, (count, 3))
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    return Corpus("boxes", {f"box {k}": Box(edge) for k, edge in enumerate(edges)})


def generated_corpus(seed: int) -> Corpus:
    """Return meshes of many kinds that trimesh makes: convex, hollow, bent, in parts, open."""
    made = make_meshes(np.random.default_rng(seed))
    shapes = {name: _unit(mesh.vertices, mesh.faces) for name, mesh in made.items()}
    return Corpus("generated meshes", dict(shapes))


def real_corpus(seconds: float, limit: int = REAL_MESHES) -> Corpus:
    """Return meshes of robots and things of daily use, as many as are read in ``seconds``.

    They come in turn from every robot of every package installed, the same ones each time.
    """
    shapes: dict[str, Mesh | Box] = {}
    notes = []
    end = perf_counter() + seconds
    sources = {name: list(_real_files(name, folder)) for name, folder in SOURCES.items()}
    counts = dict.fromkeys(sources, 0)
    for row in zip_longest(*sources.values()):
        for source, file in zip(sources, row, strict=True):
            if file is None or counts[source] >= limit or (shapes and perf_counter() > end):
                continue
            mesh = _read(file)
            if mesh is not None:
                shapes[f"{file.parent.name}/{file.name}"] = mesh
                counts[source] += 1
    for source in sources:
        found = f"{counts[source]} of {source}"
        notes.append(found if sources[source] else f"{source} is not installed")
    return Corpus("real meshes", shapes, ", ".join(notes))


def _real_files(distribution: str, folder: str) -> Iterator[Path]:
    """Yield mesh files of a distribution: one of each robot, then a second one, and so on."""
    try:
        files = importlib.metadata.files(distribution) or []
    except importlib.metadata.PackageNotFoundError:
        return
    by_robot: dict[str, list[tuple[int, Path]]] = {}
    for file in files:
        if folder in file.parts[:-1] and file.suffix.lower() in (".stl", ".obj"):
            path = Path(str(file.locate()))
            size = path.stat().st_size if path.is_file() else 0
            if REAL_BYTES[0] <= size <= REAL_BYTES[1]:
                robot = file.parts[file.parts.index(folder) + 1]
                by_robot.setdefault(robot, []).append((size, path))
    robots = [_from_the_middle(sorted(by_robot[robot])) for robot in sorted(by_robot)]
    for row in zip_longest(*robots):
        yield from (path for path in row if path is not None)


def _from_the_middle(files: list[tuple[int, Path]]) -> list[Path]:
    """Return the files of one robot, those of middle size first."""
    order = sorted(range(len(files)), key=lambda k: abs(2 * k - len(files) + 1))
    return [files[k][1] for k in order]


def _read(file: Path) -> Mesh | None:
    """Return the mesh of a file at unit size; None if it is not one to measure with."""
    try:
        mesh = Mesh.from_file(file)
    except ValueError:
        return None
    if not REAL_FACES[0] <= len(mesh.faces) <= REAL_FACES[1]:
        return None
    mesh = _unit(mesh.vertices, mesh.faces)
    return mesh if hull_volume(np.unique(mesh.vertices, axis=0)) > LEAST_VOLUME else None


def _unit(vertices: Floats, faces: Any) -> Mesh:
    """Return the mesh about the middle of its bounding box, whose diagonal becomes one metre."""
    used = np.asarray(vertices)[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    return Mesh((vertices - 0.5 * (low + high)) / np.linalg.norm(high - low), np.asarray(faces))


def random_poses(count: int, volume: float, rng: np.random.Generator) -> Floats:
    """Return poses (n, 7) in a cube with ``volume`` cubic metres per body."""
    half = 0.5 * (volume * count) ** (1 / 3)
    centers = rng.uniform(-half, half, (count, 3))
    turns = rng.normal(size=(count, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return np.concatenate([centers, turns], axis=1)

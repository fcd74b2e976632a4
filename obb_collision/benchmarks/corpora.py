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

"""The corpora on which accuracy is measured: boxes, meshes that trimesh makes, meshes of files.

All shapes are scaled to a bounding box with a diagonal of one metre, so that a corpus is about
shapes and not about sizes, and thrown at random poses into a room.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from trimesh import creation, util
from trimesh.convex import convex_hull

from obb_collision.cli import mesh_files
from obb_collision.geometry.fitting.convex_hull import hull_volume
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.shapes import Box
from obb_collision.typing import Floats

#: Full edges of the boxes of corpus (a) before scaling, metres.
BOX_EDGES = (0.1, 1.0)
#: Meshes of files have this many triangles: fewer are boxes or signs, more take their time to read.
FILE_FACES = (100, 25_000)
#: Below this volume, cubic metres at one metre of diagonal, a shape is flat: no volume to compare.
LEAST_VOLUME = 1e-6


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
    edges = np.random.default_rng(seed).uniform(*BOX_EDGES, (count, 3))
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    return Corpus("boxes", {f"box {k}": Box(edge) for k, edge in enumerate(edges)})


def generated_corpus(seed: int) -> Corpus:
    """Return meshes of many kinds that trimesh makes: convex, hollow, bent, in parts, open."""
    made = make_meshes(np.random.default_rng(seed))
    shapes = {name: _unit(mesh.vertices, mesh.faces) for name, mesh in made.items()}
    return Corpus("generated meshes", dict(shapes))


def file_corpus(folder: Path, seconds: float) -> Corpus:
    """Return random meshes of a folder and its subfolders, as many as are read in ``seconds``."""
    files = sorted(mesh_files(folder))
    shapes: dict[str, Mesh | Box] = {}
    end = perf_counter() + seconds
    for k in np.random.default_rng(0).permutation(len(files)).tolist():
        if shapes and perf_counter() > end:
            break
        mesh = _read(files[k])
        if mesh is not None:
            shapes[str(files[k].relative_to(folder))] = mesh
    return Corpus("meshes of files", shapes, f"{len(files)} files in {folder}")


def _read(file: Path) -> Mesh | None:
    """Return the mesh of a file at unit size; None if it is not suitable."""
    try:
        mesh = Mesh.from_file(file)
    except ValueError:
        return None
    if not FILE_FACES[0] <= len(mesh.faces) <= FILE_FACES[1]:
        return None
    mesh = _unit(mesh.vertices, mesh.faces)
    return mesh if hull_volume(np.unique(mesh.vertices, axis=0)) > LEAST_VOLUME else None


def _unit(vertices: Floats, faces: Any) -> Mesh:
    """Return the mesh about the middle of its bounding box, whose diagonal becomes one metre."""
    used = np.asarray(vertices)[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    return Mesh((vertices - 0.5 * (low + high)) / np.linalg.norm(high - low), np.asarray(faces))


def make_meshes(rng: np.random.Generator) -> dict[str, Any]:
    """Return meshes of trimesh by name, of any size."""
    ball = creation.icosphere(subdivisions=3)
    bumpy, bowl, sheet = ball.copy(), ball.copy(), creation.box((1.0, 1.0, 0.02))
    bumpy.vertices *= 1.0 + 0.25 * np.sin(5.0 * bumpy.vertices).sum(axis=1, keepdims=True) / 3.0
    bowl.update_faces(bowl.triangles_center[:, 2] < 0.2)
    for _ in range(4):
        sheet = sheet.subdivide()
    waves = np.sin(5.0 * sheet.vertices[:, 0]) * np.cos(4.0 * sheet.vertices[:, 1])
    sheet.vertices[:, 2] += 0.15 * waves
    needle, chip = rng.normal(size=(2, 60, 3)) * [[[0.1, 0.1, 1.0]], [[1.0, 0.8, 0.1]]]
    return {
        "box": creation.box((1.0, 0.7, 0.4)),
        "plate": creation.box((1.0, 0.8, 0.05)),
        "icosahedron": creation.icosahedron(),
        "ball": ball,
        "globe": creation.uv_sphere(count=[24, 24]),
        "cylinder": creation.cylinder(0.4, 1.0, sections=32),
        "rod": creation.cylinder(0.04, 1.0, sections=16),
        "cone": creation.cone(0.5, 1.0, sections=32),
        "capsule": creation.capsule(1.0, 0.3, count=[16, 16]),
        "tube": creation.annulus(0.35, 0.4, 0.8, sections=48),
        "washer": creation.annulus(0.2, 0.6, 0.05, sections=48),
        "ring": creation.torus(0.7, 0.08, 48, 16),
        "torus": creation.torus(0.6, 0.3, 48, 24),
        **_turned_meshes(),
        "needle": convex_hull(needle),
        "chip": convex_hull(chip),
        "bumpy ball": bumpy,
        "open bowl": bowl,
        "wavy sheet": sheet,
        **_joined_meshes(),
        "spring": _spring(),
        "axes": creation.axis(origin_size=0.1, axis_length=1.0),
    }


def _turned_meshes() -> dict[str, Any]:
    """Return profiles (radius, height) turned about z."""
    lower = np.array([[1, -1], [2, -1], [2, -0.3], [6, -0.3], [6, -1.5], [7, -1.5]])
    profiles = {
        "goblet": [[0, 0], [5, 0], [1, 1], [1, 5], [4, 7], [5, 11], [4.6, 11], [0, 7]],
        "hourglass": [[0, 0], [4, 0], [4, 1], [0.6, 5], [4, 9], [4, 10], [0, 10]],
        "wheel": np.concatenate([lower, lower[::-1] * [1, -1], lower[:1]]),
    }
    return {
        name: creation.revolve(np.array(profile, float), sections=32)
        for name, profile in profiles.items()
    }


def _joined_meshes() -> dict[str, Any]:
    """Return boxes, each its centre and edges, and other meshes in one."""
    legs = [[x, y, 2.5, 0.6, 0.6, 5] for x in (-4, 4) for y in (-3, 3)]
    boxes: dict[str, list[list[float]]] = {
        "bracket": [[0, 0, 0, 10, 3, 1], [-4.5, 0, 4, 1, 3, 8]],
        "table": [[0, 0, 5, 10, 8, 0.5], *legs],
        "stairs": [[k, 0, 0.5 * k, 1.2, 4, 0.6] for k in range(8)],
        "jack": [[0, 0, 0, 10, 1, 1], [0, 0, 0, 1, 10, 1], [0, 0, 0, 1, 1, 10]],
    }
    joined = {
        name: util.concatenate([creation.box(r[3:]).apply_translation(r[:3]) for r in rows])
        for name, rows in boxes.items()
    }
    knobs = [creation.icosphere(2, radius=2.0).apply_translation([0, 0, z]) for z in (-4.0, 4.0)]
    return joined | {
        "dumbbell": util.concatenate([knobs[0], creation.cylinder(0.5, 8.0), knobs[1]])
    }


def _spring() -> Any:
    """Bend a long thin torus of trimesh into a spring of three turns, its ends a gap apart."""
    coil = creation.torus(1.0, 0.08, major_sections=120, minor_sections=8)
    x, y, z = coil.vertices.T
    along = np.arctan2(y, x)  # one turn becomes three there and three back, a little wider
    radius = np.hypot(x, y) + 0.25 * np.where(along < 0.0, 1.0, -1.0) * np.minimum(
        1.0, 4.0 * np.abs(np.sin(along))
    )
    turn, height = 6.0 * np.abs(along), z + 0.5 * np.abs(along)
    coil.vertices = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
    return coil


def random_poses(count: int, volume: float, rng: np.random.Generator) -> Floats:
    """Return poses (n, 7) in a cube with ``volume`` cubic metres per body."""
    half = 0.5 * (volume * count) ** (1 / 3)
    centers = rng.uniform(-half, half, (count, 3))
    turns = rng.normal(size=(count, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return np.concatenate([centers, turns], axis=1)

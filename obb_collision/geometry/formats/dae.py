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

"""DAE (COLLADA 1.4 and 1.5): meshes where its scene places them, in metres.

Appearance, animations and physics are left alone. Coordinates are as written, as ROS reads them:
``up_axis`` does not turn them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from obb_collision.geometry.fitting.convex_hull import convex_hull
from obb_collision.geometry.formats.parts import (
    NO_CORNERS,
    NO_FACES,
    MeshError,
    Parts,
    Triangles,
    check_complete,
    check_corners,
    check_nodes,
    fan_faces,
    first_fault,
    floats_of,
    integers_of,
    strip_faces,
    text_of,
)
from obb_collision.geometry.formats.polygons import triangulated, with_holes
from obb_collision.typing import Floats

#: Elements of a mesh without a surface.
NO_SURFACE = {"lines", "linestrips", "source", "vertices", "extra", "asset"}
#: Elements of a node that place a surface.
PLACING = ("instance_geometry", "instance_controller", "instance_node")


def read(data: bytes, parts: Parts) -> float:
    """Add the triangles of a file; return its unit in metres. MeshError for a bad file."""
    from lxml import etree  # here: other formats need not load it

    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=True,
        remove_comments=True, remove_pis=True, recover=True,
    )  # fmt: skip
    try:
        root = etree.fromstring(data, parser)
        fault = first_fault(parser.error_log)
        line = None if fault is None else fault.line
    except etree.XMLSyntaxError as error:
        root, line = None, error.lineno
    if root is None or line is not None:
        raise MeshError(f"it is not valid XML from line {line or 1} on")
    if _tag(root) != "COLLADA":
        raise MeshError("it is not a DAE file: its first element must be COLLADA")
    unit = _unit(root)
    _Document(root, parts).read()
    return unit


def _tag(node: Any) -> str:
    return str(node.tag).rpartition("}")[2] if isinstance(node.tag, str) else ""


def _children(node: Any, *tags: str) -> list[Any]:
    return [child for child in node if not tags or _tag(child) in tags]


def _unit(root: Any) -> float:
    for asset in _children(root, "asset"):
        for unit in _children(asset, "unit"):
            text = unit.get("meter", "1")
            (meter,) = floats_of([text.encode()])
            if not (math.isfinite(meter) and meter > 0.0):
                raise MeshError(
                    f"its unit must be a positive number of metres, got {text_of(text)}"
                )
            return float(meter)
    return 1.0


def _label(node: Any) -> str:
    return f"{_tag(node)} {text_of(node.get('id') or node.get('name') or '')}"


def _words(node: Any) -> list[bytes]:
    return (node.text or "").encode().split()


class _Document:
    """Elements by their ids, and the meshes read from them."""

    def __init__(self, root: Any, parts: Parts) -> None:
        self._root, self._parts = root, parts
        self._ids: dict[str, Any] = {}
        self._twice: set[str] = set()
        for node in root.iter():
            name = node.get("id") if isinstance(node.tag, str) else None
            if name is not None and self._ids.setdefault(name, node) is not node:
                self._twice.add(name)
        self._geometries: dict[Any, list[tuple[Floats, Triangles]]] = {}
        self._references: dict[tuple[Any, ...], Any] = {}

    def _named(self, node: Any, key: str, *tags: str, within: Any = None) -> Any:
        """Return the element that an attribute refers to; where ids repeat, the one ``within``."""
        reference = node.get(key), tags, within
        if reference not in self._references:
            self._references[reference] = self._search(node, key, *tags, within=within)
        return self._references[reference]

    def _search(self, node: Any, key: str, *tags: str, within: Any) -> Any:
        name = node.get(key, "")
        if not name.startswith("#"):
            what = "it refers to" if name else f"a {_tag(node)} does not say its {key}:"
            raise MeshError(f"{what} {text_of(name)}: other files are not read")
        element = self._ids.get(name[1:])
        if name[1:] in self._twice:
            around = self._root if within is None else within
            inner = [e for e in around.iter() if e.get("id") == name[1:] and _tag(e) in tags]
            if len(inner) > 1:
                raise MeshError(f"{len(inner)} elements {tags[0]} have the id {text_of(name[1:])}")
            element = inner[0] if inner else element
        if element is None or _tag(element) not in tags:
            raise MeshError(
                f"there is no {tags[0]} {text_of(name[1:])}, which {_label(node)} names"
            )
        return element

    def read(self) -> None:
        """Add the meshes that the scene places to the parts."""
        roots = [
            self._named(instance, "url", "visual_scene")
            for scene in _children(self._root, "scene")
            for instance in _children(scene, "instance_visual_scene")
        ]
        geometries = [node for node in self._root.iter() if _tag(node) == "geometry"]
        waiting = [(root, np.eye(4), 0) for root in roots]
        inner: dict[Any, tuple[Floats, list[Any]]] = {}
        visited = placed = 0
        while waiting:
            node, matrix, level = waiting.pop()
            visited += 1
            check_nodes(visited, level)
            if node not in inner:  # a node that others place is visited often
                inner[node] = _matrix(node), _children(node, "node", *PLACING)
            turn, children = inner[node]
            matrix = matrix @ turn
            for child in children:
                kind = _tag(child)
                if kind == "instance_geometry":
                    placed += 1
                    self._place(self._named(child, "url", "geometry"), matrix)
                elif kind == "instance_controller":
                    raise MeshError(
                        f"its {_label(node)} has a skeleton (controller): export it without"
                    )
                else:
                    below = child if kind == "node" else self._named(child, "url", "node")
                    waiting.append((below, matrix, level + 1))
        if not placed:
            what = f"its scene shows none of its {len(geometries)} geometries"
            raise MeshError(what if geometries else "it has no geometry")

    def _place(self, geometry: Any, matrix: Floats) -> None:
        if geometry not in self._geometries:
            try:
                self._geometries[geometry] = self._geometry(geometry)
            except MeshError as error:
                if type(error) is not MeshError:
                    raise
                raise MeshError(f"{_label(geometry)}: {error}") from None
        for vertices, faces in self._geometries[geometry]:
            self._parts.add(vertices, faces, matrix)

    def _geometry(self, geometry: Any) -> list[tuple[Floats, Triangles]]:
        kinds = [_tag(child) for child in geometry if _tag(child) not in ("asset", "extra", "")]
        if len(kinds) != 1 or kinds[0] not in ("mesh", "convex_mesh"):
            what = " and ".join(kinds) or "nothing"
            raise MeshError(f"it holds {what}, of which only a mesh is read")
        (mesh,) = _children(geometry, kinds[0])
        if mesh.get("convex_hull_of") is None:
            return self._mesh(mesh)
        other = self._named(mesh, "convex_hull_of", "geometry")
        solid = _children(other, "mesh")
        if not solid:
            raise MeshError("it is the convex hull of a geometry that is not a mesh")
        points = [vertices[np.unique(faces)] for vertices, faces in self._mesh(solid[0])]
        return [_hull(np.concatenate([np.empty((0, 3)), *points]))]

    def _mesh(self, mesh: Any) -> list[tuple[Floats, Triangles]]:
        vertices: dict[Any, Floats] = {}
        faces: dict[Any, list[Triangles]] = {}
        for primitive in mesh:
            kind = _tag(primitive)
            if kind in NO_SURFACE or not kind:
                continue
            if kind not in READERS:
                raise MeshError(f"it has {kind}, which is not read: export it as triangles")
            source, offset, step = self._source_of(primitive, mesh)
            if source not in vertices:
                vertices[source] = self._source(source)
            triangles = READERS[kind](primitive, vertices[source], offset, step)
            faces.setdefault(source, []).append(triangles)
        return [(points, np.concatenate(faces[source])) for source, points in vertices.items()]

    def _source_of(self, primitive: Any, mesh: Any) -> tuple[Any, int, int]:
        """Return the source of positions, their offset in a corner, and numbers per corner."""
        inputs = _children(primitive, "input")
        offsets = [int(integers_of([item.get("offset", "0").encode()])[0]) for item in inputs]
        at = [row for row, item in enumerate(inputs) if item.get("semantic") == "VERTEX"]
        if len(at) != 1 or min(offsets) < 0:
            if primitive.get("count") == "0" and not inputs:
                return None, 0, 1
            raise MeshError(f"its {_tag(primitive)} have no vertices")
        vertices = self._named(inputs[at[0]], "source", "vertices", within=mesh)
        for item in _children(vertices, "input"):
            if item.get("semantic") == "POSITION":
                source = self._named(item, "source", "source", within=mesh)
                return source, offsets[at[0]], max(offsets) + 1
        raise MeshError("its vertices have no positions")

    def _source(self, source: Any) -> Floats:
        """Return the positions (n, 3) of a source, (0, 3) without one."""
        if source is None:
            return np.empty((0, 3))
        accessors = [
            accessor
            for common in _children(source, "technique_common")
            for accessor in _children(common, "accessor")
        ]
        if len(accessors) != 1:
            raise MeshError(f"its {_label(source)} has no accessor")
        (accessor,) = accessors
        array = self._named(accessor, "source", "float_array", "int_array", within=source)
        numbers = floats_of(_words(array))
        check_complete(_whole(array, "count", len(numbers)), len(numbers), "numbers of positions")
        names = [param.get("name", "") for param in _children(accessor, "param")]
        if {"X", "Y", "Z"} <= {*names}:
            columns = [names.index(name) for name in "XYZ"]
        else:
            columns = [column for column, name in enumerate(names) if name][:3] or [0, 1, 2]
        step, start = _whole(accessor, "stride", 1), _whole(accessor, "offset", 0)
        if len(columns) != 3 or max(columns) >= step:
            raise MeshError(f"its {_label(source)} does not have three numbers per position")
        count = _whole(accessor, "count", 0)
        self._parts.check_room(0, count)
        if count and start + (count - 1) * step + max(columns) >= len(numbers):
            check_complete(count, (len(numbers) - start) // step, "positions")
        rows = start + step * np.arange(count)[:, None] + columns
        return numbers[rows]


def _whole(node: Any, key: str, default: int) -> int:
    text = node.get(key)
    if text is None:
        return default
    (number,) = integers_of([text.encode()]).tolist()
    if number < 0:
        raise MeshError(f"the {key} of its {_tag(node)} is {number}")
    return int(number)


def _corners(node: Any, offset: int, step: int) -> Triangles:
    """Return the indices (n,) of vertices: every ``step``-th number, from ``offset`` on."""
    numbers = integers_of(_words(node))
    if len(numbers) % step:
        raise MeshError(f"{len(numbers)} numbers cannot be divided into corners of {step} numbers")
    return numbers[offset::step]


def _lists(primitive: Any, offset: int, step: int) -> list[Triangles]:
    return [_corners(node, offset, step) for node in _children(primitive, "p")]


def _triangles(primitive: Any, points: Floats, offset: int, step: int) -> Triangles:
    corners = np.concatenate([NO_CORNERS, *_lists(primitive, offset, step)])
    if len(corners) % 3:
        raise MeshError(f"{len(corners)} corners do not form triangles")
    check_complete(_whole(primitive, "count", len(corners) // 3), len(corners) // 3, "triangles")
    return corners.reshape(-1, 3)


def _polylist(primitive: Any, points: Floats, offset: int, step: int) -> Triangles:
    corners = np.concatenate([NO_CORNERS, *_lists(primitive, offset, step)])
    counts = integers_of([word for node in _children(primitive, "vcount") for word in _words(node)])
    check_complete(_whole(primitive, "count", len(counts)), len(counts), "polygons")
    if (counts < 0).any():
        raise MeshError("a polygon has a negative number of corners")
    check_complete(int(counts.sum()), len(corners), "corners of polygons")
    return triangulated(points, corners, counts)


def _polygons(primitive: Any, points: Floats, offset: int, step: int) -> Triangles:
    loops = _lists(primitive, offset, step)
    for holed in _children(primitive, "ph"):
        around = [_corners(node, offset, step) for node in _children(holed, "p", "h")]
        named = np.concatenate([NO_CORNERS, *around])
        check_corners(named, len(points))
        loops.append(with_holes(points, around))
    check_complete(_whole(primitive, "count", len(loops)), len(loops), "polygons")
    counts = np.fromiter(map(len, loops), np.int64, len(loops))
    return triangulated(points, np.concatenate([NO_CORNERS, *loops]), counts)


def _strips(make: Callable[[Triangles], Triangles]) -> Callable[..., Triangles]:
    def read(primitive: Any, points: Floats, offset: int, step: int) -> Triangles:
        lists = _lists(primitive, offset, step)
        check_complete(_whole(primitive, "count", len(lists)), len(lists), "lists of triangles")
        return np.concatenate([NO_FACES, *map(make, lists)])

    return read


READERS = {
    "triangles": _triangles,
    "polylist": _polylist,
    "polygons": _polygons,
    "trifans": _strips(fan_faces),
    "tristrips": _strips(strip_faces),
}


def _matrix(node: Any) -> Floats:
    """Return the matrix (4, 4) from a node to its parent: the product of its transforms."""
    matrix = np.eye(4)
    for child in node:
        kind = _tag(child)
        if kind not in TRANSFORMS:
            continue
        size, make = TRANSFORMS[kind]
        numbers = floats_of(_words(child))
        if len(numbers) != size:
            raise MeshError(f"the {kind} of its {_label(node)} does not have {size} numbers")
        if make is not None:
            matrix = matrix @ make(numbers)
        elif any(_tag(inner) in PLACING for inner in node.iter()):
            raise MeshError(f"its {_label(node)} is placed by {kind}: export it with a matrix")
    return matrix


def _moved(numbers: Floats) -> Floats:
    matrix = np.eye(4)
    matrix[:3, 3] = numbers
    return matrix


def _turned(numbers: Floats) -> Floats:
    """Return the matrix (4, 4) of a rotation: its axis, and an angle in degrees (Rodrigues)."""
    matrix, axis, length = np.eye(4), numbers[:3], float(np.linalg.norm(numbers[:3]))
    if length > 0.0:
        x, y, z = axis / length
        angle = math.radians(numbers[3])
        across = np.array([(0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)])
        turn = math.sin(angle) * across + (1.0 - math.cos(angle)) * across @ across
        matrix[:3, :3] += turn
    return matrix


#: How many numbers a transform has, and what makes its matrix; None: it is not read.
TRANSFORMS: dict[str, tuple[int, Callable[[Floats], Floats] | None]] = {
    "matrix": (16, lambda numbers: numbers.reshape(4, 4)),
    "translate": (3, _moved),
    "rotate": (4, _turned),
    "scale": (3, lambda numbers: np.diag([*numbers, 1.0])),
    "lookat": (9, None),
    "skew": (7, None),
}


def _hull(points: Floats) -> tuple[Floats, Triangles]:
    """Return the convex hull of points as triangles that face outwards."""
    hull = convex_hull(points) if len(points) > 3 else None
    if hull is None:
        raise MeshError("it is the hull of points that are flat")
    faces = np.array(hull.simplices, np.int64)
    a, b, c = (points[faces[:, column]] for column in range(3))
    inwards = ((points.mean(axis=0) - a) * np.cross(b - a, c - a)).sum(axis=1) > 0.0
    faces[inwards] = faces[inwards, ::-1]
    return points, faces

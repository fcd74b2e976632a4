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

"""glTF 2.0, as GLB and as JSON with its buffers inside.

By its specification (Khronos, 2.0.1). Coordinates stay as written, whichever axis is up.
"""

from __future__ import annotations

import base64
import binascii
import json
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.formats.parts import (
    NO_FACES,
    MeshError,
    Parts,
    Triangles,
    check_nodes,
    fan_faces,
    strip_faces,
    text_of,
)
from obb_collision.geometry.poses import rotate_vectors
from obb_collision.typing import Floats

MAGIC, HEADER, VERSION = b"glTF", 12, 2
JSON, BIN = b"JSON", b"BIN\0"
#: Extensions that do not change geometry, or are read.
KNOWN = re.compile(
    r"KHR_(mesh_quantization|materials_\w+|texture_\w+|lights_\w+|xmp\w*|animation_pointer"
    r"|techniques?_webgl|node_hoverability|node_selectability|audio\w*|interactivity)"
    r"|EXT_(texture_\w+|lights_\w+)|MSFT_(texture_dds|packing_\w+)|ADOBE_materials_\w+"
)
#: Extensions that place geometry, which a reader that ignores them would leave out.
OF_NODES = ("EXT_mesh_gpu_instancing",)
TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
TRIANGLES, STRIP, FAN = 4, 5, 6
POINTS_AND_LINES = range(4)

Object = dict[str, Any]


def read_glb(data: bytes, parts: Parts) -> None:
    """Add the triangles of a GLB. MeshError for a bad file."""
    if data[:4] != MAGIC:
        raise MeshError("it is not a GLB file: it must begin with glTF")
    version, length = (int.from_bytes(data[at : at + 4], "little") for at in (4, 8))
    if version != VERSION:
        raise MeshError(f"it is glTF {version}.0: export it as glTF 2.0")
    if length > len(data):
        raise MeshError(f"it declares {length} bytes and holds {len(data)}: it is cut")
    chunks: dict[bytes, bytes] = {}
    at = HEADER
    while at + 8 <= length:
        size, kind = int.from_bytes(data[at : at + 4], "little"), data[at + 4 : at + 8]
        if at + 8 + size > length:
            raise MeshError("one of its chunks ends beyond the file: it is cut or damaged")
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if JSON not in chunks:
        raise MeshError("its JSON is missing")
    _Document(chunks[JSON], chunks.get(BIN), parts).read()


def read_json(data: bytes, parts: Parts) -> None:
    """Add the triangles of a glTF. MeshError for a bad file."""
    _Document(data, None, parts).read()


class _Document:
    """The objects of a file by kind, and the meshes read from them."""

    def __init__(self, text: bytes, binary: bytes | None, parts: Parts) -> None:
        self._parts, self._binary = parts, binary
        self._buffers: dict[int, bytes] = {}
        self._meshes: dict[tuple[int, str], list[tuple[Floats, Triangles]]] = {}
        try:
            content = json.loads(text.decode("utf-8-sig"))
        except (ValueError, RecursionError):
            raise MeshError("it is not valid JSON: it is cut or damaged") from None
        if not isinstance(content, dict):
            raise MeshError("its JSON is not an object")
        self._all: Object = content
        version = str(content.get("asset", {}).get("version", "none"))
        if version.partition(".")[0] != str(VERSION):
            raise MeshError(f"it is glTF {version}: export it as glTF 2.0")
        for name in content.get("extensionsRequired", []):
            if KNOWN.fullmatch(str(name)) is None:
                raise MeshError(f"it requires the extension {name}: export it without")

    def _object(self, kind: str, index: Any) -> Object:
        rows = self._all.get(kind, [])
        if not (isinstance(index, int) and 0 <= index < len(rows)):
            raise MeshError(f"it names {kind} {index}, there are {len(rows)}")
        return rows[index]

    def read(self) -> None:
        """Add the meshes that the scene places to the parts."""
        waiting = [(index, np.eye(4), 1) for index in self._roots()]
        visited = 0
        while waiting:
            index, matrix, level = waiting.pop()
            visited += 1
            check_nodes(visited, level)
            node = self._object("nodes", index)
            matrix = matrix @ _matrix(node)
            if "mesh" in node:
                self._place(node, matrix)
            waiting += [(child, matrix, level + 1) for child in node.get("children", [])]

    def _roots(self) -> list[int]:
        """Return the nodes of the scene; in a file without scenes those without a parent."""
        scenes, nodes = self._all.get("scenes", []), self._all.get("nodes", [])
        if "scene" in self._all or len(scenes) == 1:
            return list(self._object("scenes", self._all.get("scene", 0)).get("nodes", []))
        if scenes:
            raise MeshError(f"it has {len(scenes)} scenes and does not say which is shown")
        below = {child for node in nodes for child in node.get("children", [])}
        return [index for index in range(len(nodes)) if index not in below]

    def _place(self, node: Object, matrix: Floats) -> None:
        name = text_of(str(node.get("name", "")))
        if "skin" in node:
            raise MeshError(f"its node {name} is moved by a skin: export it without bones")
        for extension in OF_NODES:
            if extension in node.get("extensions", {}):
                raise MeshError(f"its node {name} has {extension}: export it without")
        mesh = self._object("meshes", node["mesh"])
        weights = node.get("weights", mesh.get("weights", []))
        key = node["mesh"], str(weights)
        if key not in self._meshes:
            meshes, triangles, vertices = [], 0, 0
            for primitive in mesh.get("primitives", []):
                meshes.append(self._primitive(primitive, weights))
                vertices, triangles = vertices + len(meshes[-1][0]), triangles + len(meshes[-1][1])
                self._parts.check_room(triangles, vertices)
            self._meshes[key] = meshes
        for part in self._meshes[key]:
            self._parts.add(*part, matrix)

    def _primitive(self, primitive: Object, weights: Any) -> tuple[Floats, Triangles]:
        """Return vertices and triangles; points and lines have no triangles."""
        position = primitive.get("attributes", {}).get("POSITION")
        if position is None:
            raise MeshError("one of its primitives has no POSITION")
        vertices = self._accessor(position).astype(np.float64)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise MeshError("POSITION is not of three numbers")
        for weight, target in zip(weights, primitive.get("targets", []), strict=False):
            if weight and "POSITION" in target:
                vertices = vertices + weight * self._accessor(target["POSITION"])
        mode = primitive.get("mode", TRIANGLES)
        if mode in POINTS_AND_LINES:
            return vertices, NO_FACES
        if "indices" in primitive:
            corners = self._accessor(primitive["indices"]).astype(np.int64).reshape(-1)
        else:
            corners = np.arange(len(vertices))
        if mode == TRIANGLES and len(corners) % 3 == 0:
            return vertices, corners.reshape(-1, 3)
        if mode in (STRIP, FAN):
            return vertices, (strip_faces if mode == STRIP else fan_faces)(corners)
        raise MeshError(f"{len(corners)} corners do not form triangles of mode {mode}")

    def _accessor(self, index: int) -> NDArray[Any]:
        """Return the values (count, width) of an accessor, with sparse ones, normalised."""
        accessor = self._object("accessors", index)
        kind, count = accessor.get("componentType"), accessor["count"]
        if kind not in TYPES or accessor.get("type") not in WIDTHS:
            raise MeshError(f"accessor {index} is of type {kind} {accessor.get('type')}")
        self._parts.check_room(0, max(count, 0))
        width, sparse = WIDTHS[accessor["type"]], accessor.get("sparse")
        if "bufferView" in accessor:
            values = self._view(accessor, TYPES[kind], count, width)
        elif sparse is None:
            raise MeshError(f"accessor {index} has no data: it may be compressed")
        else:
            values = np.zeros((count, width), TYPES[kind])
        if sparse is not None:
            rows = self._view(sparse["indices"], TYPES[sparse["indices"]["componentType"]],
                              sparse["count"], 1).reshape(-1)  # fmt: skip
            if len(rows) and rows.max() >= count:
                raise MeshError(f"accessor {index} replaces row {rows.max()} of {count}")
            values = values.copy()
            values[rows] = self._view(sparse["values"], TYPES[kind], sparse["count"], width)
        if accessor.get("normalized") and values.dtype.kind in "iu":
            return np.maximum(values / np.iinfo(values.dtype).max, -1.0)
        return values

    def _view(self, reference: Object, code: str, count: int, width: int) -> NDArray[Any]:
        """Return rows (count, width) of the view that an object refers to."""
        view = self._object("bufferViews", reference.get("bufferView"))
        data = self._buffer(view.get("buffer"))
        start, size = view.get("byteOffset", 0), view.get("byteLength", 0)
        if not 0 <= start <= start + size <= len(data):
            raise MeshError("a part of a buffer reaches beyond its end: it is cut or damaged")
        kind = np.dtype(code)
        step = view.get("byteStride", width * kind.itemsize)
        offset = reference.get("byteOffset", 0)
        last = offset + (count - 1) * step + width * kind.itemsize
        if count < 0 or offset < 0 or step < 0 or (count and last > size):
            raise MeshError("an accessor reaches beyond its part of a buffer: it is damaged")
        return np.ndarray((count, width), kind, data, start + offset, (step, kind.itemsize))

    def _buffer(self, index: Any) -> bytes:
        """Return the bytes of a buffer, which must be within the file."""
        buffer = self._object("buffers", index)
        if index not in self._buffers:
            uri = buffer.get("uri")
            if uri is None:
                data = self._binary if index == 0 else None
                if data is None:
                    raise MeshError(f"buffer {index} has no data: it may be compressed")
            elif not uri.startswith("data:"):
                raise MeshError(f"it refers to {text_of(uri)}: other files are not read")
            else:
                data = _data_of(uri)
            if len(data) < buffer.get("byteLength", 0):
                declared = buffer["byteLength"]
                raise MeshError(f"buffer {index} declares {declared} bytes, it has {len(data)}")
            self._buffers[index] = data
        return self._buffers[index]


def _data_of(uri: str) -> bytes:
    head, _, text = uri.partition(",")
    try:
        if head.endswith(";base64"):
            return base64.b64decode(text, validate=True)
    except binascii.Error:
        pass
    raise MeshError("a buffer is not base64 text")


def _matrix(node: Object) -> Floats:
    """Return the matrix (4, 4) from a node to its parent."""
    if "matrix" in node:
        numbers = np.array(node["matrix"], np.float64)
        if numbers.shape != (16,):
            raise MeshError("the matrix of a node does not have 16 numbers")
        return numbers.reshape(4, 4).T
    matrix = np.eye(4)
    turn = np.array(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), np.float64)
    length = np.linalg.norm(turn)
    if turn.shape != (4,) or not length > 0.0:
        raise MeshError("the rotation of a node is not a quaternion")
    matrix[:3, :3] = rotate_vectors(turn / length, np.eye(3)).T
    matrix[:3, :3] *= np.array(node.get("scale", (1.0, 1.0, 1.0)), np.float64)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix

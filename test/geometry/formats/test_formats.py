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

"""Mesh files by format: what they declare is all there, where it belongs, or they are refused."""

from __future__ import annotations

import base64
import json
import re
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from each import each

from obb_collision.geometry.shapes.files import read_mesh

#: The unit cube: corners, and quadrangles that face outwards.
CORNERS = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = [face for a, b, c, d in SIDES for face in ((a, b, c), (a, c, d))]
SOUP = np.array(CORNERS, "<f4")[FACES]
SQUARE_4 = [(0, 0), (4, 0), (4, 4), (0, 4)]
#: An L of area 3, an arrow head of area 1, and a wall of area 12: its hole is joined by two edges.
FLAT = {
    "L": (3.0, [(1, 1), (1, 2), (0, 2), (0, 0), (2, 0), (2, 1)]),
    "arrow": (1.0, [(2, 1), (0, 0), (2, -1), (1, 0)]),
    "wall": (12.0, [*SQUARE_4, (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]),
}  # fmt: skip


def lines(*rows: Sequence[Any], first: str = "") -> str:
    return "".join(first + " ".join(map(str, row)) + "\n" for row in rows)


def measured(data: bytes | str, name: str) -> tuple[float, list[float], list[float], int]:
    """Return area, corners of the bounds, and number of triangles of what a file holds."""
    points, faces = read_mesh(data if isinstance(data, bytes) else data.encode(), name)
    shown = points[faces]
    sides = np.cross(shown[:, 1] - shown[:, 0], shown[:, 2] - shown[:, 0])
    low, high = shown.reshape(-1, 3).min(axis=0), shown.reshape(-1, 3).max(axis=0)
    return float(np.linalg.norm(sides, axis=1).sum() / 2), low.tolist(), high.tolist(), len(faces)


def obj(shift: float = 0.0, corners: Any = CORNERS, sides: Any = SIDES) -> str:
    """Return a body as OBJ whose faces count back."""
    moved = [(corner[0] + shift, *corner[1:]) for corner in corners]
    back = [[index - len(corners) for index in side] for side in sides]
    return lines(*moved, first="v ") + lines(*back, first="f ")


def off(head: str = "OFF", more: Sequence[Any] = (), corners: Any = CORNERS) -> str:
    counted = [(len(face), *face) for face in FACES]
    rows = [(*corner, *more) for corner in corners]
    return f"{head}\n" + lines((len(rows), len(FACES), 18), *rows, *counted)


def ply(kind: str = "ascii", sides: Any = FACES, more: str = "") -> bytes:
    """Return a cube as PLY, its corners as float, indices of faces as int."""
    head = f"ply\nformat {kind} 1.0\nobj_info x\ncomment y\nelement vertex 8\n" + "".join(
        f"property float {axis}\n" for axis in "xyz"
    )
    head += f"element face {len(sides)}\n{more}property list uchar int vertex_indices\nend_header\n"
    if kind == "ascii":
        return (head + lines(*CORNERS, *((len(side), *side) for side in sides))).encode()
    order = "<" if "little" in kind else ">"
    rows = [struct.pack(f"{order}3f", *corner) for corner in CORNERS]
    rows += [struct.pack(f"{order}B{len(side)}i", len(side), *side) for side in sides]
    return head.encode() + b"".join(rows)


def one_line(data: bytes) -> bytes:
    """Return a PLY with all of its rows in one line."""
    head, end, rows = data.partition(b"end_header\n")
    return head + end + rows.replace(b"\n", b" ")


def solid(name: str = "part", shift: float = 0.0) -> str:
    """Return a cube as STL in text."""
    facet = "facet normal 0 0 0\n outer loop\n{} endloop\nendfacet\n"
    corners = SOUP + np.array((shift, 0.0, 0.0))
    facets = (facet.format(lines(*face.tolist(), first="  vertex ")) for face in corners)
    return f"solid {name}\n{''.join(facets)}endsolid {name}\n"


def records(declared: int = 12, head: bytes = b"") -> bytes:
    """Return a cube as STL in binary."""
    rows = [bytes(12) + face.tobytes() + bytes(2) for face in SOUP]
    return head.ljust(80, b"\0") + struct.pack("<I", declared) + b"".join(rows)


def dae(geometries: str, nodes: str, asset: str = "", libraries: str = "") -> str:
    space = "http://www.collada.org/2005/11/COLLADASchema"
    return (
        f'<?xml version="1.0"?><COLLADA xmlns="{space}" version="1.4.1"><asset>{asset}</asset>'
        f"{libraries}<library_geometries>{geometries}</library_geometries><library_visual_scenes>"
        f'<visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )


def polylist(sides: Any) -> str:
    """Return faces as a polylist of which each corner has a normal, too."""
    counts = " ".join(str(len(side)) for side in sides)
    named = " ".join(f"{index} 0" for side in sides for index in side)
    return (
        f'<polylist count="{len(sides)}"><input semantic="VERTEX" source="#v" offset="0"/>'
        '<input semantic="NORMAL" source="#gone" offset="1"/>'
        f"<vcount>{counts}</vcount><p>{named}</p></polylist>"
    )


def primitive(kind: str, count: int, inside: str) -> str:
    vertex = '<input semantic="VERTEX" source="#v" offset="0"/>'
    return f'<{kind} count="{count}">{vertex}{inside}</{kind}>'


def geometry(name: str, inside: str, corners: Any = CORNERS, kind: str = "mesh") -> str:
    """Return a geometry of a DAE; the ids within it are those of the others, too."""
    numbers = " ".join(str(x) for corner in corners for x in corner)
    return (
        f'<geometry id="{name}"><{kind}><source id="p"><float_array id="a" '
        f'count="{3 * len(corners)}">{numbers}</float_array><technique_common><accessor source="#a"'
        f' count="{len(corners)}" stride="3"><param name="X"/><param name="Y"/><param name="Z"/>'
        '</accessor></technique_common></source><vertices id="v"><input semantic="POSITION" '
        f'source="#p"/></vertices>{inside}</{kind}></geometry>'
    )


def placed(name: str, x: float = 0.0, inside: str = "") -> str:
    show = f'<instance_geometry url="#{name}"/>'
    return f"<node><translate>{x} 0 0</translate>{inside}{show}</node>"


CUBE = polylist(SIDES)
#: The other one stands at 5, whatever the first one is.
TWO_NODES = placed("first") + placed("second", 5.0)


def two(inside: str, libraries: str = "", corners: Any = CORNERS) -> str:
    """Return a DAE of two geometries, the second a cube."""
    both = geometry("first", inside, corners) + geometry("second", CUBE)
    return dae(both, TWO_NODES, libraries=libraries)


def gltf(
    positions: Any,
    indices: Any = None,
    mode: int = 4,
    node: dict[str, Any] | None = None,
    accessor: dict[str, Any] | None = None,
    primitive: dict[str, Any] | None = None,
    more: dict[str, Any] | None = None,
    extra: bytes = b"",
) -> bytes:
    """Return a GLB of one primitive; its first view holds positions, its third ``extra``."""
    points = np.asarray(positions)
    kinds = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
    rows = np.asarray(range(len(points)) if indices is None else indices, "<u4").reshape(-1)
    chunks = [points.tobytes(), rows.tobytes(), extra]
    starts = np.cumsum([0, *(-len(chunk) % 4 + len(chunk) for chunk in chunks)]).tolist()
    body = b"".join(chunk.ljust(-len(chunk) % 4 + len(chunk), b"\0") for chunk in chunks)
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": len(chunk)}
        for start, chunk in zip(starts, chunks, strict=False)
    ]
    shown: dict[str, Any] = {"attributes": {"POSITION": 0}, "indices": 1, "mode": mode}
    found: dict[str, Any] = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **(node or {})}], "buffers": [{"byteLength": len(body)}],
        "meshes": [{"primitives": [{**shown, **(primitive or {})}]}], "bufferViews": views,
        "accessors": [
            {"bufferView": 0, "componentType": kinds[points.dtype.str[1:]], "count": len(points),
             "type": "VEC3", **(accessor or {})},
            {"bufferView": 1, "componentType": 5125, "count": len(rows), "type": "SCALAR"},
        ],
        **(more or {}),
    }  # fmt: skip
    return glb(found, body)


def glb(found: dict[str, Any], body: bytes) -> bytes:
    text = json.dumps(found).encode()
    text = text.ljust(-len(text) % 4 + len(text))
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(body), b"BIN\0") + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


FLOATS, UNIT_FACES = np.array(CORNERS, "<f4"), np.array(FACES)
SQUARE = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], "<f4")
SPARSE = {
    "count": 4, "indices": {"bufferView": 2, "componentType": 5121},
    "values": {"bufferView": 2, "byteOffset": 4},
}  # fmt: skip
MOVED = bytes([4, 5, 6, 7]) + np.array([(3, y, z) for y in (0, 1) for z in (0, 1)], "<f4").tobytes()
QUANTIZED = {"extensionsRequired": ["KHR_mesh_quantization"]}
MORPH = [{"POSITION": 0}]
IMAGE = "<library_images><image id='i'><init_from>gone.png</init_from></image></library_images>"
EFFECT = (
    '<library_effects><effect id="e"><profile_COMMON><technique sid="t"><lambert><diffuse><color>'
    "0,8 0,8 0,8 1</color></diffuse></lambert></technique></profile_COMMON></effect>"
    "</library_effects>"
)
HOLED = [(0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0), (1, 1, 0), (3, 1, 0), (3, 3, 0), (1, 3, 0)]
WALL = primitive("polygons", 1, "<ph><p>0 1 2 3</p><h>4 5 6 7</h></ph>")
LINES = primitive("linestrips", 1, "<p>0 7</p>")
INNER = '<node><rotate>0 0 1 90</rotate><instance_node url="#n"/></node>'
NESTED = f"<node><scale>2 2 2</scale>{INNER}</node>"
LIBRARY = f'<library_nodes><node id="n">{placed("first", 1.0)}</node></library_nodes>'
HULL = '<geometry id="hull"><convex_mesh convex_hull_of="#first"/></geometry>'

#: Files, the area of what they hold, and the corners of its bounds.
WHOLE: dict[str, tuple[str, bytes | str, float, Any, Any]] = {
    "OBJ, blocks that count back": ("obj", obj() + obj(10), 12, 0, (11, 1, 1)),
    "OBJ, indented": ("obj", re.sub("^", " \t", obj(), flags=re.MULTILINE), 6, 0, 1),
    "OBJ, tabs": ("obj", obj().replace("f ", "f\t").replace("v ", "v\t"), 6, 0, 1),
    "OBJ, comments after faces": ("obj", obj().replace("\n", " # end\n"), 6, 0, 1),
    "OBJ, byte-order mark": ("obj", "\ufeff" + obj(), 6, 0, 1),
    "OBJ, UTF-16": ("obj", obj().encode("utf-16"), 6, 0, 1),
    "OBJ, CRLF": ("obj", obj().replace("\n", "\r\n"), 6, 0, 1),
    "OBJ, lines that go on": ("obj", re.sub("(f \\S+)", "\\1 \\\\\n", obj()), 6, 0, 1),
    "OBJ, colours, normals, points and lines": (
        "obj",
        re.sub("^(v.*)$", "\\1 .5 .5 .5", obj(), flags=re.MULTILINE).replace("-8", "-8//7")
        + "vn 0 0 x\nusemtl a b\nl 1 2\np 1\n",
        6,
        0,
        1,
    ),
    "STL, trailing bytes": ("stl", records() + b"end of file", 6, 0, 1),
    "STL, trailing zeros": ("stl", records() + bytes(100), 6, 0, 1),
    "STL, a number that is too low": ("stl", records(5), 6, 0, 1),
    "STL, no number": ("stl", records(0), 6, 0, 1),
    "STL, binary that begins as text": ("stl", records(12, b"solid part"), 6, 0, 1),
    "STL, a name in Latin-1": ("stl", solid("B\xfcgel").encode("latin-1"), 6, 0, 1),
    "STL, upper case and CRLF": ("stl", solid().upper().replace("\n", "\r\n"), 6, 0, 1),
    "STL, two solids": ("stl", solid() + solid("facet", 10), 12, 0, (11, 1, 1)),
    "PLY": ("ply", ply(), 6, 0, 1),
    "PLY, triangles and quadrangles": (
        "ply",
        ply("binary_little_endian", [*FACES[:2], *SIDES[1:]]),
        6,
        0,
        1,
    ),
    "PLY, the same in the other order": (
        "ply",
        ply("binary_big_endian", [*FACES[:2], *SIDES[1:]]),
        6,
        0,
        1,
    ),
    "PLY, CRLF": ("ply", ply().replace(b"\n", b"\r\n"), 6, 0, 1),
    "PLY, one line": (
        "ply",
        one_line(ply()),
        6,
        0,
        1,
    ),
    "PLY, strips": (
        "ply",
        ply(sides=[(0, 1, 2, -1, 4, 5, 6, 7)]).replace(b"t face", b"t tristrips"),
        1.5,
        0,
        1,
    ),
    "OFF": ("off", off(), 6, 0, 1),
    "OFF, no line ends": ("off", off().replace("\n", " "), 6, 0, 1),
    "OFF, colours and comments": (
        "off",
        off("COFF # x", (1, 0, 0, 1)).replace("3 0", "#\n3 0"),
        6,
        0,
        1,
    ),
    "OFF, numbers beside the word": ("off", off("OFF").replace("OFF\n", "OFF "), 6, 0, 1),
    "OFF, weights": ("off", off("4OFF", (2,)), 1.5, 0, 0.5),
    "DAE, nested": (
        "dae",
        dae(geometry("first", CUBE), NESTED, libraries=LIBRARY),
        24,
        (-2, 2, 0),
        (0, 4, 2),
    ),
    "DAE, mirrored": (
        "dae",
        dae(geometry("first", CUBE), placed("first", 0, "<scale>-1 1 1</scale>")),
        6,
        (-1, 0, 0),
        (0, 1, 1),
    ),
    "DAE, millimetres": (
        "dae",
        dae(
            geometry("first", CUBE), placed("first"), '<unit meter="0.001"/><up_axis>Y_UP</up_axis>'
        ),
        6e-6,
        0,
        1e-3,
    ),
    "DAE, decimal commas in a colour": ("dae", two(CUBE, EFFECT), 12, 0, (6, 1, 1)),
    "DAE, a picture that is gone": ("dae", two(CUBE, IMAGE), 12, 0, (6, 1, 1)),
    "DAE, lines": ("dae", two(LINES + CUBE), 12, 0, (6, 1, 1)),
    "DAE, a prefix that is not declared": (
        "dae",
        two(CUBE).replace("<library_geometries>", "<library_geometries xsi:type='x'>"),
        12,
        0,
        (6, 1, 1),
    ),
    "DAE, lines only": ("dae", two(LINES), 6, (5, 0, 0), (6, 1, 1)),
    "DAE, a hole": ("dae", two(WALL, corners=HOLED), 18, 0, (6, 4, 1)),
    "DAE, fans and strips": (
        "dae",
        two(
            primitive("trifans", 1, "<p>0 1 3 2</p>") + primitive("tristrips", 1, "<p>4 5 6 7</p>")
        ),
        8,
        0,
        (6, 1, 1),
    ),
    "DAE, convex_mesh": (
        "dae",
        dae(geometry("first", CUBE, kind="convex_mesh"), placed("first")),
        6,
        0,
        1,
    ),
    "DAE, hull": ("dae", dae(geometry("first", CUBE) + HULL, placed("hull")), 6, 0, 1),
    "GLB": ("glb", gltf(FLOATS, FACES), 6, 0, 1),
    "GLB, sparse": (
        "glb",
        gltf(FLOATS, FACES, accessor={"sparse": SPARSE}, extra=MOVED),
        14,
        0,
        (3, 1, 1),
    ),
    "GLB, sparse alone": (
        "glb",
        gltf(
            FLOATS,
            FACES,
            accessor={"bufferView": None, "sparse": {**SPARSE, "count": 4}},
            extra=MOVED,
        ).replace(b'"bufferView": null, ', b" " * 20),
        7.16227766,
        0,
        (3, 1, 1),
    ),
    "GLB, strip": ("glb", gltf(SQUARE, mode=5), 1, 0, (1, 1, 0)),
    "GLB, fan": ("glb", gltf(SQUARE, [0, 1, 3, 2], mode=6), 1, 0, (1, 1, 0)),
    "GLB, morphed": (
        "glb",
        gltf(FLOATS, FACES, node={"weights": [0.5]}, primitive={"targets": MORPH}),
        13.5,
        0,
        1.5,
    ),
    "GLB, placed": (
        "glb",
        gltf(
            FLOATS,
            FACES,
            node={"scale": [2, 1, 1], "rotation": [0, 0, 1, 1], "translation": [0, 0, 3]},
        ),
        10,
        (-1, 0, 3),
        (0, 2, 4),
    ),
    **{
        f"GLB, normalised {code}": (
            "glb",
            gltf(
                np.array(CORNERS, f"<{code}") * np.iinfo(code).max,
                FACES,
                accessor={"normalized": True},
                more=QUANTIZED,
            ),
            6,
            0,
            1,
        )
        for code in ("i1", "u1", "i2", "u2")
    },
    "GLB, quantised": ("glb", gltf(np.array(CORNERS, "<i2"), FACES, more=QUANTIZED), 6, 0, 1),
}


def spread(value: Any) -> Any:
    return np.broadcast_to(value, 3)


@each("name", WHOLE)
def test_what_a_file_holds_is_all_there_and_where_it_belongs(name: str) -> None:
    suffix, data, area, low, high = WHOLE[name]
    found, lowest, highest, _ = measured(data, f"part.{suffix}")
    np.testing.assert_allclose(lowest, spread(low), atol=1e-6)
    np.testing.assert_allclose(highest, spread(high), rtol=1e-6, atol=1e-6)
    assert found == pytest.approx(area, rel=1e-6)


def flat_ply(points: Any) -> bytes:
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n" + "".join(
        f"property double {axis}\n" for axis in "xyz"
    )
    head += "element face 1\nproperty list uint8 uint vertex_index\nend_header\n"
    return (head + lines(*points, (len(points), *range(len(points))))).encode()


@each("shape", FLAT)
@each("suffix", ["obj", "off", "ply", "dae"])
def test_polygons_that_are_not_convex_have_their_area(shape: str, suffix: str) -> None:
    area, flat = FLAT[shape]
    for turn in range(len(flat)):
        points = [(0, x, y) for x, y in flat[turn:] + flat[:turn]]
        side = range(len(points))
        data: dict[str, bytes | str] = {
            "obj": obj(corners=points, sides=[side]),
            "off": "OFF\n" + lines((len(points), 1, 0), *points, (len(points), *side)),
            "ply": flat_ply(points),
            "dae": dae(geometry("first", polylist([side]), points), placed("first")),
        }
        found, _, _, count = measured(data[suffix], f"part.{suffix}")
        assert found == pytest.approx(area)
        assert count == len(points) - 2


CUT_DAE = two(CUBE).replace("</p></polylist>", " 7</p></polylist>", 1)
SKIN = '<controller id="c"><skin source="#first"/></controller>'
SKINNED = '<node><instance_controller url="#c"/></node>' + placed("second", 5.0)
BOTH = geometry("first", CUBE) + geometry("second", CUBE)
DRACO = {"extensionsRequired": ["KHR_draco_mesh_compression"]}
INSTANCED: dict[str, Any] = {"extensions": {"EXT_mesh_gpu_instancing": {"attributes": {}}}}
TWICE = 2 * '<instance_node url="#n{0}"/>'
DOUBLED = '<node id="n40"/>' + "".join(
    f'<node id="n{row}">{TWICE.format(row + 1)}</node>' for row in range(40)
)
#: Files that are refused, and why.
BROKEN: dict[str, tuple[str, bytes | str, str]] = {
    "OBJ, empty": ("obj", "# nothing\n", "^it has no triangles$"),
    "OBJ, vertex 0": ("obj", obj() + "f 0 1 2\n", "vertex 0"),
    "OBJ, a vertex that is not there": ("obj", obj() + "f 1 2 9\n", "vertex 8, there are 0 to 7"),
    "OBJ, back too far": ("obj", "f -9 1 2\n" + obj(), "before the first"),
    "OBJ, a surface": ("obj", obj() + "surf 0 1 0 1 1 2 3 4\n", "free-form surfaces"),
    "OBJ, another file": ("obj", obj() + "call other.obj\n", "other files are not read"),
    "OBJ, decimal commas": ("obj", obj().replace("v 1.0", "v 0,5"), "'0,5' stands where a number"),
    "OBJ, words that are none": ("obj", obj() + "F 1 2 3\n", "'F', which OBJ does not know"),
    "STL, cut in its second solid": ("stl", solid() + solid("b", 10)[:-500], "cut"),
    "STL, cut text": ("stl", solid()[:-500], "cut"),
    "STL, cut": ("stl", records()[:-70], "declares 12 triangles and holds 10"),
    "STL, a word too much": (
        "stl",
        solid().replace("outer loop", "outer x", 1),
        "'x' stands where",
    ),
    "PLY, cut": ("ply", ply()[: -len(b"3 0 1 2\n") * 7], "'face'.* and holds 5|12 .* holds 5"),
    "PLY, cut binary": (
        "ply",
        ply("binary_little_endian")[: -13 * 7],
        "12 rows of 'face' and holds 5",
    ),
    "PLY, cut in its vertices": (
        "ply",
        ply("binary_big_endian")[:-200],
        "rows of 'vertex' and hold",
    ),
    "PLY, other things": (
        "ply",
        ply().replace(b"t face", b"t range_grid"),
        "'range_grid', which is",
    ),
    "PLY, more than declared": ("ply", ply() + b"3 0 1 2\n", "more than it declares"),
    "PLY, a vertex that is not there": ("ply", ply(sides=[(0, 1, 8)]), "vertex 8"),
    "OFF, cut": ("off", "\n".join(off().splitlines()[:-7]), "declares 12 faces and holds 5"),
    "OFF, binary": ("off", off("OFF BINARY"), "binary OFF"),
    "OFF, more dimensions": ("off", off("nOFF"), "nOFF"),
    "DAE, units": (
        "dae",
        dae(BOTH, TWO_NODES, '<unit meter="0"/>'),
        "its unit must be a positive number of metres, got '0'",
    ),
    "DAE, negative units": (
        "dae",
        dae(BOTH, TWO_NODES, '<unit meter="-1"/>'),
        "must be a positive number",
    ),
    "DAE, units with commas": (
        "dae",
        dae(BOTH, TWO_NODES, '<unit meter="0,01"/>'),
        "'0,01' stands",
    ),
    "DAE, a skin": (
        "dae",
        dae(BOTH, SKINNED, libraries=f"<library_controllers>{SKIN}</library_controllers>"),
        "has a skeleton",
    ),
    "DAE, a bad index": ("dae", two(polylist([(0, 1, 9)])), "geometry 'first': .* vertex 9"),
    "DAE, fewer corners than declared": ("dae", CUT_DAE, "geometry 'first'"),
    "DAE, no geometry": ("dae", dae("", "<node/>"), "has no geometry"),
    "DAE, none shown": ("dae", dae(BOTH, "<node/>"), "shows none of its 2 geometries"),
    "DAE, one that is not there": ("dae", dae(BOTH, placed("third")), "no geometry 'third'"),
    "DAE, another file": (
        "dae",
        dae("", '<node><instance_geometry url="b.dae#b"/></node>'),
        "other files",
    ),
    "DAE, a spline": (
        "dae",
        dae('<geometry id="g"><spline/></geometry>', placed("g")),
        "holds spline",
    ),
    "DAE, nodes in a circle": (
        "dae",
        dae(BOTH, '<node id="n"><instance_node url="#n"/></node>'),
        "levels",
    ),
    "DAE, nodes that double": (
        "dae",
        dae(BOTH, '<node><instance_node url="#n0"/></node>', libraries=DOUBLED),
        "more than 100000 nodes",
    ),
    "DAE, cut": ("dae", two(CUBE)[:-300], "not valid XML from line 1"),
    "GLB, cut": ("glb", gltf(FLOATS, FACES)[:-10], "declares .* bytes"),
    "GLB, Draco": ("glb", gltf(FLOATS, FACES, more=DRACO), "requires the extension KHR_draco"),
    "GLB, instances": ("glb", gltf(FLOATS, FACES, node=INSTANCED), "EXT_mesh_gpu_instancing"),
    "GLB, skin": ("glb", gltf(FLOATS, FACES, node={"skin": 0}), "moved by a skin"),
    "GLB, beyond its buffer": (
        "glb",
        gltf(FLOATS, FACES, accessor={"count": 900}),
        "reaches beyond",
    ),
    "GLB, no data": ("glb", gltf(FLOATS, FACES, primitive={"attributes": {}}), "has no POSITION"),
    "GLB, a bad index": ("glb", gltf(FLOATS, [0, 1, 8]), "vertex 8"),
    "GLB, four corners": ("glb", gltf(SQUARE), "4 corners do not form triangles"),
    "GLB, nodes in a circle": ("glb", gltf(FLOATS, FACES, node={"children": [0]}), "levels"),
    "GLB, wrong kinds": ("glb", gltf(FLOATS, FACES, more={"nodes": "a"}), "damaged"),
    "glTF 1": ("gltf", json.dumps({"asset": {"version": "1.0"}}), "export it as glTF 2.0"),
    "glTF, deep": ("gltf", "[" * 100_000, "not valid JSON"),
}


@each("name", BROKEN)
def test_what_is_missing_or_not_read_is_said(name: str) -> None:
    suffix, data, reason = BROKEN[name]
    with pytest.raises(ValueError, match=reason) as caught:
        measured(data, f"part.{suffix}")
    assert "Error" not in str(caught.value)
    assert len(str(caught.value)) < 300


def test_a_part_that_is_mirrored_still_faces_outwards() -> None:
    for inside in ("", "<scale>-1 1 1</scale>"):
        data = dae(geometry("first", CUBE), placed("first", 0, inside)).encode()
        points, faces = read_mesh(data, "part.dae")
        shown = points[faces]
        assert np.linalg.det(shown).sum() / 6 == pytest.approx(1.0), "its volume"


def test_groups_of_a_mesh_share_their_vertices() -> None:
    groups = "".join(polylist([side]) for side in SIDES)
    points, faces = read_mesh(dae(geometry("first", groups), placed("first")).encode(), "part.dae")
    assert (len(points), len(faces)) == (8, 12)


def test_buffers_of_gltf_are_text_in_the_file() -> None:
    points = base64.b64encode(SQUARE.tobytes()).decode()
    found = json.loads(gltf(SQUARE, mode=5)[20:].partition(b"BIN\0")[0][:-4].decode("latin-1"))
    found["buffers"][0] = {"uri": f"data:x/y;base64,{points}", "byteLength": 48}
    del found["meshes"][0]["primitives"][0]["indices"]
    assert measured(json.dumps(found), "part.gltf")[0] == pytest.approx(1.0)

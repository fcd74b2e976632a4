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

"""OBB trees over triangle meshes (Gottschalk, Lin, Manocha 1996), many of them as arrays.

A node is split in two along its longest axis at the mean of its triangles' centroids, or in
halves where that is too lopsided, down to a few triangles. Every node's box certainly contains
its triangles: in exact arithmetic, for the doubles as stored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.shapes.primitives import LocalBox
from obb_collision.geometry.trees.build import HALF, NODE, build_tree
from obb_collision.geometry.validation import (
    as_any_array,
    as_array,
    as_half_extents,
    as_rotations,
    as_whole,
)
from obb_collision.geometry.values import ForKernels
from obb_collision.typing import Floats, Integers
from obb_collision.words import shown

Arrays = Mapping[str, NDArray[Any]]

#: Maximum number of levels of a tree: 2^31 triangles have 75, stacks have room for 128 per tree.
MAX_LEVELS = 100


def checked_arrays(values: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Return checked copies of the arrays of ``MeshTrees`` by name; else ValueError.

    Copies, as checked arrays must not change later.
    """
    arrays = {name: np.array(values[name], order="C") for name in KINDS}
    sizes: dict[str, int] = {}
    for name, (kind, shape) in KINDS.items():
        array = arrays[name]
        if array.dtype != kind or array.ndim != len(shape):
            raise ValueError(f"{name} must be {kind.__name__} of {len(shape)} dimensions")
        for size, got in zip(shape, array.shape, strict=True):
            if got != (size if isinstance(size, int) else sizes.setdefault(size, got)):
                raise ValueError(f"{name} must have as many rows as the arrays it belongs to")
    if sizes["k"] < 1 or sizes["s"] != sizes["k"] + 1:
        raise ValueError("piece_starts must have one row more than roots, which must not be empty")
    _check_nodes(arrays, sizes)
    _within(arrays["roots"], sizes["m"] - 1, "roots")
    _within(arrays["piece_starts"], sizes["p"], "piece_starts")
    if (np.diff(arrays["piece_starts"]) < 0).any():
        raise ValueError("piece_starts must not decrease")
    if (arrays["faces"] < 0).any():
        raise ValueError("faces must not be negative")
    for name in ("triangles", "nodes", "radii", "pieces"):
        if not np.isfinite(arrays[name]).all():
            raise ValueError(f"{name} must be finite")
    return arrays


def _check_nodes(arrays: Arrays, sizes: Mapping[str, int]) -> None:
    children, levels, starts = arrays["children"], arrays["levels"], arrays["starts"]
    parents = np.flatnonzero(children >= 0)
    first = children[parents]
    if (children < -1).any() or (first >= sizes["m"] - 1).any() or (first <= parents).any():
        raise ValueError("children must be -1 or the first of two rows after their parent's")
    if len(np.unique(first)) < len(first):
        raise ValueError("children must have one parent")
    _within(levels, MAX_LEVELS, "levels")
    if any((levels[first + k] != levels[parents] + 1).any() for k in range(2)):
        raise ValueError("levels must be one more than their parents'")
    _within(starts, sizes["f"], "starts")
    if (starts[:, 0] > starts[:, 1]).any():
        raise ValueError("starts must be ranges of triangles, the first not above the last")


def _within(array: NDArray[Any], maximum: int, name: str) -> None:
    if ((array < 0) | (array > maximum)).any():
        raise ValueError(f"{name} must be from 0 to {maximum}")


#: Triangles per leaf. Two halve the number of nodes and are up to 20 % faster on regular meshes
#: such as a ball, but 50 % slower on the long thin triangles of real ones.
LEAF = 1


class TreeArrays(NamedTuple):
    """The arrays of ``MeshTrees``, by the same names, for kernels."""

    triangles: Floats
    faces: Integers
    counted: NDArray[np.bool_]
    nodes: Floats
    children: Integers
    starts: Integers
    levels: Integers
    roots: Integers
    solid: NDArray[np.bool_]
    winding: NDArray[np.bool_]
    radii: Floats
    pieces: Floats
    piece_starts: Integers


@cache
def no_trees() -> TreeArrays:
    """Return the arrays of no mesh."""
    kinds = (
        (kind, [0 if isinstance(n, str) else n for n in shape]) for kind, shape in KINDS.values()
    )
    return TreeArrays(*(np.empty(shape, kind) for kind, shape in kinds))


def _of(kind: type, *shape: str | int) -> dict[str, Any]:
    """Return type and shape of an array: f triangles, m nodes, k meshes, p pieces, s = k + 1."""
    return {"kind": (kind, shape)}


@dataclass(frozen=True, eq=False)
class MeshTrees(ForKernels):
    """OBB trees of k meshes, metres, each in the frame of its mesh.

    triangles (f, 9): the three corners, those of a node in consecutive rows; faces (f,): the face
    of its mesh; counted (f,): whether it counts for inside and outside (see ``boundary_faces``).
    nodes (m, 16): centre 3, rotation 9 row by row, half extents 3, size; children (m,): the first
    of two adjacent rows, -1 for a leaf; starts (m, 2): the first of its triangles and the one
    after the last; levels (m,): 0 for the root. Per mesh: roots; solid; winding (inside is where
    the surface winds about a point, else where a ray crosses it an odd number of times); radii,
    the largest distance from the origin; ``pieces[piece_starts[i]:piece_starts[i + 1]]``,
    (p, 6, 3) corners of each connected piece.

    Examples
    --------
    >>> tree = oc.MeshTrees.build([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> len(tree), tree.solid.tolist()
    (1, [False])
    """

    triangles: Floats = field(metadata=_of(np.float64, "f", 9))
    faces: Integers = field(metadata=_of(np.int64, "f"))
    counted: NDArray[np.bool_] = field(metadata=_of(np.bool_, "f"))
    nodes: Floats = field(metadata=_of(np.float64, "m", NODE))
    children: Integers = field(metadata=_of(np.int64, "m"))
    starts: Integers = field(metadata=_of(np.int64, "m", 2))
    levels: Integers = field(metadata=_of(np.int64, "m"))
    roots: Integers = field(metadata=_of(np.int64, "k"))
    solid: NDArray[np.bool_] = field(metadata=_of(np.bool_, "k"))
    winding: NDArray[np.bool_] = field(metadata=_of(np.bool_, "k"))
    radii: Floats = field(metadata=_of(np.float64, "k"))
    pieces: Floats = field(metadata=_of(np.float64, "p", 6, 3))
    piece_starts: Integers = field(metadata=_of(np.int64, "s"))
    arrays: TreeArrays = field(init=False, repr=False)
    """The arrays, for kernels."""

    def __post_init__(self) -> None:
        arrays = TreeArrays(**checked_arrays(vars(self)))
        vars(self).clear()  # of the arguments
        vars(self)["arrays"] = arrays

    @classmethod
    def trusted(cls, **arrays: NDArray[Any]) -> MeshTrees:
        """Return trees of valid arrays by name, neither checked nor copied."""
        trees = object.__new__(cls)
        vars(trees)["arrays"] = TreeArrays(**arrays)
        return trees

    @classmethod
    def build(
        cls,
        vertices: ArrayLike,
        faces: ArrayLike,
        solid: bool | None = None,
        leaf: int = LEAF,
        root: LocalBox | None = None,
    ) -> MeshTrees:
        """Return the tree of one mesh.

        Parameters
        ----------
        vertices : (n, 3) array_like
            Metres.
        faces : (m, 3) array_like of int
            Indices of vertices; at least one face.
        solid : bool, optional
            Whether it is a body, which must be watertight; by default whether it is watertight.
        leaf : int
            Maximum number of triangles per leaf.
        root : tuple, optional
            A box that certainly contains all triangles, for the first node: centre, rotation, half
            extents.

        References
        ----------
        Gottschalk, Lin, Manocha, OBBTree (SIGGRAPH 1996).

        Examples
        --------
        >>> tree = oc.MeshTrees.build([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        >>> len(tree)
        1
        """
        mesh = Mesh(vertices, faces)
        size = as_whole(leaf, "leaf", 1)
        if root is not None:
            center, rotation, half_extents = root
            root = (
                as_array(center, "root's centre", (3,)),
                as_rotations(rotation, "root's rotation", (3, 3)),
                as_half_extents(half_extents, "root's half extents", (3,)),
            )
        return cls.of(mesh.vertices, mesh.faces, solid, size, root)

    @classmethod
    def of(
        cls,
        vertices: Floats,
        faces: Integers,
        solid: bool | None = None,
        leaf: int = LEAF,
        root: LocalBox | None = None,
    ) -> MeshTrees:
        """Return the tree of valid arrays, as ``build``.

        Coordinates may exceed MAX_MAGNITUDE, as a hull about valid points can.
        """
        if len(faces) == 0:
            raise ValueError("faces must not be empty")
        merged = merged_faces(vertices, faces)
        boundary, closed = boundary_faces(merged)
        if solid and not closed:
            raise ValueError("solid must not be true for a mesh that is not watertight")
        counted = np.zeros(len(merged), np.bool_)
        counted[boundary] = True
        triangles = vertices[faces].reshape(-1, 9)
        order, nodes, children, starts, levels = build_tree(triangles, leaf)
        if root is not None:
            center, rotation, half_extents = root
            nodes[0] = np.r_[center, rotation.ravel(), half_extents, half_extents.sum()]
        pieces = vertices[piece_corners(vertices, merged)]
        return cls.trusted(
            triangles=triangles[order],
            faces=order,
            counted=counted[order],
            nodes=nodes,
            children=children,
            starts=starts,
            levels=levels,
            roots=np.zeros(1, np.int64),
            solid=np.array([closed if solid is None else solid]),
            winding=np.array([closed and is_oriented(merged[boundary])]),
            radii=np.array([_radius(triangles, nodes)]),
            pieces=pieces,
            piece_starts=np.array([0, len(pieces)]),
        )

    @classmethod
    def from_half_extents(cls, half_extents: ArrayLike) -> MeshTrees:
        """Return the trees of k solid boxes about the origin, half extents (k, 3) metres.

        Parameters
        ----------
        half_extents : (k, 3) array_like
            Metres.

        Examples
        --------
        >>> len(oc.MeshTrees.from_half_extents([[1, 1, 1], [1, 2, 3]]))
        2
        """
        sizes = as_any_array(half_extents, "half_extents", "numbers of shape (k, 3)")
        rows = as_half_extents(sizes[None] if sizes.ndim == 1 else sizes, "half_extents", (None, 3))
        if not len(rows):
            raise ValueError("half_extents must not be empty")
        return cls.join([cls.of(BOX_CORNERS * row, BOX_FACES) for row in rows])

    @classmethod
    def join(cls, trees: Sequence[MeshTrees]) -> MeshTrees:
        """Return the meshes of several trees as one ``MeshTrees``, in order.

        Parameters
        ----------
        trees : sequence of MeshTrees
            At least one.

        Examples
        --------
        >>> tree = oc.MeshTrees.build([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        >>> len(oc.MeshTrees.join([tree, tree]))
        2
        """
        if not isinstance(trees, Sequence) or not all(isinstance(t, MeshTrees) for t in trees):
            raise TypeError(f"trees must be a sequence of MeshTrees, got {shown(trees)}")
        if not trees:
            raise ValueError("trees must not be empty")
        parts, sizes = [], dict.fromkeys(("nodes", "triangles", "pieces"), 0)
        for tree in trees:
            arrays = tree.arrays._asdict()
            parts.append(arrays | shifted(arrays, **sizes))
            sizes = {name: size + len(arrays[name]) for name, size in sizes.items()}
        return cls.trusted(
            **{name: np.concatenate([part[name] for part in parts]) for name in KINDS}
        )

    def __len__(self) -> int:
        return len(self.arrays.roots)

    def boxes(self, index: int, depth: int) -> Boxes:
        """Return the boxes of mesh ``index`` at a depth, at most 2^depth, in the mesh's frame.

        ``oc.Boxes(*boxes.arrays)[k]`` is box k as an ``OBB``.

        Parameters
        ----------
        index : int
            Row of the mesh.
        depth : int
            0 is one box.

        Examples
        --------
        >>> tree = oc.MeshTrees.build([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        >>> len(tree.boxes(0, 0))
        1
        """
        rows = self.rows(index, depth)
        rotations = self.nodes[rows, 3:HALF].reshape(-1, 3, 3)
        return Boxes.trusted(
            self.nodes[rows, :3].copy(), rotations.copy(), self.nodes[rows, HALF : HALF + 3].copy()
        )

    def rows(self, index: int, depth: int) -> Integers:
        """Return the nodes at a depth and the leaves above it, which contain all triangles."""
        index, depth = as_whole(index, "index", 0, len(self) - 1), as_whole(depth, "depth")
        last = self.roots[index + 1] if index + 1 < len(self) else len(self.nodes)
        rows = np.arange(self.roots[index], last)
        leaf = self.children[rows] < 0
        level = self.levels[rows]
        return rows[(level == depth) | (leaf & (level < depth))]


#: Kind and shape of each array.
KINDS: Mapping[str, tuple[type, tuple[str | int, ...]]] = {
    f.name: f.metadata["kind"] for f in fields(MeshTrees) if f.metadata
}


def shifted(arrays: Arrays, nodes: int, triangles: int, pieces: int) -> dict[str, NDArray[Any]]:
    """Return the arrays of row numbers, raised by the counts of rows in earlier trees."""
    children = arrays["children"]
    return {
        "children": np.where(children < 0, -1, children + nodes),
        "starts": arrays["starts"] + triangles,
        "roots": arrays["roots"] + nodes,
        "piece_starts": arrays["piece_starts"][1 if triangles else 0 :] + pieces,
    }


#: Corners (8, 3) and outward faces (12, 3) of the box of half extents one.
BOX_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
BOX_FACES = np.array(_SIDES)[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)


def _radius(triangles: Floats, nodes: Floats) -> float:
    """Return a bound on the distance of every triangle and node box from the origin, metres."""
    sizes = np.abs(nodes[:, :3]).sum(axis=1) + nodes[:, HALF : HALF + 3].sum(axis=1)
    return float(max(np.abs(triangles).max() * 2.0, sizes.max()))


# The topology of a mesh: whether it is closed and oriented, and its connected pieces.

#: Bits of a vertex number, three of which fit into one number.
VERTEX_BITS = 21


def merged_faces(vertices: Floats, faces: Integers) -> Integers:
    """Return faces (m, 3) with equal vertices (n, 3) merged, in the same order.

    Files often store corners per triangle (STL always does).
    """
    # adding zero makes -0.0 equal to 0.0 bit for bit
    keys = np.ascontiguousarray(vertices + 0.0).view([("", vertices.dtype)] * 3).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return first[inverse.ravel()][faces]


def boundary_faces(faces: Integers) -> tuple[Integers, bool]:
    """Return (k,) the faces that may bound a solid, and whether they are closed (``is_closed``).

    Faces with a repeated corner never do; of copies of a face one does. Copies of opposite
    orientation count as copies, as in a double-sided mesh; where that leaves the surface open,
    they may be walls between two solids, and both count.
    """
    corners = np.sort(faces, axis=1)
    whole = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2])
    rows = np.flatnonzero(whole)
    first = _first_of_each(corners[rows])
    single = np.sort(rows[first])
    if is_closed(faces[single]):
        return single, True
    turned = np.take_along_axis(faces, (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    first = _first_of_each(turned[rows])
    double = np.sort(rows[first])
    return (double, True) if is_closed(faces[double]) else (single, False)


def _first_of_each(rows: Integers) -> Integers:
    """Return the first row of each group of equal rows (m, 3), not negative."""
    if len(rows) == 0 or rows.max() >= 1 << VERTEX_BITS:
        return np.asarray(np.unique(rows, axis=0, return_index=True)[1])
    # one number per row sorts ten times as fast
    keys = (rows[:, 0] << 2 * VERTEX_BITS) | (rows[:, 1] << VERTEX_BITS) | rows[:, 2]
    return np.asarray(np.unique(keys, return_index=True)[1])


def is_oriented(faces: Integers) -> bool:
    """Return whether faces use every edge as often in one direction as in the other.

    Then the surface winds about each point a whole number of times, and inside is where that is
    not zero, also where several solids overlap.
    """
    edges = _edges(faces)
    forward = edges[:, 0] < edges[:, 1]
    keys = _edge_keys(edges)
    order = np.argsort(keys, kind="stable")
    starts = _starts(keys[order])
    return bool((np.add.reduceat(np.where(forward, 1, -1)[order], starts) == 0).all())


def is_closed(faces: Integers) -> bool:
    """Return whether every edge of faces (m, 3) borders an even number of faces, and faces exist.

    Inside and outside by counting crossings require it. A manifold has two faces at every
    edge; solids that share an edge have four.
    """
    if len(faces) == 0:
        return False
    keys = np.sort(_edge_keys(_edges(faces)))
    return bool((np.diff(np.r_[_starts(keys), len(keys)]) % 2 == 0).all())


def _edges(faces: Integers) -> Integers:
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def _edge_keys(edges: Integers) -> Integers:
    """Return one number (k,) for the two ends (k, 2) of an edge, independent of direction."""
    return (edges.min(axis=1) << 32) | edges.max(axis=1)


def _starts(keys: Integers) -> Integers:
    """Return where runs of equal numbers start."""
    return np.flatnonzero(np.r_[True, keys[1:] != keys[:-1]])


def piece_corners(vertices: Floats, faces: Integers) -> Integers:
    """Return (k, 6) vertices of each connected piece of the surface: the extremes along x, y, z.

    Several, so that some are far from any surface that a piece rests on.
    """
    from scipy.sparse import coo_matrix  # here, as it takes 0.1 s
    from scipy.sparse.csgraph import connected_components

    pairs = np.concatenate([faces[:, :2], faces[:, 1:]])
    size = int(faces.max()) + 1
    graph = coo_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), (size, size))
    _, labels = connected_components(graph, directed=False)
    used = np.unique(faces)
    extremes = []
    for k in range(3):
        order = used[np.lexsort((vertices[used, k], labels[used]))]
        change = np.flatnonzero(np.diff(labels[order])) + 1
        extremes += [order[np.r_[0, change]], order[np.r_[change, len(order)] - 1]]
    return np.stack(extremes, axis=1)

"""The shapes of objects, all in one place: each knows its ``local_box`` in its own frame."""

from __future__ import annotations

from obb_collision.geometry.meshes import Hull, Mesh, resolve_path
from obb_collision.geometry.primitives import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    LocalBox,
    Shape,
    Sphere,
)

__all__ = [
    "Box",
    "Capsule",
    "Cone",
    "Cylinder",
    "Ellipsoid",
    "Hull",
    "LocalBox",
    "Mesh",
    "Shape",
    "Sphere",
    "resolve_path",
]

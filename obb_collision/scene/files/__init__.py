"""Scene files: a scene with its rules and effects in one YAML file, and MoveIt planning scenes.

``load_scene`` reads either. ``docs/scene_files.md`` describes the format.
"""

from obb_collision.scene.files.description import (
    AllowedRule,
    EffectChoice,
    SceneDescription,
    SceneObject,
)
from obb_collision.scene.files.errors import SceneFileError
from obb_collision.scene.files.load import READY, find_scene, load_scene

__all__ = [
    "READY",
    "AllowedRule",
    "EffectChoice",
    "SceneDescription",
    "SceneFileError",
    "SceneObject",
    "find_scene",
    "load_scene",
]

"""Pairs that may touch, as a parameter and in the scene."""

from __future__ import annotations

from collections.abc import Sequence

from obb_collision.scene.scene import Scene

AllowedPair = tuple[str, str]
"""Two patterns of names: objects that match them may touch."""


def allowed_from_text(text: str) -> AllowedPair:
    """Read ``PATTERN PATTERN``; ValueError for anything else."""
    words = text.split()
    if len(words) != 2:
        raise ValueError(f"{text!r} is not two names or patterns like 'robot/* table/1'")
    return words[0], words[1]


def set_allowed(scene: Scene, old: Sequence[AllowedPair], new: Sequence[AllowedPair]) -> None:
    """Replace pairs that may touch."""
    for first, second in old:
        scene.allow(first, second, False)
    for first, second in new:
        scene.allow(first, second)

"""Parameters of the node by which it does what a scene file says."""

from __future__ import annotations

from typing import Any

import numpy as np

from obb_collision.node.demo.file_scene import FileScene
from obb_collision.node.parameter_table import SPECS
from obb_collision.scene.files import SceneDescription
from obb_collision.scene.files.description import NODE_EFFECTS
from obb_collision.scene.patterns import matching


def parameters_of(scene: FileScene) -> dict[str, Any]:
    """Return values by name; objects are named as on the topics."""
    said, names = scene.description, np.array(scene.names, object)
    rungs = [
        f"{name}: {rung.name.lower()}"
        for name, rung in zip(scene.names, said.object_accuracies(), strict=True)
        if rung is not None
    ]
    values: dict[str, Any] = {
        "padding": said.padding,
        "accuracy": said.accuracy.name.lower(),
        "accuracy_overrides": rungs,
        "allowed_pairs": _allowed_pairs(said, scene.names),
        "time_budget": said.time_budget,
    }
    for effect, choice in said.effects.items():
        values[f"effects.{effect}"] = choice.mode
        if choice.objects is not None and effect not in NODE_EFFECTS:
            found = names[matching(choice.objects, said.names)].tolist()
            values[f"effects.{effect}_objects"] = found
        for key, value in choice.options.items():
            values[f"effects.{effect}_{key}"] = value
    kinds = {spec.name: type(spec.default) for spec in SPECS}
    return {
        name: kinds[name](value)
        for name, value in values.items()
        if name in kinds and value not in (None, [])
    }


def _allowed_pairs(said: SceneDescription, names: list[str]) -> list[str]:
    """Return the pairs of objects that may touch, as rules if the topics have the same names."""
    if names == said.names and all(rule.allowed for rule in said.allowed):
        return [f"{rule.first} {rule.second}" for rule in said.allowed]
    table = np.zeros((len(names), len(names)), np.bool_)
    for rule in said.allowed:
        one, other = (matching([pattern], said.names) for pattern in (rule.first, rule.second))
        table[np.outer(one, other) | np.outer(other, one)] = rule.allowed
    rows = np.argwhere(np.triu(table, 1)).tolist()
    return [f"{names[i]} {names[j]}" for i, j in rows]

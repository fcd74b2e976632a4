"""The effects of a scene: one module each, and one line here."""

from __future__ import annotations

from obb_collision.scene.effects.base import Effect
from obb_collision.scene.effects.clearance import Clearance
from obb_collision.scene.effects.contacts import ContactPatches
from obb_collision.scene.effects.points import Points
from obb_collision.scene.effects.separations import Separations
from obb_collision.scene.effects.sweep import Sweep

EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (Separations(), ContactPatches(), Clearance(), Sweep(), Points())
}

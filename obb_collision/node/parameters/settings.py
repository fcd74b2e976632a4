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

"""Parameters -> settings of the scene, each set only when it changes."""

from __future__ import annotations

from typing import Any

from obb_collision._threads import set_threads
from obb_collision.accuracy import as_accuracy
from obb_collision.node.messages.conversions import NANOSECONDS, name_from_key
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.shape_requests import ShapeLimits
from obb_collision.node.objects.states import BY_STAMP, AgeLimits
from obb_collision.node.parameters.entries import Groups
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.scene.building.builder import Limits
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.settings import AUTO, OFF
from obb_collision.scene.store.allowed import Rule
from obb_collision.scene.store.patterns import Overrides

MEGABYTE = 1_000_000


class SceneParameters:
    """Applies parameters to the scene; allowed: rules before those of the parameters."""

    def __init__(self, parameters: Parameters, objects: Objects, allowed: list[Rule]) -> None:
        self._parameters, self._objects, self._allowed = parameters, objects, allowed
        self._filters: tuple[object, ...] = ()
        self._effects: dict[str, Any] = {}
        self._threads: int | None = None

    def apply(self) -> None:
        """Apply the parameters to the scene."""
        parameters, scene = self._parameters, self._objects.scene
        if self._threads != parameters.threads:
            set_threads(parameters.threads or None)
            self._threads = parameters.threads
        for name in ("padding", "max_pairs"):
            _set(scene, name, getattr(parameters, name))
        _set(scene, "time_budget", parameters.time_budget or None)
        _set(scene, "accuracy", as_accuracy(parameters.accuracy))
        groups = Groups(parameters.groups)
        overrides = Overrides(groups.overrides(parameters.accuracy_overrides))
        if overrides.overrides != self._objects.shapes.overrides.overrides:
            self._objects.set_overrides(overrides)
        self._apply_filters()
        self._apply_effects()

    def _apply_effects(self) -> None:
        """Set the effects, and the region: its halo depends on them."""
        parameters, scene = self._parameters, self._objects.scene
        groups = Groups(parameters.groups)
        settings: dict[str, Any] = {}
        for name in EFFECTS:
            mode = OFF if parameters.mode(name) == OFF else AUTO  # requested per check: never "on"
            setting = settings[name] = {"mode": mode, **parameters.setting(name)}
            setting["objects"] = groups.all_meant(setting["objects"])
        if self._effects != settings or scene.region != parameters.share:
            scene.region = None  # its halo fits the new options, maybe not the old ones
            for name, setting in settings.items():
                if self._effects.get(name) != setting:
                    scene.set_effect(name, **setting)
            self._effects, scene.region = settings, parameters.share

    def _apply_filters(self) -> None:
        """Set which pairs count, and the paddings by name."""
        parameters, scene = self._parameters, self._objects.scene
        groups = Groups(parameters.groups)
        pairs = [(*groups.sides(pair), True) for pair in parameters.allowed_pairs]
        only = [groups.sides(pair) for pair in parameters.check_only_pairs]
        filters = ([*self._allowed, *pairs], only, parameters.allowed_within)
        if self._filters != filters:
            rules = scene.rules
            rules.allowed, rules.check_only, rules.allowed_within = filters
            self._filters = filters
        _set(scene.objects, "padding_overrides", groups.overrides(parameters.padding_overrides))


def _set(scene: Any, name: str, value: object) -> None:
    """Set what differs: the scene starts anew with what depends on it."""
    if getattr(scene, name) != value:
        setattr(scene, name, value)


def apply_limits(parameters: Parameters, objects: Objects) -> None:
    """Apply the limits of objects and states."""
    shapes, table = objects.shapes, objects.table
    shapes.max_objects, objects.max_points = parameters.max_objects, parameters.max_cloud_points
    objects.set_limits(build_limits(parameters))
    shapes.requests.limits = ShapeLimits(
        parameters.mesh_file_size * MEGABYTE,
        parameters.max_triangles,
        parameters.max_cloud_points,
        parameters.folders,
    )
    longest = parameters.max_name_length
    table.namespaces.max_bytes = objects.placement.frame_table.max_bytes = longest
    objects.placement.timeout = parameters.transform_timeout
    objects.states.stamp_tolerance = int(parameters.stamp_tolerance * NANOSECONDS)
    objects.states.order_timeout = int(parameters.order_timeout * NANOSECONDS)
    by_stamp = parameters.judge_ages == BY_STAMP
    objects.states.by_stamp = objects.placement.latest.by_stamp = by_stamp
    groups = Groups(parameters.groups, parameters.robots)
    timeouts = groups.overrides(parameters.object_timeout_overrides)
    policies = groups.overrides(parameters.stale_policy_overrides)
    for source in parameters.source_settings:
        timeouts.append((name_from_key(source.key), source.timeout))
        policies.append((name_from_key(source.key), source.stale_policy))
    objects.staleness.limits = AgeLimits(
        parameters.object_timeout,
        Overrides(timeouts),
        parameters.stale_policy,
        Overrides(policies),
        parameters.stale_speed,
        parameters.stale_reach,
    )


def build_limits(parameters: Parameters) -> Limits:
    """Return the limits of the process that builds shapes."""
    return Limits(
        parameters.shape_timeout,
        parameters.shape_memory * MEGABYTE,
        parameters.shape_queue * MEGABYTE,
    )

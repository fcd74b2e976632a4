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

"""The effect ``points``: clouds in the boxes of a scene."""

from typing import Any

import numpy as np
import pytest
from scenes import filled_scene

import obb_collision as oc
from obb_collision.scene.effects import points as module


def test_every_object_knows_its_points() -> None:
    scene = filled_scene(20)
    cloud = np.random.default_rng(3).uniform(-2, 2, (3000, 3)).astype(np.float32)
    cloud[7] = np.nan
    scene.obstacle_points = cloud
    found = scene.check().points_inside
    assert found.indices.tolist() == scene.indices.tolist()
    assert found.ignored == 1
    for name, row in zip(scene.names, range(len(found)), strict=True):
        held = np.flatnonzero(scene.obb(name).contains(np.nan_to_num(cloud, nan=1e6)))
        assert found.counts[row] == len(held)
        assert found.first[row] == (held[0] if len(held) else -1)
    assert found.counts.sum() > 100


def test_margin_callers_and_disabled_objects() -> None:
    scene = oc.Scene()
    for name, x in (("zone/1", 0.0), ("zone/2", 5.0), ("other/1", 0.0)):
        scene.add(name, oc.shapes.Box([1, 1, 1]), [x, 0, 0, 0, 0, 0, 1])
    scene.obstacle_points = [[0.75, 0.0, 0.0], [5.0, 0.0, 0.0]]
    scene.set_effect("points", objects="zone/*", margin=0.25)
    found = scene.check().points_inside
    assert found.indices.tolist() == [0, 1]
    assert found.counts.tolist() == [1, 1]
    assert found.nearest.tolist() == [0, 1]
    scene.set_enabled("zone/2", False)
    assert scene.check().points_inside.indices.tolist() == [0]


def test_a_new_cloud_is_looked_at_and_none_costs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    query = module.points_in_bodies  # type: ignore[attr-defined]

    def counted(boxes: Any, bodies: Any, points: Any, *rest: Any) -> Any:
        calls.append(len(points))
        assert bodies is None
        return query(boxes, bodies, points, *rest)

    monkeypatch.setattr(module, "points_in_bodies", counted)
    scene = oc.Scene()
    scene.add("zone", oc.shapes.Box([1, 1, 1]))
    scene.set_effect("points", "on")
    assert scene.check().points_inside.counts.tolist() == [0]
    scene.obstacle_points = np.zeros((0, 3))
    scene.check()
    assert calls == []
    scene.obstacle_points = np.zeros((4, 3))
    assert scene.check().points_inside.counts.tolist() == [4]
    scene.obstacle_points = np.zeros((2, 3))
    assert scene.check().points_inside.counts.tolist() == [2]
    assert calls == [4, 2]
    wrong: Any
    for wrong in (np.zeros((3, 2)), ["x"]):
        with pytest.raises(ValueError, match="points must"):
            scene.obstacle_points = wrong

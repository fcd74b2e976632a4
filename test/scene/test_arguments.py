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

"""What a scene refuses, where silence would hide a mistake."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from each import each

import obb_collision as oc
from obb_collision.shapes import Box, Sphere


def pile() -> oc.Scene:
    scene = oc.Scene(accuracy="hull")
    for k, shape in enumerate((Box([1, 1, 1]), Sphere(0.5), oc.shapes.Cone(0.5, 1.0))):
        scene.add(f"thing/{k}", shape, [0.4 * k, 0, 0, 0, 0, 0, 1])
    return scene


def test_a_name_that_is_taken_is_refused_where_asked() -> None:
    scene = pile()
    scene.add("new", Sphere(0.1), replace=False)
    with pytest.raises(ValueError, match=r"name must be new, as replace is False, got 'new'"):
        scene.add("new", Sphere(0.2), replace=False)
    assert scene.objects.shape_of("new") == Sphere(0.1)
    assert scene.add("new", Sphere(0.2)) == scene.index("new")


def test_a_rule_for_no_object_is_refused_where_asked() -> None:
    scene = pile()
    scene.allow("to come", "thing/*")
    rules = scene.rules.allowed
    for sides in (("thin/0", "thing/*"), ("thing/*", ["thing/0", "thin/0"])):
        with pytest.raises(ValueError, match=r"got 'thin/0'; did you mean thing/0"):
            scene.allow(*sides, known=True)
    assert scene.rules.allowed == rules
    scene.allow("thing/[01]", "thing/2", known=True)
    assert scene.check().names() == [("thing/0", "thing/1")]


@each("copied", [copy.copy, copy.deepcopy, pickle.dumps])
@each("made", [oc.Scene, lambda: oc.RobotScene(oc.Robot.from_urdf(
    '<robot name="arm"><link name="hand"/></robot>'))])  # fmt: skip
def test_a_scene_is_not_copied(made: Callable[[], Any], copied: Callable[[Any], Any]) -> None:
    with pytest.raises(TypeError, match="Scene can be neither copied nor pickled"):
        copied(made())


def test_effects_are_read_only_and_the_next_check_has_them_as_they_were() -> None:
    scene = pile()
    scene.obstacle_points = np.zeros((3, 3))
    effects = ["separations", "contacts", "clearance", "sweep", "points"]
    scene.check(effects)
    report = scene.check(effects)
    tables = [report.result(effect) for effect in effects]
    tables += [report.swept.passed, report.swept.predicted]
    arrays = [value for each in tables for value in vars(each).values() if hasattr(value, "flags")]
    full = [array for array in arrays if array.size]
    assert len(full) > 15
    assert not any(array.flags.writeable for array in full)

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

"""Scene files: what they say is what the scene does, and what is wrong is told by line and key."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

import obb_collision as oc
from obb_collision.scene_files import SceneFileError, load_scene
from obb_collision.scene_files.objects import unit
from obb_collision.shapes import Box, Cylinder, Hull, Mesh, Sphere

GOOD = """\
name: small
groups:
  hand: [hand/*]
  things: ["cup/*", box]
allowed:
  - [hand, hand]
  - [things, table/0]
accuracy:
  default: sphere
  hand: mesh
  hand/1: hull
padding: 1e-3
effects:
  separations: {mode: on, objects: hand}
  markers: off
objects:
  - {name: table/0, shape: box, size: [2, 1, 5e-1], position: [0, 0, 0.25], padding: 0}
  - name: cup/0
    shape: cylinder
    radius: 0.125
    length: .25
    position: [0.5, 0, 0.625]
    color: [1, 0.5, 0]
  - {name: box, shape: box, size: [1, 1, 1], rpy: [0, 0, 0.5], scale: 0.5, accuracy: aabb}
  - {name: hand/0, shape: sphere, radius: 1, scale: [1, 2, 3], quaternion: [0, 0, 0.6, 0.8]}
  - {name: hand/1, shape: hull, points: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]}
"""


@pytest.fixture
def write(tmp_path: Path) -> Any:
    """Return a function that writes a scene file and returns its path."""

    def write(text: str) -> Path:
        path = tmp_path / "scene.yaml"
        path.write_text(text)
        return path

    return write


def test_what_a_file_says_is_what_the_scene_has(write: Any) -> None:
    description = load_scene(write(GOOD))
    assert description.name == "small"
    assert description.names == ["table/0", "cup/0", "box", "hand/0", "hand/1"]
    assert description.groups == {"hand": ("hand/*",), "things": ("cup/*", "box")}
    cup = description.objects[1]
    assert (cup.shape, cup.color) == (Cylinder(0.125, 0.25), (1.0, 0.5, 0.0, 1.0))
    assert description.objects[3].shape == Sphere(1.0, (1, 2, 3))
    assert description.effects["markers"].mode == "off"

    scene = description.build()
    expected = oc.Scene(padding=1e-3, accuracy="sphere")
    expected.add("table/0", Box([2, 1, 0.5]), [0, 0, 0.25, 0, 0, 0, 1], padding=0.0)
    expected.add("cup/0", Cylinder(0.125, 0.25), [0.5, 0, 0.625, 0, 0, 0, 1])
    turn = [0, 0, np.sin(0.25), np.cos(0.25)]
    expected.add("box", Box([0.5, 0.5, 0.5]), [0, 0, 0, *turn], accuracy="aabb")
    expected.add("hand/0", Sphere(1, (1, 2, 3)), [0, 0, 0, 0, 0, 0.6, 0.8], accuracy="mesh")
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    expected.add("hand/1", Hull(points), accuracy="hull")
    for part in ("centers", "rotations", "half_extents"):
        np.testing.assert_allclose(
            getattr(scene.boxes, part), getattr(expected.boxes, part), rtol=0, atol=1e-15
        )
    expected.allow("hand/*", "hand/*")
    expected.allow("cup/*", "table/0")
    expected.allow("box", "table/0")
    assert scene.rules.allowed == expected.rules.allowed
    assert scene.check().names() == expected.check().names()
    assert scene.check().accuracies.tolist() == expected.check().accuracies.tolist()
    setting = scene.effects["separations"]
    assert (setting.mode, setting.objects) == ("on", ("hand/*",))


SHELF = (Path(__file__).parents[1] / "data" / "moveit" / "shelf.yaml").read_text()


def test_meshes_are_found_beside_their_file_and_shared(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    lines = ["v 0 0 0", "v 2 0 0", "v 0 2 0", "v 0 0 2", "f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    (tmp_path / "parts" / "tip.obj").write_text("\n".join(lines))
    entries = [f"- {{name: tip/{k}, shape: mesh, file: parts/tip.obj, scale: 0.5}}" for k in (0, 1)]
    path = tmp_path / "scene.yaml"
    path.write_text("objects:\n" + "\n".join(entries))
    one, two = (thing.shape for thing in load_scene(path).objects)
    assert one is two
    assert isinstance(one, Mesh)
    assert one.vertices.max() * one.scale[0] == 1.0


NUMBERS = st.floats(-1e6, 1e6).filter(lambda x: x == 0.0 or abs(x) > 1e-6)
SIZES = st.floats(1e-6, 1e6)


@given(
    st.lists(
        st.tuples(
            st.tuples(NUMBERS, NUMBERS, NUMBERS),
            st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS).filter(any).map(unit),
            st.tuples(SIZES, SIZES, SIZES),
        ),
        min_size=1,
        max_size=4,
    )
)
def test_numbers_arrive_as_yaml_writes_them(tmp_path_factory: Any, rows: list[Any]) -> None:
    content = {
        "objects": [
            {"name": f"o/{k}", "shape": "box", "size": [*s], "position": [*p], "quaternion": [*q]}
            for k, (p, q, s) in enumerate(rows)
        ]
    }
    path = tmp_path_factory.mktemp("round") / "scene.yaml"
    path.write_text(yaml.safe_dump(content))
    objects = load_scene(path).objects
    assert [thing.pose for thing in objects] == [(*p, *q) for p, q, _ in rows]
    assert [thing.shape for thing in objects] == [Box(size) for *_, size in rows]


WORDS = """
objects name shape box size mesh file motion follow waypoints effects sweep on a a/0 [ ] { } : - ,
1 -1 1e-3 .nan ~ & * &a *a ! !!set !!int << | > ? % @ ' \\ # --- ... é world collision_objects id
primitives type dimensions allowed_collision_matrix entry_names
""".split()  # noqa: SIM905 - words are easier to read than a list of them
TOKENS = st.sampled_from([*WORDS, "\n", "\n  ", "\n- ", "\t", "\0", '"'])


@settings(max_examples=60)
@given(st.one_of(st.text(max_size=60), st.lists(TOKENS, max_size=30).map(" ".join)))
def test_nonsense_is_refused_and_nothing_else_is_raised(tmp_path_factory: Any, text: str) -> None:
    path = tmp_path_factory.mktemp("nonsense") / "scene.yaml"
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    with pytest.raises(SceneFileError, match=r"scene\.yaml:\d+: "):
        load_scene(path)


VALUES = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(-3, 3), st.floats(), st.text(max_size=4)),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner),
    max_leaves=6,
)


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@settings(max_examples=40)
@given(st.data(), VALUES)
def test_a_wrong_value_in_a_right_place_is_refused_or_read(
    tmp_path_factory: Any, data: st.DataObject, value: Any
) -> None:
    content = yaml.safe_load(GOOD) if data.draw(st.booleans()) else yaml.safe_load(SHELF)
    place, parents = content, []
    while isinstance(place, (dict, list)) and len(place) > 0:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        parents.append((place, data.draw(st.sampled_from(keys))))
        place = place[parents[-1][1]]
    parent, key = data.draw(st.sampled_from(parents))
    parent[key] = value
    path = tmp_path_factory.mktemp("wrong") / "scene.yaml"
    path.write_text(yaml.safe_dump(content))
    with suppress(SceneFileError):
        load_scene(path).build()


BOX = "{name: a, shape: box, size: [1, 1, 1]}"
REFUSED = {
    "": "scene.yaml:1: the file is empty",
    "# only words": "scene.yaml:1: the file is empty",
    "a: [1": "scene.yaml:1: no YAML: ",
    "a: 1\nb: 2\n\tc: 3": "scene.yaml:3: no YAML: ",
    "a: 1\n--- \nb: 2": "scene.yaml:2: no YAML: ",
    "a: *b": "scene.yaml:1: no YAML: found undefined alias",
    "a: 1\nb: \x07": "scene.yaml:2: no YAML: special characters are not allowed",
    "just words": "scene.yaml:1: must be a mapping",
    "{}": "scene.yaml:1: needs objects",
    "size: 3": "scene.yaml:1: needs objects: (a scene) or world:",
    "[" * 1500: "scene.yaml:1: nested too deeply",
    "objects: 3": "scene.yaml:1: objects: must be a list, got 3",
    f"objects: [{BOX}]\nobjects: []": ":2: objects: stands twice, first in line 1",
    f"objects: [{BOX}]\ngruops: {{}}": ":2: gruops: unknown key; did you mean groups?",
    "objects:\n  - 3": ":2: objects[0]: must be a mapping (key: value), got 3",
    "objects:\n- {name: a, shape: box}": ":2: objects[0]: needs size",
    "objects:\n- {name: a}": ":2: objects[0]: needs shape",
    "objects:\n- {name: a, shape: cube}": ":2: objects[0].shape: must be one of box, sphere",
    "objects:\n- name: a\n  shape: box\n  size: [1, -1]": (
        ":4: objects[0].size: must be 3 positive numbers, got [1, -1]"
    ),
    "objects:\n- {name: a, shape: box, size: [1, .nan, 1]}": "3 positive numbers, got [1, .nan, 1]",
    "objects:\n- {name: a, shape: box, size: [1, '2', 1]}": "3 positive numbers, got [1, '2', 1]",
    "objects:\n- {name: a, shape: box, size: [1, 0x10, 1]}": "3 positive numbers",
    "objects:\n- {name: a, shape: box, size: &s [1, *s, 1]}": ":2: &s contains itself",
    "objects:\n- {name: a, shape: sphere, size: [1, 1, 1]}": ".size: unknown key; ",
    "objects:\n- {name: a, shape: sphere, radius: 0}": (
        ".radius: must be a positive number, got 0"
    ),
    "objects:\n- {name: a, shape: sphere, radius: yes}": "must be a positive number, got yes",
    "objects:\n- {name: a, shape: sphere, radius: }": "objects[0]: needs radius",
    "objects:\n- {name: a, shape: sphere, radius: 1, radius: 2}": ".radius: stands twice",
    "objects:\n- {name: , shape: sphere, radius: 1}": "needs name",
    "objects:\n- {name: '', shape: sphere, radius: 1}": ".name: must be a name, got ''",
    "objects:\n- {name: a*, shape: sphere, radius: 1}": ".name: must not hold any of *?[]",
    "objects:\n- {name: a, shape: sphere, radius: 1, position: [1, 2]}": (
        "objects[0].position: must be 3 numbers, got [1, 2]"
    ),
    "objects:\n- {name: a, shape: sphere, radius: 1, quaternion: [0, 0, 0, 0]}": (
        ".quaternion: must not be zero"
    ),
    "objects:\n- {name: a, shape: sphere, radius: 1, quaternion: [0, 0, 0, 1], rpy: [0, 0, 0]}": (
        ".rpy: there is a quaternion already"
    ),
    "objects:\n- {name: a, shape: sphere, radius: 1e299, scale: 100}": (
        ":2: objects[0]: size times scale must not exceed"
    ),
    "objects:\n- {name: a, shape: sphere, radius: 1, accuracy: best}": ".accuracy: must be one of ",
    "objects:\n- {name: a, shape: sphere, radius: 1, color: [1, 2, 3]}": ".color: must be 3 or 4",
    "objects:\n- {name: a, shape: mesh, file: none.stl}": "none.stl: there is no such file",
    "objects:\n- {name: a, shape: mesh, file: 'http://x/y'}": "objects[0].file: mesh file http://x/",
    "objects:\n- {name: a, shape: hull, points: []}": ".points: must be points [x, y, z], at",
    "objects:\n- !!python/object/apply:os.system ['true']": "objects[0]: tags are not read",
    "objects:\n- {name: !new a, shape: sphere, radius: 1}": "objects[0].name: tags are not read",
    "objects:\n- {<<: {name: a}, shape: sphere, radius: 1}": "merged mappings (<<) are not read",
    "objects:\n- {? [a] : 1}": "objects[0]: must be a key, got [a]",
    f"objects:\n- {BOX}\n- {BOX}": (
        ":3: objects[1].name: the name a stands twice, first in line 2"
    ),
    f"objects: [{BOX}]\ngroups: {{a: b/*}}": "groups.a: an object has this name already",
    f"objects: [{BOX}]\ngroups: {{b*: b/*}}": "a group can't be called b*",
    f"objects: [{BOX}]\ngroups: {{default: b/*}}": "a group can't be called default",
    f"objects: [{BOX}]\ngroups: {{b: []}}": "groups.b: must be a pattern, a group, or a list",
    f"objects: [{BOX}]\ngroups: {{hand: h/*}}\nallowed:\n- [hadn, a]": (
        ":4: allowed[0][0]: hadn is no group, object or pattern; did you mean hand?"
    ),
    f"objects: [{BOX}]\nallowed: [[a]]": "allowed[0]: must be a pair of groups, names or patterns",
    f"objects: [{BOX}]\naccuracy: exact": "accuracy: must be one of sphere, aabb, obb,",
    f"objects: [{BOX}]\naccuracy: obb_tree": "got 'obb_tree': use obb or hull instead",
    f"objects: [{BOX}]\naccuracy: {{a: fine}}": "accuracy.a: must be one of sphere",
    f"objects: [{BOX}]\naccuracy: {{b: obb}}": "accuracy.b: b is no group, object or pattern",
    f"objects: [{BOX}]\npadding: -1": "padding: must be a number, not negative, got -1",
    f"objects: [{BOX}]\ntime_budget: 0": (
        "time_budget: must be seconds, above 0 and at most 1, got 0"
    ),
    f"objects: [{BOX}]\ntime_budget: 5": "must be seconds, above 0 and at most 1, got 5",
    f"objects: [{BOX}]\neffects: on": "effects: must be a mapping (key: value), got on",
    f"objects: [{BOX}]\neffects: {{seperations: on}}": "did you mean separations?",
    f"objects: [{BOX}]\neffects: {{separations: maybe}}": "must be one of off, auto, on, got maybe",
    f"objects: [{BOX}]\neffects: {{separations: {{mode: true}}}}": "separations.mode: must be one",
    f"objects: [{BOX}]\neffects: {{separations: {{limit: 1}}}}": "separations.limit: unknown key",
    f"objects: [{BOX}]\neffects: {{separations: {{objects: b}}}}": "b is no group, object or",
    f"objects: [{BOX}]\neffects: {{markers: {{objects: a}}}}": "effects.markers.objects: unknown",
    f"objects: [{BOX}]\nlidar: {{count: 1.5, range: 1}}": "lidar.count: must be a whole number",
    f"objects: [{BOX}]\nlidar: {{count: 1}}": "lidar: needs range",
    f"objects: [{BOX}]\nview: {{eye: [0, 0, 1], target: [0, 0, 0]}}": "view: eye and target must",
}


@each("text", REFUSED)
def test_what_is_wrong_is_told_by_line_and_key(text: str, write: Any) -> None:
    with pytest.raises(SceneFileError) as error:
        load_scene(write(text))
    assert REFUSED[text] in str(error.value)


MOTIONS = {
    "3": "objects[0].motion: must be a mapping",
    "{}": "objects[0].motion: must be a mapping with twist, waypoints or follow, got {}",
    "{twist: [1, 0, 0]}": "motion.twist: must be 6 numbers",
    "{twist: [1, 0, 0, 0, 0, 0], period: 0}": "period: must be seconds from 0.001 to",
    "{twist: [1, 0, 0, 0, 0, 0], waypoints: []}": "waypoints: a motion by waypoints has no twist",
    "{waypoints: [[0, 0, 0], [1, 0, 0]]}": "motion: needs period",
    "{waypoints: [[0, 0, 0]], period: 1}": "must be at least 2 waypoints",
    "{waypoints: [[0, 0], [1, 0, 0]], period: 1}": "waypoints[0]: must be 3 numbers",
    "{waypoints: [far, [1, 0, 0]], period: 1}": "waypoints[0]: must be [x, y, z], [x, y, z, yaw]",
    "{waypoints: [{position: [0, 0, 0], time: 0}, [1, 0, 0]], period: 1}": "need a time, or none",
    "{waypoints: [{position: [0, 0, 0], time: 0}, {position: [0, 0, 0], time: 2}], period: 1}": (
        "times must ascend from 0 and stay below the period 1, got [0.0, 2.0]"
    ),
    "{follow: b}": "motion: follows b, which is no object here",
    "{follow: a}": "motion: follows itself: a",
    "{follow: a, period: 1}": "period: without waypoints there is no round",
}


@each("motion", MOTIONS)
def test_motions_that_make_no_sense_are_refused(motion: str, write: Any) -> None:
    text = f"objects:\n- {{name: a, shape: sphere, radius: 1, motion: {motion}}}"
    with pytest.raises(SceneFileError) as error:
        load_scene(write(text))
    expected = MOTIONS[motion].replace("waypoints: a motion by", "twist: a motion by")
    assert expected in str(error.value)


def test_a_place_beside_waypoints_is_refused(write: Any) -> None:
    motion = "{waypoints: [[0, 0, 0], [1, 0, 0]], period: 1}"
    text = (
        f"objects: [{{name: a, shape: sphere, radius: 1, position: [0, 0, 0], motion: {motion}}}]"
    )
    with pytest.raises(SceneFileError, match="position: the waypoints of the motion say where"):
        load_scene(write(text))


def test_all_that_is_wrong_is_told_at_once(write: Any) -> None:
    text = "\n".join(f"- {{name: n{k}, shape: sphere, radius: -{k}}}" for k in range(1, 31))
    with pytest.raises(SceneFileError) as error:
        load_scene(write(f"padding: x\nobjects:\n{text}"))
    assert [problem.line for problem in error.value.problems] == [1, *range(3, 33)]
    assert str(error.value).endswith("and 11 more")

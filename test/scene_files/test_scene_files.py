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

import fnmatch
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from pages import ROOT, table_rows

import obb_collision as oc
from obb_collision.geometry.poses import unit_quaternions
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene_files import (
    READY,
    SceneDescription,
    SceneFileError,
    find_scene,
    load_scene,
    moveit,
    native,
    objects,
)
from obb_collision.scene_files.description import NODE_EFFECTS
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Sphere

PAGE = ROOT / "docs" / "scene_files.md"
DOCS = PAGE.read_text()


def test_what_a_file_says_is_what_the_scene_has() -> None:
    description = load_scene(Path(__file__).parents[1] / "data" / "scene.yaml")
    assert description.name == "small"
    names = "table/0 cup/0 box hand/0 hand/1 fan rider tram"
    assert description.names == names.split()
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
    expected.add("fan", Cone(1, 2))
    expected.add("rider", Capsule(1, 2))
    expected.add("tram", Ellipsoid([1, 2, 3]))
    for part, wanted in expected.boxes.arrays._asdict().items():
        np.testing.assert_allclose(getattr(scene.boxes, part), wanted, rtol=0, atol=1e-15)
    for sides in (("hand/*", "hand/*"), ("cup/*", "table/0"), ("box", "table/0")):
        expected.allow(*sides)
    assert scene.rules.allowed == expected.rules.allowed
    assert scene.check().names() == expected.check().names()
    assert scene.check().accuracies.tolist() == expected.check().accuracies.tolist()
    setting = scene.effects["separations"]
    assert (setting.mode, setting.objects) == ("on", ("hand/*",))


def test_meshes_are_found_beside_their_file_and_shared(tmp_path: Path, write: Any) -> None:
    (tmp_path / "parts").mkdir()
    lines = ["v 0 0 0", "v 2 0 0", "v 0 2 0", "v 0 0 2", "f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    (tmp_path / "parts" / "tip.obj").write_text("\n".join(lines))
    entries = [f"- {{name: tip/{k}, shape: mesh, file: parts/tip.obj, scale: 0.5}}" for k in (0, 1)]
    path = write("\n".join(["objects:", *entries]))
    one, two = (thing.shape for thing in load_scene(path).objects)
    assert one is two
    assert isinstance(one, Mesh)
    assert one.vertices.max() * one.scale[0] == 1.0


NUMBERS = st.floats(-1e6, 1e6).filter(lambda x: x == 0.0 or abs(x) > 1e-6)
SIZES = st.tuples(*[st.floats(1e-6, 1e6)] * 3)
PLACES, TURNS = st.tuples(*[NUMBERS] * 3), st.tuples(*[NUMBERS] * 4).filter(any)
TURNS = TURNS.map(lambda turn: tuple(unit_quaternions(turn).tolist()))


@given(st.lists(st.tuples(PLACES, TURNS, SIZES), min_size=1, max_size=4))
def test_numbers_arrive_as_yaml_writes_them(tmp_path_factory: Any, rows: list[Any]) -> None:
    content = [
        {"name": f"o/{k}", "shape": "box", "size": [*s], "position": [*p], "quaternion": [*q]}
        for k, (p, q, s) in enumerate(rows)
    ]
    path = tmp_path_factory.mktemp("round") / "scene.yaml"
    path.write_text(yaml.safe_dump({"objects": content}))
    objects = load_scene(path).objects
    assert [thing.pose for thing in objects] == [(*p, *q) for p, q, _ in rows]
    assert [thing.shape for thing in objects] == [Box(size) for *_, size in rows]


WORDS = """
objects name shape box size mesh file position rpy robots effects sweep on a a/0 [ ] { } : - ,
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


BOX = "{name: a, shape: box, size: [1, 1, 1]}"


def top(line: str) -> str:
    return f"objects: [{BOX}]\n{line}"


def one(fields: str) -> str:
    return f"objects:\n- {{name: a, {fields}}}"


def ball(fields: str) -> str:
    return one(f"shape: sphere, radius: 1, {fields}")


REFUSED = [
    ("", "scene.yaml:1: the file is empty"),
    ("# only words", "scene.yaml:1: the file is empty"),
    ("a: [1", "scene.yaml:1: not valid YAML: "),
    ("a: 1\nb: 2\n\tc: 3", "scene.yaml:3: not valid YAML: "),
    ("a: 1\n--- \nb: 2", "scene.yaml:2: not valid YAML: "),
    ("a: *b", "scene.yaml:1: not valid YAML: found undefined alias"),
    ("a: 1\nb: \x07", "scene.yaml:2: not valid YAML: special characters are not allowed"),
    ("just words", "scene.yaml:1: must be a mapping"),
    ("{}", "scene.yaml:1: needs objects"),
    ("size: 3", "scene.yaml:1: needs objects: (a scene) or world:"),
    ("[" * 1500, "scene.yaml:1: nested too deeply"),
    (top("objects: []"), ":2: objects: stands twice, first in line 1"),
    (one(""), ":2: objects[0]: needs shape"),
    (one("shape: cube"), ":2: objects[0].shape: must be one of box, sphere"),
    ("objects:\n- name: a\n  shape: box\n  size: [1, -1]",
     ":4: objects[0].size: must be 3 positive numbers, got [1, -1]"),
    (one("shape: box, size: [1, .nan, 1]"), "3 positive numbers, got [1, .nan, 1]"),
    (one("shape: box, size: [1, 0x10, 1]"), "3 positive numbers"),
    (one("shape: box, size: &s [1, *s, 1]"), ":2: &s contains itself"),
    (one("shape: sphere, radius: 0"), ".radius: must be a positive number, got 0"),
    (one("shape: sphere, radius: "), "objects[0]: needs radius"),
    (ball("radius: 2"), ".radius: stands twice"),
    ("objects:\n- {name: , shape: sphere, radius: 1}", "needs name"),
    ("objects:\n- {name: '', shape: sphere, radius: 1}", ".name: must be a name, got ''"),
    ("objects:\n- {name: a*, shape: sphere, radius: 1}", ".name: must not hold any of *?[]"),
    (ball("position: [1, 2]"), "objects[0].position: must be 3 numbers, got [1, 2]"),
    (ball("quaternion: [0, 0, 0, 0]"), ".quaternion: must not be zero"),
    (ball("quaternion: [0, 0, 0, 1], rpy: [0, 0, 0]"), ".rpy: give either rpy or a quaternion"),
    (one("shape: sphere, radius: 1e299, scale: 100"),
     ":2: objects[0]: size times scale must not exceed"),
    (ball("color: [1, 2, 3]"), ".color: must be 3 or 4"),
    (one("shape: mesh, file: none.stl"), "none.stl: the file does not exist"),
    (one("shape: mesh, file: 'http://x/y'"), "objects[0].file: mesh file http://x/"),
    (one("shape: hull, points: []"), ".points: must be points [x, y, z], at"),
    ("objects:\n- !!python/object/apply:os.system ['true']", "objects[0]: tags are not read"),
    ("objects:\n- {name: !new a, shape: sphere, radius: 1}", "objects[0].name: tags are not read"),
    (ball("<<: {name: a}"), "merged mappings (<<) are not read"),
    ("objects:\n- {? [a] : 1}", "objects[0]: must be a key, got [a]"),
    (f"objects:\n- {BOX}\n- {BOX}", ":3: objects[1].name: the name a stands twice, first in li"),
    (top("groups: {a: b/*}"), "groups.a: an object has this name already"),
    (top("groups: {b*: b/*}"), "a group cannot have the name b*"),
    (top("groups: {default: b/*}"), "a group cannot have the name default"),
    (top("groups: {b: []}"), "groups.b: must be a pattern, a group, or a list"),
    (top("groups: {hand: h/*}\nallowed:\n- [hadn, a]"),
     ":4: allowed[0][0]: hadn is not a group, object or pattern; did you mean hand?"),
    (top("allowed: [[a]]"), "allowed[0]: must be a pair of groups, names or patterns"),
    (top("accuracy: exact"), "accuracy: must be one of sphere, aabb, obb,"),
    (top("accuracy: obb_tree"), "got 'obb_tree': use obb or hull instead"),
    (top("accuracy: {b: obb}"), "accuracy.b: b is not a group, object or pattern"),
    (top("padding: -1"), "padding: must be a number, not negative, got -1"),
    (top("time_budget: 0"), "time_budget: must be seconds, above 0 and at most 1, got 0"),
    (top("time_budget: 5"), "must be seconds, above 0 and at most 1, got 5"),
    (top("effects: {separations: {objects: b}}"), "b is not a group, object or"),
    (top("effects: {markers: {objects: a}}"), "effects.markers.objects: unknown"),
    (top("view: {eye: [0, 0, 1], target: [0, 0, 0]}"), "view: eye and target must"),
    (ball("motion: {follow: b}"),
     ":2: objects[0].motion: a scene does not move; the demo reads NAME.motion.yaml beside"),
]  # fmt: skip


@each("text, reason", REFUSED)
def test_what_is_wrong_is_told_by_line_and_key(text: str, reason: str, write: Any) -> None:
    with pytest.raises(SceneFileError) as error:
        load_scene(write(text))
    assert reason in str(error.value)


def test_all_that_is_wrong_is_told_at_once(write: Any) -> None:
    text = "\n".join(f"- {{name: n{k}, shape: sphere, radius: -{k}}}" for k in range(1, 31))
    with pytest.raises(SceneFileError) as error:
        load_scene(write(f"padding: x\nobjects:\n{text}"))
    assert [problem.line for problem in error.value.problems] == [1, *range(3, 33)]
    assert str(error.value).endswith("and 11 more")


@pytest.fixture(params=READY)
def ready(request: pytest.FixtureRequest) -> SceneDescription:
    """Return one of the scenes of the package."""
    return load_scene(request.param)


def test_ready_scenes_are_those_of_the_folder_and_of_the_page() -> None:
    found = (ROOT / "config").glob("*.yaml")
    motions = {f"{name}.motion" for name in READY}
    others = {"obb_collision", "camera.params", "lidar_zone.params"}
    assert {path.stem for path in found} == {*READY, *motions, *others}
    rows = re.findall(r"^\| `(\w+)\.yaml` \|", DOCS, re.MULTILINE)
    assert tuple(rows) == READY


def test_ready_scenes_build_and_are_free(ready: SceneDescription) -> None:
    scene = ready.build()
    assert scene.names == ready.names
    assert scene.check().names() == []


def test_their_patterns_are_about_something(ready: SceneDescription) -> None:
    rules = [pattern for rule in ready.allowed for pattern in (rule.first, rule.second)]
    effects = [pattern for choice in ready.effects.values() for pattern in choice.objects or ()]
    links = [f"{r.name}/{link}/0" for r in ready.robots for link in r.robot.link_names]
    groups = [pattern for patterns in ready.groups.values() for pattern in patterns]
    for pattern in (*rules, *effects, *groups, *(pattern for pattern, _ in ready.accuracies)):
        assert fnmatch.filter([*ready.names, *links], pattern), pattern


def test_scenes_are_found_in_a_pip_target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SceneFileError, match="scenes of the package are tabletop, warehou"):
        load_scene("kitchen")
    assert find_scene("kitchen.yaml") == Path("kitchen.yaml")
    config = tmp_path / "share" / "obb_collision" / "config"
    config.mkdir(parents=True)
    (config / "tabletop.yaml").write_text("objects: [{name: a, shape: sphere, radius: 1}]")
    module = tmp_path / "obb_collision" / "scene_files" / "load.py"
    monkeypatch.setattr("obb_collision.scene_files.load.__file__", str(module))
    assert load_scene("tabletop").names == ["a"]


def words(heading: str) -> set[str]:
    """Return the words in code font in the first cells of a section's table."""
    return {word for row in table_rows(PAGE, heading) for word in re.findall(r"`(\w+)", row[0])}


def test_keys_are_those_of_the_code() -> None:
    assert words("## Keys of a file") == set(native.KEYS)
    sizes = {key for _, keys in objects.SHAPES.values() for key in keys}
    assert words("## Keys of an object") == {*objects.KEYS, *sizes}
    assert words("## Robots") == set(native.ROBOT_KEYS)
    assert words("## Effects") == {*EFFECTS, *NODE_EFFECTS}
    parts = words("## MoveIt planning scenes")
    assert {part for part in parts if part != "is_diff"} <= set(moveit.KEYS)
    rows = {row[0]: row[1] for row in table_rows(PAGE, "## Effects")}
    for effect, values in EFFECTS.items():
        named = set(re.findall(r"`(\w+)`", rows[f"`{effect}`"]))
        assert named == {"mode", "objects", *values.options}


def test_the_errors_are_as_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (shown,) = re.findall(r"```text\n(.*?)```", DOCS, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    text = [
        "groups: {gripper: [g/*]}", *["# words"] * 9, "objects:",
        "- {name: a, shape: box, size: [1, 1, 1]}", "- {name: b, shape: box, size: [1, 1, 1]}",
        "- {name: c, shape: box, size: [1, -1]}", *["# words"] * 4, "effects:",
        "  contact: on", "allowed: [[a, b],", "  [griper, a]]",
    ]  # fmt: skip
    Path("cell.yaml").write_text("\n".join(text))
    with pytest.raises(SceneFileError) as error:
        load_scene("cell.yaml")
    assert str(error.value).splitlines() == shown.splitlines()

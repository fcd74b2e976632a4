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


@settings(max_examples=300)
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
@settings(max_examples=150)
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

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

"""Whatever a scene file holds, it is read or refused, in bounded time and printable words."""

from __future__ import annotations

import cProfile
import json
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import yaml
from each import each
from scenes import counted

import obb_collision as oc
from obb_collision.scene_files import SceneFileError, find_scene, load, load_scene
from obb_collision.scene_files import yaml_values as values

DATA = Path(__file__).parents[1] / "data" / "moveit"
CONFIG = Path(__file__).parents[2] / "config"
BOX = "shape: box, size: [1, 1, 1]"
BAD_WORDS = ["\ud800/1", "\ude00", "a\x00b", "a\x1b[2Jb", "a\nb", "a\x85b", "a\u2028b", "x" * 5000]


def refusal(path: Path | str) -> str:
    """Return why a file is refused."""
    with pytest.raises(SceneFileError) as error:
        load_scene(path)
    return readable(error.value)


def readable(error: SceneFileError) -> str:
    """Return the text of an error that can be printed, sent and read."""
    text = str(error)
    text.encode()
    assert all(line.isprintable() for line in text.splitlines())
    assert len(text) < 20_000
    return text


FILES = [DATA / "message.yaml", DATA / "shelf.yaml", DATA.parent / "scene.yaml"]
CONTENTS = {file.stem: yaml.safe_load(file.read_text()) for file in FILES}
#: Values that may stand somewhere, and those that are right nowhere.
ANY = [None, True, -1, 0.5, 1e308, float("nan"), "", "x", [], {}, [1], {"a": 1}]
NEVER = [{"x": "y"}, [[{}]]]
#: What is not read of planning scenes, and mappings whose keys are names.
UNREAD = {
    *("joint_state", "multi_dof_joint_state", "octomap", "detach_posture", "weight", "stamp"),
    *("type", "polygon", "link_padding", "link_scale"),
    *("plane_poses", "subframe_names", "subframe_poses"),
}
FREE = {"groups", "accuracy"}
WHY = re.compile("must not hold the char|must have at most|not valid YAML: expected|needs objects:")
KEY = object()
Way = tuple[Any, ...]


def ways_in(place: Any, way: Way = ()) -> Iterator[tuple[Way, Any]]:
    """Yield the ways to values of a file, and to its keys, with these; of like items to the first.

    Items are alike that have the same keys, or are of the same type.
    """
    yield way, place
    inner: dict[Any, tuple[Any, Any]] = {}
    if isinstance(place, dict):
        yield from (((*way, KEY, key), key) for key in place)
        inner = {key: (key, value) for key, value in place.items()}
    elif isinstance(place, list):
        for number, item in enumerate(place):
            inner.setdefault(str([*item]) if isinstance(item, dict) else type(item), (number, item))
    for key, value in inner.values():
        yield from ways_in(value, (*way, key))


def replaced(place: Any, way: Way, value: Any) -> Any:
    """Return a file with another value, or key, at the end of a way."""
    if not way:
        return value
    if way[0] is KEY:
        return {value if key == way[1] else key: inner for key, inner in place.items()}
    if isinstance(place, dict):
        return {k: replaced(v, way[1:], value) if k == way[0] else v for k, v in place.items()}
    return [replaced(v, way[1:], value) if k == way[0] else v for k, v in enumerate(place)]


def refusal_at(way: Way, path: Path) -> str:
    """Return why a file is refused, of which a place, what is around it, or in it, is wrong."""
    with pytest.raises(SceneFileError) as error:
        load_scene(path)
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in way if part != KEY)
    at, keys = "".join(parts)[1:], [problem.key for problem in error.value.problems]
    assert any(key.startswith(at) or at.startswith(key) for key in keys), (way, keys)
    return readable(error.value)


@each("source", CONTENTS)
@pytest.mark.filterwarnings("ignore:.*far from unit length", "ignore:.*matches no object")
def test_what_is_right_nowhere_is_refused_by_its_key_everywhere(source: str, write: Any) -> None:
    content = CONTENTS[source]
    load_scene(write(json.dumps(content)))
    for number, (way, place) in enumerate(ways_in(content)):
        is_read = not UNREAD & {*way} and way not in ((), ("robot_state", "is_diff"))
        is_read &= way[2:3] != ("header",)  # of a frame
        if KEY in way and is_read and not FREE & {*way[-3:-2]} and way != (KEY, "objects"):
            key, wrong = way[-1], way[-1][0] + way[-1]
            text = refusal_at((*way[:-2], wrong), write(json.dumps(replaced(content, way, wrong))))
            assert f"unknown key; did you mean {key}?" in text
        elif KEY not in way:
            if is_read:  # of another list only the length might be told
                wrong = NEVER[0 if isinstance(place, list) else number % 2]
                refusal_at(way, write(json.dumps(replaced(content, way, wrong))))
            for value in ANY[number % 12 :: 12]:
                with suppress(SceneFileError):
                    load_scene(write(json.dumps(replaced(content, way, value)))).build()


@each("word", BAD_WORDS)
@each("source", CONTENTS)
def test_bad_words_are_refused_wherever_they_stand(source: str, word: str, write: Any) -> None:
    content = CONTENTS[source]
    words = [way for way, value in ways_in(content) if isinstance(value, str)]
    assert len(words) > 20
    for way in words[BAD_WORDS.index(word) :: len(BAD_WORDS)]:  # a load takes long
        if way == ("description",) and word in ("a\nb", "x" * 5000):
            continue  # text for people may have lines
        path = write(json.dumps(replaced(content, way, word)))  # YAML, too, and quickly written
        if source == "scene":
            assert WHY.search(refusal(path)), way
            continue
        try:  # not all of a planning scene is read
            wrong = unusable(load_scene(path))
        except SceneFileError as error:
            wrong = [] if f"{path}:" in readable(error) else [str(error)]
        assert wrong == []


def unusable(description: Any) -> list[str]:
    """Return what words of a scene can't be used."""
    rules = [word for rule in description.allowed for word in (rule.first, rule.second)]
    words = [description.name, *description.names, *description.notes, *rules]
    return [word for word in words if len(word) > 600 or not word.isprintable()]


def test_a_name_is_refused_with_file_line_and_reason(write: Any) -> None:
    path = write(f'objects:\n- {{name: a, {BOX}}}\n- {{name: "\\ud800/1", {BOX}}}')
    reason = "objects[1].name: must not hold the character U+D800, got '\\ud800/1'"
    assert refusal(path) == f"{path}:3: {reason}"
    path = write(f"objects:\n- {{name: {'x' * 256}, {BOX}}}")
    assert "objects[0].name: must have at most 255 characters, got 256" in refusal(path)


def test_what_the_parser_itself_cannot_take_is_refused(write: Any) -> None:
    for text, line in (
        ('a: "\\UFFFFFFFF"', 1), ('a: 1\nb: "\\U00110000"', 2), ("a: !<%FF> b", 1),
        (f"%YAML {'9' * 6000}.1\n---\na", 1), (f"%YAML 1.{'1' * 6000}\n---\na", 1),
        ("\n\na: |9999999999\n b", 3),
    ):  # fmt: skip
        assert f".yaml:{line}: not valid YAML: " in refusal(write(text)), text[:50]


def test_numbers_of_any_length_are_read_where_floats_need_them_and_else_refused(write: Any) -> None:
    for number in (
        "1" * 50_000, "1" * 2_000_000 + "x", "1e999999999999", "-1e" + "9" * 5000, "." * 99_999,
        "0" * 5000 + ".5", "1e400", ":".join("1" * 50_000), "1_" * 50_000 + "1",
    ):  # fmt: skip
        path = write(f"objects:\n- name: a\n  shape: sphere\n  radius: {number}")
        reason = f"{path}:4: objects[0].radius: must be a positive number, got "
        assert reason in refusal(path), number[:20]
    for number in ("1.5", "1.", ".5", "+1e-3", f"{5e-324:.1074f}", "1" + "0" * 99):
        file = write(f"objects: [{{name: a, {BOX}, position: [{number}, 0, 0]}}]")
        assert load_scene(file).objects[0].pose[0] == float(number)


def test_nesting_is_limited_and_told_by_its_line(write: Any) -> None:
    for text, line in (
        ("a: 1\nb: " + "[" * 5000, 2),
        ("\n".join("  " * k + f"k{k}:" for k in range(3000)), load.MAX_LEVELS),
        ("- " * 5000, 1),
        ("\n\n" + "{a: " * 5000, 3),
        ("? " * 5000, 1),
    ):
        assert f":{line}: nested too deeply, more than 30 levels" in refusal(write(text))


def test_aliases_count_as_all_that_they_stand_for(write: Any) -> None:
    lists = [f"x{k}: &x{k} [{', '.join([f'*x{k - 1}'] * 20)}]" for k in range(1, 9)]
    text = refusal(write("\n".join(["x0: &x0 [1, 1]", *lists])))
    assert ":6: there are more than 4000000 values, counting those repeated by aliases" in text
    vertices = "[" + ", ".join(["[0, 0, 0]"] * 3000) + "]"
    meshes = ", ".join(["{vertices: *v, triangles: []}"] * 400)
    text = f"name: &v {vertices}\nworld: {{collision_objects: [{{id: a, meshes: [{meshes}]}}]}}"
    assert ":2: there are more than 4000000 values" in refusal(write(text))
    assert ":1: &a contains itself" in refusal(write("a: &a {b: *a}"))
    fine = write(f"objects:\n- &a {{name: a, {BOX}, position: &p [1, 2, 3]}}\n"
                 f"- {{name: b, {BOX}, position: *p}}")  # fmt: skip
    assert load_scene(fine).objects[1].pose[:3] == (1.0, 2.0, 3.0)


def test_files_have_a_limit_and_are_files(tmp_path: Path) -> None:
    large = tmp_path / "large.yaml"
    with large.open("wb") as file:
        file.truncate(10**12)  # a hole: nothing is written
    assert refusal(large) == f"{large}: the file has more than {load.MAX_BYTES} bytes"
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero"), tmp_path):
        assert refusal(path) == f"{path}: the path is a folder, a device or a pipe, not a file"


def test_a_file_that_is_not_there_is_told_as_such(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none.yaml") == f"{tmp_path}/none.yaml: the file does not exist"
    for name in ("x" * 5000, "nul\0", "\ud800", "a\nb", f"{'x' * 300}.yaml", "x/" * 3000):
        text = refusal(name)
        assert len(text.splitlines()) == 1
        assert ":1:" not in text
        with pytest.raises(SceneFileError):
            load_scene(name)
    bad = tmp_path / "bad.yaml"
    bad.write_bytes(b"a: 1\nb: \xff\n")
    assert refusal(bad).startswith(f"{bad}:2: not UTF-8 text: ")


def test_a_mesh_path_of_any_length_is_refused(write: Any) -> None:
    long = ["x" * 4000, "y" * 5000, "x/" * 2040, "file:///" + "x" * 4000, "package://a/%00"]
    for name in (*long, '"part\\0.stl"'):
        path = write(f"objects:\n- {{name: a, shape: mesh, file: {name}}}")
        assert f"{path}:2: objects[0].file: " in refusal(path)


def test_groups_of_groups_do_not_multiply(write: Any) -> None:
    groups = ["g0: [a/*, b/*]", *(f"g{k}: [{', '.join([f'g{k - 1}'] * 20)}]" for k in range(1, 20))]
    text = f"objects: [{{name: a, {BOX}}}]\ngroups:\n  " + "\n  ".join(groups)
    assert load_scene(write(text)).groups["g19"] == ("a/*", "b/*")
    many = ", ".join(f"p{k}/*" for k in range(1001))
    text = f"objects: [{{name: a, {BOX}}}]\ngroups:\n  many: [{many}]\n"
    assert ":3: groups.many: these are more than 1000 patterns" in refusal(write(text))
    many = ", ".join(f"p{k}/*" for k in range(900))
    text = f"objects: [{{name: a, {BOX}}}]\ngroups: {{many: [{many}]}}\nallowed: [[many, many]]"
    assert ":3: allowed: these are more than 100000 pairs of patterns" in refusal(write(text))


def test_no_more_is_guessed_than_told(write: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = counted(monkeypatch, values, "get_close_matches", 1)
    lines = [f"- {{name: a{k}, {BOX}, postion{k}: 3}}" for k in range(2000)]
    rules = [f"- [b{k}, c{k}]" for k in range(500)]
    refusal(write("objects:\n" + "\n".join(lines) + "\nallowed:\n" + "\n".join(rules)))
    assert 0 < len(calls) <= values.MAX_PROBLEMS
    names = [f"- {{name: a{k}, {BOX}}}" for k in range(2000)]
    refusal(write("\n".join(["objects:", *names, "allowed:", *rules])))
    assert max(calls) == values.MAX_GUESSES


def test_a_bad_object_or_frame_is_one_error_whoever_names_it(write: Any) -> None:
    text = f"""\
objects:
  - {{name: cup, shape: box, size: [1, -1, 1]}}
  - {{name: tray, {BOX}}}
  - {{name: plate, {BOX}}}
groups: {{all: [cup, plate], wrong: [nothing]}}
allowed: [[cup, plate], [all, tray], [wrong, cup]]
accuracy: {{cup: hull, wrong: mesh}}
effects: {{contacts: {{objects: [cup, wrong]}}}}
"""
    lines = refusal(write(text)).splitlines()
    assert len(lines) == 2
    assert "objects[0].size: must be 3 positive numbers" in lines[0]
    assert "groups.wrong[0]: nothing is not a group" in lines[1]

    one = "{id: ID, header: {frame_id: stand}, primitives: [{type: sphere, dimensions: [1]}]}"
    text = f"""\
fixed_frame_transforms: [{{child_frame_id: stand, transform: {{translation: [1, 2]}}}}]
world: {{collision_objects: [{one.replace("ID", "a")}, {one.replace("ID", "b")}]}}
"""
    (line,) = refusal(write(text)).splitlines()
    assert "fixed_frame_transforms[0].transform.translation: must be 3 numbers" in line


def test_angles_that_are_degrees_are_refused(write: Any) -> None:
    path = write(f"objects:\n- {{name: a, {BOX}, rpy: [0, 0, 90]}}")
    reason = "angles are in radians, at most a turn; 90 degrees are 1.5708, got [0, 0, 90]"
    assert refusal(path) == f"{path}:2: objects[0].rpy: {reason}"
    load_scene(write(f"objects:\n- {{name: a, {BOX}, rpy: [0, 0, -6.2832]}}"))


def test_a_quaternion_far_from_unit_length_is_told_by_its_line(write: Any) -> None:
    path = write(f"objects:\n- {{name: a, {BOX}, quaternion: [0, 0, 3, 4]}}")
    told = f"{path}:2: objects[0].quaternion: a quaternion far from unit length, taken as "
    with pytest.warns(UserWarning, match="far from unit length") as warnings:
        description = load_scene(path)
    assert str(warnings[0].message).startswith(told)
    assert warnings[0].filename == __file__
    assert description.notes == (str(warnings[0].message),)
    assert description.objects[0].pose[3:] == (0.0, 0.0, 0.6, 0.8)
    assert isinstance(description.build(), oc.Scene)
    near = load_scene(write(f"objects:\n- {{name: a, {BOX}, quaternion: [0, 0, 0.7, 0.7]}}"))
    assert (near.notes, near.objects[0].pose[5:]) == ((), (0.7, 0.7))


def test_a_pattern_that_matches_nothing_is_told_and_one_of_links_is_not(write: Any) -> None:
    urdf = find_scene("arm_cell").parent / "arm.urdf"
    path = write(
        f"objects:\n- {{name: cup/0, {BOX}}}\n"
        f"robots:\n- {{name: arm, urdf: {urdf}}}\n"
        "allowed:\n- [arm/*, cup/*]\n- [arm/hand/1, cup/0]\n- [arm/hnad, cap/*]\n- [cap/*, cup/*]\n"
    )
    with pytest.warns(UserWarning, match="matches no object and no link of a robot") as warnings:
        description = load_scene(path, [urdf.parent])
    told = [str(warning.message) for warning in warnings]
    assert description.notes == tuple(told)
    assert [text.split("matches no ")[0] for text in told] == [
        f"{path}:8: allowed[2][0]: arm/hnad ",
        f"{path}:8: allowed[2][1]: cap/* ",
    ]


def test_reading_an_object_takes_few_calls(write: Any) -> None:
    """A scene of 100,000 objects took 72 s: 2,800 calls each, most of them PyYAML's."""
    pytest.importorskip("yaml.cyaml")
    objects = [f"- {{name: o{n}, {BOX}, position: [{n}, 0, 0.5]}}\n" for n in range(100)]
    small, large = (write(f"objects:\n{''.join(objects[:n])}") for n in (50, 100))
    load_scene(small)  # what is imported and compiled once
    counts = []
    for path in (small, large):
        profile = cProfile.Profile()
        profile.runcall(load_scene, path)
        counts.append(sum(entry.callcount for entry in profile.getstats()))
    assert counts[1] - counts[0] < 50 * 700


@pytest.mark.parametrize("path", sorted((*DATA.rglob("*.yaml"), *CONFIG.glob("*.yaml"))))
def test_both_parsers_of_yaml_read_the_same(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("yaml.cyaml")
    text = path.read_text()
    ways = [load.parse("scene.yaml", text)]
    monkeypatch.setattr(load, "FastParser", load.PythonParser)
    ways.append(load.parse("scene.yaml", text))
    quick, slow = ([*nodes_in(way.node)] for way in ways)
    assert quick == slow


def nodes_in(node: values.Node) -> Iterator[tuple[object, ...]]:
    """Yield tag, line, style and text, or number of parts, of all nodes."""
    parts = [] if isinstance(node.value, str) else list(node.value)
    yield node.tag, node.line, node.style, len(parts) or node.value
    for part in parts:
        for inner in part if isinstance(part, tuple) else (part,):
            yield from nodes_in(inner)

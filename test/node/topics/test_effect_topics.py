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

"""The topics of the effects; and a new effect, which is one file and one entry."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.lib.recfunctions as rfn
import pytest
from each import each
from processes import run_python
from rig import FIRST_STAMP, Rig, cube, pose
from sensor_msgs.msg import PointField

import obb_collision
from obb_collision import node as ros
from obb_collision.node.messages.clouds import DATATYPE_OF, cloud_to_ros
from obb_collision.node.messages.conversions import stamp_from_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.table import ObjectTable
from obb_collision.node.topics.cloud import Cloud
from obb_collision.node.topics.topics import PREDICTIONS, TOPICS
from obb_collision.queries.sweep import Sweeps
from obb_collision.scene.effects import sweep

CLOUDS = {topic.name: topic for topic in TOPICS.values() if isinstance(topic, Cloud)}


@each("topic", ["collisions", "contacts", "clearances", "predicted_collisions"])
def test_messages_come_every_cycle_also_when_there_is_nothing(rig: Rig, topic: str) -> None:
    rig.next(topic)
    first, second = rig.next(topic), rig.next(topic)
    assert (first.width, second.width) == (0, 0)
    assert first.header.frame_id == "map"
    assert stamp_from_ros(second.header.stamp) > stamp_from_ros(first.header.stamp)


def test_contacts_are_points_in_both_boxes_with_the_normal_from_a_to_b(rig: Rig) -> None:
    rig.next("contacts")
    # sent so that scene indices and keys disagree on who is first
    rig.send(cube(("a", 2), (0.75, 0.25, 0.0)), cube(("a", 1)))
    message = rig.answer("contacts")
    rows = ros.contacts_from_ros(message)
    assert rows[["index", "count"]].tolist() == [(n, 4) for n in range(4)]
    found = ros.named_contacts(message, rig.namespaces("a"))
    assert {(c.a, c.b, c.normal) for c in found} == {("a/1", "a/2", (1.0, 0.0, 0.0))}
    places = np.array([contact.point for contact in found])
    corners = {tuple(place) for place in places[:, 1:].round(9).tolist()}
    assert corners == {(y, z) for y in (-0.25, 0.5) for z in (-0.5, 0.5)}
    assert np.all((places[:, 0] >= 0.25) & (places[:, 0] <= 0.5))
    assert [contact.depth for contact in found] == pytest.approx([0.25] * 4)
    assert np.allclose(rows["x"], rows["point_x"])


def test_clearances_have_the_closest_points_of_each_and_leave_out_what_is_far() -> None:
    with Rig(given={"effects.clearance_max_distance": 0.75}) as rig:
        rig.next("clearances")
        rig.send(cube(("a", 2), (1.5, 0, 0)), cube(("a", 1)), cube(("b", 1), (-1.8, 0, 0)))
        (found,) = ros.named_clearances(rig.answer("clearances"), rig.namespaces("a", "b"))
        assert (found.a, found.b, found.distance) == ("a/1", "a/2", 0.5)
        assert (found.point_a[0], found.point_b[0]) == (0.5, 1.0)
        assert found.point_a[1:] == found.point_b[1:]
        (row,) = ros.clearances_from_ros(rig.last["clearances"])
        assert (row["normal_x"], row["x"]) == (1.0, 0.75)
        rig.set(**{"effects.clearance_max_distance": 0.9})
        rig.until(lambda: rig.next("clearances").width == 2, "another limit")
        rig.send(cube(("b", 1), (-9, 0, 0)), cube(("a", 2), (0.75, 0, 0)))
        (found,) = ros.named_clearances(rig.answer("clearances"), rig.namespaces("a"))
        assert found.distance == -0.25, "they overlap"


def test_twists_predict_collisions_with_their_time(rig: Rig) -> None:
    rig.next("predicted_collisions")
    rig.send(cube(("wall", 1), (2.0, 0, 0), (0.5, 4, 4)), cube(("fast", 1))).answer()
    rig.send_states(["fast/1"], [pose(0.0)], twists=[[2.5, 0, 0, 0, 0, 0]])
    message = rig.answer("predicted_collisions")
    (found,) = ros.named_predictions(message, rig.namespaces("wall", "fast"))
    assert (found.a, found.b) == ("wall/1", "fast/1")
    assert found.time == pytest.approx(0.5)
    assert found.point[0] == pytest.approx(1.75)
    assert found.normal == pytest.approx((-1.0, 0.0, 0.0))
    assert ros.predictions_from_ros(message)["passed"].tolist() == [0]
    assert rig.set(**{"effects.sweep_horizon": 0.4})[0].successful
    rig.until(lambda: rig.next("predicted_collisions").width == 0, "beyond the horizon")


def test_what_passes_through_a_wall_between_two_states_is_told_once(rig: Rig) -> None:
    rig.next("predicted_collisions")
    rig.send(cube(("wall", 1), (2.0, 0, 0), (0.25, 4, 4)), cube(("fast", 1), size=(0.5, 0.5, 0.5)))
    rig.answer()
    before = rig.stamp
    rig.stamp += 99_000_000
    rig.send_transform("fast/1", pose(4.0))
    message = rig.answer("predicted_collisions")
    assert rig.pairs() == set(), "neither before nor after"
    seconds = 1e-9 * (rig.stamp - before)
    table = rig.namespaces("wall", "fast")
    assert ros.named_predictions(message, table) == [], "a rule for what is to come must not see it"
    ((a, b, time, point, normal),) = ros.named_passed_collisions(message, table)
    assert (a, b) == ("wall/1", "fast/1")
    share = (1.875 - 0.25) / 4.0  # of the way, when the faces meet
    assert time == pytest.approx((share - 1.0) * seconds)
    assert point[0] == pytest.approx(1.875)
    assert normal == pytest.approx((-1.0, 0.0, 0.0))
    assert ros.predictions_from_ros(message)["passed"].tolist() == [1]
    rig.until(lambda: rig.next("predicted_collisions").width == 0, "over")


def test_passed_coming_and_undecided_each_have_their_marks() -> None:
    table = ObjectTable()
    for number in range(5):
        table.claim(number, ("a", number))
    hits, undecided = np.array([True, False]), np.array([False, True])
    points, nan = np.array([[1.0, 2.0, 3.0], [np.nan] * 3]), np.nan

    def sweeps(first: int, times: list[float], free: list[float]) -> Sweeps:
        pairs = np.array([[0, first], [0, first + 2]])
        return Sweeps(pairs, hits, undecided, np.array(times), np.array(free), points, points)

    passed = sweeps(1, [0.75, nan], [0.75, 0.5])
    result = sweep.SweptPairs(passed, predicted=sweeps(2, [0.25, nan], [0.25, 0.125]))
    state: Any = SimpleNamespace(table=table, step=0.1)
    rows = PREDICTIONS.make_rows(result, state, PREDICTIONS.dtype)
    assert rows["id_b"].tolist() == [1, 2, 3, 4]
    assert rows["passed"].tolist() == [1, 0, 1, 0]
    assert rows["undecided"].tolist() == [0, 0, 1, 1]
    assert rows["time"].tolist() == pytest.approx([-0.025, 0.25, -0.05, 0.125])
    assert np.isnan(rows["point_x"]).tolist() == [False, False, True, True]
    message = cloud_to_ros(rows)
    assert [r.undecided for r in ros.named_predictions(message, ["a"])] == [False, True]
    assert [r.undecided for r in ros.named_passed_collisions(message, ["a"])] == [False, True]
    old = cloud_to_ros(rfn.drop_fields(rows, "undecided"))
    assert len(ros.named_predictions(old, ["a"])) == 2, "recorded with an earlier version"


@each("topic", CLOUDS)
def test_readers_refuse_other_messages_and_older_tables(topic: str) -> None:
    read, rows = CLOUDS[topic].named, np.zeros(1, CLOUDS[topic].dtype)
    rows["ns" if topic == "points_inside" else "ns_b"] = ros.namespace_number("arm")
    message = cloud_to_ros(rows)
    named = read(message, ["arm", ""])
    assert "arm/0" in named[0]
    assert named == read(message, {0: "", ros.namespace_number("arm"): "arm"})
    with pytest.raises(RefusedError, match="unknown namespace"):
        read(message, [""])
    with pytest.raises(RefusedError, match=f"not a {topic} message"):
        read(cloud_to_ros(np.zeros(1, [("x", "<f4")])), ["arm"])


@each("cloud", CLOUDS.values())
def test_rows_are_aligned_and_drawn_by_rviz(cloud: Cloud[Any]) -> None:
    layout: Any = cloud.dtype
    assert layout.itemsize % 8 == 0
    for name in layout.names:
        kind, offset = layout.fields[name][:2]
        assert offset % kind.itemsize == 0
        assert kind.newbyteorder("=") in DATATYPE_OF
    assert [layout.fields[name][1] for name in "xyz"] == [0, 4, 8]
    message = cloud_to_ros(np.zeros(2, layout))
    assert {f.datatype for f in message.fields if f.name in "xyz"} == {PointField.FLOAT32}
    assert message.point_step == layout.itemsize


def test_points_inside_are_counted_by_object(rig: Rig) -> None:
    rig.next("points_inside")
    rig.send(cube(("a", 1)), cube(("a", 2), (2.0, 0, 0)), cube(("b", 1), (9.0, 0, 0))).answer()
    inside = [[9.0, 9, 9], [2.4, 0, 0], [0.25, 0, 0], [np.nan, 0, 0], [0.125, 0, 0], [0.4, 0, 0]]
    rig.send_points(inside)
    message = rig.answer("points_inside")
    assert ros.named_points_inside(message, rig.namespaces("a", "b")) == [
        ("a/1", 3, 2, 4, 0.125, "sources/points/0"),
        ("a/2", 1, 1, 1, pytest.approx(0.4), "sources/points/0"),
    ]
    rows = ros.points_inside_from_ros(message)
    old = cloud_to_ros(rfn.drop_fields(rows, ["cloud_ns", "cloud_id"]))
    (first, _) = ros.named_points_inside(old, ["a"])
    assert first == ("a/1", 3, 2, 4, 0.125, ""), "recorded with an earlier version"
    assert rows["x"].tolist() == [0.125, pytest.approx(2.4)]
    assert FIRST_STAMP < stamp_from_ros(message.header.stamp) == rig.stamp, "that of the cloud"


FILE = '''
"""The effect ``heights``: how far the second object of each colliding pair is above the first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from obb_collision.scene.broad_phase.broad_phase import NO_PAIRS
from obb_collision.scene.effects.base import Effect, Option, pair_rows


@dataclass(frozen=True, eq=False)
class Heights:
    pairs: np.ndarray
    heights: np.ndarray


def heights(boxes, pairs):
    first, second = boxes.centers[pairs, 2].T
    return Heights(pairs, second - first)


class HeightsEffect:
    name = "heights"
    description = "How far one object is above the other"
    options = {"floor": Option(0.0, -1.0, 1.0, "Not used (m).")}
    lazy = True

    def run(self, cycle, setting):
        return pair_rows(self.name, cycle, setting, heights, heights(cycle.boxes, NO_PAIRS))


EFFECT: Effect = HeightsEffect()
'''
ENTRY = """

from obb_collision.node.topics.rows import order_pairs, pair_rows

def _height_rows(result, state, dtype):
    found = order_pairs(result.pairs, state.table)
    rows = pair_rows(dtype, found, state)
    rows["height"] = found.flipped(result.heights[:, None])[:, 0]
    return rows


TOPICS["heights"] = Cloud(
    name="object_heights",
    fields=(("<f4", POSITION_FIELDS), ("<f8", ("height",)), ("<i4", PAIR_FIELDS)),
    make_rows=_height_rows,
    record=lambda a, b, height: (a, b, height),
    values=("height",),
)
"""
PROGRAM = """
import json
import numpy as np
import obb_collision as oc
from rig import Rig, cube
from obb_collision.node.parameters.table import SPECS
from obb_collision.node.topics.topics import TOPICS
from obb_collision.warm_up.steps import STEPS

scene = oc.Scene()
for name, z in (("a", 0.0), ("b", 0.25), ("c", 9.0)):
    scene.add(name, oc.OBB([0, 0, z], np.eye(3), [0.5] * 3))
scene.set_effect("heights", floor=0.5)
found = scene.check(effects=["heights"]).result("heights")
with Rig() as rig:
    rig.send(cube(("a", 2)), cube(("a", 1), (0, 0, 0.25)))
    rig.until(lambda: rig.next("object_heights").width, "rows")
    named = TOPICS["heights"].named(rig.last["object_heights"], ["a"])
    state = rig.status(": cycle")["effect heights"]
parameters = {s.name: s.description for s in SPECS if s.name.startswith("effects.heights")}
steps = [step for step in STEPS if "heights" in step]
found = found.pairs.tolist(), found.heights.tolist()
print(json.dumps([oc.__file__, *found, named, state, parameters, steps]))
"""


def test_an_effect_is_one_file_and_one_entry(tmp_path: Path) -> None:
    """Run a program with a copy of the package that has one more effect."""
    package = tmp_path / "obb_collision"
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(obb_collision.__file__).parent, package, ignore=ignored)
    (package / "scene" / "effects" / "heights.py").write_text(FILE)
    with (package / "node" / "topics" / "topics.py").open("a") as table:
        table.write(ENTRY)
    tools = Path(__file__).parents[1]
    others = os.environ.get("PYTHONPATH", "").split(os.pathsep)  # what is needed may be there
    path = os.pathsep.join(map(str, (tmp_path, tools, tools.parent / "support", *others)))
    done = run_python("-c", PROGRAM, cwd=tmp_path, PYTHONPATH=path)
    file, pairs, heights, named, state, parameters, steps = json.loads(done.stdout.splitlines()[-1])
    assert file.startswith(str(tmp_path))
    assert (pairs, heights, named) == ([[0, 1]], [0.25], [["a/1", "a/2", -0.25]])
    assert (state, steps) == ("auto, computed", ["effect heights"])
    says = "How far one object is above the other: the topic object_heights."
    assert parameters["effects.heights"] == says
    assert set(parameters) == {f"effects.heights{end}" for end in ("", "_objects", "_floor")}

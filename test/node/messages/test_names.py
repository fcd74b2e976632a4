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

"""Names from outside: numbers, lengths, tables that stay small."""

from __future__ import annotations

import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from each import each
from rclpy.serialization import deserialize_message
from rig import Rig, cube, pose, sync
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

from obb_collision.node import namespace_number, namespace_table
from obb_collision.node.messages.cdr import namespace_bytes
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import (
    MAX_FRAMES,
    MAX_NAME_BYTES,
    MAX_NAMESPACE_BYTES,
    FrameTable,
    NamespaceTable,
    check_name,
    shortened,
)
from obb_collision.node.outputs import NAMESPACES_RATE

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
CLASHING = "plumless", "buckeroo"
"""Two words with the same CRC-32."""
LONG = "x" * 1_000_000


def test_the_number_is_the_crc_32_as_int32() -> None:
    names = ["", "a", "b", "äöü/1", "crate"]
    numbers = [namespace_number(name) for name in names]
    assert np.array(numbers, np.int32).view(np.uint32).tolist() == [
        zlib.crc32(name.encode()) for name in names
    ]


def test_of_two_namespaces_with_one_number_the_second_is_refused_until_the_first_is_gone() -> None:
    first, second = ((name, 1) for name in CLASHING)
    assert namespace_number(first[0]) == namespace_number(second[0])
    with Rig() as rig:
        rig.send(cube(first), cube(second, (0.1, 0, 0)), cube(A1, (0.2, 0, 0)))
        assert {frozenset(pair) for pair in rig.pairs()} == {frozenset(("a/1", "plumless/1"))}
        assert rig.refused("objects") == {"namespace number taken": 1}
        assert rig.node.objects.unplaceable == {second: "namespace number taken"}
        rig.send(Marker(ns=first[0], id=1, action=Marker.DELETE))
        rig.send(cube(second, (0.1, 0, 0)), cube(A1, (0.2, 0, 0))).answer()
        rig.until(lambda: "buckeroo" in namespace_table(rig.last["namespaces"]).values(), "table")
        assert {frozenset(pair) for pair in rig.pairs()} == {frozenset(("a/1", "buckeroo/1"))}


@each("number", [0, 1, -1, 2**31 - 1, -(2**31)])
def test_unknown_numbers_are_refused_and_counted(rig: Rig, number: int) -> None:
    rig.send(cube(A1), cube(A2, (0.5, 0, 0))).answer()
    rig.send_poses([1, 2], [pose(5.0), pose(6.0)], [number, namespace_number("a")])
    rig.refuses("object_poses", {"unknown namespace": 1})
    assert sync(rig) == set(), "the other row is used"


def test_the_same_bits_as_uint32_will_do(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0))).answer()
    table = rig.node.objects.table
    unsigned = np.array([zlib.crc32(b"a")], np.int64)
    assert unsigned[0] >= 2**31
    assert table.find(unsigned, np.array([2])).tolist() == [table.slots[A2]]
    assert table.find(unsigned + 2**32, np.array([2])).tolist() == [-1]
    assert table.find(unsigned, np.array([2**40])).tolist() == [-1]


def test_long_names_are_refused_and_not_kept(rig: Rig) -> None:
    limit = "y" * MAX_NAME_BYTES
    rig.send(*(cube((f"{number}{LONG}", 1)) for number in range(5)), cube((limit, 1)), cube(A1))
    rig.pairs()
    assert rig.refused("objects") == {"bad name": 5}
    unplaceable = rig.node.objects.unplaceable
    assert len(unplaceable) == 5, "they are not checked, and that is said"
    assert all(len(namespace) < MAX_NAME_BYTES for namespace, _ in unplaceable)
    rig.send(Marker(ns="0" + LONG, id=1, action=Marker.DELETE))
    rig.send(Marker(ns="1" + LONG, action=Marker.DELETEALL))
    sync(rig)
    assert len(unplaceable) == 3
    rig.send_transform(LONG, pose(0.0))
    rig.refuses("object_transform", {"unknown object": 1})
    rig.send_transform("a/1", pose(0.0), LONG)
    rig.until(lambda: rig.refused("object_transform").get("bad name"), "refusal")
    assert set(namespace_table(rig.last["namespaces"]).values()) == {limit, "a", "sync"}


@each("name", ["\ud800", "a\0b", "é" * 128, "a\nb", "\n" * 255, "\ud800" * 2000, LONG])
def test_what_is_no_name_is_refused(name: str) -> None:
    with pytest.raises(RefusedError, match="bad name"):
        check_name(name, "namespace")
    with pytest.raises(RefusedError, match="bad name"):
        NamespaceTable().admit(name)
    kept = shortened(name)
    assert kept.isprintable()
    check_name(kept, "namespace")
    assert shortened(kept) == kept


def test_many_namespaces_come_and_go_and_a_full_table_recovers(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("obb_collision.node.messages.names.MAX_NAMESPACES", 20)
    for round_ in range(3):
        rig.send(*(cube((f"{round_} {number}", 0), (5.0 * number, 0, 0)) for number in range(25)))
        rig.answer()
        assert len(rig.node.objects.table) == 20
        assert rig.refused("objects") == {"too many namespaces": 5 * (round_ + 1)}
        rig.send(Marker(action=Marker.DELETEALL))
        sync(rig)
        rig.send(Marker(action=Marker.DELETEALL))
    rig.until(lambda: len(rig.node.objects.table) == 0, "all deleted")
    rig.call(Trigger, "obb_collision/clear", Trigger.Request())
    rig.until(lambda: len(rig.last["namespaces"].values) == 0, "an empty table")


def test_a_scene_file_with_more_than_fits_starts_with_the_rest(tmp_path: Path) -> None:
    file = tmp_path / "many.yaml"
    shape = "shape: box, size: [1, 1, 1]"
    lines = [f"  - {{name: thing {n}, {shape}, position: [{2 * n}, 0, 0]}}" for n in range(9)]
    file.write_text("\n".join(["objects:", *lines]))
    with Rig(scene_file=str(file), max_objects=7) as rig:
        assert len(rig.node.objects.table) == 7
        assert set(rig.node.objects.unplaceable.values()) == {"too many objects"}
        rig.send_transform("thing 0/0", pose(1.5))
        assert {frozenset(pair) for pair in rig.pairs()} == {frozenset(("thing 0/0", "thing 1/0"))}


def test_the_table_is_bounded_in_bytes() -> None:
    table = NamespaceTable()
    most = MAX_NAMESPACE_BYTES // MAX_NAME_BYTES
    for number in range(most + 10):
        table.use(table.admit(f"{number:0{MAX_NAME_BYTES}}")) if number < most else None
    with pytest.raises(RefusedError, match="too many namespaces"):
        table.admit("z" * MAX_NAME_BYTES)
    table.leave(next(iter(table.names)))
    table.admit("z" * MAX_NAME_BYTES)
    assert len(table) == most


def test_unused_namespaces_stay_until_their_place_is_needed() -> None:
    table = NamespaceTable()
    number = table.admit("a")
    table.use(number, 2)
    version = table.version
    table.leave(number, 2)
    assert (table.names, table.version) == ({number: "a"}, version), "no table is sent for it"
    assert table.admit("a") == number
    table.forget_unused()
    assert (table.names, len(table)) == ({}, 0)
    assert table.version > version


@each("count", [0, 1, 5])
def test_the_table_is_written_as_rclpy_would(count: int) -> None:
    names = {namespace_number("ä" * n): "ä" * n for n in range(count)}
    message = deserialize_message(namespace_bytes(names), DiagnosticStatus)
    values = [KeyValue(key=str(number), value=name) for number, name in names.items()]
    text = f"{count} namespaces"
    assert message == DiagnosticStatus(name="namespaces", message=text, values=values)


def test_a_large_table_is_not_sent_at_every_cycle(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, out = [1e6], rig.node.outputs
    sent: list[bytes] = []
    monkeypatch.setattr("obb_collision.node.outputs.outputs.perf_counter", lambda: now[0])
    monkeypatch.setattr(out, "namespaces", SimpleNamespace(publish=sent.append))
    table = NamespaceTable()
    for number in range(10_000):
        table.admit(f"{number:0100}")
        if number % 10 == 9:
            now[0] += 0.02  # 1,000 cycles, each with new names
            out.publish_namespaces(table)
    assert sum(len(data) for data in sent) < 1.2 * NAMESPACES_RATE * 20.0
    assert len(sent) < 500, "each at first, later ones more and more rarely"
    now[0] += 1.0
    out.publish_namespaces(table)
    assert len(deserialize_message(sent[-1], DiagnosticStatus).values) == 10_000


def test_frames_that_nothing_uses_give_their_place_to_others() -> None:
    frames = FrameTable("map")
    assert frames.index("") == frames.index("map") == 0
    indices = [frames.index(f"f{number}") for number in range(MAX_FRAMES - 1)]
    assert [frames.name(index) for index in indices[:2]] == ["f0", "f1"]
    assert frames.is_full
    frames.keep_only(indices)
    with pytest.raises(RefusedError, match="too many frames"):
        frames.index("one more")
    frames.keep_only([*indices[:5], *indices[6:]])
    assert "f5" not in frames
    assert frames.index("one more") == indices[5]
    assert frames.index("f6") == indices[6]
    assert len(frames) == MAX_FRAMES
    with pytest.raises(RefusedError, match="bad name"):
        frames.index(LONG)

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

"""The demo and its live view: random scenes over real topics against brute force, and commands."""

from __future__ import annotations

import os
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from each import each
from processes import output_until, started
from rclpy.executors import ExternalShutdownException
from rig import own_context
from std_msgs.msg import Header

import obb_collision as oc
from obb_collision.demo.command import MIN_OBJECTS, main, open_view
from obb_collision.demo.listener import Listener, boxes_from_bytes
from obb_collision.demo.run import NAMESPACE, Demo
from obb_collision.demo.scene import DemoScene, random_scene
from obb_collision.demo.snapshot import FREE, take_snapshot
from obb_collision.demo.status import Status
from obb_collision.demo.view import NOTES, WAITING, BrowserView, LiveView, banner
from obb_collision.node import namespace_number
from obb_collision.node.diagnostics.answer import Answer
from obb_collision.node.messages.box_markers import COLLIDING, COLORS, Markers
from obb_collision.node.messages.box_markers import FREE as FREE_BOX
from obb_collision.node.messages.clouds import cloud_to_ros
from obb_collision.node.messages.conversions import namespaces_to_ros, stamp_to_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_shapes import shape_from_ros, shape_to_ros
from obb_collision.node.node import NODE_NAME
from obb_collision.node.topics.topics import COLLISIONS, TOPICS

#: Domains of these tests, apart from those a robot or the other tests use.
DOMAIN = 60 + os.getpid() % 40
#: Most seconds a started demo may take; it compiles first.
PATIENCE = 120.0
OBJECTS = 50


def test_a_random_scene_follows_from_objects_and_seed_and_has_all_states() -> None:
    one, two, other = random_scene(80, 3), random_scene(80, 3), random_scene(80, 4)
    for time in (0.0, 1.25, 30.0):
        assert one.states(time)[0].tobytes() == two.states(time)[0].tobytes()
        assert not np.array_equal(one.states(time)[0], other.states(time)[0])
    assert len(set(one.description.names)) == 80
    scene = random_scene(OBJECTS, 4)
    still = np.setdiff1d(np.arange(OBJECTS), scene.moving)
    assert 0.2 * OBJECTS < len(scene.moving) < 0.4 * OBJECTS
    assert np.array_equal(scene.states(3.3)[0][still], scene.states(0.0)[0][still])
    report = scene.description.build().check()
    assert report.depths.min() < 1e-6
    assert report.depths.max() > 0.01
    assert len(report.names()) < OBJECTS  # most are free
    assert len(random_scene(MIN_OBJECTS, 4).description.names) == MIN_OBJECTS


def brute_force(scene: DemoScene, time: float) -> set[tuple[str, ...]]:
    """All pairs of the scene as published, each judged for itself, names sorted in a pair."""
    made = oc.Scene()
    poses = scene.motions.states(time)[0]
    for (name, shape), pose in zip(scene.shapes.items(), poses, strict=True):
        made.add(name, shape_from_ros(shape_to_ros(shape)), pose)
    pairs = np.stack(np.triu_indices(len(made), 1), axis=1)
    colliding = oc.verdicts(made.boxes, made.boxes, pairs) != oc.Verdict.SEPARATE
    return {tuple(sorted((scene.names[a], scene.names[b]))) for a, b in pairs[colliding]}


def check_pairs(demo: Demo, time: float) -> int:
    """Return how many pairs were received, which must be those at a time."""
    received = {tuple(sorted((pair.a, pair.b))) for pair in demo.listener.pairs.rows}
    assert received == brute_force(demo.scene, time), f"at {time} s"
    return len(received)


@pytest.fixture
def lines() -> list[str]:
    return []


@contextmanager
def made(objects: int, seed: int, *more: Any, **options: Any) -> Iterator[Demo]:
    """Yield the demo of a random scene, which is ended."""
    with own_context(DOMAIN) as context:
        running = Demo(context, DemoScene(random_scene(objects, seed)), 20.0, *more, **options)
        try:
            yield running
        finally:
            running.close()


@pytest.fixture
def demo(lines: list[str]) -> Iterator[Demo]:
    with made(OBJECTS, 7, 2.0, lines.append) as running:
        yield running


def test_pairs_received_are_those_of_brute_force(demo: Demo) -> None:
    demo.begin()
    for time in np.arange(0.0, 12.0, 0.75).tolist():
        demo.settle(time)
        check_pairs(demo, time)


def test_a_run_ends_with_summary_and_picture(demo: Demo, lines: list[str], tmp_path: Path) -> None:
    demo.run()
    assert demo.time == 2.0
    count = check_pairs(demo, 2.0)
    assert lines[0].startswith("topics to watch: /obb_collision_demo/objects ")
    begun = [line for line in lines if " begins " in line]
    ended = [line for line in lines if " ends " in line]
    assert len(begun) - len(ended) == count
    assert any("touching" in line for line in begun)
    ends = demo.summary()
    assert ends[0].startswith(
        f"2.0 s, {OBJECTS} objects, {len(demo.scene.motions.moving)} moving, "
    )
    assert "median" in ends[1]
    assert "pairs in all, at most " in ends[2]
    assert f"at the end {count}: " in ends[2]
    pytest.importorskip("matplotlib")
    file = tmp_path / "scene.png"
    demo.save_picture(file)
    assert file.read_bytes().startswith(b"\x89PNG")
    assert 50_000 < file.stat().st_size < 600_000


def test_it_is_always_known_what_collides_while_it_runs(demo: Demo) -> None:
    said: list[DiagnosticArray] = []
    topic = f"{NAMESPACE}/collision_status"
    demo.begin()
    demo.settle(0.0)
    demo.listener.create_subscription(DiagnosticArray, topic, said.append, 100)
    demo.run()
    answers = [message.status[0] for message in said]
    assert len(answers) > 5
    assert {status.level for status in answers} <= {DiagnosticStatus.OK, DiagnosticStatus.ERROR}
    assert not {pair.value for s in answers for pair in s.values if pair.key == "reasons"} - {""}


def test_without_rclpy_or_viser_it_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("obb_collision.node.runtime.environment.find_spec", lambda name: None)
    assert main([]) == 1
    monkeypatch.setitem(sys.modules, "viser", None)
    assert open_view(0) is None
    assert capsys.readouterr().err.splitlines() == [
        "obb_collision_demo needs rclpy and common_interfaces: source a ROS 2 installation, "
        "or install 'obb_collision[ros]' by pip",
        "the live view needs viser: pip install 'obb_collision[view]'",
    ]


def test_ctrl_c_ends_it_with_its_summary() -> None:
    code = "from obb_collision.commands import demo_script; raise SystemExit(demo_script())"
    few = ("--seconds", "3600", "--no-picture", "--objects", "20")
    with started("-c", code, *few, ROS_DOMAIN_ID=str(DOMAIN + 1)) as demo:
        received = output_until(demo, " begins ")
        demo.send_signal(signal.SIGINT)
        rest, _ = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == 0
    assert "scene random: 20 objects" in received
    assert "topics to watch: " in received
    assert " pairs in all, " in rest


def test_it_ends_while_it_waits_for_effects() -> None:
    asked: list[bool] = []
    with made(OBJECTS, 7, 1.0, print, stopped=lambda: bool(asked)) as running:
        asked.append(True)
        with pytest.raises(ExternalShutdownException):
            running.begin()


def test_the_listener_waits_for_namespaces_that_it_does_not_know_yet() -> None:
    lines: list[str] = []
    rows = np.zeros(1, COLLISIONS.dtype)
    rows["ns_a"] = rows["ns_b"] = namespace_number("late")
    rows["id_b"], rows["depth"] = 1, 0.5
    message = cloud_to_ros(rows, Header(stamp=stamp_to_ros(5)))
    with own_context(DOMAIN) as context:
        listener = Listener(lines.append, context=context)
        take = {one.topic_name.split("/")[-1]: one.callback for one in listener.subscriptions}
        take["namespaces"](namespaces_to_ros(["early"]))
        take["collisions"](message)
        assert (listener.cycles, listener.pairs.rows, lines) == (0, [], [])
        take["namespaces"](namespaces_to_ros(["early", "late"]))
        take["collisions"](message)
        assert listener.cycles == 1
        assert [row[:3] for row in listener.pairs.rows] == [("late/0", "late/1", 0.5)]
        assert len(lines) == 1
        listener.destroy_node()


def messages_of(number: int, stamp: int, pairs: int, told: bool) -> Iterator[tuple[str, Any]]:
    """Yield topics and messages of a cycle: its number is the depth (mm), place and distance (m).

    told: whether it has boxes and a status, which have rates of their own.
    """
    poses = np.tile([0.0, 0, 0, 0, 0, 0, 1], (6, 1))
    poses[:, 0], header = number, Header(stamp=stamp_to_ros(stamp))
    clearance: Any = TOPICS["clearance"]
    rows, near = np.zeros(pairs, COLLISIONS.dtype), np.zeros(1, clearance.dtype)
    rows["ns_a"] = rows["ns_b"] = near["ns_a"] = near["ns_b"] = namespace_number("a")
    rows["id_a"], rows["id_b"] = 2 * np.arange(pairs), 2 * np.arange(pairs) + 1
    rows["depth"], near["distance"] = 1e-3 * number, number
    yield "collisions", cloud_to_ros(rows, header)
    yield "clearances", cloud_to_ros(near, header)
    if told:
        states = np.where(np.arange(6) < 2 * pairs, COLLIDING, FREE_BOX)
        boxes = oc.Boxes.from_poses(poses, np.ones((6, 3)))
        keys = [("a", ident) for ident in range(6)]
        yield "markers", Markers("map").write(keys, boxes, states, stamp, 1.0, None)
    status = Answer((), pairs, stamp=stamp).to_ros("node", stamp, True)
    yield "collision_status", DiagnosticArray(header=header, status=[status])


@each("stands", [False, True])
def test_nothing_of_two_cycles_is_drawn_together(stands: bool) -> None:
    random, pairs, level = Random(3), 0, None
    mixed, shown = 0, set[int]()
    with own_context(DOMAIN) as context:
        listener = Listener(lambda line: None, ["clearance"], context=context)
        listener.watch_boxes("markers")
        take = {one.topic_name.split("/")[-1]: one.callback for one in listener.subscriptions}
        take["namespaces"](namespaces_to_ros(["a"]))
        waiting: dict[str, list[Any]] = {topic: [] for topic in take}
        for number in range(1, 400):
            pairs = random.choice((0, 0, 1, 2, 3)) if number % 4 == 0 else pairs
            stamp = 7 if stands else number * 10**7
            for topic, message in messages_of(number, stamp, pairs, number % 3 == 0):
                if topic != "collision_status" or level != bool(pairs) or number % 7 == 0:
                    waiting[topic].append(message)
            level = bool(pairs)
            while sum(map(len, waiting.values())) > 8:  # each topic in its order, all in any
                topic = random.choice([topic for topic, queue in waiting.items() if queue])
                take[topic](waiting[topic].pop(0))
                if listener.cycle is None:
                    continue
                boxes, found, effects, *_, status, _ = listener.cycle
                shown.add(round(boxes.poses[0, 0]))
                assert status.level == ("ERROR" if found.rows else "OK")
                legend = dict(
                    text.split(" ", 1)[::-1]
                    for text, _, form in take_snapshot(listener.cycle, {}, {}).legend()
                    if form == "box"
                )
                colliding = int(legend.get("overlapping", 0))
                assert int(legend.get("free", 0)) == 6 - colliding
                assert status.message.startswith(f"{len(found.rows)} " if found.rows else "free")
                if not stands:
                    numbers = {1e3 * row.depth for row in found.rows}
                    numbers |= {row.distance for row in effects["clearance"]}
                    np.testing.assert_allclose([*numbers], boxes.poses[0, 0], rtol=1e-6)
                    assert colliding == 2 * len(found.rows)
                latest = listener.status.level == "ERROR", bool(listener.pairs.rows)
                mixed += len({*latest, bool(listener.boxes.colliding.any())}) > 1
        listener.destroy_node()
    assert mixed > 50, "messages of several cycles were there at once"
    assert len(shown) > 60


@pytest.fixture
def live() -> Iterator[Demo]:
    """Yield a demo as it is watched."""
    with made(20, 2, 1.0, print, live=True) as running:
        yield running


def test_the_view_shows_what_the_node_published(live: Demo) -> None:
    pytest.importorskip("viser")
    live.begin()
    states = []
    with closing(BrowserView(port=0)) as view:
        assert WAITING in view.panel.content
        for time in (0.0, 4.0):
            live.settle(time)
            snapshot = live.snapshot()
            view.show(snapshot, Status())
            drawn = {name: handle for name, (_, handle) in view.handles.items() if handle}
            scales = [h.batched_scales for name, h in drawn.items() if "/" in name]
            assert np.count_nonzero(np.concatenate(scales).all(axis=1)) == 20
            ends = [len(body.edges()) for body in snapshot.wires()]
            assert len(drawn["edges"].points) == sum(ends) > 12
            np.testing.assert_allclose(drawn["contact"].points, snapshot.contacts, atol=1e-5)
            states.append(snapshot.states.tolist())
        assert sum(row.visible for row in view.rows) == min(len(snapshot.notes), NOTES)
        note, client = snapshot.notes[0], SimpleNamespace(atomic=nullcontext)
        camera = SimpleNamespace(client=client, position=(9.0, 0.0, 9.0), look_at=(0.0, 0.0, 0.0))
        view.fly_to(note, camera)
        np.testing.assert_allclose(camera.look_at, note.place)
        assert np.linalg.norm(np.subtract(camera.position, note.place)) < 5.0 * note.extent
        assert states[0] != states[1]
        assert f"{states[1].count(FREE)} free" in view.panel.content
        with urlopen(view.url, timeout=10.0) as page:
            assert page.status == 200


def test_the_banner_says_level_reason_and_time_and_that_a_node_is_silent() -> None:
    pytest.importorskip("viser")
    status = Status()
    assert "STALE" in banner(status, 0.0)  # nothing was heard yet
    status.level, status.message, status.stamp = "ERROR", "2 pairs <collide>", 1e9
    status.values = {"reason": "blocked"}
    text = banner(status, 0.1)
    assert all(part in text for part in ("ERROR", "blocked", "2 pairs &lt;collide&gt;", ":46:40"))
    assert "STALE" in banner(status, 60.0)


def test_the_view_follows_the_topics_and_shows_edges_of_many_boxes(live: Demo) -> None:
    pytest.importorskip("viser")
    with closing(BrowserView(port=0)) as view:
        ends = np.random.default_rng(1).normal(size=(48, 3))
        assert WAITING in view.panel.content
        view.show_lines([(ends, (0.1, 0.8, 0.2)), (ends[:24], (0.9, 0.1, 0.1))], Status())
        assert view.handles["edges of boxes"][0] == 36
        assert view.panel.content == ""
    view = BrowserView(port=0)
    with closing(LiveView(view, live.listener, live.scene.shapes)):
        live.begin()
        live.spin_until(lambda: "edges" in view.handles, PATIENCE)
        live.spin_until(lambda: live.listener.status.level in view.banner.content, PATIENCE)


def test_a_running_node_is_shown_by_its_topics(live: Demo) -> None:
    pytest.importorskip("viser")
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        port = probe.getsockname()[1]
    node = f"{NAMESPACE}/{NODE_NAME}"
    view = ("-m", "obb_collision", "view", node, "--port", str(port))
    with started(*view, ROS_DOMAIN_ID=str(DOMAIN)) as process:
        assert f"view: http://localhost:{port}\n" in output_until(process, "view:")
        topic = f"{node}/markers"
        live.begin()
        live.spin_until(lambda: live.listener.count_subscribers(topic) >= 2, PATIENCE)
        with urlopen(f"http://localhost:{port}", timeout=10.0) as page:
            assert page.status == 200
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=PATIENCE) == 0


def test_boxes_come_out_of_the_bytes_of_markers() -> None:
    random = np.random.default_rng(5)
    poses = np.zeros((3, 7))
    poses[:, :3], poses[:, 6] = random.normal(size=(3, 3)), 1.0
    boxes = oc.Boxes.from_poses(poses, np.full((3, 3), 0.5))
    keys = [("a", 1), ("a longer name", 2), ("b", -3)]
    states = np.array([0, 1, 2])
    cubes = boxes_from_bytes(Markers("map").write(keys, boxes, states, 7, 1.0, None))
    assert cubes.names == ["a/1", "a longer name/2", "b/-3"]
    np.testing.assert_array_equal(cubes.poses, poses)
    np.testing.assert_array_equal(cubes.sizes, np.ones((3, 3)))
    assert cubes.doubtful.tolist() == [False, False, True]
    assert (cubes.frame, cubes.stamp, cubes.lines) == ("map", 7, [])
    lines = boxes_from_bytes(Markers("map").write(keys, boxes, states, 7, 1.0, 0.01))
    assert lines.names == []
    for (ends, color), expected in zip(lines.lines, COLORS, strict=True):
        assert len(ends) == 24
        np.testing.assert_allclose(color, expected[:3], atol=1e-6)
    with pytest.raises(RefusedError):
        boxes_from_bytes(b"no markers")

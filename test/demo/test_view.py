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


"""The live view: of the running demo, and of a node in another process, by its topics."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from contextlib import closing, nullcontext
from types import SimpleNamespace
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from processes import limited, output_until

from obb_collision.demo.command import open_view
from obb_collision.demo.scene import random_scene

rclpy_context = pytest.importorskip("rclpy.context")

from obb_collision import Boxes  # noqa: E402
from obb_collision.demo.listener import boxes_from_bytes  # noqa: E402
from obb_collision.demo.run import NAMESPACE, Demo  # noqa: E402
from obb_collision.demo.scene import DemoScene  # noqa: E402
from obb_collision.demo.snapshot import FREE  # noqa: E402
from obb_collision.demo.status import Status  # noqa: E402
from obb_collision.demo.view import NOTES, WAITING, BrowserView, LiveView, banner  # noqa: E402
from obb_collision.node.messages.box_markers import COLORS, Markers  # noqa: E402
from obb_collision.node.messages.errors import RefusedError  # noqa: E402
from obb_collision.node.node import NODE_NAME  # noqa: E402

DOMAIN = 141 + os.getpid() % 40
PATIENCE = 120.0


def test_without_viser_it_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert open_view(0) is None
    assert capsys.readouterr().err.splitlines() == [
        "the live view needs viser: pip install 'obb_collision[view]'"
    ]


@pytest.fixture
def demo() -> Any:
    context = rclpy_context.Context()
    context.init(domain_id=DOMAIN)
    scene = DemoScene(random_scene(20, 2))
    running = Demo(context, scene, 20.0, 1.0, lambda line: None, live=True)
    yield running
    running.close()
    context.try_shutdown()


def test_the_view_shows_what_the_node_published(demo: Demo) -> None:
    pytest.importorskip("viser")
    demo.begin()
    states = []
    with closing(BrowserView(port=0)) as view:
        assert WAITING in view.panel.content
        for time in (0.0, 4.0):
            demo.settle(time)
            snapshot = demo.snapshot()
            view.show(snapshot)
            drawn = {name: handle for name, (_, handle) in view.handles.items() if handle}
            scales = [h.batched_scales for name, h in drawn.items() if "/" in name]
            assert np.count_nonzero(np.concatenate(scales).all(axis=1)) == 20
            ends = [len(body.edges()) for body in snapshot.wires()]
            assert len(drawn["edges"].points) == sum(ends) > 12
            np.testing.assert_allclose(drawn["contact"].points, snapshot.contacts, atol=1e-5)
            states.append(snapshot.states.tolist())
        view.show_notes(snapshot)
        assert sum(row.visible for row in view.rows) == min(len(snapshot.notes), NOTES)
        (note, *_), camera = snapshot.notes, FakeCamera()
        view.fly_to(note, camera)
        np.testing.assert_allclose(camera.look_at, note.place)
        assert np.linalg.norm(np.subtract(camera.position, note.place)) < 5.0 * note.extent
        assert states[0] != states[1]
        assert f"{states[1].count(FREE)} free" in view.panel.content
        with urlopen(view.url, timeout=10.0) as page:
            assert page.status == 200


class FakeCamera:
    """A client's camera, without the client."""

    client = SimpleNamespace(atomic=nullcontext)
    position, look_at = (9.0, 0.0, 9.0), (0.0, 0.0, 0.0)


def test_the_banner_says_level_reason_and_time_and_that_a_node_is_silent() -> None:
    pytest.importorskip("viser")
    status = Status()
    assert "STALE" in banner(status, 0.0)  # nothing was heard yet
    status.level, status.message, status.stamp = "ERROR", "2 pairs <collide>", 1e9
    status.values = {"reason": "blocked"}
    text = banner(status, 0.1)
    assert all(part in text for part in ("ERROR", "blocked", "2 pairs &lt;collide&gt;", ":46:40"))
    assert "STALE" in banner(status, 60.0)


def test_the_view_follows_the_topics(demo: Demo) -> None:
    pytest.importorskip("viser")
    view = BrowserView(port=0)
    with closing(LiveView(view, demo.listener, demo.scene.shapes)):
        demo.begin()
        demo.spin_until(lambda: "edges" in view.handles, PATIENCE)
        demo.spin_until(lambda: demo.listener.status.level in view.banner.content, PATIENCE)


def test_a_running_node_is_shown_by_its_topics(demo: Demo) -> None:
    pytest.importorskip("viser")
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        port = probe.getsockname()[1]
    node = f"{NAMESPACE}/{NODE_NAME}"
    process = subprocess.Popen(
        [sys.executable, "-m", "obb_collision", "view", node, "--port", str(port)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"ROS_DOMAIN_ID": str(DOMAIN)},
    )
    with limited(process):
        assert output_until(process, "view:") == f"view: http://localhost:{port}\n"
        topic = f"{node}/markers"
        demo.begin()
        demo.spin_until(lambda: demo.listener.count_subscribers(topic) >= 2, PATIENCE)
        with urlopen(f"http://localhost:{port}", timeout=10.0) as page:
            assert page.status == 200
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=PATIENCE) == 0


def test_boxes_come_out_of_the_bytes_of_markers() -> None:
    random = np.random.default_rng(5)
    poses = np.zeros((3, 7))
    poses[:, :3], poses[:, 6] = random.normal(size=(3, 3)), 1.0
    boxes = Boxes.from_poses(poses, np.full((3, 3), 0.5))
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


def test_edges_of_many_boxes_are_shown(demo: Demo) -> None:
    pytest.importorskip("viser")
    with closing(BrowserView(port=0)) as view:
        ends = np.random.default_rng(1).normal(size=(48, 3))
        assert WAITING in view.panel.content
        view.show_lines([(ends, (0.1, 0.8, 0.2)), (ends[:24], (0.9, 0.1, 0.1))])
        assert view.handles["edges of boxes"][0] == 36
        assert view.panel.content == ""

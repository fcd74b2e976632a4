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

"""Makes the pictures of programs at work anew: all, or those that are named.

    python docs/make_pictures.py [demo] [arm_cell] [camera] [safety_stop] [planner]

``demo`` makes ``view.png``, ``view.gif`` and ``demo.png``, the others are those of the tutorials.
They need the extras ``ros`` and ``bench``, ``demo`` the extra ``view`` and Chromium or Chrome, too.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from base64 import b64decode
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from functools import partial
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, sleep, time
from typing import Any
from urllib.request import urlopen

import numpy as np
import rclpy
from make_plots import FOLDER, make, program_of
from PIL import Image
from rclpy.context import Context
from sensor_msgs.msg import MultiDOFJointState
from websockets.sync.client import connect

from obb_collision.benchmarks import plots
from obb_collision.demo.command import DEFAULT_SCENE, scene_file
from obb_collision.demo.picture import draw_picture
from obb_collision.demo.run import Demo
from obb_collision.demo.scene import DemoScene
from obb_collision.demo.snapshot import FREE, ROBOT, DrawnScene
from obb_collision.demo.view import BrowserView, LiveView
from obb_collision.geometry.poses import compose_poses
from obb_collision.node.runtime.environment import set_defaults
from obb_collision.scene_files.description import View

#: When vehicles collide in the scene, seconds.
TIME = 28.0
#: When the arm grazes a board in its cell, and when it is near a hand, seconds.
ARM_TIME, HAND_TIME = 10.0, 10.0
#: The film: when it begins and how long it takes, s; pictures per second, pixels, colours.
FILM, FRAMES, FILM_SIZE, COLORS = (27.0, 3.0), 10, (984, 444), 255
#: Seconds until the page is there, and until it shows a state that was sent.
LOADED, SETTLED = 15.0, 1.5
#: Pixels of the browser's window, and where it warns of a software renderer: painted over.
WINDOW, WARNING = (1640, 883), (0, 0, 345, 190)
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
#: How far the crate is from the vehicle of the safety stop, and where its node is killed, m;
#: seconds without a node.
CRATE, KILLED_AT, WITHOUT_NODE = 1.5, 1.1, 1.5
#: Seconds without news of the vehicle at the end; shorter stops have no text.
SILENCE = 1.0
#: States of the planned path that are drawn, and from where.
STATES, PATH_VIEW = 9, View((-2.0, 0.9, 1.9), (0.3, 0.0, 0.5))


@contextmanager
def browser_of(url: str) -> Iterator[Callable[[], Image.Image]]:
    """Open a page in a browser without a window; yields what takes a picture of it."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"needs one of {', '.join(BROWSERS)}")
    with TemporaryDirectory() as folder:
        command = [
            *(browser, "--headless=new", "--no-sandbox", "--hide-scrollbars"),
            *("--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
            *("--force-color-profile=srgb", f"--window-size={WINDOW[0]},{WINDOW[1]}"),
            *("--remote-debugging-port=0", f"--user-data-dir={folder}", url),
        ]
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        try:
            port, pages = Path(folder) / "DevToolsActivePort", []
            while not pages:
                sleep(0.5)
                if port.exists():
                    address = f"http://localhost:{port.read_text().split()[0]}/json/list"
                    with urlopen(address) as reply:
                        pages = [page for page in json.load(reply) if page["url"].startswith(url)]
            with connect(pages[0]["webSocketDebuggerUrl"], max_size=None) as socket:

                def take() -> Image.Image:
                    socket.send(json.dumps({"id": 1, "method": "Page.captureScreenshot"}))
                    data = json.loads(socket.recv())["result"]["data"]
                    picture = Image.open(BytesIO(b64decode(data))).convert("RGB")
                    picture.paste("white", WARNING)
                    return picture

                yield take
        finally:
            process.terminate()
            process.wait()


@contextmanager
def running_demo(scene: str, **options: Any) -> Iterator[Demo]:
    """Start the demo of a scene."""
    set_defaults()
    context = Context()
    context.init()
    description = DemoScene(*scene_file(scene))
    demo = Demo(context, description, rate=30.0, seconds=1.0, report=print, **options)
    try:
        demo.begin()
        yield demo
    finally:
        demo.close()
        context.try_shutdown()


def draw_demo() -> None:
    """Run the demo up to a time and draw that state; and a few seconds of it, in the browser."""
    with running_demo(DEFAULT_SCENE, live=True) as demo:
        scene = demo.scene
        view = BrowserView(port=0, view=scene.description.view)
        live = LiveView(view, demo.listener, scene.shapes, scene.zones)

        def picture(time: float) -> Image.Image:
            demo.settle(time)
            ready = monotonic() + SETTLED
            demo.spin_until(lambda: monotonic() >= ready)
            taken = pool.submit(take)
            demo.spin_until(taken.done)  # a node that does not spin would be STALE
            return taken.result()

        with closing(live), browser_of(view.url) as take, ThreadPoolExecutor(1) as pool:
            ready = monotonic() + LOADED
            demo.spin_until(lambda: monotonic() >= ready)
            frames = [picture(FILM[0] + k / FRAMES) for k in range(round(FILM[1] * FRAMES))]
            picture(TIME).save(FOLDER / "view.png", optimize=True)
        small = [frame.resize(FILM_SIZE, Image.Resampling.LANCZOS) for frame in frames]
        pixels = np.concatenate([np.asarray(frame).reshape(-1, 3) for frame in small])
        colors = np.unique(pixels | 7, axis=0)  # each one once: rare ones count
        palette = Image.fromarray(colors[None]).quantize(COLORS)
        first, *others = [frame.quantize(palette=palette, dither=0) for frame in small]
        options: Any = {"duration": 1000 / FRAMES, "loop": 0, "optimize": True}
        first.save(FOLDER / "view.gif", save_all=True, append_images=others, **options)
        demo.save_picture(FOLDER / "demo.png")


def draw_scene(name: str, time: float) -> None:
    """Run the demo of a scene up to a time (s), and draw that state."""
    with running_demo(name) as demo:
        demo.settle(time)
        demo.save_picture(FOLDER / "tutorials" / f"{name}.png")


def draw_safety_stop() -> None:
    """Run the program of the tutorial, kill its node and start it again; draw how it drove."""
    text = (FOLDER / "tutorials" / "mobile_robot_safety_stop.md").read_text(encoding="utf-8")
    parameters, program = re.findall(
        r"^```(?:yaml|python)\n(.*?)^```", text, re.DOTALL | re.MULTILINE
    )
    gaps = [(0.0, np.inf)]
    rclpy.init()
    listener = rclpy.create_node("picture")

    def listen(message: MultiDOFJointState) -> None:
        gaps.append((time(), CRATE - message.transforms[0].translation.x))

    listener.create_subscription(MultiDOFJointState, "object_states", listen, 10)

    def spin_until(condition: Callable[[], bool]) -> float:
        while not condition():
            rclpy.spin_once(listener, timeout_sec=0.1)
        return time()

    with TemporaryDirectory() as folder:
        file = Path(folder) / "parameters.yaml"
        file.write_text(parameters)
        command = ["obb_collision_node", "--ros-args", "--params-file", str(file)]
        node = subprocess.Popen(command)
        start: Any = [sys.executable, "-c", program]
        vehicle = subprocess.Popen(start, stderr=subprocess.PIPE, text=True)
        killed = spin_until(lambda: gaps[-1][1] < KILLED_AT)
        node.kill()
        again = spin_until(lambda: time() > killed + WITHOUT_NODE)
        node = subprocess.Popen(command)
        end = spin_until(lambda: vehicle.poll() is not None)
        node.terminate()
        node.wait()
    rclpy.shutdown()
    said = re.findall(r"\[([\d.]+)\] \[safety_stop\]: (.*)", vehicle.communicate()[1])
    begin = min(float(when) for when, words in said if words == "driving")
    with plots.picture(FOLDER / "tutorials" / "safety_stop.svg", (9.0, 4.0)) as (_, panels):
        axes = panels["a"]
        gaps.append((end + SILENCE, gaps[-1][1]))
        shown = [(when - begin, gap) for when, gap in gaps if when >= begin]
        axes.plot(*zip(*shown, strict=True), color=plots.OUR_COLOR, linewidth=3)
        axes.axhline(0.5, color="0.3", linestyle="--", linewidth=1)
        times = [float(when) - begin for when, _ in said] + [end + SILENCE - begin]
        for (_, words), since, until in zip(said, times[:-1], times[1:], strict=True):
            if words != "driving" and since > 0.0:
                axes.axvspan(since, until, color="#f4c7c3")
                if until - since > SILENCE:
                    axes.text(since + 0.05, 1.5, words.replace(": ", ":\n"), va="top")
        for when, words in ((killed, "node killed"), (again, "node started again")):
            x, arrow = when - begin, {"arrowstyle": "->"}
            axes.annotate(words, (x, 0.28), (x, 0.1), ha="left", arrowprops=arrow)
        axes.set(xlabel="s", ylabel="m to the crate", xlim=(0, times[-1]), ylim=(0, 1.6))
        axes.set_title("The vehicle stops without fresh answers, and half a metre before the crate")


def draw_planner() -> None:
    """Draw states of the arm along the path that the tutorial plans."""
    found = program_of("tutorials/planner_states_without_ros.md")
    robot, path, scene, shapes = found["robot"], found["path"], found["scene"], {}
    scene.remove("table")
    at = np.linspace(0.0, len(path) - 1.0, STATES)
    states = np.stack([np.interp(at, range(len(path)), column) for column in path.T], axis=1)
    for k, placed in enumerate(robot.link_poses(states)):
        for link, pose, parts in zip(robot.link_names, placed, robot.shapes, strict=True):
            for number, (shape, local) in enumerate(parts):
                name = f"{k}/{link}/{number}"
                scene.add(name, shape, compose_poses(pose, local))
                shapes[name] = shape
    none = np.empty((0, 3))
    kinds = np.array([ROBOT if name in shapes else FREE for name in scene.names])
    drawn = DrawnScene(
        scene.names, scene.boxes, kinds, shapes, {}, none, none, none.reshape(0, 2, 3), none,
        np.empty(0, np.bool_), [],
    )  # fmt: skip
    subtitle = f"{STATES} states of it, from the right to the left, and proved free in between"
    figure = draw_picture(drawn, "A path of the arm around a post", subtitle, PATH_VIEW)
    figure.legends[0].remove()
    figure.savefig(FOLDER / "tutorials" / "planner.png", pil_kwargs={"optimize": True})


PICTURES = {
    "demo": draw_demo,
    "arm_cell": partial(draw_scene, "arm_cell", ARM_TIME),
    "camera": partial(draw_scene, "camera", HAND_TIME),
    "safety_stop": draw_safety_stop,
    "planner": draw_planner,
}

if __name__ == "__main__":
    make(PICTURES)

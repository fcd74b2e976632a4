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

"""Makes the pictures of the demo in this folder anew: ``view.png`` and ``demo.png``.

    python docs/make_pictures.py

Needs the extras ``ros`` and ``view``, and Chromium or Chrome.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from rclpy.context import Context

from obb_collision.demo.command import DEFAULT_SCENE, scene_file
from obb_collision.demo.run import Demo
from obb_collision.demo.scene import DemoScene
from obb_collision.demo.view import LiveView, View
from obb_collision.node.runtime.environment import set_defaults

FOLDER = Path(__file__).parent
#: When vehicles collide in the scene, seconds.
TIME = 28.0
#: Pixels of the browser's window, and where it warns of a software renderer: painted over.
WINDOW, WARNING = (1640, 740), (0, 0, 345, 190)
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def photograph(url: str, file: Path) -> subprocess.Popen[bytes]:
    """Start a browser that writes a picture of a page and ends."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"needs one of {', '.join(BROWSERS)}")
    return subprocess.Popen(
        [
            *(browser, "--headless=new", "--no-sandbox", "--hide-scrollbars"),
            *("--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
            *("--force-color-profile=srgb", f"--window-size={WINDOW[0]},{WINDOW[1]}"),
            *("--virtual-time-budget=120000", f"--screenshot={file}", url),
        ]
    )


def main() -> None:
    """Run the demo up to a time and draw that state, in the browser and as a file."""
    set_defaults()
    context = Context()
    context.init()
    scene = DemoScene(*scene_file(DEFAULT_SCENE))
    view = View(port=0, view=scene.description.view)
    demo = Demo(context, scene, rate=30.0, seconds=1.0, report=print, live=True)
    live = LiveView(view, demo.listener, scene.shapes, scene.zones)
    try:
        demo.begin()
        demo.settle(TIME)
        with TemporaryDirectory() as folder:
            file = Path(folder) / "view.png"
            browser = photograph(view.url, file)
            demo.spin_until(lambda: browser.poll() is not None)
            picture = Image.open(file).convert("RGB")
            picture.paste("white", WARNING)
            picture.save(FOLDER / "view.png", optimize=True)
        demo.save_picture(FOLDER / "demo.png")
    finally:
        live.close()
        demo.close()
        context.try_shutdown()


if __name__ == "__main__":
    main()

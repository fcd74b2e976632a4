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

"""Packages that need not be there: installed and broken, they end nothing, and that is said."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from node_process import environment, running
from processes import output_until
from rig import NAMESPACE

UNSUPPORTED = """
class Meta(type):
    _TYPE_SUPPORT = None

    @classmethod
    def __import_type_support__(cls):
        {fault}

class {name}(metaclass=Meta):
    pass
"""
NOT_BUILT = "from rosidl_generator_py import import_type_support; import_type_support('nothing')"
TYPES = {
    "vision_msgs.msg.Detection3DArray": UNSUPPORTED.format(name="Detection3DArray", fault="pass"),
    "moveit_msgs.msg.ContactInformation": "class ContactInformation: pass",
    "moveit_msgs.srv.GetStateValidity": "raise OSError('libmoveit_msgs.so: cannot open')",
    "tf2_msgs.msg.TFMessage": UNSUPPORTED.format(name="TFMessage", fault=NOT_BUILT),
}


def test_a_node_goes_on_without_packages_that_are_broken(tmp_path: Path) -> None:
    for name, text in TYPES.items():
        package, module, _ = name.split(".")
        (tmp_path / package / module).mkdir(parents=True)
        (tmp_path / package / module / "__init__.py").write_text(text)
    path = os.pathsep.join([str(tmp_path), environment()["PYTHONPATH"]])
    arguments = "--ros-args", "-r", f"__ns:={NAMESPACE}", "-p", "robots:=['arm']"
    with running(*arguments, PYTHONPATH=path) as process:
        output = output_until(process, "ready:")
    for package in ("vision_msgs", "moveit_msgs", "tf2_msgs"):
        assert f"{package} is installed and cannot be used" in output
    assert "Traceback" not in output

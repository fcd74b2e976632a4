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

from glob import glob

from setuptools import find_packages, setup

package_name = "obb_collision"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(include=[package_name, f"{package_name}.*"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/launch", glob("launch/*.launch.py")),
        (f"share/{package_name}/config", glob("config/*")),
    ],
    python_requires=">=3.10",
    # The lower bounds are those that .ci/full runs the tests with.
    install_requires=[
        "setuptools>=61.0.0",
        "numpy>=1.26.0",
        "numba>=0.59.1",
        "scipy>=1.11.1",
        "trimesh>=4.4.9",
        "pyyaml>=6.0",
        "lxml>=4.9.0",
    ],
    extras_require={
        # on a robot these come from apt; matplotlib draws the picture of the demo
        "ros": [
            "ros-jazzy-rclpy[fastrtps]",
            "ros-jazzy-common-interfaces",
            "ros-jazzy-lifecycle-msgs",
            "matplotlib>=3.6.0",
        ],
        # the demo, or a running node, live in the browser
        "view": ["viser>=1.1.1"],
        # bags of ROS 2 without a ROS installation: a test replays one
        "bags": ["rosbags"],
        # pytest-xdist: two tests at a time; pycollada: trimesh writes and reads DAE with it
        "test": [
            "pytest>=7.4.0",
            "pytest-xdist>=3.4.0",
            "hypothesis>=6.98.0",
            "pycollada>=0.7.2",
        ],
        # the pages of docs/ and the API reference
        "docs": ["sphinx", "myst-parser", "furo"],
        "lint": ["ruff==0.17.5", "mypy==2.4.1"],
        # peers to compare with, and plots
        "bench": ["python-fcl", "coal", "mujoco", "matplotlib>=3.6.0"],
        # robots to check states of, and a peer that does
        "robots": ["pin", "example-robot-data", "mujoco", "matplotlib>=3.6.0"],
    },
    zip_safe=True,
    url="https://github.com/obb-collision/obb_collision",
    author="The obb_collision developers",
    author_email="obb-collision@users.noreply.github.com",
    maintainer="The obb_collision developers",
    maintainer_email="obb-collision@users.noreply.github.com",
    description="Certified oriented bounding box collision checking for ROS 2 and Python.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "obb_collision = obb_collision.commands:script",
            "obb_collision_node = obb_collision.commands:node_script",
            "obb_collision_merge = obb_collision.commands:merge_script",
            "obb_collision_demo = obb_collision.commands:demo_script",
        ],
    },
)

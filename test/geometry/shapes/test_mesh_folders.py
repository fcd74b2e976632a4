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

"""Only mesh files in allowed folders are read where somebody else names them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from each import each
from support import refused

from obb_collision.geometry.shapes import allowed_path, resolve_path, source_folder

REFUSED = "is in no folder from which meshes are read"


def package(prefix: Path, name: str) -> Path:
    """Register an installed package; returns its share folder."""
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True, exist_ok=True)
    (index / name).touch()
    share = prefix / "share" / name
    (share / "meshes").mkdir(parents=True)
    return share


@pytest.fixture
def share(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the share folder of the only installed package, ``arm``."""
    pytest.importorskip("ament_index_python")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    return package(tmp_path / "install", "arm")


@pytest.fixture
def chosen(tmp_path: Path) -> Path:
    folder = tmp_path / "chosen"
    folder.mkdir()
    return folder


def test_files_in_chosen_folders_are_allowed_wherever_the_path_comes_from(chosen: Path) -> None:
    file = chosen / "sub" / "a b.stl"
    for uri in (file.as_uri(), f"file://localhost{file.as_uri()[7:]}", str(file)):
        assert allowed_path(resolve_path(uri), [chosen]) == file
    assert allowed_path(chosen / "x" / ".." / "a.stl", [str(chosen)]) == chosen / "a.stl"


def test_a_link_of_the_chosen_folder_itself_is_followed(chosen: Path, tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(chosen)
    assert allowed_path(link / "a.stl", [link]) == chosen / "a.stl"


def test_files_outside_are_refused_however_they_are_named(chosen: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside.stl"
    outside.touch()
    (chosen / "link.stl").symlink_to(outside)
    (chosen / "up").symlink_to("..")
    (chosen / "loop").symlink_to("loop")
    hostile = [
        outside,
        chosen / ".." / "outside.stl",
        chosen / "link.stl",
        chosen / "up" / "outside.stl",
        resolve_path(f"file://{chosen}/%2e%2e/outside.stl"),
        resolve_path(f"file://{chosen}/..%2Foutside.stl"),
        Path(f"{chosen}2/a.stl"),
        Path("/etc/passwd"),
        Path("outside.stl"),
    ]
    for path in hostile:
        refused(REFUSED, allowed_path, path, [chosen])
    loop = chosen / "loop"
    assert allowed_path(loop, [chosen]) == loop, "no file: it is refused when it is read"


def test_the_reason_says_where_a_link_leads(chosen: Path, tmp_path: Path) -> None:
    (chosen / "link.stl").symlink_to(tmp_path / "secret")
    refused(
        f"it leads to {tmp_path}/secret, which is in no folder",
        allowed_path,
        chosen / "link.stl",
        [chosen],
    )


@each("path", ["/proc/self/mem", "/dev/zero", "/sys/kernel", "/dev/../proc/1"])
def test_files_of_the_kernel_are_never_read(path: str, chosen: Path) -> None:
    (chosen / "link").unlink(missing_ok=True)
    (chosen / "link").symlink_to(path)
    for name in (Path(path), chosen / "link"):
        refused(REFUSED, allowed_path, name, ["/"])


def test_zero_bytes_and_long_names_are_refused(chosen: Path) -> None:
    refused("null", allowed_path, Path("/a\0b"), [chosen])
    long = chosen / ("a" * 300)
    assert allowed_path(long, [chosen]) == long, "no file: it is refused when it is read"


def test_shares_of_installed_packages_are_allowed(share: Path) -> None:
    file = share / "meshes" / "hand.stl"
    assert allowed_path(resolve_path("package://arm/meshes/hand.stl"), []) == file
    assert allowed_path(file, []) == file
    for path in (share.parent / "other" / "a.stl", share / ".." / "other" / "a.stl"):
        refused(REFUSED, allowed_path, path, [])
    refused(REFUSED, allowed_path, resolve_path("package://arm/../../../outside.stl"), [])
    refused(REFUSED, allowed_path, resolve_path("package://arm/%2e%2e/%2e%2e/outside.stl"), [])


def test_links_of_a_share_lead_to_the_sources_of_the_same_package_only(
    share: Path, tmp_path: Path
) -> None:
    source = tmp_path / "src" / "robot"
    (source / "meshes").mkdir(parents=True)
    (source / "meshes" / "hand.stl").touch()
    link = share / "meshes" / "hand.stl"
    link.symlink_to(source / "meshes" / "hand.stl")
    refused(REFUSED, allowed_path, link, [])
    for name, allowed in (("legs", False), ("arm", True)):
        (source / "package.xml").write_text(f"<package>\n  <name> {name} </name></package>")
        assert source_folder(source / "meshes" / "hand.stl") == source
        if allowed:
            assert allowed_path(link, []) == source / "meshes" / "hand.stl"
        else:
            refused(REFUSED, allowed_path, link, [])
    for path in (source / "meshes" / "hand.stl", share / "meshes" / ".." / "meshes" / "hand.stl"):
        refused(REFUSED, allowed_path, path, [])
    (source / "package.xml").unlink()
    os.mkfifo(source / "package.xml")
    refused(REFUSED, allowed_path, link, [])


def test_without_ros_only_chosen_folders_are_allowed(
    chosen: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    assert allowed_path(chosen / "a.stl", [chosen]) == chosen / "a.stl"
    refused(REFUSED, allowed_path, Path("/usr/share/a.stl"), [chosen])

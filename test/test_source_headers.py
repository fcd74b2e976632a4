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

"""Every source file begins with the copyright notice and the licence that ament_copyright finds."""

from pathlib import Path

ROOT = Path(__file__).parent.parent
SOURCES = sorted(
    [ROOT / "setup.py"]
    + [
        path
        for folder in ("launch", "obb_collision", "test")
        for path in (ROOT / folder).rglob("*.py")
    ]
)
#: The comment block of this file: copyright, licence, where it is.
HEADER = Path(__file__).read_text(encoding="utf-8").partition("\n\n")[0] + "\n\n"


def test_the_header_is_that_of_the_apache_license() -> None:
    first, _, rest = HEADER.partition("\n")
    assert first == "# Copyright 2026 The obb_collision developers"
    wanted = (ROOT / "LICENSE").read_text(encoding="utf-8").partition("Licensed under the Apache")
    text = " ".join(line.removeprefix("#").strip() for line in rest.splitlines()).split()
    assert text == ("Licensed under the Apache" + wanted[2]).split()


def test_source_files_begin_with_copyright_and_licence() -> None:
    contents = {path: path.read_text(encoding="utf-8") for path in SOURCES}
    assert len(contents) > 500
    without = [path for path, text in contents.items() if text and not text.startswith(HEADER)]
    assert without == []

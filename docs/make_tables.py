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

"""Writes what the code says into the pages of this folder, and ``config/obb_collision.yaml``.

``python docs/make_tables.py`` needs the extra ``ros``. A table stands between
``<!-- table: NAME -->`` and ``<!-- end -->``.
"""

from __future__ import annotations

import ast
import json
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

import obb_collision.node as node
from obb_collision.node.diagnostics.answer import CODES, REMEDIES
from obb_collision.node.inputs import detections
from obb_collision.node.inputs.sources import DEPTH, KINDS
from obb_collision.node.inputs.subscriptions import INPUTS, Input
from obb_collision.node.parameters import base, sources
from obb_collision.node.parameters import table as parameters
from obb_collision.node.robots import robots, validity
from obb_collision.node.topics import topics as out
from obb_collision.node.topics.cloud import MEANINGS, Cloud, Topic
from obb_collision.node.topics.topics import NAMESPACES, TOPICS, describe_mode

FOLDER = Path(__file__).parent
PARAMETER_FILE = FOLDER.parent / "config" / "obb_collision.yaml"
Spec = parameters.Spec
PAGES = ("parameters.md", "topics.md", "status.md", "mobile_base.md")
GROUPS = {
    "general": parameters.GENERAL,
    "robots": parameters.ROBOTS,
    "sources": (
        *parameters.SOURCES,
        *(replace(spec, name=f"NAME.{spec.name}") for spec in sources.SPECS),
    ),
    "base": base.NODE,
    "zones": base.ZONE,
    "parts of velocity polygons": (*base.PART, *base.DIRECTION),
    "observation sources": base.SOURCE,
    "exclusions": base.EXCLUSION,
    "regions": parameters.REGION,
    "filters": parameters.FILTERS,
    "accuracy": parameters.ACCURACY,
}
"""The parameters that are not about effects, by table."""
READERS = {
    "named_pairs": (out.COLLISIONS, out.NamedPair),
    "named_contacts": (out.CONTACTS, out.NamedContact),
    "named_clearances": (out.CLEARANCES, out.NamedClearance),
    "named_events": (out.EVENTS, out.NamedEvent),
    "named_predictions": (out.PREDICTIONS, out.NamedPrediction),
    "named_passed_collisions": (out.PREDICTIONS, out.NamedPrediction),
    "named_points_inside": (out.POINTS_INSIDE, out.NamedPoints),
}
"""The topic that each function reads, and its rows."""


def tables() -> dict[str, str]:
    """Return all tables in Markdown, by name."""
    found = {name: parameter_table(specs) for name, specs in GROUPS.items()}
    effects = [spec for spec in parameters.SPECS if spec.name.startswith("effects.")]
    found["effects"] = parameter_table(merged(effects))
    found["topics in"] = topic_table(inputs())
    found["topics out"] = topic_table(
        (topic.name, topic.message, topic, meaning(key, topic))
        for key, topic in {**TOPICS, "": NAMESPACES}.items()
    )
    given = ((name, topic.kind, topic, topic.meaning) for name, topic in robots.KINDS.items())
    answers = ((topic.name, topic.message, topic, topic.description) for topic in robots.OUTPUTS)
    rows = ((f"ROBOT/{name}", *row) for name, *row in (*given, *answers))
    found["robot topics"] = topic_table(rows)
    found["fields"] = field_table()
    found["validity"] = as_markdown(
        [
            ["field, type", "meaning"],
            *fields(validity.ROWS, validity.MEANINGS),
            *fields(validity.PATH_ROWS, validity.PATH_MEANINGS),
        ]
    )
    found["readers"] = as_markdown(
        [
            ["function", "topic", "fields of a row"],
            *(
                [code(name), code(topic.name), ", ".join(map(code, record._fields))]
                for name, (topic, record) in READERS.items()
                if hasattr(node, name)
            ),
        ]
    )
    found["services"] = as_markdown([["service", "type", "what it does"], *services()])
    found["codes"] = as_markdown(
        [["code", "why, and what to do"], *([code(k), marked(REMEDIES[k])] for k in CODES)]
    )
    return found


def as_markdown(rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown, of which the first row is the head."""
    head, *others = rows
    lines = [head, ["---"] * len(head), *others]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def code(text: Any) -> str:
    """Return a text in code font."""
    return f"`{text}`"


def marked(text: str) -> str:
    """Return a text with the names of topics, services and parameters in it in code font."""
    return re.sub(r"(?<![\w`])((?:ROBOT|~)?/\w+|\w+_\w+)(?![\w`])", r"`\1`", text)


def parameter_table(specs: Iterable[Spec]) -> str:
    """Return name, default, range and meaning of each parameter."""
    rows = [["parameter", "default, range", "meaning"]]
    for spec in specs:
        allowed = "; " + ", ".join(map(code, spec.choices)) if spec.choices else ""
        if spec.limits is not None:
            allowed = f"; {spec.limits[0]:g}..{spec.limits[1]:g}"
        text = spec.description.replace(" Read at the start only.", " \N{DAGGER}")
        rows.append([code(spec.name), code(spec.default) + allowed, text])
    return as_markdown(rows)


def parameter_file() -> str:
    """Return the file of all parameters at their defaults, described in comments."""
    lines = [
        "# Parameters of obb_collision_node, all at their defaults.",
        "# A decimal number needs its point: 50.0, not 50.",
        "/**:",
        "  ros__parameters:",
    ]
    indent = 4
    for spec in parameters.SPECS:
        name = spec.name.removeprefix("effects.")
        if name != spec.name and indent == 4:
            lines.append("    effects:")
            indent = 6
        text = spec.description
        if spec.limits is not None:
            text += f" From {spec.limits[0]:g} to {spec.limits[1]:g}."
        start = " " * indent + "# "
        lines += textwrap.wrap(text, 100, initial_indent=start, subsequent_indent=start)
        lines.append(f"{' ' * indent}{name}: {json.dumps(spec.default)}")
    return "\n".join(lines) + "\n"


def merged(specs: Iterable[Spec]) -> Iterator[Spec]:
    """Yield the parameters of effects, those that are equal but for the effect as one."""
    alike: dict[tuple[str, ...], list[Spec]] = {}
    for spec in specs:
        effect, _, option = spec.name.removeprefix("effects.").partition("_")
        is_mode = spec.choices == parameters.MODES
        text = "" if is_mode else re.sub(rf"\b{effect}\b", "NAME", spec.description)
        key = ("mode",) if is_mode else (option, str(spec.default), str(spec.choices), text)
        alike.setdefault(key, []).append(spec)
    for key, group in alike.items():
        first, *others = group
        names = [spec.name.removeprefix("effects.") for spec in group]
        if key == ("mode",):
            yield from ()
            text = "off: not computed. auto: for readers and subscribers. on: every cycle. NAME: "
            yield _renamed(first, "effects.NAME", text + ", ".join(names) + ".")
        elif others:
            effects = ", ".join(name.removesuffix(f"_{key[0]}") for name in names)
            text = f"{key[-1]} NAME: {effects}."
            yield _renamed(first, f"effects.NAME_{key[0]}", text)
        else:
            yield first


def _renamed(spec: Spec, name: str, description: str) -> Spec:
    return Spec(name, spec.default, spec.limits, spec.choices, description=description)


def inputs() -> Iterator[tuple[str, Any, Any, str]]:
    """Yield the topics that every node takes, ``detections`` also where its type is missing."""
    for name, topic in INPUTS.items():
        yield name, topic.kind, topic, topic.meaning
    kind = "vision_msgs/Detection3DArray"
    yield (
        detections.DETECTIONS.topic,
        kind,
        Input(object, *detections.QUEUE),
        detections.MEANING,
    )
    for kind, (message, _) in KINDS.items():
        text = f"Points of the source NAME, with NAME.type {kind}."
        yield "NAME.topic", message, Input(object, DEPTH, ReliabilityPolicy.BEST_EFFORT), text
    text = "Transforms of frames, where tf2_ros is installed."
    yield "/tf, /tf_static", "tf2_msgs/TFMessage", Input(object, 100), text


def topic_table(topics: Iterable[tuple[str, Any, Any, str]]) -> str:
    """Return name, type, QoS and meaning of topics: of an Input, a Topic or a QoS."""
    rows = [["topic", "type, QoS", "meaning"]]
    for name, kind, given, text in topics:
        qos = given.qos if isinstance(given, Topic) else given
        names = ", ".join(map(code, name.split(", ")))
        rows.append([names, f"{code(type_name(kind))}, {qos_text(qos)}", text])
    return as_markdown(rows)


def type_name(kind: type | str) -> str:
    """Return a message type as ROS writes it."""
    return kind if isinstance(kind, str) else f"{kind.__module__.split('.')[0]}/{kind.__name__}"


def qos_text(qos: Any) -> str:
    """Return reliability, depth or durability, and deadline."""
    is_reliable = qos.reliability != ReliabilityPolicy.BEST_EFFORT
    is_latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    words = ["reliable" if is_reliable else "best effort"]
    words.append("latched" if is_latched else str(qos.depth))
    deadline = getattr(qos, "deadline", Duration())
    if deadline != Duration():
        words.append(f"deadline {deadline.nanoseconds / 1e9:g} s")
    return ", ".join(words)


def meaning(key: str, topic: Topic) -> str:
    """Return what a topic says, without its name."""
    text = describe_mode(key) if key else f"{topic.description}."
    return re.sub(r": the (latched )?topic \S+\.", ".", text)


def fields(layout: np.dtype[Any], meanings: Mapping[str, str]) -> Iterator[list[str]]:
    """Yield names, type and meaning of the fields of a row; all must have a meaning."""
    found = [name for names in meanings for name in names.split()]
    assert sorted(found) == sorted(set(layout.names or ()) & set(found)), found
    for names, text in meanings.items():
        yield [f"{code(names)} {np.dtype(layout[names.split()[0]])}", text]


def field_table() -> str:
    """Return the fields of all clouds: first those that most have."""
    rows = [["topic, bytes of a row", "field, type", "meaning"]]
    layout = out.COLLISIONS.dtype
    rows += [["all", *row] for row in fields(layout, MEANINGS)]
    common = {name for names in MEANINGS for name in names.split()}
    for topic in TOPICS.values():
        if isinstance(topic, Cloud):
            given = {name for names in topic.meanings for name in names.split()}
            assert set(topic.dtype.names or ()) - common <= given, topic.name
            first = f"{code(topic.name)}, {topic.dtype.itemsize}"
            for row in fields(topic.dtype, topic.meanings):
                rows.append([first, *row])
                first = ""
    return as_markdown(rows)


def services() -> Iterator[list[str]]:
    """Yield name, type and meaning of the services that the sources of the node create."""
    for path in sorted(Path(node.__file__).parent.rglob("*.py")):
        parts = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        texts = {p.name: ast.get_docstring(p) for p in parts if isinstance(p, ast.FunctionDef)}
        packages = {
            name.name: (part.module or "").split(".")[0]
            for part in parts
            if isinstance(part, ast.ImportFrom)
            for name in part.names
        }
        for part in parts:
            if isinstance(part, ast.Call) and ast.unparse(part.func).endswith(".create_service"):
                kind, name, answer = part.args
                if isinstance(name, ast.Constant) and isinstance(answer, ast.Attribute):
                    text = (texts[answer.attr] or "").partition("\n")[0]
                    kind_name = ast.unparse(kind)
                    yield [code(name.value), code(f"{packages[kind_name]}/{kind_name}"), text]


def with_tables(text: str, found: Mapping[str, str]) -> str:
    """Return the text of a page with its tables made anew."""
    for name, table in found.items():
        pattern = rf"(<!-- table: {name} -->\n).*?(<!-- end -->)"
        text = re.sub(pattern, lambda m, t=table: f"{m[1]}{t}\n{m[2]}", text, flags=re.DOTALL)
    return text


def main() -> None:
    """Write the tables into the pages, and the file of parameters."""
    found = tables()
    for name in PAGES:
        page = FOLDER / name
        page.write_text(with_tables(page.read_text(encoding="utf-8"), found), encoding="utf-8")
    PARAMETER_FILE.write_text(parameter_file(), encoding="utf-8")


if __name__ == "__main__":
    main()

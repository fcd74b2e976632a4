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

"""The table of the topics that the node publishes: name, message, fields, rows, reader.

Publishers, readers, parameters and ``/diagnostics`` follow from it; a test compares the
documentation with it.
"""

from __future__ import annotations

from math import isnan
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool
from visualization_msgs.msg import MarkerArray

from obb_collision.accuracy import Accuracy
from obb_collision.node.messages.conversions import namespace_table
from obb_collision.node.topics.cloud import LATCHED, Cloud, Namespaces, Topic
from obb_collision.node.topics.rows import (
    A_FIELDS,
    B_FIELDS,
    END,
    NORMAL_FIELDS,
    PAIR_FIELDS,
    POINT_FIELDS,
    POSITION_FIELDS,
    REMOVED,
    clearance_rows,
    collision_rows,
    contact_rows,
    event_rows,
    inside_rows,
    prediction_rows,
)
from obb_collision.queries.verdict.verdict import Verdict
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.base import Option

Triple = tuple[float, float, float]


class NamedPair(NamedTuple):
    """One collision with the objects' names, ``ns/id``, and its depth (m).

    touching: touching, or not distinguishable from touching in doubles; it counts as colliding.
    """

    a: str
    b: str
    depth: float
    touching: bool


class NamedContact(NamedTuple):
    """One contact point: where (m), unit normal from a to b, depth (m)."""

    a: str
    b: str
    point: Triple
    normal: Triple
    depth: float


class NamedClearance(NamedTuple):
    """One pair that is near: signed distance (m) and the closest points."""

    a: str
    b: str
    distance: float
    point_a: Triple
    point_b: Triple


class NamedPrediction(NamedTuple):
    """One collision to come or passed: when (s from the stamp), where (m), unit normal from a to b.

    If it is ``undecided``, it is not known whether the objects collide: they certainly don't
    before the time, but they may from then on. Point and normal are NaN then.
    """

    a: str
    b: str
    time: float
    point: Triple
    normal: Triple

    @property
    def undecided(self) -> bool:
        """Whether it is unknown if the pair collides."""
        return isnan(self.point[0])


class NamedEvent(NamedTuple):
    """The begin or end of a collision: "begin", "end", or "lasting" for one that began before.

    depth: the greatest so far (m); duration: since the begin (s); reason: why it ended, "apart",
    "removed" or "not checked"; "" if it did not.
    """

    a: str
    b: str
    event: str
    depth: float
    duration: float
    reason: str


class NamedPoints(NamedTuple):
    """One object with points inside: how many, indices in the cloud of the first and the nearest.

    distance: from the box centre to the nearest one (m). cloud: whose points these are.
    """

    name: str
    points: int
    first: int
    nearest: int
    distance: float
    cloud: str = ""


DEADLINE = 0.5
"""Seconds within which the next ``collision_status`` is promised by default: five of its periods,
for a loaded machine."""
EVENT_WORDS = ("end", "begin", "lasting")
REASON_WORDS = ("apart", "removed", "not checked")

COLLISIONS = Cloud(
    name="collisions",
    description="Pairs that collide",
    needs=("separations",),
    fields=(
        ("<f4", POSITION_FIELDS),
        ("<f8", (*NORMAL_FIELDS, "depth")),
        ("<i4", PAIR_FIELDS),
        ("u1", ("verdict", "accuracy")),
    ),
    meanings={
        "depth": "Least translation along the normal that separates the pair (m).",
        "verdict": "1 touching, or undecided by doubles; 2 overlap.",
        "accuracy": "The level that decided the pair: "
        + ", ".join(f"{int(level)} {level.name.lower()}" for level in Accuracy)
        + ".",
    },
    make_rows=collision_rows,
    record=lambda a, b, depth, verdict: NamedPair(a, b, depth, verdict == Verdict.TOUCHING),
    values=("depth", "verdict"),
)
CONTACTS = Cloud(
    name="contacts",
    fields=(
        ("<f4", POSITION_FIELDS),
        ("<f8", (*NORMAL_FIELDS, "depth", *POINT_FIELDS)),
        ("<i4", PAIR_FIELDS),
        ("u1", ("index", "count")),
    ),
    meanings={
        "depth": "Depth of this point (m).",
        "point_x point_y point_z": "The point (m), as x y z.",
        "index count": "Number of the point, and of all points of the pair.",
    },
    make_rows=contact_rows,
    record=NamedContact,
    values=(POINT_FIELDS, NORMAL_FIELDS, "depth"),
)
CLEARANCES = Cloud(
    name="clearances",
    fields=(
        ("<f4", POSITION_FIELDS),
        ("<f8", (*NORMAL_FIELDS, "distance", *A_FIELDS, *B_FIELDS)),
        ("<i4", PAIR_FIELDS),
    ),
    meanings={
        "distance": "Distance of the objects (m); negative: depth.",
        "a_x a_y a_z b_x b_y b_z": "The closest points of a and b (m); x y z is between them.",
    },
    make_rows=clearance_rows,
    record=NamedClearance,
    values=("distance", A_FIELDS, B_FIELDS),
)
PREDICTIONS = Cloud(
    name="predicted_collisions",
    fields=(
        ("<f4", POSITION_FIELDS),
        ("<f8", (*NORMAL_FIELDS, "time", *POINT_FIELDS)),
        ("<i4", PAIR_FIELDS),
        ("u1", ("passed", "undecided")),
    ),
    meanings={
        "time": "Time of the collision, from the stamp on (s); negative: passed.",
        "point_x point_y point_z": "Where the objects collide (m), as x y z.",
        "passed": "1: between the last two states; 0: to come.",
        "undecided": "1: free before time, perhaps colliding from then on; point and normal NaN.",
    },
    make_rows=prediction_rows,
    record=NamedPrediction,
    values=("time", POINT_FIELDS, NORMAL_FIELDS),
)
EVENTS = Cloud(
    name="events",
    description="Begin and end of each collision",
    note="on: also recorded without subscribers.",
    needs=("separations",),
    qos=QoSProfile(depth=100),
    fields=(
        ("<f4", POSITION_FIELDS),
        ("<f8", (*NORMAL_FIELDS, "depth", "duration")),
        ("<i4", PAIR_FIELDS),
        ("u1", ("event", "reason")),
    ),
    meanings={
        "depth": "Greatest depth so far (m); x y z is where the pair collided last.",
        "duration": "Time since the begin (s).",
        "event": "0 end; 1 begin; 2 lasting.",
        "reason": "Reason of an end: 0 objects apart; 1 an object was removed; 2 the pair is not "
        "checked.",
    },
    make_rows=event_rows,
    record=lambda a, b, event, depth, duration, reason: NamedEvent(
        a, b, EVENT_WORDS[event], depth, duration, "" if event != END else REASON_WORDS[reason]
    ),
    values=("event", "depth", "duration", "reason"),
    options={
        "begin_distance": Option(
            0.0, 0.0, 1e6, "A collision begins at this depth (m). More than 0 delays the begin."
        ),
        "clear_distance": Option(
            0.0, 0.0, 1e6, "A collision ends when the boxes are farther apart than this (m)."
        ),
        "begin_time": Option(
            0.0,
            0.0,
            3600.0,
            "A collision begins after it has lasted so long (s), at least "
            "begin_distance deep. More than 0 delays the begin.",
        ),
        "clear_time": Option(
            0.0,
            0.0,
            3600.0,
            "A collision ends after the objects have been apart so long (s), by "
            "more than clear_distance.",
        ),
    },
)
POINTS_INSIDE = Cloud(
    name="points_inside",
    note="off: no subscription to points.",
    fields=(
        ("<f4", POSITION_FIELDS),
        ("<f8", ("distance",)),
        ("<i4", ("ns", "id", "count", "first", "nearest", "cloud_ns", "cloud_id")),
    ),
    meanings={
        "distance": "From the box centre to the nearest point (m), which is x y z.",
        "ns id": "The object: number of the namespace and id.",
        "count first nearest": "Points inside; indices in the cloud of the first and the nearest.",
        "cloud_ns cloud_id": "The cloud: sources/NAME/0, or sources/points/0 of the topic points.",
    },
    make_rows=inside_rows,
    record=lambda name, cloud, count, first, nearest, distance: NamedPoints(
        name, count, first, nearest, distance, cloud
    ),
    values=("count", "first", "nearest", "distance"),
    of_points=True,
)

TOPICS: dict[str, Topic] = {
    "collisions": COLLISIONS,
    "text": Topic(
        name="collisions_text",
        description="Pairs that collide, as text",
        message=DiagnosticArray,
        needs=("separations",),
    ),
    "in_collision": Topic(
        name="in_collision",
        description="Whether any pair collides",
        note="auto: also on every change.",
        message=Bool,
        qos=LATCHED,
    ),
    "collision_status": Topic(
        name="collision_status",
        description="OK, ERROR or STALE, with the reason and counts",
        note="auto: also on every change.",
        message=DiagnosticArray,
        qos=QoSProfile(
            depth=1,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
            deadline=Duration(seconds=DEADLINE),
        ),
    ),
    "contacts": CONTACTS,
    "clearance": CLEARANCES,
    "sweep": PREDICTIONS,
    "points": POINTS_INSIDE,
    "events": EVENTS,
    "markers": Topic(name="~/markers", description="The world boxes", message=MarkerArray),
    "diagnostics": Topic(
        name="/diagnostics", description="The state of the node", message=DiagnosticArray
    ),
}
"""By the name in the parameter ``effects.NAME``: an effect of the scene, or an output of the node
only."""
NAMESPACES = Topic(
    name="namespaces",
    description="Names of the namespace numbers in the clouds",
    message=DiagnosticStatus,
    qos=LATCHED,
)
"""Without a mode: the clouds cannot be read without it."""


def mode_names() -> list[str]:
    """Return names that have a mode: topics but ``namespaces``, and effects without a topic."""
    with_needs = (name for key, topic in TOPICS.items() for name in (key, *topic.needs))
    return list(dict.fromkeys((*with_needs, *EFFECTS)))


def describe_mode(name: str) -> str:
    """Describe an effect or topic in sentences, for its parameter."""
    topic = TOPICS.get(name)
    text = EFFECTS[name].description if name in EFFECTS else ""
    if topic is None:
        return f"{text}."
    kind = "latched topic" if topic.is_latched else "topic"
    return f"{text or topic.description}: the {kind} {topic.name}. {topic.note}".rstrip()


collisions_to_ros, collisions_from_ros = COLLISIONS.to_ros, COLLISIONS.from_ros
contacts_from_ros, clearances_from_ros = CONTACTS.from_ros, CLEARANCES.from_ros
predictions_from_ros, points_inside_from_ros = PREDICTIONS.from_ros, POINTS_INSIDE.from_ros
named_pairs, named_contacts = COLLISIONS.named, CONTACTS.named
events_from_ros = EVENTS.from_ros
named_clearances, named_points_inside = CLEARANCES.named, POINTS_INSIDE.named


def named_events(message: PointCloud2, namespaces: Namespaces) -> list[NamedEvent]:
    """Return the begins and ends of collisions, and those that last, with names.

    The table may have forgotten namespaces of objects that were removed: they are ``#NUMBER``.
    """
    rows = EVENTS.from_ros(message)
    removed = rows[rows["reason"] == REMOVED]
    gone = (number for name in ("ns_a", "ns_b") for number in removed[name].tolist())
    table = {**{number: f"#{number}" for number in gone}, **namespace_table(namespaces)}
    return EVENTS.name_rows(rows, table)


def named_predictions(message: PointCloud2, namespaces: Namespaces) -> list[NamedPrediction]:
    """Return the collisions to come, with names: also what may come, see ``NamedPrediction``."""
    return _predictions(message, namespaces, passed=False)


def named_passed_collisions(message: PointCloud2, namespaces: Namespaces) -> list[NamedPrediction]:
    """Return named pairs that collided, or may have, between the last two states.

    Times are negative. ``named_predictions`` has the collisions to come.
    """
    return _predictions(message, namespaces, passed=True)


def _predictions(message: PointCloud2, namespaces: Namespaces, passed: bool) -> Any:
    rows = PREDICTIONS.from_ros(message)
    return PREDICTIONS.name_rows(rows[(rows["passed"] != 0) == passed], namespaces)

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

"""The table of the node's parameters: what they mean, their units and ranges."""

from __future__ import annotations

from collections.abc import Iterator

from obb_collision._threads import MAX_THREADS
from obb_collision.accuracy import ALL_LEVELS
from obb_collision.node.messages.names import MAX_NAME_BYTES
from obb_collision.node.objects.states import JUDGED_BY
from obb_collision.node.objects.table import POLICIES
from obb_collision.node.parameters.entries import (
    MAX_ROBOTS,
    Spec,
    base_from_text,
    folder_from_text,
    group_from_text,
    option_name,
    pair_from_text,
    pattern_from_text,
    range_from_text,
    robot_from_text,
    touches_from_text,
)
from obb_collision.node.parameters.sources import MAX_SOURCES, source_from_text
from obb_collision.node.topics.topics import TOPICS, describe_mode, mode_names
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.base import Option
from obb_collision.scene.effects.settings import AUTO, MODES
from obb_collision.scene.store.patterns import (
    MAX_OVERRIDES,
    override_from_text,
    padding_from_text,
    read_override,
)


def _seconds(text: str) -> float:
    value = float(text)  # ValueError says what it was
    if not 0.0 <= value <= MAX_AGE:
        raise ValueError(f"seconds must be between 0 and {MAX_AGE:g}, got {text}")
    return value


def _limit_from_text(text: str) -> tuple[str, float]:
    return read_override(text, "0.5", _seconds)


def _deceleration_from_text(text: str) -> tuple[str, float]:
    where, value = read_override(text, "5.0", float)
    if not 0.0 < value < float("inf"):
        raise ValueError(f"a deceleration must be positive and finite, got {value:g}")
    return where, value


def _policy_from_text(text: str) -> tuple[str, str]:
    where, policy = read_override(text, POLICIES[0], str)
    if policy not in POLICIES:
        raise ValueError(f"policy must be one of {', '.join(POLICIES)}, got {policy!r}")
    return where, policy


MAX_AGE = 1.0e6
"""Largest age limit (s)."""

GENERAL = (
    Spec("fixed_frame", "map", fixed=True).means(
        "Frame of the world boxes and of all published data."
    ),
    Spec("rate", 50.0, (0.1, 1000.0)).means("Cycles per second (Hz)."),
    Spec("trigger", "timer", choices=("timer", "arrival")).means(
        "What starts a cycle. timer: a period of 1/rate. arrival: an input message, between "
        "min_period and 1/rate after the last cycle."
    ),
    Spec("min_period", 0.002, (0.0, 1.0)).means(
        "Minimum time between two cycles with trigger arrival (s)."
    ),
    Spec("padding", 0.0, (0.0, 1000.0)).means(
        "Distance by which every box is enlarged on every side (m)."
    ),
    Spec("object_timeout", 0.0, (0.0, MAX_AGE)).means(
        "Age limit (s): an object without a newer state becomes stale. It applies from the "
        "second message of an object on. 0: no limit."
    ),
    Spec("object_timeout_overrides", [""], entry=_limit_from_text, most=MAX_OVERRIDES).means(
        "Age limits of selected objects (s), from their first message on: 'person/*: 0.5' by "
        "name, pattern or group, 'person=0.5' by namespace. The last match counts. 0: no limit."
    ),
    Spec("judge_ages", JUDGED_BY[0], choices=JUDGED_BY).means(
        "How the age of a state is measured. stamp_and_receipt: from its stamp, its receipt or the "
        "transform that placed it, whichever is oldest. receipt: from its receipt only, for "
        "senders with other clocks and for bags replayed without /clock."
    ),
    Spec("stale_policy", "unknown", choices=POLICIES).means(
        "How stale objects are treated. unknown: with their last box, and collision_status is "
        "STALE. collide: with a box that grows to all that they can have reached. keep: as if "
        "seen at their last pose just now. ignore: not checked."
    ),
    Spec("stale_policy_overrides", [""], entry=_policy_from_text, most=MAX_OVERRIDES).means(
        "stale_policy of selected objects: 'pallet/*: keep' by name, pattern or group, "
        "'pallet=keep' by namespace. The last match counts."
    ),
    Spec("required_objects", [""], entry=pattern_from_text).means(
        "Names, patterns or groups that must have an object. While an object is missing, "
        "collision_status is STALE."
    ),
    Spec("required_inputs", [""], entry=_limit_from_text).means(
        "Inputs with the maximum time (s) between two messages: 'points: 0.3'. After a longer "
        "silence, counted from the activation on, collision_status is STALE."
    ),
    Spec("ignored_objects", [""], entry=pattern_from_text).means(
        "Names or patterns of unknown objects whose states are ignored. States of other unknown "
        "objects make collision_status STALE."
    ),
    Spec("expect_empty", False).means(
        "Whether an empty scene counts as free before any object was sent, as for a robot alone."
    ),
    Spec("stale_speed", 1.6, (0.0, 1000.0)).means(
        "With stale_policy collide: speed (m/s) at which a stale box grows with its age. The "
        "speed of its last twist counts if that is faster."
    ),
    Spec("stale_reach", 5.0, (0.0, 1.0e6)).means(
        "With stale_policy collide: maximum growth of a box (m). Beyond it collision_status is "
        "STALE."
    ),
    Spec("transform_timeout", 0.2, (0.0, 60.0)).means(
        "Maximum time that a state waits for the transform of its frame (s). Then it is refused, "
        "and collision_status is STALE until a state of the object is placed."
    ),
    Spec("stamp_tolerance", 0.5, (0.0, 1.0e6)).means(
        "Maximum time that a stamp may be ahead of the node's clock (s). Beyond it the state is "
        "used, its object is grey, and the stamp is not published."
    ),
    Spec("order_timeout", 1.0, (0.0, 1.0e6)).means(
        "Time (s) for which a state with an older stamp than the latest is refused. If the latest "
        "arrived longer ago, the sender counts as restarted."
    ),
    Spec("input_timeout", 0.0, (0.0, 1.0e6)).means(
        "Maximum time between two messages about objects, by steady time (s). After a longer "
        "silence collision_status is STALE. 0: no limit."
    ),
    Spec("status_deadline", 0.5, (0.2, 3600.0), fixed=True).means(
        "Deadline of collision_status (s). The middleware informs subscribers of a missed deadline."
    ),
    Spec("cycle_timeout", 0.5, (0.05, 3600.0)).means(
        "Maximum time of a cycle beyond 1/rate (s). collision_status is STALE if no cycle ends in "
        "1/rate + cycle_timeout, or if a message waits longer for its answer."
    ),
    Spec("unknown_is_collision", True).means(
        "Whether in_collision is true while collisions are unknown."
    ),
    Spec("shape_timeout", 60.0, (0.1, 3600.0)).means(
        "Maximum time to build a shape of points or a mesh file (s)."
    ),
    Spec("shape_memory", 2000, (50, 1000000)).means(
        "Maximum memory of the process that builds shapes (MB). A million triangles take 1000."
    ),
    Spec("shape_queue", 512, (1, 1000000)).means(
        "Maximum size of points and embedded mesh files that wait to be built (MB)."
    ),
    Spec("mesh_file_size", 1000, (1, 1000000)).means("Maximum size of a mesh file (MB)."),
    Spec("max_objects", 20000, (1, 1000000)).means("Maximum number of objects."),
    Spec("max_pairs", 10000, (1, 10000000)).means(
        "Maximum number of reported pairs. A check stops beyond it, and the reported total is a "
        "lower bound."
    ),
    Spec("max_text_pairs", 100, (0, 10000)).means("Maximum number of pairs in collisions_text."),
    Spec("marker_rate", 10.0, (0.0, 100.0)).means("Rate of ~/markers (Hz). 0: not published."),
    Spec("marker_lifetime", 1.0, (0.0, 3600.0)).means(
        "Lifetime of the markers (s). RViz removes the markers of a dead node after it. "
        "0: no limit."
    ),
    Spec("marker_form", "auto", choices=("auto", "cubes", "lines")).means(
        "Form of ~/markers. cubes: a CUBE per object. lines: a LINE_LIST per colour. auto: lines "
        "above marker_max_cubes objects."
    ),
    Spec("marker_max_cubes", 200, (0, 100000)).means(
        "Maximum number of CUBEs with marker_form auto."
    ),
    Spec("marker_line_width", 0.01, (0.0001, 10.0)).means(
        "Width of the lines in LINE_LIST markers (m)."
    ),
    Spec("warn_period", 5.0, (0.0, 3600.0)).means(
        "Minimum time between two warnings about a topic for the same reason (s)."
    ),
    Spec("latched_objects", False, fixed=True).means(
        "Whether the subscription to objects is transient_local (latched). The node then receives "
        "earlier objects, and no messages from publishers that are volatile."
    ),
    Spec("autostart", True, fixed=True).means(
        "Whether the node configures and activates itself. false: a lifecycle manager does."
    ),
    Spec("mesh_folders", [""], fixed=True, entry=folder_from_text).means(
        "Folders from which mesh files are read, besides the shares of installed packages. An "
        "entry is an absolute path, which may contain packages, or 'arm_description: /opt/arm' "
        "for package://arm_description/."
    ),
    Spec("max_triangles", 2000000, (1, 100000000)).means(
        "Maximum number of triangles of a shape. Each takes up to 96 bytes."
    ),
    Spec("max_cloud_points", 10000000, (1, 1000000000)).means(
        "Maximum number of points or rows of a cloud, and of points of a marker."
    ),
    Spec("max_name_length", MAX_NAME_BYTES, (1, MAX_NAME_BYTES)).means(
        "Maximum length of a namespace or frame (bytes of UTF-8)."
    ),
)

ROBOTS = (
    Spec("robots", [""], fixed=True, entry=robot_from_text, most=MAX_ROBOTS).means(
        "Names of robots. Their links become the objects ROBOT/LINK/0, 1, ... With robots and "
        "without a scene_file, accuracy is hull by default."
    ),
    Spec("robot_bases", [""], fixed=True, entry=base_from_text, most=MAX_ROBOTS).means(
        "Poses of root links. 'arm: 0 0 0.5 0 0 0 1': x y z (m) qx qy qz qw in the fixed frame. "
        "'arm: base_link': frame of tf. 'arm: object_transform': that topic. Without an entry: "
        "the tf frame named like the root link."
    ),
    Spec("joint_timeout", 0.5, (0.0, 1.0e6)).means(
        "Age limit of joint states (s). If a joint exceeds it, collision_status is STALE. "
        "0: no limit."
    ),
    Spec("state_validity_distance", 0.0, (0.0, 1.0e6)).means(
        "Maximum distance that ROBOT/state_validity measures (m). 0: distances are not measured."
    ),
    Spec("joint_decelerations", [""], entry=_deceleration_from_text, most=MAX_OVERRIDES).means(
        "Decelerations at which joints can stop (rad/s^2 or m/s^2): 'arm/*: 5.0' by name "
        "ROBOT/JOINT or pattern. The last match counts. If all joints of a robot have one and a "
        "velocity limit, speed_scale goes by direction, and stops of trajectories brake."
    ),
    Spec("speed_stop_distance", 0.05, (0.0, 1.0e6)).means(
        "Distance from objects at which ROBOT/speed_scale is 0 (m), but by direction not for what "
        "opens."
    ),
    Spec("speed_slow_distance", 0.5, (0.001, 1.0e6)).means(
        "Distance from objects beyond which ROBOT/speed_scale is 1 (m), if it does not go by "
        "direction. It must exceed speed_stop_distance."
    ),
    Spec("speed_still_pairs", False).means(
        "Whether ROBOT/speed_scale includes still objects near links that no joint moves, such as "
        "a table under the base."
    ),
    Spec("speed_reaction_time", 0.2, (0.0, 3600.0)).means(
        "Reaction time (s): from the measurement of the joints until they follow a new "
        "ROBOT/speed_scale. Distances grow by what robot and objects can approach in it."
    ),
    Spec("trajectory_start_tolerance", 0.01, (0.0, 1000.0)).means(
        "Maximum deviation of a joint (rad or m): from the start of a trajectory, from its "
        "progress, and for joints that the trajectory does not move."
    ),
    Spec("trajectory_margin", 0.001, (1.0e-6, 1.0)).means(
        "Minimum distance of links on a trajectory (m). A smaller margin takes more time."
    ),
    Spec("robot_touch_links", [""], entry=touches_from_text).means(
        "Further links that objects attached to a link may touch: 'arm/hand: arm/finger_*', by "
        "name or pattern."
    ),
)

SOURCES = (
    Spec("sources", [""], fixed=True, entry=source_from_text, most=MAX_SOURCES).means(
        "Names of sensors. Each sensor is the object sources/NAME/0, and has the parameters "
        "NAME.type, NAME.topic, ..."
    ),
)

REGION = (
    Spec("region", [""], entry=range_from_text).means(
        "Region of space that this node checks: 'x: -inf to 5.0' for each bounded axis (m, fixed "
        "frame), the upper bound excluded. Without entries: all of space."
    ),
    Spec("region_halo", 1.0, (0.0, 1.0e6)).means(
        "Distance from the region beyond which objects are left out (m). At least "
        "effects.clearance_max_distance and effects.points_margin, unless these effects are off."
    ),
)

FILTERS = (  # before what uses groups: parameters of a file are set one by one
    Spec("groups", [""], entry=group_from_text, most=MAX_OVERRIDES).means(
        "Groups of objects: 'gripper: hand/* finger/1', by names, patterns and earlier groups. "
        "Quote words with spaces. Entries with the same group name are merged."
    ),
    Spec("allowed_pairs", [""], entry=pair_from_text).means(
        "Pairs whose collisions are ignored: 'robot/* table/1', with two names, patterns or groups."
    ),
    Spec("check_only_pairs", [""], entry=pair_from_text).means(
        "Pairs that are checked, and no others: 'robot/* table/1', with two names, patterns or "
        "groups. Without entries: all pairs."
    ),
    Spec("allowed_within", [""], entry=pattern_from_text).means(
        "Namespaces, or patterns of them, within which collisions are ignored. '*': every "
        "namespace."
    ),
    Spec("padding_overrides", [""], entry=padding_from_text, most=MAX_OVERRIDES).means(
        "Padding of selected objects (m): 'gripper/*: 0.02' by name, pattern or group, "
        "'gripper=0.02' by namespace. The last match counts."
    ),
)

ACCURACY = (
    Spec("accuracy", "obb", choices=ALL_LEVELS).means(
        "Geometry that represents objects, from coarse to exact. Levels above obb refine pairs "
        "with shapes other than boxes."
    ),
    Spec("accuracy_overrides", [""], entry=override_from_text, most=MAX_OVERRIDES).means(
        "Accuracy of selected objects: 'gripper/*: mesh' by name, pattern or group, 'gripper=mesh' "
        "by namespace. The last match counts."
    ),
    Spec("time_budget", 0.0, (0.0, 1.0)).means(
        "Time for a check (s). The nearest pairs get the requested accuracy, the rest stays at obb "
        "when time is up. No collision is missed. 0: no limit."
    ),
    Spec("threads", 0, (0, MAX_THREADS)).means(
        "Number of threads that check a large scene. 0: OBB_COLLISION_THREADS, or else the number "
        "of usable cores."
    ),
    Spec("scene_file", "", fixed=True, optional=True).means(
        "Scene file to load at the start: a path, or the name of a file in config. It replaces "
        "parameters that have their default values."
    ),
)


def _option_spec(name: str, option: Option) -> Spec:
    default, choices = option.default, option.choices
    if isinstance(default, str):
        return Spec(name, default, choices=choices).means(option.description)
    kind = int if choices and all(float(choice).is_integer() for choice in choices) else float
    limits = None if choices else (float(option.low), float(option.high))
    typed_choices = tuple(kind(choice) for choice in choices)
    return Spec(name, kind(default), limits, typed_choices).means(option.description)


def _effect_specs() -> Iterator[Spec]:
    for name in mode_names():
        yield Spec(f"effects.{name}", AUTO, choices=MODES).means(describe_mode(name))
        if name in EFFECTS:
            yield Spec(option_name(name, "objects"), ["*"], entry=pattern_from_text).means(
                f"Objects selected for {name}, by name, pattern or group. A pair is computed if at "
                "least one of its objects is selected."
            )
        for key, option in (EFFECTS if name in EFFECTS else TOPICS)[name].options.items():
            yield _option_spec(option_name(name, key), option)


SPECS = (*GENERAL, *ROBOTS, *SOURCES, *REGION, *FILTERS, *ACCURACY, *_effect_specs())

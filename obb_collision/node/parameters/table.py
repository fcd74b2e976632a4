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
    range_from_text,
    robot_from_text,
    touches_from_text,
)
from obb_collision.node.topics.topics import TOPICS, describe_mode, mode_names
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.base import Option
from obb_collision.scene.effects.settings import AUTO, MODES
from obb_collision.scene.store.patterns import (
    MAX_OVERRIDES,
    as_patterns,
    override_from_text,
    padding_from_text,
    read_override,
)


def _pattern(text: str) -> str:
    return as_patterns(text, "entry")[0]


def _seconds(text: str) -> float:
    value = float(text)  # ValueError says what it was
    if not 0.0 <= value <= MAX_AGE:
        raise ValueError(f"seconds must be between 0 and {MAX_AGE:g}, not {text}")
    return value


def _limit_from_text(text: str) -> tuple[str, float]:
    return read_override(text, "0.5", _seconds)


def _policy_from_text(text: str) -> tuple[str, str]:
    where, policy = read_override(text, POLICIES[0], str)
    if policy not in POLICIES:
        raise ValueError(f"policy must be one of {', '.join(POLICIES)}, not {policy!r}")
    return where, policy


MAX_AGE = 1.0e6
"""Largest age limit (s)."""

GENERAL = (
    Spec("fixed_frame", "map", fixed=True).means(
        "Frame of the world boxes and of all that is published."
    ),
    Spec("rate", 50.0, (0.1, 1000.0)).means("Cycles per second (Hz)."),
    Spec("trigger", "timer", choices=("timer", "arrival")).means(
        "What starts a cycle. timer: every 1/rate. arrival: every input message, between "
        "min_period and 1/rate after the last cycle."
    ),
    Spec("min_period", 0.002, (0.0, 1.0)).means(
        "Minimum time between two cycles with trigger arrival (s)."
    ),
    Spec("padding", 0.0, (0.0, 1000.0)).means("Every box grows by this on every side (m)."),
    Spec("object_timeout", 0.0, (0.0, MAX_AGE)).means(
        "An object is stale without a new state for longer than this (s), from its second "
        "message on. 0: never."
    ),
    Spec("object_timeout_overrides", [""], entry=_limit_from_text, most=MAX_OVERRIDES).means(
        "Age limits of some objects (s), from their first message on: 'person/*: 0.5' by name, "
        "pattern or group, 'person=0.5' by namespace. The last match counts. 0: never."
    ),
    Spec("judge_ages", JUDGED_BY[0], choices=JUDGED_BY).means(
        "What ages go by. stamp_and_receipt: the older of a state's stamp and its receipt, and of "
        "the transform that placed it. receipt: receipt only, for senders whose clocks are not the "
        "node's, and for bags replayed without /clock."
    ),
    Spec("stale_policy", "unknown", choices=POLICIES).means(
        "What a stale object does. unknown: it collides at its last pose, and collision_status "
        "is STALE. collide: it collides with all that it can have reached since. keep: it is "
        "taken to be where it was. ignore: it is in no pair."
    ),
    Spec("stale_policy_overrides", [""], entry=_policy_from_text, most=MAX_OVERRIDES).means(
        "stale_policy of some objects: 'pallet/*: keep' by name, pattern or group, "
        "'pallet=keep' by namespace. The last match counts."
    ),
    Spec("required_objects", [""], entry=_pattern).means(
        "Names, patterns or groups: while one has no object, collision_status is STALE."
    ),
    Spec("required_inputs", [""], entry=_limit_from_text).means(
        "Inputs and the longest time (s) between two of their messages: 'points: 0.3'. Beyond "
        "it, from the activation on, collision_status is STALE."
    ),
    Spec("ignored_objects", [""], entry=_pattern).means(
        "Names or patterns of objects whose states may come though the node lacks them: those "
        "of others make collision_status STALE."
    ),
    Spec("expect_empty", False).means(
        "Whether a scene is free before anybody sends objects or says that it is empty: a robot "
        "alone."
    ),
    Spec("stale_speed", 1.6, (0.0, 1000.0)).means(
        "With stale_policy collide: a stale box grows by its age times this speed (m/s), or "
        "that of its last twist if faster."
    ),
    Spec("stale_reach", 5.0, (0.0, 1.0e6)).means(
        "With stale_policy collide: maximum growth of a box (m). Beyond it collision_status is "
        "STALE."
    ),
    Spec("transform_timeout", 0.2, (0.0, 60.0)).means(
        "How long a state may wait for its frame's transform before it is refused (s). "
        "collision_status is STALE until a state of its object is placed."
    ),
    Spec("stamp_tolerance", 0.5, (0.0, 1.0e6)).means(
        "A stamp further ahead of the node's clock is not trusted (s): the state is used, its "
        "object is grey, and the stamp is not published."
    ),
    Spec("order_timeout", 1.0, (0.0, 1.0e6)).means(
        "A state older than its object's latest is refused, unless the latest arrived longer "
        "ago than this (s): then its sender has restarted."
    ),
    Spec("input_timeout", 0.0, (0.0, 1.0e6)).means(
        "collision_status is STALE without a message about objects for longer than this, by "
        "steady time (s). 0: never."
    ),
    Spec("status_deadline", 0.5, (0.2, 3600.0), fixed=True).means(
        "Deadline of collision_status (s): the middleware tells subscribers when it is missed."
    ),
    Spec("cycle_timeout", 0.5, (0.05, 3600.0)).means(
        "collision_status is STALE if no cycle ends within 1/rate and this (s), or a message "
        "waits longer for its answer."
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
        "Maximum number of colliding pairs reported. A check stops beyond them, and gives a lower "
        "bound of the total."
    ),
    Spec("max_text_pairs", 100, (0, 10000)).means("Maximum number of pairs in collisions_text."),
    Spec("marker_rate", 10.0, (0.0, 100.0)).means(
        "Publications of ~/markers per second (Hz). 0: none."
    ),
    Spec("marker_lifetime", 1.0, (0.0, 3600.0)).means(
        "Lifetime of the markers (s), after which RViz removes those of a node that has ended. "
        "0: no limit."
    ),
    Spec("marker_form", "auto", choices=("auto", "cubes", "lines")).means(
        "cubes: a CUBE per object. lines: a LINE_LIST per colour. auto: lines above "
        "marker_max_cubes objects."
    ),
    Spec("marker_max_cubes", 200, (0, 100000)).means(
        "Maximum number of CUBEs with marker_form auto."
    ),
    Spec("marker_line_width", 0.01, (0.0001, 10.0)).means(
        "Width of the lines in LINE_LIST markers (m)."
    ),
    Spec("warn_period", 5.0, (0.0, 3600.0)).means(
        "Minimum time between two warnings about a topic for one reason (s)."
    ),
    Spec("latched_objects", False, fixed=True).means(
        "Whether objects is subscribed as latched (transient_local): earlier objects arrive, "
        "and senders that do not latch are incompatible."
    ),
    Spec("autostart", True, fixed=True).means(
        "Whether the node configures and activates itself. false: others do."
    ),
    Spec("mesh_folders", [""], fixed=True, entry=folder_from_text).means(
        "Folders of mesh files besides the shares of installed packages: absolute paths, in "
        "which packages are found too, or 'arm_description: /opt/arm' for "
        "package://arm_description/."
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
        "Names of robots, whose links are objects ROBOT/LINK/0, 1, ... With robots and without "
        "a scene_file, accuracy is hull by default."
    ),
    Spec("robot_bases", [""], fixed=True, entry=base_from_text, most=MAX_ROBOTS).means(
        "Where root links stand: 'arm: 0 0 0.5 0 0 0 1', x y z (m) qx qy qz qw in the fixed "
        "frame, 'arm: base_link' by tf, or 'arm: object_transform' by that topic. Without an "
        "entry, by tf in the frame of the root link."
    ),
    Spec("joint_timeout", 0.5, (0.0, 1.0e6)).means(
        "A joint without a new state for longer than this is stale, and its robot unknown (s). "
        "0: never."
    ),
    Spec("state_validity_distance", 0.0, (0.0, 1.0e6)).means(
        "How far ROBOT/state_validity looks for distances (m). 0: without distances."
    ),
    Spec("speed_stop_distance", 0.05, (0.0, 1.0e6)).means(
        "Distance from objects at which ROBOT/speed_scale is 0 (m)."
    ),
    Spec("speed_slow_distance", 0.5, (0.001, 1.0e6)).means(
        "Distance from which on ROBOT/speed_scale is 1 (m). More than speed_stop_distance."
    ),
    Spec("speed_still_pairs", False).means(
        "Whether ROBOT/speed_scale also counts objects that stand still beside links that no joint "
        "moves, such as a table under the base."
    ),
    Spec("speed_reaction_time", 0.2, (0.0, 3600.0)).means(
        "Both distances grow by how far robot and objects can approach in this time (s)."
    ),
    Spec("trajectory_start_tolerance", 0.01, (0.0, 1000.0)).means(
        "How far a joint may be from a trajectory at its start, where it has passed, and where "
        "it is to stay (rad or m)."
    ),
    Spec("trajectory_margin", 0.001, (1.0e-6, 1.0)).means(
        "Distance that links keep on a trajectory (m). Smaller ones take more time."
    ),
    Spec("robot_touch_links", [""], entry=touches_from_text).means(
        "Links that attached objects may touch besides their own: 'arm/hand: arm/finger_*', "
        "names or patterns."
    ),
)

REGION = (
    Spec("region", [""], entry=range_from_text).means(
        "Part of space whose pairs are found: 'x: -inf to 5.0' for each axis with ends (m, "
        "fixed frame), without the second end. Without entries, all of space."
    ),
    Spec("region_halo", 1.0, (0.0, 1.0e6)).means(
        "Objects farther than this from the region take no part (m). At least "
        "effects.clearance_max_distance and effects.points_margin, unless these are off."
    ),
)

FILTERS = (  # before what uses groups: parameters of a file are set one by one
    Spec("groups", [""], entry=group_from_text, most=MAX_OVERRIDES).means(
        "Names for sets of objects: 'gripper: hand/* finger/1', of names, patterns and earlier "
        "groups, quoted if with spaces. Entries of one name add up."
    ),
    Spec("allowed_pairs", [""], entry=pair_from_text).means(
        "Pairs that may collide unreported: 'robot/* table/1', two names, patterns or groups each."
    ),
    Spec("check_only_pairs", [""], entry=pair_from_text).means(
        "The only pairs that are checked: 'robot/* table/1', two names, patterns or groups "
        "each. Without entries, all."
    ),
    Spec("allowed_within", [""], entry=_pattern).means(
        "Namespaces, or patterns of them, whose objects may collide with each other unreported. "
        "'*': each."
    ),
    Spec("padding_overrides", [""], entry=padding_from_text, most=MAX_OVERRIDES).means(
        "Padding of some objects (m): 'gripper/*: 0.02' by name, pattern or group, "
        "'gripper=0.02' by namespace. The last match counts."
    ),
)

ACCURACY = (
    Spec("accuracy", "obb", choices=ALL_LEVELS).means(
        "What stands for objects, from coarse to exact. Levels above obb refine pairs with "
        "other shapes than boxes."
    ),
    Spec("accuracy_overrides", [""], entry=override_from_text, most=MAX_OVERRIDES).means(
        "Accuracy of some objects: 'gripper/*: mesh' by name, pattern or group, 'gripper=mesh' "
        "by namespace. The last match counts."
    ),
    Spec("time_budget", 0.0, (0.0, 1.0)).means(
        "Time for a check (s): the nearest pairs get the accuracy requested, those that there "
        "is no time for stay on obb. No collision is missed. 0: no limit."
    ),
    Spec("threads", 0, (0, MAX_THREADS)).means(
        "Number of threads that check a large scene. 0: OBB_COLLISION_THREADS, else one per "
        "core that the node may use."
    ),
    Spec("scene_file", "", fixed=True, optional=True).means(
        "Scene file to load at the start: a path, or the name of one in config. It replaces "
        "parameters at their defaults."
    ),
)


def _option_spec(name: str, option: Option) -> Spec:
    default, choices = option.default, option.choices
    if isinstance(default, str):
        return Spec(name, default, choices=choices).means(option.description)
    kind = int if choices and all(float(choice).is_integer() for choice in choices) else float
    limits = None if choices else (float(option.low), float(option.high))
    given = tuple(kind(choice) for choice in choices)
    return Spec(name, kind(default), limits, given).means(option.description)


def _effect_specs() -> Iterator[Spec]:
    for name in mode_names():
        yield Spec(f"effects.{name}", AUTO, choices=MODES).means(describe_mode(name))
        if name in EFFECTS:
            yield Spec(option_name(name, "objects"), ["*"], entry=_pattern).means(
                f"Objects selected for {name}, by name, pattern or group. A pair is computed if at "
                "least one of its objects is selected."
            )
        for key, option in (EFFECTS if name in EFFECTS else TOPICS)[name].options.items():
            yield _option_spec(option_name(name, key), option)


SPECS = (*GENERAL, *ROBOTS, *REGION, *FILTERS, *ACCURACY, *_effect_specs())

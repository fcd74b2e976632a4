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

"""One robot of the node: its description and joint states come by topics, its links are objects.

Where its links are is known while it has a description, a state of each joint that is neither
refused nor stale, and a base. Otherwise the links are grey, and ``fault`` says why.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Thread

import numpy as np

from obb_collision.geometry.poses import IDENTITY_POSE, unit_poses
from obb_collision.geometry.validation import without_warnings
from obb_collision.node.messages.cdr import NamedPose
from obb_collision.node.messages.conversions import NANOSECONDS, stamp_from_ros, unusable_poses
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.states import OLDER, State
from obb_collision.node.objects.table import NO_TIME
from obb_collision.node.parameters.entries import BY_TOPIC, Base
from obb_collision.node.robots.joints import Joints, Timestamps, joints_from_bytes, text_from_bytes
from obb_collision.node.robots.links import NONE_ATTACHED, AttachedObjects, LinkObjects
from obb_collision.node.runtime.guard import INTERNAL_ERROR
from obb_collision.robots.robot import Robot
from obb_collision.scene_files.mesh_files import MeshReading
from obb_collision.typing import Floats

DESCRIPTION, SEMANTIC = "robot_description", "robot_description_semantic"
JOINT_STATES = "joint_states"
BAD_DESCRIPTION = "bad description"
BOTH = "URDF and SRDF"
ROBOT, JOINT, BASE = "robot_unknown", "joint_unknown", "base_unknown"
"""Codes of ``evidence``."""
START = "<"
"""What XML begins with: anything else would be the name of a file."""
FIRST = np.zeros(1, np.int64)
"""The row of the only base."""
ENDING = 2.0
"""Seconds to wait at the end for the thread that reads."""


class DescriptionReading(Thread):
    """Makes a robot of its URDF and SRDF, in a thread: meshes may take minutes to read."""

    def __init__(self, meshes: MeshReading, urdf: str, srdf: str | None) -> None:
        super().__init__(name="robot_description", daemon=True)
        self._meshes, self._texts = meshes, (urdf, srdf)
        self.is_abandoned = False
        self.result: Robot | str | None = None
        """The robot, or why there is none; None while it is being read."""

    def run(self) -> None:
        """Read the description."""
        try:
            meshes = self._meshes
            with without_warnings():  # what is odd is in the diagnostics
                self.result = Robot.from_urdf(*self._texts, meshes.folders, read_mesh=meshes.read)
        except ValueError as error:
            self.result = str(error)
        except Exception as error:
            self.result = f"{INTERNAL_ERROR}: {type(error).__name__}: {error}"
        finally:
            self._meshes.close()

    def abandon(self) -> None:
        """Make the reading end soon; a mesh that is being read fails."""
        self.is_abandoned = True
        self._meshes.abandon()


class RobotInput:
    """A robot, by its name; base: where it stands; meshes: reads mesh files."""

    def __init__(self, base: Base, objects: Objects, meshes: Callable[[], MeshReading]) -> None:
        self.name, self.base = base.robot, base
        self._objects, self._meshes = objects, meshes
        kinds = (DESCRIPTION, SEMANTIC, JOINT_STATES)
        self._monitors = {kind: objects.monitors[f"{self.name}/{kind}"] for kind in kinds}
        self.reading: DescriptionReading | None = None
        """Of the latest description, or of one before, abandoned; None where it was taken."""
        self._texts: dict[str, str] = {}  # the latest of each kind
        self._refused: dict[str, str] = {}  # why the latest of a kind can't be used, or both
        self._robot: Robot | None = None  # of the latest one that can be
        self._unadded = ""  # why its links could not be added
        self._renewed = False  # whether there are other objects than at the last ``apply``
        self._unplaced = ""  # why the latest state could not be
        self.links: LinkObjects | None = None
        self.joints: Joints | None = None  # of the robot whose links there are
        self._base: tuple[Floats, str] | None = None  # pose and frame
        if base.pose is not None:
            self._base = unit_poses(np.array(base.pose)), ""
        self._bases, self._base_sender = Timestamps(1, objects.states), 0
        self._changed = False
        self._link_poses: Floats | None = None
        self.attached = NONE_ATTACHED
        """The objects attached to its links."""
        self._base_refused = ""  # why its latest pose could not be used
        self.faults = {ROBOT: "no robot_description"}
        """Why the places of the links are unknown, by code."""
        self.halt = ""
        """Why its ``speed_scale`` is 0, "" if it is not, or not requested."""

    @property
    def fault(self) -> str:
        """Why the places of the links are unknown, "" if they are known."""
        return "; ".join(self.faults.values())

    def receive_text(self, kind: str, data: bytes, now: int) -> None:
        """Begin to read a URDF, with the SRDF if there is one, unless it is only sent again.

        While the last of either is refused, the robot is in doubt.
        """
        try:
            text = text_from_bytes(data)
            if not text.lstrip("\ufeff \t\r\n").startswith(START):
                raise RefusedError(BAD_DESCRIPTION, "not valid XML")
        except RefusedError as error:
            self._refused[kind] = f"{kind} refused: {error}"
            raise
        was_refused = bool(self._refused.pop(kind, "")) or BOTH in self._refused
        if text != self._texts.get(kind) or was_refused or self._unadded:
            self._texts[kind] = text
            if DESCRIPTION in self._texts:
                if self.reading is not None:
                    self.reading.abandon()
                self.read()

    def read(self) -> None:
        """Read the latest description, once one that is abandoned is no longer read."""
        if self.reading is not None and self.reading.is_alive():
            return
        self._refused.pop(BOTH, "")
        urdf, srdf = self._texts[DESCRIPTION], self._texts.get(SEMANTIC)
        try:
            self.reading = DescriptionReading(self._meshes(), urdf, srdf)
            self.reading.start()
        except Exception as error:  # no memory for a thread, for example
            self.reading = None
            self._refuse_description(f"{INTERNAL_ERROR}: {error}")

    def _refuse_description(self, why: str) -> None:
        self._refused[BOTH] = f"{DESCRIPTION} refused: {why}"
        self._monitors[DESCRIPTION].refuse(BAD_DESCRIPTION, "whole message", why)

    def store_joints(self, data: bytes, now: int) -> None:
        """Store the states of joints; drop them if there is no robot yet."""
        message = joints_from_bytes(data)
        if self.joints is not None:
            self.joints.store_values(message, now)
            self._changed, self._link_poses = True, None

    def store_base(self, message: NamedPose, now: int) -> None:
        """Store where the root link is, by ``object_transform``."""
        try:
            if self.base.frame != BY_TOPIC:
                raise RefusedError(
                    "object of another input", "robot_bases does not name this topic"
                )
            if unusable_poses(message.pose)[0]:
                raise RefusedError("bad pose")
            stamp = stamp_from_ros(message.header.stamp)
            states = self._objects.states
            if self._bases.find_late(FIRST, stamp, now)[0]:
                raise RefusedError(OLDER)
            self._objects.placement.frame_index(message.header.frame_id)
        except RefusedError as error:
            monitor = self._objects.monitors["object_transform"]
            monitor.refuse(error.reason, repr(self.name), error.detail)
            if error.reason != OLDER:
                self._base_refused = f"its latest pose was refused: {error.reason}"
            return
        stamp = stamp if stamp <= now + states.stamp_tolerance else 0
        self._bases.note(FIRST, stamp, now)
        self._base = unit_poses(message.pose[0]), message.header.frame_id
        self._base_refused, self._changed = "", True
        self._base_sender = self._objects.monitors["object_transform"].sender

    def apply(self, now: int, timeout: float) -> bool:
        """Update the objects by the messages since the last call; return whether objects differ.

        timeout: the age (s) at which joints are stale, 0 for never.
        """
        outcome = None
        if self.reading is not None and self.reading.is_abandoned:
            self.read()
        elif self.reading is not None and self.reading.result is not None:
            outcome, self.reading = self.reading.result, None
        if isinstance(outcome, str):
            self._refuse_description(outcome)
        elif outcome is not None:
            self._robot = outcome
            for doubt in outcome.doubts:
                self._monitors[DESCRIPTION].doubt("odd description", detail=doubt)
            self._replace(outcome)
        self.update_faults(now, timeout)
        if self.links is not None:
            if not self.faults and self._changed:
                self._place(now)
                self.update_faults(now, timeout)
            if self.faults:
                self.links.refuse()
        renewed, self._renewed = self._renewed or outcome is not None, False
        return renewed

    def update_faults(self, now: int, timeout: float) -> None:
        """Find the faults; timeout: as for ``apply``."""
        faults = self._find_faults(now, timeout)
        self.faults = {code: why for code, why in faults.items() if why}

    def _find_faults(self, now: int, timeout: float) -> dict[str, str]:
        """Return the faults by code of ``evidence``, "" where there is none."""
        reading = f"{DESCRIPTION} being read" if self.reading is not None else ""
        fault = "; ".join(self._refused.values()) or reading or self._unadded
        if fault or self.joints is None:
            return {ROBOT: fault or f"no {DESCRIPTION}"}
        joints, base = self.joints.fault(now, timeout), self._base_fault(now)
        unplaced = "" if self._changed or joints else self._unplaced
        return {JOINT: joints, BASE: base or unplaced}

    def _base_fault(self, now: int) -> str:
        """Return why the pose of the base is unknown, "" if it is known."""
        if self.base.frame != BY_TOPIC:
            return ""
        if self._base is None or self._base_refused:
            return self._base_refused or f"no base by {BY_TOPIC}"
        if self._bases.overdue[0] < now:
            return "its latest poses have older stamps"
        is_old = self._is_old(int(self._bases.since[0]), now, bool(self._bases.repeated[0]))
        return f"its base by {BY_TOPIC} is stale" if is_old else ""

    def _is_old(self, since: int, now: int, repeated: bool) -> bool:
        """Return whether what the base goes by is older (ns) than the age limit of its name."""
        return 0.0 < self._base_limit(repeated) * NANOSECONDS < now - since

    def _base_limit(self, repeated: bool) -> float:
        """Return the age limit of the base (s), 0 for none; repeated: whether it came again."""
        limits = self._objects.staleness.limits
        own = limits.timeouts.value(self.name)
        return own if own is not None else limits.timeout if repeated else 0.0

    def known_until(self, joint_timeout: float) -> int:
        """Return up to when (ns) the state is known, by the oldest of joints and base that age.

        NO_TIME where none does.
        """
        assert self.joints is not None
        times = [NO_TIME]
        if joint_timeout > 0.0:
            times.append(int(self.joints.since.min(initial=NO_TIME)))
        if self.base.frame == BY_TOPIC and self._base_limit(bool(self._bases.repeated[0])) > 0.0:
            times.append(int(self._bases.since[0]))
        return min(times)

    def transform_fault(self, stamp: int, now: int) -> str:
        """Return why the base's transform of a stamp (ns) is stale, "" if it is not."""
        frame = "" if self.where is None else self.where[1]
        since = self._objects.placement.latest.since(frame, stamp, now)
        is_old = since > 0 and self._is_old(since, now, True)
        return f"the transform of its base, of {frame!r}, is stale" if is_old else ""

    def _replace(self, robot: Robot) -> None:
        """Take a robot in place of the one before."""
        if self.links is not None:
            self.links.remove()
        self.links = self.joints = None
        self._unadded = ""
        links = LinkObjects(self.name, robot, self._objects)
        try:
            links.add()
        except RefusedError as error:
            self._unadded = f"{DESCRIPTION} refused: {error}"
            self._monitors[DESCRIPTION].refuse(error.reason, "whole message", error.detail)
            return
        self.links, self._changed, self._unplaced, self._link_poses = links, True, "", None
        self.joints = Joints(robot, self._monitors[JOINT_STATES], self._objects.states)

    def _place(self, now: int) -> None:
        """Store where the links are by the latest joints and base."""
        links, joints = self.links, self.joints
        assert links is not None
        assert joints is not None
        pose, frame = self._base or (IDENTITY_POSE, self.base_frame)
        stamp = max(joints.stamp, int(self._bases.stamps[0]))
        received = joints.newest if len(joints.names) else now
        state = State(frame, stamp, received, f"{self.name}/{JOINT_STATES}")
        self._changed = False
        try:
            poses, kinds, twists = links.located(pose, joints.positions, joints.velocities)
            self._objects.states.store(links.slots, poses, state, twists, kinds)
            self._unplaced = ""
        except RefusedError as error:
            self._unplaced = f"links not placed: {error}"
            self._monitors[JOINT_STATES].refuse(error.reason, "whole state", error.detail)
        except Exception as error:  # not foreseen, and so not known
            self._unplaced = f"links not placed: {INTERNAL_ERROR}: {error}"
            self.faults = {BASE: self._unplaced}
            links.refuse()
            raise

    @property
    def base_frame(self) -> str:
        """The frame in which the root link stands, or that is the root link's."""
        assert self.links is not None
        return self.base.frame or self.links.robot.link_names[0]

    @property
    def where(self) -> tuple[Floats, str] | None:
        """The pose (7,) of the root link in a frame, and the frame; None if it is unknown."""
        if self.links is None or (self.base.frame == BY_TOPIC and self._base is None):
            return None
        return self._base or (IDENTITY_POSE, self.base_frame)

    @property
    def stands_in(self) -> str:
        """The frame in which the root link stands, "" where that is not by tf."""
        if self.base.pose is not None or self.base.frame == BY_TOPIC:
            return ""
        return self.base.frame if self.links is None else self.base_frame

    @property
    def link_poses(self) -> Floats:
        """The poses (n, 7) of all links in the frame of the root, by the latest joints."""
        assert self.links is not None
        assert self.joints is not None
        if self._link_poses is None:
            self._link_poses = self.links.robot.link_poses(self.joints.positions)
        return self._link_poses

    def set_attached(self, attached: AttachedObjects) -> bool:
        """Set the attached objects, and their twists; return whether other objects are attached.

        The objects are as old as the joints, for they move with them.
        """
        same, self.attached = attached.identity == self.attached.identity, attached
        if len(attached.slots) and not self.faults:
            links, joints = self.links, self.joints
            assert links is not None
            assert joints is not None
            newest, received = joints.since.max(initial=0), self._objects.table.received
            received[attached.slots] = np.maximum(received[attached.slots], newest)
            links.set_twists(attached, self.link_poses, joints.positions, joints.velocities)
        return not same

    def goes_by(self, sender: int) -> bool:
        """Return whether a joint or the base has the value of a sender."""
        joints = NONE_ATTACHED.slots if self.joints is None else self.joints.senders
        return bool((joints == sender).any()) or self._base_sender == sender

    def has_base_of(self, time: int) -> bool:
        """Return whether the base came by its topic, at a time (ns) or before."""
        return self.base.frame == BY_TOPIC and int(self._bases.received[0]) <= time

    def describe(self) -> dict[str, object]:
        """Return the values in ``/diagnostics``."""
        if self.links is None:
            return {"links": 0}
        robot = self.links.robot
        counts = {
            "links": len(robot.link_names),
            "shapes": len(self.links.keys),
            "joints": len(robot.joint_names),
        }
        texts = {"odd": "; ".join(robot.doubts), "speed_scale is 0": self.halt}
        return counts | {key: text for key, text in texts.items() if text}

    def cleared(self) -> None:
        """Add the links again, whose joints are not known: all objects were removed."""
        self.links = self.joints = None
        self._renewed = True
        if self._robot is not None:
            self._replace(self._robot)

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        if self.joints is not None:
            self.joints.clock_jumped(shift)
        self._bases.clock_jumped(shift)

    def close(self) -> None:
        """Stop reading."""
        if self.reading is not None:
            self.reading.abandon()
            self.reading.join(ENDING)

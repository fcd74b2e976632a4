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

"""Poses of frames in the fixed frame: with tf2 of any frame, without it of the fixed one."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from copy import copy
from typing import Any, Protocol

import numpy as np
from rclpy.node import Node
from rclpy.time import Time

from obb_collision.geometry.poses import IDENTITY_POSE, compose_poses, inverse_poses
from obb_collision.node.messages.conversions import (
    stamp_from_ros,
    transform_from_ros,
    unusable_poses,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.optional import optional
from obb_collision.node.objects.table import Slots
from obb_collision.node.runtime.guard import Guard
from obb_collision.typing import Floats, Mask

tf2_ros: Any = optional("tf2_msgs.msg", "TFMessage") and optional("tf2_ros")
"""None where tf2 cannot be used."""

UNKNOWN_FRAME, NO_TRANSFORM, EXTRAPOLATION = "unknown frame", "no transform", "extrapolation"
"""Reasons why a frame can't be placed: no transform names it, nothing connects it with the fixed
frame, or its known transforms do not cover the stamp."""

LINK_NOT_KNOWN = "link not known"
"""Reason: a frame is that of a link, and its robot is not known (yet)."""

LATER = (UNKNOWN_FRAME, NO_TRANSFORM, EXTRAPOLATION)
"""What may be otherwise later on."""


class FrameSource(Protocol):
    """Looks up frames other than the fixed frame."""

    waits: bool
    """Whether a frame unknown now may be known later."""
    description: str
    """For the log: what frames are accepted."""

    def lookup(self, frame: str, stamp: int) -> tuple[Floats, int]:
        """Return the pose (7,) of ``frame`` in the fixed frame at ``stamp`` (ns; 0: the latest).

        Also returns the stamp of the transform used: of a chain the oldest, 0 of static ones.
        Raises RefusedError where it isn't known (yet): "unknown frame", "no transform" between the
        two, "extrapolation" where the stamp is later or earlier than what is known.
        """
        ...


class FixedFrameOnly:
    """Stands in for tf2 where it is missing: knows the fixed frame only."""

    waits = False

    def __init__(self, fixed_frame: str) -> None:
        self._fixed_frame = fixed_frame
        self.description = "fixed frame only (no tf2_ros here)"

    def lookup(self, frame: str, stamp: int) -> tuple[Floats, int]:
        """Refuse every frame."""
        raise RefusedError(UNKNOWN_FRAME, f"{frame!r} is not {self._fixed_frame!r}; no tf2 here")


def reason_from_tf2(error: Exception, tf2: Any) -> str:
    """Return under which reason a TransformException of the module ``tf2`` is counted."""
    if isinstance(error, tf2.ExtrapolationException):
        return EXTRAPOLATION
    if isinstance(error, (tf2.LookupException, tf2.InvalidArgumentException)):
        return UNKNOWN_FRAME
    return NO_TRANSFORM


class TfFrames:
    """Looks poses of frames up by tf2; the node's own executor receives the transforms."""

    waits = True
    description = "tf2"

    def __init__(self, node: Node, fixed_frame: str) -> None:
        self._fixed_frame = fixed_frame
        self.buffer: Any = tf2_ros.Buffer(node=node)
        self._listener: Any = tf2_ros.TransformListener(self.buffer, node, spin_thread=False)

    def seen_from(self, frame: str) -> TfFrames:
        """Return the same of poses in another frame."""
        other = copy(self)
        other._fixed_frame = frame
        return other

    def lookup(self, frame: str, stamp: int) -> tuple[Floats, int]:
        """Return the pose (7,) of ``frame`` from the tf2 buffer, without waiting.

        At time 0 tf2 stamps what it finds by the latest time that all transforms of the chain have,
        static ones aside, and 0 where all are static.
        """
        try:
            answer = self.buffer.lookup_transform(self._fixed_frame, frame, Time(nanoseconds=stamp))
        except tf2_ros.TransformException as error:
            raise RefusedError(reason_from_tf2(error, tf2_ros), str(error)) from error
        return transform_from_ros(answer.transform), stamp_from_ros(answer.header.stamp)


def make_frames(node: Node, fixed_frame: str) -> FrameSource:
    """Return the source of frames: tf2 where it is installed, else the fixed frame only."""
    return FixedFrameOnly(fixed_frame) if tf2_ros is None else TfFrames(node, fixed_frame)


class SeenFrom:
    """Poses in another frame than the fixed one, by way of that: at one stamp each."""

    def __init__(self, frames: FrameSource, fixed_frame: str, frame: str) -> None:
        self._frames, self._fixed_frame, self._frame = frames, fixed_frame, frame

    def lookup(self, frame: str, stamp: int) -> tuple[Floats, int]:
        """Return the pose (7,) of a frame, and the stamp of the transform; RefusedError."""
        (own, since), (pose, at) = (self._find(name, stamp) for name in (self._frame, frame))
        stamps = [one for one in (since, at) if one]
        return compose_poses(inverse_poses(own[None]), pose[None])[0], min(stamps, default=0)

    def _find(self, frame: str, stamp: int) -> tuple[Floats, int]:
        if frame == self._fixed_frame:
            return np.array(IDENTITY_POSE), 0
        return self._frames.lookup(frame, stamp)


def lookup_in(
    frames: FrameSource, fixed_frame: str, frame: str
) -> Callable[[str, int], tuple[Floats, int]]:
    """Return what looks poses up in a frame, as ``FrameSource.lookup`` does in the fixed one."""
    if isinstance(frames, TfFrames):
        return frames.seen_from(frame).lookup
    return SeenFrom(frames, fixed_frame, frame).lookup


class LatestTransforms:
    """Times (ns) of the latest transforms of frames, which stay when their sender has died.

    A time is the older of a transform's stamp and of when it was first seen. by_stamp: False
    where stamps are of other clocks.
    """

    def __init__(self) -> None:
        self.by_stamp = True
        self._seen: dict[str, tuple[int, int]] = {}  # by frame: the stamp, and since when it is it

    def since(self, frame: str, stamp: int, now: int) -> int:
        """Return since when (ns) a transform with this stamp was true, 0 for a static one."""
        if stamp == 0:
            return 0
        if self._seen.get(frame, NOT_SEEN)[0] != stamp:
            self._seen[frame] = stamp, now
        first = self._seen[frame][1]
        return max(min(stamp, first) if self.by_stamp else first, 1)

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        self._seen = {name: (stamp, at + shift) for name, (stamp, at) in self._seen.items()}


NOT_SEEN = 0, 0
FEW_STAMPS = 8
"""Up to this many stamps of a frame are looked up one after the other, newest first; with
more, steps backwards double: a transform missing at a stamp is missing at all newer ones."""


class Transforms:
    """Looks frames up at most once per stamp; valid for one cycle.

    name: of a frame by its index.
    """

    def __init__(self, frames: FrameSource, name: Callable[[int], str], guard: Guard) -> None:
        self._frames, self._name, self._guard = frames, name, guard
        self._found: dict[tuple[int, int], tuple[Floats, int] | None] = {}
        self.errors: dict[int, RefusedError] = {}
        """By frame: why the latest look-up of those that failed did."""

    def get(self, frame: int, stamp: int) -> tuple[Floats, int] | None:
        """Return the pose (7,) of a frame at a stamp (ns, 0: latest), and the transform's stamp.

        None where there is none.
        """
        key = frame, stamp
        if key not in self._found:
            self._found[key] = self._look_up(frame, stamp)
        return self._found[key]

    def _look_up(self, frame: int, stamp: int) -> tuple[Floats, int] | None:
        name = self._name(frame)
        try:
            pose, at = self._frames.lookup(name, stamp)
            if unusable_poses(pose[None]).any():
                raise RefusedError("bad transform", f"{name!r}: {pose.tolist()}")
            return pose, at
        except Exception as error:
            self.errors[frame] = self._guard.refusal("look-up of frames", error, name)
        return None

    def reach(self, frames: Slots, all_stamps: Slots) -> Mask:
        """Return which states (n,) can be placed: those up to the newest stamp with a transform."""
        ok: Mask = frames == 0
        for frame in np.unique(frames[~ok]).tolist():
            rows = np.flatnonzero(frames == frame)
            stamps_here = all_stamps[rows]
            stamps = np.unique(stamps_here[stamps_here > 0])
            newest = self._newest(frame, stamps)
            ok[rows] = (stamps_here > 0) & (stamps_here <= newest)
            if (stamps_here == 0).any() and self.get(frame, 0) is not None:
                ok[rows[stamps_here == 0]] = True
        return ok

    def _newest(self, frame: int, stamps: Slots) -> int:
        """Return the newest of rising stamps with a transform of a frame, -1 for none."""
        late, at, leap = len(stamps), len(stamps) - 1, 1
        while at >= 0 and self.get(frame, int(stamps[at])) is None:
            if self.errors[frame].reason != EXTRAPOLATION:
                return -1
            late = at
            leap = 1 if len(stamps) <= FEW_STAMPS else 2 * leap
            at = max(at - leap, 0) if at > 0 else -1
        if at < 0:
            return -1
        between = stamps[at + 1 : late].tolist()
        at += bisect_left(between, True, key=lambda stamp: self.get(frame, stamp) is None)
        return int(stamps[at])

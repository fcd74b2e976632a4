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

"""Clouds in a scene, beside the distance of each of their points from the other objects."""

from __future__ import annotations

import gc
import sys

import numpy as np
import pytest
from cloud_oracle import SOLIDS, placed
from convex_bodies import CORNER_SIGNS
from hypothesis import given
from hypothesis import strategies as st
from sweep_motions import TWISTING, motion_of_boxes, places_at

import obb_collision as oc
from obb_collision.typing import Floats

SPAN = 2.0
RADIUS = 0.03
SHAPES = {name: solid.shape for name, solid in SOLIDS.items()}


def made_points(seed: int, count: int = 800) -> Floats:
    """Return points on the walls of a room and in it."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-SPAN, SPAN, (count, 3))
    walls = np.arange(0, count, 2)
    points[walls, rng.integers(0, 3, len(walls))] = -SPAN / 2
    return points


def made_poses(seed: int, count: int) -> Floats:
    """Return poses (n, 7) in the room."""
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.hstack([rng.uniform(-SPAN, SPAN, (count, 3)), quaternions])


def room(
    level: str, seed: int, radius: float = RADIUS
) -> tuple[oc.Scene, dict[str, Floats], Floats]:
    """Return a scene of a cloud and shapes, their poses, and the points in the world."""
    scene, points, pose = oc.Scene(accuracy=level), made_points(seed), made_poses(seed + 1, 1)[0]
    scene.add("cloud", oc.shapes.Cloud(points, radius), pose)
    names = [f"{kind}/{n}" for n in range(4) for kind in SHAPES]
    poses = dict(zip(names, made_poses(seed, len(names)), strict=True))
    for name, where in poses.items():
        scene.add(name, SHAPES[name.split("/")[0]], where)
    scene.check_only([("cloud", "*")])
    return scene, poses, placed(points, pose)


def other(pair: tuple[str, str]) -> str:
    """Return the object that is not the cloud."""
    first, second = pair
    return second if first == "cloud" else first


#: Bodies of a scene of a family, points made for each, and points anywhere; what are compared.
BODIES, NEAR, ANYWHERE, NEAREST = 24, 6, 60, 6
#: By how much, metres, the depth of a point near the axis of a cylinder may be too large.
ROUND_DEPTH = 1e-4
#: From where a point of a solid sees all of its surface.
MIDDLES = {"mesh": (0.1, 0.08, 0.06), "iron": (0.1, 0.1, 0.15)}


def gaps_of(family: str, rng: np.random.Generator) -> Floats:
    """Return how far balls (n,) are to be from a surface."""
    signs = rng.choice([-1.0, 0.0, 1.0], NEAR)
    if family in ("touching", "far"):
        return np.asarray(signs * 10.0 ** rng.uniform(-16.0, -9.0, NEAR))
    if family == "grazing":
        return np.asarray(signs * 10.0 ** rng.uniform(-9.0, -2.0, NEAR))
    return np.asarray(rng.uniform(-0.3, 0.0 if family == "inside" else 0.2, NEAR))


def points_at(kind: str, level: str, gaps: Floats, rng: np.random.Generator) -> Floats:
    """Return points (n, 3) in the frame of a solid at distances (n,), or as deep as they can be."""
    ways = rng.normal(size=(len(gaps), 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    low, high = np.zeros(len(gaps)), np.full(len(gaps), 4.0)
    start = np.array(MIDDLES.get(kind, (0.0, 0.0, 0.0)))
    for _ in range(60):
        middle = 0.5 * (low + high)
        near = SOLIDS[kind].distances[level](start + middle[:, None] * ways) <= gaps
        low, high = np.where(near, middle, low), np.where(near, high, middle)
    return np.asarray(start + low[:, None] * ways)


def family_scene(
    family: str, level: str, rng: np.random.Generator
) -> tuple[oc.Scene, dict[str, Floats], Floats, Floats, float]:
    """Return a scene, the poses of its bodies, points and pose of its cloud, and the radius."""
    seed, scene = int(rng.integers(1 << 30)), oc.Scene(accuracy=level)
    radius = float(rng.choice([0.0, RADIUS]))
    poses, pose = made_poses(seed, BODIES), made_poses(seed + 1, 1)[0]
    if family == "far":
        origin = rng.choice([-1.0, 1.0], 3) * 10.0 ** rng.uniform(3.0, 6.0)
        poses[:, :3] += origin
        pose[:3] = pose[:3] + origin if rng.random() < 0.5 else 0.0
    named: dict[str, Floats] = {}
    parts = [placed(rng.uniform(-SPAN, SPAN, (ANYWHERE, 3)), poses[0])]
    for kind, where in zip(4 * list(SHAPES), poses, strict=True):
        named[f"{kind}/{len(named)}"] = where
        gaps = gaps_of(family, rng) + radius
        parts.append(placed(points_at(kind, level, gaps, rng), where))
    points = placed(np.concatenate(parts), pose, inverse=True)
    scene.add("cloud", oc.shapes.Cloud(points, radius), pose)
    for name, where in named.items():
        scene.add(name, SHAPES[name.split("/")[0]], where)
    scene.check_only([("cloud", "*")])
    return scene, named, points, pose, radius


def truth_of(kind: str, level: str, pose: Floats, points: Floats) -> float:
    """Return the distance of the nearest of points in the world, given in extended precision."""
    distance = SOLIDS[kind].distances[level]
    local = placed(points, pose.astype(np.longdouble), inverse=True)
    nearest = np.argsort(distance(local.astype(np.float64)))[:NEAREST]
    return float(distance(local[nearest]).min())


@pytest.mark.parametrize("level", ["obb", "hull", "mesh"])
@pytest.mark.parametrize("family", ["near", "inside", "touching", "grazing", "far"])
def test_verdicts_and_clearances_are_those_of_the_nearest_ball(
    family: str, level: str, pairs: int
) -> None:
    rng, reach, wrong, collided = np.random.default_rng(7), 0.15, [], 0
    scenes = max(1, pairs // (5 * BODIES))
    for _ in range(scenes):
        scene, poses, points, pose, radius = family_scene(family, level, rng)
        scene.set_effect("clearance", "on", max_distance=reach)
        report = scene.check()
        colliding, table = {other(pair) for pair in report.names()}, report.clearances
        rows = [other((scene.names[i], scene.names[j])) for i, j in table.pairs]
        found = dict(zip(rows, table.distances.tolist(), strict=True))
        there = placed(points.astype(np.longdouble), pose.astype(np.longdouble))
        collided += len(colliding)
        for name, where in poses.items():
            kind = name.split("/")[0]
            gap = truth_of(kind, level, where, there) - radius
            size = 1.0 + SPAN + float(np.abs([where[:3], pose[:3]]).sum() + np.abs(points).max())
            if gap > 1e-12 * size if name in colliding else gap <= 0.0:
                wrong.append((name, "collides" if name in colliding else "is apart", gap))
            if gap > reach or (gap > reach - 1e-9 * size and name not in found):
                continue
            clearance = found[name]
            least = gap - (ROUND_DEPTH if gap < 0.0 and kind == "cylinder" else 1e-9 * size)
            if gap < 0.0 and not SOLIDS[kind].convex:
                # a push out of what is not convex may be longer: of a ball, out of an inner corner
                least = -np.inf if radius else least + gap
            most = gap + (1e-9 if level == "mesh" and gap < 0.0 else 1e-14) * size
            if not least <= clearance <= most:
                wrong.append((name, clearance, gap))
    assert wrong == []
    assert 2 * scenes < collided <= BODIES * scenes


def test_closest_points_are_as_far_apart_as_the_clearance_along_its_normal() -> None:
    for level in ("obb", "hull", "mesh"):
        scene, _, _ = room(level, 2)
        scene.set_effect("clearance", "on", max_distance=0.15)
        table = scene.check().clearances
        free = table.distances > 0.0
        ways = table.positions_b[free] - table.positions_a[free]
        assert np.linalg.norm(ways, axis=1) == pytest.approx(table.distances[free], abs=1e-9)
        along = np.einsum("ij,ij->i", ways, table.normals[free])
        assert along == pytest.approx(table.distances[free], abs=1e-9)


@pytest.mark.parametrize("level", ["obb", "hull", "mesh"])
def test_contacts_are_the_deepest_balls(level: str) -> None:
    scene, poses, points = room(level, 4)
    report = scene.check()
    contacts = report.contacts
    assert (report.separations <= 0.0).all()
    np.testing.assert_array_equal(contacts.depths, -report.separations)
    for row, pair in enumerate(report.names()):
        name, count = other(pair), contacts.counts[row]
        kind = name.split("/")[0]
        solid = SOLIDS[kind].distances["hull" if level == "obb" else level]
        gaps = np.sort(solid(placed(points, poses[name], inverse=True))) - RADIUS
        assert count == min(4, int((gaps < 0.0).sum())) or (level == "obb" and kind != "box")
        assert np.isnan(contacts.positions[row, count:]).all()
        places = contacts.positions[row, :count]
        near = np.linalg.norm(points[None] - places[:, None], axis=2).min(axis=1)
        assert (near < RADIUS + contacts.position_depths[row, :count]).all()
        if kind == "box" or (level != "obb" and kind in ("sphere", "capsule")):
            depths = contacts.position_depths[row, :count]
            np.testing.assert_allclose(depths, -gaps[:count], atol=1e-9)


@pytest.mark.parametrize("margin", [0.0, 0.05])
@pytest.mark.parametrize("level", ["obb", "hull", "mesh"])
def test_the_points_in_each_object_are_counted_for_each_cloud(level: str, margin: float) -> None:
    scene, poses, points = room(level, 5)
    scene.check_only([])
    far, pose = made_points(9, 5000).astype(np.float32), made_poses(3, 1)[0]
    scene.add("other", oc.shapes.Cloud(far), pose, padding=0.02)
    watched = made_points(2, 5000)
    watched[::7] = np.nan
    scene.watched = {"lidar": watched}
    scene.set_effect("points", margin=margin)
    inside = scene.check().points_inside
    assert inside.clouds is not None
    assert inside.positions is not None
    assert inside.ignored == len(watched[::7])
    clouds = {
        -1: (watched, margin),
        scene.index("cloud"): (points, margin + RADIUS),
        scene.index("other"): (placed(far.astype(float), pose), margin + 0.02),
    }
    assert inside.clouds.tolist() == [cloud for cloud in clouds for _ in poses]
    assert inside.indices.tolist() == 3 * [scene.index(name) for name in poses]
    for row, (cloud, index) in enumerate(zip(inside.clouds, inside.indices, strict=True)):
        (places, reach), name = clouds[cloud], scene.name(index)
        box = scene.boxes[index]
        solid = SOLIDS[name.split("/")[0]]
        gaps = solid.distances[level](placed(places, poses[name], inverse=True))
        held = np.flatnonzero(gaps <= reach)
        assert inside.counts[row] == len(held)
        assert inside.first[row] == (held[0] if len(held) else -1)
        if len(held):
            off = np.linalg.norm(places[held] - box.center, axis=1)
            assert inside.nearest[row] == held[off.argmin()]
            assert inside.distances[row] == pytest.approx(off.min())
            assert inside.positions[row] == pytest.approx(places[inside.nearest[row]])
        else:
            assert np.isnan(inside.positions[row]).all()
    assert all(np.count_nonzero(inside.counts[inside.clouds == cloud]) > 1 for cloud in clouds)


def test_rows_of_points_are_of_pairs_that_count_as_they_were_at_the_check() -> None:
    scene = oc.Scene()
    for name in ("front", "rear", "off"):
        scene.add(name, oc.shapes.Cloud([[0, 0, 0]]))
    for name in ("zone/1", "zone/2", "gone"):
        scene.add(name, oc.shapes.Box([1, 1, 1]))
    scene.set_enabled("off", False)
    scene.set_enabled("gone", False)
    scene.allow("zone/1", "front")
    scene.watched = {"lidar": [[0, 0, 0]]}

    def rows(report: oc.Report) -> list[tuple[str, str, int]]:
        inside = report.points_inside
        assert inside.clouds is not None
        names = ["lidar" if cloud < 0 else scene.name(cloud) for cloud in inside.clouds]
        objects = [scene.name(index) for index in inside.indices]
        return [*zip(names, objects, inside.counts.tolist(), strict=True)]

    of_lidar = [("lidar", "zone/1", 1), ("lidar", "zone/2", 1)]
    seen = [*of_lidar, ("front", "zone/2", 1), ("rear", "zone/1", 1), ("rear", "zone/2", 1)]
    report = scene.check()
    scene.set_shape("front", oc.shapes.Cloud([[9, 9, 9]]))
    scene.move("rear", [5, 0, 0, 0, 0, 0, 1])
    scene.watched = {}
    assert rows(report) == seen
    after = [("front", "zone/2", 0), ("rear", "zone/1", 0), ("rear", "zone/2", 0)]
    assert rows(scene.check()) == after
    scene.set_effect("points", objects="zone/1")
    assert rows(scene.check()) == after[1:2]
    scene.set_effect("points", objects="front")
    assert rows(scene.check()) == after[:1]
    scene.set_effect("points", "off")
    assert scene.check().costs == {}


@pytest.mark.parametrize("moves", ["object", "cloud", "both"])
@pytest.mark.parametrize("level", ["obb", "hull", "mesh"])
def test_a_sweep_is_never_late(level: str, moves: str) -> None:
    scene, poses, _ = room(level, 7)
    rng, twists = np.random.default_rng(3), {}
    for name in ["cloud", *poses]:
        if moves == "both" or (moves == "cloud") == (name == "cloud"):
            twists[name] = rng.uniform(-1.0, 1.0, 6)
            scene.set_twist(name, twists[name])
    before = {other(pair) for pair in scene.check().names()}
    table = scene.check("sweep").swept.predicted
    times = dict.fromkeys(poses, np.inf)
    for (i, j), time in zip(table.pairs.tolist(), table.times.tolist(), strict=True):
        times[other((scene.names[i], scene.names[j]))] = time
    assert 2 < sum(time < 1.0 for time in times.values()) < 20
    seen = dict.fromkeys(poses, np.inf)
    start = {name: scene.pose(name) for name in ["cloud", *poses]}
    for time in np.linspace(0.0, 1.0, 41):
        for name, twist in twists.items():
            scene.move(name, advanced(start[name], twist, time))
        for pair in scene.check().names():
            seen[other(pair)] = min(seen[other(pair)], time)
    scene.set_effect("clearance", "on", max_distance=SPAN)
    for name in poses.keys() - before:
        assert times[name] <= seen[name] + 1e-9
        if times[name] < np.inf:  # it is not early: they are as near as the tolerance then
            for body, twist in twists.items():
                scene.move(body, advanced(start[body], twist, times[name]))
            near = scene.check().clearances
            row = [{"cloud", name} == {scene.names[i], scene.names[j]} for i, j in near.pairs]
            assert near.distances[row] < 2e-3


@pytest.mark.parametrize("name", TWISTING)
def test_no_sweep_is_late_in_the_families_of_boxes(name: str, pairs: int) -> None:
    """The smaller box of each pair as the points of its corners and some in it."""
    rng, samples = np.random.default_rng(5), 800
    given = TWISTING[name](rng, max(20, pairs // 100))
    motion, halves = motion_of_boxes(given), given.boxes.half_extents
    scenes = {level: oc.Scene(accuracy=level) for level in ("obb", "hull", "mesh")}
    points = [np.vstack([CORNER_SIGNS, rng.uniform(-1, 1, (40, 3))]) * half for half in halves]
    times, truth = np.linspace(0.0, 1.0, samples), {}
    for k in range(0, len(points), 2):
        seen, solid = (k, k + 1) if halves[k].sum() < halves[k + 1].sum() else (k + 1, k)
        for row in (k, k + 1):
            own = points[row] @ motion.rotations[row].T + motion.arms[row]
            shape = oc.shapes.Cloud(own) if row == seen else oc.shapes.Hull(own)
            for scene in scenes.values():
                scene.add(f"{row}", shape, [*given.origins[row], 0, 0, 0, 1])
                scene.set_twist(f"{row}", given.twists[row])
        (at, turn), (there, solid_turn) = (
            places_at(motion, np.full(samples, row), times) for row in (seen, solid)
        )
        offsets = np.einsum("nij,pj->npi", turn, points[seen]) + (at - there)[:, None]
        local = np.abs(np.einsum("nji,npj->npi", solid_turn, offsets))
        slack = 1e-12 * (np.abs(motion.arms[k : k + 2]).sum() + halves[k : k + 2].sum())
        met = (local <= halves[solid] - slack).all(axis=2).any(axis=1)
        if met.any():
            truth[k, k + 1] = given.horizon * times[met.argmax()]
    assert truth
    for scene in scenes.values():
        scene.check_only([(f"{k}", f"{k + 1}") for k in range(0, len(points), 2)])
        scene.set_effect("sweep", "on", horizon=given.horizon)
        report = scene.check()
        table = report.swept.predicted
        found = dict(zip(map(tuple, table.pairs.tolist()), table.free_until, strict=True))
        found |= dict.fromkeys(map(tuple, report.pairs.tolist()), 0.0)
        assert [pair for pair, time in truth.items() if not found.get(pair, np.inf) <= time] == []


def advanced(pose: Floats, twist: Floats, time: float) -> Floats:
    """Return a pose after a time with a twist of its origin."""
    angle = np.linalg.norm(twist[3:]) * time
    axis = twist[3:] / np.linalg.norm(twist[3:])
    turned = [*np.sin(angle / 2) * axis, np.cos(angle / 2)]
    turn = oc.OBB.from_quaternion(np.zeros(3), turned, [1] * 3)
    here = oc.OBB.from_quaternion(pose[:3], pose[3:], [1] * 3)
    rotated = oc.OBB(pose[:3] + time * twist[:3], turn.rotation @ here.rotation, [1] * 3)
    return np.array([*rotated.center, *rotated.quaternion])


def test_what_passes_a_cloud_between_two_checks_is_found() -> None:
    scene = oc.Scene(accuracy="hull")
    wall = np.stack(np.meshgrid([0.0], np.linspace(-1, 1, 21), np.linspace(-1, 1, 21)), -1)
    scene.add("wall", oc.shapes.Cloud(wall.reshape(-1, 3)))
    scene.add("ball", oc.shapes.Sphere(0.2), [-3.0, 0.01, 0.02, 0, 0, 0, 1])
    scene.check("sweep")
    scene.move("ball", [3.0, 0.01, 0.02, 0, 0, 0, 1])
    passed = scene.check("sweep").swept.passed
    assert len(passed.pairs) == 1
    first = np.sqrt(0.2**2 - np.min(np.sum((wall.reshape(-1, 3)[:, 1:] - [0.01, 0.02]) ** 2, 1)))
    assert passed.times[0] == pytest.approx((3.0 - first) / 6.0, abs=1e-6)


@given(st.data())
def test_a_point_that_touches_collides(data: st.DataObject) -> None:
    place = data.draw(st.tuples(*[st.integers(-4, 4)] * 3))
    level, where = (
        data.draw(st.sampled_from(["obb", "hull", "mesh"])),
        np.array([*place, 0, 0, 0, 1.0]),
    )
    scene = oc.Scene(accuracy=level)
    scene.add("cloud", oc.shapes.Cloud([[1.0, 0.25, -0.5], [90.0, 0, 0]]), where)
    scene.add("box", oc.shapes.Box([2.0, 1.0, 4.0]), where)
    assert scene.check().names() == [("cloud", "box")]
    where[0] -= 1e-9
    scene.move("box", where)
    assert scene.check().names() == []


def test_a_cloud_without_points_collides_with_nothing() -> None:
    for level in oc.Accuracy:
        scene = oc.Scene(accuracy=level)
        scene.add("cloud", oc.shapes.Cloud(np.full((3, 3), np.nan), radius=1.0))
        scene.add("box", oc.shapes.Box([1, 1, 1]))
        scene.set_effect("clearance", "on", max_distance=10.0)
        report = scene.check("sweep")
        assert report.names() == []
        assert len(report.clearances.pairs) == 0


@pytest.mark.parametrize("level", list(oc.Accuracy))
def test_two_clouds_never_collide(level: oc.Accuracy) -> None:
    scene = oc.Scene(accuracy=level)
    for name in "ab":
        scene.add(name, oc.shapes.Cloud(made_points(1), 0.5))
        scene.set_twist(name, [1, 0, 0, 0, 0, 0])
    scene.set_effect("clearance", "on", max_distance=1.0)
    report = scene.check("sweep")
    assert report.names() == []
    assert len(report.clearances.pairs) == len(report.swept.predicted.pairs) == 0


def test_below_obb_the_bounds_stand_for_a_cloud() -> None:
    scene = oc.Scene(accuracy="aabb")
    scene.add("cloud", oc.shapes.Cloud([[-1, -1, -1], [1, 1, 1]]))
    scene.add("box", oc.shapes.Box([0.1, 0.1, 0.1]))
    assert scene.check().names() == [("cloud", "box")]
    scene.set_accuracy("box", "obb")
    assert scene.check().names() == [("cloud", "box")]
    scene.set_accuracy("cloud", "obb")
    assert scene.check().names() == []


def test_padding_grows_the_balls() -> None:
    scene = oc.Scene(accuracy="hull")
    scene.add("cloud", oc.shapes.Cloud([[0, 0, 1.0]]), padding=0.25)
    scene.add("ball", oc.shapes.Sphere(0.5), padding=0.2)
    scene.set_effect("clearance", "on", max_distance=0.3)
    assert scene.check().clearances.distances == pytest.approx([0.05])
    scene.set_padding("cloud", 0.31)
    assert scene.check().names() == [("cloud", "ball")]


def test_a_new_shape_keeps_pose_padding_level_rules_and_index() -> None:
    scene = oc.Scene()
    index = scene.add("cloud", oc.shapes.Cloud([[0, 0, 0]]), [1, 0, 0, 0, 0, 0, 1], padding=0.1)
    scene.add("box", oc.shapes.Box([1, 1, 1]), [2, 0, 0, 0, 0, 0, 1])
    scene.add("floor", oc.shapes.Box([9, 9, 1]))
    scene.allow("cloud", "floor")
    scene.set_accuracy("cloud", "hull")
    assert scene.check().names() == [("box", "floor")]
    scene.set_shape("cloud", oc.shapes.Cloud([[0.45, 0, 0]]))
    assert scene.check().names() == [("cloud", "box"), ("box", "floor")]
    assert scene.index("cloud") == index
    assert scene.pose("cloud")[0] == 1.0
    with pytest.raises(KeyError, match="none"):
        scene.set_shape("none", oc.shapes.Sphere(1))
    with pytest.raises(TypeError, match="shape"):
        scene.set_shape("cloud", "sphere")  # type: ignore[arg-type]


def test_replacing_a_cloud_again_and_again_leaks_nothing() -> None:
    scene = oc.Scene(accuracy="hull")
    scene.add("cloud", oc.shapes.Cloud(made_points(0, 10)))
    scene.add("ball", oc.shapes.Sphere(0.5))
    for n in range(300):
        if n == 100:
            gc.collect()
            blocks = sys.getallocatedblocks()
        scene.set_shape("cloud", oc.shapes.Cloud(made_points(n % 3, 10)))
        scene.check()
    gc.collect()
    assert sys.getallocatedblocks() < blocks + 500


def test_a_body_in_question_meets_clouds_and_may_be_one() -> None:
    scene = oc.Scene(accuracy="hull")
    scene.add("cloud", oc.shapes.Cloud([[0, 0, 0], [5, 5, 5]]))
    scene.add("box", oc.shapes.Box([1, 1, 1]), [3, 0, 0, 0, 0, 0, 1])
    assert scene.query(oc.shapes.Sphere(0.1)) == ["cloud"]
    assert scene.query(oc.shapes.Sphere(0.1), [1, 1, 1, 0, 0, 0, 1]) == []
    assert scene.query(oc.shapes.Cloud([[3, 0, 0], [0, 0, 0]])) == ["box"]


def test_points_that_are_not_finite_are_counted() -> None:
    points = np.array([[0, 0, 0], [np.nan, 0, 0], [1, 2, np.inf], [1, 1, 1]], np.float32)
    cloud = oc.shapes.Cloud(points[:, ::1], 0.25)
    assert (len(cloud.points), cloud.ignored) == (2, 2)
    center, _, half = cloud.local_box
    np.testing.assert_array_equal(center, 0.5)
    np.testing.assert_allclose(half, 0.75)
    with pytest.raises(ValueError, match="radius"):
        oc.shapes.Cloud(points, -1)
    with pytest.raises(ValueError, match="points"):
        oc.shapes.Cloud([[1, 2]])
    with pytest.raises(ValueError, match="read-only"):
        cloud.points[0] = 1


@pytest.mark.parametrize("level", ["obb", "hull", "mesh"])
def test_rays_hit_the_first_ball(level: str) -> None:
    scene, points = oc.Scene(accuracy=level), made_points(3, 200)
    pose = made_poses(5, 1)[0]
    scene.add("cloud", oc.shapes.Cloud(points, 0.1), pose, padding=0.05)
    scene.add("box", oc.shapes.Box([0.3, 0.3, 0.3]), [0.5, 0, 0, 0, 0, 0, 1])
    rng, centers = np.random.default_rng(1), placed(points, pose)
    origins, ways = rng.uniform(-3, 3, (50, 3)), rng.normal(size=(50, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    hits = scene.cast_rays(origins, ways)
    arms = centers[None] - origins[:, None]
    along = np.einsum("rpi,ri->rp", arms, ways)
    square = 0.15**2 - (np.einsum("rpi,rpi->rp", arms, arms) - along**2)
    first = np.where(square >= 0.0, along - np.sqrt(np.maximum(square, 0.0)), np.inf)
    first = np.where((first < 0.0) & (np.linalg.norm(arms, axis=2) < 0.15), 0.0, first)
    first = np.where(first < 0.0, np.inf, first).min(axis=1)
    only = hits.boxes == scene.index("cloud")
    assert 5 < only.sum() < 50
    np.testing.assert_allclose(hits.distances[only], first[only], atol=1e-6)
    assert (hits.distances <= first + 1e-9).all()


def test_shapes_are_prepared_beside_clouds() -> None:
    scene, _, _ = room("mesh", 2)
    scene.objects.prepare()
    assert scene.check().names() == room("mesh", 2)[0].check().names()

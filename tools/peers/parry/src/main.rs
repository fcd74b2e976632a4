//! Times parry3d at the frames of a scene: new poses in, colliding pairs out.
//!
//! `parry_pairs FILE`: the file has three u64, the counts of boxes, frames and rounds, then, as f64,
//! half extents (boxes, 3) and poses (frames, boxes, 7), x y z qx qy qz qw. Prints a line of JSON
//! for each way to keep the tree up to date: seconds of each step and pairs of the last one.

use std::time::Instant;
use std::{env, fs};

use parry3d::bounding_volume::Aabb;
use parry3d::glamx::{Pose3, Quat, Vec3};
use parry3d::partitioning::{Bvh, BvhBuildStrategy, BvhWorkspace};
use parry3d::query::details::intersection_test_cuboid_cuboid;
use parry3d::shape::Cuboid;

type Step<'a> = dyn FnMut(&[f64]) -> usize + 'a;

fn pose(row: &[f64]) -> Pose3 {
    let r: Vec<f32> = row.iter().map(|v| *v as f32).collect();
    Pose3::from_parts(
        Vec3::new(r[0], r[1], r[2]),
        Quat::from_xyzw(r[3], r[4], r[5], r[6]).normalize(),
    )
}

fn count_pairs(tree: &Bvh, room: &mut BvhWorkspace, boxes: &[Cuboid], poses: &[Pose3]) -> usize {
    let mut pairs = Vec::new();
    tree.traverse_bvtt_single_tree::<false>(room, &mut |a, b| {
        let (i, j) = (a as usize, b as usize);
        if intersection_test_cuboid_cuboid(&poses[i].inv_mul(&poses[j]), &boxes[i], &boxes[j]) {
            pairs.push((a, b));
        }
    });
    pairs.len()
}

fn time(name: &str, frames: &[f64], size: usize, rounds: usize, step: &mut Step) {
    let mut seconds = Vec::new();
    let mut pairs = 0;
    for _ in 0..rounds {
        for frame in frames.chunks(size) {
            let start = Instant::now();
            pairs = step(frame);
            seconds.push(start.elapsed().as_secs_f64());
        }
    }
    println!("{{\"name\": \"{name}\", \"pairs\": {pairs}, \"seconds\": {seconds:?}}}");
}

fn main() {
    let bytes = fs::read(env::args().nth(1).expect("a file of frames")).expect("it can be read");
    let words: Vec<[u8; 8]> = bytes.chunks(8).map(|w| w.try_into().unwrap()).collect();
    let head: Vec<usize> = words[..3].iter().map(|w| u64::from_le_bytes(*w) as usize).collect();
    let numbers: Vec<f64> = words[3..].iter().map(|w| f64::from_le_bytes(*w)).collect();
    let (count, rounds) = (head[0], head[2]);
    let (halves, frames) = numbers.split_at(3 * count);
    let half = |h: &[f64]| Cuboid::new(Vec3::new(h[0] as f32, h[1] as f32, h[2] as f32));
    let boxes: Vec<Cuboid> = halves.chunks(3).map(half).collect();
    let mut poses: Vec<Pose3> = frames[..7 * count].chunks(7).map(pose).collect();
    let bounds = |poses: &[Pose3]| -> Vec<Aabb> {
        boxes.iter().zip(poses).map(|(shape, pose)| shape.aabb(pose)).collect()
    };
    let mut room = BvhWorkspace::default();
    let mut kept = Bvh::from_leaves(BvhBuildStrategy::Binned, &bounds(&poses));

    time("rebuild", frames, 7 * count, rounds, &mut |frame| {
        let placed: Vec<Pose3> = frame.chunks(7).map(pose).collect();
        let tree = Bvh::from_leaves(BvhBuildStrategy::Binned, &bounds(&placed));
        count_pairs(&tree, &mut room, &boxes, &placed)
    });
    time("refit", frames, 7 * count, rounds, &mut |frame| {
        for (index, row) in frame.chunks(7).enumerate() {
            poses[index] = pose(row);
            kept.insert_or_update_partially(boxes[index].aabb(&poses[index]), index as u32, 0.0);
        }
        kept.refit(&mut room);
        kept.optimize_incremental(&mut room);
        count_pairs(&kept, &mut room, &boxes, &poses)
    });
}

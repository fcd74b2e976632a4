//! Times capt: a tree over the points of a cloud, and whether the spheres of states meet a point.
//!
//! `capt_spheres FILE`: the file has four u64, the counts of points, states and spheres of a state, and
//! that with some repeated to fill groups of eight, then, as f32, points (points, 3) and spheres
//! (states, filled, 4), x y z radius. Prints a line of JSON: the seconds of building, the least of
//! all states with one sphere at once and with eight, and how many states collide by each.

#![feature(portable_simd)]
use std::simd::Simd;
use std::time::Instant;
use std::{env, fs};

const LANES: usize = 8;
const ROUNDS: usize = 5;
type Tree = capt::Capt<3, f32, u32>;

fn alone(tree: &Tree, spheres: &[f32]) -> bool {
    spheres.chunks_exact(4).any(|s| tree.collides(&[s[0], s[1], s[2]], s[3]))
}

fn together(tree: &Tree, spheres: &[f32]) -> bool {
    spheres.chunks_exact(4 * LANES).any(|group| {
        let column = |k: usize| Simd::<f32, LANES>::from_array(std::array::from_fn(|j| group[4 * j + k]));
        tree.collides_simd(&[column(0), column(1), column(2)], column(3))
    })
}

fn least(run: &mut dyn FnMut() -> usize) -> (f64, usize) {
    let mut best = (f64::INFINITY, 0);
    for _ in 0..ROUNDS {
        let start = Instant::now();
        let count = run();
        best = (best.0.min(start.elapsed().as_secs_f64()), count);
    }
    best
}

fn main() {
    let bytes = fs::read(env::args().nth(1).expect("a file")).expect("it can be read");
    let (head, rest) = bytes.split_at(32);
    let counts: Vec<usize> =
        head.chunks_exact(8).map(|w| u64::from_le_bytes(w.try_into().unwrap()) as usize).collect();
    let numbers: Vec<f32> =
        rest.chunks_exact(4).map(|w| f32::from_le_bytes(w.try_into().unwrap())).collect();
    let (flat, spheres) = numbers.split_at(3 * counts[0]);
    let points: Vec<[f32; 3]> = flat.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
    let radii = spheres.chunks_exact(4).map(|s| s[3]);
    let range = (radii.clone().fold(f32::INFINITY, f32::min), radii.fold(0.0, f32::max));
    let start = Instant::now();
    let tree = Tree::new(&points, range, LANES);
    let build = start.elapsed().as_secs_f64();
    let states = spheres.chunks_exact(4 * counts[3]);
    let real = 4 * counts[2];
    let (one, first) = least(&mut || states.clone().filter(|s| alone(&tree, &s[..real])).count());
    let (eight, second) = least(&mut || states.clone().filter(|s| together(&tree, s)).count());
    println!("{{\"build\": {build}, \"one\": {one}, \"eight\": {eight}, \"colliding\": [{first}, {second}]}}");
}

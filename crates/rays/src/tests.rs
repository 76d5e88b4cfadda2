//! Hits against those of all triangles, hard inputs, and rays that must not escape.

use super::ray::{Hit, Ray, Way};
use super::{Boxes, LEAF, NONE, Rays, Side};
use glam::{DMat3, DVec3, EulerRot};
use std::collections::HashMap;
use std::time::{Duration, Instant};

type Triangle = [DVec3; 3];

/// Numbers from 0 to 1 (SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
    /// From -1 to 1 along each axis.
    fn point(&mut self) -> DVec3 {
        2.0 * DVec3::new(self.next(), self.next(), self.next()) - 1.0
    }
    fn on(&mut self, [a, b, c]: Triangle) -> DVec3 {
        let (s, t) = (self.next().sqrt(), self.next());
        a + s * (b - a) + s * t * (c - b)
    }
    fn below(&mut self, count: usize) -> usize {
        (self.next() * count as f64) as usize
    }
}

/// With the instructions that were found, and with those that all processors have.
fn both(corners: &[Triangle]) -> [Rays; 2] {
    let rays = || Rays::among(corners.to_vec(), |_| true);
    [rays(), rays().portable()]
}

/// A turned box of `cells` a side with vertices that are moved at random, fronts outside.
fn uneven_box(cells: i32) -> Vec<Triangle> {
    let turn = DMat3::from_euler(EulerRot::XYZ, 0.3, 0.7, 1.1);
    let mut random = Random(7);
    let mut places = HashMap::new();
    let mut place = |cell: [i32; 3]| {
        *places.entry(cell).or_insert_with(|| {
            let moved = DVec3::from(cell.map(f64::from)) + 0.15 * random.point();
            turn * (moved * 5.0 / f64::from(cells)) + DVec3::new(3.0, -2.0, 11.0)
        })
    };
    let mut corners = Vec::new();
    for axis in 0..3 {
        for side in [0, cells] {
            for (i, j) in (0..cells * cells).map(|k| (k / cells, k % cells)) {
                let mut at = |i: i32, j: i32| {
                    let mut cell = [side; 3];
                    (cell[(axis + 1) % 3], cell[(axis + 2) % 3]) = (i, j);
                    place(cell)
                };
                let [p, q, r, s] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                corners.extend(if side == 0 { [[p, r, q], [p, s, r]] } else { [[p, q, r], [p, r, s]] });
            }
        }
    }
    corners
}

/// Triangles of all sizes, some of them sheets with two sides and some needles.
fn rubble(count: usize) -> Vec<Triangle> {
    let mut random = Random(5);
    let mut corners = Vec::new();
    while corners.len() < count {
        let (at, size) = (random.point(), 0.5 * random.next().powi(4));
        let [a, b, c] = [(); 3].map(|()| at + size * random.point());
        match corners.len() % 4 {
            0 => corners.extend([[a, b, c], [a, c, b]]),
            1 => corners.push([a, b, a.lerp(b, 0.3) + 1e-7 * c]),
            _ => corners.push([a, b, c]),
        }
    }
    corners
}

/// The nearest back and front of all triangles.
fn nearest_of_all(rays: &Rays, corners: &[Triangle], way: Way, from: usize) -> [Option<(f64, usize)>; 2] {
    let epsilon = 1e-9 * 2.0 / rays.scale();
    let frame = super::frame::Frame { centre: rays.centre(), scale: rays.scale() };
    let ray = Ray::new(&frame, way).expect("a ray");
    let hits = corners.iter().enumerate().filter(|(t, _)| *t != from);
    let hits: Vec<(usize, Hit)> = hits
        .filter_map(|(t, corners)| Some((t, ray.hit(&corners.map(|c| c.to_array()), epsilon)?)))
        .collect();
    [false, true].map(|front| {
        let of_side = hits.iter().filter(|(_, hit)| hit.front == front);
        of_side.map(|(t, hit)| (hit.distance, *t)).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
    })
}

/// From faces, from within and from far away, wherever triangles are, by both sets of instructions: bit for bit.
#[test]
fn hits_are_those_of_all_triangles() {
    for (away, size) in [(0.0, 1.0), (0.0, 1e-9), (4.5e6, 1e3), (1e3, 1.0)] {
        let corners: Vec<Triangle> =
            rubble(300).into_iter().map(|t| t.map(|corner| size * corner + away)).collect();
        let mut random = Random(1);
        let both = both(&corners);
        for k in 0..4000 {
            let from = random.below(corners.len());
            let direction = random.point().normalize();
            let origin = random.on(corners[from]) - [0.0, 0.0, 1e3, 1e6][k % 4] * size * direction;
            let end = corners[random.below(corners.len())];
            let to = random.on(end);
            let [back, front] = nearest_of_all(&both[0], &corners, Way { origin, direction }, from);
            let epsilon = 1e-9 * 2.0 / both[0].scale();
            let distance = |side: Option<(f64, usize)>| side.map_or(f64::INFINITY, |side| side.0);
            let wanted = if distance(front) <= distance(back) + epsilon { front } else { back };
            let apart = (distance(front) - distance(back)).abs() > epsilon;
            let side = if distance(front) < distance(back) {
                front.map(|f| Side::Front(f.1))
            } else {
                Some(Side::Back)
            };
            let [one, other] = both.each_ref().map(|rays| {
                let found = rays.nearest(origin, direction, Some(from));
                assert_eq!(found.map(|(t, at)| (at, t)), wanted, "{away} {size} {k}");
                assert_eq!(rays.first_side(origin, direction, from), side.filter(|_| apart));
                let fronts = rays.fronts(origin, direction, from);
                assert_eq!(fronts.first().map(|(t, at)| (*at, *t)), front);
                (fronts, rays.blocked(origin, to, |t| t == from))
            });
            assert_eq!(one, other);
        }
    }
}

/// What lies between two points, against the distances of hits; exceptions do not count, nor do the ends.
#[test]
fn what_is_between_blocks() {
    let corners = rubble(200);
    let [rays, portable] = both(&corners);
    let mut random = Random(2);
    for _ in 0..4000 {
        let [a, b] = [(); 2].map(|()| random.below(corners.len()));
        let (from, to) = (random.on(corners[a]), random.on(corners[b]));
        let exception = |t: usize| t == a || t == b;
        let direction = (to - from) * (1.0 / (to - from).length());
        let end = from.distance(to) - 1e-9 * 2.0 / rays.scale();
        let between = (0..corners.len()).filter(|t| !exception(*t)).any(|t| {
            let way = Way { origin: from, direction };
            let sides = nearest_of_all(&rays, &corners[t..=t], way, usize::MAX);
            sides.into_iter().flatten().any(|(at, _)| at < end)
        });
        assert_eq!(rays.blocked(from, to, exception), between);
        assert_eq!(portable.blocked(from, to, exception), between);
    }
    assert!(!rays.blocked(DVec3::ZERO, DVec3::ZERO, |_| false));
}

/// Not even rays that aim exactly at edges and corners.
#[test]
fn no_ray_escapes_from_a_closed_box() {
    let corners = uneven_box(12);
    let middle = corners.iter().flatten().sum::<DVec3>() / (3.0 * corners.len() as f64);
    for rays in both(&corners) {
        let mut random = Random(3);
        for k in 0..1_000_000 {
            let from = middle + 1.5 * random.point();
            let triangle = corners[random.below(corners.len())];
            let to = match k % 3 {
                0 => random.on(triangle),
                1 => triangle[0].lerp(triangle[1], random.next()),
                _ => triangle[0],
            };
            let met = rays.nearest(from, (to - from).normalize(), None);
            assert!(met.is_some(), "{from} {to}");
        }
    }
}

/// In the planes of symmetry of a mesh rays run along edges.
#[test]
fn rays_along_axes_do_not_escape() {
    let at = |cell: [i32; 3]| DVec3::from(cell.map(f64::from)) / 8.0;
    let mut corners = Vec::new();
    for (axis, side, k) in
        (0..3).flat_map(|a| [0, 8].into_iter().flat_map(move |s| (0..64).map(move |k| (a, s, k))))
    {
        let place = |i: i32, j: i32| {
            let mut cell = [side; 3];
            (cell[(axis + 1) % 3], cell[(axis + 2) % 3]) = (i, j);
            at(cell)
        };
        let (i, j) = (k / 8, k % 8);
        let [p, q, r, s] = [place(i, j), place(i + 1, j), place(i + 1, j + 1), place(i, j + 1)];
        corners.extend([[p, q, r], [p, r, s]]);
    }
    for rays in both(&corners) {
        for (x, y, z) in (1..8).flat_map(|x| (1..8).flat_map(move |y| (1..8).map(move |z| (x, y, z)))) {
            for direction in
                (0..27).map(|k| DVec3::new((k % 3) as f64, (k / 3 % 3) as f64, (k / 9) as f64) - 1.0)
            {
                if direction != DVec3::ZERO {
                    assert!(rays.nearest(at([x, y, z]), direction.normalize(), None).is_some());
                }
            }
        }
    }
}

#[test]
fn hard_inputs_are_harmless() {
    let (o, x, y, z) = (DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z);
    // None, and one.
    let none = Rays::among(Vec::new(), |_| true);
    assert_eq!(none.nearest(o, x, None), None);
    assert!(!none.blocked(o, x, |_| false) && none.fronts(o, x, 0).is_empty());
    for rays in both(&[[o, x, y]]) {
        assert_eq!(rays.nearest(DVec3::new(0.2, 0.2, 1.0), -z, None), Some((0, 1.0)));
        assert_eq!(rays.nearest(DVec3::new(0.2, 0.2, 1.0), -z, Some(0)), None);
        assert_eq!(rays.nearest(DVec3::new(0.2, 0.2, 1.0), z, None), None);
        // No direction, none that is finite, along its plane.
        for direction in [o, DVec3::NAN, DVec3::INFINITY, x] {
            assert_eq!(rays.nearest(DVec3::new(0.2, 0.2, 0.0), direction, None), None);
        }
        assert_eq!(rays.nearest(DVec3::NAN, x, None), None);
    }
    // Without area, without numbers, a point, a line, all at one place; beside one that is there.
    let odd = [[o, o, o], [o, x, 2.0 * x], [o, x, x], [DVec3::NAN, x, y], [o, DVec3::INFINITY, y], [o, x, y]];
    for rays in both(&odd) {
        assert_eq!(rays.nearest(DVec3::new(0.2, 0.2, 1.0), -z, None), Some((5, 1.0)));
    }
    for corners in [vec![[o; 3]; 20], vec![[x; 3]; 20], vec![[1e-300 * x, o, o]; 20]] {
        assert_eq!(both(&corners).map(|rays| rays.nearest(-x, x, None)), [None; 2]);
    }
    // Those that are not solid.
    let rays = Rays::among(vec![[o, x, y], [o - z, x - z, y - z]], |i| *i == 1);
    assert_eq!(rays.nearest(DVec3::new(0.2, 0.2, 1.0), -z, None), Some((1, 2.0)));
}

/// Both sides of a sheet: that which faces the ray; and neither, where one is asked for.
#[test]
fn sheets_show_the_side_that_faces_a_ray() {
    let (o, x, y) = (DVec3::ZERO, DVec3::X, DVec3::Y);
    for rays in both(&[[o, x, y], [o, y, x]]) {
        for (height, seen) in [(1.0, 0), (-1.0, 1)] {
            let (origin, direction) = (DVec3::new(0.2, 0.2, height), DVec3::Z * -height);
            assert_eq!(rays.nearest(origin, direction, None), Some((seen, 1.0)));
            assert_eq!(rays.first_side(origin, direction, usize::MAX), None);
            assert_eq!(rays.first_side(origin, direction, 1 - seen), Some(Side::Front(seen)));
        }
    }
}

/// As many triangles as fit into one place: no stack overflows, and building takes no longer than of others.
#[test]
fn coincident_triangles_are_halved() {
    let start = Instant::now();
    let triangle = [DVec3::ZERO, DVec3::X, DVec3::Y];
    // Beside them one each as large and half as large as the one before, which the heuristic would split off one by one.
    let shrinking = (0..900).map(|k| triangle.map(|corner| corner * 0.5_f64.powi(k)));
    let corners: Vec<Triangle> = std::iter::repeat_n(triangle, 200_000).chain(shrinking).collect();
    for rays in both(&corners) {
        assert_eq!(rays.nearest(DVec3::new(0.3, 0.3, 2.0), -DVec3::Z, None), Some((0, 2.0)));
        assert_eq!(rays.nearest(DVec3::new(0.6, 0.6, 2.0), -DVec3::Z, None), None);
        assert_eq!(rays.fronts(DVec3::new(0.3, 0.3, 2.0), -DVec3::Z, 7).len(), 200_000);
    }
    assert!(start.elapsed() < Duration::from_secs(20));
}

/// Every triangle is in one leaf, and each branch is within the box that leads to it.
#[test]
fn the_description_is_whole() {
    let corners = rubble(3000);
    let rays = Rays::among(corners.clone(), |i| i % 7 != 0);
    let (mut seen, mut next) = (vec![0; corners.len()], vec![0]);
    while let Some(branch) = next.pop() {
        if branch & LEAF == 0 {
            let led = rays.nodes()[branch as usize].branches.into_iter().filter(|&to| to != NONE);
            next.extend(led.inspect(|&to| assert!(to & LEAF != 0 || to > branch)));
        } else {
            let held = rays.leaves()[(branch & !LEAF) as usize].triangles;
            held.into_iter().filter(|&t| t != NONE).for_each(|t| seen[t as usize] += 1);
        }
    }
    assert!(seen.iter().enumerate().all(|(t, &times)| times == usize::from(t % 7 != 0)));
    assert!(rays.bytes() > 3000 * 72);
}

/// After moves small and large, and where all triangles change places.
#[test]
fn refitted_hits_are_those_of_a_new_hierarchy() {
    let given = rubble(500);
    let mut random = Random(4);
    let apart: Vec<DVec3> = given.iter().map(|_| 3.0 * random.point()).collect();
    let turn = DMat3::from_euler(EulerRot::XYZ, 1.0, 0.5, 0.2);
    let moves: [&dyn Fn(usize, DVec3) -> DVec3; 4] =
        [&|_, p| p, &|_, p| turn * p + 4.0, &|t, p| p + 0.01 * apart[t], &|t, p| p + apart[t]];
    let mut rays = both(&given);
    for to in moves {
        let corners: Vec<Triangle> = given.iter().enumerate().map(|(t, c)| c.map(|p| to(t, p))).collect();
        rays.iter_mut().for_each(|rays| rays.refit(&corners));
        let new = Rays::among(corners.clone(), |_| true);
        for _ in 0..2000 {
            let from = random.below(corners.len());
            let (origin, direction) = (random.on(corners[from]), random.point().normalize());
            let wanted = new.nearest(origin, direction, Some(from));
            assert!(rays.iter().all(|rays| rays.nearest(origin, direction, Some(from)) == wanted));
        }
    }
}

/// Against all pairs.
#[test]
fn boxes_meet_those_around() {
    let given: Vec<Triangle> = rubble(400).into_iter().map(|t| t.map(|p| p + 100.0)).collect();
    let boxes = Boxes::around(&given);
    let bounds = |t: &Triangle| [t[0].min(t[1]).min(t[2]), t[0].max(t[1]).max(t[2])];
    for t in &given {
        let mut found = Vec::new();
        boxes.meet(t, |k| {
            found.push(k as usize);
            true
        });
        found.sort_unstable();
        let [low, high] = bounds(t);
        let meets = |other: &Triangle| {
            let [other_low, other_high] = bounds(other);
            low.cmple(other_high).all() && other_low.cmple(high).all()
        };
        let wanted: Vec<usize> = (0..given.len()).filter(|&k| meets(&given[k])).collect();
        assert!(wanted.iter().all(|k| found.binary_search(k).is_ok()));
        assert!(found.len() <= wanted.len() + 2);
    }
    let mut calls = 0;
    boxes.meet(&given.concat(), |_| {
        calls += 1;
        calls < 5
    });
    assert_eq!(calls, 5);
    Boxes::around::<3>(&[]).meet(&[DVec3::ZERO], |_| panic!("there are none"));
}

/// Wherever they move, and whatever others ask for in between.
#[test]
fn shared_hits_are_those_of_a_new_hierarchy() {
    let given = rubble(200);
    for k in 0..12 {
        let corners: Vec<Triangle> =
            given.iter().take(200 - k % 2).map(|t| t.map(|p| p + 0.3 * (k / 4) as f64)).collect();
        let solid = |t: &u32| *t as usize % 5 != k % 3;
        let (shared, new) = (Rays::shared(corners.clone(), solid), Rays::among(corners.clone(), solid));
        let mut random = Random(6);
        for triangle in &corners {
            let (origin, direction) = (random.on(*triangle), random.point().normalize());
            assert_eq!(shared.nearest(origin, direction, None), new.nearest(origin, direction, None));
        }
    }
}

//! Light that falls on backs: sheets without a second side, and faces that are turned.
//!
//! Backs reflect nothing; with implicit visibility they let light pass that does not come straight from lamps. How much falls there is a matter of
//! visibility, so it is path-traced, with few paths: surfaces that close each other off, such as a room and what stands in it, keep
//! their backs dark even where edges are open. Of what a back would reflect, that counts which would meet a front, or all if a camera sees the back:
//! the outside of a room under a sky may be black.

use crate::path_tracer::PathTracer;
use antirad_base::parallel;
use antirad_core::direct::from_front;
use antirad_core::model::{Facet, PADDING};
use antirad_core::plan::Plan;
use antirad_scene::{Rays, Scene, bounds};
use glam::DVec3;

/// Triangles that are tried; each stands for its neighbours in space with about the same normal.
const TRIED: usize = 2000;
/// Paths to the back of a triangle.
const PATHS: u32 = 32;
/// Paths to fronts, in all: only their mean is of interest, and in a room they are long.
const PATHS_TO_FRONTS: usize = 4000;
/// Rays from the back of a triangle, which tell where it would reflect light to.
const RAYS: u32 = 32;
/// Irradiance of a back, relative to the mean of all fronts, from which it counts as lit.
const LIT: f64 = 0.05;
/// How far a scene may reach behind an outermost triangle, relative to its size.
const FLAT: f64 = 1e-6;

/// Light on backs.
pub struct Lit {
    /// The triangles whose backs are lit, with that part of their irradiance which is missed, W/m² (sum over RGB), the brightest first.
    pub backs: Vec<(u32, f64)>,
    /// Mean irradiance of all fronts, W/m² (sum over RGB), times the area of all triangles in the plan's unit.
    pub light: f64,
}

impl Lit {
    /// Light on these backs as a share of that on all fronts and these backs. That the housing of a lamp is black is what most expect.
    pub fn share(&self, scene: &Scene, plan: &Plan) -> f64 {
        self.part(plan, |i| !scene.material(i as usize).emits())
    }

    fn part(&self, plan: &Plan, counts: impl Fn(u32) -> bool) -> f64 {
        let light = |&(i, back): &(u32, f64)| plan.facets()[i as usize].area * back;
        let light: f64 = self.backs.iter().filter(|(i, _)| counts(*i)).map(light).sum();
        light.max(0.0) / (light + self.light).max(f64::MIN_POSITIVE)
    }
}

/// Which triangles have nothing of their scene behind them, as outer walls have: known where there are suns, and none otherwise.
struct Outermost<'a> {
    scene: &'a Scene,
    corners: Vec<DVec3>,
    tolerance: f64,
}

impl<'a> Outermost<'a> {
    fn new(scene: &'a Scene) -> Self {
        let skies = scene.behind_suns();
        let all = 0..if scene.suns.is_empty() { 0 } else { scene.triangles.len() };
        let own = all.filter(|i| skies.binary_search(&(*i as u32)).is_err());
        let corners: Vec<DVec3> = own.flat_map(|i| scene.corners(i)).collect();
        let (low, high) = bounds(corners.iter().copied());
        Self { scene, tolerance: FLAT * (high - low).length(), corners }
    }

    fn holds(&self, triangle: usize) -> bool {
        let (origin, normal) =
            (self.scene.corners(triangle)[0], self.scene.area_vector(triangle).normalize_or_zero());
        !self.corners.is_empty() && self.corners.iter().all(|c| (*c - origin).dot(normal) >= -self.tolerance)
    }
}

/// The share of light reflected by the back of a triangle that is missed: what would meet a front that reflects, or all if a camera sees the back.
fn missed(scene: &Scene, rays: &Rays, triangle: usize) -> f64 {
    let [a, b, c] = scene.corners(triangle);
    let back = Facet::new([a, c, b]);
    let sees = |position: DVec3| {
        (position - a).dot(back.normal) > 0.0 && !rays.blocked(position, back.centroid, |i| i == triangle)
    };
    if scene.cameras.iter().any(|camera| sees(camera.position)) {
        return 1.0;
    }
    let meets = |&(origin, direction): &(DVec3, DVec3)| {
        let met = rays.nearest(origin, direction, Some(triangle));
        met.is_some_and(|(i, _)| scene.area_vector(i).dot(direction) < 0.0 && !scene.material(i).only_emits())
    };
    from_front(&back, triangle as u64, 0..RAYS).filter(meets).count() as f64 / f64::from(RAYS)
}

/// Finds the triangles whose backs are lit.
pub fn lit(scene: &Scene, plan: &Plan) -> Lit {
    let order: Vec<u32> = plan.layout().order.iter().copied().filter(|&i| i != PADDING).collect();
    let runs: Vec<&[u32]> = order.chunks(order.len().div_ceil(TRIED).max(1)).collect();
    let tracer = PathTracer::new(scene);
    let sunless = Scene { suns: Vec::new(), ..scene.clone() };
    let without_suns = PathTracer::new(&sunless);
    let outermost = Outermost::new(scene);
    let rays = scene.rays();
    let to_front = (PATHS_TO_FRONTS.div_ceil(runs.len().max(1)) as u32).min(PATHS);
    let sides: Vec<[f64; 2]> = parallel::map(&runs, |run| {
        let middle = run[run.len() / 2] as usize;
        // Walls are expected to keep suns out.
        let to_back = if outermost.holds(middle) { &without_suns } else { &tracer };
        let both = [tracer.irradiance_of(middle, to_front), to_back.irradiance_of_back(middle, PATHS)];
        let [front, back] = both.map(|side| side.mean.element_sum());
        [front, if back > 0.0 { back * missed(scene, &rays, middle) } else { back }]
    });
    let area = |run: &[u32]| run.iter().map(|&i| plan.facets()[i as usize].area).sum::<f64>();
    let (light, all) = runs
        .iter()
        .zip(&sides)
        .fold((0.0, 0.0), |(light, all), (run, [front, _])| (light + front * area(run), all + area(run)));
    let least = LIT * light / all;
    let bright = runs.iter().zip(&sides).filter(|(_, [_, back])| *back > least.max(0.0));
    // What arrives at the back of a side of a sheet arrives at the front of the other.
    let other_sides = scene.other_sides();
    let mut found: Vec<(u32, f64)> = bright
        .flat_map(|(run, [_, back])| run.iter().map(|&i| (i, *back)))
        .filter(|&(i, _)| other_sides[i as usize].is_none())
        .collect();
    found.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    Lit { backs: found, light }
}

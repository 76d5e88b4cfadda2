//! The factor by which the antiradiance of a blocker may be wrong at a receiver.
//!
//! Light incident on a blocker from one direction is interpolated into the surrounding bins, and its antiradiance is emitted
//! over their whole solid angle s_b. A receiver at distance d should lose exactly the light along the line to the blocker, which
//! it sees under a/d². If a/d² is well below s_b, the antiradiance of many blockers overlaps there and the sum is right.
//! Otherwise a single blocker removes up to a/(d² s_b) times too much light from the receivers in one direction, and none from
//! others. This factor is called gain, with the pieces of the near field in place of the whole blocker.

use super::distance::between;
use antirad_base::parallel;
use antirad_core::model::{
    Bins, BoundedRun, Class, Facet, Hierarchy, Node, PADDING, QUARTER_RANGE, Sight, coplanar_tolerance,
    far_weight, morton, reaches,
};
use antirad_core::plan::Plan;
use antirad_scene::bounds;
use glam::DVec3;
use std::collections::HashMap;
use std::f64::consts::PI;

/// Number of strongest gains kept per receiver.
const STRONGEST: usize = 4;

/// Triangles per leaf of the search.
const LEAF: usize = 8;
/// Receivers per parallel task.
const RUN: usize = 64;

/// The strongest gains of each receiver.
type Strongest = Vec<Vec<Gain>>;

/// Gain from the back of a blocker to the front of a receiver. Index = triangle of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gain {
    pub blocker: u32,
    pub receiver: u32,
    pub gain: f64,
}

/// The gains above a limit, by receiver and by blocker.
#[derive(Clone, Debug, Default)]
pub struct Gains {
    /// The strongest gains of each receiver, in descending order.
    pub strongest: Strongest,
    /// The strongest gain of each blocker, if there is one.
    pub of_blocker: Vec<Option<Gain>>,
}

/// The input of gains: triangles with their classes, and the discretisation of the transport.
#[derive(Clone, Copy)]
pub struct Surfaces<'a> {
    /// All triangles.
    pub facets: &'a [Facet],
    /// Their classes.
    pub classes: &'a [Class],
    /// Triangles with area, in spatial order, and [`PADDING`].
    pub order: &'a [u32],
    /// The bins of a hemisphere.
    pub bins: &'a Bins,
    /// Range of the near field: [`antirad_scene::SolveSettings::near_field`].
    pub near_field: f64,
}

impl<'a> From<&'a Plan> for Surfaces<'a> {
    fn from(plan: &'a Plan) -> Self {
        Self {
            facets: plan.facets(),
            classes: plan.classes(),
            order: &plan.layout().order,
            bins: plan.bins(),
            near_field: plan.settings().near_field,
        }
    }
}

impl Gains {
    /// All pairs that can exchange antiradiance and whose gain exceeds `limit`, except where surfaces meet: close to a contact of
    /// blocker and receiver, refinement does not reduce the gains, only the area affected.
    pub fn above(limit: f64, surfaces: Surfaces) -> Self {
        let Surfaces { facets, order, .. } = surfaces;
        let search = Search::new(limit, surfaces);
        let meeting = Nearest::new(search.meeting());
        let to_meeting: Vec<f64> = parallel::map(facets, |facet| meeting.distance(facet.centroid));
        let meets = |g: &Gain| {
            let (i, j) = (g.blocker as usize, g.receiver as usize);
            to_meeting[i].max(to_meeting[j]) <= facets[i].centroid.distance(facets[j].centroid)
        };
        let count = facets.len();
        let mut gains = Self { strongest: vec![Vec::new(); count], of_blocker: vec![None; count] };
        let runs: Vec<(Strongest, HashMap<u32, Gain>)> = parallel::map(order.chunks(RUN), |receivers| {
            let mut of_blocker: HashMap<u32, Gain> = HashMap::new();
            let mut strongest = Vec::new();
            for receiver in real(receivers) {
                let mut all = search.gains(receiver);
                all.retain(|g| !meets(g));
                for g in &all {
                    let best = of_blocker.entry(g.blocker).or_insert(*g);
                    if g.gain > best.gain {
                        *best = *g;
                    }
                }
                all.sort_by(|a, b| b.gain.total_cmp(&a.gain));
                all.truncate(STRONGEST);
                strongest.push(all);
            }
            (strongest, of_blocker)
        });
        for (strongest, of_blocker) in runs {
            for list in strongest {
                if let Some(receiver) = list.first().map(|g| g.receiver) {
                    gains.strongest[receiver as usize] = list;
                }
            }
            for (blocker, g) in of_blocker {
                let best = &mut gains.of_blocker[blocker as usize];
                if best.is_none_or(|best| g.gain > best.gain) {
                    *best = Some(g);
                }
            }
        }
        gains
    }
}

/// Finds the blockers in front of a receiver.
struct Search<'a> {
    surfaces: Surfaces<'a>,
    limit: f64,
    /// The smallest solid angle of a bin, sr.
    finest: f64,
    /// Blockers, in the order of [`Surfaces::order`].
    blockers: Vec<u32>,
    tree: Hierarchy,
    tolerance: f64,
}

impl<'a> Search<'a> {
    fn new(limit: f64, surfaces: Surfaces<'a>) -> Self {
        let Surfaces { facets, classes, order, bins, .. } = surfaces;
        let tolerance = coplanar_tolerance(facets);
        let blockers: Vec<u32> = real(order).filter(|&i| classes[i as usize].blocker).collect();
        Self {
            surfaces,
            limit,
            finest: bins.solid_angle.iter().copied().fold(f64::INFINITY, f64::min),
            tree: Hierarchy::new(facets, &blockers, LEAF, tolerance),
            blockers,
            tolerance,
        }
    }

    /// The blockers that may be in front of a receiver, from the nodes that are `near` its box.
    fn before(&self, receiver: u32, near: impl Fn(&BoundedRun, &Node) -> bool) -> impl Iterator<Item = u32> {
        let to = &self.surfaces.facets[receiver as usize];
        let bounds = BoundedRun::around(std::iter::once(to));
        let may = move |node: &Node| {
            near(&bounds, node)
                && !self.tree.misses(to, &node.bounds, 1.0)
                && self.tree.sight(node, &bounds, -1.0, true) != Sight::Nothing
        };
        let slots = self.tree.leaves(may).flat_map(|node| node.slots(LEAF, &self.blockers));
        slots.copied().filter(move |&blocker| blocker != receiver)
    }

    /// All gains above the limit at a receiver.
    fn gains(&self, receiver: u32) -> Vec<Gain> {
        let large = |bounds: &BoundedRun, node: &Node| {
            node.area > self.limit * self.finest * node.bounds.distance_squared(bounds)
        };
        self.before(receiver, large).filter_map(|blocker| self.gain(blocker, receiver)).collect()
    }

    /// Midpoints of all pairs of a blocker and a receiver behind it that touch.
    fn meeting(&self) -> Vec<DVec3> {
        let most = (2.0 * self.tolerance).powi(2);
        let near = |bounds: &BoundedRun, node: &Node| node.bounds.distance_squared(bounds) <= most;
        let receivers: Vec<u32> = real(self.surfaces.order).collect();
        let meeting = |&receiver: &u32| {
            self.before(receiver, near).filter_map(move |blocker| self.touching(blocker, receiver))
        };
        parallel::flat_map(&receivers, meeting)
    }

    /// The midpoint between the centroids of a blocker and a receiver behind it, if they touch.
    fn touching(&self, blocker: u32, receiver: u32) -> Option<DVec3> {
        let [from, to] = [blocker, receiver].map(|i| &self.surfaces.facets[i as usize]);
        let reach = |f: &Facet| f.corners.iter().map(|&c| c.distance(f.centroid)).fold(0.0, f64::max);
        (from.centroid.distance(to.centroid) <= reach(from) + reach(to)
            && self.passes(from, to)
            && between(from.corners, to.corners).length() <= self.tolerance)
            .then(|| from.centroid.midpoint(to.centroid))
    }

    /// Whether antiradiance passes from centroid to centroid.
    fn passes(&self, from: &Facet, to: &Facet) -> bool {
        let between = to.centroid - from.centroid;
        between.dot(from.normal) < 0.0
            && between.dot(to.normal) < 0.0
            && reaches(from, to, -1.0, self.tolerance)
    }

    /// a cos_i / (d² s_b), with a the area of the pieces into which the transport cuts the blocker, if above the limit.
    fn gain(&self, blocker: u32, receiver: u32) -> Option<Gain> {
        let Surfaces { facets, bins, near_field, .. } = self.surfaces;
        let (from, to) = (&facets[blocker as usize], &facets[receiver as usize]);
        let between = to.centroid - from.centroid;
        let r2 = between.length_squared();
        if from.area <= self.limit * self.finest * r2 || between.dot(from.normal) >= 0.0 {
            return None;
        }
        let range = 0.5 * near_field * (from.characteristic_area + to.characteristic_area);
        let (far, middle) = (far_weight(r2, range), far_weight(r2, range * QUARTER_RANGE));
        let piece = from.area * (far + (1.0 - far) * (middle / 4.0 + (1.0 - middle) / 16.0));
        let back = -between / r2.sqrt();
        let solid_angle = piece * back.dot(from.normal) / (r2 + piece / PI);
        if solid_angle <= self.limit * self.finest || !self.passes(from, to) {
            return None;
        }
        let taps = bins.taps(from.to_local(back));
        let bin: f64 = taps.iter().map(|&(b, t)| t * bins.solid_angle[b]).sum();
        let gain = solid_angle / bin;
        (gain > self.limit).then_some(Gain { blocker, receiver, gain })
    }
}

fn real(slots: &[u32]) -> impl Iterator<Item = u32> + Clone {
    slots.iter().copied().filter(|&i| i != PADDING)
}

/// Distances to the nearest of a set of points, stored in chunks of neighbours with their bounds.
struct Nearest {
    runs: Vec<(DVec3, DVec3, Vec<DVec3>)>,
}

impl Nearest {
    const RUN: usize = 64;

    fn new(mut points: Vec<DVec3>) -> Self {
        let (low, high) = bounds(points.iter().copied());
        let size = (high - low).max_element().max(f64::MIN_POSITIVE);
        points.sort_by_cached_key(|&p| morton((p - low) / size));
        let run = |points: &[DVec3]| {
            let (low, high) = bounds(points.iter().copied());
            (low, high, points.to_vec())
        };
        Self { runs: points.chunks(Self::RUN).map(run).collect() }
    }

    /// Distance to the nearest point; infinite if there are no points.
    fn distance(&self, from: DVec3) -> f64 {
        let mut nearest = f64::INFINITY;
        for (low, high, points) in &self.runs {
            if (*low - from).max(from - *high).max(DVec3::ZERO).length_squared() < nearest {
                nearest = points.iter().map(|p| p.distance_squared(from)).fold(nearest, f64::min);
            }
        }
        nearest.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_core::plan::PlanOptions;
    use antirad_kit::Plates;
    use antirad_scene::{LoadOptions, Material, Scene, SceneBuilder, Shape};
    use glam::DAffine3;
    use std::path::Path;

    /// A statue that stands on a floor.
    fn statue() -> Scene {
        let (floor, stone) = (Material::named("floor"), Material::named("stone"));
        let mut builder = SceneBuilder::new();
        let place = DAffine3::from_scale(DVec3::splat(4.0)) * DAffine3::from_translation(-DVec3::X / 2.0);
        builder.shape("floor", Shape::Quad { cells: 12 }, &floor, place);
        builder.shape("statue", Shape::Statue { triangles: 1500 }, &stone, DAffine3::IDENTITY);
        builder.finish("statue").expect("a scene")
    }

    #[test]
    fn the_search_finds_all_pairs() {
        let rooms = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/two_rooms.toml");
        let rooms = Scene::load(&rooms, &LoadOptions::default()).expect("a shipped scene");
        let (mut gains, mut touching) = (0, 0);
        for scene in [statue(), rooms, Plates::default().scene().expect("a scene")] {
            let plan = Plan::new(
                &scene,
                &PlanOptions::default().boundless(),
                &scene.settings.visibility(antirad_scene::VisibilityChoice::Implicit),
            )
            .expect("a plan");
            let search = Search::new(0.5, (&plan).into());
            let others = |receiver: u32| search.blockers.iter().copied().filter(move |&i| i != receiver);
            let mut meeting = Vec::new();
            for receiver in real(&plan.layout().order) {
                let all: Vec<Gain> = others(receiver).filter_map(|i| search.gain(i, receiver)).collect();
                assert_eq!(search.gains(receiver), all, "{}: triangle {receiver}", scene.name);
                meeting.extend(others(receiver).filter_map(|i| search.touching(i, receiver)));
                gains += all.len();
            }
            assert_eq!(search.meeting(), meeting, "{}", scene.name);
            touching += meeting.len();
        }
        assert!(gains > 1000 && touching > 10, "{gains} gains, {touching} that touch");
    }
}

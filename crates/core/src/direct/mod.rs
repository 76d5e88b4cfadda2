//! Direct light of lamps, with exact visibility, on the host in f64.
//!
//! What a point sees of a lamp is the lamp's cone of directions less the cones of all triangles in between. The rest is cut into
//! convex cones, each of which Lambert's formula integrates exactly, so that there is no sampling noise, and the boundaries of what is
//! visible move smoothly with every vertex. Only the mean over a receiver is a quadrature. Of a bulb a point sees the silhouette, and of
//! a sun a polygon that moves with the point.

mod blockers;
mod cone;
mod derivative;
mod guide;
mod highlight;
mod lamps;
mod lobes;
mod many_lights;
mod openness;
mod polygon;
mod quadrature;
mod rays;
mod sampling;
mod shaft;
mod solid;
mod subtraction;
mod sun;
mod surface;
mod trapezoids;
mod visible;

pub use cone::vector_irradiance;
pub use lamps::{FEW as FEW_LAMPS, Lamp, lamps, suns};
pub use openness::{Lost, Openness, Parts};
pub use polygon::Polygon;
pub use rays::{DirectError, Look, RayScene, Traced, Tracer};
pub use sampling::{STEPS, Sampling, Sums, from_front, mixed, sobol};
pub use surface::{Flat, Surface, within};

use crate::model::{Facet, FacetGradient, pull_unit};
use antirad_base::parallel;
use antirad_base::ranks::{RankError, Ranks};
use antirad_gpu::GpuError;
use antirad_scene::Material;
use blockers::Blockers;
use derivative::{Contributions, Sight};
use glam::{DVec2, DVec3};
use guide::{Guides, Mask, Open};
use highlight::Lobe;
use many_lights::{Arrival, ManyLights, by_lamp};
use quadrature::Cuts;
pub use quadrature::{POINTS, Sample};
use rays::{Lit, Tracing};
use sampling::Share;
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use sun::Disc;
use visible::{Geometry, Placed, Visible};

/// How much of a lamp a point sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Visibility {
    /// Exact visibility: cones without sampling noise.
    #[default]
    Exact,
    /// Visibility by rays where much stands in between, which costs as much in any scene. Derivatives by
    /// positions leave out how shadows move.
    Sampled,
    /// A number of rays from each point that does not depend on that of lamps, which are distributed over them by
    /// importance. There are no derivatives by positions.
    Distributed,
}

/// The light of a lamp on a triangle.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize, serde::Serialize)]
pub struct Factor {
    /// Number of the lamp.
    pub lamp: u32,
    /// Standard error of the value. Where rays are distributed over lamps, half the difference of what two halves of the rays
    /// tell: the errors of all lamps have to be added up first.
    error: f32,
    /// Mean irradiance per radiance, sr: the form factor times π.
    pub value: f64,
}

/// Vector irradiance of lamps at a point per radiance, sr: of those of which some arrives, by their ascending numbers.
pub type PointLight = Vec<(u32, DVec3)>;

/// Direct light of lamps on the triangles of a scene. Several ranks compute it and its derivatives together,
/// and all of them have the whole.
#[derive(Clone, Debug)]
pub struct DirectLight {
    /// The ranks that compute it together.
    ranks: Ranks,
    blockers: Blockers,
    /// Rays to lamps; `None` where visibility is exact.
    sampling: Option<Sampling>,
    /// A kernel that traces such rays from many points at once.
    tracing: Option<Tracing>,
    /// Rays distributed over all lamps, in place of visibility lamp by lamp.
    many: Option<ManyLights>,
    lamps: Vec<Lamp>,
    /// How open the parts of receivers lie.
    open: Arc<Openness>,
    receivers: usize,
    /// Of each receiver, in the order of lamps: [`Self::factors`].
    factors: Vec<Vec<Factor>>,
    /// How receivers with a penumbra are cut into cells, by receiver and lamp.
    cuts: BTreeMap<[usize; 2], Cuts>,
    /// Where rays from points go.
    guides: Arc<Guides>,
}

impl DirectLight {
    /// Computes the light of lamps on triangles, in any unit of length. Ranks compute shares of it, and all
    /// of them call it. `open`: by which means over triangles are weighted.
    ///
    /// # Errors
    /// Fails if another rank has ended, or does not run the same program.
    pub fn new<'a>(
        ranks: &Ranks,
        facets: &[Facet],
        lamps: Vec<Lamp>,
        visibility: Visibility,
        open: Arc<Openness>,
        material: impl Fn(usize) -> &'a Material,
    ) -> Result<Self, RankError> {
        if let Some(many) = Self::many(facets, &lamps, visibility, &material) {
            return Self::distributed(ranks.clone(), facets, lamps, open, many);
        }
        let sampling = Self::sampling(facets, &lamps, visibility, material);
        Self::compute(ranks.clone(), facets, lamps, open, sampling, None)
    }

    /// Computes the light of lamps on triangles as [`Self::new`] does, by rays that a kernel traces from points. `tracer`: makes it.
    ///
    /// # Errors
    /// Fails if the device does, or if another rank has ended or does not run the same program.
    pub fn traced<'a>(
        ranks: &Ranks,
        facets: &[Facet],
        lamps: Vec<Lamp>,
        open: Arc<Openness>,
        material: impl Fn(usize) -> &'a Material,
        tracer: impl FnOnce(&RayScene) -> Result<Arc<dyn Tracer>, GpuError>,
    ) -> Result<Self, DirectError> {
        let unlit = Self::of_points(facets, lamps, Visibility::Sampled, &material);
        let (usual, radiance) = (usual(facets, &unlit.lamps), unlit.radiance(&material));
        let tracer = tracer(&unlit.ray_scene(facets))?;
        let tracing = Tracing::new(tracer, &unlit.lamps, &radiance, &usual);
        let geometry = unlit.geometry(facets);
        let placed: Vec<Placed> = unlit.lamps.iter().map(|lamp| geometry.place(lamp)).collect();
        let mut found = Vec::new();
        for receivers in ranks.own(facets.len()).chunks(RECEIVERS) {
            let faced = |&receiver: &usize| {
                let lamps = placed.iter().enumerate();
                lamps.filter(move |(_, lamp)| geometry.faces(receiver, lamp)).map(move |(l, _)| [receiver, l])
            };
            let pairs: Vec<[usize; 2]> = receivers.iter().flat_map(faced).collect();
            let usual: Vec<f64> = pairs.iter().map(|&[_, l]| usual[l]).collect();
            let parts = |pair: usize| open.of(pairs[pair][0]);
            let means = quadrature::means(&usual, parts, &mut |points, width| {
                let look = |&(pair, b): &(usize, DVec3)| {
                    let [receiver, lamp]: [usize; 2] = pairs[pair];
                    let Facet { corners, normal, .. } = facets[receiver];
                    Look { point: at(corners, b), normal, lamp }
                };
                let looks: Vec<Look> = points.iter().map(look).collect();
                let lit = tracing.light(&looks, rays::OF_SAMPLE, 1.0 / width)?;
                Ok::<_, GpuError>(lit.iter().map(|lit| lit.irradiance).collect())
            })?;
            let mut of_pairs = pairs.iter().zip(means).peekable();
            for &receiver in receivers {
                let dark = || (Share::NOTHING, Cuts::default());
                let of_lamp = |l: usize| {
                    let of_pair = of_pairs.next_if(|(pair, _)| **pair == [receiver, l]);
                    let (share, cuts) = of_pair.map_or_else(dark, |(_, mean)| mean);
                    (share, cuts, Mask::default())
                };
                found.push((0..placed.len()).map(of_lamp).collect());
            }
        }
        let found = ranks.merged(facets.len(), found)?;
        drop(placed);
        let Self { blockers, sampling, lamps, .. } = unlit;
        let light = Self::of_found(ranks.clone(), facets, found, blockers, (sampling, open), lamps);
        Ok(Self { tracing: Some(tracing), ..light })
    }

    /// Rays, the more to a lamp the more it emits.
    fn sampling<'a>(
        facets: &[Facet],
        lamps: &[Lamp],
        visibility: Visibility,
        material: impl Fn(usize) -> &'a Material,
    ) -> Option<Sampling> {
        let sampled = visibility == Visibility::Sampled && !lamps.is_empty();
        sampled.then(|| Sampling::new(facets, lamps, &radiance(lamps, material)))
    }

    /// Rays to distribute over lamps, the more to a lamp the more it emits.
    fn many<'a>(
        facets: &[Facet],
        lamps: &[Lamp],
        visibility: Visibility,
        material: impl Fn(usize) -> &'a Material,
    ) -> Option<ManyLights> {
        let distributed = visibility == Visibility::Distributed && !lamps.is_empty();
        distributed.then(|| ManyLights::new(facets, lamps, &radiance(lamps, material)))
    }

    /// The light of lamps on triangles by rays that are distributed over all lamps.
    fn distributed(
        ranks: Ranks,
        facets: &[Facet],
        lamps: Vec<Lamp>,
        open: Arc<Openness>,
        many: ManyLights,
    ) -> Result<Self, RankError> {
        let of_receiver = |receiver: usize| -> Vec<Factor> {
            let facet = &facets[receiver];
            let arrivals = many.at_triangle(&lamps, (receiver, facet), open.of(receiver));
            let of_half = |Arrival { direction, solid_angle, in_second_half, .. }: &Arrival| {
                let light = solid_angle * direction.dot(facet.normal);
                if *in_second_half { DVec2::new(0.0, light) } else { DVec2::new(light, 0.0) }
            };
            let factor =
                |(lamp, DVec2 { x, y }): (u32, DVec2)| Factor { lamp, error: (x - y) as f32, value: x + y };
            by_lamp(&arrivals, of_half).into_iter().map(factor).collect()
        };
        let factors = ranks.map(facets.len(), of_receiver)?;
        let receivers = factors.len();
        let unlit = Self::among(Blockers::none(facets), lamps);
        Ok(Self { ranks, open, receivers, factors, many: Some(many), ..unlit })
    }

    /// Prepares light at points of triangles alone ([`Self::at_points`]): it knows the light of no triangle.
    pub fn of_points<'a>(
        facets: &[Facet],
        lamps: Vec<Lamp>,
        visibility: Visibility,
        material: impl Fn(usize) -> &'a Material,
    ) -> Self {
        let many = Self::many(facets, &lamps, visibility, &material);
        let sampling = Self::sampling(facets, &lamps, visibility, material);
        let blockers = if many.is_some() { Blockers::none(facets) } else { Blockers::of(facets, &lamps) };
        Self { sampling, many, ..Self::among(blockers, lamps) }
    }

    fn among(blockers: Blockers, lamps: Vec<Lamp>) -> Self {
        Self {
            ranks: Ranks::default(),
            blockers,
            sampling: None,
            tracing: None,
            many: None,
            lamps,
            open: Arc::default(),
            receivers: 0,
            factors: Vec::new(),
            cuts: BTreeMap::new(),
            guides: Arc::default(),
        }
    }

    /// The same as if nothing stood between lamps and points.
    pub fn unblocked(self, facets: &[Facet]) -> Self {
        let many = self.many.map(ManyLights::without_shadows);
        Self { blockers: Blockers::none(facets), sampling: None, tracing: None, many, ..self }
    }

    /// The same with so many rays from each point, where they are distributed over lamps.
    pub fn with_rays(self, count: u32) -> Self {
        Self { many: self.many.map(|many| many.with_rays(count)), ..self }
    }

    /// Whether anything may stand between lamps and what they light.
    pub fn is_blocked(facets: &[Facet], lamps: &[Lamp]) -> bool {
        Blockers::exist(facets, lamps)
    }

    /// What rays from these triangles to lamps may meet.
    pub fn ray_scene(&self, facets: &[Facet]) -> RayScene {
        RayScene::new(facets, &self.blockers, &self.lamps)
    }

    /// Prepares light at points of triangles alone, as if nothing stood between lamps and points.
    pub fn without_shadows(facets: &[Facet], lamps: Vec<Lamp>) -> Self {
        Self::among(Blockers::none(facets), lamps)
    }

    /// Whether [`Self::new`] would test at most so many blockers against cones: an estimate, from the work of a few receivers.
    pub fn takes_at_most(facets: &[Facet], lamps: &[Lamp], tests: f64) -> bool {
        // Odd, since triangles often come in pairs.
        let step = (facets.len() / PROBES).max(ONE_OF) | 1;
        Self::work(facets, lamps, step, tests) <= tests
    }

    /// Tests of blockers against cones that [`Self::new`] takes, from every `step`-th receiver; any number above `most` where there are more.
    fn work(facets: &[Facet], lamps: &[Lamp], step: usize, most: f64) -> f64 {
        let blockers = Blockers::of(facets, lamps);
        let geometry = Geometry { facets, blockers: &blockers };
        let placed: Vec<Placed> = lamps.iter().map(|lamp| geometry.place(lamp)).collect();
        let usual = usual(facets, lamps);
        let probes: Vec<usize> = (0..facets.len()).step_by(step).collect();
        let of_each = facets.len() as f64 / probes.len().max(1) as f64;
        let tests = AtomicU64::new(0);
        let work = || tests.load(Ordering::Relaxed) as f64 * of_each;
        // What is too much need not be known exactly.
        let too_much = || work() > most;
        let of_probe = |visible: &mut Visible, &receiver: &usize| {
            let Facet { corners, normal, .. } = facets[receiver];
            let faced = placed.iter().enumerate().filter(|(_, lamp)| geometry.faces(receiver, lamp));
            for lamp in faced.take_while(|_| !too_much()) {
                let (between, _) = Between::triangle(geometry, None, (receiver, None), lamp);
                quadrature::mean(usual[lamp.0], between.least_cuts(), None, &mut |b: DVec3| {
                    if too_much() {
                        return 0.0;
                    }
                    let value = between.sight(at(corners, b), None).vector_irradiance(visible).dot(normal);
                    tests.fetch_add(std::mem::take(&mut visible.tests), Ordering::Relaxed);
                    value
                });
            }
        };
        parallel::map_init(&probes, Visible::default, of_probe);
        work()
    }

    /// The light of lamps at the same places, which may shine otherwise; `None` if some stand elsewhere.
    pub fn relit(self: &Arc<Self>, lamps: &[Lamp]) -> Option<Arc<Self>> {
        if self.lamps == lamps {
            return Some(self.clone());
        }
        let in_place =
            self.lamps.len() == lamps.len() && self.lamps.iter().zip(lamps).all(|(a, b)| a.is_at(b));
        in_place.then(|| Arc::new(Self { lamps: lamps.to_vec(), ..(**self).clone() }))
    }

    /// Computes the light after vertices of triangles and lamps have moved, at the same sample points: a
    /// smooth function of the vertices.
    ///
    /// # Errors
    /// Fails if another rank has ended, or does not run the same program.
    pub fn moved(&self, facets: &[Facet]) -> Result<Self, RankError> {
        if let Some(many) = &self.many {
            let many = many.moved(facets, &self.lamps);
            return Self::distributed(
                self.ranks.clone(),
                facets,
                self.lamps.clone(),
                self.open.clone(),
                many,
            );
        }
        let sampling = self.sampling.as_ref().map(|sampling| sampling.moved(facets, &self.lamps));
        let open = self.open.clone();
        Self::compute(self.ranks.clone(), facets, self.lamps.clone(), open, sampling, Some(&self.cuts))
    }

    fn compute(
        ranks: Ranks,
        facets: &[Facet],
        lamps: Vec<Lamp>,
        open: Arc<Openness>,
        sampling: Option<Sampling>,
        cuts: Option<&BTreeMap<[usize; 2], Cuts>>,
    ) -> Result<Self, RankError> {
        let blockers = Blockers::of(facets, &lamps);
        let geometry = Geometry { facets, blockers: &blockers };
        let placed: Vec<Placed> = lamps.iter().map(|lamp| geometry.place(lamp)).collect();
        let usual = usual(facets, &lamps);
        let of_receiver = |visible: &mut Visible, receiver: usize| -> Vec<Found> {
            let Facet { corners, normal, .. } = facets[receiver];
            let of_lamp = |(l, lamp): (usize, &Placed)| {
                if !geometry.faces(receiver, lamp) {
                    return (Share::NOTHING, Cuts::default(), Mask::default());
                }
                let parts = open.of(receiver);
                let (between, mask) =
                    Between::triangle(geometry, sampling.as_ref(), (receiver, parts), (l, lamp));
                let mut irradiance =
                    |b: DVec3| between.sight(at(corners, b), None).vector_irradiance(visible).dot(normal);
                let (value, cuts) = match cuts {
                    None => quadrature::mean(usual[l], between.least_cuts(), parts, &mut irradiance),
                    Some(cuts) => {
                        let cuts = cuts.get(&[receiver, l]).cloned().unwrap_or_default();
                        let samples = quadrature::samples(&cuts, parts);
                        (samples.iter().map(|s| s.weight * irradiance(s.barycentric)).sum(), cuts)
                    }
                };
                (Share { value, error: value * between.relative_error() }, cuts, mask)
            };
            placed.iter().enumerate().map(of_lamp).collect()
        };
        let found = ranks.map_init(facets.len(), Visible::default, of_receiver)?;
        drop(placed);
        Ok(Self::of_found(ranks, facets, found, blockers, (sampling, open), lamps))
    }

    /// `found`: the light of each lamp on each receiver.
    fn of_found(
        ranks: Ranks,
        facets: &[Facet],
        found: Vec<Vec<Found>>,
        blockers: Blockers,
        (sampling, open): (Option<Sampling>, Arc<Openness>),
        lamps: Vec<Lamp>,
    ) -> Self {
        let receivers = found.len();
        let mut factors = Vec::with_capacity(receivers);
        let masks = found.iter().enumerate().flat_map(|(receiver, of_lamps)| {
            of_lamps.iter().enumerate().map(move |(lamp, (.., mask))| (receiver, lamp, mask))
        });
        let guides =
            Arc::new(if sampling.is_some() { Guides::new(facets, masks) } else { Guides::default() });
        let mut cuts = BTreeMap::new();
        for (receiver, of_lamps) in found.into_iter().enumerate() {
            let factor = |(lamp, (Share { value, error }, ..)): (u32, &Found)| {
                (*value != 0.0).then_some(Factor { lamp, error: *error as f32, value: *value })
            };
            factors.push((0..).zip(&of_lamps).filter_map(factor).collect());
            let in_parts = of_lamps.into_iter().enumerate().filter(|(_, (_, cuts, _))| !cuts.is_whole());
            cuts.extend(in_parts.map(|(l, (_, cuts, _))| ([receiver, l], cuts)));
        }
        Self { ranks, open, receivers, sampling, factors, cuts, guides, ..Self::among(blockers, lamps) }
    }

    /// The ranks that compute the light together.
    pub fn ranks(&self) -> &Ranks {
        &self.ranks
    }

    fn geometry<'a>(&'a self, facets: &'a [Facet]) -> Geometry<'a> {
        Geometry { facets, blockers: &self.blockers }
    }

    /// Whether a kernel traces rays.
    pub fn is_traced(&self) -> bool {
        self.tracing.is_some()
    }

    /// How much of lamps points see.
    pub fn visibility(&self) -> Visibility {
        match (&self.many, &self.sampling) {
            (Some(_), _) => Visibility::Distributed,
            (None, Some(_)) => Visibility::Sampled,
            (None, None) => Visibility::Exact,
        }
    }

    /// Standard error of [`Self::irradiance`], as a relative L2 norm weighted by area, without that of emitters; zero where visibility is
    /// exact.
    pub fn standard_error<'a>(&self, facets: &[Facet], material: impl Fn(usize) -> &'a Material) -> f64 {
        let radiance = self.radiance(&material);
        let (mut error, mut light) = (0.0, 0.0);
        let receives = |(i, _): &(usize, _)| !material(*i).emits();
        for (i, factors) in self.factors.iter().enumerate().filter(receives) {
            let area = facets[i].area;
            let errors = factors.iter().map(|f| f64::from(f.error) * radiance[f.lamp as usize]);
            error += area
                * match self.many {
                    // Halves of the same rays go to all lamps.
                    Some(_) => errors.sum::<DVec3>().length_squared(),
                    None => errors.map(DVec3::length_squared).sum::<f64>(),
                };
            let sum: f64 = factors.iter().map(|f| f.value * radiance[f.lamp as usize].length()).sum();
            light += area * sum * sum;
        }
        if light > 0.0 { (error / light).sqrt() } else { 0.0 }
    }

    /// The lamps.
    pub fn lamps(&self) -> &[Lamp] {
        &self.lamps
    }

    /// Points of a triangle that suffice where light is smooth.
    pub fn whole_samples(&self) -> Vec<Sample> {
        quadrature::samples(&Cuts::default(), None)
    }

    /// Number of triangles.
    pub fn receivers(&self) -> usize {
        self.receivers
    }

    /// The light of lamps on a triangle: of those of which some arrives, by their ascending numbers.
    pub fn factors(&self, receiver: usize) -> &[Factor] {
        &self.factors[receiver]
    }

    /// Mean irradiance of a triangle per radiance of a lamp, sr.
    pub fn factor(&self, receiver: usize, lamp: usize) -> f64 {
        let factors = self.factors(receiver);
        let place = factors.binary_search_by_key(&(lamp as u32), |factor| factor.lamp);
        place.map_or(0.0, |place| factors[place].value)
    }

    /// Radiance of each lamp, W/(m² sr), of emitters from the material of each triangle.
    pub fn radiance<'a>(&self, material: impl Fn(usize) -> &'a Material) -> Vec<DVec3> {
        radiance(&self.lamps, material)
    }

    /// Irradiance of each triangle, W/m², RGB.
    pub fn irradiance<'a>(&self, material: impl Fn(usize) -> &'a Material) -> Vec<DVec3> {
        let radiance = self.radiance(material);
        let of = |receiver| self.factors(receiver).iter().map(|f| f.value * radiance[f.lamp as usize]).sum();
        (0..self.receivers).map(of).collect()
    }

    /// Derivatives of a loss by the irradiance of each sun, from those by the radiance of each lamp.
    pub fn by_suns(&self, by_radiance: &[DVec3]) -> Vec<DVec3> {
        let lamps = self.lamps.iter().zip(by_radiance);
        lamps.filter_map(|(lamp, by)| Some(*by / lamp.sun()?.projected())).collect()
    }

    /// Irradiance of each triangle straight from suns, W/m², RGB: the part of [`Self::irradiance`] that no triangle emits.
    pub fn sunlight(&self) -> Vec<DVec3> {
        let suns: Vec<(usize, DVec3)> =
            (0..).zip(&self.lamps).filter_map(|(l, lamp)| Some((l, lamp.sun()?.radiance()))).collect();
        let of = |receiver| suns.iter().map(|&(l, radiance)| self.factor(receiver, l) * radiance).sum();
        (0..self.receivers).map(of).collect()
    }

    /// What each triangle sends into U, W/(m² sr): its emission, except for lamps, and the direct light that it reflects diffusely. Takes
    /// [`Self::irradiance`] under the same materials.
    pub fn emitted<'a>(
        &self,
        material: impl Fn(usize) -> &'a Material,
        irradiance: &[DVec3],
    ) -> Vec<[f64; 3]> {
        let mut own: Vec<DVec3> = (0..self.receivers).map(|i| material(i).emission.into()).collect();
        for &i in self.lamps.iter().flat_map(Lamp::triangles) {
            own[i as usize] = DVec3::ZERO;
        }
        let sent = |(i, (own, &irradiance)): (usize, (DVec3, &DVec3))| {
            (own + irradiance * DVec3::from(material(i).diffuse_albedo()) / PI).to_array()
        };
        own.into_iter().zip(irradiance).enumerate().map(sent).collect()
    }

    /// Derivatives of a loss by the triangles, where `cotangent` is its derivative by [`Self::factors`] of a receiver and a lamp. Those by
    /// triangles of which `moves` is false need not be complete.
    ///
    /// # Errors
    /// Fails if another rank has ended, or does not run the same program.
    pub fn pull_back(
        &self,
        facets: &[Facet],
        cotangent: impl Fn(usize, usize) -> f64 + Sync,
        moves: impl Fn(u32) -> bool + Sync,
    ) -> Result<Vec<FacetGradient>, RankError> {
        let geometry = self.geometry(facets);
        let placed: Vec<Placed> = self.lamp_by_lamp().map(|lamp| geometry.place(lamp)).collect();
        let of_receiver = |visible: &mut Visible, receiver: usize, to: &mut Contributions| {
            for (l, lamp) in placed.iter().enumerate() {
                let weight = cotangent(receiver, l);
                if weight == 0.0 || self.factor(receiver, l) == 0.0 {
                    continue;
                }
                let between = self.between(geometry, receiver, (l, lamp));
                if moves(receiver as u32) || between.moves(&moves) {
                    self.pull_back_to(&between, visible, weight, to);
                }
            }
        };
        let mut gradients = vec![FacetGradient::default(); facets.len()];
        for first in (0..facets.len()).step_by(RECEIVERS) {
            let receivers = first..facets.len().min(first + RECEIVERS);
            // Neighbours share lamps and what stands in between.
            let of_some = |visible: &mut Visible, number: usize| {
                let mut to = Contributions::default();
                let some = receivers.clone().skip(number * NEIGHBOURS).take(NEIGHBOURS);
                some.for_each(|receiver| of_receiver(visible, receiver, &mut to));
                to.merged()
            };
            let count = receivers.len().div_ceil(NEIGHBOURS);
            let parts = self.ranks.map_init(count, Visible::default, of_some)?;
            // One after the other, so that sums are the same from run to run, with any number of ranks.
            for (triangle, gradient) in parts.into_iter().flatten() {
                gradients[triangle as usize] += gradient;
            }
        }
        Ok(gradients)
    }

    /// Whether some shadows are as sharp as those of suns.
    pub fn has_sharp_shadows(&self) -> bool {
        self.many.is_none() && self.lamps.iter().any(|lamp| lamp.sun().is_some())
    }

    /// The share of each sun that is seen from points of one triangle; `None` of suns that the triangle does not face.
    pub fn sunlit(&self, facets: &[Facet], face: usize, points: &[DVec3]) -> Vec<Vec<Option<f64>>> {
        let suns = self.lamps.iter().filter(|lamp| lamp.sun().is_some()).count();
        let others = self.lamps.len() - suns;
        let mut shares = vec![vec![None; suns]; points.len()];
        let is_sun = |between: &Between| between.lamp.1.lamp.sun().is_some();
        self.each_sight(facets, face, points, None, &is_sun, &mut |k, l, sight, visible| {
            let all = self.lamps[l].sun().map_or(1.0, Disc::projected);
            shares[k][l - others] = Some(sight.vector_irradiance(visible).length() / all);
        });
        shares
    }

    /// Vector irradiance Φ = ∫ ω dω over the visible directions of each lamp above the horizon, at points of
    /// one triangle, sr: irradiance per radiance is its product with the normal. Distant points are better
    /// asked for separately, since they share a search.
    pub fn at_points(&self, facets: &[Facet], face: usize, points: &[DVec3]) -> Vec<PointLight> {
        if let Some(many) = &self.many {
            let phi = |arrival: &Arrival| arrival.solid_angle * arrival.direction;
            let at = |point: &DVec3| many.at_point(&self.lamps, (face, &facets[face]), *point, None);
            return points.iter().map(|point| by_lamp(&at(point), phi)).collect();
        }
        let mut light = vec![PointLight::new(); points.len()];
        self.each_sight(facets, face, points, None, &|_| true, &mut |k, l, sight, visible| {
            light[k].push((l as u32, sight.vector_irradiance(visible)));
        });
        light
    }

    /// [`Self::at_points`] of several faces, each with its points: by kernels where these compute the light.
    ///
    /// # Errors
    /// Fails if the device does.
    pub fn at_faces(
        &self,
        facets: &[Facet],
        faces: &[(usize, &[DVec3])],
    ) -> Result<Vec<Vec<PointLight>>, GpuError> {
        let Some(tracing) = &self.tracing else {
            let of = |&(face, points): &(usize, &[DVec3])| self.at_points(facets, face, points);
            return Ok(parallel::map(faces, of));
        };
        let geometry = self.geometry(facets);
        let placed: Vec<Placed> = self.lamps.iter().map(|lamp| geometry.place(lamp)).collect();
        let mut light: Vec<Vec<PointLight>> =
            faces.iter().map(|(_, points)| vec![PointLight::new(); points.len()]).collect();
        let (mut places, mut looks) = (Vec::new(), Vec::new());
        for (f, &(face, points)) in faces.iter().enumerate() {
            let normal = facets[face].normal;
            for (lamp, _) in placed.iter().enumerate().filter(|(_, lamp)| geometry.faces(face, lamp)) {
                places.extend((0..points.len()).map(|k| [f, k, lamp]));
                looks.extend(points.iter().map(|&point| Look { point, normal, lamp }));
            }
        }
        for ([f, k, lamp], Lit { phi, .. }) in
            places.into_iter().zip(tracing.light(&looks, rays::OF_PIXEL, 1.0)?)
        {
            light[f][k].push((lamp as u32, phi));
        }
        Ok(light)
    }

    /// The transpose of the derivative of [`Self::at_points`]: contributions by triangle, from the derivative of a loss by each Φ. The
    /// second result is the derivative by each point. Both need be complete only where a triangle is concerned of which `moves` is true.
    pub fn pull_back_points(
        &self,
        facets: &[Facet],
        face: usize,
        points: &[DVec3],
        cotangent: impl Fn(usize, usize) -> DVec3,
        moves: impl Fn(u32) -> bool,
    ) -> (Vec<(u32, FacetGradient)>, Vec<DVec3>) {
        let mut to = Contributions::default();
        let mut of_points = vec![DVec3::ZERO; points.len()];
        let wanted = |between: &Between| moves(face as u32) || between.moves(&moves);
        self.each_sight(facets, face, points, None, &wanted, &mut |k, l, sight, visible| {
            of_points[k] += sight.pull_back(visible, cotangent(k, l), &mut to).1;
        });
        (to.merged(), of_points)
    }

    /// Specular reflection of each lamp at points of one triangle towards an eye, ∫ ⟨h, n⟩^p cosθ dω over the visible part, sr: times σ N(p)
    /// and the lamp's radiance, it is the radiance that the eye sees.
    pub fn highlights(
        &self,
        facets: &[Facet],
        face: usize,
        points: &[DVec3],
        eye: DVec3,
        power: f64,
    ) -> Vec<Vec<f64>> {
        let mut light = vec![vec![0.0; self.lamps.len()]; points.len()];
        self.each_reflected(facets, face, points, (eye, power), &mut |k, l, lobe, arrival| {
            light[k][l] += lobe.at(arrival) * arrival.dot(lobe.normal);
        });
        self.each_sight(facets, face, points, Some((eye, power)), &|_| true, &mut |k, l, sight, visible| {
            light[k][l] = sight.highlight(visible, &Lobe::towards(eye, sight.point, sight.normal, power));
        });
        light
    }

    /// The transpose of the derivative of [`Self::highlights`], from the derivative of a loss by each of them.
    pub fn pull_back_highlights(
        &self,
        facets: &[Facet],
        face: usize,
        points: &[DVec3],
        eye: DVec3,
        power: f64,
        cotangent: impl Fn(usize, usize) -> f64,
    ) -> HighlightGradient {
        let mut to = Contributions::default();
        let mut gradient =
            HighlightGradient { points: vec![DVec3::ZERO; points.len()], ..HighlightGradient::default() };
        let mut own = FacetGradient::default();
        self.each_reflected(facets, face, points, (eye, power), &mut |k, l, lobe, arrival| {
            gradient.power += cotangent(k, l) * lobe.by_power(arrival) * arrival.dot(lobe.normal);
        });
        self.each_sight(facets, face, points, Some((eye, power)), &|_| true, &mut |k, l, sight, visible| {
            let by = cotangent(k, l);
            let lobe = Lobe::towards(eye, sight.point, sight.normal, power);
            let (_, slopes, by_point) = sight.pull_back_highlight(visible, &lobe, by, &mut to);
            let by_eye = by * pull_unit(lobe.eye, (eye - sight.point).length(), slopes.eye);
            gradient.points[k] += by_point - by_eye;
            gradient.eye += by_eye;
            gradient.power += by * slopes.power;
            own.normal += by * slopes.normal;
        });
        to.add(face as u32, own);
        gradient.facets = to.merged();
        gradient
    }

    /// The lamps whose visibility is found one by one: none where rays are distributed over all of them.
    fn lamp_by_lamp(&self) -> impl Iterator<Item = &Lamp> {
        self.lamps.iter().filter(|_| self.many.is_none())
    }

    /// Where rays are distributed over lamps, calls `each` with the numbers of each point of a triangle and of the lamp that a ray comes from, the
    /// lobe there, and the direction to the lamp times the solid angle of the ray.
    fn each_reflected(
        &self,
        facets: &[Facet],
        face: usize,
        points: &[DVec3],
        (eye, power): (DVec3, f64),
        each: &mut dyn FnMut(usize, usize, &Lobe, DVec3),
    ) {
        let Some(many) = &self.many else { return };
        let facet = &facets[face];
        for (k, &point) in points.iter().enumerate() {
            let lobe = Lobe::towards(eye, point, facet.normal, power);
            for Arrival { lamp, direction, solid_angle, .. } in
                many.at_point(&self.lamps, (face, facet), point, Some(&lobe))
            {
                each(k, lamp as usize, &lobe, solid_angle * direction);
            }
        }
    }

    /// Calls `each` with each point of a triangle, by its number, and each lamp that may be seen from there. One search for blockers serves
    /// all points. `reflected`: the eye and the power of the lobe that light is reflected in, if it is. Lamps are left out unless what is
    /// between them and the points is `wanted`.
    fn each_sight(
        &self,
        facets: &[Facet],
        face: usize,
        points: &[DVec3],
        reflected: Option<(DVec3, f64)>,
        wanted: &dyn Fn(&Between) -> bool,
        each: &mut dyn FnMut(usize, usize, &Sight, &mut Visible),
    ) {
        let geometry = self.geometry(facets);
        let visible = &mut Visible::default();
        let aims = |rays: &Sampling| rays.aims(&facets[face], |l| self.guides.open(face, l));
        let aims = self.sampling.as_ref().map(aims).unwrap_or_default();
        for (l, lamp) in self.lamp_by_lamp().enumerate() {
            let lamp = &geometry.place(lamp);
            if !geometry.faces(face, lamp) {
                continue;
            }
            let between = Between::points(geometry, self.sampling.as_ref(), face, points, (l, lamp));
            let between = Between { aim: aims.get(l).copied().unwrap_or(between.aim), ..between };
            if !wanted(&between) {
                continue;
            }
            for (k, &point) in points.iter().enumerate() {
                let lobe =
                    reflected.map(|(eye, power)| Lobe::towards(eye, point, facets[face].normal, power));
                each(k, l, &between.sight(point, lobe.as_ref()), visible);
            }
        }
    }

    /// Per lamp and outgoing bin, the mean over a triangle of ⟨n, Φ⟩ ⟨h, n⟩^p, sr, with Φ the vector irradiance per radiance of the lamp.
    /// `bins`: their directions, in the frame of the triangle. Empty for lamps of which nothing arrives.
    pub fn lobes(&self, facets: &[Facet], receiver: usize, bins: &[DVec3], power: f64) -> Vec<Vec<f64>> {
        let mut lobes = vec![Vec::new(); self.lamps.len()];
        let normal = facets[receiver].normal;
        for Arrival { lamp, direction, solid_angle, .. } in self.arrivals(facets, receiver) {
            let lobe = &mut lobes[lamp as usize];
            lobe.resize(bins.len(), 0.0);
            lobes::add(solid_angle * direction, normal, 1.0, bins, power, lobe);
        }
        self.each_sample(facets, receiver, &mut |l, sight, share, visible| {
            let phi = sight.vector_irradiance(visible);
            lobes[l].resize(bins.len(), 0.0);
            lobes::add(phi, sight.normal, share, bins, power, &mut lobes[l]);
        });
        lobes
    }

    /// The transpose of the derivative of [`Self::lobes`], from the derivative of a loss by each of them: by triangles, and by the power.
    pub fn pull_back_lobes(
        &self,
        facets: &[Facet],
        receiver: usize,
        bins: &[DVec3],
        power: f64,
        cotangent: impl Fn(usize, usize) -> f64,
    ) -> (Vec<(u32, FacetGradient)>, f64) {
        let mut to = Contributions::default();
        let mut by_power = 0.0;
        let Facet { corners, normal, .. } = facets[receiver];
        for Arrival { lamp, direction, solid_angle, .. } in self.arrivals(facets, receiver) {
            let by = |b| cotangent(lamp as usize, b);
            by_power += lobes::pull_back(solid_angle * direction, normal, bins, power, by).2;
        }
        self.each_sample(facets, receiver, &mut |l, sight, share, visible| {
            let phi = sight.vector_irradiance(visible);
            let (by_phi, by_normal, by_exponent) =
                lobes::pull_back(phi, sight.normal, bins, power, |b| share * cotangent(l, b));
            by_power += by_exponent;
            let (_, by_point, by_horizon) = sight.pull_back(visible, by_phi, &mut to);
            let normal = by_normal + by_horizon;
            let mut own = FacetGradient { normal, ..FacetGradient::default() };
            let weights = barycentric(corners, sight.normal, sight.point);
            for (corner, b) in own.corners.iter_mut().zip(weights.to_array()) {
                *corner += b * by_point;
            }
            to.add(receiver as u32, own);
        });
        (to.merged(), by_power)
    }

    /// What rays bring to a triangle, where they are distributed over lamps.
    fn arrivals(&self, facets: &[Facet], receiver: usize) -> Vec<Arrival> {
        let of = |many: &ManyLights| {
            many.at_triangle(&self.lamps, (receiver, &facets[receiver]), self.open.of(receiver))
        };
        self.many.as_ref().map(of).unwrap_or_default()
    }

    /// Calls `each` with each lamp, a point of a receiver that may see it, and the share of the receiver that the point stands for.
    fn each_sample(
        &self,
        facets: &[Facet],
        receiver: usize,
        each: &mut dyn FnMut(usize, &Sight, f64, &mut Visible),
    ) {
        let geometry = self.geometry(facets);
        let corners = facets[receiver].corners;
        let visible = &mut Visible::default();
        for (l, lamp) in self.lamp_by_lamp().enumerate().filter(|&(l, _)| self.factor(receiver, l) != 0.0) {
            let lamp = &geometry.place(lamp);
            let between = self.between(geometry, receiver, (l, lamp));
            for Sample { barycentric, weight } in self.samples(receiver, l) {
                each(l, &between.sight(at(corners, barycentric), None), weight, visible);
            }
        }
    }

    /// The points of a receiver at which the light of a lamp there is known.
    fn samples(&self, receiver: usize, lamp: usize) -> Vec<Sample> {
        let cuts = self.cuts.get(&[receiver, lamp]).cloned().unwrap_or_default();
        quadrature::samples(&cuts, self.open.of(receiver))
    }

    /// What stands between a receiver and a lamp.
    fn between<'a>(
        &'a self,
        geometry: Geometry<'a>,
        receiver: usize,
        lamp: (usize, &'a Placed<'a>),
    ) -> Between<'a> {
        Between::triangle(geometry, self.sampling.as_ref(), (receiver, self.open.of(receiver)), lamp).0
    }

    fn pull_back_to(&self, between: &Between, visible: &mut Visible, weight: f64, to: &mut Contributions) {
        let &Between { geometry, receiver, lamp: (l, _), .. } = between;
        let Facet { corners, normal, .. } = geometry.facets[receiver];
        let mut own = FacetGradient::default();
        for Sample { barycentric, weight: share } in self.samples(receiver, l) {
            let sight = between.sight(at(corners, barycentric), None);
            let (light, by_point, _) = sight.pull_back(visible, weight * share * normal, to);
            own.normal += weight * share * light;
            for (corner, b) in own.corners.iter_mut().zip(barycentric.to_array()) {
                *corner += b * by_point;
            }
        }
        to.add(receiver as u32, own);
    }
}

/// Half the mean irradiance per radiance of each lamp, sr, in a closed scene, of suns that of what faces them: errors are compared to
/// that where there is less light.
fn usual(facets: &[Facet], lamps: &[Lamp]) -> Vec<f64> {
    let all: f64 = facets.iter().map(|facet| facet.area).sum();
    let area = |lamp: &Lamp| lamp.triangles().iter().map(|&i| facets[i as usize].area).sum::<f64>();
    let mean = |lamp: &Lamp| lamp.sun().map_or_else(|| PI * area(lamp) / all, Disc::projected);
    lamps.iter().map(|lamp| 0.5 * mean(lamp)).collect()
}

fn radiance<'a>(lamps: &[Lamp], material: impl Fn(usize) -> &'a Material) -> Vec<DVec3> {
    let of = |lamp: &Lamp| match lamp {
        Lamp::Surface(surface) => material(surface.first()).emission.into(),
        Lamp::Sun(disc) => disc.radiance(),
    };
    lamps.iter().map(of).collect()
}

/// What stands between points of a triangle and a lamp.
struct Between<'a> {
    geometry: Geometry<'a>,
    receiver: usize,
    /// The lamp, with its number.
    lamp: (usize, &'a Placed<'a>),
    /// Polygons in between, unless rays count in their place.
    blockers: Vec<u32>,
    /// Rays from each point, unless `blockers` or `share` count in their place.
    sampling: Option<&'a Sampling>,
    /// Share of the lamp that the whole triangle sees, by rays.
    share: Share,
    /// Where rays from points go, and their number.
    aim: (Open, u32),
}

/// The light of a lamp on a triangle, how that is cut into cells for it, and from where it arrives by rays.
type Found = (Share, Cuts, Mask);

impl<'a> Between<'a> {
    /// What stands between a lamp and some points of a triangle.
    fn points(
        geometry: Geometry<'a>,
        sampling: Option<&'a Sampling>,
        receiver: usize,
        points: &[DVec3],
        lamp: (usize, &'a Placed<'a>),
    ) -> Self {
        let most = sampling.map(|rays| rays.few(lamp.0));
        let blockers = geometry.between(points, geometry.facets[receiver].normal, lamp.1, most);
        let sampling = sampling.filter(|_| blockers.is_none());
        let blockers = blockers.unwrap_or_default();
        Self { geometry, receiver, lamp, blockers, sampling, share: Share::ALL, aim: (Open::ALL, 0) }
    }

    /// What stands between a lamp and all of a triangle: one share counts everywhere. `parts`: the weights of the parts
    /// of that. With where rays from there arrive.
    fn triangle(
        geometry: Geometry<'a>,
        sampling: Option<&'a Sampling>,
        (receiver, parts): (usize, Option<&Parts>),
        lamp: (usize, &'a Placed<'a>),
    ) -> (Self, Mask) {
        let Facet { corners, normal, centroid, .. } = geometry.facets[receiver];
        let between = Self::points(geometry, sampling, receiver, &corners, lamp);
        let of = |rays: &Sampling| {
            let seen = geometry.seen_from(lamp.1, centroid);
            rays.of_triangle(receiver, (corners, parts), normal, (lamp.0, &seen))
        };
        let (share, mask) = between.sampling.map_or((Share::ALL, Mask::default()), of);
        (Self { share, sampling: None, ..between }, mask)
    }

    /// Whether the lamp, or a polygon in between, has a triangle that moves.
    fn moves(&self, moves: impl Fn(u32) -> bool) -> bool {
        let any = |triangles: &[u32]| triangles.iter().any(|&i| moves(i));
        let blockers = self.geometry.blockers;
        any(self.lamp.1.lamp.triangles())
            || self.blockers.iter().any(|&number| any(&blockers.polygon(number).triangles))
    }

    /// The sight of the lamp from a point, for light that falls on it, or with `lobe`, that is reflected
    /// there.
    fn sight(&self, point: DVec3, lobe: Option<&Lobe>) -> Sight<'_> {
        let &Self { geometry, receiver, lamp: (number, lamp), ref blockers, sampling, share, aim } = self;
        let normal = geometry.facets[receiver].normal;
        let lamp = geometry.seen_from(lamp, point);
        let of = |rays: &Sampling| rays.of_point(receiver, point, normal, (number, &lamp), lobe, aim);
        let share = sampling.map_or(share.value, of);
        Sight { geometry, point, normal, lamp, blockers, share }
    }

    /// How often the receiver is cut in any case. A shadow of a sun is sharp, and as large as what casts it, however far it falls: seven points may
    /// all be beside one.
    fn least_cuts(&self) -> u32 {
        if self.lamp.1.lamp.sun().is_none() || self.blockers.is_empty() {
            return 0;
        }
        let areas = self.blockers.iter().map(|&number| self.geometry.blockers.area(number));
        let smallest = areas.fold(f64::INFINITY, f64::min);
        let halvings = 0.5 * (self.geometry.facets[self.receiver].area / smallest).log2();
        (halvings.ceil() as u32).clamp(1, MOST_CUTS)
    }

    /// Standard error of what the triangle receives, as a share of that.
    fn relative_error(&self) -> f64 {
        if self.share.value > 0.0 { self.share.error / self.share.value } else { 0.0 }
    }
}

/// Derivatives of a loss of highlights.
#[derive(Clone, Debug, Default)]
pub struct HighlightGradient {
    /// Derivatives by triangle; that of the points themselves is not included.
    pub facets: Vec<(u32, FacetGradient)>,
    /// Derivative by each point.
    pub points: Vec<DVec3>,
    /// Derivative by the position of the eye.
    pub eye: DVec3,
    /// Derivative by the power.
    pub power: f64,
}

/// Receivers that an estimate of work looks at, about, and of how many at most one.
const PROBES: usize = 256;
const ONE_OF: usize = 7;

/// Cuts of a receiver in any case, at most.
const MOST_CUTS: u32 = 3;

/// Receivers whose derivatives are held in memory at a time.
const RECEIVERS: usize = 4096;

/// Receivers whose derivatives are added up before they are sent to other ranks.
const NEIGHBOURS: usize = 16;

/// Barycentric coordinates of a point of a triangle.
pub fn barycentric(corners: [DVec3; 3], normal: DVec3, point: DVec3) -> DVec3 {
    let [a, b, c] = corners.map(|corner| corner - point);
    let areas = [b.cross(c), c.cross(a), a.cross(b)].map(|double| double.dot(normal));
    DVec3::from(areas) / areas.iter().sum::<f64>()
}

/// The point with given barycentric coordinates.
pub fn at([a, b, c]: [DVec3; 3], barycentric: DVec3) -> DVec3 {
    a * barycentric.x + b * barycentric.y + c * barycentric.z
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_scene::{Material, Scene, SceneBuilder, Shape};
    use glam::DAffine3;
    use rand::{RngExt, SeedableRng};

    /// A jittered floor, three blockers, one of which crosses the plane of the lamp, and a lamp of eight triangles.
    fn scene() -> Scene {
        let lamp = Material { emission: [5.0; 3], ..Material::named("lamp") };
        let black = Material::named("black");
        let at = |x: f64, y: f64, z: f64| DAffine3::from_translation(DVec3::new(x, y, z));
        let down = DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0));
        let tilted = DAffine3::from_rotation_x(1.2) * DAffine3::from_rotation_y(0.4);
        let small = DAffine3::from_scale(DVec3::splat(0.4));
        let mut builder = SceneBuilder::new();
        builder
            .shape("floor", Shape::Quad { cells: 2 }, &black, at(0.0, 0.0, 0.0))
            .shape("low", Shape::Quad { cells: 1 }, &black, at(0.1, 0.4, 0.07) * small)
            .shape("high", Shape::Quad { cells: 1 }, &black, at(-0.2, 0.7, 0.1) * tilted * small)
            .shape("crossing", Shape::Quad { cells: 1 }, &black, at(0.3, 0.95, -0.1) * tilted * small)
            .shape("lamp", Shape::Quad { cells: 2 }, &lamp, at(0.05, 1.0, 0.0) * down * small);
        let mut scene = builder.finish("direct").expect("a scene");
        let mut random = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(7);
        let jitter = scene.vertices.len() - 9;
        for vertex in &mut scene.vertices[..jitter] {
            *vertex += DVec3::from_array(random.random::<[f64; 3]>()) * 0.03;
        }
        scene
    }

    pub fn facets(scene: &Scene) -> Vec<Facet> {
        (0..scene.triangles.len()).map(|i| Facet::new(scene.corners(i))).collect()
    }

    pub fn exact(scene: &Scene, facets: &[Facet], lamps: Vec<Lamp>) -> DirectLight {
        let ranks = Ranks::default();
        DirectLight::new(&ranks, facets, lamps, Visibility::Exact, Arc::default(), |i| scene.material(i))
            .expect("one rank")
    }

    fn weight(receiver: usize, _: usize) -> f64 {
        1.0 + (receiver as f64).sin()
    }

    fn loss(light: &DirectLight) -> f64 {
        (0..light.receivers).map(|receiver| weight(receiver, 0) * light.factor(receiver, 0)).sum()
    }

    /// A floor under a lamp, and a box and a screen between them, whose faces are cut into many triangles.
    fn fine_blockers(cells: u32) -> Scene {
        let lamp = Material { emission: [5.0; 3], ..Material::named("lamp") };
        let black = Material::named("black");
        let at = |x: f64, y: f64, z: f64| DAffine3::from_translation(DVec3::new(x, y, z));
        let turned = DAffine3::from_rotation_y(0.37) * DAffine3::from_rotation_x(0.14);
        let small = DAffine3::from_scale(DVec3::splat(0.4));
        let down = DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0));
        let mut builder = SceneBuilder::new();
        builder
            .shape("floor", Shape::Quad { cells: 2 }, &black, at(0.0, 0.0, 0.0))
            .shape("box", Shape::Box { cells }, &black, at(0.1, 0.4, 0.07) * turned * small)
            .shape("screen", Shape::Quad { cells }, &black, at(-0.3, 0.7, 0.0) * turned * small)
            .shape("lamp", Shape::Quad { cells: 2 }, &lamp, at(0.05, 1.0, 0.0) * down * small);
        builder.finish("fine blockers").expect("a scene")
    }

    /// Triangles that cross each other, every third of them a lamp: penumbras everywhere, so that receivers take hundreds of points each.
    fn soup() -> Scene {
        let [lamp, black] = [1.0, 0.0].map(|emission| Material {
            emission: [emission; 3],
            ..Material::named(format!("emits {emission}"))
        });
        let mut random = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(3);
        let mut builder = SceneBuilder::new();
        for k in 0..21 {
            let material = if k % 3 == 0 { &lamp } else { &black };
            let corners = (0..3).map(|_| DVec3::from_array(random.random::<[f64; 3]>())).collect();
            builder.mesh("soup", corners, vec![[0, 1, 2]], material, DAffine3::IDENTITY);
        }
        builder.finish("soup").expect("a scene")
    }

    /// What one receiver in seven takes tells what all do, whether light is smooth or not, and no more is done than is allowed.
    #[test]
    fn a_few_receivers_tell_the_work_of_all() {
        for (scene, least) in [(fine_blockers(6), 1.0), (soup(), 50.0)] {
            let facets = facets(&scene);
            let lamps = lamps(&scene, &facets, 1e-9);
            let work = |step| DirectLight::work(&facets, &lamps, step, f64::INFINITY);
            let all = work(1);
            let pairs = (facets.len() * lamps.len()) as f64;
            assert!(all >= least * pairs, "{} tests of each pair", all / pairs);
            let ratio = work(ONE_OF) / all;
            assert!((0.5..=2.0).contains(&ratio), "{ratio}");
            assert!(DirectLight::takes_at_most(&facets, &lamps, 2.0 * all));
            assert!(!DirectLight::takes_at_most(&facets, &lamps, 0.5 * all));
            // What is above the limit is where it ends: far from all of it.
            let most = 0.01 * all;
            let stopped = DirectLight::work(&facets, &lamps, 1, most);
            assert!(stopped > most && stopped < 0.5 * all, "{}", stopped / all);
        }
    }

    /// However fine a mesh, what it hides is the same; so are the polygons that it is cut with.
    #[test]
    fn the_mesh_of_a_blocker_does_not_matter() {
        let mut in_part = fine_blockers(1);
        for _ in 0..3 {
            // Every third triangle of the blockers, in three rounds: vertices in the middle of the edges of others.
            let chosen: Vec<u32> = (8..in_part.triangles.len() as u32 - 2).step_by(3).collect();
            in_part.split(&chosen);
        }
        let [coarse, fine, part] = [fine_blockers(1), fine_blockers(3), in_part].map(|scene| {
            let facets = facets(&scene);
            let light = exact(&scene, &facets, lamps(&scene, &facets, 1e-9));
            let factors: Vec<f64> = (0..8).map(|receiver| light.factor(receiver, 0)).collect();
            (light.blockers.count(), factors)
        });
        // Six faces and the screen; everything is above the floor and below the lamp.
        assert_eq!((coarse.0, fine.0, part.0), (7, 7, 7));
        assert!(coarse.1.iter().any(|&f| f > 0.01));
        for ((a, b), c) in coarse.1.iter().zip(&fine.1).zip(&part.1) {
            assert!((a - b).abs() <= 1e-9 && (a - c).abs() <= 1e-9, "{a} {b} {c}");
        }
    }

    /// A face with a hole is no convex polygon, but some.
    #[test]
    fn a_face_with_a_hole_is_cut_into_convex_polygons() {
        let quad = SceneBuilder::new()
            .shape("quad", Shape::Quad { cells: 5 }, &Material::named("black"), DAffine3::IDENTITY)
            .finish("quad")
            .expect("a scene");
        let mut facets = facets(&quad);
        // The two triangles in the middle of five by five cells.
        facets.retain(|f| (f.centroid - DVec3::new(0.5, 0.0, 0.5)).length() > 0.1);
        assert_eq!(facets.len(), 48);
        // Alone it stands between nothing.
        assert_eq!(Blockers::new(&facets).count(), 0);
        for side in [DVec3::Y, DVec3::NEG_Y] {
            facets.push(Facet::new(facets[0].corners.map(|corner| corner + side)));
        }
        let blockers = Blockers::new(&facets);
        assert!((4..=8).contains(&blockers.count()), "{}", blockers.count());
        let mut triangles: Vec<u32> = blockers.all().flat_map(|polygon| polygon.triangles.clone()).collect();
        triangles.sort_unstable();
        assert_eq!(triangles, (0..48).collect::<Vec<u32>>());
    }

    /// Light, where it is sampled, derivatives and light of moved vertices: of three ranks the same bits as of one.
    #[test]
    fn ranks_compute_the_light_of_one() {
        let scene = fine_blockers(3);
        let facets = facets(&scene);
        let lamps = lamps(&scene, &facets, 1e-9);
        for visibility in [Visibility::Exact, Visibility::Sampled] {
            let computed = |ranks: &Ranks| {
                let light =
                    DirectLight::new(ranks, &facets, lamps.clone(), visibility, Arc::default(), |i| {
                        scene.material(i)
                    })
                    .expect("light");
                let gradients = light.pull_back(&facets, weight, |_| true).expect("derivatives");
                let moved = light.moved(&facets).expect("light of moved vertices");
                (light.factors, light.cuts, gradients, moved.factors)
            };
            let alone = computed(&Ranks::default());
            assert!(alone.1.len() > 4 && alone.0.iter().flatten().all(|factor| factor.value.is_finite()));
            std::thread::scope(|scope| {
                for ranks in antirad_base::ranks::in_threads(3) {
                    let (alone, computed) = (&alone, &computed);
                    scope.spawn(move || assert!(computed(&ranks) == *alone, "{ranks:?}"));
                }
            });
        }
    }

    /// Central differences at fixed points, where blockers are triangles, and where they are polygons with vertices on their edges.
    #[test]
    fn derivatives_are_those_of_central_differences() {
        differences(&scene(), 1);
        // Every other vertex: corners, middles of edges, and centres.
        differences(&fine_blockers(2), 2);
    }

    fn differences(scene: &Scene, one_of: usize) {
        let facets = facets(scene);
        let lamps = lamps(scene, &facets, 1e-9);
        assert_eq!(lamps.len(), 1);
        let outline = lamps[0].surface().expect("a surface").outline.clone();
        assert_eq!((lamps[0].surface().expect("a surface").corners.len(), outline.len()), (4, 8));
        let light = exact(scene, &facets, lamps.clone());
        assert!(light.cuts.len() > 4);
        let gradients: Vec<[DVec3; 3]> = light
            .pull_back(&facets, weight, |_| true)
            .expect("one rank")
            .iter()
            .zip(&facets)
            .map(|(g, f)| g.to_corners(f))
            .collect();
        // What moves are all vertices of the outline, not only those that are corners now.
        let mut moving = light.clone();
        let Lamp::Surface(lamp) = &mut moving.lamps[0] else { panic!("a surface") };
        lamp.corners = outline;
        // Vertices move with all triangles that share them: a lamp stays one piece.
        let mut by_vertex = vec![DVec3::ZERO; scene.vertices.len()];
        for (triangle, gradient) in scene.triangles.iter().zip(&gradients) {
            triangle.vertices.iter().zip(gradient).for_each(|(&v, g)| by_vertex[v as usize] += *g);
        }
        let step = 1e-6;
        let largest = by_vertex.iter().map(|g| g.length()).fold(0.0, f64::max);
        let mut worst = 0.0_f64;
        for (vertex, gradient) in by_vertex.iter().enumerate().step_by(one_of) {
            let emits = vertex >= scene.vertices.len() - 9;
            for axis in 0..3 {
                // Out of its plane, the lamp would no longer be one polygon.
                if emits && axis == 1 {
                    continue;
                }
                let moved = |by: f64| {
                    let mut scene = scene.clone();
                    scene.vertices[vertex][axis] += by;
                    loss(&moving.moved(&self::facets(&scene)).expect("one rank"))
                };
                let difference = (moved(step) - moved(-step)) / (2.0 * step);
                let error = (difference - gradient[axis]).abs() / largest;
                worst = worst.max(error);
            }
        }
        println!("{worst:e} of {largest}");
        assert!(worst <= 1e-6, "{worst:e}");
    }
}

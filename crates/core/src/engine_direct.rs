//! The light that comes straight from lamps, in an engine: what it adds to irradiance, to what triangles send into U, and to what is
//! seen of them.

use crate::direct::{DirectLight, Lamp, Polygon, at, suns};
use crate::engine::Engine;
use crate::plan::{PADDING, Plan};
use antirad_base::ranks::RankError;
use antirad_scene::Scene;
use glam::DVec3;
use std::sync::Arc;

/// Direct light under the current materials.
pub struct Direct {
    /// Irradiance per unit of radiance of each lamp.
    pub light: Arc<DirectLight>,
    /// Irradiance of each triangle of the scene, W/m².
    pub irradiance: Vec<DVec3>,
    /// Specular lobes of glossy triangles, by ascending triangle; empty without lamps.
    pub lobes: Vec<Lobes>,
}

/// How a glossy triangle reflects lamps specularly.
#[derive(Clone)]
pub struct Lobes {
    /// The triangle of the scene.
    pub triangle: usize,
    power: f64,
    /// Per lamp and bin: [`DirectLight::lobes`].
    pub values: Vec<Vec<f64>>,
}

impl Direct {
    /// `known`: lobes that may be computed already.
    ///
    /// # Errors
    /// Fails if ranks can no longer work together.
    pub fn new(
        light: Arc<DirectLight>,
        scene: &Scene,
        plan: &Plan,
        known: &[Lobes],
    ) -> Result<Self, RankError> {
        let irradiance = light.irradiance(|i| scene.material(i));
        let lobes = if light.lamps().is_empty() { Vec::new() } else { lobes(&light, scene, plan, known)? };
        Ok(Self { light, irradiance, lobes })
    }

    /// What each triangle emits into U, W/(m² sr).
    pub fn emitted(&self, scene: &Scene) -> Vec<[f64; 3]> {
        self.light.emitted(|i| scene.material(i), &self.irradiance)
    }

    /// What glossy triangles reflect of it specularly: per glossy group, by slot, bin and channel, in units of `unit`.
    pub fn first_bounce(&self, scene: &Scene, plan: &Plan, unit: f64) -> Vec<Option<Vec<f64>>> {
        let radiance = self.light.radiance(|i| scene.material(i));
        let (bins, channels) = (plan.bins().count(), plan.channels() as usize);
        let of_slot = |slot: u32| {
            let mut values = vec![0.0; bins * channels];
            let triangle = plan.layout().order[slot as usize];
            let known = self.lobes.binary_search_by_key(&(triangle as usize), |lobes| lobes.triangle);
            if let (true, Ok(at)) = (triangle != PADDING, known) {
                let scale = DVec3::from(scene.material(triangle as usize).lobe_scale()) / unit;
                for (of_lamp, radiance) in self.lobes[at].values.iter().zip(&radiance) {
                    for (to, lobe) in values.chunks_mut(channels).zip(of_lamp) {
                        let reflected = *lobe * *radiance * scale;
                        to.iter_mut().zip(reflected.to_array()).for_each(|(to, by)| *to += by);
                    }
                }
            }
            values
        };
        let page = |group: &crate::plan::Group| {
            let glossy = group.class.glossy && !self.light.lamps().is_empty();
            glossy.then(|| plan.layout().slots_of(&group.tiles).flat_map(of_slot).collect())
        };
        plan.layout().groups.iter().map(page).collect()
    }
}

/// The lobes of all glossy triangles. Those in `known` are taken from there if the power is the same.
fn lobes(light: &DirectLight, scene: &Scene, plan: &Plan, known: &[Lobes]) -> Result<Vec<Lobes>, RankError> {
    let power = |triangle: usize| scene.material(triangle).power;
    let known = |triangle: usize| {
        let same = known.binary_search_by_key(&triangle, |lobes| lobes.triangle).ok();
        same.map(|at| &known[at]).filter(|lobes| lobes.power == power(triangle))
    };
    let glossy = plan.classes().iter().enumerate().filter(|(_, class)| class.glossy);
    let glossy: Vec<usize> = glossy.map(|(triangle, _)| triangle).collect();
    let new: Vec<usize> = glossy.iter().copied().filter(|&triangle| known(triangle).is_none()).collect();
    let of_new = |number: usize| {
        let triangle = new[number];
        light.lobes(plan.facets(), triangle, &plan.bins().centre, power(triangle))
    };
    let mut computed = light.ranks().map(new.len(), of_new)?.into_iter();
    let of = |triangle: usize| {
        let new = || Lobes { triangle, power: power(triangle), values: computed.next().unwrap_or_default() };
        known(triangle).cloned().unwrap_or_else(new)
    };
    Ok(glossy.into_iter().map(of).collect())
}

/// Lamps, and triangles of their own for those whose triangles no longer emit the same; and the suns of now.
pub(crate) fn lamps_of(scene: &Scene, lamps: &[Lamp]) -> Vec<Lamp> {
    let emission = |&i: &u32| scene.material(i as usize).emission;
    let uniform =
        |surface: &Polygon| surface.triangles.iter().all(|i| emission(i) == emission(&surface.triangles[0]));
    let split = |surface: &Polygon| match uniform(surface) {
        true => vec![Lamp::Surface(surface.clone())],
        false => surface.triangles.iter().map(|&i| Lamp::single(i)).collect(),
    };
    lamps.iter().filter_map(Lamp::surface).flat_map(split).chain(suns(scene)).collect()
}

impl Engine {
    /// Standard error of the irradiance that comes straight from lamps whose visibility is sampled: relative L2 norm, weighted by area. Zero
    /// where visibility is exact.
    #[doc(hidden)]
    pub fn sampling_error(&self) -> f64 {
        self.direct.light.standard_error(self.plan().facets(), |i| &self.materials[i])
    }

    /// The triangles of lamps whose fronts face a point, metres.
    pub(crate) fn lamp_triangles_facing(&self, point: DVec3) -> impl Iterator<Item = usize> + '_ {
        let triangles = self.direct.light.lamps().iter().flat_map(Lamp::triangles);
        triangles.map(|&i| i as usize).filter(move |&i| self.faces(i, point))
    }

    fn faces(&self, triangle: usize, point: DVec3) -> bool {
        let facet = &self.plan().facets()[triangle];
        (self.plan().placement().apply(point) - facet.centroid).dot(facet.normal) > 0.0
    }

    /// Glossy triangles that face a point, metres, and reflect lamps, with the points of each at which highlights are computed and the
    /// share of each point.
    pub(crate) fn highlighted(&self, point: DVec3) -> Vec<(usize, Vec<DVec3>, Vec<f64>)> {
        let lit = |lobes: &&Lobes| {
            let material = &self.materials[lobes.triangle];
            material.is_glossy() && self.faces(lobes.triangle, point)
        };
        let points = |lobes: &Lobes| {
            let corners = self.plan().facets()[lobes.triangle].corners;
            let samples = self.direct.light.whole_samples();
            let (at, shares) = samples.iter().map(|s| (at(corners, s.barycentric), s.weight)).unzip();
            (lobes.triangle, at, shares)
        };
        self.direct.lobes.iter().filter(lit).map(points).collect()
    }

    /// Mean radiance of the highlights of lamps on each triangle that has some, towards a point (metres), W/(m² sr).
    pub(crate) fn highlights(&self, point: DVec3) -> Result<Vec<(usize, DVec3)>, RankError> {
        let eye = self.plan().placement().apply(point);
        let (light, materials, facets) = (&self.direct.light, &self.materials, self.plan().facets());
        let radiance = light.radiance(|i| &materials[i]);
        let highlighted = self.highlighted(point);
        let mean = |number: usize| {
            let (triangle, points, shares) = &highlighted[number];
            let material = &materials[*triangle];
            let of_points = light.highlights(facets, *triangle, points, eye, material.power);
            let of_point = |(of_lamps, share): (&Vec<f64>, &f64)| {
                of_lamps.iter().zip(&radiance).map(|(&h, &l)| *share * h * l).sum::<DVec3>()
            };
            (
                *triangle,
                DVec3::from(material.lobe_scale())
                    * of_points.iter().zip(shares).map(of_point).sum::<DVec3>(),
            )
        };
        light.ranks().map(highlighted.len(), mean)
    }
}

//! E and K - J: emission, and what triangles make of incident light; transpose and derivative. Twin of crates/core/glsl/reflect*.comp.

use super::light::{DIFFUSE, INCIDENT, IRRADIANCE, Runs, SPECULAR};
use super::{Model, Outgoing, State};
use antirad_base::parallel;
use antirad_core::model::{Dual, DualVector, Scalar, Vector};
use antirad_scene::Material;
use glam::DVec3;
use std::f64::consts::PI;

/// E: emission as outgoing light.
pub fn emission(model: &Model) -> Outgoing {
    let diffuse = model.materials.iter().map(|m| DVec3::from(m.emission)).collect();
    Outgoing { diffuse, ..model.dark() }
}

impl Model {
    /// (K - J) H: outgoing light without emission. K makes diffuse radiance (δρ/π) Σ_b H(b), and per outgoing bin o of glossy triangles
    /// Σ_b σ N(p) ⟨h(b,o),n⟩^p H(b), W/(m² sr); J is the identity on the state.
    pub fn leave(&self, state: &State) -> Outgoing {
        let state = state.runs(self);
        Outgoing::of_runs(&self.of_triangles(|i| {
            let mut outgoing = self.unsent(self.classes[i]);
            let reflector = Reflector::of(&self.materials[i]);
            self.reflect(i, &reflector, |to, from, weight: DVec3| outgoing[to] += weight * state[i][from]);
            outgoing
        }))
    }

    /// Visits each entry of the run of a triangle's outgoing light with the entry of its incident light that is added to it, and the
    /// weight, RGB.
    fn reflect<V: Vector>(
        &self,
        triangle: usize,
        reflector: &Reflector<V>,
        mut visit: impl FnMut(usize, usize, V),
    ) {
        let (class, bins) = (self.classes[triangle], &self.bins);
        visit(DIFFUSE, IRRADIANCE, reflector.albedo * (reflector.diffuse / PI));
        if class.glossy {
            let scale = reflector.specular * reflector.normalization;
            for out in 0..bins.count() {
                for bin in 0..bins.count() {
                    let lobe = power(bins.half_cosine(bin, out), reflector.power) * bins.projected[bin];
                    visit(SPECULAR + out, INCIDENT + bin, scale * lobe);
                }
            }
        }
        if class.has_bins() {
            let antiradiance = SPECULAR + bins.count();
            (0..bins.count()).for_each(|bin| visit(antiradiance + bin, INCIDENT + bin, DVec3::ONE.into()));
        }
    }

    fn of_triangles<T: Send>(&self, of: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
        parallel::map(0..self.facets.len(), of)
    }
}

/// (K - J)ᵀ.
pub fn reflect_adjoint(model: &Model, cotangent: &Outgoing) -> State {
    let cotangent = cotangent.runs(model);
    State::of_runs(&model.of_triangles(|i| {
        let mut importance = model.unlit(model.classes[i]);
        let reflector = Reflector::of(&model.materials[i]);
        model.reflect(i, &reflector, |to, from, weight: DVec3| importance[from] += weight * cotangent[i][to]);
        importance
    }))
}

/// Derivative of a loss with respect to the [`Material`] of one triangle, as if it had a material of its own. RGB where the material
/// has RGB.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MaterialGradient {
    /// Derivative with respect to L_e, per W/(m² sr).
    pub emission: DVec3,
    /// Derivative with respect to δ.
    pub diffuse: f64,
    /// Derivative with respect to ρ.
    pub albedo: DVec3,
    /// Derivative with respect to σ; zero for triangles that are not glossy, which have no bins for it.
    pub specular: DVec3,
    /// Derivative with respect to p; zero for triangles that are not glossy.
    pub power: f64,
}

/// The gradient of μ·(E + K H) with respect to the material of every triangle, H (`state`) and μ (`cotangent`) held
/// fixed.
pub fn reflect_derivative(model: &Model, state: &State, cotangent: &Outgoing) -> Vec<MaterialGradient> {
    let (state, cotangent): (Runs, Runs) = (state.runs(model), cotangent.runs(model));
    model.of_triangles(|i| {
        let mut sum = Dual::from(0.0);
        model.reflect(i, &Reflector::variable(&model.materials[i]), |to, from, weight| {
            sum = sum + weight.dot((cotangent[i][to] * state[i][from]).into());
        });
        let rgb = |first: usize| DVec3::from_slice(&sum.slopes[first..]);
        let [diffuse, power] = [DELTA, POWER].map(|number| sum.slopes[number]);
        let emission = cotangent[i][DIFFUSE];
        MaterialGradient { emission, diffuse, albedo: rgb(ALBEDO), specular: rgb(SIGMA), power }
    })
}

/// What of a material matters to K.
struct Reflector<V: Vector> {
    diffuse: V::Scalar,
    albedo: V,
    specular: V,
    power: V::Scalar,
    /// N(p).
    normalization: V::Scalar,
}

/// The numbers of a reflector by which is derived.
const ALBEDO: usize = 0;
const SIGMA: usize = 3;
const DELTA: usize = 6;
const POWER: usize = 7;
const NUMBERS: usize = 8;

impl Reflector<DVec3> {
    fn of(material: &Material) -> Self {
        Self {
            diffuse: material.diffuse,
            albedo: material.albedo.into(),
            specular: material.specular.into(),
            power: material.power,
            normalization: material.specular_normalization(),
        }
    }
}

impl Reflector<DualVector<NUMBERS>> {
    fn variable(material: &Material) -> Self {
        let (value, slope) =
            (material.specular_normalization(), material.specular_normalization_derivative());
        let power = Dual::variable(material.power, POWER);
        Self {
            diffuse: Dual::variable(material.diffuse, DELTA),
            albedo: DualVector::variable(material.albedo.into(), ALBEDO),
            specular: DualVector::variable(material.specular.into(), SIGMA),
            power,
            normalization: power.chain(value, slope),
        }
    }
}

/// x^p. Its slope x^p ln x tends to zero with x for every p > 0, and counts as zero there for p = 0 too.
fn power<S: Scalar>(x: f64, p: S) -> S {
    let value = x.powf(p.value());
    p.chain(value, if x > 0.0 { x.ln() * value } else { 0.0 })
}

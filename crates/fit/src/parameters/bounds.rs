//! Bounds within which every vector of unknowns is a valid scene.

use super::super::limit::{LIMIT, largest_lobe, lobe, unlimited};
use super::super::motion::Part;
use super::{Fit, ParameterError, Parameters, What, to_unknown};
use antirad_render::render::Quantity;
use antirad_scene::Material;

/// Default upper bound of the diffuse albedo: a closed room of it still converges in a few hundred passes.
const MAX_ALBEDO: f64 = 0.99;
/// Default upper bound of the power: sharper lobes are finer than any bins.
const MAX_POWER: f64 = 1e4;
/// Default bounds of rotation vectors, degrees: a mesh may turn anyhow, while a camera is known rather well.
const MAX_ROTATION: f64 = 180.0;
const MAX_ROTATION_OF_CAMERAS: f64 = 5.0;
/// Default bounds of factors of size, and of distances of cameras that move together.
const MAX_SCALE: f64 = 10.0;
const MAX_SCALE_OF_CAMERAS: f64 = 2.0;

impl Parameters {
    pub(super) fn set_bounds(&mut self, fit: usize) -> Result<(), ParameterError> {
        let what = self.fits[fit].clone();
        let refuse = |message: String| ParameterError { fit, message };
        let word = what.quantity.word();
        let n = self.start.len();
        self.bounds.lower.resize(n, f64::NEG_INFINITY);
        self.bounds.upper.resize(n, f64::INFINITY);
        for index in 0..self.blocks.len() {
            let block = self.blocks[index].clone();
            if block.fit != fit {
                continue;
            }
            match &block.what {
                What::Material { quantity, materials, .. } => {
                    let natural = self.natural_upper(*quantity, materials);
                    for channel in 0..quantity.channels() {
                        let lower = what.lower.map_or(0.0, |l| l[channel]);
                        let upper = what.upper.map_or(natural[channel], |u| u[channel].min(natural[channel]));
                        let requested = what.upper.map_or(f64::INFINITY, |u| u[channel]);
                        let ordered = lower >= 0.0 && lower <= requested;
                        if !ordered {
                            return Err(refuse(format!(
                                "{word}: bounds {lower} to {requested}; they must be 0 or more, the lower one first"
                            )));
                        }
                        if lower > upper {
                            return Err(refuse(format!(
                                "{word} of \"{}\" must lie above {lower} and, for its total albedo to stay below 1, \
                                 below {upper:.4}; lower the other parts of the material, or fit them too",
                                block.name
                            )));
                        }
                        let at = block.first + channel;
                        self.bounds.lower[at] = to_unknown(*quantity, lower, block.scale);
                        self.bounds.upper[at] = to_unknown(*quantity, upper, block.scale);
                        if *quantity == Quantity::Specular {
                            self.start[at] = self.unlimited_start(materials, channel);
                        }
                    }
                }
                What::Motion { free, .. } | What::Camera { free, .. } => {
                    let [usual_angle, usual_factor] = match what.quantity {
                        Quantity::Camera => [MAX_ROTATION_OF_CAMERAS, MAX_SCALE_OF_CAMERAS],
                        _ => [MAX_ROTATION, MAX_SCALE],
                    };
                    let mut put = |at: usize, unit: f64, lower: f64, upper: f64| {
                        let at = block.first + at;
                        (self.bounds.lower[at], self.bounds.upper[at]) = (lower / unit, upper / unit);
                    };
                    let (lower, upper) = displacement(&what).map_err(refuse)?;
                    let angle = largest_rotation(&what, usual_angle).map_err(refuse)?.to_radians();
                    let factor = largest_factor(&what, usual_factor).map_err(refuse)?.ln();
                    let [translation, rotation, scale] = free.parts();
                    for axis in 0..3 {
                        if let Some(Part { first, unit }) = translation {
                            put(first + axis, unit, lower[axis], upper[axis]);
                        }
                        if let Some(Part { first, unit }) = rotation {
                            put(first + axis, unit, -angle, angle);
                        }
                    }
                    if let Some(Part { first, unit }) = scale {
                        put(first, unit, -factor, factor);
                    }
                }
                What::Texture { .. } => {
                    for at in 0..block.unknowns() {
                        let lower = what.lower.map_or(0.0, |l| l[at % 3]);
                        let upper = what.upper.map_or(MAX_ALBEDO, |u| u[at % 3].min(MAX_ALBEDO));
                        if !(lower >= 0.0 && lower <= upper) {
                            return Err(refuse(format!(
                                "{word}: bounds {lower} to {upper}; they must be 0 or more, the lower one first"
                            )));
                        }
                        self.bounds.lower[block.first + at] = lower;
                        self.bounds.upper[block.first + at] = upper;
                    }
                }
                What::Vertex { .. } => {
                    let (lower, upper) = displacement(&what).map_err(refuse)?;
                    for axis in 0..3 {
                        self.bounds.lower[block.first + axis] = lower[axis] / block.scale;
                        self.bounds.upper[block.first + axis] = upper[axis] / block.scale;
                    }
                }
            }
        }
        Ok(())
    }

    /// The largest values that are valid for all of the given materials, whatever their other fitted quantities are.
    fn natural_upper(&self, quantity: Quantity, materials: &[u32]) -> [f64; 3] {
        let mut upper = [f64::INFINITY; 3];
        for &m in materials {
            let material = &self.base.materials[m as usize];
            let limited = self.limited[m as usize];
            let fitted_power = self.fit_of(Quantity::Power, m);
            let powers = fitted_power.map_or([material.power; 2], |fit| {
                let end = |of: Option<[f64; 3]>, usual: f64| of.map_or(usual, |v| v[0]).clamp(0.0, MAX_POWER);
                [end(fit.lower, 0.0), end(fit.upper, MAX_POWER)]
            });
            // A fixed σ reduces the budget; a fitted one gets the remainder.
            let lobe = if limited || !material.is_glossy() {
                0.0
            } else {
                largest_lobe(powers, material.normalization)
            };
            let here = [0, 1, 2].map(|c| match quantity {
                Quantity::Emission | Quantity::Position | Quantity::Camera => f64::INFINITY,
                Quantity::Albedo => {
                    let budget = MAX_ALBEDO.min(LIMIT - material.specular[c] * lobe);
                    (budget / material.diffuse).min(MAX_ALBEDO)
                }
                Quantity::Diffuse => {
                    let budget =
                        |c: usize| MAX_ALBEDO.min(LIMIT - material.specular[c] * lobe) / material.albedo[c];
                    (0..3).map(budget).fold(f64::INFINITY, f64::min)
                }
                Quantity::Specular => {
                    // Beyond this the soft limit saturates.
                    let smallest = powers.map(|p| self::lobe(p, material.normalization).0);
                    2.0 * LIMIT / smallest[0].min(smallest[1])
                }
                Quantity::Power if limited => MAX_POWER,
                Quantity::Power => {
                    let budget = (0..3).map(|c| {
                        let albedo = match self.fit_of(Quantity::Albedo, m) {
                            Some(fit) => fit.upper.map_or(MAX_ALBEDO, |u| u[c]).min(MAX_ALBEDO),
                            None => material.albedo[c],
                        };
                        (LIMIT - material.diffuse * albedo.min(material.albedo[c])) / material.specular[c]
                    });
                    let budget = budget.fold(f64::INFINITY, f64::min);
                    largest_power(budget, material)
                }
            });
            upper = [0, 1, 2].map(|c| upper[c].min(here[c]));
        }
        upper
    }

    /// The [`Fit`] of a quantity that a material takes part in.
    fn fit_of(&self, quantity: Quantity, material: u32) -> Option<&Fit> {
        self.fit_of.get(&(quantity, material)).map(|&fit| &self.fits[fit])
    }

    fn unlimited_start(&self, materials: &[u32], channel: usize) -> f64 {
        let of = |&m: &u32| {
            let material = &self.base.materials[m as usize];
            let lobe = lobe(material.power, material.normalization).0;
            unlimited(material.specular[channel], lobe, material.diffuse_albedo()[channel])
        };
        // Materials that share a value share the start: the smallest decides.
        materials.iter().map(of).fold(f64::INFINITY, f64::min)
    }
}

/// The bound on the components of rotation vectors, degrees.
fn largest_rotation(fit: &Fit, usual: f64) -> Result<f64, String> {
    let angle = fit.max_rotation_degrees.unwrap_or(usual);
    match angle > 0.0 && angle <= MAX_ROTATION {
        true => Ok(angle),
        false => Err(format!("max_rotation_degrees is {angle}; it must lie in 0 to {MAX_ROTATION}")),
    }
}

/// The bound on factors.
fn largest_factor(fit: &Fit, usual: f64) -> Result<f64, String> {
    let factor = fit.max_scale.unwrap_or(usual);
    match factor >= 1.0 && factor.is_finite() {
        true => Ok(factor),
        false => Err(format!("max_scale is {factor}; it must be 1 or more, and finite")),
    }
}

fn displacement(fit: &Fit) -> Result<([f64; 3], [f64; 3]), String> {
    let (lower, upper) =
        (fit.lower.unwrap_or([f64::NEG_INFINITY; 3]), fit.upper.unwrap_or([f64::INFINITY; 3]));
    let ordered = |axis: &usize| lower[*axis] <= upper[*axis];
    match (0..3).find(|axis| !ordered(axis)) {
        Some(axis) => {
            let word = fit.quantity.word();
            Err(format!("{word}: bounds {} to {}; the lower one comes first", lower[axis], upper[axis]))
        }
        None => Ok((lower, upper)),
    }
}

/// The largest power whose lobe reflects at most `budget` for σ = 1, by bisection, since ℓ increases with p.
fn largest_power(budget: f64, material: &Material) -> f64 {
    let fits = |power: f64| largest_lobe([power; 2], material.normalization) <= budget;
    if !material.is_glossy() || fits(MAX_POWER) {
        return MAX_POWER;
    }
    let (mut low, mut high) = (0.0, MAX_POWER.ln_1p());
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if fits(f64::exp_m1(middle)) { low = middle } else { high = middle }
    }
    f64::exp_m1(low)
}

//! What is fitted: the way from a vector of unknowns to a scene, and of derivatives back.
//!
//! Unknowns are values divided by a scale that is typical of their kind, so that a change of 1 means about as much for
//! each of them; a power p is the unknown ln(1 + p), a factor of size its logarithm. Whatever the unknowns are within
//! [`Parameters::bounds`], the materials are possible ones: emission, δ, ρ, σ and p have boxes, and σ passes through the
//! soft limit of [`limit`](super::limit).

use super::gradient::{Quantity, SceneGradient};
use super::limit::{LIMIT, largest_lobe, limit, lobe, unlimited};
use super::motion::Motion;
use super::optimiser::Bounds;
use super::selection::{self, Selected};
use crate::plan::Wanted;
use crate::scene::{Material, Scene};
use glam::DVec3;
use serde::Serialize;
use std::collections::HashMap;

/// What shares one value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Per {
    #[default]
    Material,
    Mesh,
    Triangle,
}

/// How positions may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MotionKind {
    /// Every vertex for itself; vertices at the same place move as one.
    Vertices,
    Translation,
    /// Translation and rotation.
    Rigid,
    /// A factor about the centre of the mesh's bounding box.
    Scale,
    /// Translation, rotation and scale.
    Similarity,
}

impl MotionKind {
    fn parts(self) -> [bool; 3] {
        match self {
            Self::Vertices => [false; 3],
            Self::Translation => [true, false, false],
            Self::Rigid => [true, true, false],
            Self::Scale => [false, false, true],
            Self::Similarity => [true; 3],
        }
    }
}

/// One thing to fit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fit {
    pub quantity: Quantity,
    /// Names of materials and meshes: what has both is fitted. `None`: all.
    pub materials: Option<Vec<String>>,
    pub meshes: Option<Vec<String>>,
    pub per: Per,
    pub motion: MotionKind,
    /// The meshes move as one body, rather than each for itself.
    pub together: bool,
    /// In the unit of the quantity; of a position, the way from where it stands in the scene, metres.
    pub lower: Option<[f64; 3]>,
    pub upper: Option<[f64; 3]>,
    /// Where to start; `None`: what the scene has.
    pub initial: Option<[f64; 3]>,
    /// Largest component of a rotation vector, degrees.
    pub max_rotation_degrees: Option<f64>,
    /// Largest factor of size, and largest to divide it by.
    pub max_scale: Option<f64>,
}

impl Fit {
    /// A quantity of the whole scene, per material; positions as rigid motions of each mesh.
    pub fn new(quantity: Quantity) -> Self {
        Self {
            quantity,
            materials: None,
            meshes: None,
            per: Per::default(),
            motion: MotionKind::Rigid,
            together: false,
            lower: None,
            upper: None,
            initial: None,
            max_rotation_degrees: None,
            max_scale: None,
        }
    }
}

/// Something cannot be fitted as asked.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct ParameterError {
    /// Index of the [`Fit`] to blame.
    pub fit: usize,
    pub message: String,
}

/// Some unknowns that belong together.
#[derive(Clone, Debug)]
struct Block {
    fit: usize,
    /// Material, mesh or triangle.
    name: String,
    /// Index of the first unknown.
    first: usize,
    /// Value per unit of the unknowns.
    scale: f64,
    what: What,
}

#[derive(Clone, Debug)]
enum What {
    /// Materials of the split scene, and triangles.
    Material { quantity: Quantity, materials: Vec<u32>, triangles: Vec<u32> },
    /// Vertices that move, and which of translation, rotation, scale are unknown.
    Motion { vertices: Vec<u32>, centre: DVec3, parts: [bool; 3] },
    /// Vertices at one place.
    Vertex { vertices: Vec<u32> },
}

/// RGB derivatives, by [`Quantity`]; `None` where it is not fitted.
type ByQuantity = [Option<[f64; 3]>; 6];

impl Block {
    fn unknowns(&self) -> usize {
        match &self.what {
            What::Material { quantity, .. } => quantity.channels(),
            What::Motion { parts: [translation, rotation, scale], .. } => {
                3 * usize::from(*translation) + 3 * usize::from(*rotation) + usize::from(*scale)
            }
            What::Vertex { .. } => 3,
        }
    }
}

/// A value that was fitted, for people and for JSON.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Recovered {
    pub quantity: &'static str,
    /// Material, mesh, or triangle by its number.
    pub of: String,
    pub unit: &'static str,
    pub value: Vec<f64>,
    pub initial: Vec<f64>,
    /// Channels that stand on a bound.
    pub at_bound: Vec<bool>,
}

/// The way between unknowns and scene. See the module.
#[derive(Clone, Debug)]
pub struct Parameters {
    fits: Vec<Fit>,
    /// The scene with a material for each part that is fitted alone; its own values are the starting point.
    base: Scene,
    blocks: Vec<Block>,
    bounds: Bounds,
    start: Vec<f64>,
    /// Materials whose σ is fitted, and so limited.
    limited: Vec<bool>,
    /// Which [`Fit`] a quantity of a material takes part in.
    fit_of: HashMap<(Quantity, u32), usize>,
    wanted: Wanted,
}

/// The largest diffuse albedo if nothing else is asked for: a closed room of it still settles in some hundred passes.
const MAX_ALBEDO: f64 = 0.99;
/// The largest power if nothing else is asked for: sharper lobes are finer than any bins.
const MAX_POWER: f64 = 1e4;
/// What the scene's check lets through.
const CHECKED_POWER: f64 = 1e5;

impl Parameters {
    /// `brightness`: a typical radiance of lamps, W/(m² sr), the scale of emissions.
    pub fn new(scene: &Scene, fits: &[Fit], brightness: f64) -> Result<Self, ParameterError> {
        let selected: Vec<Selected> = fits
            .iter()
            .enumerate()
            .map(|(fit, what)| {
                selection::select(scene, what).map_err(|message| ParameterError { fit, message })
            })
            .collect::<Result<_, _>>()?;
        selection::check_overlaps(scene, fits, &selected)?;
        let mut base = scene.clone();
        base.split_materials(&selection::labels(scene, fits, &selected));

        let mut parameters = Self {
            fits: fits.to_vec(),
            limited: vec![false; base.materials.len()],
            base,
            blocks: Vec::new(),
            bounds: Bounds::free(0),
            start: Vec::new(),
            fit_of: HashMap::new(),
            wanted: Wanted::NOTHING,
        };
        for (fit, selected) in selected.iter().enumerate() {
            parameters.add(fit, selected, brightness.max(f64::MIN_POSITIVE));
        }
        for (fit, what) in fits.iter().enumerate() {
            parameters.set_initial(fit, what)?;
        }
        for fit in 0..fits.len() {
            parameters.set_bounds(fit)?;
        }
        parameters.bounds.project(&mut parameters.start);
        Ok(parameters)
    }

    fn add(&mut self, fit: usize, selected: &Selected, brightness: f64) {
        let quantity = self.fits[fit].quantity;
        let w = &mut self.wanted;
        *match quantity {
            Quantity::Emission => &mut w.emission,
            Quantity::Diffuse => &mut w.diffuse,
            Quantity::Albedo => &mut w.albedo,
            Quantity::Specular => &mut w.specular,
            Quantity::Power => &mut w.power,
            Quantity::Position => &mut w.positions,
        } = true;
        for (name, members) in &selected.groups {
            let (scale, what) = if quantity == Quantity::Position {
                let place = |v: &u32| self.base.vertices[*v as usize];
                let (low, high) = members
                    .iter()
                    .map(place)
                    .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
                match self.fits[fit].motion {
                    MotionKind::Vertices => (selected.edge, What::Vertex { vertices: members.clone() }),
                    motion => {
                        let size = (high - low).length();
                        // A rotation by 1 rad moves the end of the mesh by half its size.
                        let scale = if size > 0.0 { size / 2.0 } else { 1.0 };
                        let (centre, parts) = (low.midpoint(high), motion.parts());
                        (scale, What::Motion { vertices: members.clone(), centre, parts })
                    }
                }
            } else {
                let mut materials: Vec<u32> =
                    members.iter().map(|&t| self.base.triangles[t as usize].material).collect();
                materials.sort_unstable();
                materials.dedup();
                materials.iter().for_each(|&m| {
                    self.fit_of.insert((quantity, m), fit);
                });
                if quantity == Quantity::Specular {
                    materials.iter().for_each(|&m| self.limited[m as usize] = true);
                }
                let scale = if quantity == Quantity::Emission { brightness } else { 1.0 };
                (scale, What::Material { quantity, materials, triangles: members.clone() })
            };
            let block = Block { fit, name: name.clone(), first: self.start.len(), scale, what };
            self.start.resize(self.start.len() + block.unknowns(), 0.0);
            self.blocks.push(block);
        }
    }

    /// Puts initial values into the base scene and makes the unknowns of them.
    fn set_initial(&mut self, fit: usize, what: &Fit) -> Result<(), ParameterError> {
        let refuse = |message: String| Err(ParameterError { fit, message });
        if let Some(initial) = what.initial {
            let word = what.quantity.word();
            if what.quantity != Quantity::Position && initial.iter().any(|v| !(*v >= 0.0 && v.is_finite())) {
                return refuse(format!("initial {word} is {initial:?}; it must be finite and 0 or more"));
            }
            if what.quantity == Quantity::Position && !what.motion.parts()[0] {
                return refuse(String::from("only a motion with a translation has an `initial`, in metres"));
            }
        }
        // By value: the blocks are written to below.
        for block in self.blocks.clone().iter().filter(|block| block.fit == fit) {
            let first = block.first;
            match &block.what {
                What::Material { quantity, materials, .. } => {
                    let value = what.initial.unwrap_or_else(|| {
                        // The mean, where materials differ that shall be alike.
                        let sum: DVec3 = materials
                            .iter()
                            .map(|&m| DVec3::from(get(&self.base.materials[m as usize], *quantity)))
                            .sum();
                        (sum / materials.len() as f64).into()
                    });
                    for &m in materials {
                        set(&mut self.base.materials[m as usize], *quantity, value);
                    }
                    for (channel, &value) in value.iter().enumerate().take(quantity.channels()) {
                        self.start[first + channel] = to_unknown(*quantity, value, block.scale);
                    }
                }
                What::Motion { parts: [true, ..], .. } => {
                    let initial = what.initial.unwrap_or_default();
                    for (axis, way) in initial.iter().enumerate() {
                        self.start[first + axis] = way / block.scale;
                    }
                }
                What::Motion { .. } | What::Vertex { .. } => {}
            }
        }
        Ok(())
    }

    fn set_bounds(&mut self, fit: usize) -> Result<(), ParameterError> {
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
                        let asked = what.upper.map_or(f64::INFINITY, |u| u[channel]);
                        let ordered = lower >= 0.0 && lower <= asked;
                        if !ordered {
                            return Err(refuse(format!(
                                "{word}: bounds {lower} to {asked}; they must be 0 or more, the lower one first"
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
                What::Motion { parts, .. } => {
                    let mut at = block.first;
                    let mut put = |bounds: &mut Bounds, lower: f64, upper: f64| {
                        (bounds.lower[at], bounds.upper[at]) = (lower, upper);
                        at += 1;
                    };
                    let (lower, upper) = displacement(&what).map_err(refuse)?;
                    for axis in 0..if parts[0] { 3 } else { 0 } {
                        put(&mut self.bounds, lower[axis] / block.scale, upper[axis] / block.scale);
                    }
                    let angle = what.max_rotation_degrees.unwrap_or(180.0);
                    if !(angle > 0.0 && angle <= 180.0) {
                        return Err(refuse(format!(
                            "max_rotation_degrees is {angle}; it must lie in 0 to 180"
                        )));
                    }
                    for _ in 0..if parts[1] { 3 } else { 0 } {
                        put(&mut self.bounds, -angle.to_radians(), angle.to_radians());
                    }
                    let factor = what.max_scale.unwrap_or(10.0);
                    if !(factor >= 1.0 && factor.is_finite()) {
                        return Err(refuse(format!(
                            "max_scale is {factor}; it must be 1 or more, and finite"
                        )));
                    }
                    if parts[2] {
                        put(&mut self.bounds, -factor.ln(), factor.ln());
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

    /// The largest values that are possible for all of some materials, whatever else is fitted of them takes.
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
            // What a fixed σ takes away; a fitted one takes what is left.
            let lobe = if limited || !material.is_glossy() {
                0.0
            } else {
                largest_lobe(powers, material.normalization)
            };
            let here = [0, 1, 2].map(|c| match quantity {
                Quantity::Emission | Quantity::Position => f64::INFINITY,
                Quantity::Albedo => {
                    let room = MAX_ALBEDO.min(LIMIT - material.specular[c] * lobe);
                    (room / material.diffuse).min(MAX_ALBEDO)
                }
                Quantity::Diffuse => {
                    let room =
                        |c: usize| MAX_ALBEDO.min(LIMIT - material.specular[c] * lobe) / material.albedo[c];
                    (0..3).map(room).fold(f64::INFINITY, f64::min)
                }
                Quantity::Specular => {
                    // Beyond this the soft limit lets nothing more through.
                    let smallest = powers.map(|p| self::lobe(p, material.normalization).0);
                    2.0 * LIMIT / smallest[0].min(smallest[1])
                }
                Quantity::Power if limited => MAX_POWER,
                Quantity::Power => {
                    let room = (0..3).map(|c| {
                        let albedo = match self.fit_of(Quantity::Albedo, m) {
                            Some(fit) => fit.upper.map_or(MAX_ALBEDO, |u| u[c]).min(MAX_ALBEDO),
                            None => material.albedo[c],
                        };
                        (LIMIT - material.diffuse * albedo.min(material.albedo[c])) / material.specular[c]
                    });
                    let room = room.fold(f64::INFINITY, f64::min);
                    largest_power(room, material)
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
        // Materials that shall be alike start alike: the one with the least room decides.
        materials.iter().map(of).fold(f64::INFINITY, f64::min)
    }

    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.start.len()
    }

    pub fn is_empty(&self) -> bool {
        self.start.is_empty()
    }

    /// Within these, every vector of unknowns is a possible scene.
    pub fn bounds(&self) -> &Bounds {
        &self.bounds
    }

    /// The unknowns of the initial values.
    pub fn start(&self) -> &[f64] {
        &self.start
    }

    /// Which derivatives [`Self::pull_back`] needs.
    pub fn wanted(&self) -> Wanted {
        self.wanted
    }

    /// The scene with initial values, each part that is fitted alone with a material of its own.
    pub fn base(&self) -> &Scene {
        &self.base
    }

    /// True if nothing but emission is fitted: then pictures are linear in the unknowns.
    pub fn is_linear(&self) -> bool {
        self.fits.iter().all(|fit| fit.quantity == Quantity::Emission)
    }

    /// The scene of some unknowns.
    pub fn scene(&self, x: &[f64]) -> Scene {
        let mut scene = self.base.clone();
        self.set_materials(x, &mut scene.materials, true);
        let mut moved = false;
        for block in &self.blocks {
            match &block.what {
                What::Material { .. } => {}
                What::Motion { vertices, .. } => {
                    let motion = self.motion(block, x);
                    let before = vertices.iter().map(|&v| self.base.vertices[v as usize]);
                    for (&v, place) in vertices.iter().zip(motion.apply(before)) {
                        scene.vertices[v as usize] = place;
                    }
                    moved = true;
                }
                What::Vertex { vertices } => {
                    let way = block.scale * DVec3::from_slice(&x[block.first..]);
                    for &v in vertices {
                        scene.vertices[v as usize] = self.base.vertices[v as usize] + way;
                    }
                    moved = true;
                }
            }
        }
        if moved {
            scene.update_degenerate();
        }
        scene
    }

    /// The scene whose only light is that of the fitted emissions, which may be negative: the part of
    /// [`Self::scene`] that is linear in the unknowns, if [`Self::is_linear`].
    pub fn linear_scene(&self, x: &[f64]) -> Scene {
        let mut scene = self.base.clone();
        scene.materials.iter_mut().for_each(|m| m.emission = [0.0; 3]);
        self.set_materials(x, &mut scene.materials, true);
        scene
    }

    /// A scene that needs as much of a solver as any that the unknowns can describe: three channels where colours are
    /// fitted, specular reflection where σ is.
    pub fn planning_scene(&self) -> Scene {
        let mut scene = self.base.clone();
        for block in &self.blocks {
            let What::Material { quantity, materials, .. } = &block.what else { continue };
            for &m in materials {
                let material = &mut scene.materials[m as usize];
                match quantity {
                    Quantity::Specular => {
                        material.specular = material.specular.map(|s| s.max(1e-6));
                        material.specular[1] *= 1.5;
                    }
                    Quantity::Albedo => material.albedo[1] = 0.9 * material.albedo[1] + 1e-6,
                    Quantity::Emission => material.emission[1] = 0.9 * material.emission[1] + 1e-6,
                    Quantity::Diffuse | Quantity::Power | Quantity::Position => {}
                }
            }
        }
        scene
    }

    fn set_materials(&self, x: &[f64], materials: &mut [Material], limit_specular: bool) {
        for block in &self.blocks {
            if let What::Material { quantity, materials: of, .. } = &block.what {
                let mut value = [0.0; 3];
                for (channel, value) in value.iter_mut().enumerate().take(quantity.channels()) {
                    *value = from_unknown(*quantity, x[block.first + channel], block.scale);
                }
                of.iter().for_each(|&m| set(&mut materials[m as usize], *quantity, value));
            }
        }
        if limit_specular {
            for (material, _) in materials.iter_mut().zip(&self.limited).filter(|(_, limited)| **limited) {
                let lobe = lobe(material.power, material.normalization);
                let diffuse = material.diffuse_albedo();
                for (sigma, diffuse) in material.specular.iter_mut().zip(diffuse) {
                    *sigma = limit(*sigma, lobe, diffuse).specular;
                }
            }
        }
    }

    fn motion(&self, block: &Block, x: &[f64]) -> Motion {
        let What::Motion { centre, parts, .. } = &block.what else {
            return Motion::at_rest(DVec3::ZERO);
        };
        let mut motion = Motion::at_rest(*centre);
        let mut at = block.first;
        if parts[0] {
            motion.translation = block.scale * DVec3::from_slice(&x[at..]);
            at += 3;
        }
        if parts[1] {
            motion.rotation = DVec3::from_slice(&x[at..]);
            at += 3;
        }
        if parts[2] {
            motion.log_factor = x[at];
        }
        motion
    }

    /// The derivative by the unknowns, from that by the scene at them.
    pub fn pull_back(&self, x: &[f64], gradient: &SceneGradient) -> Vec<f64> {
        let mut by_unknowns = vec![0.0; self.len()];
        let by_material = self.by_material(x, gradient);
        for block in &self.blocks {
            let to = &mut by_unknowns[block.first..block.first + block.unknowns()];
            match &block.what {
                What::Material { quantity, materials, .. } => {
                    let unknowns = &x[block.first..];
                    for &m in materials {
                        let by_value = by_material[m as usize][*quantity as usize].unwrap_or_default();
                        for (channel, to) in to.iter_mut().enumerate() {
                            *to += by_value[channel] * slope(*quantity, unknowns[channel], block.scale);
                        }
                    }
                }
                What::Motion { vertices, parts, .. } => {
                    let Some(by_position) = &gradient.positions else { continue };
                    let pairs =
                        vertices.iter().map(|&v| (self.base.vertices[v as usize], by_position[v as usize]));
                    let by_motion = self.motion(block, x).pull_back(pairs);
                    let numbers = [
                        (parts[0], (block.scale * by_motion.translation).to_array().to_vec()),
                        (parts[1], by_motion.rotation.to_array().to_vec()),
                        (parts[2], vec![by_motion.log_factor]),
                    ];
                    let numbers = numbers.into_iter().filter(|(fitted, _)| *fitted).flat_map(|(_, n)| n);
                    to.iter_mut().zip(numbers).for_each(|(to, number)| *to += number);
                }
                What::Vertex { vertices } => {
                    let Some(by_position) = &gradient.positions else { continue };
                    let sum: DVec3 = vertices.iter().map(|&v| by_position[v as usize]).sum();
                    to.iter_mut().zip((block.scale * sum).to_array()).for_each(|(to, number)| *to += number);
                }
            }
        }
        by_unknowns
    }

    /// Sums over the triangles of each material, through the soft limit of σ.
    fn by_material(&self, x: &[f64], gradient: &SceneGradient) -> Vec<ByQuantity> {
        let mut sums: Vec<ByQuantity> = vec![Default::default(); self.base.materials.len()];
        for block in &self.blocks {
            let What::Material { quantity, triangles, .. } = &block.what else { continue };
            for &t in triangles {
                let material = self.base.triangles[t as usize].material as usize;
                let sum = sums[material][*quantity as usize].get_or_insert_default();
                let by_value = gradient.of_triangle(*quantity, t as usize);
                sum.iter_mut().zip(by_value).for_each(|(sum, g)| *sum += g);
            }
        }
        let mut raw = self.base.materials.clone();
        self.set_materials(x, &mut raw, false);
        for ((sum, material), _) in
            sums.iter_mut().zip(&raw).zip(&self.limited).filter(|(_, limited)| **limited)
        {
            let lobe = lobe(material.power, material.normalization);
            let diffuse = material.diffuse_albedo();
            let by_limited = sum[Quantity::Specular as usize].unwrap_or_default();
            let limits = [0, 1, 2].map(|c| limit(material.specular[c], lobe, diffuse[c]));
            for c in 0..3 {
                let mut add = |quantity: Quantity, channel: usize, value: f64| {
                    if let Some(sum) = &mut sum[quantity as usize] {
                        sum[channel] += value * by_limited[c];
                    }
                };
                add(Quantity::Power, 0, limits[c].by_power);
                add(Quantity::Albedo, c, limits[c].by_diffuse_albedo * material.diffuse);
                add(Quantity::Diffuse, 0, limits[c].by_diffuse_albedo * material.albedo[c]);
            }
            if let Some(sum) = &mut sum[Quantity::Specular as usize] {
                *sum = [0, 1, 2].map(|c| by_limited[c] * limits[c].by_specular);
            }
        }
        sums
    }

    /// Unknowns of a quantity, for regularisers.
    pub fn unknowns_of(&self, quantity: Quantity) -> Vec<usize> {
        let blocks = self.blocks.iter().filter(|block| self.fits[block.fit].quantity == quantity);
        blocks.flat_map(|block| block.first..block.first + block.unknowns()).collect()
    }

    /// The unknown that an RGB value of a quantity would be, per channel of [`Self::unknowns_of`]; `None` for positions.
    pub fn unknowns_for(&self, quantity: Quantity, value: [f64; 3]) -> Option<Vec<f64>> {
        if quantity == Quantity::Position {
            return None;
        }
        let blocks = self.blocks.iter().filter(|block| self.fits[block.fit].quantity == quantity);
        Some(
            blocks.flat_map(|b| (0..b.unknowns()).map(|c| to_unknown(quantity, value[c], b.scale))).collect(),
        )
    }

    /// Triangles whose quantity is fitted.
    pub fn triangles_of(&self, wanted: Quantity) -> Vec<bool> {
        let mut fitted = vec![false; self.base.triangles.len()];
        for block in &self.blocks {
            if let What::Material { quantity, triangles, .. } = &block.what
                && *quantity == wanted
            {
                triangles.iter().for_each(|&t| fitted[t as usize] = true);
            }
        }
        fitted
    }

    /// Vertices that are fitted, by places: vertices at one place together.
    pub fn fitted_places(&self) -> Vec<Vec<u32>> {
        let mut places = Vec::new();
        for block in &self.blocks {
            match &block.what {
                What::Vertex { vertices } => places.push(vertices.clone()),
                What::Material { .. } | What::Motion { .. } => {}
            }
        }
        places
    }

    /// A change of a quantity that means as much as a change of an unknown by 1.
    pub fn scale(&self, quantity: Quantity) -> f64 {
        let of = |block: &&Block| self.fits[block.fit].quantity == quantity;
        self.blocks.iter().find(of).map_or(1.0, |block| block.scale)
    }

    /// What was found.
    pub fn recovered(&self, x: &[f64]) -> Vec<Recovered> {
        let (found, initial) = (self.scene(x), self.scene(&self.start));
        let mut list = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let range = block.first..block.first + block.unknowns();
            let at_bound: Vec<bool> =
                range.clone().map(|i| x[i] <= self.bounds.lower[i] || x[i] >= self.bounds.upper[i]).collect();
            let mut push = |quantity, unit, value: Vec<f64>, initial: Vec<f64>, at_bound: &[bool]| {
                let (of, at_bound) = (block.name.clone(), at_bound.to_vec());
                list.push(Recovered { quantity, of, unit, value, initial, at_bound });
            };
            match &block.what {
                What::Material { quantity, materials, .. } => {
                    let n = quantity.channels();
                    let value = |scene: &Scene| {
                        materials
                            .first()
                            .map_or(vec![], |&m| get(&scene.materials[m as usize], *quantity)[..n].to_vec())
                    };
                    push(quantity.word(), quantity.unit(), value(&found), value(&initial), &at_bound);
                }
                What::Motion { parts, .. } => {
                    let (now, before) = (self.motion(block, x), self.motion(block, &self.start));
                    let mut at = 0;
                    let mut next = |n: usize| {
                        at += n;
                        at - n..at
                    };
                    if parts[0] {
                        let value = |m: &Motion| m.translation.to_array().to_vec();
                        push("translation", "m", value(&now), value(&before), &at_bound[next(3)]);
                    }
                    if parts[1] {
                        let value = |m: &Motion| m.rotation.to_array().map(f64::to_degrees).to_vec();
                        push("rotation vector", "degrees", value(&now), value(&before), &at_bound[next(3)]);
                    }
                    if parts[2] {
                        let value = |m: &Motion| vec![m.log_factor.exp()];
                        push("scale", "1", value(&now), value(&before), &at_bound[next(1)]);
                    }
                }
                What::Vertex { vertices } => {
                    let value = |scene: &Scene| {
                        vertices.first().map_or(vec![], |&v| scene.vertices[v as usize].to_array().to_vec())
                    };
                    push("position", "m", value(&found), value(&initial), &at_bound);
                }
            }
        }
        list
    }
}

fn displacement(fit: &Fit) -> Result<([f64; 3], [f64; 3]), String> {
    let (lower, upper) =
        (fit.lower.unwrap_or([f64::NEG_INFINITY; 3]), fit.upper.unwrap_or([f64::INFINITY; 3]));
    let ordered = |axis: &usize| lower[*axis] <= upper[*axis];
    match (0..3).find(|axis| !ordered(axis)) {
        Some(axis) => {
            Err(format!("position: bounds {} to {}; the lower one comes first", lower[axis], upper[axis]))
        }
        None => Ok((lower, upper)),
    }
}

/// The largest power whose lobe reflects at most `room` for σ = 1, by bisection: ℓ grows with p.
fn largest_power(room: f64, material: &Material) -> f64 {
    let fits = |power: f64| largest_lobe([power; 2], material.normalization) <= room;
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

fn get(material: &Material, quantity: Quantity) -> [f64; 3] {
    match quantity {
        Quantity::Emission => material.emission,
        Quantity::Albedo => material.albedo,
        Quantity::Specular => material.specular,
        Quantity::Diffuse => [material.diffuse, 0.0, 0.0],
        Quantity::Power => [material.power, 0.0, 0.0],
        Quantity::Position => [0.0; 3],
    }
}

fn set(material: &mut Material, quantity: Quantity, value: [f64; 3]) {
    match quantity {
        Quantity::Emission => material.emission = value,
        Quantity::Albedo => material.albedo = value,
        Quantity::Specular => material.specular = value,
        Quantity::Diffuse => material.diffuse = value[0],
        Quantity::Power => material.power = value[0],
        Quantity::Position => {}
    }
}

fn to_unknown(quantity: Quantity, value: f64, scale: f64) -> f64 {
    if quantity == Quantity::Power { value.min(CHECKED_POWER).ln_1p() } else { value / scale }
}

fn from_unknown(quantity: Quantity, unknown: f64, scale: f64) -> f64 {
    if quantity == Quantity::Power { unknown.exp_m1() } else { scale * unknown }
}

/// The derivative of the value by the unknown.
fn slope(quantity: Quantity, unknown: f64, scale: f64) -> f64 {
    if quantity == Quantity::Power { unknown.exp() } else { scale }
}

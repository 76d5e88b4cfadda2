//! Maps a vector of unknowns to a scene, and pulls derivatives back.
//!
//! Unknowns are values divided by a typical scale of their quantity, so that a change of 1 has a similar effect for all; a
//! power p has the unknown ln(1 + p), a scale factor its logarithm. All unknowns within [`Parameters::bounds`] give
//! physical materials: emission, δ, ρ, σ and p have box constraints, and σ passes through the soft limit of
//! [`limit`](super::limit).

mod asked;
mod bounds;
mod derivative;
mod pose;
mod recovered;
mod textures;
mod unseen;

pub use asked::{Fit, Groups, MotionKind, Per};
pub use recovered::Recovered;
pub use unseen::Unseen;

use super::limit::{limit, lobe};
use super::motion::FreeMotion;
use super::optimiser::Bounds;
use super::renderer::OwnSquares;
use super::selection::{self, Selected};
use antirad_core::plan::GradientRequest;
use antirad_render::render::Quantity;
use antirad_scene::{Material, Painting, Scene, bounds};
use glam::DVec3;
use std::collections::{HashMap, HashSet};
use std::ops::Range;

/// Multiples of it fill the unit interval evenly, without their whole parts.
const GOLDEN_RATIO: f64 = 1.618_033_988_749_895;

/// A [`Fit`] is invalid for the scene.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
#[non_exhaustive]
pub struct ParameterError {
    /// Index of the [`Fit`].
    pub fit: usize,
    /// What is wrong with it.
    pub message: String,
}

/// Unknowns that belong together, such as the channels of an albedo.
#[derive(Clone, Debug)]
struct ParameterBlock {
    fit: usize,
    /// Material, mesh, triangle or camera.
    name: String,
    /// Index of the first unknown.
    first: usize,
    /// Scale: value per unit of the unknowns.
    scale: f64,
    what: What,
}

#[derive(Clone, Debug)]
enum What {
    /// Materials of the split scene, and triangles.
    Material { quantity: Quantity, materials: Vec<u32>, triangles: Vec<u32> },
    /// Texels of the painting with such a number.
    Texture { painting: usize, texels: usize },
    /// Vertices that move.
    Motion { vertices: Vec<u32>, free: FreeMotion },
    /// Vertices at one place.
    Vertex { vertices: Vec<u32> },
    /// Views of one camera, or of several that move together.
    Camera { views: Vec<usize>, free: FreeMotion },
}

/// An unknown among those whose derivatives one change of the scene shows, and where in the pictures it does.
pub(super) struct Shown {
    pub unknown: usize,
    /// The only channel that it changes.
    pub channel: Option<usize>,
    /// The only views that it changes.
    pub views: Option<Vec<usize>>,
}

/// The pose of a camera, or of several that move together.
#[derive(Clone, Debug)]
pub(super) struct Pose {
    pub unknowns: Range<usize>,
    /// The views that it changes.
    pub views: Vec<usize>,
}

impl Shown {
    /// Whether it is of some views alone, as the pose of a camera is.
    pub fn is_of_views(&self) -> bool {
        self.views.is_some()
    }

    /// Whether it changes the picture of a view.
    pub fn changes(&self, view: usize) -> bool {
        self.views.as_ref().is_none_or(|views| views.contains(&view))
    }
}

impl ParameterBlock {
    /// Its unknowns among all.
    fn range(&self) -> Range<usize> {
        self.first..self.first + self.unknowns()
    }

    fn unknowns(&self) -> usize {
        match &self.what {
            What::Material { quantity, .. } => quantity.channels(),
            What::Motion { free, .. } | What::Camera { free, .. } => free.unknowns(),
            What::Vertex { .. } => 3,
            What::Texture { texels, .. } => 3 * texels,
        }
    }
}

/// The map between unknowns and scenes; see the module.
#[derive(Clone, Debug)]
pub struct Parameters {
    fits: Vec<Fit>,
    /// The scene with a separate material for each part that is fitted separately; its values are the initial ones.
    base: Scene,
    blocks: Vec<ParameterBlock>,
    bounds: Bounds,
    start: Vec<f64>,
    /// Textures whose texels are fitted.
    paintings: Vec<Painting>,
    /// Materials whose σ is fitted and thus passes through the soft limit.
    limited: Vec<bool>,
    /// The [`Fit`] of each quantity of a material.
    fit_of: HashMap<(Quantity, u32), usize>,
    request: GradientRequest,
}

/// Most groups of emission whose curvature is found by a picture for each.
const MOST_LAMPS: usize = 16;

/// The largest power that the scene's check accepts.
const CHECKED_POWER: f64 = 1e5;

impl Parameters {
    /// The unknowns of some fits to a scene, whose cameras are those of the views. `brightness`: a typical radiance of lamps, W/(m² sr), the
    /// scale of emissions.
    ///
    /// # Errors
    /// Fails if a fit selects nothing in the scene or what cannot be fitted, if fits overlap, or if an
    /// initial value or a bound is invalid.
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
            paintings: Vec::new(),
            blocks: Vec::new(),
            bounds: Bounds::free(0),
            start: Vec::new(),
            fit_of: HashMap::new(),
            request: GradientRequest::NOTHING,
        };
        for (fit, selected) in selected.iter().enumerate() {
            match fits[fit].per {
                Per::Texel => parameters.add_textures(fit, selected)?,
                _ => parameters.add(fit, selected, brightness.max(f64::MIN_POSITIVE)),
            }
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

    /// The vertices whose positions are fitted, by their indices in the scene.
    pub fn movable(&self) -> Vec<u32> {
        let of = |block: &ParameterBlock| match &block.what {
            What::Motion { vertices, .. } | What::Vertex { vertices } => vertices.clone(),
            What::Material { .. } | What::Texture { .. } | What::Camera { .. } => Vec::new(),
        };
        self.blocks.iter().flat_map(of).collect()
    }

    /// The textures whose texels are fitted.
    pub fn paintings(&self) -> Vec<Painting> {
        self.paintings.clone()
    }

    fn add(&mut self, fit: usize, selected: &Selected, brightness: f64) {
        let quantity = self.fits[fit].quantity;
        let w = &mut self.request;
        *match quantity {
            Quantity::Emission => &mut w.emission,
            Quantity::Diffuse => &mut w.diffuse,
            Quantity::Albedo => &mut w.albedo,
            Quantity::Specular => &mut w.specular,
            Quantity::Power => &mut w.power,
            Quantity::Position => &mut w.positions,
            Quantity::Camera => &mut w.camera,
        } = true;
        for (name, members) in &selected.groups {
            let (scale, what) = if quantity == Quantity::Camera {
                let views: Vec<usize> = members.iter().map(|&view| view as usize).collect();
                let what = &self.fits[fit];
                let parts = if what.together { what.motion.parts() } else { [true, true, false] };
                let free = pose::free_motion(&self.base, &views, parts);
                (1.0, What::Camera { views, free })
            } else if quantity == Quantity::Position {
                let place = |v: &u32| self.base.vertices[*v as usize];
                let (low, high) = bounds(members.iter().map(place));
                match self.fits[fit].motion {
                    MotionKind::Vertices => (selected.edge, What::Vertex { vertices: members.clone() }),
                    motion => {
                        let size = (high - low).length();
                        // A rotation by 1 rad moves the ends of the mesh by half its size.
                        let scale = if size > 0.0 { size / 2.0 } else { 1.0 };
                        let (units, parts) = ([scale, 1.0, 1.0], motion.parts());
                        let units = [0, 1, 2].map(|k| parts[k].then_some(units[k]));
                        let free = FreeMotion { centre: low.midpoint(high), units };
                        (scale, What::Motion { vertices: members.clone(), free })
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
            let block = ParameterBlock { fit, name: name.clone(), first: self.start.len(), scale, what };
            self.start.resize(self.start.len() + block.unknowns(), 0.0);
            self.blocks.push(block);
        }
    }

    /// Writes initial values to the base scene and converts them to unknowns.
    fn set_initial(&mut self, fit: usize, what: &Fit) -> Result<(), ParameterError> {
        let refuse = |message: String| Err(ParameterError { fit, message });
        if let Some(initial) = what.initial {
            let word = what.quantity.word();
            if what.quantity == Quantity::Camera {
                return refuse(String::from("a camera starts where it is given: leave `initial` out"));
            }
            if what.quantity != Quantity::Position && initial.iter().any(|v| !(*v >= 0.0 && v.is_finite())) {
                return refuse(format!("initial {word} is {initial:?}; it must be finite and 0 or more"));
            }
            if what.quantity == Quantity::Position && !what.motion.parts()[0] {
                return refuse(String::from("only a motion with a translation has an `initial`, in metres"));
            }
        }
        // Cloned, because the blocks are modified below.
        for block in self.blocks.clone().iter().filter(|block| block.fit == fit) {
            let first = block.first;
            match &block.what {
                What::Material { quantity, materials, .. } => {
                    let value = what.initial.unwrap_or_else(|| {
                        // The mean, if materials that share a value differ.
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
                What::Motion { free: FreeMotion { units: [Some(unit), ..], .. }, .. } => {
                    let initial = what.initial.unwrap_or_default();
                    for (axis, way) in initial.iter().enumerate() {
                        self.start[first + axis] = way / unit;
                    }
                }
                What::Texture { painting, texels } => {
                    if let Some(value) = what.initial {
                        let texels = vec![DVec3::from(value); *texels];
                        let values = texels.iter().flat_map(|texel| texel.to_array());
                        self.start[first..].iter_mut().zip(values).for_each(|(to, value)| *to = value);
                        self.base.set_painting(&self.paintings[*painting], texels);
                    }
                }
                What::Motion { .. } | What::Vertex { .. } | What::Camera { .. } => {}
            }
        }
        Ok(())
    }

    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.start.len()
    }

    /// True if there are no unknowns.
    pub fn is_empty(&self) -> bool {
        self.start.is_empty()
    }

    /// Bounds within which every vector of unknowns is a valid scene.
    pub fn bounds(&self) -> &Bounds {
        &self.bounds
    }

    /// Candidates for lamps ([`Fit::groups`] of emission): number of the block, name, unknowns.
    pub(super) fn candidates(&self) -> Vec<(usize, &str, Range<usize>)> {
        let may_shine = |block: &ParameterBlock| {
            let fit = &self.fits[block.fit];
            fit.quantity == Quantity::Emission && fit.groups.is_some()
        };
        let blocks = self.blocks.iter().enumerate().filter(|(_, block)| may_shine(block));
        blocks.map(|(b, block)| (b, block.name.as_str(), block.range())).collect()
    }

    /// Holds the unknowns of a block at 0.
    pub(super) fn hold_at_zero(&mut self, block: usize) {
        for i in self.blocks[block].range() {
            (self.bounds.lower[i], self.bounds.upper[i], self.start[i]) = (0.0, 0.0, 0.0);
        }
    }

    /// The unknowns at the initial values.
    pub fn start(&self) -> &[f64] {
        &self.start
    }

    /// Which derivatives [`Self::pull_back`] needs.
    pub fn gradient_request(&self) -> GradientRequest {
        self.request
    }

    /// The scene with initial values, and with a separate material for each part that is fitted separately.
    pub fn base(&self) -> &Scene {
        &self.base
    }

    /// True if only emission is fitted, so that pictures are affine in the unknowns.
    pub fn is_linear(&self) -> bool {
        self.fits.iter().all(|fit| fit.quantity == Quantity::Emission)
    }

    /// The scene at the given unknowns.
    pub fn scene(&self, x: &[f64]) -> Scene {
        let mut scene = self.base.clone();
        self.set_materials(x, &mut scene.materials, true);
        let mut moved = false;
        for block in &self.blocks {
            match &block.what {
                What::Material { .. } => {}
                What::Texture { painting, .. } => {
                    scene.set_painting(&self.paintings[*painting], self.texels(block, x));
                }
                What::Motion { vertices, free } => {
                    let motion = free.motion(&x[block.range()]);
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
                What::Camera { views, free } => {
                    let motion = free.motion(&x[block.range()]);
                    for &view in views {
                        scene.cameras[view] = pose::moved(&self.base.cameras[view], &motion);
                    }
                }
            }
        }
        if moved {
            scene.update_degenerate();
        }
        scene
    }

    /// The scene lit by the fitted emissions alone, which may be negative: the linear part of [`Self::scene`], if
    /// [`Self::is_linear`].
    pub fn linear_scene(&self, x: &[f64]) -> Scene {
        let mut scene = self.base.clone();
        scene.materials.iter_mut().for_each(|m| m.emission = [0.0; 3]);
        scene.suns.iter_mut().for_each(|sun| sun.irradiance = [0.0; 3]);
        self.set_materials(x, &mut scene.materials, true);
        scene
    }

    /// A scene that requires as much of the solver as any other within the bounds: three channels if colours are fitted,
    /// specular reflection if σ is.
    pub fn planning_scene(&self) -> Scene {
        let mut scene = self.base.clone();
        for block in &self.blocks {
            let What::Material { quantity, materials, .. } = &block.what else { continue };
            for &m in materials {
                let material = &mut scene.materials[m as usize];
                match quantity {
                    Quantity::Specular => {
                        material.specular = material.specular.map(|s| s.max(1e-6));
                        material.specular[1] *= 0.9;
                    }
                    Quantity::Albedo => material.albedo[1] = 0.9 * material.albedo[1] + 1e-6,
                    // Rays are as many as the light of this scene asks for. Where nothing is known of it, materials emit differently,
                    // distributed exponentially: of uniform light few rays tell all.
                    Quantity::Emission => {
                        let share = ((f64::from(m) + 0.5) * GOLDEN_RATIO).fract();
                        material.emission[1] = 0.9 * material.emission[1] - 1e-6 * (1.0 - share).ln();
                    }
                    Quantity::Diffuse | Quantity::Power | Quantity::Position | Quantity::Camera => {}
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

    /// Unknowns of a quantity, for regularisers.
    pub fn unknowns_of(&self, quantity: Quantity) -> Vec<usize> {
        self.groups_of(quantity).into_iter().flat_map(|(_, unknowns)| unknowns).collect()
    }

    /// Unknowns of a quantity by group, with the name of the material, mesh, triangle or camera that they are of: the channels of a colour, the
    /// texels of a texture, the coordinates of a motion.
    pub fn groups_of(&self, quantity: Quantity) -> Vec<(&str, Range<usize>)> {
        let blocks = self.blocks.iter().filter(|block| self.fits[block.fit].quantity == quantity);
        blocks.map(|block| (block.name.as_str(), block.range())).collect()
    }

    /// Groups of unknowns whose derivatives one change of the scene shows: the channels of a colour, which do not mix in any
    /// picture; the same coordinate of the poses of all cameras, each of which changes its own pictures; or an unknown alone. Those of
    /// cameras come first: a renderer needs no other light for them.
    pub(super) fn columns(&self) -> Vec<Vec<Shown>> {
        let (mut of_cameras, mut columns) = (Vec::new(), Vec::new());
        for block in &self.blocks {
            let unknowns = block.range();
            let alone = |unknown| Shown { unknown, channel: None, views: None };
            match &block.what {
                What::Material { quantity, .. } if quantity.channels() == 3 => {
                    let of_channel = |(c, unknown)| Shown { channel: Some(c), ..alone(unknown) };
                    columns.push(unknowns.enumerate().map(of_channel).collect());
                }
                What::Camera { views, .. } => {
                    of_cameras.resize_with(block.unknowns().max(of_cameras.len()), Vec::new);
                    for (column, unknown) in of_cameras.iter_mut().zip(unknowns) {
                        column.push(Shown { views: Some(views.clone()), ..alone(unknown) });
                    }
                }
                _ => columns.extend(unknowns.map(|unknown| vec![alone(unknown)])),
            }
        }
        of_cameras.extend(columns);
        of_cameras
    }

    /// The poses of cameras that are unknown.
    pub(super) fn poses(&self) -> Vec<Pose> {
        let of_block = |block: &ParameterBlock| match &block.what {
            What::Camera { views, .. } => Some(Pose { unknowns: block.range(), views: views.clone() }),
            _ => None,
        };
        self.blocks.iter().filter_map(of_block).collect()
    }

    /// Columns of unknowns that change more than the triangles they belong to: cameras, and the emission of groups of triangles if there are
    /// at most [`MOST_LAMPS`].
    pub(super) fn far_reaching_columns(&self) -> Vec<Vec<Shown>> {
        let lamps: HashSet<usize> = self
            .blocks
            .iter()
            .filter(|block| matches!(block.what, What::Material { quantity: Quantity::Emission, .. }))
            .map(|block| block.first)
            .collect();
        let few = lamps.len() <= MOST_LAMPS;
        let is_lamp = |column: &[Shown]| column.first().is_some_and(|shown| lamps.contains(&shown.unknown));
        let mut columns = self.columns();
        columns.retain(|column| column.iter().all(Shown::is_of_views) || few && is_lamp(column));
        columns
    }

    /// The step of a finite difference for each unknown: `usual`, or what moves the picture of a camera by half a pixel, since edges pass
    /// the samples of a picture one by one.
    pub(super) fn steps(&self, usual: f64) -> Vec<f64> {
        let of_block = |block: &ParameterBlock| match &block.what {
            What::Camera { views, .. } => {
                vec![pose::half_a_pixel(&self.base.cameras[views[0]]); block.unknowns()]
            }
            _ => vec![usual; block.unknowns()],
        };
        self.blocks.iter().flat_map(of_block).collect()
    }

    /// Squares of derivatives by the unknowns, from those by triangles, which add up where triangles share an unknown. `None` if
    /// something else than albedo and emission is unknown, apart from cameras, whose squares are left zero.
    pub(super) fn own_squares(&self, by_triangles: &OwnSquares) -> Option<Vec<f64>> {
        let mut by_unknowns = vec![0.0; self.len()];
        for block in &self.blocks {
            let (quantity, triangles) = match &block.what {
                What::Material { quantity, triangles, .. } => (quantity, triangles),
                What::Texture { painting, .. } => {
                    // A pixel is about as large as a texel.
                    let to = &mut by_unknowns[block.range()];
                    let mut squares = vec![DVec3::ZERO; to.len() / 3];
                    self.paintings[*painting].pull_back(|t| by_triangles.albedo[t], &mut squares);
                    to.iter_mut().zip(squares.iter().flat_map(|s| s.to_array())).for_each(|(to, s)| *to = s);
                    continue;
                }
                What::Camera { .. } => continue,
                What::Motion { .. } | What::Vertex { .. } => return None,
            };
            let of = match quantity {
                Quantity::Albedo => &by_triangles.albedo,
                Quantity::Emission => &by_triangles.emission,
                _ => return None,
            };
            let sum: DVec3 = triangles.iter().map(|&t| of[t as usize]).sum();
            let squares = block.scale * block.scale * sum;
            by_unknowns[block.first..block.first + 3].copy_from_slice(&squares.to_array());
        }
        Some(by_unknowns)
    }

    /// The texels of a texture at the given unknowns.
    fn texels(&self, block: &ParameterBlock, x: &[f64]) -> Vec<DVec3> {
        x[block.range()].chunks_exact(3).map(DVec3::from_slice).collect()
    }

    /// The unknowns for an RGB value of a quantity, per channel of [`Self::unknowns_of`]; `None` for positions and cameras.
    pub fn unknowns_for(&self, quantity: Quantity, value: [f64; 3]) -> Option<Vec<f64>> {
        if matches!(quantity, Quantity::Position | Quantity::Camera) {
            return None;
        }
        let blocks = self.blocks.iter().filter(|block| self.fits[block.fit].quantity == quantity);
        Some(
            blocks
                .flat_map(|b| (0..b.unknowns()).map(|c| to_unknown(quantity, value[c % 3], b.scale)))
                .collect(),
        )
    }

    /// Triangles whose quantity is fitted.
    pub fn triangles_of(&self, of: Quantity) -> Vec<bool> {
        let mut fitted = vec![false; self.base.triangles.len()];
        for block in &self.blocks {
            match &block.what {
                What::Material { quantity, triangles, .. } if *quantity == of => {
                    triangles.iter().for_each(|&t| fitted[t as usize] = true);
                }
                What::Texture { painting, .. } if of == Quantity::Albedo => {
                    let triangles = self.paintings[*painting].triangles();
                    triangles.iter().for_each(|&t| fitted[t as usize] = true);
                }
                _ => {}
            }
        }
        fitted
    }

    /// Fitted vertices, grouped by place.
    pub fn fitted_places(&self) -> Vec<Vec<u32>> {
        let mut places = Vec::new();
        for block in &self.blocks {
            match &block.what {
                What::Vertex { vertices } => places.push(vertices.clone()),
                What::Material { .. } | What::Motion { .. } | What::Texture { .. } | What::Camera { .. } => {}
            }
        }
        places
    }

    /// The change of a quantity that corresponds to a change of its unknown by 1.
    pub fn scale(&self, quantity: Quantity) -> f64 {
        let of = |block: &&ParameterBlock| self.fits[block.fit].quantity == quantity;
        self.blocks.iter().find(of).map_or(1.0, |block| block.scale)
    }
}

fn get(material: &Material, quantity: Quantity) -> [f64; 3] {
    match quantity {
        Quantity::Emission => material.emission,
        Quantity::Albedo => material.albedo,
        Quantity::Specular => material.specular,
        Quantity::Diffuse => [material.diffuse, 0.0, 0.0],
        Quantity::Power => [material.power, 0.0, 0.0],
        Quantity::Position | Quantity::Camera => [0.0; 3],
    }
}

fn set(material: &mut Material, quantity: Quantity, value: [f64; 3]) {
    match quantity {
        Quantity::Emission => material.emission = value,
        Quantity::Albedo => material.albedo = value,
        Quantity::Specular => material.specular = value,
        Quantity::Diffuse => material.diffuse = value[0],
        Quantity::Power => material.power = value[0],
        Quantity::Position | Quantity::Camera => {}
    }
}

fn to_unknown(quantity: Quantity, value: f64, scale: f64) -> f64 {
    if quantity == Quantity::Power { value.min(CHECKED_POWER).ln_1p() } else { value / scale }
}

fn from_unknown(quantity: Quantity, unknown: f64, scale: f64) -> f64 {
    if quantity == Quantity::Power { unknown.exp_m1() } else { scale * unknown }
}

//! Regularisers: value and gradient of each.

use super::parameters::{MotionKind, Parameters};
use super::selection::unknown_of;
use antirad_render::render::{Quantity, SceneGradient};
use antirad_scene::{Edges, Scene, Welded, sides};
use glam::DVec3;
use serde::Serialize;

/// An assumption about the scene, with its weight relative to the loss of the pictures. Quantities are in units of their
/// scale ([`Parameters::scale`]), so that weights are dimensionless and independent of the scene's size.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Regulariser {
    /// Neighbours on a mesh are alike: the mean of |v_i - v_j|² over pairs of triangles that share an edge, at least one of
    /// them fitted. For a power, v = ln(1 + p).
    Smoothness {
        /// The quantity.
        of: Quantity,
        /// Weight, dimensionless.
        weight: f64,
    },
    /// Meshes keep their shape: the mean over fitted vertices of |u - mean of u over its neighbours|², where u is the
    /// displacement of a vertex. It preserves details of the initial mesh; translations as a whole cost nothing.
    Laplacian {
        /// Weight, dimensionless.
        weight: f64,
    },
    /// Few triangles emit: the mean of L_e over area and channels of the fitted triangles, an L1 norm because emission is
    /// never negative. Of all emissions that explain the pictures it favours one with little power; it biases lamps to be
    /// slightly too dark.
    Sparsity {
        /// Weight, dimensionless.
        weight: f64,
    },
    /// Textures are even but for edges: the mean over neighbouring texels, of an atlas those of one chart, and channels of √(d² + ε²) - ε,
    /// with d their difference of albedo and ε = 0.02 (total variation: Rudin, Osher and Fatemi 1992). It evens out the noise of photos,
    /// and continues textures where no photo shows them.
    TotalVariation {
        /// Weight, dimensionless.
        weight: f64,
    },
    /// Values stay near `value` (`None`: near their initial values): the mean of the squared difference of the unknowns, in which a texture
    /// counts as one.
    Prior {
        /// The quantity.
        of: Quantity,
        /// Materials, meshes, triangles or cameras, by the names that results give them; `None`: all that are fitted.
        names: Option<Vec<String>>,
        /// The value to stay near, in the unit of the quantity.
        value: Option<[f64; 3]>,
        /// Weight, dimensionless.
        weight: f64,
    },
}

impl Regulariser {
    /// The weight of the regulariser, dimensionless.
    pub fn weight(&self) -> f64 {
        match self {
            Self::Smoothness { weight, .. }
            | Self::Laplacian { weight }
            | Self::Sparsity { weight }
            | Self::TotalVariation { weight }
            | Self::Prior { weight, .. } => *weight,
        }
    }

    /// Description for reports.
    pub fn assumption(&self) -> String {
        match self {
            Self::Smoothness { of, .. } => format!("{} varies little between neighbours", of.word()),
            Self::Laplacian { .. } => String::from("meshes keep their shape"),
            Self::Sparsity { .. } => String::from("few triangles emit, and emission is not negative"),
            Self::TotalVariation { .. } => String::from("textures are even but for edges"),
            Self::Prior { of, names, value, .. } => {
                let whose =
                    names.as_ref().map_or_else(String::new, |names| format!(" of {}", names.join(", ")));
                let near =
                    value.map_or_else(|| String::from("where it started"), |value| format!("{value:?}"));
                format!("{}{whose} is near {near}", of.word())
            }
        }
    }
}

/// Regularisers of a scene, ready for evaluation.
#[derive(Clone, Debug, Default)]
pub struct Regularisers {
    terms: Vec<Term>,
}

#[derive(Clone, Debug)]
enum Term {
    Smoothness {
        of: Quantity,
        pairs: Vec<[u32; 2]>,
        weight: f64,
        scale: f64,
    },
    Laplacian {
        places: Vec<Vec<u32>>,
        neighbours: Vec<Vec<usize>>,
        weight: f64,
        scale: f64,
    },
    Sparsity {
        areas: Vec<(u32, f64)>,
        weight: f64,
    },
    TotalVariation {
        /// The first unknowns of neighbouring texels.
        pairs: Vec<[usize; 2]>,
        weight: f64,
    },
    /// Unknowns with their values and weights.
    Prior {
        unknowns: Vec<(usize, f64, f64)>,
    },
}

/// Differences of albedo between texels from which on they are edges.
const EDGE: f64 = 0.02;

impl Regularisers {
    /// Prepares the regularisers.
    ///
    /// # Errors
    /// Fails if a regulariser applies to nothing fitted. The error has its index.
    pub fn new(terms: &[Regulariser], parameters: &Parameters) -> Result<Self, (usize, String)> {
        let term = |(at, term): (usize, &Regulariser)| term_of(term, parameters).map_err(|error| (at, error));
        Ok(Self { terms: terms.iter().enumerate().map(term).collect::<Result<_, _>>()? })
    }

    /// The regularisers that apply to what is fitted.
    pub fn applicable(terms: &[Regulariser], parameters: &Parameters) -> Self {
        Self { terms: terms.iter().filter_map(|term| term_of(term, parameters).ok()).collect() }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.terms.is_empty()
    }

    /// The value of each term at some unknowns and their scene; adds the derivatives by the scene and by the unknowns.
    pub fn evaluate(
        &self,
        parameters: &Parameters,
        scene: &Scene,
        x: &[f64],
        by_scene: &mut SceneGradient,
        by_unknowns: &mut [f64],
    ) -> Vec<f64> {
        let term = |term: &Term| match term {
            Term::Smoothness { of, pairs, weight, scale } => {
                smoothness(scene, *of, pairs, *weight, *scale, by_scene)
            }
            Term::Laplacian { places, neighbours, weight, scale } => {
                laplacian(parameters.base(), scene, places, neighbours, weight / (scale * scale), by_scene)
            }
            Term::Sparsity { areas, weight } => {
                let mut sum = 0.0;
                for &(t, area) in areas {
                    sum += weight * area * scene.material(t as usize).emission.iter().sum::<f64>();
                    by_scene.add_to_triangle(Quantity::Emission, t as usize, [weight * area; 3]);
                }
                sum
            }
            Term::TotalVariation { pairs, weight } => total_variation(x, pairs, *weight, by_unknowns),
            Term::Prior { unknowns } => {
                let mut sum = 0.0;
                for &(i, prior, weight) in unknowns {
                    let d = x[i] - prior;
                    sum += weight * d * d;
                    by_unknowns[i] += 2.0 * weight * d;
                }
                sum
            }
        };
        self.terms.iter().map(term).collect()
    }
}

fn term_of(term: &Regulariser, parameters: &Parameters) -> Result<Term, String> {
    let weight = term.weight();
    if !(weight >= 0.0 && weight.is_finite()) {
        return Err(format!("the weight is {weight}; it must be 0 or more, and finite"));
    }
    let missing = |of: Quantity| format!("{} is not fitted, so it cannot be regularised", of.word());
    let scene = parameters.base();
    match term {
        Regulariser::Smoothness { of: Quantity::Position, .. } => {
            Err(String::from("smoothness of positions is kind = \"laplacian\""))
        }
        Regulariser::Smoothness { of: Quantity::Camera, .. } => Err(String::from(
            "cameras have no neighbours: use kind = \"prior\" to keep them where they are given",
        )),
        Regulariser::Smoothness { of, .. } => {
            let fitted = parameters.triangles_of(*of);
            if !fitted.contains(&true) {
                return Err(missing(*of));
            }
            let mut pairs = neighbours(scene);
            pairs.retain(|&[a, b]| fitted[a as usize] || fitted[b as usize]);
            if pairs.is_empty() {
                return Err(format!("no two triangles of which {} is fitted share an edge", of.word()));
            }
            let scale = if *of == Quantity::Power { 1.0 } else { parameters.scale(*of) };
            Ok(Term::Smoothness { of: *of, weight: weight / pairs.len() as f64, pairs, scale })
        }
        Regulariser::Laplacian { .. } => {
            let places = parameters.fitted_places();
            if places.is_empty() {
                return Err(format!(
                    "no vertices are fitted (motion = \"{}\"), so there is no shape to keep",
                    serde_word(MotionKind::Vertices)
                ));
            }
            let neighbours = adjacent_places(scene, &places);
            let scale = parameters.scale(Quantity::Position);
            Ok(Term::Laplacian { weight: weight / places.len() as f64, places, neighbours, scale })
        }
        Regulariser::Sparsity { .. } => {
            let fitted = parameters.triangles_of(Quantity::Emission);
            let area = |t: usize| scene.area_vector(t).length();
            let picked = (0..fitted.len()).filter(|&t| fitted[t]).map(|t| (t as u32, area(t)));
            let areas: Vec<(u32, f64)> = picked.collect();
            let total: f64 = areas.iter().map(|(_, area)| area).sum();
            if total == 0.0 {
                return Err(missing(Quantity::Emission));
            }
            Ok(Term::Sparsity {
                areas,
                weight: weight / (3.0 * total * parameters.scale(Quantity::Emission)),
            })
        }
        Regulariser::TotalVariation { .. } => {
            let pairs = parameters.neighbouring_texels();
            match pairs.len() {
                0 => Err(String::from("no texture is fitted (per = \"texel\"), so none can be even")),
                count => Ok(Term::TotalVariation { pairs, weight: weight / (3.0 * count as f64) }),
            }
        }
        Regulariser::Prior { of, names, value, .. } => {
            let mut groups = parameters.groups_of(*of);
            if groups.is_empty() {
                return Err(missing(*of));
            }
            if let Some(names) = names {
                let known = || groups.iter().map(|(name, _)| *name);
                if let Some(name) = names.iter().find(|name| known().all(|known| known != name.as_str())) {
                    let none = format!("no {} is fitted of", of.word());
                    return Err(unknown_of(&none, name, "but of", known()));
                }
                groups.retain(|(name, _)| names.iter().any(|wanted| wanted == name));
            }
            let mut near = parameters.start().to_vec();
            if let Some(value) = value {
                let values = parameters.unknowns_for(*of, *value).ok_or_else(|| {
                    format!("the prior of a {} is where it starts: leave `value` out", of.word())
                })?;
                parameters.unknowns_of(*of).into_iter().zip(values).for_each(|(i, value)| near[i] = value);
            }
            let count = groups.len();
            let unknowns = groups.into_iter().flat_map(|(_, group)| {
                let weight = weight / (count * group.len()) as f64;
                group.map(move |i| (i, weight))
            });
            Ok(Term::Prior { unknowns: unknowns.map(|(i, weight)| (i, near[i], weight)).collect() })
        }
    }
}

fn serde_word(kind: MotionKind) -> &'static str {
    match kind {
        MotionKind::Vertices => "vertices",
        MotionKind::Translation => "translation",
        MotionKind::Rigid => "rigid",
        MotionKind::Scale => "scale",
        MotionKind::Similarity => "similarity",
    }
}

/// The values of a triangle's material in units of their scale, and the derivative of these by the value.
fn values(scene: &Scene, of: Quantity, triangle: u32, scale: f64) -> ([f64; 3], f64) {
    let material = scene.material(triangle as usize);
    let rgb = |v: [f64; 3]| (v.map(|v| v / scale), 1.0 / scale);
    match of {
        Quantity::Emission => rgb(material.emission),
        Quantity::Albedo => rgb(material.albedo),
        Quantity::Specular => rgb(material.specular),
        Quantity::Diffuse => rgb([material.diffuse, 0.0, 0.0]),
        Quantity::Power => ([material.power.ln_1p(), 0.0, 0.0], 1.0 / (1.0 + material.power)),
        Quantity::Position | Quantity::Camera => ([0.0; 3], 0.0),
    }
}

fn smoothness(
    scene: &Scene,
    of: Quantity,
    pairs: &[[u32; 2]],
    weight: f64,
    scale: f64,
    gradient: &mut SceneGradient,
) -> f64 {
    let mut sum = 0.0;
    for &[i, j] in pairs {
        let ((a, by_a), (b, by_b)) = (values(scene, of, i, scale), values(scene, of, j, scale));
        let d = [0, 1, 2].map(|c| a[c] - b[c]);
        sum += weight * d.iter().map(|d| d * d).sum::<f64>();
        gradient.add_to_triangle(of, i as usize, d.map(|d| 2.0 * weight * d * by_a));
        gradient.add_to_triangle(of, j as usize, d.map(|d| -2.0 * weight * d * by_b));
    }
    sum
}

/// The sum over neighbouring texels, by their first unknowns; adds its derivatives.
fn total_variation(x: &[f64], pairs: &[[usize; 2]], weight: f64, by_unknowns: &mut [f64]) -> f64 {
    let mut sum = 0.0;
    for &[a, b] in pairs {
        for c in 0..3 {
            let d = x[a + c] - x[b + c];
            let root = d.hypot(EDGE);
            sum += weight * (root - EDGE);
            by_unknowns[a + c] += weight * d / root;
            by_unknowns[b + c] -= weight * d / root;
        }
    }
    sum
}

fn laplacian(
    before: &Scene,
    scene: &Scene,
    places: &[Vec<u32>],
    neighbours: &[Vec<usize>],
    weight: f64,
    gradient: &mut SceneGradient,
) -> f64 {
    let first = |place: &Vec<u32>| place.first().map_or(0, |&v| v as usize);
    let moved: Vec<DVec3> =
        places.iter().map(|place| scene.vertices[first(place)] - before.vertices[first(place)]).collect();
    let mut by_place = vec![DVec3::ZERO; places.len()];
    let mut sum = 0.0;
    for (place, around) in neighbours.iter().enumerate().filter(|(_, around)| !around.is_empty()) {
        let share = 1.0 / around.len() as f64;
        let d = moved[place] - share * around.iter().map(|&n| moved[n]).sum::<DVec3>();
        sum += weight * d.length_squared();
        by_place[place] += 2.0 * weight * d;
        around.iter().for_each(|&n| by_place[n] -= 2.0 * weight * share * d);
    }
    if let Some(by_position) = &mut gradient.positions {
        // All vertices at a place move as one: exactly one of them carries the derivative.
        for (place, by) in places.iter().zip(by_place) {
            by_position[first(place)] += by;
        }
    }
    sum
}

/// Pairs of triangles of a mesh that share an edge, by the positions of its ends: files often repeat vertices.
fn neighbours(scene: &Scene) -> Vec<[u32; 2]> {
    let welded = Welded::exactly(scene.vertices.iter().copied());
    let mut pairs = Vec::new();
    for mesh in &scene.meshes {
        let corners = |t: u32| welded.positions(scene.triangles[t as usize].vertices);
        let directed = mesh.range.clone().flat_map(|t| sides(corners(t)).map(|side| (t, side)));
        for edge in Edges::new(directed).iter() {
            let mut rest = edge.triangles();
            while let Some(a) = rest.next() {
                pairs.extend(rest.clone().filter(|&b| a != b).map(|b| [a, b]));
            }
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// Per fitted place, the fitted places at the other ends of its edges, ascending.
fn adjacent_places(scene: &Scene, places: &[Vec<u32>]) -> Vec<Vec<usize>> {
    let mut place_of: Vec<Option<u32>> = vec![None; scene.vertices.len()];
    for (place, vertices) in (0..).zip(places) {
        vertices.iter().for_each(|&v| place_of[v as usize] = Some(place));
    }
    let place = |v: u32| place_of[v as usize];
    let directed = (0..).zip(&scene.triangles).flat_map(|(t, triangle)| {
        sides(triangle.vertices).into_iter().filter_map(move |[a, b]| Some((t, [place(a)?, place(b)?])))
    });
    let mut around = vec![Vec::new(); places.len()];
    for edge in Edges::new(directed).iter() {
        let [a, b] = edge.ends();
        around[a as usize].push(b as usize);
        around[b as usize].push(a as usize);
    }
    around
}

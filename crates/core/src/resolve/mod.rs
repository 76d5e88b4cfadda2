//! Settings that are resolved once: what a scene leaves open is decided here, before anything is planned, and nothing decides it anew.

mod flooded;
mod mesh;

use crate::direct::{FEW_LAMPS, Lamp, Visibility};
use crate::plan::{GradientRequest, direct_lamps};
use antirad_base::setters;
use antirad_scene::{Cut, Lamps, Scene, SceneError, VisibilityChoice};
use serde::Serialize;
use std::fmt;

pub use mesh::cut_coarse;

/// What a scene is resolved for.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ResolveOptions {
    /// Whether triangles may be cut.
    pub cut: bool,
    /// Triangles that the scene has at most after that, if it has no more before.
    pub max_triangles: usize,
    /// Whether derivatives by positions or cameras are wanted. Those by positions take implicit visibility, and both take lamps with exact
    /// visibility.
    pub moves: Moves,
}

/// What moves, and is differentiated by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Moves {
    /// Nothing.
    #[default]
    Nothing,
    /// Cameras.
    Cameras,
    /// Vertices.
    Vertices,
}

impl From<GradientRequest> for Moves {
    fn from(request: GradientRequest) -> Self {
        match request {
            GradientRequest { positions: true, .. } => Self::Vertices,
            GradientRequest { camera: true, .. } => Self::Cameras,
            _ => Self::Nothing,
        }
    }
}

setters!(ResolveOptions { cut: bool, max_triangles: usize, moves: Moves });

impl Default for ResolveOptions {
    fn default() -> Self {
        Self { cut: true, max_triangles: Self::MAX_TRIANGLES, moves: Moves::Nothing }
    }
}

impl ResolveOptions {
    /// Default of `max_triangles`.
    pub const MAX_TRIANGLES: usize = 200_000;
}

/// A decision, with its reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Decision {
    /// What is decided, as in scene files.
    pub setting: &'static str,
    /// What it is.
    pub value: String,
    /// Why.
    pub why: String,
}

impl fmt::Display for Decision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { setting, value, why } = self;
        write!(f, "{setting:<11} {value}: {why}")
    }
}

/// A scene with nothing left to decide.
#[derive(Clone, Debug)]
pub struct Resolved {
    /// The scene as it is solved: its triangles are parts of those given, and its settings are all stated.
    pub scene: Scene,
    /// How its triangles were cut.
    pub cut: Cut,
    /// What was decided.
    pub decisions: Vec<Decision>,
}

impl Resolved {
    /// Means over the given triangles, by area, of values of the triangles of `scene`, such as irradiance.
    pub fn on_given(&self, values: &[[f64; 3]]) -> Vec<[f64; 3]> {
        self.cut.on_given(values)
    }
}

/// Triangles that cutting adds at most.
const MOST_ADDED: usize = 20_000;

/// Resolves a scene: cuts its mesh where light varies within triangles, and chooses how direct light is computed. The result is that of the
/// geometry of the scene, of which triangles emit, and of what its settings state, whoever asks: backend, memory, threads and derivatives
/// have no part in it, but for [`ResolveOptions::moves`].
///
/// # Errors
/// Fails if the scene is invalid.
pub fn resolve(scene: &Scene, options: &ResolveOptions) -> Result<Resolved, SceneError> {
    scene.validate()?;
    let given = scene.triangles.len();
    let (mut resolved, cut) = match options.cut {
        true => {
            let most = options.max_triangles.min(given + MOST_ADDED);
            mesh::cut(scene, most, options.moves == Moves::Vertices)
        }
        false => (scene.clone(), Cut::none(scene)),
    };
    let count = resolved.triangles.len();
    let why_mesh = match (options.cut, count == given) {
        (false, _) => "as given, as stated".to_owned(),
        (_, true) => "as given: light hardly varies within triangles".to_owned(),
        _ => format!(
            "{given} given triangles are cut at contacts, near lamps, and where they reach further than light travels freely"
        ),
    };
    let stated = resolved.settings;
    let settings = &mut resolved.settings;
    let why_visibility = match (options.moves, stated.visibility) {
        (Moves::Vertices, VisibilityChoice::Explicit) => {
            settings.visibility = VisibilityChoice::Implicit;
            "positions are differentiated, of which rays have no derivatives yet: by antiradiance"
        }
        (_, VisibilityChoice::Explicit) => "by rays, as by default",
        (_, VisibilityChoice::Implicit) => "by antiradiance, as stated",
    };
    let (visibility, ray_error) = (settings.visibility, settings.ray_error);
    let (bins, near_field, tolerance) = (settings.bins, settings.near_field, settings.tolerance);
    let (lamps, why_lamps) = match stated.lamps {
        Lamps::Auto => {
            let (_, lamps, visibility) = direct_lamps(&resolved);
            let chosen = chosen(&lamps, visibility);
            match chosen.0 == Lamps::Sampled && options.moves != Moves::Nothing {
                true if lamps.len() <= FEW_LAMPS => (
                    Lamps::Exact,
                    "positions or cameras are differentiated, of which sampled light has no derivatives",
                ),
                true => (
                    Lamps::Antiradiance,
                    "positions or cameras are differentiated, and lamps are too many for exact visibility: with all other light",
                ),
                false => chosen,
            }
        }
        stated => (stated, "as stated"),
    };
    resolved.settings.lamps = lamps;
    let decision = |setting, value: String, why: &str| Decision { setting, value, why: why.to_owned() };
    let mut decisions = vec![
        decision("mesh", format!("{count} triangles"), &why_mesh),
        decision("visibility", visibility.to_string(), why_visibility),
        decision("lamps", lamps.to_string(), why_lamps),
        decision("bins", bins.to_string(), "of glossy triangles, and of all where visibility is implicit"),
        decision("tolerance", tolerance.to_string(), "relative residual of the solve"),
    ];
    decisions.push(match visibility {
        VisibilityChoice::Explicit => {
            decision("ray_error", ray_error.to_string(), "standard error of irradiance, relative to its mean")
        }
        VisibilityChoice::Implicit => decision(
            "near_field",
            near_field.to_string(),
            "in sizes of triangles, within which pairs are integrated",
        ),
    });
    Ok(Resolved { scene: resolved, cut, decisions })
}

/// What the choice of the plan is as a setting, and why.
fn chosen(lamps: &[Lamp], visibility: Visibility) -> (Lamps, &'static str) {
    match visibility {
        _ if lamps.is_empty() => {
            (Lamps::Antiradiance, "no lamp, or more than can be followed: with all other light")
        }
        Visibility::Exact => (Lamps::Exact, "few enough outlines stand in between"),
        Visibility::Sampled => (Lamps::Sampled, "by rays where more than a few outlines stand in between"),
        Visibility::Distributed => (Lamps::Sampled, "many lamps: rays are distributed over all of them"),
    }
}

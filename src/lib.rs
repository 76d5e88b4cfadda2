//! Differentiable directional radiosity with implicit visibility: global illumination of triangle scenes, with shadows,
//! on a Vulkan device or on the CPU; and the exact gradients of losses with respect to lights, materials, geometry and
//! cameras ([`Engine::backward`], [`render::Renderer::pull_back`]).
//!
//! The outgoing light is C = (1 - (K - J) U)⁻¹ E. E is the emission; U transports light between all pairs of triangles,
//! ignoring occlusion; K reflects it; J makes light that a triangle blocks leave its back as negative light,
//! *antiradiance*, which cancels what should not have passed (Dachsbacher et al., ACM TOG 26(3), 2007). The solvers
//! find the incident light H = U C.
//!
//! ```no_run
//! use antirad::backend::Backend;
//! use antirad::gpu::DeviceOptions;
//! use antirad::image::ToneMap;
//! use antirad::render::{RenderOptions, Renderer};
//! use antirad::scene::{LoadOptions, Scene};
//! use antirad::{Engine, SolveParams};
//! use std::path::Path;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let backend = Backend::open(None, &DeviceOptions::default())?;
//! let scene = Scene::load(Path::new("scenes/cornell_boxes.toml"), &LoadOptions::default())?;
//! let mut engine = Engine::builder(&backend, &scene).build()?;
//! let solution = engine.solve(&SolveParams::from(&scene.settings))?;
//! println!("irradiance of triangle 0: {:?} W/m²", solution.irradiance[0]);
//!
//! let renderer = Renderer::new(&backend, RenderOptions::default())?;
//! for picture in renderer.pictures(&mut engine, &solution, &scene, &scene.cameras)? {
//!     picture.write_png("room.png", &ToneMap::default())?;
//! }
//! # Ok(())
//! # }
//! ```
//!
//! Modules, in the order in which data passes through them: [`scene`] (validated input), [`plan`] (sizes and lists,
//! decided without a device), [`backend`] (where light is computed), [`transport`] (the operators U, K, J, S on it),
//! [`solve`] (solvers for any operator), [`Engine`] (all of these together), [`render`] (pictures). [`mod@reference`] is
//! the f64 twin against which both backends are tested, [`path_tracer`] the truth where there is none in closed form.
//! Units are SI; light is RGB.
//!
//! Threads: inputs and results can be shared, and so can a [`backend::Backend`], on which several engines can work at
//! once. An [`Engine`] belongs to one thread at a time.
#![warn(missing_docs)]

pub mod ambiguity;
pub mod backend;
#[cfg(feature = "cli")]
pub mod cli;
pub mod direct;
mod engine;
mod engine_builder;
mod engine_direct;
pub mod export;
pub mod fit;
pub mod gpu;
mod gradients;
mod gradients_direct;
pub mod image;
mod input;
pub mod model;
mod options;
pub mod output;
pub mod path_tracer;
pub mod plan;
pub mod ranks;
pub mod reference;
pub mod render;
mod revision;
pub mod scene;
pub mod shaders;
pub mod shading;
pub mod solve;
pub mod target_error;
pub mod transport;
pub mod usage;
pub mod warnings;
mod watch;

pub use engine::{Energy, Engine, EngineError, Negative, Solution, SolveParams};
pub use engine_builder::EngineBuilder;
/// The crate of the vector types in this API, in the version it uses.
pub use glam;
pub use gradients::{Cotangent, Gradients, MaterialGradients};
pub use watch::Watch;

/// What unit tests share with those in `tests/`, where this crate has its name.
#[cfg(test)]
extern crate self as antirad;
#[cfg(test)]
#[path = "../tests/support/kit/mod.rs"]
mod kit;

/// Which types of the API threads may share or send: a change that breaks this does not compile.
const _: () = {
    const fn moved<T: Send>() {}
    const fn shared<T: Send + Sync>() {}
    shared::<scene::Scene>();
    shared::<scene::SceneError>();
    shared::<plan::PlanOptions>();
    shared::<plan::Plan>();
    shared::<gpu::Device>();
    shared::<gpu::Buffer>();
    shared::<gpu::Pipeline>();
    shared::<gpu::GpuError>();
    shared::<gpu::ValidationLog>();
    shared::<Solution>();
    shared::<EngineError>();
    shared::<Cotangent>();
    shared::<Gradients>();
    shared::<image::Rasterizer>();
    shared::<image::Picture>();
    shared::<image::ImageError>();
    // A pass callback may be bound to one thread at a time; a recording batch always is.
    moved::<Engine>();
    shared::<backend::Backend>();
    moved::<Box<dyn transport::Operators>>();
    moved::<gpu::Batch>();
};

/// The snippets of README.md compile as they stand.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

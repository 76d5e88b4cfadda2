//! Directional radiosity with implicit visibility: how light spreads through a scene of triangles, over all bounces and
//! with shadows, on a Vulkan compute device; and the exact gradients of losses with respect to lights, materials, geometry
//! and cameras ([`Engine::backward`], [`image::geometry_gradient`]).
//!
//! What leaves the triangles is C = (1 - (K - J) U)⁻¹ E. E emits; U carries light between all pairs, through
//! everything; K reflects; J lets what a triangle blocks leave its back as negative light, *antiradiance*, which cancels
//! what should not have passed. The solvers find H = U C, what arrives.
//!
//! ```no_run
//! use antirad::gpu::{Device, DeviceOptions};
//! use antirad::image::{PictureOptions, Rasterizer, ToneMap};
//! use antirad::output::single;
//! use antirad::scene::{LoadOptions, Scene};
//! use antirad::{Engine, SolveParams};
//! use std::path::Path;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let device = Device::new(&DeviceOptions::default())?;
//! let scene = Scene::load(Path::new("scenes/cornell_boxes.toml"), &LoadOptions::default())?;
//! let mut engine = Engine::builder(&device, &scene).build()?;
//! let solution = engine.solve(&SolveParams::from(&scene.settings))?;
//! println!("{:?} W/m² arrive at triangle 0", solution.irradiance[0]);
//!
//! let camera = &scene.cameras[0];
//! let colours = single(&engine.face_colours(&solution, camera.position)?);
//! let options = PictureOptions::default();
//! let picture = Rasterizer::new(&device)?.render(&scene, camera, &colours, &options)?;
//! picture.write_png("room.png", &ToneMap::default())?;
//! # Ok(())
//! # }
//! ```
//!
//! In the order in which data passes: [`scene`] (what is given, checked), [`plan`] (what is to be done, without a device),
//! [`gpu`] (Vulkan), [`transport`] (the operators U, K, J, S on the device), [`solve`] (solvers, for any operator),
//! [`Engine`] (all of it together), [`image`] (pictures). [`mod@reference`] is the f64 twin that the kernels are tested
//! against. SI units, RGB.
//!
//! Threads: what is given and what comes out can be shared, and so can a [`gpu::Device`], on which several engines can work
//! at once. An [`Engine`] belongs to one thread at a time.
#![warn(missing_docs)]

pub mod ambiguity;
#[cfg(feature = "cli")]
pub mod cli;
mod engine;
mod engine_builder;
pub mod fit;
pub mod gpu;
mod gradients;
pub mod image;
mod input;
pub mod model;
mod options;
pub mod output;
pub mod plan;
pub mod reference;
mod revision;
pub mod scene;
pub mod shaders;
pub mod solve;
pub mod target_error;
pub mod transport;
pub mod warnings;
mod watch;

pub use engine::{Energy, Engine, EngineError, Negative, Solution, SolveParams};
pub use engine_builder::EngineBuilder;
/// The vectors of this interface, in the version that it takes.
pub use glam;
pub use gradients::{Cotangent, Gradients, MaterialGradients};
pub use watch::Watch;

/// What threads may do with the types of the API: a change that takes it away does not compile.
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
    // A watcher may be of one thread at a time, a recording batch always is.
    moved::<Engine>();
    moved::<transport::Operators>();
    moved::<gpu::Batch<'static>>();
};
/// The snippets of README.md compile as they stand.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

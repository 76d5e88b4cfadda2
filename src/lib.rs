//! antirad: differentiable directional radiosity with implicit visibility.
pub mod cli;
mod engine;
pub mod gpu;
pub mod image;
pub mod output;
pub mod plan;
pub mod reference;
pub mod scene;
pub mod shaders;
pub mod solve;
pub mod transport;

pub use engine::{Energy, Engine, EngineError, Negative, Solution, SolveParams};

//! antirad: differentiable directional radiosity with implicit visibility.
mod engine;
pub mod gpu;
pub mod plan;
pub mod reference;
pub mod scene;
pub mod shaders;
pub mod solve;
pub mod transport;

pub use engine::{Energy, Engine, EngineError, Negative, Solution, SolveParams};

//! The engine of antirad: the numerical model, plans, the operators on both backends, solvers and gradients. Programs use
//! it through the crate `antirad`.
#![warn(missing_docs)]

pub mod backend;
pub mod direct;
pub mod engine;
mod engine_builder;
mod engine_direct;
pub mod gradients;
mod gradients_direct;
pub mod model;
pub mod plan;
pub mod resolve;
mod revision;
mod rows;
pub mod shaders;
pub mod solve;
pub mod transport;

pub use engine::{Energy, Engine, EngineError, Negative, Solution, SolveParams};
pub use engine_builder::EngineBuilder;
pub use gradients::{Cotangent, Gradients, MaterialGradients};
pub use rows::RayError;

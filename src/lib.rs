//! antirad: differentiable directional radiosity with implicit visibility.
pub mod gpu;
pub mod plan;
pub mod reference;
pub mod scene;
pub mod shaders;
pub mod solve;

//! Pictures against geometry, on both backends, Vulkan under validation.

mod files;
mod gradients;
mod scenes;
mod shading;
#[path = "../support/mod.rs"]
mod support;
mod visibility;

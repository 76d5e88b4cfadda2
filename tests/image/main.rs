//! Pictures against geometry, on a Vulkan device under validation.

mod files;
mod gradients;
mod scenes;
mod shading;
mod visibility;

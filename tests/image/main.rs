//! Pictures, against what geometry says they must show, on a Vulkan device under validation.

mod files;
mod gradients;
mod scenes;
mod shading;
mod visibility;

//! Pictures by Vulkan kernels.

pub mod visibility;

//! How branches and triangles are numbered.

/// Branches of a node, triangles of a leaf.
pub const WIDTH: usize = 8;
/// The bit of a branch that leads to a leaf; the others are its index.
pub const LEAF: u32 = 1 << 31;
/// No branch, no triangle.
pub const NONE: u32 = u32::MAX;

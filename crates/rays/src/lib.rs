//! Rays among triangles: which is met first, what is between two points. It knows nothing of scenes or light.
//!
//! A hierarchy of eight branches a node ([`Node`]) leads to groups of eight triangles ([`Leaf`]), in f32, of which eight are tested at once. These
//! tests let too much pass and never too little; what passes is decided in f64 ([`Rays`]). Hits are therefore the same on every processor.
#![warn(missing_docs)]

#[cfg(target_arch = "x86_64")]
#[allow(
    unsafe_code,
    reason = "vector instructions that are found at run time; only in this file, each with its safety argument"
)]
mod avx2;
mod binned;
mod boxes;
mod frame;
mod lanes;
mod leaf;
mod nodes;
mod numbering;
mod ray;
mod rays;
mod shared;
#[cfg(test)]
mod tests;
mod traverse;

pub use boxes::Boxes;
pub use leaf::Leaf;
pub use nodes::Node;
pub use numbering::{LEAF, NONE, WIDTH};
pub use rays::{Rays, Side};

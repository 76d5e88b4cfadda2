//! Pictures on the CPU.

pub mod visibility;

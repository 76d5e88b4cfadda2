//! What every layer of antirad needs: files that are read and written whole, accounts of memory and time, ranks, and
//! the interruption of long work. Programs use it through the crate `antirad`.
#![warn(missing_docs)]

pub mod input;
pub mod npy;
mod options;
pub mod output;
pub mod parallel;
pub mod ranks;
pub mod usage;
mod watch;

pub use watch::Watch;

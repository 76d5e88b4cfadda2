//! Fitting scenes to pictures.

pub mod optimiser;

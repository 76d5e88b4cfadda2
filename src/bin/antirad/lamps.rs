//! `--lamp` and `--relight`: other factors of the light of lamps.

use crate::Failure;
use antirad::scene::{LampFactor, Scene};
use clap::Args;
use std::path::PathBuf;

/// Which lamps shine differently.
#[derive(Args)]
pub struct LampArguments {
    /// Multiply the light of a lamp: of the mesh or, if none of that name emits, the material; of suns by `sun`, `sun.2` … The factor is
    /// one number or R,G,B, and 0 switches it off; may be given several times
    #[arg(long, value_name = "NAME=FACTOR", value_parser = parse)]
    lamp: Vec<LampFactor>,
    /// Multiply the light of all lamps in a TOML file of `NAME = FACTOR`, such as the `relight.toml` of a fit
    #[arg(long, value_name = "FILE")]
    relight: Option<PathBuf>,
}

impl LampArguments {
    /// Changes the lamps of a scene; returns what was stated.
    pub fn apply(&self, scene: &mut Scene) -> Result<Vec<LampFactor>, Failure> {
        let mut factors = self.relight.as_deref().map(LampFactor::read).transpose()?.unwrap_or_default();
        factors.extend(self.lamp.iter().cloned());
        let before = scene.warnings.len();
        scene.scale_lamps(&factors)?;
        for warning in &scene.warnings[before..] {
            tracing::warn!("{warning}");
        }
        Ok(factors)
    }
}

fn parse(text: &str) -> Result<LampFactor, String> {
    let Some((name, factor)) = text.rsplit_once('=') else {
        return Err("NAME=FACTOR is expected, such as panel=0".to_owned());
    };
    let numbers: Option<Vec<f64>> = factor.split(',').map(|number| number.trim().parse().ok()).collect();
    let factor = match numbers.as_deref() {
        Some(&[grey]) => [grey; 3],
        Some(&[r, g, b]) => [r, g, b],
        _ => return Err("the factor must be one number, or three numbers R,G,B".to_owned()),
    };
    match factor.iter().find(|f| !(f.is_finite() && **f >= 0.0)) {
        Some(wrong) => Err(format!("the factor is {wrong}; it must be finite and 0 or more")),
        None => Ok(LampFactor::new(name, factor)),
    }
}

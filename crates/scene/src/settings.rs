//! Settings of a solve: bins, near field, lamps, tolerance, solver, precision, visibility.

use antirad_base::setters;
use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use serde::Deserialize;

use super::{BackendChoice, SceneError};

/// How a hemisphere is split into direction bins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BinLayout {
    /// `theta` rows of equal polar angle times `phi` sectors of equal azimuth.
    EqualAngle {
        /// Rows from the normal to the horizon.
        theta: u32,
        /// Sectors around the normal.
        phi: u32,
    },
    /// An `n` x `n` grid on the equal-area concentric map of the hemisphere onto a square, `n` even.
    Concentric {
        /// Cells along each side of the square.
        n: u32,
    },
}

impl BinLayout {
    /// Number of bins B.
    pub fn count(self) -> usize {
        match self {
            Self::EqualAngle { theta, phi } => theta as usize * phi as usize,
            Self::Concentric { n } => n as usize * n as usize,
        }
    }

    /// An error if a number is out of range.
    pub(super) fn validate(self) -> Result<(), String> {
        let within = |what: &str, number: u32, range: RangeInclusive<u32>| match range.contains(&number) {
            true => Ok(()),
            false => Err(format!("{what} = {number} is not in {} to {}", range.start(), range.end())),
        };
        match self {
            Self::EqualAngle { theta, phi } => {
                within("equal_angle bins: theta", theta, 2..=64)?;
                within("equal_angle bins: phi", phi, 3..=64)
            }
            Self::Concentric { n } if n % 2 == 1 => {
                Err(format!("concentric bins: n = {n} is odd; it must be even"))
            }
            Self::Concentric { n } => within("concentric bins: n", n, 2..=64),
        }
    }
}

/// `10x13` or `concentric:12`, which [`BinLayout::from_str`] reads back.
impl fmt::Display for BinLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::EqualAngle { theta, phi } => write!(f, "{theta}x{phi}"),
            Self::Concentric { n } => write!(f, "concentric:{n}"),
        }
    }
}

impl FromStr for BinLayout {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = match text.strip_prefix("concentric:") {
            Some(n) => n.parse().ok().map(|n| Self::Concentric { n }),
            None => text.split_once('x').and_then(|(theta, phi)| {
                Some(Self::EqualAngle { theta: theta.parse().ok()?, phi: phi.parse().ok()? })
            }),
        };
        let layout =
            parsed.ok_or_else(|| format!("bins `{text}`: expected THETAxPHI like 10x13, or concentric:N"))?;
        layout.validate()?;
        Ok(layout)
    }
}

/// How the light that comes straight from emitters is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Lamps {
    /// Sampled, but exact where visibility is implicit and shadows take at most several times as long as the solve; like all other light where
    /// lamps are more than can be followed.
    #[default]
    Auto,
    /// With exact visibility: shadows are as sharp as they are.
    Exact,
    /// With exact visibility, except where a lamp is seen between many blockers: there by rays, with noise,
    /// and without derivatives by positions.
    Sampled,
    /// Like all other light, through bins.
    Antiradiance,
}

/// How blockers keep light from what is behind them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum VisibilityChoice {
    /// By rays: for any scene, with a little noise, and without derivatives of indirect light by positions.
    #[default]
    Explicit,
    /// By antiradiance: differentiable by positions and without noise, for blockers that are few and large.
    Implicit,
}

impl fmt::Display for Lamps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Auto => "auto",
            Self::Exact => "exact",
            Self::Sampled => "sampled",
            Self::Antiradiance => "antiradiance",
        })
    }
}

impl fmt::Display for VisibilityChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Implicit => "implicit",
            Self::Explicit => "explicit",
        })
    }
}

/// Which solver to use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SolverChoice {
    /// GMRES where its basis fits the memory budget, else fixed-point iteration.
    #[default]
    Auto,
    /// Fixed-point iteration: one bounce per pass.
    FixedPoint,
    /// Restarted GMRES, with the longest basis that fits.
    Gmres,
}

/// Number format of the solve.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    /// Single precision: relative errors of about 1e-6 of irradiance.
    #[default]
    F32,
    /// Double precision, for validation: on a Vulkan device needs `shaderFloat64`; twice the memory and several times the time.
    F64,
}

impl Precision {
    /// Bytes of one number.
    pub fn bytes(self) -> u64 {
        match self {
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
        })
    }
}

/// Errors that may be asked of rays: no scene has the rays for less, and more says nothing of light.
const RAY_ERRORS: RangeInclusive<f64> = 1e-5..=0.5;

/// Settings that trade accuracy for time and memory.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct SolveSettings {
    /// How the hemisphere is split.
    pub bins: BinLayout,
    /// Pairs with r² < `near_field` · (s_i + s_j) / 2 are integrated over sub-triangles, s = Σl²/(4√3) being the
    /// area of the equilateral triangle with the same sum of squared edges. 0 switches the near field off.
    pub near_field: f64,
    /// How the light that comes straight from emitters is computed.
    pub lamps: Lamps,
    /// Relative area-weighted residual of irradiance at which the solve stops. It bounds that of radiosity and, unlike it,
    /// includes black surfaces.
    pub tolerance: f64,
    /// Passes (applications of U) after which the solve gives up.
    pub max_passes: u32,
    /// Which solver, or that the plan chooses it.
    pub solver: SolverChoice,
    /// Number format of the solve.
    pub precision: Precision,
    /// How blockers keep light from what is behind them.
    pub visibility: VisibilityChoice,
    /// Standard error of the irradiance that rays bring, relative to its mean over the area, where visibility is by rays.
    pub ray_error: f64,
    /// The backend that computes light.
    pub backend: BackendChoice,
}

setters!(SolveSettings {
    bins: BinLayout,
    near_field: f64,
    lamps: Lamps,
    tolerance: f64,
    max_passes: u32,
    solver: SolverChoice,
    precision: Precision,
    visibility: VisibilityChoice,
    ray_error: f64,
    backend: BackendChoice,
});

/// Checks a target error, if there is one.
///
/// # Errors
/// Fails if it does not lie between 0 and 1.
#[doc(hidden)]
pub fn check_target_error(error: Option<f64>) -> Result<(), SceneError> {
    match error {
        Some(error) if !(error > 0.0 && error < 1.0) => Err(SceneError::SolveSettings {
            message: format!("error = {error} must lie between 0 and 1; 0.02 is 2 %"),
        }),
        _ => Ok(()),
    }
}

impl SolveSettings {
    /// Checks the numbers of the settings.
    ///
    /// # Errors
    /// Fails if one is out of range.
    pub fn check(&self) -> Result<(), SceneError> {
        self.validate().map_err(|message| SceneError::SolveSettings { message })
    }

    fn validate(&self) -> Result<(), String> {
        self.bins.validate()?;
        if !(self.near_field >= 0.0 && self.near_field.is_finite()) {
            return Err(format!("near_field = {} must be 0 or more, and finite", self.near_field));
        }
        if !(self.tolerance > 0.0 && self.tolerance < 1.0) {
            return Err(format!("tolerance = {} must lie between 0 and 1", self.tolerance));
        }
        if self.max_passes == 0 {
            return Err(String::from("max_passes = 0 must be 1 or more"));
        }
        if !RAY_ERRORS.contains(&self.ray_error) {
            let (least, most) = (RAY_ERRORS.start(), RAY_ERRORS.end());
            return Err(format!("ray_error = {} is not in {least} to {most}; 0.005 is .5 %", self.ray_error));
        }
        Ok(())
    }
}

impl Default for SolveSettings {
    fn default() -> Self {
        Self {
            bins: BinLayout::EqualAngle { theta: 10, phi: 13 },
            near_field: 30.0,
            lamps: Lamps::Auto,
            tolerance: 1e-4,
            max_passes: 200,
            solver: SolverChoice::Auto,
            precision: Precision::F32,
            visibility: VisibilityChoice::default(),
            ray_error: 0.005,
            backend: BackendChoice::Auto,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_are_read_as_they_are_shown() {
        for text in ["10x13", "2x3", "64x64", "concentric:2", "concentric:12"] {
            assert_eq!(text.parse::<BinLayout>().map(|b| b.to_string()), Ok(text.to_owned()));
        }
        for text in
            ["", "10", "10x", "x13", "1x13", "10x2", "65x13", "concentric:", "concentric:7", "concentric:66"]
        {
            assert!(text.parse::<BinLayout>().is_err(), "{text}");
        }
    }
}

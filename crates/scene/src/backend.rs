//! Which of the two implementations of all operators computes light.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// The two implementations of all operators.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BackendKind {
    /// Vulkan compute kernels, on a GPU or on a driver for CPUs such as lavapipe.
    Vulkan,
    /// Rust on all cores of the CPU. Needs neither a Vulkan loader nor a driver.
    Cpu,
}

impl fmt::Display for BackendKind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::Vulkan => "vulkan",
            Self::Cpu => "cpu",
        })
    }
}

impl FromStr for BackendKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "vulkan" => Ok(Self::Vulkan),
            "cpu" => Ok(Self::Cpu),
            other => Err(format!("\"{other}\" is no backend: vulkan or cpu")),
        }
    }
}

impl From<BackendKind> for BackendChoice {
    fn from(kind: BackendKind) -> Self {
        match kind {
            BackendKind::Vulkan => Self::Vulkan,
            BackendKind::Cpu => Self::Cpu,
        }
    }
}

/// Which backend to open.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", try_from = "String")]
pub enum BackendChoice {
    /// Vulkan where there is a usable GPU, or where a device is named; otherwise the CPU.
    #[default]
    Auto,
    /// Vulkan, on whatever device there is.
    Vulkan,
    /// The CPU.
    Cpu,
}

impl BackendChoice {
    /// All choices, as they are written.
    pub const NAMES: [&str; 3] = ["auto", "vulkan", "cpu"];

    /// The choice in the environment variable ANTIRAD_BACKEND, if it holds one.
    pub fn of_environment() -> Option<Self> {
        std::env::var("ANTIRAD_BACKEND").ok()?.trim().parse().ok()
    }
}

impl FromStr for BackendChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            "vulkan" => Ok(Self::Vulkan),
            "cpu" => Ok(Self::Cpu),
            other => Err(format!("\"{other}\" is no backend: auto, vulkan or cpu")),
        }
    }
}

impl TryFrom<String> for BackendChoice {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl fmt::Display for BackendChoice {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(Self::NAMES[*self as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_are_written_as_they_are_read() {
        for (name, choice) in BackendChoice::NAMES.into_iter().zip([
            BackendChoice::Auto,
            BackendChoice::Vulkan,
            BackendChoice::Cpu,
        ]) {
            assert_eq!(name.parse(), Ok(choice));
            assert_eq!(choice.to_string(), name);
        }
        assert!("gpu".parse::<BackendChoice>().is_err_and(|why| why.contains("vulkan")));
    }
}

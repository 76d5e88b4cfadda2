//! The backend that a command line asks for.

use crate::backend::BackendChoice;
use crate::gpu::DeviceOptions;
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};

fn choices() -> impl TypedValueParser<Value = BackendChoice> {
    PossibleValuesParser::new(BackendChoice::NAMES).try_map(|name| name.parse::<BackendChoice>())
}

/// Where light is computed.
#[derive(Args, Clone, Debug, Default)]
pub struct BackendArguments {
    /// Where light is computed: cpu; vulkan, on whatever Vulkan device there is; or auto, on a GPU if there is one, otherwise on the CPU
    /// [default: that of the scene, or auto] [env: ANTIRAD_BACKEND]
    #[arg(long, value_name = "BACKEND", value_parser = choices())]
    pub backend: Option<BackendChoice>,
    /// Vulkan device, by its number or a part of its name (see `antirad devices`); it implies --backend vulkan [env: ANTIRAD_DEVICE]
    #[arg(long, value_name = "INDEX|NAME")]
    pub device: Option<String>,
}

impl BackendArguments {
    /// How to open it, within a memory budget.
    pub fn options(&self, memory_budget: Option<u64>) -> DeviceOptions {
        DeviceOptions::asked(&self.device, memory_budget)
    }
}

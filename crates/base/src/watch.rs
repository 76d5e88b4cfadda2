//! Interruption of long work.

use std::ops::ControlFlow;
use std::sync::Arc;

/// Called often during a solve; `Break` interrupts it.
pub type Watch = Arc<dyn Fn() -> ControlFlow<()> + Send + Sync>;

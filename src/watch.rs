//! Stopping long work from outside.

use std::ops::ControlFlow;
use std::sync::Arc;

/// Asked often during a solve: whether to go on.
pub type Watch = Arc<dyn Fn() -> ControlFlow<()> + Send + Sync>;

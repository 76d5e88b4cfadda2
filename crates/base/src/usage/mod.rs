//! What an engine uses of a device or of the CPU: memory by label, under a budget, and time by kernel.

mod memory;
mod profile;

pub use memory::{ALIGN, Bytes, LabelReport, MemoryReport, OverBudget, rounded};
pub use memory::{Ledger, ScopeId};
pub use profile::Profile;
pub use profile::ProfileRow;

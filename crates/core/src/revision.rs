//! Identifies the engine and the materials that a solution belongs to.

use std::sync::atomic::{AtomicU64, Ordering};

/// Equal for a solution and its engine until that engine takes other materials.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Revision {
    engine: u64,
    materials: u64,
}

/// How a revision differs from another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Difference {
    Engine,
    Materials,
}

impl Revision {
    /// The revision of a new engine.
    pub fn first() -> Self {
        static ENGINES: AtomicU64 = AtomicU64::new(0);
        Self { engine: ENGINES.fetch_add(1, Ordering::Relaxed), materials: 0 }
    }

    /// The revision of the same engine with other materials.
    #[must_use]
    pub fn next(self) -> Self {
        Self { materials: self.materials + 1, ..self }
    }

    pub fn difference(self, other: Self) -> Option<Difference> {
        match (self.engine == other.engine, self.materials == other.materials) {
            (true, true) => None,
            (true, false) => Some(Difference::Materials),
            (false, _) => Some(Difference::Engine),
        }
    }
}

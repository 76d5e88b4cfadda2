//! Memory for what is held from picture to picture, so that it need not be computed again.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes that may be held.
#[derive(Debug)]
pub struct Budget {
    free: AtomicU64,
}

/// A part of the budget, free again when this is dropped.
#[derive(Debug)]
pub struct Lease {
    budget: Arc<Budget>,
    bytes: u64,
}

impl Budget {
    pub fn new(bytes: u64) -> Arc<Self> {
        Arc::new(Self { free: AtomicU64::new(bytes) })
    }

    /// So many bytes of the budget; `None` if they are not free.
    pub fn take(self: &Arc<Self>, bytes: usize) -> Option<Lease> {
        let bytes = bytes as u64;
        let left = |free: u64| free.checked_sub(bytes);
        self.free.fetch_update(Ordering::Relaxed, Ordering::Relaxed, left).ok()?;
        Some(Lease { budget: self.clone(), bytes })
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        self.budget.free.fetch_add(self.bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_given_back_can_be_taken_again() {
        let budget = Budget::new(10);
        let first = budget.take(7).expect("budget");
        assert!(budget.take(4).is_none());
        assert!(budget.take(3).is_some());
        drop(first);
        assert!(budget.take(10).is_some());
    }
}

//! Memory in use, counted by label under a budget before it is allocated.

use std::collections::BTreeMap;
use std::fmt;

/// Buffer sizes are multiples of this many bytes: the largest alignment that Vulkan lets a device require of a storage
/// buffer's offset, so that the sizes a plan computes hold on every device.
pub const ALIGN: u64 = 256;

/// The bytes that a buffer of `bytes` takes. An empty one takes [`ALIGN`]: Vulkan has no empty buffers.
pub const fn rounded(bytes: u64) -> u64 {
    let blocks = bytes.div_ceil(ALIGN);
    if blocks == 0 { ALIGN } else { blocks.saturating_mul(ALIGN) }
}

/// A number of bytes that prints itself both rounded and exactly: `8.0 MiB (8388608 bytes)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Bytes(pub u64);

impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(bytes) = *self;
        let (unit, name) = match bytes {
            0..=1023 => return write!(f, "{bytes} bytes"),
            1024..=0xF_FFFF => (1u64 << 10, "KiB"),
            0x10_0000..=0x3FFF_FFFF => (1 << 20, "MiB"),
            _ => (1 << 30, "GiB"),
        };
        write!(f, "{:.1} {name} ({bytes} bytes)", bytes as f64 / unit as f64)
    }
}

/// The memory budget does not hold another array.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "\"{label}\" needs {requested}, but {in_use} of the budget of {budget} are in use; raise the budget or reduce the job"
)]
pub struct OverBudget {
    /// Label of the array.
    pub label: String,
    /// Size of the array, bytes.
    pub requested: Bytes,
    /// Bytes of all arrays so far.
    pub in_use: Bytes,
    /// The budget.
    pub budget: Bytes,
}

/// The memory in use under one label.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LabelReport {
    /// Label of the buffers.
    pub label: String,
    /// Their total size, each rounded up.
    pub bytes: u64,
    /// Number of buffers.
    pub count: u64,
}

/// Memory use of a device, bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MemoryReport {
    /// Budget of all buffers together.
    pub budget: u64,
    /// Size of all buffers now.
    /// Bytes in use.
    pub in_use: u64,
    /// The largest `in_use` so far.
    pub peak: u64,
    /// Memory taken from the driver: `in_use`, and what is free in the blocks that small buffers share.
    pub reserved: u64,
    /// Sorted by label.
    pub by_label: Vec<LabelReport>,
    /// Peak bytes of each label, labels freed since included.
    pub peak_by_label: Vec<(String, u64)>,
}

/// The counts.
#[derive(Default)]
pub struct Ledger {
    budget: u64,
    /// Bytes in use.
    pub in_use: u64,
    peak: u64,
    /// Bytes and number of buffers.
    labels: BTreeMap<String, (u64, u64)>,
    peaks: BTreeMap<String, u64>,
    /// Bytes and number of buffers, by their scope, then by label.
    scopes: BTreeMap<ScopeId, BTreeMap<String, (u64, u64)>>,
}

/// Who allocates: an engine, or a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct ScopeId(pub u64);

impl Ledger {
    /// An empty one.
    pub fn new(budget: u64) -> Self {
        Self { budget, ..Self::default() }
    }

    /// Counts a buffer in.
    ///
    /// # Errors
    ///
    /// Where the budget has no room for it; nothing is counted then.
    pub fn take(&mut self, scope: ScopeId, label: &str, bytes: u64) -> Result<(), OverBudget> {
        // Written without a sum, which could overflow, and without trusting that in_use <= budget.
        if bytes > self.budget.saturating_sub(self.in_use) {
            return Err(OverBudget {
                label: label.to_owned(),
                requested: Bytes(bytes),
                in_use: Bytes(self.in_use),
                budget: Bytes(self.budget),
            });
        }
        self.in_use += bytes;
        self.peak = self.peak.max(self.in_use);
        let own = self.scopes.entry(scope).or_default().entry(label.to_owned()).or_default();
        *own = (own.0 + bytes, own.1 + 1);
        let entry = self.labels.entry(label.to_owned()).or_default();
        *entry = (entry.0 + bytes, entry.1 + 1);
        let peak = self.peaks.entry(label.to_owned()).or_default();
        *peak = (*peak).max(entry.0);
        Ok(())
    }

    /// Counts a buffer out.
    pub fn give_back(&mut self, scope: ScopeId, label: &str, bytes: u64) {
        self.in_use = self.in_use.saturating_sub(bytes);
        forget(&mut self.labels, label, bytes);
        if let Some(own) = self.scopes.get_mut(&scope) {
            forget(own, label, bytes);
            if own.is_empty() {
                self.scopes.remove(&scope);
            }
        }
    }

    /// Forgets the peaks of the past.
    pub fn reset_peak(&mut self) {
        self.peak = self.in_use;
        self.peaks = self.labels.iter().map(|(label, &(bytes, _))| (label.clone(), bytes)).collect();
    }

    /// The counts, where `reserved` bytes are taken from the system.
    pub fn report(&self, reserved: u64) -> MemoryReport {
        MemoryReport {
            budget: self.budget,
            in_use: self.in_use,
            peak: self.peak,
            reserved,
            by_label: rows(&self.labels),
            peak_by_label: self.peaks.iter().map(|(label, &bytes)| (label.clone(), bytes)).collect(),
        }
    }

    /// Memory by label of one scope.
    pub fn report_of(&self, scope: ScopeId) -> Vec<LabelReport> {
        self.scopes.get(&scope).map(rows).unwrap_or_default()
    }
}

/// Removes one buffer of `bytes` from the counts.
fn forget(labels: &mut BTreeMap<String, (u64, u64)>, label: &str, bytes: u64) {
    if let Some(entry) = labels.get_mut(label) {
        *entry = (entry.0.saturating_sub(bytes), entry.1.saturating_sub(1));
        if entry.1 == 0 {
            labels.remove(label);
        }
    }
}

fn rows(labels: &BTreeMap<String, (u64, u64)>) -> Vec<LabelReport> {
    let row =
        |(label, &(bytes, count)): (&String, &(u64, u64))| LabelReport { label: label.clone(), bytes, count };
    labels.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_rounded_up() {
        let cases = [(0, 256), (1, 256), (256, 256), (257, 512), (u64::MAX, u64::MAX)];
        for (bytes, expected) in cases {
            assert_eq!(rounded(bytes), expected);
        }
    }

    #[test]
    fn bytes_print_for_people_and_exactly() {
        assert_eq!(Bytes(1000).to_string(), "1000 bytes");
        assert_eq!(Bytes(1536).to_string(), "1.5 KiB (1536 bytes)");
        assert_eq!(Bytes(8 << 20).to_string(), "8.0 MiB (8388608 bytes)");
    }

    #[test]
    fn ledger_counts_and_refuses() {
        let scope = ScopeId(3);
        let mut ledger = Ledger { budget: 1000, ..Ledger::default() };
        assert!(ledger.take(scope, "a", 600).is_ok());
        assert!(ledger.take(scope, "b", 401).is_err());
        assert!(ledger.take(scope, "b", u64::MAX).is_err());
        assert!(ledger.take(scope, "b", 400).is_ok());
        ledger.give_back(scope, "a", 600);
        assert_eq!((ledger.in_use, ledger.peak), (400, 1000));
        assert_eq!(ledger.labels.keys().collect::<Vec<_>>(), ["b"]);
        assert_eq!(ledger.peaks.keys().collect::<Vec<_>>(), ["a", "b"]);
        // A budget below what is in use must refuse, not wrap.
        ledger.budget = 100;
        assert!(ledger.take(scope, "c", 1).is_err());
    }

    #[test]
    fn scopes_are_counted_apart() {
        let (one, other) = (ScopeId(1), ScopeId(2));
        let mut ledger = Ledger { budget: 1000, ..Ledger::default() };
        for (scope, label, bytes) in [(one, "a", 100), (other, "a", 200), (one, "a", 10), (one, "b", 1)] {
            ledger.take(scope, label, bytes).unwrap();
        }
        assert_eq!(ledger.scopes[&one], BTreeMap::from([("a".into(), (110, 2)), ("b".into(), (1, 1))]));
        assert_eq!(ledger.scopes[&other], BTreeMap::from([("a".into(), (200, 1))]));
        assert_eq!((ledger.labels["a"], ledger.in_use), ((310, 3), 311));
        ledger.give_back(other, "a", 200);
        assert_eq!(ledger.scopes.keys().collect::<Vec<_>>(), [&one]);
        assert_eq!((ledger.labels["a"], ledger.in_use), ((110, 2), 111));
    }
}

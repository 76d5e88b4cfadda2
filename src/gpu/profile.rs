//! Where the device's time goes: one row for each kernel and shape of its work.

use std::collections::BTreeMap;

#[derive(Clone, Debug, PartialEq)]
pub struct ProfileRow {
    pub kernel: String,
    /// What the caller of the dispatch said about its size, e.g. "64x4096".
    pub shape: String,
    /// Number of dispatches.
    pub count: u64,
    /// Time on the device of all of them; 0 where it keeps no time.
    pub seconds: f64,
}

#[derive(Default)]
pub(super) struct Profile(BTreeMap<(&'static str, String), (u64, f64)>);

impl Profile {
    pub(super) fn add(&mut self, kernel: &'static str, shape: String, seconds: f64) {
        let entry = self.0.entry((kernel, shape)).or_default();
        *entry = (entry.0 + 1, entry.1 + seconds);
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// The most expensive first.
    pub(super) fn rows(&self) -> Vec<ProfileRow> {
        let rows = self.0.iter().map(|((kernel, shape), &(count, seconds))| ProfileRow {
            kernel: (*kernel).to_owned(),
            shape: shape.clone(),
            count,
            seconds,
        });
        let mut rows: Vec<_> = rows.collect();
        rows.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        rows
    }
}

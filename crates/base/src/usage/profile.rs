//! Time in use: one row for each kernel and shape of its work.

use std::collections::BTreeMap;
use std::fmt;

/// Time and work of one kernel under one shape.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ProfileRow {
    /// Name of the kernel: the shader's file without `.comp`.
    pub kernel: String,
    /// Size of the work as the caller of the dispatch labelled it, e.g. "64x4096".
    pub shape: String,
    /// Number of dispatches.
    pub count: u64,
    /// Their device time, s; 0 where the device has no timestamps.
    pub seconds: f64,
    /// Items of work done, as far as callers have credited them.
    pub items: u64,
    /// Bytes of buffer accesses for `items`, as far as callers have credited them.
    pub bytes: u64,
}

/// Totals of a kernel under one shape.
#[derive(Clone, Copy, Default)]
struct Work {
    count: u64,
    seconds: f64,
    items: u64,
    bytes: u64,
}

/// Time and work by kernel and shape.
#[derive(Default)]
pub struct Profile(BTreeMap<(&'static str, String), Work>);

impl Profile {
    /// Adds one run of a kernel.
    pub fn add(&mut self, kernel: &'static str, shape: String, seconds: f64) {
        let work = self.0.entry((kernel, shape)).or_default();
        work.count += 1;
        work.seconds += seconds;
    }

    /// Adds items and bytes to the work of a kernel.
    pub fn credit(&mut self, kernel: &'static str, shape: &str, items: u64, bytes: u64) {
        let work = self.0.entry((kernel, shape.to_owned())).or_default();
        work.items += items;
        work.bytes += bytes;
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// The most expensive first.
    pub fn rows(&self) -> Vec<ProfileRow> {
        let rows = self.0.iter().map(|((kernel, shape), work)| ProfileRow {
            kernel: (*kernel).to_owned(),
            shape: shape.clone(),
            count: work.count,
            seconds: work.seconds,
            items: work.items,
            bytes: work.bytes,
        });
        let mut rows: Vec<_> = rows.filter(|row| row.count > 0).collect();
        rows.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        rows
    }
}

impl fmt::Display for ProfileRow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:>8.3} s in {:>5} dispatches", self.seconds, self.count)?;
        match self.items > 0 && self.seconds > 0.0 {
            true => write!(
                f,
                ", {:>8.2} million pairs/s, {:>7.2} GB/s",
                1e-6 * self.items as f64 / self.seconds,
                1e-9 * self.bytes as f64 / self.seconds
            )?,
            false => write!(f, "{:39}", "")?,
        }
        write!(f, ": {}, {}", self.kernel, self.shape)
    }
}

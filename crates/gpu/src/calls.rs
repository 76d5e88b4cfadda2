//! Calls into Vulkan that the validation layer checks.
//!
//! The layer finds what it knows of an instance or a device in a table of all of them, which it reads in every call and does not lock
//! (version 1.3.239): where one is made or destroyed meanwhile, on another thread, a call may read what is no longer there. Under validation
//! such changes therefore wait until no call is under way, in the whole process, and calls until the change is done.

use super::lock;
use std::ops::Deref;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

/// A Vulkan object to call functions of. While this is there, no instance or device is made or destroyed under validation.
pub(super) struct Calls<'a, T> {
    of: &'a T,
    _call: Option<Call>,
}

impl<'a, T> Calls<'a, T> {
    pub fn of(of: &'a T, validates: bool) -> Self {
        Self { of, _call: validates.then(Call::begin) }
    }
}

impl<T> Deref for Calls<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.of
    }
}

struct Table {
    /// Calls under way; a thread may be in several.
    calls: usize,
    changes: bool,
    /// Threads that wait to change the table.
    waiting: usize,
}

static TABLE: Mutex<Table> = Mutex::new(Table { calls: 0, changes: false, waiting: 0 });
static FREE: Condvar = Condvar::new();

/// How long a call leaves precedence to a change that waits: not for good, since the change may wait for a call of the same thread.
const PRECEDENCE: Duration = Duration::from_millis(1);

/// Some calls.
pub(super) struct Call(());

impl Call {
    pub fn begin() -> Self {
        let mut table = lock(&TABLE);
        if table.waiting > 0 {
            let waited = FREE.wait_timeout_while(table, PRECEDENCE, |table| table.waiting > 0);
            table = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        table = FREE.wait_while(table, |table| table.changes).unwrap_or_else(PoisonError::into_inner);
        table.calls += 1;
        Self(())
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        lock(&TABLE).calls -= 1;
        FREE.notify_all();
    }
}

/// An instance or a device is made or destroyed. Must not be begun in a call.
pub(super) struct Change(());

impl Change {
    pub fn begin() -> Self {
        let mut table = lock(&TABLE);
        table.waiting += 1;
        let busy = |table: &mut Table| table.changes || table.calls > 0;
        table = FREE.wait_while(table, busy).unwrap_or_else(PoisonError::into_inner);
        table.waiting -= 1;
        table.changes = true;
        Self(())
    }
}

impl Drop for Change {
    fn drop(&mut self) {
        lock(&TABLE).changes = false;
        FREE.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn changes_are_alone_and_calls_may_nest() {
        let (calls, changes, most) = (AtomicUsize::new(0), AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for thread in 0..4 {
                let (calls, changes, most) = (&calls, &changes, &most);
                scope.spawn(move || {
                    for round in 0..50 {
                        if (thread + round) % 5 == 0 {
                            let _change = Change::begin();
                            assert_eq!(changes.fetch_add(1, Ordering::SeqCst), 0);
                            assert_eq!(calls.load(Ordering::SeqCst), 0);
                            std::thread::sleep(Duration::from_micros(50));
                            changes.fetch_sub(1, Ordering::SeqCst);
                        } else {
                            let _call = Call::begin();
                            most.fetch_max(1 + calls.fetch_add(1, Ordering::SeqCst), Ordering::SeqCst);
                            let _nested = Call::begin();
                            std::thread::sleep(Duration::from_micros(200));
                            assert_eq!(changes.load(Ordering::SeqCst), 0);
                            calls.fetch_sub(1, Ordering::SeqCst);
                        }
                    }
                });
            }
        });
        assert!(most.load(Ordering::SeqCst) > 1, "calls exclude each other");
    }
}

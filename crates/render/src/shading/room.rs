//! Memory for what is held from picture to picture, so that it need not be computed again.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes that may be held.
#[derive(Debug)]
pub struct Room {
    free: AtomicU64,
}

/// A part of the room, free again when this is dropped.
#[derive(Debug)]
pub struct Lease {
    room: Arc<Room>,
    bytes: u64,
}

impl Room {
    pub fn new(bytes: u64) -> Arc<Self> {
        Arc::new(Self { free: AtomicU64::new(bytes) })
    }

    /// So many bytes of the room; `None` if they are not free.
    pub fn take(self: &Arc<Self>, bytes: usize) -> Option<Lease> {
        let bytes = bytes as u64;
        let left = |free: u64| free.checked_sub(bytes);
        self.free.fetch_update(Ordering::Relaxed, Ordering::Relaxed, left).ok()?;
        Some(Lease { room: self.clone(), bytes })
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        self.room.free.fetch_add(self.bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_given_back_can_be_taken_again() {
        let room = Room::new(10);
        let first = room.take(7).expect("room");
        assert!(room.take(4).is_none());
        assert!(room.take(3).is_some());
        drop(first);
        assert!(room.take(10).is_some());
    }
}

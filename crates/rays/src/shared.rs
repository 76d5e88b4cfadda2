//! One hierarchy for all who ask for the same triangles.

use super::Rays;
use glam::DVec3;
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// The hierarchies that somebody has.
static KNOWN: Mutex<Vec<Weak<Rays>>> = Mutex::new(Vec::new());

impl Rays {
    /// [`Rays::among`], or the hierarchy of just these triangles that somebody still has.
    pub fn shared(corners: Vec<[DVec3; 3]>, solid: impl Fn(&u32) -> bool) -> Arc<Self> {
        let found = |known: &[Weak<Self>]| {
            known.iter().filter_map(Weak::upgrade).find(|rays| rays.is_among(&corners, &solid))
        };
        // Nothing is built while others wait: who builds may be given their work in between.
        let known = known(|known| known.clone());
        found(&known).unwrap_or_else(|| {
            let rays = Arc::new(Self::among(corners, solid));
            self::known(|known| {
                known.retain(|rays| rays.strong_count() > 0);
                known.push(Arc::downgrade(&rays));
            });
            rays
        })
    }
}

fn known<R>(with: impl FnOnce(&mut Vec<Weak<Rays>>) -> R) -> R {
    with(&mut KNOWN.lock().unwrap_or_else(PoisonError::into_inner))
}

//! One hierarchy for all who ask for the same triangles.

use super::Rays;
use glam::DVec3;
use std::sync::{Arc, Mutex, PoisonError};

/// The last hierarchy. Whoever works on a scene asks for its triangles again and again, where they are or a little farther.
static LAST: Mutex<Option<Arc<Rays>>> = Mutex::new(None);

impl Rays {
    /// [`Rays::among`], which all share who ask for the same triangles without others in between. Where these have only moved it is
    /// [refitted](Rays::refit). The last hierarchy stays in memory.
    pub fn shared(corners: Vec<[DVec3; 3]>, solid: impl Fn(&u32) -> bool) -> Arc<Self> {
        // Nothing is built while others wait: who builds may be given their work in between.
        let last = LAST.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let rays = match last.filter(|last| last.fits(&corners, &solid)) {
            Some(last) if last.is_at(&corners) => return last,
            Some(last) => {
                let mut moved = Arc::unwrap_or_clone(last);
                moved.refit(&corners);
                moved
            }
            None => Self::among(corners, solid),
        };
        let rays = Arc::new(rays);
        *LAST.lock().unwrap_or_else(PoisonError::into_inner) = Some(rays.clone());
        rays
    }
}

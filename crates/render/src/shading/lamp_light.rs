//! The light of lamps at points of a face, in as little memory as pictures and their derivatives need.

use super::budget::{Budget, Lease};
use antirad_core::direct::PointLight;
use glam::DVec3;
use std::borrow::Cow;
use std::sync::{Arc, OnceLock};

/// Light of lamps per radiance at points of one face: of each point, the lamps of which some arrives, in ascending order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LampLight {
    /// Where the lamps of each point end.
    ends: Box<[u32]>,
    lamps: Box<[u32]>,
    /// Irradiance, sr.
    irradiance: Box<[f64]>,
    /// Vector irradiance, sr; empty unless derivatives by geometry are wanted.
    vectors: Box<[DVec3]>,
}

impl LampLight {
    /// Of the vector irradiance at points of a face with this normal. `by_geometry`: whether derivatives by geometry are wanted.
    pub fn new(light: &[PointLight], normal: DVec3, by_geometry: bool) -> Self {
        let arrives = || light.iter().flatten().filter(|(_, phi)| *phi != DVec3::ZERO);
        let mut end = 0;
        let ends = light.iter().map(|of_lamps| {
            end += of_lamps.iter().filter(|(_, phi)| *phi != DVec3::ZERO).count() as u32;
            end
        });
        Self {
            ends: ends.collect(),
            lamps: arrives().map(|(lamp, _)| *lamp).collect(),
            irradiance: arrives().map(|(_, phi)| phi.dot(normal)).collect(),
            vectors: arrives().filter(|_| by_geometry).map(|(_, phi)| *phi).collect(),
        }
    }

    /// The lamps of a point, each with its irradiance and, for derivatives by geometry, its vector irradiance.
    pub fn at(&self, point: usize) -> impl Iterator<Item = (usize, f64, Option<DVec3>)> {
        let begin = point.checked_sub(1).map_or(0, |before| self.ends[before]);
        let of_lamp = |k: usize| (self.lamps[k] as usize, self.irradiance[k], self.vectors.get(k).copied());
        (begin as usize..self.ends[point] as usize).map(of_lamp)
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
            + size_of_val(&self.ends[..])
            + size_of_val(&self.lamps[..])
            + size_of_val(&self.irradiance[..])
            + size_of_val(&self.vectors[..])
    }
}

/// Where the light of a run of points is held once it is known, as far as there is room; clones share it.
#[derive(Clone, Debug)]
pub struct Cache {
    budget: Arc<Budget>,
    held: Arc<OnceLock<(LampLight, Lease)>>,
}

impl Cache {
    pub fn new(budget: Arc<Budget>) -> Self {
        Self { budget, held: Arc::default() }
    }

    pub fn get(&self) -> Option<&LampLight> {
        self.held.get().map(|(light, _)| light)
    }

    /// Holds the light if there is room.
    pub fn put(&self, light: LampLight) -> Cow<'_, LampLight> {
        match self.budget.take(light.bytes()) {
            Some(lease) => Cow::Borrowed(&self.held.get_or_init(|| (light, lease)).0),
            None => Cow::Owned(light),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_is_that_of_each_point_without_lamps_of_which_none_arrives() {
        let light = [vec![(0, DVec3::ZERO), (2, DVec3::Y)], vec![], vec![(1, DVec3::new(3.0, 0.5, 0.0))]];
        for by_geometry in [false, true] {
            let of_points = LampLight::new(&light, DVec3::Y, by_geometry);
            let at = |k: usize| of_points.at(k).collect::<Vec<_>>();
            let vector = |phi: DVec3| by_geometry.then_some(phi);
            assert_eq!(at(0), [(2, 1.0, vector(DVec3::Y))]);
            assert_eq!(at(1), []);
            assert_eq!(at(2), [(1, 0.5, vector(light[2][0].1))]);
        }
    }

    #[test]
    fn light_without_room_is_not_held() {
        let light = LampLight::new(&[vec![(0, DVec3::Y)]], DVec3::Y, false);
        let bytes = light.bytes();
        for (budget, held) in [(bytes, true), (bytes - 1, false)] {
            let cache = Cache::new(Budget::new(budget as u64));
            assert_eq!(*cache.put(light.clone()), light);
            assert_eq!(cache.get().is_some(), held);
        }
    }
}

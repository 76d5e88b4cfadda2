//! Incident and outgoing light of all triangles, by kind, and as runs of entries, one run per triangle.

use super::Model;
use antirad_core::model::Class;
use glam::DVec3;
use std::ops::{AddAssign, Range};

/// Incident light H, RGB.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Irradiance of each front, W/m².
    pub irradiance: Vec<DVec3>,
    /// Incident radiance per bin, H(b) / c_b, W/(m² sr), B entries for each triangle that has bins. In this form J is the
    /// identity: incident radiance at the front of a blocker is antiradiance A(b) of its back.
    pub bins: Vec<DVec3>,
}

/// Outgoing light C, RGB, W/(m² sr).
#[derive(Clone, Debug)]
pub struct Outgoing {
    /// Diffuse radiance of the front.
    pub diffuse: Vec<DVec3>,
    /// Specular radiance of the front per bin, in the slots of [`State::bins`].
    pub specular: Vec<DVec3>,
    /// A, antiradiance of the back per bin of the incident direction, in the slots of [`State::bins`].
    pub antiradiance: Vec<DVec3>,
}

/// Index of the irradiance in a run of incident light. The bins follow.
pub const IRRADIANCE: usize = 0;
/// Index of the first bin in a run of incident light.
pub const INCIDENT: usize = 1;
/// Index of the diffuse radiance in a run of outgoing light.
pub const DIFFUSE: usize = 0;
/// Index of the first bin of specular radiance in a run of outgoing light. The bins of antiradiance follow.
pub const SPECULAR: usize = 1;

/// The light of each triangle.
pub type Runs = Vec<Vec<DVec3>>;

impl State {
    pub(super) fn runs(&self, model: &Model) -> Runs {
        let run = |(j, irradiance): (usize, &DVec3)| {
            let bins = &self.bins[model.bins_of(j).unwrap_or(0..0)];
            [&[*irradiance], bins].concat()
        };
        self.irradiance.iter().enumerate().map(run).collect()
    }

    pub(super) fn of_runs(runs: &Runs) -> Self {
        let bins = runs.iter().flat_map(|run| &run[INCIDENT..]);
        Self { irradiance: runs.iter().map(|run| run[IRRADIANCE]).collect(), bins: bins.copied().collect() }
    }
}

impl State {
    pub(super) fn values(&self) -> impl Iterator<Item = &DVec3> {
        self.irradiance.iter().chain(&self.bins)
    }

    pub(super) fn values_mut(&mut self) -> impl Iterator<Item = &mut DVec3> {
        self.irradiance.iter_mut().chain(&mut self.bins)
    }
}

impl AddAssign<&Self> for Outgoing {
    fn add_assign(&mut self, other: &Self) {
        let add =
            |to: &mut [DVec3], from: &[DVec3]| to.iter_mut().zip(from).for_each(|(to, from)| *to += *from);
        add(&mut self.diffuse, &other.diffuse);
        add(&mut self.specular, &other.specular);
        add(&mut self.antiradiance, &other.antiradiance);
    }
}

impl Outgoing {
    pub(super) fn runs(&self, model: &Model) -> Runs {
        let run = |(i, diffuse): (usize, &DVec3)| {
            let bins = model.bins_of(i).unwrap_or(0..0);
            [&[*diffuse], &self.specular[bins.clone()], &self.antiradiance[bins]].concat()
        };
        self.diffuse.iter().enumerate().map(run).collect()
    }

    pub(super) fn of_runs(runs: &[Vec<DVec3>]) -> Self {
        let halves = || runs.iter().map(|run| run[SPECULAR..].split_at((run.len() - SPECULAR) / 2));
        Self {
            diffuse: runs.iter().map(|run| run[DIFFUSE]).collect(),
            specular: halves().flat_map(|(specular, _)| specular).copied().collect(),
            antiradiance: halves().flat_map(|(_, antiradiance)| antiradiance).copied().collect(),
        }
    }
}

impl Model {
    /// The bins of a triangle in [`State::bins`].
    pub fn bins_of(&self, triangle: usize) -> Option<Range<usize>> {
        self.slots[triangle].map(|first| first..first + self.bins.count())
    }

    /// A state without incident light.
    pub fn zero(&self) -> State {
        State::of_runs(&self.classes.iter().map(|class| self.unlit(*class)).collect())
    }

    /// No outgoing light.
    pub fn dark(&self) -> Outgoing {
        let State { irradiance: diffuse, bins } = self.zero();
        Outgoing { diffuse, specular: bins.clone(), antiradiance: bins }
    }

    /// A run without incident light.
    pub(super) fn unlit(&self, class: Class) -> Vec<DVec3> {
        vec![DVec3::ZERO; INCIDENT + if class.has_bins() { self.bins.count() } else { 0 }]
    }

    /// A run without outgoing light.
    pub(super) fn unsent(&self, class: Class) -> Vec<DVec3> {
        vec![DVec3::ZERO; SPECULAR + if class.has_bins() { 2 * self.bins.count() } else { 0 }]
    }
}

//! The classes of a pair of triangles.

use crate::model::Class;
use crate::plan::Plan;

/// The classes of a pair, as far as operators are specialised for them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    pub source: Class,
    pub receiver_bins: bool,
}

impl Shape {
    pub fn new(source: Class, receiver: Class) -> Self {
        Self { source, receiver_bins: receiver.has_bins() }
    }

    /// Whether either end has bins.
    pub fn any_bins(self) -> bool {
        self.source.has_bins() || self.receiver_bins
    }

    /// Name of the shape in the profile.
    pub fn name(self) -> &'static str {
        match (self.source.blocker, self.source.glossy, self.receiver_bins) {
            (false, false, false) => "fronts to irradiance",
            (true, false, false) => "fronts and backs to irradiance",
            (false, true, false) => "glossy fronts to irradiance",
            (true, true, false) => "glossy fronts and backs to irradiance",
            (false, false, true) => "fronts to bins",
            (true, false, true) => "fronts and backs to bins",
            (false, true, true) => "glossy fronts to bins",
            (true, true, true) => "glossy fronts and backs to bins",
        }
    }

    /// All shapes that occur in a planned scene.
    pub fn all(plan: &Plan) -> Vec<Self> {
        let mut shapes: Vec<Self> = Vec::new();
        for to in &plan.layout.groups {
            for from in &plan.layout.groups {
                let shape = Self::new(from.class, to.class);
                if !shapes.contains(&shape) {
                    shapes.push(shape);
                }
            }
        }
        shapes
    }
}

//! Shafts: bounds of all lines between some points and a lamp, which reject most blockers early (E. Haines and J. Wallace,
//! *Shaft Culling for Efficient Ray-Cast Radiosity*, 1991).

use super::polygon::mean;
use crate::model::{BoundedRun, orthonormal_basis};
use glam::DVec3;

/// Half-spaces ⟨normal, x⟩ <= offset whose intersection holds all lines from the points to the lamp.
pub struct Shaft {
    planes: Vec<(DVec3, f64)>,
}

/// Directions around the axis of the shaft.
const AROUND: usize = 8;

impl Shaft {
    /// Between points in front of a plane (a receiver's, through `points[0]` with `normal`) and the corners of a lamp. What does not
    /// rise more than `tolerance` above the planes of receiver and lamp is outside; `lamp_normal` is that of lamps in a plane.
    pub fn new(
        points: &[DVec3],
        normal: DVec3,
        lamp: &[DVec3],
        lamp_normal: Option<DVec3>,
        tolerance: f64,
    ) -> Self {
        let mut planes = vec![(-normal, -normal.dot(points[0]) - tolerance)];
        planes.extend(lamp_normal.map(|normal| (-normal, -normal.dot(lamp[0]) - tolerance)));
        let all = || points.iter().chain(lamp);
        let farthest = |n: DVec3| all().map(|x| n.dot(*x)).fold(f64::NEG_INFINITY, f64::max);
        let mut bound = |n: DVec3| planes.push((n, farthest(n)));
        for axis in DVec3::AXES {
            bound(axis);
            bound(-axis);
        }
        let (from, to) = (mean(points), mean(lamp));
        let length = (to - from).length();
        if length > 0.0 {
            let along = (to - from) / length;
            let frame = orthonormal_basis(along);
            let widest = |points: &[DVec3], n: DVec3, centre: DVec3| {
                points.iter().map(|x| n.dot(*x - centre)).fold(f64::NEG_INFINITY, f64::max)
            };
            for k in 0..AROUND {
                let (sin, cos) = (std::f64::consts::TAU * k as f64 / AROUND as f64).sin_cos();
                let across = frame.x_axis * cos + frame.y_axis * sin;
                // Tilted so that it touches both ends.
                let slope = (widest(lamp, across, from) - widest(points, across, from)) / length;
                bound(across - slope * along);
            }
        }
        Self { planes }
    }

    /// Whether a box is wholly outside.
    pub fn misses_box(&self, bounds: &BoundedRun) -> bool {
        self.planes.iter().any(|&(n, offset)| bounds.lowest(n) > offset)
    }

    /// Whether a polygon is wholly outside.
    pub fn misses(&self, corners: impl Iterator<Item = DVec3> + Clone) -> bool {
        self.planes.iter().any(|&(n, offset)| corners.clone().all(|c| n.dot(c) > offset))
    }
}

//! Triangles in f32, eight at once.

use super::frame::Frame;
use super::numbering::{NONE, WIDTH};
use bytemuck::{Pod, Zeroable};
use glam::DVec3;

/// By how much barycentric coordinates times the determinant may be off, in units of the longer edge.
///
/// Origins are within 2.3 of the middle and directions have length 1. The three products of an edge, a direction and the way to a corner (at
/// most 3.3) are off by 43, 39 and 24 roundings of at most 2⁻²⁴ times that edge, and one minus two of them by 116: 7e-6. A determinant with the
/// wrong sign is so small that the others, turned around, are off by 67 at most.
const SLACK: f64 = 1e-5;
/// By how much distances times the determinant may be off, in units of the longer edge squared: 36 roundings of the distance, and 60 of a limit
/// of at most [`FARTHEST`](super::ray::FARTHEST) times the determinant, 6e-6.
const SLACK_OF_DISTANCE: f64 = 1e-5;

/// Eight triangles in the frame of [`Node`](super::Node). In memory 96 words in this order, fit for a buffer of a device.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C, align(32))]
pub struct Leaf {
    /// x, y, z of the first corner of each.
    pub corner: [[f32; WIDTH]; 3],
    /// From there to the second and to the third.
    pub edges: [[[f32; WIDTH]; 3]; 2],
    /// How far outside counts as inside, since f32 may err: of barycentric coordinates times the determinant. Negative where there is no triangle:
    /// nothing is inside.
    pub slack: [f32; WIDTH],
    /// The same of distances times the determinant.
    pub slack_of_distance: [f32; WIDTH],
    /// Which triangle each is; [`NONE`] after the last.
    pub triangles: [u32; WIDTH],
}

impl Leaf {
    pub(crate) fn new(triangles: [u32; WIDTH], corners: &[[DVec3; 3]], frame: &Frame) -> Self {
        let mut leaf = Self { triangles, ..Self::zeroed() };
        leaf.place(corners, frame);
        leaf
    }

    /// Puts the triangles where their corners are.
    pub(crate) fn place(&mut self, corners: &[[DVec3; 3]], frame: &Frame) {
        for (k, triangle) in self.triangles.into_iter().enumerate() {
            let corners =
                corners.get(triangle as usize).filter(|corners| corners.iter().all(|c| c.is_finite()));
            let Some(&[a, b, c]) = corners else {
                (self.slack[k], self.slack_of_distance[k]) = (-1.0, -1.0);
                continue;
            };
            let edges = [b - a, c - a].map(|edge| edge * frame.scale);
            let at = frame.point(a).as_vec3();
            for axis in 0..3 {
                self.corner[axis][k] = at[axis];
                self.edges[0][axis][k] = edges[0][axis] as f32;
                self.edges[1][axis][k] = edges[1][axis] as f32;
            }
            let longer = edges[0].length().max(edges[1].length());
            // Products of tiny triangles may underflow.
            let with_underflow = |slack: f64| slack as f32 + f32::MIN_POSITIVE;
            self.slack[k] = with_underflow(SLACK * longer);
            self.slack_of_distance[k] = with_underflow(SLACK_OF_DISTANCE * longer * longer);
        }
    }

    /// The triangles that are there.
    pub(crate) fn held(&self) -> impl Iterator<Item = usize> + '_ {
        self.triangles.iter().filter(|&&triangle| triangle != NONE).map(|&triangle| triangle as usize)
    }
}

//! Derivatives of direct light with respect to the corners of receivers, blockers and lamps.
//!
//! With Φ = ∫ ω dω over the visible part, its boundary moves with the planes through the point and the edges in sight: for a side in the
//! plane with normal m, dΦ = ∫ ω ⟨ω, dm⟩ / |m| ds along its arc (Reynolds' transport theorem). Sides where the part was only cut in
//! two count twice with opposite signs.

use super::cone::{Side, arc_moment, sides, vector_irradiance};
use super::highlight::{Lobe, LobeGradient};
use super::visible::{Geometry, HORIZON, Placed, Planes, Visible, blocker_plane};
use crate::model::FacetGradient;
use glam::DVec3;

/// Derivatives with respect to triangles, as a list of contributions.
#[derive(Default)]
pub struct Contributions(Vec<(u32, FacetGradient)>);

impl Contributions {
    fn corner(&mut self, [triangle, corner]: [u32; 2], gradient: DVec3) {
        let mut own = FacetGradient::default();
        own.corners[corner as usize] = gradient;
        self.add(triangle, own);
    }

    pub fn add(&mut self, triangle: u32, gradient: FacetGradient) {
        self.0.push((triangle, gradient));
    }

    /// One entry per triangle.
    pub fn merged(mut self) -> Vec<(u32, FacetGradient)> {
        // Stable: sums have one order.
        self.0.sort_by_key(|&(triangle, _)| triangle);
        let mut merged: Vec<(u32, FacetGradient)> = Vec::new();
        for (triangle, gradient) in self.0 {
            match merged.last_mut() {
                Some((last, sum)) if *last == triangle => *sum += gradient,
                _ => merged.push((triangle, gradient)),
            }
        }
        merged
    }
}

/// A point that looks at a lamp through some triangles.
pub struct Sight<'a> {
    pub geometry: Geometry<'a>,
    pub point: DVec3,
    pub normal: DVec3,
    pub lamp: &'a Placed<'a>,
    /// Triangles that may be in between.
    pub blockers: &'a [u32],
}

impl Sight<'_> {
    /// Φ of the part of the lamp above the horizon that the point sees.
    pub fn vector_irradiance(&self, visible: &mut Visible) -> DVec3 {
        let mut sum = DVec3::ZERO;
        visible.parts(self, false, &mut |part| sum += vector_irradiance(part));
        sum
    }

    /// Adds the derivatives of a loss by the corners of blockers and lamp, where `cotangent` is its derivative by Φ; returns Φ and the
    /// derivatives by the point and by the normal, which tilts the horizon. (Light along the horizon adds nothing to irradiance: for a
    /// cotangent along the normal, the last is zero.)
    pub fn pull_back(
        &self,
        visible: &mut Visible,
        cotangent: DVec3,
        to: &mut Contributions,
    ) -> (DVec3, DVec3, DVec3) {
        let mut sum = DVec3::ZERO;
        let mut of_point = DVec3::ZERO;
        let mut of_normal = DVec3::ZERO;
        visible.parts(self, true, &mut |part: &[Side]| {
            sum += vector_irradiance(part);
            for (plane, arc) in sides(part) {
                let moment = arc_moment(arc, cotangent);
                match plane {
                    HORIZON => of_normal += moment,
                    plane => of_point += self.side(plane, arc, moment, to),
                }
            }
        });
        (sum, of_point, of_normal)
    }

    /// ∫ ⟨h, n⟩^p cosθ dω of the part of the lamp that the point sees.
    pub fn highlight(&self, visible: &mut Visible, lobe: &Lobe) -> f64 {
        let mut sum = 0.0;
        visible.parts(self, false, &mut |part| sum += lobe.integral(part));
        sum
    }

    /// As [`Self::pull_back`], of [`Self::highlight`]; returns it with its derivatives by the lobe, and that of the loss by the point as far
    /// as the visible part depends on it.
    pub fn pull_back_highlight(
        &self,
        visible: &mut Visible,
        lobe: &Lobe,
        cotangent: f64,
        to: &mut Contributions,
    ) -> (f64, LobeGradient, DVec3) {
        let mut sum = 0.0;
        let mut slopes = LobeGradient::default();
        let mut of_point = DVec3::ZERO;
        visible.parts(self, true, &mut |part: &[Side]| {
            let (value, by_lobe) = lobe.slopes(part);
            sum += value;
            slopes.normal += by_lobe.normal;
            slopes.eye += by_lobe.eye;
            slopes.power += by_lobe.power;
            for (plane, arc, moment) in lobe.arcs(part) {
                of_point += self.side(plane, arc, cotangent * moment, to);
            }
        });
        (sum, slopes, of_point)
    }

    /// Adds the derivatives by the corners that a side's plane passes through, and returns that by the point; `moment`: derivative by the
    /// normal of that plane if its length is one and it points into the part.
    fn side(&self, plane: u32, arc: [DVec3; 2], moment: DVec3, to: &mut Contributions) -> DVec3 {
        match blocker_plane(plane) {
            _ if plane == HORIZON => DVec3::ZERO,
            Some((place, which)) => self.blocker(self.blockers[place], which, arc, moment, to),
            None => self.lamp_side(plane as usize, moment, to),
        }
    }

    fn offset(&self, [triangle, corner]: [u32; 2]) -> DVec3 {
        self.geometry.facets[triangle as usize].corners[corner as usize] - self.point
    }

    /// The plane through the point and two corners.
    fn edge(&self, [from, to]: [[u32; 2]; 2], by_normal: DVec3, out: &mut Contributions) -> DVec3 {
        let (p, q) = (self.offset(from), self.offset(to));
        let (by_p, by_q) = (q.cross(by_normal), by_normal.cross(p));
        out.corner(from, by_p);
        out.corner(to, by_q);
        -(by_p + by_q)
    }

    fn lamp_side(&self, side: usize, moment: DVec3, out: &mut Contributions) -> DVec3 {
        let outline = &self.lamp.lamp.outline;
        // The lamp's front is seen clockwise.
        let ends = [outline[(side + 1) % outline.len()], outline[side]];
        let normal = self.offset(ends[0]).cross(self.offset(ends[1]));
        self.edge(ends, moment / normal.length(), out)
    }

    fn blocker(
        &self,
        triangle: u32,
        which: usize,
        [a, b]: [DVec3; 2],
        moment: DVec3,
        out: &mut Contributions,
    ) -> DVec3 {
        let corners = [0, 1, 2].map(|k| self.offset([triangle, k]));
        let over_lamp = self.lamp.corners[0] - self.point;
        let tolerance = self.geometry.tolerance();
        let Some(Planes { normals, sign, .. }) =
            Planes::new(&corners, over_lamp, self.lamp.normal, tolerance)
        else {
            return DVec3::ZERO;
        };
        let normal = normals[which];
        let inwards = if a.cross(b).dot(normal) > 0.0 { 1.0 } else { -1.0 };
        let by_normal = moment * (inwards * sign / normal.length());
        match which {
            3 => self.crossing(triangle, corners, by_normal, out),
            k => self.edge([[triangle, k as u32], [triangle, (k as u32 + 1) % 3]], by_normal, out),
        }
    }

    /// The plane through the point and the line in which a triangle crosses the lamp's plane: m = h_L A - h n_L, with the heights of the
    /// point over the two planes, the triangle's area vector A and the lamp's normal.
    fn crossing(
        &self,
        triangle: u32,
        [a, b, c]: [DVec3; 3],
        by_normal: DVec3,
        out: &mut Contributions,
    ) -> DVec3 {
        let lamp_corner = self.lamp.lamp.corners[0];
        let (l, lamp_normal) = (self.offset(lamp_corner), self.lamp.normal);
        let area_vector = (b - a).cross(c - a);
        let (lamp_height, height) = (-l.dot(lamp_normal), -area_vector.dot(a));
        let (by_lamp_height, by_height) = (by_normal.dot(area_vector), -by_normal.dot(lamp_normal));
        let by_area_vector = lamp_height * by_normal - by_height * a;
        let by_lamp_normal = -height * by_normal - by_lamp_height * l;
        let (by_a, by_l) = (-by_height * area_vector, -by_lamp_height * lamp_normal);
        let (at_b, at_c) = ((c - a).cross(by_area_vector), by_area_vector.cross(b - a));
        let corners = [by_a - at_b - at_c, at_b, at_c];
        out.add(triangle, FacetGradient { corners, ..FacetGradient::default() });
        let normal = FacetGradient { normal: by_lamp_normal, ..FacetGradient::default() };
        out.add(self.lamp.lamp.triangles[0], normal);
        out.corner(lamp_corner, by_l);
        -(by_a + by_l)
    }
}

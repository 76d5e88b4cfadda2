//! Derivatives of direct light with respect to the corners of receivers, blockers and lamps.
//!
//! With Φ = ∫ ω dω over the visible part, its boundary moves with the planes through the point and the edges in sight: for a side in the
//! plane with normal m, dΦ = ∫ ω ⟨ω, dm⟩ / |m| ds along its arc (Reynolds' transport theorem). Sides where the part was only cut in
//! two count twice with opposite signs.

use super::cone::{Side, arc_moment, sides, vector_irradiance};
use super::highlight::{Lobe, LobeGradient};
use super::polygon::Polygon;
use super::visible::{
    CROSSING, EDGES, Geometry, HORIZON, Placed, UPRIGHT, View, Visible, blocker_plane, of_blocker,
};
use crate::model::FacetGradient;
use glam::DVec3;
use std::borrow::Cow;

/// What a part adds to Φ, without the sides in which it touches other parts: those of two parts cancel.
fn of_boundary(part: &[Side]) -> DVec3 {
    vector_irradiance(sides(part).filter(|(plane, _)| *plane != UPRIGHT))
}

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
    pub lamp: Cow<'a, Placed<'a>>,
    /// Polygons that may be in between.
    pub blockers: &'a [u32],
    /// How much of the light that passes these arrives.
    pub share: f64,
}

impl Sight<'_> {
    /// Vector irradiance Φ = ∫ ω dω over the directions above the horizon in which the point sees the lamp,
    /// sr.
    pub fn vector_irradiance(&self, visible: &mut Visible) -> DVec3 {
        let mut sum = DVec3::ZERO;
        if self.share > 0.0 {
            visible.parts(self, false, &mut |part| sum += of_boundary(part));
        }
        self.share * sum
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
        let cotangent = self.share * cotangent;
        let mut sum = DVec3::ZERO;
        let mut of_point = DVec3::ZERO;
        let mut of_normal = DVec3::ZERO;
        let mut with_vertices = Vec::new();
        visible.parts(self, true, &mut |part: &[Side]| {
            let part = self.with_vertices(part, &mut with_vertices);
            sum += of_boundary(part);
            for (plane, arc) in sides(part) {
                let moment = arc_moment(arc, cotangent);
                match plane {
                    HORIZON => of_normal += moment,
                    plane => of_point += self.side(plane, arc, moment, to),
                }
            }
        });
        (self.share * sum, of_point, of_normal)
    }

    /// ∫ ⟨h, n⟩^p cosθ dω over the directions in which the point sees the lamp.
    pub fn highlight(&self, visible: &mut Visible, lobe: &Lobe) -> f64 {
        let mut sum = 0.0;
        if self.share > 0.0 {
            visible.parts(self, false, &mut |part| sum += lobe.integral(part));
        }
        self.share * sum
    }

    /// Adds the derivatives of a loss by the corners of blockers and lamp, where `cotangent` is its
    /// derivative by [`Self::highlight`]. Returns the highlight, its derivatives by the lobe, and the
    /// derivative of the loss by the point, as far as the visible directions depend on it.
    pub fn pull_back_highlight(
        &self,
        visible: &mut Visible,
        lobe: &Lobe,
        cotangent: f64,
        to: &mut Contributions,
    ) -> (f64, LobeGradient, DVec3) {
        let cotangent = self.share * cotangent;
        let mut sum = 0.0;
        let mut slopes = LobeGradient::default();
        let mut of_point = DVec3::ZERO;
        let mut with_vertices = Vec::new();
        visible.parts(self, true, &mut |part: &[Side]| {
            let part = self.with_vertices(part, &mut with_vertices);
            let (value, by_lobe) = lobe.slopes(part);
            sum += value;
            slopes.normal += by_lobe.normal;
            slopes.eye += by_lobe.eye;
            slopes.power += by_lobe.power;
            for (plane, arc, moment) in lobe.arcs(part) {
                of_point += self.side(plane, arc, cotangent * moment, to);
            }
        });
        slopes.normal *= self.share;
        slopes.eye *= self.share;
        slopes.power *= self.share;
        (self.share * sum, slopes, of_point)
    }

    /// A part with corners where edges of blockers have vertices: there, planes go by the pieces of outlines.
    fn with_vertices<'b>(&self, part: &[Side], out: &'b mut Vec<Side>) -> &'b [Side] {
        out.clear();
        for (side, [a, b]) in part.iter().zip(sides(part).map(|(_, ends)| ends)) {
            match of_blocker(side.plane) {
                Some((place, which))
                    if which != CROSSING && self.polygon(place).edge(which - EDGES).len() > 1 =>
                {
                    self.cut_at_vertices(place, which - EDGES, *side, [a, b], out);
                }
                _ => out.push(*side),
            }
        }
        out
    }

    /// Appends a side from `a` to `b` in the plane of an edge of a blocker, cut at the vertices of the edge. What lies beyond both ends of
    /// the edge stays in the plane of the whole edge: such sides are those of two parts, whose derivatives cancel.
    fn cut_at_vertices(
        &self,
        place: usize,
        edge: usize,
        side: Side,
        [a, b]: [DVec3; 2],
        out: &mut Vec<Side>,
    ) {
        let polygon = self.polygon(place);
        let numbers = polygon.edge(edge);
        let vertices: Vec<DVec3> =
            (numbers.start..=numbers.end).map(|number| self.offset(polygon.vertex(number))).collect();
        // A direction between two others, as a fraction of the line that joins them.
        let between = |[a, b]: [DVec3; 2], direction: DVec3| {
            let normal = a.cross(b);
            let (by_a, by_b) = (direction.cross(b).dot(normal), a.cross(direction).dot(normal));
            (by_a > 0.0 && by_b > 0.0).then(|| by_b / (by_a + by_b))
        };
        let mut cuts: Vec<f64> = vertices.iter().filter_map(|&vertex| between([a, b], vertex)).collect();
        cuts.sort_by(f64::total_cmp);
        let starts = [0.0].into_iter().chain(cuts.iter().copied());
        for (start, end) in starts.zip(cuts.iter().copied().chain([1.0])) {
            let middle = a.lerp(b, f64::midpoint(start, end));
            let piece = vertices.windows(2).position(|ends| between([ends[0], ends[1]], middle).is_some());
            let plane = piece.map_or(side.plane, |piece| {
                blocker_plane(place, (numbers.start + piece) % polygon.outline.len())
            });
            out.push(Side { corner: if start > 0.0 { a.lerp(b, start) } else { a }, plane });
        }
    }

    /// The blocker at a place in the list.
    fn polygon(&self, place: usize) -> &Polygon {
        self.geometry.blockers.polygon(self.blockers[place])
    }

    /// Adds the derivatives by the corners that a side's plane passes through, and returns that by the point; `moment`: derivative by the
    /// normal of that plane if its length is one and it points into the part.
    fn side(&self, plane: u32, arc: [DVec3; 2], moment: DVec3, to: &mut Contributions) -> DVec3 {
        match of_blocker(plane) {
            _ if plane == HORIZON || plane == UPRIGHT => DVec3::ZERO,
            Some((place, which)) => self.blocker(self.polygon(place), which, arc, moment, to),
            None => self.lamp_side(plane as usize, moment, to),
        }
    }

    fn offset(&self, corner: [u32; 2]) -> DVec3 {
        self.geometry.corner(corner) - self.point
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
        // The outline of a sun stays where it is.
        let Some(surface) = self.lamp.lamp.surface() else { return DVec3::ZERO };
        let outline = &surface.outline;
        // The lamp's front is seen clockwise.
        let ends = [outline[(side + 1) % outline.len()], outline[side]];
        let normal = self.offset(ends[0]).cross(self.offset(ends[1]));
        self.edge(ends, moment / normal.length(), out)
    }

    /// The plane through the point and a piece of a blocker's outline, an edge, or that of [`CROSSING`].
    fn blocker(
        &self,
        polygon: &Polygon,
        which: usize,
        [a, b]: [DVec3; 2],
        moment: DVec3,
        out: &mut Contributions,
    ) -> DVec3 {
        let triangle = polygon.first() as u32;
        let corners = [0, 1, 2].map(|k| self.offset([triangle, k]));
        let Some(view) = View::new(corners) else { return DVec3::ZERO };
        let ends = match which {
            CROSSING => None,
            EDGES.. => {
                let edge = polygon.edge(which - EDGES);
                Some([edge.start, edge.end].map(|number| polygon.vertex(number)))
            }
            piece => Some([piece, piece + 1].map(|number| polygon.vertex(number))),
        };
        let normal = match ends {
            Some([from, to]) => view.sign * self.offset(from).cross(self.offset(to)),
            None => view.crossing(self.lamp.corners[0] - self.point, self.lamp.normal),
        };
        let inwards = if a.cross(b).dot(normal) > 0.0 { 1.0 } else { -1.0 };
        let by_normal = moment * (inwards * view.sign / normal.length());
        match ends {
            Some(ends) => self.edge(ends, by_normal, out),
            None => self.crossing(triangle, corners, by_normal, out),
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
        // Nothing reaches the plane of a sun.
        let Some(surface) = self.lamp.lamp.surface() else { return DVec3::ZERO };
        let lamp_corner = surface.corners[0];
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
        // The plane of a silhouette counts as fixed: little stands at it.
        if let Some(plane) = self.lamp.plane {
            out.add(plane, FacetGradient { normal: by_lamp_normal, ..FacetGradient::default() });
        }
        out.corner(lamp_corner, by_l);
        -(by_a + by_l)
    }
}

//! The part of a plane between some edges that no region covers, cut into trapezoids with two vertical sides (the vertical decomposition of
//! M. de Berg et al., *Computational Geometry*, 2008, section 6.1, by a sweep).
//!
//! Regions are given by the edges of their boundaries. How many regions cover a point is the sum of the steps of the edges below it: it takes
//! no order of the edges of a region, an edge between two regions that no gap separates may be left out of both, and one that bounds both from
//! the same side may be a single edge of twice the step.

/// Relative distance within which edges count as touching.
const TOUCHING: f64 = 1e-12;
/// How often a strip between two ends of edges is cut where edges cross.
const DEEPEST: u32 = 64;

/// A boundary that is not vertical: a line over an interval.
#[derive(Clone, Copy, Debug)]
pub struct Edge {
    /// Where it begins and ends, in ascending order.
    pub s: [f64; 2],
    /// Its heights there.
    pub t: [f64; 2],
    /// By how many the regions above it are more than those below.
    pub step: i32,
    /// Whether that is the frame within which trapezoids are wanted, and not a region to leave out.
    pub frame: bool,
    /// The number of its plane.
    pub plane: u32,
}

/// A part that nothing covers, above one edge and below another.
#[derive(Clone, Copy, Debug)]
pub struct Trapezoid {
    pub s: [f64; 2],
    /// Heights at both ends, and the number of the plane.
    pub low: ([f64; 2], u32),
    pub high: ([f64; 2], u32),
}

/// An edge over the strip that is being swept.
#[derive(Clone, Copy)]
struct Active {
    edge: u32,
    /// Its line, s0, t0 and slope, and where it ends.
    line: [f64; 3],
    end: [f64; 2],
    /// Heights at both sides of the last strip, and where that ended.
    t: [f64; 2],
    s: f64,
}

impl Active {
    fn new(number: u32, edge: &Edge) -> Self {
        let ([s0, s1], [t0, t1]) = (edge.s, edge.t);
        Self { edge: number, line: [s0, t0, (t1 - t0) / (s1 - s0)], end: [s1, t1], t: [0.0; 2], s: f64::NAN }
    }

    /// At its ends, its heights to the last bit.
    fn at(&self, s: f64) -> f64 {
        let ([s0, t0, slope], [s1, t1]) = (self.line, self.end);
        if s >= s1 { t1 } else { t0 + slope * (s - s0) }
    }

    /// Whether it is to come after another one, by their heights in the middle.
    fn is_above(&self, other: &Self) -> bool {
        let (own, others) = (self.t[0] + self.t[1], other.t[0] + other.t[1]);
        own > others || own == others && self.edge > other.edge
    }
}

/// A trapezoid that goes on from strip to strip.
#[derive(Clone, Copy)]
struct Open {
    edges: [u32; 2],
    s: [f64; 2],
}

/// Finds trapezoids; keeps its memory.
#[derive(Default)]
pub struct Trapezoids {
    pub edges: Vec<Edge>,
    ends: Vec<f64>,
    active: Vec<Active>,
    open: Vec<Open>,
    next: Vec<Open>,
    /// Edges looked at so far.
    pub visits: u64,
}

impl Trapezoids {
    /// Calls `emit` with the trapezoids between `edges`.
    pub fn emit(&mut self, emit: &mut dyn FnMut(&Trapezoid)) {
        self.edges.retain(|edge| edge.s[0] < edge.s[1]);
        self.edges.sort_unstable_by(|a, b| a.s[0].total_cmp(&b.s[0]));
        self.ends.clear();
        self.ends.extend(self.edges.iter().flat_map(|edge| edge.s));
        self.ends.sort_unstable_by(f64::total_cmp);
        self.ends.dedup();
        self.active.clear();
        self.open.clear();
        let mut waiting = 0;
        for strip in 1..self.ends.len() {
            let [from, to] = [self.ends[strip - 1], self.ends[strip]];
            let edges = &self.edges;
            self.active.retain(|active| active.end[0] > from);
            while edges.get(waiting).is_some_and(|edge| edge.s[0] <= from) {
                self.active.push(Active::new(waiting as u32, &edges[waiting]));
                waiting += 1;
            }
            self.strip([from, to], DEEPEST, emit);
        }
        self.end_open(emit, |_| true);
    }

    /// A strip in which no edge begins or ends.
    fn strip(&mut self, [from, to]: [f64; 2], depth: u32, emit: &mut dyn FnMut(&Trapezoid)) {
        let edges = &self.edges;
        self.visits += self.active.len() as u64;
        for active in &mut self.active {
            // Strips come one after the other.
            let begin = if active.s == from { active.t[1] } else { active.at(from) };
            (active.s, active.t) = (to, [begin, active.at(to)]);
        }
        // From strip to strip few edges change their places.
        for k in 1..self.active.len() {
            let active = self.active[k];
            let mut place = k;
            while place > 0 && self.active[place - 1].is_above(&active) {
                self.active[place] = self.active[place - 1];
                place -= 1;
            }
            self.active[place] = active;
        }
        if let Some(crossing) = self.crossing([from, to]).filter(|_| depth > 0) {
            self.strip([from, crossing], depth - 1, emit);
            self.strip([crossing, to], depth - 1, emit);
            return;
        }
        self.next.clear();
        let (mut frames, mut covers, mut low) = (0, 0, None);
        for active in &self.active {
            let edge = &edges[active.edge as usize];
            if edge.frame {
                frames += edge.step
            } else {
                covers += edge.step
            }
            match low {
                None if frames > 0 && covers <= 0 => low = Some(active),
                Some(&Active { edge, t: [t0, t1], .. }) if frames <= 0 || covers > 0 => {
                    let [above0, above1] = active.t;
                    if above0 - t0 + (above1 - t1) > 2.0 * TOUCHING * (1.0 + t0.abs()) {
                        self.next.push(Open { edges: [edge, active.edge], s: [from, to] });
                    }
                    low = None;
                }
                _ => {}
            }
        }
        let mut begun = std::mem::take(&mut self.next);
        self.end_open(emit, |open| {
            match begun.iter_mut().find(|next| next.edges == open.edges && open.s[1] == from) {
                Some(next) => {
                    next.s[0] = open.s[0];
                    false
                }
                None => true,
            }
        });
        std::mem::swap(&mut self.open, &mut begun);
        self.next = begun;
    }

    /// Where the first two edges cross that are neighbours in the middle of a strip, and not in the same order at its ends.
    fn crossing(&self, [from, to]: [f64; 2]) -> Option<f64> {
        self.active.windows(2).find_map(|pair| {
            let gaps = [0, 1].map(|side| pair[1].t[side] - pair[0].t[side]);
            let tolerance = TOUCHING * (1.0 + pair[0].t[0].abs());
            if gaps[0].min(gaps[1]) >= -tolerance {
                return None;
            }
            let at = from + (to - from) * (gaps[0] / (gaps[0] - gaps[1]));
            (at > from && at < to).then_some(at)
        })
    }

    /// Emits the open trapezoids that end.
    fn end_open(&mut self, emit: &mut dyn FnMut(&Trapezoid), mut ends: impl FnMut(&Open) -> bool) {
        for open in self.open.drain(..) {
            if ends(&open) {
                let [low, high] = open.edges.map(|number| {
                    let edge = &self.edges[number as usize];
                    let line = Active::new(number, edge);
                    (open.s.map(|s| line.at(s)), edge.plane)
                });
                emit(&Trapezoid { s: open.s, low, high });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polygon(corners: &[[f64; 2]], frame: bool) -> Vec<Edge> {
        (0..corners.len())
            .map(|k| {
                let [a, b] = [corners[k], corners[(k + 1) % corners.len()]];
                let (step, [a, b]) = if a[0] < b[0] { (1, [a, b]) } else { (-1, [b, a]) };
                Edge { s: [a[0], b[0]], t: [a[1], b[1]], step, frame, plane: k as u32 }
            })
            .collect()
    }

    fn area(edges: Vec<Edge>) -> (f64, usize) {
        let (mut area, mut count) = (0.0, 0);
        Trapezoids { edges, ..Trapezoids::default() }.emit(&mut |part| {
            let heights = [0, 1].map(|k| part.high.0[k] - part.low.0[k]);
            assert!(heights.iter().all(|height| *height >= -1e-12));
            area += (part.s[1] - part.s[0]) * f64::midpoint(heights[0], heights[1]);
            count += 1;
        });
        (area, count)
    }

    const FRAME: [[f64; 2]; 4] = [[0.0, 0.0], [4.0, 0.1], [4.0, 4.1], [0.0, 4.0]];

    #[test]
    fn what_is_left_has_the_area_that_is_not_covered() {
        let of = |regions: &[&[[f64; 2]]]| {
            let regions = regions.iter().flat_map(|corners| polygon(corners, false));
            area(polygon(&FRAME, true).into_iter().chain(regions).collect())
        };
        assert_eq!(of(&[]), (16.0, 1));
        let triangle: &[[f64; 2]] = &[[1.0, 1.0], [2.0, 1.5], [1.5, 3.0]];
        let (alone, parts) = of(&[triangle]);
        assert!((alone - (16.0 - 0.875)).abs() < 1e-12, "{alone}");
        // Left and right of it, below, and above each of two sides.
        assert_eq!(parts, 5);
        // Twice the same, and one that crosses it and reaches out of the frame.
        assert!((of(&[triangle, triangle]).0 - alone).abs() < 1e-12);
        let bar: &[[f64; 2]] = &[[-1.0, 2.0], [5.0, 2.0], [5.0, 9.0], [-1.0, 9.0]];
        let (both, _) = of(&[triangle, bar]);
        // Above a height of 2, the triangle reaches from [11/6, 2] and [1.25, 2] to [1.5, 3].
        let below = 0.875 - 0.5 * (11.0 / 6.0 - 1.25);
        assert!((both - (8.0 - 0.2 - below)).abs() < 1e-12, "{both}");
        assert!(of(&[&[[-1.0, -1.0], [6.0, -1.0], [6.0, 6.0], [-1.0, 6.0]]]).0.abs() < 1e-12);
    }

    /// Without the edge between them, two regions are one.
    #[test]
    fn edges_between_regions_may_be_left_out() {
        let mut regions = polygon(&[[1.0, 1.0], [3.0, 1.2], [2.9, 2.0], [1.1, 2.2]], false);
        regions.extend(polygon(&[[1.1, 2.2], [2.9, 2.0], [2.0, 3.0]], false));
        let with = area(polygon(&FRAME, true).into_iter().chain(regions.clone()).collect());
        regions.retain(|edge| edge.s != [1.1, 2.9]);
        let without = area(polygon(&FRAME, true).into_iter().chain(regions).collect());
        assert!((with.0 - without.0).abs() < 1e-12 && without.1 <= with.1, "{with:?} {without:?}");
    }
}

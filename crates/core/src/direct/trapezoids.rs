//! The part of a plane between some edges that no region covers, cut into trapezoids with two vertical sides (the vertical decomposition of
//! M. de Berg et al., *Computational Geometry*, 2008, section 6.1, by a sweep).
//!
//! Regions are given by the edges of their boundaries. How many regions cover a point is the sum of the steps of the edges below it: it takes
//! no order of the edges of a region, an edge between two regions that no gap separates may be left out of both, and one that bounds both from
//! the same side may be a single edge of twice the step.

/// Relative distance within which edges count as touching.
const TOUCHING: f64 = 1e-12;
/// How often the strip between two ends of edges is cut at most where edges cross.
const DEEPEST: u32 = 64;

/// A boundary that is not vertical: a line over an interval.
#[derive(Clone, Copy, Debug)]
pub struct Edge {
    /// Horizontal coordinates of both ends, in ascending order.
    pub s: [f64; 2],
    /// Heights of both ends.
    pub t: [f64; 2],
    /// How many more regions lie above the edge than below it.
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
    /// Step of the edge: `frames` of one of the frame, `covers` of one of regions.
    frames: i32,
    covers: i32,
    /// Line of the edge (s0, t0 and slope), and the point at which it ends.
    line: [f64; 3],
    end: [f64; 2],
    /// Heights at both sides of the last strip, and where that ended.
    t: [f64; 2],
    s: f64,
}

impl Active {
    fn new(number: u32, edge: &Edge) -> Self {
        let ([s0, s1], [t0, t1]) = (edge.s, edge.t);
        let (frames, covers) = if edge.frame { (edge.step, 0) } else { (0, edge.step) };
        let line = [s0, t0, (t1 - t0) / (s1 - s0)];
        Self { edge: number, frames, covers, line, end: [s1, t1], t: [0.0; 2], s: f64::NAN }
    }

    /// At its ends, its heights to the last bit.
    fn at(&self, s: f64) -> f64 {
        let ([s0, t0, slope], [s1, t1]) = (self.line, self.end);
        if s >= s1 { t1 } else { t0 + slope * (s - s0) }
    }

    /// Height of the edge within the strip, at a share of the strip's width from its beginning.
    fn between(&self, share: f64) -> f64 {
        self.t[0] + (self.t[1] - self.t[0]) * share
    }

    /// Whether the edge is below some heights at an end of the strip.
    fn dips_below(&self, heights: &[f64; 2]) -> bool {
        (0..2).any(|side| self.t[side] < heights[side] - touching(heights[side]))
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
    /// The greatest heights of the edges up to each at both ends of the strip.
    highest: Vec<[f64; 2]>,
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
            frames += active.frames;
            covers += active.covers;
            match low {
                None if frames > 0 && covers <= 0 => low = Some(active),
                Some(&Active { edge, t: [t0, t1], .. }) if frames <= 0 || covers > 0 => {
                    let [above0, above1] = active.t;
                    if above0 - t0 + (above1 - t1) > 2.0 * touching(t0) {
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

    /// Finds where two edges cross in a strip, if that may be seen: not where regions cover all around it.
    /// Most crossings are of silhouettes behind others. What none covers around a crossing reaches from one
    /// end of the strip to the other between the same two edges.
    fn crossing(&mut self, [from, to]: [f64; 2]) -> Option<f64> {
        let Self { active, highest, visits, .. } = self;
        if !active.windows(2).any(|pair| pair[1].dips_below(&pair[0].t)) {
            return None;
        }
        highest.clear();
        highest.extend(active.iter().scan([f64::NEG_INFINITY; 2], |highest, active| {
            *highest = [0, 1].map(|side| highest[side].max(active.t[side]));
            Some(*highest)
        }));
        for (k, upper) in active.iter().enumerate() {
            let reached = (0..k).rev().take_while(|&below| upper.dips_below(&highest[below]));
            for lower in reached.map(|below| &active[below]).filter(|lower| upper.dips_below(&lower.t)) {
                let gaps = [0, 1].map(|side| upper.t[side] - lower.t[side]);
                let share = gaps[0] / (gaps[0] - gaps[1]);
                let at = from + (to - from) * share;
                if !(at > from && at < to) {
                    continue;
                }
                *visits += active.len() as u64;
                if least_covers(active, share, upper.between(share)) <= 0 {
                    return Some(at);
                }
            }
        }
        None
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

/// Distance within which edges at a height count as touching.
fn touching(height: f64) -> f64 {
    TOUCHING * (1.0 + height.abs())
}

/// How many regions cover the surroundings of a point in a strip at least, in whatever order the edges lie that touch it.
fn least_covers(active: &[Active], share: f64, height: f64) -> i32 {
    let touching = touching(height);
    let covers = |edge: &Active| match edge.between(share) - height {
        gap if gap > touching => 0,
        gap if gap < -touching => edge.covers,
        _ => edge.covers.min(0),
    };
    active.iter().map(covers).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::SplitMix64 as Random;

    fn polygon(corners: &[[f64; 2]], frame: bool) -> Vec<Edge> {
        sides(corners)
            .enumerate()
            .map(|(k, [a, b])| {
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

    /// Triangles with corners in a square around a point, seen counter-clockwise.
    fn triangles(
        count: usize,
        random: &mut Random,
        of: impl Fn(&mut Random) -> [f64; 3],
    ) -> Vec<[[f64; 2]; 3]> {
        let triangle = |_| {
            let [s, t, size] = of(random);
            let mut corners = [0; 3].map(|_| [s, t].map(|x| x + size * (random.random::<f64>() - 0.5)));
            let [a, b, c] = corners;
            if (b[0] - a[0]) * (c[1] - a[1]) < (b[1] - a[1]) * (c[0] - a[0]) {
                corners.swap(1, 2);
            }
            corners
        };
        (0..count).map(triangle).collect()
    }

    fn sides(of: &[[f64; 2]]) -> impl Iterator<Item = [[f64; 2]; 2]> {
        (0..of.len()).map(|k| [of[k], of[(k + 1) % of.len()]])
    }

    /// Horizontal coordinates at which lines cross that have no end in common.
    fn crossings(lines: &[[[f64; 2]; 2]]) -> Vec<f64> {
        let crossing = |[a, b]: [[f64; 2]; 2], [c, d]: [[f64; 2]; 2]| {
            let side = |x: [f64; 2], [a, b]: [[f64; 2]; 2]| {
                (b[0] - a[0]) * (x[1] - a[1]) - (b[1] - a[1]) * (x[0] - a[0])
            };
            let [from, to] = [c, d].map(|x| side(x, [a, b]));
            let cross = from * to < 0.0 && side(a, [c, d]) * side(b, [c, d]) < 0.0;
            cross.then(|| c[0] + (d[0] - c[0]) * from / (from - to))
        };
        let pairs = lines.iter().enumerate().flat_map(|(k, a)| lines[..k].iter().map(move |b| (*a, *b)));
        pairs.filter_map(|(a, b)| crossing(a, b)).collect()
    }

    /// What triangles leave of the frame: between all corners and crossings the uncovered length is linear, so that its value in the middle
    /// is its mean.
    fn left(triangles: &[[[f64; 2]; 3]]) -> f64 {
        let all: Vec<&[[f64; 2]]> = triangles.iter().map(|of| &of[..]).chain([&FRAME[..]]).collect();
        let lines: Vec<[[f64; 2]; 2]> = all.iter().flat_map(|of| sides(of)).collect();
        let mut places: Vec<f64> = lines.iter().map(|line| line[0][0]).chain(crossings(&lines)).collect();
        places.sort_by(f64::total_cmp);
        let at = |of: &[[f64; 2]], s: f64| {
            let across = sides(of).filter(|[a, b]| (a[0] <= s) != (b[0] <= s));
            let heights = across.map(|[a, b]| a[1] + (s - a[0]) * (b[1] - a[1]) / (b[0] - a[0]));
            heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], t| [low.min(t), high.max(t)])
        };
        let length = |s: f64| {
            let [mut top, end] = at(&FRAME, s);
            let mut covered: Vec<[f64; 2]> = triangles.iter().map(|of| at(of, s)).collect();
            covered.retain(|[low, high]| low < high);
            covered.sort_by(|a, b| a[0].total_cmp(&b[0]));
            let mut sum = 0.0;
            for [low, high] in covered {
                sum += (low.min(end) - top).max(0.0);
                top = top.max(high);
            }
            sum + (end - top).max(0.0)
        };
        places.windows(2).map(|of| (of[1] - of[0]) * length(f64::midpoint(of[0], of[1]))).sum()
    }

    #[test]
    fn triangles_that_cross_leave_what_the_length_between_them_says() {
        let mut random = Random::seed_from_u64(8);
        for (count, size) in [(6, 3.0), (20, 2.0), (40, 1.5), (60, 4.0), (150, 0.5)] {
            for _ in 0..10 {
                let of = triangles(count, &mut random, |random| {
                    [4.0 * random.random::<f64>(), 4.0 * random.random::<f64>(), size]
                });
                let regions = of.iter().flat_map(|corners| polygon(corners, false));
                let (found, _) = area(polygon(&FRAME, true).into_iter().chain(regions).collect());
                let wanted = left(&of);
                assert!((found - wanted).abs() < 1e-10, "{count} of {size}: {found}, not {wanted}");
            }
        }
    }

    /// A strip is cut only where edges cross that may be seen; other crossings take one look at the edges there.
    #[test]
    fn edges_behind_others_may_cross() {
        let mut random = Random::seed_from_u64(3);
        let behind = triangles(30, &mut random, |random| {
            [2.0 + random.random::<f64>(), 2.0 + random.random::<f64>(), 1.0]
        });
        let before: &[[f64; 2]] = &[[1.0, 1.0], [3.9, 1.1], [3.8, 3.9], [1.2, 3.8]];
        let hidden = behind.iter().flat_map(|corners| polygon(corners, false));
        let edges: Vec<Edge> =
            polygon(&FRAME, true).into_iter().chain(polygon(before, false)).chain(hidden).collect();
        let mut ends: Vec<f64> = edges.iter().flat_map(|edge| edge.s).collect();
        ends.sort_by(f64::total_cmp);
        ends.dedup();
        let across = |s: f64| edges.iter().filter(|edge| edge.s[0] < s && s < edge.s[1]).count() as u64;
        let strips: u64 = ends.windows(2).map(|of| across(f64::midpoint(of[0], of[1]))).sum();
        let lines: Vec<[[f64; 2]; 2]> = behind.iter().flat_map(|of| sides(of)).collect();
        let wanted = strips + crossings(&lines).into_iter().map(across).sum::<u64>();
        let mut trapezoids = Trapezoids { edges, ..Trapezoids::default() };
        let mut parts = 0;
        trapezoids.emit(&mut |_| parts += 1);
        assert_eq!((trapezoids.visits, parts), (wanted, 6));
    }
}

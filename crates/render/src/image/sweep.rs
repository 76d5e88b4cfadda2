//! Exact visibility along a line of the picture: where the nearest face changes, and why.
//!
//! On a line each face covers an interval, in which its inverse depth is linear. A sweep over the ends of the intervals keeps the
//! list of faces between two of them; the nearest face changes at such an end, or where two inverse depths cross. Faces that
//! share an edge end and begin at the same coordinate, bit for bit, since the two functions of the edge have opposite
//! coefficients.

use glam::DVec3;

use super::projection::Projected;

/// Coordinates in the picture, and relative inverse depths, that differ by less count as equal. A picture has at most 2^18
/// samples along a side, 7.6e-6 apart.
const CLOSE: f64 = 1e-9;

/// Stands for an edge at the border of the picture.
const BORDER: usize = 3;

/// Direction of lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Axis {
    /// Lines from left to right, at one y.
    Rows,
    /// Lines upwards, at one x.
    Columns,
}

impl Axis {
    /// The coefficients of a function of the picture: along the lines, across them, constant.
    pub fn coefficients(self, function: DVec3) -> [f64; 3] {
        let [x, y, one] = function.to_array();
        match self {
            Self::Rows => [x, y, one],
            Self::Columns => [y, x, one],
        }
    }

    /// (x, y, 1) of a point.
    pub fn place(self, along: f64, across: f64) -> DVec3 {
        match self {
            Self::Rows => DVec3::new(along, across, 1.0),
            Self::Columns => DVec3::new(across, along, 1.0),
        }
    }
}

/// Why the nearest face changes.
#[derive(Clone, Copy, Debug)]
pub(super) enum Cause {
    /// An edge of a face.
    Edge { face: u32, edge: usize },
    /// One face passes through the other.
    Crossing,
}

/// A change of the nearest face along a line. Faces are positions in the list that is swept.
#[derive(Clone, Copy, Debug)]
pub(super) struct Change {
    pub at: f64,
    pub before: Option<u32>,
    pub after: Option<u32>,
    pub cause: Cause,
}

/// The interval that a face covers on a line; its inverse depth there is `slope` times the coordinate, plus `offset`.
#[derive(Clone, Copy, Debug)]
struct Span {
    face: u32,
    front: bool,
    low: f64,
    high: f64,
    low_edge: usize,
    high_edge: usize,
    slope: f64,
    offset: f64,
}

impl Span {
    fn new(face: u32, projected: &Projected, axis: Axis, across: f64) -> Option<Self> {
        let (mut low, mut high) = (-1.0, 1.0);
        let (mut low_edge, mut high_edge) = (BORDER, BORDER);
        for (edge, &function) in projected.edges.iter().enumerate() {
            let [slope, side, constant] = axis.coefficients(function);
            let offset = side * across + constant;
            let root = -offset / slope;
            if slope > 0.0 {
                if root > low {
                    (low, low_edge) = (root, edge);
                }
            } else if slope < 0.0 {
                if root < high {
                    (high, high_edge) = (root, edge);
                }
            } else if offset < 0.0 {
                return None;
            }
        }
        let [slope, side, constant] = axis.coefficients(projected.inverse_depth);
        let offset = side * across + constant;
        let front = projected.front;
        (high - low > CLOSE).then_some(Self { face, front, low, high, low_edge, high_edge, slope, offset })
    }

    fn inverse_depth(&self, at: f64) -> f64 {
        self.slope * at + self.offset
    }

    /// Difference of inverse depth to another face at a point, positive if this one is nearer; zero within [`CLOSE`].
    fn nearer_by(&self, other: &Self, at: f64) -> f64 {
        let (own, others) = (self.inverse_depth(at), other.inverse_depth(at));
        if (own - others).abs() <= CLOSE * (own.abs() + others.abs()) { 0.0 } else { own - others }
    }

    /// Whether this hides another just after `from`; no face begins or ends before `to`. Of coincident faces a front wins, then
    /// the first.
    fn hides(&self, other: &Self, from: f64, to: f64) -> bool {
        // Faces that touch at `from` differ at `to`.
        let by = [from, to].map(|at| self.nearer_by(other, at));
        match by.into_iter().find(|&by| by != 0.0) {
            Some(by) => by > 0.0,
            None => (!self.front, self.face) < (!other.front, other.face),
        }
    }
}

/// Sweeps one line after another.
#[derive(Debug, Default)]
pub(super) struct Sweep {
    /// Spans of the current line, sorted by where they begin.
    spans: Vec<Span>,
    /// Spans that have begun and not yet ended.
    active: Vec<u32>,
}

impl Sweep {
    /// Calls `change` with each change along the line, in order. `faces` are in ascending order.
    pub fn line<'a>(
        &mut self,
        faces: impl Iterator<Item = (u32, &'a Projected)>,
        axis: Axis,
        across: f64,
        mut change: impl FnMut(Change),
    ) {
        self.spans.clear();
        self.spans.extend(faces.filter_map(|(face, projected)| Span::new(face, projected, axis, across)));
        self.spans.sort_by(|a, b| a.low.total_cmp(&b.low));
        self.active.clear();
        let spans = &self.spans;
        let mut next = 0;
        let mut at = -1.0;
        let mut seen: Option<&Span> = None;
        loop {
            // Ends that are close together coincide; otherwise rounding would reveal faces behind a common edge.
            let reached = at + CLOSE;
            self.active.retain(|&span| spans[span as usize].high > reached);
            while let Some(span) = spans.get(next).filter(|span| span.low <= reached) {
                if span.high > reached {
                    self.active.push(next as u32);
                }
                next += 1;
            }
            let active = || self.active.iter().map(|&span| &spans[span as usize]);
            let begins = spans.get(next).map_or(1.0, |span| span.low);
            let end = active().map(|span| span.high).fold(begins, f64::min);

            let mut nearest = active().reduce(|a, b| if b.hides(a, at, end) { b } else { a });
            // At the left border there is no change: what lies beyond it is unknown.
            if at > -1.0
                && let Some(found) = boundary(seen, nearest, at)
            {
                change(found);
            }
            let mut from = at;
            while let Some(front) = nearest
                && let Some((place, other)) = first_crossing(front, active(), from, end)
            {
                let (before, after) = (Some(front.face), Some(other.face));
                change(Change { at: place, before, after, cause: Cause::Crossing });
                (nearest, from) = (Some(other), place);
            }
            if end >= 1.0 {
                return;
            }
            (seen, at) = (nearest, end);
        }
    }
}

/// The change at an end of a face, if there is one.
fn boundary(before: Option<&Span>, after: Option<&Span>, at: f64) -> Option<Change> {
    if before.map(|span| span.face) == after.map(|span| span.face) {
        return None;
    }
    let ends = before.filter(|span| span.high <= at + CLOSE && span.high_edge != BORDER);
    let begins = after.filter(|span| span.low >= at && span.low_edge != BORDER);
    let by_end = match (ends, begins) {
        (Some(a), Some(b)) => {
            // The edge of the nearer face hides the other; adjacent faces share it.
            let by = a.nearer_by(b, at);
            by > 0.0 || by == 0.0 && a.face < b.face
        }
        (ends, _) => ends.is_some(),
    };
    // If neither, rounding has swapped two coincident faces.
    let (at, cause) = match (ends, begins) {
        (Some(a), _) if by_end => (a.high, Cause::Edge { face: a.face, edge: a.high_edge }),
        (_, Some(b)) => (b.low, Cause::Edge { face: b.face, edge: b.low_edge }),
        _ => return None,
    };
    Some(Change { at, before: before.map(|span| span.face), after: after.map(|span| span.face), cause })
}

/// The first place between `from` and `to` where another face crosses the nearest one, and that face.
fn first_crossing<'a>(
    front: &Span,
    others: impl Iterator<Item = &'a Span>,
    from: f64,
    to: f64,
) -> Option<(f64, &'a Span)> {
    let crossing = |other: &'a Span| {
        let ahead = other.nearer_by(front, to);
        (ahead > 0.0).then(|| {
            let behind = (front.inverse_depth(from) - other.inverse_depth(from)).max(0.0);
            (from + (to - from) * behind / (behind + ahead), other)
        })
    };
    others.filter_map(crossing).min_by(|a, b| a.0.total_cmp(&b.0))
}

//! Light between two close triangles, from quarters to quarters, 16 pieces at a time. Twin of glsl/near_walk.glsl and
//! near_field.glsl.

use super::pairs::{Facet, cross, dot, far_weight, minus};
use super::real::Real;
use super::taps::{Layout, Taps};
use crate::gpu::vectorised;
use crate::model::{Class, QUARTER_RANGE};
use std::f64::consts::PI;

/// Pieces of a batch: four quarters of the source for each of four of the receiver.
pub const ALL: usize = 16;
/// The whole source for each quarter of the receiver.
const WHOLE: usize = 4;

type Corners<T> = [[T; 3]; 3];

/// A triangle.
#[derive(Clone, Copy)]
pub struct Triangle<T> {
    pub facet: Facet<T>,
    pub corners: Corners<T>,
}

/// A source and a receiver close to it.
pub struct ClosePair<T> {
    pub source: Triangle<T>,
    pub receiver: Triangle<T>,
    /// That of the source; not a blocker where no antiradiance leaves backs.
    pub class: Class,
    pub receiver_bins: bool,
    /// Half of `near_field`.
    pub half_range: T,
}

/// A batch of pieces.
pub struct Pieces<T, const N: usize = ALL> {
    /// Irradiance per radiance: of what is uniform, from fronts, and of what varies with direction.
    pub diffuse: [T; N],
    pub binned: [T; N],
    /// 1 where the receiver is on the front side of the source, otherwise 0.
    pub front: [T; N],
    /// Taps at the source, of light that leaves the front or was incident on it, and at the receiver.
    pub at_source: Taps<T, N>,
    pub at_receiver: Taps<T, N>,
    direction: [[T; N]; 3],
    /// Blend weight of quarters against quarters of quarters.
    far: [T; N],
}

impl<T: Real> ClosePair<T> {
    /// Calls `with` for each batch of pieces: quarter to quarter and, for radiance that varies with direction, between two quarters
    /// close for their size, quarter of a quarter to quarter of a quarter.
    pub fn walk(&self, layout: &Layout<T>, pieces: &mut Pieces<T>, mut with: impl FnMut(&Pieces<T>)) {
        let Self { source, receiver, class, .. } = self;
        let range = self.half_range * (source.facet.characteristic_area + receiver.facet.characteristic_area);
        let between = minus(receiver.facet.centre, source.facet.centre);
        let near = T::ONE - far_weight(dot(between, between), range);
        let finest = range * T::of(QUARTER_RANGE);
        let (from, onto) = (quarters(&source.corners), quarters(&receiver.corners));
        let weight = T::of(0.25) * near;
        // Where the radiance of the source varies with direction, as some corner of a quarter of the receiver sees it.
        let varies = onto.map(|onto| {
            let height = onto.map(|corner| dot(minus(corner, source.facet.centre), source.facet.normal));
            class.glossy && height.iter().any(|h| *h > T::ZERO)
                || class.blocker && height.iter().any(|h| *h < T::ZERO)
        });
        let blend = varies.contains(&true).then_some(finest);
        if self.evaluate(layout, (&from[..], &onto), [weight; 2], blend, pieces) {
            with(pieces);
        }
        let far = pieces.far;
        for (k, far) in far.into_iter().enumerate().filter(|(k, far)| varies[k / 4] && *far < T::ONE) {
            let weight = T::of(0.0625) * near * (T::ONE - far);
            let ends = (&quarters(&from[k % 4])[..], &quarters(&onto[k / 4]));
            if self.evaluate(layout, ends, [T::ZERO, weight], None, pieces) {
                with(pieces);
            }
        }
    }

    /// Irradiance per radiance where neither end has bins: Lambert's formula is exact for the whole source.
    pub fn uniform(&self, layout: &Layout<T>) -> T {
        let Self { source, receiver, .. } = self;
        let range = self.half_range * (source.facet.characteristic_area + receiver.facet.characteristic_area);
        let between = minus(receiver.facet.centre, source.facet.centre);
        let weight = T::of(0.25) * (T::ONE - far_weight(dot(between, between), range));
        let mut pieces = Pieces::<T, WHOLE>::NONE;
        let ends = (&[source.corners][..], &quarters(&receiver.corners));
        self.evaluate(layout, ends, [weight; 2], None, &mut pieces);
        pieces.diffuse.into_iter().fold(T::ZERO, |sum, weight| sum + weight)
    }

    /// Sets the pieces from some triangles to others, with the weights of what is uniform and of what varies, this one blended by the
    /// range `blend`. Whether there is anything.
    fn evaluate<const N: usize>(
        &self,
        layout: &Layout<T>,
        (from, onto): (&[Corners<T>], &[Corners<T>; 4]),
        weights: [T; 2],
        blend: Option<T>,
        pieces: &mut Pieces<T, N>,
    ) -> bool {
        let centroid = |[a, b, c]: Corners<T>| [0, 1, 2].map(|k| (a[k] + b[k] + c[k]) * T::of(1.0 / 3.0));
        let points = onto.map(centroid);
        let centroids: [[T; 3]; 4] =
            std::array::from_fn(|k| from.get(k).map_or([T::ZERO; 3], |from| centroid(*from)));
        let sources = N / 4;
        // The corners of the source by piece, seen from the point of the receiver, and the line between the centroids.
        let mut seen = [[[T::ZERO; N]; 3]; 3];
        let mut offset = [[T::ZERO; N]; 3];
        for k in 0..N {
            let (point, from) = (points[k / sources], from[k % sources]);
            for a in 0..3 {
                for corner in 0..3 {
                    seen[corner][a][k] = from[corner][a] - point[a];
                }
                offset[a][k] = point[a] - centroids[k % sources][a];
            }
        }
        vectorised(
            #[inline(always)]
            || {
                self.weigh(&seen, &offset, weights, blend, pieces);
                let any = pieces
                    .diffuse
                    .iter()
                    .zip(&pieces.binned)
                    .fold(T::ZERO, |any, (&d, &b)| any.most(d).most(b));
                if any <= T::ZERO {
                    return false;
                }
                self.aim(layout, pieces);
                true
            },
        )
    }

    /// Sets weights and directions.
    #[inline(always)]
    fn weigh<const N: usize>(
        &self,
        seen: &[[[T; N]; 3]; 3],
        offset: &[[T; N]; 3],
        [diffuse, binned]: [T; 2],
        blend: Option<T>,
        pieces: &mut Pieces<T, N>,
    ) {
        let (source, receiver) = (&self.source.facet, &self.receiver.facet);
        let coincident = T::COINCIDENT * source.characteristic_area;
        let [glossy, blocker] =
            [self.class.glossy, self.class.blocker].map(|is| if is { binned } else { T::ZERO });
        for k in 0..N {
            let at = |of: &[[T; N]; 3]| [of[0][k], of[1][k], of[2][k]];
            let d = at(offset);
            let r2 = dot(d, d);
            let side = dot(d, source.normal);
            let front = side > T::ZERO;
            let far = blend.map_or(T::ONE, |range| far_weight(r2, range));
            let projected = projected_solid_angle(receiver.normal, seen.each_ref().map(at));
            let projected = if side * side > coincident { projected } else { T::ZERO };
            pieces.diffuse[k] = if front { diffuse * projected } else { T::ZERO };
            pieces.binned[k] = far * projected * if front { glossy } else { blocker };
            pieces.front[k] = if front { T::ONE } else { T::ZERO };
            pieces.far[k] = far;
            let inverse = T::ONE / r2.most(T::of(1e-30)).root();
            for a in 0..3 {
                pieces.direction[a][k] = d[a] * inverse;
            }
        }
    }

    /// Sets the taps.
    #[inline(always)]
    fn aim<const N: usize>(&self, layout: &Layout<T>, pieces: &mut Pieces<T, N>) {
        let Pieces { at_source, at_receiver, direction, front, .. } = pieces;
        if self.class.has_bins() {
            at_source.set(layout, |k| {
                let sign = T::of(2.0) * front[k] - T::ONE;
                self.source.facet.in_frame([0, 1, 2].map(|a| sign * direction[a][k]))
            });
        }
        if self.receiver_bins {
            at_receiver.set(layout, |k| self.receiver.facet.in_frame([0, 1, 2].map(|a| -direction[a][k])));
        }
    }
}

impl<T: Real, const N: usize> Pieces<T, N> {
    pub const NONE: Self = Self {
        diffuse: [T::ZERO; N],
        binned: [T::ZERO; N],
        front: [T::ZERO; N],
        at_source: Taps::NONE,
        at_receiver: Taps::NONE,
        direction: [[T::ZERO; N]; 3],
        far: [T::ONE; N],
    };

    /// Those through which light passes.
    pub fn lit(&self) -> impl Iterator<Item = usize> {
        (0..N).filter(|&k| self.diffuse[k] > T::ZERO || self.binned[k] > T::ZERO)
    }
}

/// Three quarters at the corners, then the one in the middle.
fn quarters<T: Real>(&[p, q, r]: &Corners<T>) -> [Corners<T>; 4] {
    let middle = |a: [T; 3], b: [T; 3]| [0, 1, 2].map(|k| T::of(0.5) * (a[k] + b[k]));
    let (pq, qr, rp) = (middle(p, q), middle(q, r), middle(r, p));
    [[p, pq, rp], [pq, q, qr], [rp, qr, r], [pq, qr, rp]]
}

/// ∫ cosθ dω over a triangle whose corners are given relative to the point, clipped at the horizon of the normal: Lambert's polygon
/// formula.
#[inline(always)]
fn projected_solid_angle<T: Real>(normal: [T; 3], corners: Corners<T>) -> T {
    let height = corners.map(|corner| dot(corner, normal));
    let (mut leave, mut enter) = ([T::ZERO; 3], [T::ZERO; 3]);
    let mut sum = T::ZERO;
    for (k, next) in [(0, 1), (1, 2), (2, 0)] {
        let (a, b) = (corners[k], corners[next]);
        let (above_a, above_b) = (height[k] > T::ZERO, height[next] > T::ZERO);
        let differ = above_a != above_b;
        let part = height[k] / (height[k] - height[next]);
        let crossing = [0, 1, 2].map(|c| if differ { a[c] + part * (b[c] - a[c]) } else { T::ZERO });
        for c in 0..3 {
            leave[c] = if above_a && !above_b { crossing[c] } else { leave[c] };
            enter[c] = if above_b && !above_a { crossing[c] } else { enter[c] };
        }
        // A side below the horizon has no angle: both ends are the crossing.
        let begin = [0, 1, 2].map(|c| if above_a { a[c] } else { crossing[c] });
        let end = [0, 1, 2].map(|c| if above_b { b[c] } else { crossing[c] });
        sum += side(normal, begin, end);
    }
    T::of(0.5) * (sum + side(normal, leave, enter)).magnitude()
}

/// The angle one side subtends times the unit normal of its plane, along `normal`.
#[inline(always)]
fn side<T: Real>(normal: [T; 3], a: [T; 3], b: [T; 3]) -> T {
    let c = cross(a, b);
    let sine2 = dot(c, c);
    let sine = sine2.root();
    let cosine = dot(a, b);
    // The half angle's tangent keeps the argument in [0, 1] for angles up to a right one.
    let both = (sine2 + cosine * cosine).root() + cosine.magnitude();
    let acute = T::of(2.0) * (sine / both.most(T::of(1e-30))).least(T::ONE).arctangent();
    let angle = if cosine < T::ZERO { T::of(PI) - acute } else { acute };
    // A side through the point, or without length, bounds no solid angle.
    let seen = sine > T::SHORTEST * (dot(a, a) + dot(b, b));
    if seen { dot(c, normal) * (angle / sine) } else { T::ZERO }
}

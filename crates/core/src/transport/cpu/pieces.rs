//! Light between two close triangles, from quarters to quarters, 16 pieces at a time. Twin of crates/core/glsl/near_walk.glsl and
//! near_field.glsl.

use super::exchanged::{Coordinates, at};
use super::far::flag;
use super::pairs::{Facet, cross, dot, far_weight, minus, times};
use super::real::Real;
use super::taps::{Layout, Taps};
use crate::model::{Class, QUARTER_RANGE};
use antirad_gpu::vectorised;
use std::f64::consts::PI;

/// Pieces of a batch: four quarters of the source for each of four of the receiver.
pub const ALL: usize = 16;
/// The whole source for each quarter of the receiver.
pub const WHOLE: usize = 4;

pub type Corners<T> = [[T; 3]; 3];

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
    /// The class of the source; not a blocker where no antiradiance leaves backs.
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
    /// Bilinear weights at the source, of light that leaves the front or was incident on it, and at the
    /// receiver.
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
        let (seen, offset) = views::<T, N>(from, onto);
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
        seen: &[Coordinates<T, N>; 3],
        offset: &Coordinates<T, N>,
        [diffuse, binned]: [T; 2],
        blend: Option<T>,
        pieces: &mut Pieces<T, N>,
    ) {
        let (source, receiver) = (&self.source.facet, &self.receiver.facet);
        let projected = projected_solid_angles(receiver.normal, seen);
        let coincident = T::COINCIDENT * source.characteristic_area;
        let [glossy, blocker] = [binned * flag(self.class.glossy), binned * flag(self.class.blocker)];
        for k in 0..N {
            let d = at(offset, k);
            let r2 = dot(d, d);
            let side = dot(d, source.normal);
            let front = side > T::ZERO;
            let far = blend.map_or(T::ONE, |range| far_weight(r2, range));
            let projected = if side * side > coincident { projected[k] } else { T::ZERO };
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

    /// Sets the bilinear weights at the ends that have bins.
    #[inline(always)]
    fn aim<const N: usize>(&self, layout: &Layout<T>, pieces: &mut Pieces<T, N>) {
        let Pieces { at_source, at_receiver, direction, front, .. } = pieces;
        if self.class.has_bins() {
            at_source.set(
                layout,
                #[inline(always)]
                |k| {
                    let sign = T::of(2.0) * front[k] - T::ONE;
                    self.source.facet.in_frame(times(sign, at(direction, k)))
                },
            );
        }
        if self.receiver_bins {
            at_receiver.set(
                layout,
                #[inline(always)]
                |k| self.receiver.facet.in_frame(times(-T::ONE, at(direction, k))),
            );
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

    /// Numbers of the pieces through which light passes.
    pub fn lit(&self) -> impl Iterator<Item = usize> {
        (0..N).filter(|&k| self.diffuse[k] > T::ZERO || self.binned[k] > T::ZERO)
    }
}

#[inline(always)]
pub fn centroid<T: Real>([a, b, c]: Corners<T>) -> [T; 3] {
    let third = T::of(1.0 / 3.0);
    [(a[0] + b[0] + c[0]) * third, (a[1] + b[1] + c[1]) * third, (a[2] + b[2] + c[2]) * third]
}

#[inline(always)]
pub fn middle<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    let half = T::of(0.5);
    [half * (a[0] + b[0]), half * (a[1] + b[1]), half * (a[2] + b[2])]
}

/// The corners of the source by piece, seen from the point of the receiver, and the line between the centroids.
#[inline(always)]
pub fn views<T: Real, const N: usize>(
    from: &[Corners<T>],
    onto: &[Corners<T>; 4],
) -> ([Coordinates<T, N>; 3], Coordinates<T, N>) {
    let (points, centroids) = (centroids(onto), centroids(from));
    let sources = N / 4;
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
    (seen, offset)
}

/// Centroids of up to four triangles.
#[inline(always)]
fn centroids<T: Real>(of: &[Corners<T>]) -> [[T; 3]; 4] {
    let mut all = [[T::ZERO; 3]; 4];
    all.iter_mut().zip(of).for_each(|(to, of)| *to = centroid(*of));
    all
}

/// Three quarters at the corners, then the one in the middle.
#[inline(always)]
pub fn quarters<T: Real>(&[p, q, r]: &Corners<T>) -> [Corners<T>; 4] {
    let (pq, qr, rp) = (middle(p, q), middle(q, r), middle(r, p));
    [[p, pq, rp], [pq, q, qr], [rp, qr, r], [pq, qr, rp]]
}

/// ∫ cosθ dω over triangles whose corners are given relative to the point, clipped at the horizon of the normal: Lambert's polygon
/// formula. In loops over all triangles without branches, closures and values from one loop to the next: compilers make no
/// vectors of others.
#[inline(always)]
fn projected_solid_angles<T: Real, const N: usize>(
    normal: [T; 3],
    [p, q, r]: &[Coordinates<T, N>; 3],
) -> [T; N] {
    let mut heights = [[T::ZERO; N]; 3];
    for (height, corner) in heights.iter_mut().zip([p, q, r]) {
        for k in 0..N {
            height[k] = dot(at(corner, k), normal);
        }
    }
    let [hp, hq, hr] = &heights;
    let mut sum = [T::ZERO; N];
    for ([a, b], [ha, hb]) in [([p, q], [hp, hq]), ([q, r], [hq, hr]), ([r, p], [hr, hp])] {
        for k in 0..N {
            let (a, b) = (at(a, k), at(b, k));
            // A side below the horizon has no angle: both ends are where it does not cross.
            let crossing = crossing([a, b], [ha[k], hb[k]]);
            let [begin, end] = [choose(ha[k] > T::ZERO, a, crossing), choose(hb[k] > T::ZERO, b, crossing)];
            sum[k] += side(normal, begin, end);
        }
    }
    for k in 0..N {
        let level = level_side(normal, [at(p, k), at(q, k), at(r, k)], [hp[k], hq[k], hr[k]]);
        sum[k] = T::of(0.5) * (sum[k] + level).magnitude();
    }
    sum
}

#[inline(always)]
pub fn choose<T: Real>(first: bool, a: [T; 3], b: [T; 3]) -> [T; 3] {
    [if first { a[0] } else { b[0] }, if first { a[1] } else { b[1] }, if first { a[2] } else { b[2] }]
}

/// The point at which the edge from `a` to `b` crosses the horizon, from the heights of both ends above it;
/// zero if it does not.
#[inline(always)]
pub fn crossing<T: Real>([a, b]: [[T; 3]; 2], [height_a, height_b]: [T; 2]) -> [T; 3] {
    let t = height_a / (height_a - height_b);
    let crossing = [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2])];
    choose((height_a > T::ZERO) != (height_b > T::ZERO), crossing, [T::ZERO; 3])
}

/// The side of a triangle's part above the horizon that lies in it, from where the outline leaves the upper half-space to where it enters
/// it again, of corners with these heights.
#[inline(always)]
pub fn level_side<T: Real>(normal: [T; 3], [a, b, c]: Corners<T>, [ha, hb, hc]: [T; 3]) -> T {
    let [up_a, up_b, up_c] = [ha > T::ZERO, hb > T::ZERO, hc > T::ZERO];
    let (ab, bc, ca) = (crossing([a, b], [ha, hb]), crossing([b, c], [hb, hc]), crossing([c, a], [hc, ha]));
    let leave = choose(up_a & !up_b, ab, choose(up_b & !up_c, bc, ca));
    let enter = choose(up_b & !up_a, ab, choose(up_c & !up_b, bc, ca));
    let level = side(normal, leave, enter);
    if (up_a != up_b) | (up_b != up_c) { level } else { T::ZERO }
}

/// The angle with this sine, its square, and cosine, all times the lengths of both ends. The half angle's tangent keeps the argument in
/// [0, 1] for angles up to a right one.
#[inline(always)]
pub fn subtended<T: Real>(sine2: T, sine: T, cosine: T) -> T {
    let both = (sine2 + cosine * cosine).root() + cosine.magnitude();
    let acute = T::of(2.0) * (sine / both.most(T::of(1e-30))).least(T::ONE).arctangent();
    let obtuse = T::of(PI) - acute;
    if cosine < T::ZERO { obtuse } else { acute }
}

/// The angle one side subtends times the unit normal of its plane, along `normal`.
#[inline(always)]
fn side<T: Real>(normal: [T; 3], a: [T; 3], b: [T; 3]) -> T {
    let c = cross(a, b);
    let sine2 = dot(c, c);
    let sine = sine2.root();
    let cosine = dot(a, b);
    let angle = subtended(sine2, sine, cosine);
    // A side through the point, or without length, bounds no solid angle.
    let seen = sine > T::SHORTEST * (dot(a, a) + dot(b, b));
    let along = dot(c, normal) * (angle / sine.most(T::of(1e-30)));
    if seen { along } else { T::ZERO }
}

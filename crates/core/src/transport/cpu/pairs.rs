//! What passes between N pairs of triangles, point to point. Twin of crates/core/glsl/transport_bins.comp and what it includes.
//!
//! Loops over the pairs have no branches and no calls, so that compilers make vectors of them.

use super::exchanged::at;
use super::real::Real;
use super::taps::{Layout, Taps};
use crate::transport::scene_values::FACET;
use std::f64::consts::FRAC_1_PI;

/// Squared distances below this are rounding.
pub const R2_MIN: f64 = 1e-12;
/// The n.z at which frames are discontinuous: that of crates/core/src/model/facet.rs.
const DISCONTINUITY: f64 = -0.6543;

/// `Facet` of crates/core/glsl/geometry.glsl, with what its frame needs.
#[derive(Clone, Copy)]
pub struct Facet<T> {
    pub centre: [T; 3],
    pub area: T,
    pub normal: [T; 3],
    pub characteristic_area: T,
    sign: T,
    inverse: T,
}

#[inline(always)]
pub fn dot<T: Real>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub fn cross<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
pub fn minus<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub fn times<T: Real>(factor: T, [x, y, z]: [T; 3]) -> [T; 3] {
    [factor * x, factor * y, factor * z]
}

/// Blend weight of what is farther away at squared distance `r2`.
#[inline(always)]
pub fn far_weight<T: Real>(r2: T, range: T) -> T {
    let t = (T::of(2.0) * r2 / range.most(T::of(1e-30)) - T::ONE).clamped();
    let far = t * t * (T::of(3.0) - T::of(2.0) * t);
    if range > T::ZERO { far } else { T::ONE }
}

/// Derivatives of [`far_weight`] by `r2` and by `range`.
#[inline(always)]
pub fn far_weight_slopes<T: Real>(r2: T, range: T) -> [T; 2] {
    let of = range.most(T::of(1e-30));
    let t = (T::of(2.0) * r2 / of - T::ONE).clamped();
    let by_r2 = T::of(12.0) * t * (T::ONE - t) / of;
    let by_r2 = if range > T::ZERO { by_r2 } else { T::ZERO };
    [by_r2, -by_r2 * r2 / of]
}

/// The gradient by d, from that by d/|d| (`by`); `direction` is d/|d| and `length` is |d|.
#[inline(always)]
pub fn through_normalization<T: Real>(by: [T; 3], direction: [T; 3], length: T) -> [T; 3] {
    let along = dot(direction, by);
    let across = |k: usize| (by[k] - direction[k] * along) / length;
    [across(0), across(1), across(2)]
}

impl<T: Real> Facet<T> {
    /// The facet of a slot.
    pub fn read(facets: &[T], index: u32) -> Self {
        let reals = &facets[index as usize * FACET..][..FACET];
        let sign = if reals[6] < T::of(DISCONTINUITY) { -T::ONE } else { T::ONE };
        Self {
            centre: [reals[0], reals[1], reals[2]],
            area: reals[3],
            normal: [reals[4], reals[5], reals[6]],
            characteristic_area: reals[7],
            sign,
            inverse: T::ONE / (sign + reals[6]),
        }
    }

    /// A direction in the frame of the triangle.
    #[inline(always)]
    pub fn in_frame(&self, v: [T; 3]) -> [T; 3] {
        let (n, s) = (self.normal, self.sign);
        let along = dot(n, v);
        let k = (along + s * v[2]) * self.inverse;
        [v[0] - s * n[0] * k, s * v[1] - n[1] * k, along]
    }

    /// A direction from the frame of the triangle to that of all: the transpose of
    /// [`in_frame`](Self::in_frame).
    #[inline(always)]
    pub fn out_of_frame(&self, w: [T; 3]) -> [T; 3] {
        let (n, s) = (self.normal, self.sign);
        let level = s * n[0] * w[0] + n[1] * w[1];
        let k = w[2] - level * self.inverse;
        [w[0] + n[0] * k, s * w[1] + n[1] * k, n[2] * w[2] - level]
    }

    /// The gradient by the normal of the product of [`in_frame`](Self::in_frame) of `v` and `g`: `frame_gradient` of
    /// crates/core/glsl/bins_slope.glsl.
    #[inline(always)]
    pub fn frame_gradient(&self, v: [T; 3], g: [T; 3]) -> [T; 3] {
        let (n, s, a) = (self.normal, self.sign, -self.inverse);
        let two = T::of(2.0);
        let by_b = g[0] * s * v[1] + g[1] * v[0];
        let by_a = g[0] * s * n[0] * n[0] * v[0] + g[1] * n[1] * n[1] * v[1] + by_b * n[0] * n[1];
        [
            g[2] * v[0] + g[0] * s * (two * n[0] * a * v[0] - v[2]) + by_b * n[1] * a,
            g[2] * v[1] + g[1] * (two * n[1] * a * v[1] - v[2]) + by_b * n[0] * a,
            g[2] * v[2] + by_a * a * a,
        ]
    }
}

/// N triangles, by what they consist of.
pub struct Facets<T, const N: usize>([[T; N]; 10]);

impl<T: Real, const N: usize> Facets<T, N> {
    pub fn new(of: impl Fn(usize) -> Facet<T>) -> Self {
        let mut all = [[T::ZERO; N]; 10];
        for k in 0..N {
            let Facet { centre: [a, b, c], area, normal: [u, v, w], characteristic_area, sign, inverse } =
                of(k);
            let reals = [a, b, c, area, u, v, w, characteristic_area, sign, inverse];
            all.iter_mut().zip(reals).for_each(|(to, real)| to[k] = real);
        }
        Self(all)
    }

    #[inline(always)]
    pub fn get(&self, k: usize) -> Facet<T> {
        let all = &self.0;
        Facet {
            centre: [all[0][k], all[1][k], all[2][k]],
            area: all[3][k],
            normal: [all[4][k], all[5][k], all[6][k]],
            characteristic_area: all[7][k],
            sign: all[8][k],
            inverse: all[9][k],
        }
    }
}

/// What passes between N pairs of a source and a receiver, point to point.
pub struct Pairs<T, const N: usize> {
    /// max(cos_j, 0) |cos_i| g_ij a_i; zero where nothing passes.
    pub weight: [T; N],
    /// 1 where the front of the source sends it, otherwise 0.
    pub front: [T; N],
    /// Bilinear weights at the source, of light that leaves the front or was incident on it, and at the
    /// receiver.
    pub at_source: Taps<T, N>,
    pub at_receiver: Taps<T, N>,
    direction: [[T; N]; 3],
    r2: [T; N],
}

impl<T: Real, const N: usize> Pairs<T, N> {
    pub const NONE: Self = Self {
        weight: [T::ZERO; N],
        front: [T::ZERO; N],
        at_source: Taps::NONE,
        at_receiver: Taps::NONE,
        direction: [[T::ZERO; N]; 3],
        r2: [T::ZERO; N],
    };

    /// Sets the weights. `sides`: 1 or 0 for the front and for the back of the source.
    #[inline(always)]
    pub fn weigh(
        &mut self,
        source: impl Fn(usize) -> Facet<T>,
        receiver: impl Fn(usize) -> Facet<T>,
        sides: impl Fn(usize) -> [T; 2],
    ) {
        for k in 0..N {
            let (i, j, [fronts, backs]) = (source(k), receiver(k), sides(k));
            let d = minus(j.centre, i.centre);
            let r2 = dot(d, d).most(T::of(R2_MIN));
            let (along, to) = (dot(d, i.normal), -dot(d, j.normal));
            let front = along > T::ZERO;
            let side = if front { fronts } else { backs };
            let sent = side * along.magnitude() * i.area / (r2 * (r2 + i.area * T::of(FRAC_1_PI)));
            let inverse = T::ONE / r2.root();
            for a in 0..3 {
                self.direction[a][k] = d[a] * inverse;
            }
            self.weight[k] = sent * to.most(T::ZERO);
            self.front[k] = if front { T::ONE } else { T::ZERO };
            self.r2[k] = r2;
        }
    }

    /// Multiplies the weights by what the near field leaves. `areas`: sums of characteristic areas.
    #[inline(always)]
    pub fn blend(&mut self, half_range: T, areas: impl Fn(usize) -> T) {
        for k in 0..N {
            self.weight[k] *= far_weight(self.r2[k], half_range * areas(k));
        }
    }

    /// Whether fronts send anything, and backs.
    #[inline(always)]
    pub fn passing(&self) -> [bool; 2] {
        let (mut fronts, mut backs) = (T::ZERO, T::ZERO);
        for (&weight, &front) in self.weight.iter().zip(&self.front) {
            fronts = fronts.most(weight * front);
            backs = backs.most(weight * (T::ONE - front));
        }
        [fronts > T::ZERO, backs > T::ZERO]
    }

    /// Sets the bilinear weights at the sources. Light that leaves the back was incident from the opposite
    /// direction.
    #[inline(always)]
    pub fn aim_from(&mut self, layout: &Layout<T>, source: impl Fn(usize) -> Facet<T>) {
        let Self { at_source, direction, front, .. } = self;
        at_source.set(
            layout,
            #[inline(always)]
            |k| {
                let sign = T::of(2.0) * front[k] - T::ONE;
                source(k).in_frame(times(sign, at(direction, k)))
            },
        );
    }

    /// Sets the bilinear weights at the receivers.
    #[inline(always)]
    pub fn aim_at(&mut self, layout: &Layout<T>, receiver: impl Fn(usize) -> Facet<T>) {
        let Self { at_receiver, direction, .. } = self;
        at_receiver.set(
            layout,
            #[inline(always)]
            |k| receiver(k).in_frame(times(-T::ONE, at(direction, k))),
        );
    }
}

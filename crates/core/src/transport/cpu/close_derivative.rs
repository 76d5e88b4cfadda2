//! Derivatives of what passes between two close triangles, 16 pieces at a time. Twin of crates/core/glsl/near_derivative.comp and
//! near_field_gradient.glsl.

use super::derivative::{By, Derivative, Gradient, gradient};
use super::exchanged::{Coordinates, Ends, Exchanged, at, product};
use super::far::{BLOCK, N, Sources, flag};
use super::far_adjoint::Receivers;
use super::pairs::{cross, dot, far_weight, far_weight_slopes, minus, through_normalization, times};
use super::pieces::{
    ALL, ClosePair, Corners, Triangle, WHOLE, centroid, choose, crossing, level_side, middle, quarters,
    subtended, views,
};
use super::real::Real;
use super::taps::Layout;
use crate::model::QUARTER_RANGE;
use antirad_gpu::vectorised;

/// What the two ends of a close pair exchange.
struct Exchange<'a, T> {
    radiance: [T; 4],
    /// Bins of the source, in front and behind; empty without.
    front: &'a [T],
    back: &'a [T],
    irradiance: [T; 4],
    incident: &'a [T],
}

/// Gradient of a triangle: by its corners, its normal, and its characteristic area.
struct Sums<T> {
    corners: Corners<T>,
    normal: [T; 3],
    characteristic_area: T,
}

impl<T: Real> Derivative<'_, T> {
    /// Gradients of the N sources or receivers of a block, from their close partners.
    pub(super) fn close_block(&self, block: u32, pieces: &mut PieceSlopes<T>) -> [Gradient<T>; N] {
        let Self { light, cotangents, .. } = self;
        let mut gradients = [[T::ZERO; 16]; N];
        let (near, slots, by_source) = match &self.by {
            By::Receivers(Sources::Close { near, slots }) => (near, slots, false),
            By::Sources(Receivers::Close { near, slots }) => (near, slots, true),
            _ => return gradients,
        };
        let class = self.shape.source;
        let receiver_bins = self.shape.receiver_bins;
        let half_range = light.half_range;
        for (own, to) in (block * BLOCK..).zip(&mut gradients) {
            let partners = near.of(own, slots);
            if partners.is_empty() {
                continue;
            }
            let none = T::ZERO;
            let mut sums = Sums { corners: [[none; 3]; 3], normal: [none; 3], characteristic_area: none };
            let triangle = Triangle::read(light.facets, light.corners, own);
            for &partner in partners {
                let other = Triangle::read(light.facets, light.corners, partner);
                let (i, j) = if by_source { (own, partner) } else { (partner, own) };
                let (source, receiver) = if by_source { (triangle, other) } else { (other, triangle) };
                let pair = ClosePair { source, receiver, class, receiver_bins, half_range };
                let (front, back) = light.bins_of(i - self.sources_page, class);
                let exchange = Exchange {
                    radiance: light.radiance(i),
                    front,
                    back,
                    irradiance: cotangents.of_irradiance(j),
                    incident: cotangents.of_bins(j - self.receivers_page, receiver_bins),
                };
                match by_source {
                    true => pair.differentiate::<true>(&light.layout, &exchange, pieces, &mut sums),
                    false => pair.differentiate::<false>(&light.layout, &exchange, pieces, &mut sums),
                }
            }
            *to = gradient(sums.corners, sums.normal, none, sums.characteristic_area);
        }
        gradients
    }
}

impl<T: Real> ClosePair<T> {
    /// Adds the derivatives by the geometry of the source, where `BY_SOURCE`, or of the receiver.
    fn differentiate<const BY_SOURCE: bool>(
        &self,
        layout: &Layout<T>,
        exchange: &Exchange<T>,
        pieces: &mut PieceSlopes<T>,
        sums: &mut Sums<T>,
    ) {
        let Self { source, receiver, class, .. } = self;
        let range = self.half_range * (source.facet.characteristic_area + receiver.facet.characteristic_area);
        let between = minus(receiver.facet.centre, source.facet.centre);
        let r2 = dot(between, between);
        let near = T::ONE - far_weight(r2, range);
        let weight = T::of(0.25) * near;
        let onto = quarters(&receiver.corners);
        let mut by_near = T::ZERO;
        let mut by_range = T::ZERO;
        if !class.has_bins() && !self.receiver_bins {
            // Lambert's formula is exact for the whole source.
            let mut whole = PieceSlopes::<T, WHOLE>::NONE;
            let ends = (&[source.corners][..], &onto);
            if whole.evaluate::<BY_SOURCE>(self, layout, exchange, ends, [weight; 2]) {
                by_near += whole.by_weight();
                whole.add_to::<BY_SOURCE>(|_, by| by, from_quarter, sums);
            }
        } else {
            let from = quarters(&source.corners);
            let finest = range * T::of(QUARTER_RANGE);
            // Blend weights of quarters, where radiance varies with direction.
            let lines: [[T; 3]; ALL] =
                std::array::from_fn(|k| minus(centroid(onto[k / 4]), centroid(from[k % 4])));
            let far: [T; ALL] = std::array::from_fn(|k| match class.has_bins() {
                true => far_weight(dot(lines[k], lines[k]), finest),
                false => T::ONE,
            });
            let binned: [T; ALL] = std::array::from_fn(|k| weight * far[k]);
            let mut by_far = [T::ZERO; ALL];
            let ends = (&from[..], &onto);
            if pieces.evaluate_blended::<BY_SOURCE>(self, layout, exchange, ends, (weight, &binned)) {
                by_near += pieces.by_weight();
                for k in 0..ALL {
                    by_far[k] = weight * pieces.by_binned[k];
                }
                pieces.add_to::<BY_SOURCE>(from_quarter, from_quarter, sums);
            }
            for k in 0..ALL {
                if far[k] >= T::ONE {
                    continue;
                }
                let finer = T::of(0.0625) * near;
                let ends = (&quarters(&from[k % 4])[..], &quarters(&onto[k / 4]));
                let weights = [T::ZERO, finer * (T::ONE - far[k])];
                if pieces.evaluate::<BY_SOURCE>(self, layout, exchange, ends, weights) {
                    by_near += pieces.by_weight();
                    let by_binned = pieces.by_binned.iter().fold(T::ZERO, |sum, &by| sum + by);
                    by_far[k] -= finer * by_binned;
                    pieces.add_to::<BY_SOURCE>(
                        |finer, by| from_quarter(k % 4, from_quarter(finer, by)),
                        |finer, by| from_quarter(k / 4, from_quarter(finer, by)),
                        sums,
                    );
                }
                let [by_r2, of_range] = far_weight_slopes(dot(lines[k], lines[k]), finest);
                by_range += by_far[k] * of_range * T::of(QUARTER_RANGE);
                let scale = T::of(2.0 / 3.0) * by_far[k] * by_r2;
                let (quarter, sign) = if BY_SOURCE { (k % 4, -scale) } else { (k / 4, scale) };
                add(&mut sums.corners, from_quarter(quarter, [times(sign, lines[k]); 3]));
            }
        }
        // near = 1 - far_weight; every piece has it as a factor.
        if near > T::ZERO {
            let [by_r2, of_range] = far_weight_slopes(r2, range);
            let by_weight = -by_near / near;
            by_range += by_weight * of_range;
            let scale = T::of(2.0 / 3.0) * by_weight * by_r2;
            let scale = if BY_SOURCE { -scale } else { scale };
            add(&mut sums.corners, [times(scale, between); 3]);
        }
        sums.characteristic_area += by_range * self.half_range;
    }
}

fn add<T: Real>(to: &mut Corners<T>, by: Corners<T>) {
    to.as_flattened_mut().iter_mut().zip(by.as_flattened()).for_each(|(to, &by)| *to += by);
}

/// The transpose of [`quarters`]: from the gradient by the corners of one to that by the corners of the triangle.
#[inline(always)]
fn from_quarter<T: Real>(quarter: usize, [a, b, c]: Corners<T>) -> Corners<T> {
    let plus = |a: [T; 3], b: [T; 3]| [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
    let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
    let half = T::of(0.5);
    let [ha, hb, hc] = [times(half, a), times(half, b), times(half, c)];
    match quarter {
        // p, pq, rp
        0 => [plus(a, bc), hb, hc],
        // pq, q, qr
        1 => [ha, plus(b, ca), hc],
        // rp, qr, r
        2 => [ha, hb, plus(c, ab)],
        // pq, qr, rp
        _ => [ca, ab, bc],
    }
}

/// A batch of pieces, with the derivatives of what passes.
pub(super) struct PieceSlopes<T, const N: usize = ALL> {
    /// Weights of radiance in all directions, from fronts, and of what varies with direction; zero where nothing passes.
    diffuse: [T; N],
    binned: [T; N],
    /// ∫ cosθ dω, with its gradients by the normal of the receiver and by the corners of the source relative to the point.
    projected: [T; N],
    by_normal: Coordinates<T, N>,
    by_corners: [Coordinates<T, N>; 3],
    /// 1 where the front of the source sends it, otherwise 0.
    front: [T; N],
    direction: Coordinates<T, N>,
    length: [T; N],
    /// ⟨weighted L, λ⟩.
    value: [T; N],
    /// The derivative by the weight of what varies with direction.
    by_binned: [T; N],
    exchanged: Exchanged<T, N>,
    sides: [Side<T, N>; 3],
    /// Gradients by the corners of the source, or, at first, by the point of the receiver.
    sums: [Coordinates<T, N>; 3],
    normals: Coordinates<T, N>,
}

/// θ ⟨u, n⟩ of a side that subtends θ, u being the unit normal of its plane, clipped at the horizon, with its derivatives by n and by its
/// ends.
struct Side<T, const N: usize> {
    value: [T; N],
    by_normal: Coordinates<T, N>,
    by_begin: Coordinates<T, N>,
    by_end: Coordinates<T, N>,
}

impl<T: Real, const N: usize> Side<T, N> {
    const NONE: Self = Self {
        value: [T::ZERO; N],
        by_normal: [[T::ZERO; N]; 3],
        by_begin: [[T::ZERO; N]; 3],
        by_end: [[T::ZERO; N]; 3],
    };

    /// Terms n × a/|a|² and n × b/|b|² are left out, as they cancel around a polygon.
    #[inline(always)]
    fn set(
        &mut self,
        normal: [T; 3],
        (begin, end): (&Coordinates<T, N>, &Coordinates<T, N>),
        (heights_begin, heights_end): (&[T; N], &[T; N]),
    ) {
        for k in 0..N {
            let (p, q, hp, hq) = (at(begin, k), at(end, k), heights_begin[k], heights_end[k]);
            let (above_p, above_q) = (hp > T::ZERO, hq > T::ZERO);
            let crosses = above_p != above_q;
            let along = if crosses { hp / (hp - hq) } else { T::ZERO };
            let crossing = crossing([p, q], [hp, hq]);
            let (a, b) = (choose(above_p, p, crossing), choose(above_q, q, crossing));
            let c = cross(a, b);
            let sine2 = dot(c, c);
            let sine = sine2.root();
            let (a2, b2, cosine) = (dot(a, a), dot(b, b), dot(a, b));
            let angle = subtended(sine2, sine, cosine);
            let seen = (above_p | above_q) & (sine > T::SHORTEST * (a2 + b2));
            let per = T::ONE / sine.most(T::of(1e-30));
            let unit = times(per, c);
            let height = dot(unit, normal);
            let ratio = angle * per;
            let across = minus(normal, times(height, unit));
            let (of_a, of_b) = (T::ONE / a2.most(T::of(1e-30)), T::ONE / b2.most(T::of(1e-30)));
            let end_a = [ratio * b[0] - a[0] * of_a, ratio * b[1] - a[1] * of_a, ratio * b[2] - a[2] * of_a];
            let end_b = [ratio * a[0] - b[0] * of_b, ratio * a[1] - b[1] * of_b, ratio * a[2] - b[2] * of_b];
            let zero = [T::ZERO; 3];
            let by_a = choose(seen, cross(end_a, across), zero);
            let by_b = choose(seen, cross(across, end_b), zero);
            // Where a side crosses the horizon, the crossing moves with its two ends; moving along the side changes nothing, since light
            // from the horizon contributes nothing.
            let by_crossing = choose(crosses, choose(above_p, by_b, by_a), zero);
            let (by_p, by_q) = (choose(above_p, by_a, zero), choose(above_q, by_b, zero));
            self.value[k] = if seen { angle * height } else { T::ZERO };
            for axis in 0..3 {
                self.by_normal[axis][k] = if seen { angle * unit[axis] } else { T::ZERO };
                self.by_begin[axis][k] = by_p[axis] + (T::ONE - along) * by_crossing[axis];
                self.by_end[axis][k] = by_q[axis] + along * by_crossing[axis];
            }
        }
    }
}

impl<T: Real, const N: usize> PieceSlopes<T, N> {
    pub const NONE: Self = Self {
        diffuse: [T::ZERO; N],
        binned: [T::ZERO; N],
        projected: [T::ZERO; N],
        by_normal: [[T::ZERO; N]; 3],
        by_corners: [[[T::ZERO; N]; 3]; 3],
        front: [T::ZERO; N],
        direction: [[T::ZERO; N]; 3],
        length: [T::ZERO; N],
        value: [T::ZERO; N],
        by_binned: [T::ZERO; N],
        exchanged: Exchanged::NONE,
        sides: [Side::NONE, Side::NONE, Side::NONE],
        sums: [[[T::ZERO; N]; 3]; 3],
        normals: [[T::ZERO; N]; 3],
    };

    /// Evaluates the N pieces of a pair with the same weights `[diffuse, binned]` for all; returns whether
    /// anything passes.
    fn evaluate<const BY_SOURCE: bool>(
        &mut self,
        pair: &ClosePair<T>,
        layout: &Layout<T>,
        exchange: &Exchange<T>,
        ends: (&[Corners<T>], &[Corners<T>; 4]),
        [diffuse, binned]: [T; 2],
    ) -> bool {
        self.evaluate_blended::<BY_SOURCE>(pair, layout, exchange, ends, (diffuse, &[binned; N]))
    }

    /// Evaluates the pieces from some triangles to others. The weights are those of diffuse radiance and, by
    /// piece, of directional radiance. Returns whether anything passes.
    fn evaluate_blended<const BY_SOURCE: bool>(
        &mut self,
        pair: &ClosePair<T>,
        layout: &Layout<T>,
        exchange: &Exchange<T>,
        (from, onto): (&[Corners<T>], &[Corners<T>; 4]),
        (diffuse, binned): (T, &[T; N]),
    ) -> bool {
        let (seen, offset) = views::<T, N>(from, onto);
        let bins = [pair.class.has_bins(), pair.receiver_bins];
        let (i, j) = (&pair.source.facet, &pair.receiver.facet);
        vectorised(
            #[inline(always)]
            || {
                self.project(j.normal, &seen);
                let coincident = T::COINCIDENT * i.characteristic_area;
                let [glossy, blocker]: [T; 2] = [flag(pair.class.glossy), flag(pair.class.blocker)];
                for k in 0..N {
                    let d = at(&offset, k);
                    let length = dot(d, d).most(T::of(1e-30)).root();
                    let height = dot(d, i.normal);
                    let front = height > T::ZERO;
                    let passes = (height * height > coincident) & (self.projected[k] > T::ZERO);
                    let [of_diffuse, of_binned] = [
                        if front { diffuse } else { T::ZERO },
                        binned[k] * if front { glossy } else { blocker },
                    ];
                    self.diffuse[k] = if passes { of_diffuse } else { T::ZERO };
                    self.binned[k] = if passes { of_binned } else { T::ZERO };
                    self.front[k] = if front { T::ONE } else { T::ZERO };
                    self.length[k] = length;
                    for a in 0..3 {
                        self.direction[a][k] = d[a] / length;
                    }
                }
                let weights = self.diffuse.iter().zip(&self.binned);
                if weights.fold(T::ZERO, |any, (&d, &b)| any.most(d).most(b)) <= T::ZERO {
                    return false;
                }
                let Self { direction, front, exchanged, .. } = self;
                exchanged.aim(layout, bins, (&*direction, &*front), |_| *i, |_| *j);
                for k in 0..N {
                    self.exchange(k, layout, exchange);
                }
                let Self { direction, front, exchanged, .. } = self;
                exchanged.differentiate(layout, bins, (&*direction, &*front), |_| *i, |_| *j);
                self.differentiate::<BY_SOURCE>();
                true
            },
        )
    }

    #[inline(always)]
    fn exchange(&mut self, k: usize, layout: &Layout<T>, of: &Exchange<T>) {
        let [diffuse, binned] = [self.diffuse[k], self.binned[k]];
        (self.value[k], self.by_binned[k]) = (T::ZERO, T::ZERO);
        if diffuse > T::ZERO || binned > T::ZERO {
            let front = self.front[k] > T::ZERO;
            let radiance = if front { of.radiance } else { [T::ZERO; 4] };
            let ends = Ends {
                diffuse: radiance,
                sent: if front { (of.front, T::ONE) } else { (of.back, -T::ONE) },
                irradiance: of.irradiance,
                incident: of.incident,
                weights: [diffuse, binned],
            };
            let [directional, importance] = self.exchanged.exchange(k, layout, ends);
            let directional = product(directional, importance);
            self.value[k] = diffuse * product(radiance, importance) + binned * directional;
            self.by_binned[k] = self.projected[k] * directional;
        }
    }

    /// `projected_solid_angle_gradient` of crates/core/glsl/near_field_gradient.glsl. The side in the horizon has a derivative along the normal only,
    /// which does not count.
    #[inline(always)]
    fn project(&mut self, normal: [T; 3], [p, q, r]: &[Coordinates<T, N>; 3]) {
        let mut heights = [[T::ZERO; N]; 3];
        for (height, corner) in heights.iter_mut().zip([p, q, r]) {
            for k in 0..N {
                height[k] = dot(at(corner, k), normal);
            }
        }
        let [hp, hq, hr] = &heights;
        let [pq, qr, rp] = &mut self.sides;
        pq.set(normal, (p, q), (hp, hq));
        qr.set(normal, (q, r), (hq, hr));
        rp.set(normal, (r, p), (hr, hp));
        for k in 0..N {
            let level = level_side(normal, [at(p, k), at(q, k), at(r, k)], [hp[k], hq[k], hr[k]]);
            let sum = pq.value[k] + qr.value[k] + rp.value[k] + level;
            let factor = if sum < T::ZERO { -T::of(0.5) } else { T::of(0.5) };
            self.projected[k] = factor * sum;
            for a in 0..3 {
                self.by_normal[a][k] =
                    factor * (pq.by_normal[a][k] + qr.by_normal[a][k] + rp.by_normal[a][k]);
                self.by_corners[0][a][k] = factor * (pq.by_begin[a][k] + rp.by_end[a][k]);
                self.by_corners[1][a][k] = factor * (qr.by_begin[a][k] + pq.by_end[a][k]);
                self.by_corners[2][a][k] = factor * (rp.by_begin[a][k] + qr.by_end[a][k]);
            }
        }
    }

    #[inline(always)]
    fn differentiate<const BY_SOURCE: bool>(&mut self) {
        for k in 0..N {
            let (projected, value) = (self.projected[k], self.value[k]);
            let lit = (self.diffuse[k] > T::ZERO) | (self.binned[k] > T::ZERO);
            let by = at(&self.exchanged.by_direction, k);
            let by_offset =
                through_normalization(times(projected, by), at(&self.direction, k), self.length[k]);
            for a in 0..3 {
                let of = |corner: usize| value * self.by_corners[corner][a][k];
                let of = [of(0), of(1), of(2)];
                if BY_SOURCE {
                    let third = by_offset[a] * T::of(1.0 / 3.0);
                    for corner in 0..3 {
                        self.sums[corner][a][k] = if lit { of[corner] - third } else { T::ZERO };
                    }
                    let by_normal = projected * self.exchanged.by_source_normal[a][k];
                    self.normals[a][k] = if lit { by_normal } else { T::ZERO };
                } else {
                    let by_point = by_offset[a] - (of[0] + of[1] + of[2]);
                    self.sums[0][a][k] = if lit { by_point } else { T::ZERO };
                    let by_normal =
                        projected * self.exchanged.by_receiver_normal[a][k] + value * self.by_normal[a][k];
                    self.normals[a][k] = if lit { by_normal } else { T::ZERO };
                }
            }
        }
    }

    /// The derivative by a factor of all weights.
    fn by_weight(&self) -> T {
        self.projected.iter().zip(&self.value).fold(T::ZERO, |sum, (&of, &value)| sum + of * value)
    }

    /// Adds the gradients by pieces to those by the triangle; `of_source` and `of_receiver` turn gradients by the corners of the k-th of
    /// the triangles at either end into those by its corners.
    fn add_to<const BY_SOURCE: bool>(
        &self,
        of_source: impl Fn(usize, Corners<T>) -> Corners<T>,
        of_receiver: impl Fn(usize, Corners<T>) -> Corners<T>,
        sums: &mut Sums<T>,
    ) {
        let sources = N / 4;
        if BY_SOURCE {
            for source in 0..sources {
                let mut by = [[T::ZERO; 3]; 3];
                for k in (source..N).step_by(sources) {
                    (0..3).for_each(|corner| (0..3).for_each(|a| by[corner][a] += self.sums[corner][a][k]));
                }
                add(&mut sums.corners, of_source(source, by));
            }
        } else {
            for receiver in 0..4 {
                let mut by = [T::ZERO; 3];
                for k in receiver * sources..(receiver + 1) * sources {
                    (0..3).for_each(|a| by[a] += self.sums[0][a][k]);
                }
                add(&mut sums.corners, of_receiver(receiver, [times(T::of(1.0 / 3.0), by); 3]));
            }
        }
        for (to, of) in sums.normal.iter_mut().zip(&self.normals) {
            *to = of.iter().fold(*to, |sum, &by| sum + by);
        }
    }
}

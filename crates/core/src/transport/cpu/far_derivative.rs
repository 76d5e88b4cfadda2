//! Derivatives of what passes between N pairs of triangles, point to point. Twin of
//! crates/core/glsl/transport_derivative.comp.

use super::derivative::{Derivative, Gradient, gradient};
use super::exchanged::{Coordinates, Ends, Exchanged, at, product, set};
use super::far::{BLOCK, Sources, flag};
use super::far_adjoint::{Cotangents, Receivers, sides};
use super::pairs::{Facet, Facets, R2_MIN, dot, far_weight, far_weight_slopes, through_normalization};
use super::real::Real;
use super::taps::Layout;
use crate::model::Class;
use crate::plan::{PAIR_BACK, PAIR_FRONT, PAIR_NEAR};
use crate::transport::shape::Shape;
use antirad_gpu::vectorised;
use std::f64::consts::FRAC_1_PI;

/// N pairs: of one source or of one receiver.
trait Pairs<T> {
    fn source(&self, k: usize) -> Facet<T>;
    fn receiver(&self, k: usize) -> Facet<T>;
    /// 1 or 0 for the front and for the back of the source.
    fn sides(&self, k: usize) -> [T; 2];
    fn radiance(&self, k: usize) -> [T; 4];
    /// Bins of a side of the source.
    fn sent(&self, k: usize, front: bool) -> &[T];
    /// Cotangents of irradiance, and of bins.
    fn irradiance(&self, k: usize) -> [T; 4];
    fn incident(&self, k: usize) -> &[T];
}

/// RGB values by channel.
struct Rgb<T, const N: usize>(Coordinates<T, N>);

impl<T: Real, const N: usize> Rgb<T, N> {
    fn new(of: impl Fn(usize) -> [T; 4]) -> Self {
        let mut all = [[T::ZERO; N]; 3];
        for k in 0..N {
            let value = of(k);
            set(&mut all, k, [value[0], value[1], value[2]]);
        }
        Self(all)
    }

    #[inline(always)]
    fn get(&self, k: usize) -> [T; 4] {
        [self.0[0][k], self.0[1][k], self.0[2][k], T::ZERO]
    }
}

/// Pairs of one source and the receivers of a block.
struct FromOne<'a, T, const N: usize> {
    source: Facet<T>,
    sides: [T; 2],
    radiance: [T; 4],
    front: &'a [T],
    back: &'a [T],
    receivers: &'a Facets<T, N>,
    /// 1 where the receiver is a triangle, 0 where it is padding.
    exists: &'a [T; N],
    irradiance: &'a Rgb<T, N>,
    cotangents: &'a Cotangents<'a, T>,
    receiver_bins: bool,
    /// Place of the first receiver in its page.
    place: u32,
}

impl<T: Real, const N: usize> Pairs<T> for FromOne<'_, T, N> {
    #[inline(always)]
    fn source(&self, _: usize) -> Facet<T> {
        self.source
    }

    #[inline(always)]
    fn receiver(&self, k: usize) -> Facet<T> {
        self.receivers.get(k)
    }

    #[inline(always)]
    fn sides(&self, k: usize) -> [T; 2] {
        [self.sides[0] * self.exists[k], self.sides[1] * self.exists[k]]
    }

    #[inline(always)]
    fn radiance(&self, _: usize) -> [T; 4] {
        self.radiance
    }

    #[inline(always)]
    fn sent(&self, _: usize, front: bool) -> &[T] {
        if front { self.front } else { self.back }
    }

    #[inline(always)]
    fn irradiance(&self, k: usize) -> [T; 4] {
        self.irradiance.get(k)
    }

    #[inline(always)]
    fn incident(&self, k: usize) -> &[T] {
        self.cotangents.of_bins(self.place + k as u32, self.receiver_bins)
    }
}

/// Pairs of the sources of a block and one receiver.
struct ToOne<'a, T, const N: usize> {
    sources: &'a Facets<T, N>,
    sides: [T; 2],
    radiance: &'a Rgb<T, N>,
    bins: &'a [[&'a [T]; 2]; N],
    receiver: Facet<T>,
    irradiance: [T; 4],
    incident: &'a [T],
}

impl<T: Real, const N: usize> Pairs<T> for ToOne<'_, T, N> {
    #[inline(always)]
    fn source(&self, k: usize) -> Facet<T> {
        self.sources.get(k)
    }

    #[inline(always)]
    fn receiver(&self, _: usize) -> Facet<T> {
        self.receiver
    }

    #[inline(always)]
    fn sides(&self, _: usize) -> [T; 2] {
        self.sides
    }

    #[inline(always)]
    fn radiance(&self, k: usize) -> [T; 4] {
        self.radiance.get(k)
    }

    #[inline(always)]
    fn sent(&self, k: usize, front: bool) -> &[T] {
        self.bins[k][usize::from(!front)]
    }

    #[inline(always)]
    fn irradiance(&self, _: usize) -> [T; 4] {
        self.irradiance
    }

    #[inline(always)]
    fn incident(&self, _: usize) -> &[T] {
        self.incident
    }
}

impl<T: Real> Derivative<'_, T> {
    /// Gradients of the N receivers of a block, from all their sources.
    pub(super) fn by_receivers<const N: usize>(
        &self,
        of: &Sources,
        block: u32,
        slopes: &mut Slopes<T, N>,
    ) -> [Gradient<T>; N] {
        let Self { light, cotangents, .. } = self;
        let first = block * BLOCK;
        let receivers = Facets::<T, N>::new(|k| Facet::read(light.facets, first + k as u32));
        // Padding is within the horizon of everything.
        let exists: [T; N] = std::array::from_fn(|k| flag(receivers.get(k).area > T::ZERO));
        let irradiance = Rgb::<T, N>::new(|k| cotangents.of_irradiance(first + k as u32));
        let mut sums = Sums::NONE;
        of.visit(block, |index, bits| {
            let fronts = bits & PAIR_FRONT != 0;
            let backs = self.shape.source.blocker && bits & PAIR_BACK != 0;
            if !fronts && !backs {
                return;
            }
            let class = Class { blocker: backs, ..self.shape.source };
            let (front, back) = light.bins_of(index - self.sources_page, class);
            let near = bits & PAIR_NEAR != 0;
            let pairs = FromOne {
                source: Facet::read(light.facets, index),
                sides: [flag(fronts), flag(backs)],
                radiance: light.radiance(index),
                front,
                back,
                receivers: &receivers,
                exists: &exists,
                irradiance: &irradiance,
                cotangents,
                receiver_bins: self.shape.receiver_bins,
                place: first - self.receivers_page,
            };
            let of = (&light.layout, self.shape, near.then_some(light.half_range));
            vectorised(
                #[inline(always)]
                || slopes.add::<false>(of, &pairs, &mut sums),
            );
        });
        sums.gradients()
    }

    /// Gradients of the N sources of a block, from all their receivers.
    pub(super) fn by_sources<const N: usize>(
        &self,
        of: &Receivers,
        block: u32,
        slopes: &mut Slopes<T, N>,
    ) -> [Gradient<T>; N] {
        let Self { light, cotangents, .. } = self;
        let index = |k: usize| block * BLOCK + k as u32;
        let sources = Facets::<T, N>::new(|k| Facet::read(light.facets, index(k)));
        let radiance = Rgb::<T, N>::new(|k| light.radiance(index(k)));
        let bins: [[&[T]; 2]; N] = std::array::from_fn(|k| {
            let (front, back) = light.bins_of(index(k) - self.sources_page, self.shape.source);
            [front, back]
        });
        let mut sums = Sums::NONE;
        of.visit(block, |slots, passing| {
            let sides = sides(passing, self.shape.source);
            if sides == [T::ZERO; 2] {
                return;
            }
            let near = passing & PAIR_NEAR != 0;
            for slot in slots {
                let receiver = Facet::read(light.facets, slot);
                if receiver.area <= T::ZERO {
                    continue;
                }
                let pairs = ToOne {
                    sources: &sources,
                    sides,
                    radiance: &radiance,
                    bins: &bins,
                    receiver,
                    irradiance: cotangents.of_irradiance(slot),
                    incident: cotangents.of_bins(slot - self.receivers_page, self.shape.receiver_bins),
                };
                let of = (&light.layout, self.shape, near.then_some(light.half_range));
                vectorised(
                    #[inline(always)]
                    || slopes.add::<true>(of, &pairs, &mut sums),
                );
            }
        });
        sums.gradients()
    }
}

/// Derivatives by the centroids of N triangles, by their normals, areas, and characteristic areas.
struct Sums<T, const N: usize> {
    centre: Coordinates<T, N>,
    normal: Coordinates<T, N>,
    area: [T; N],
    characteristic_area: [T; N],
}

impl<T: Real, const N: usize> Sums<T, N> {
    const NONE: Self = Self {
        centre: [[T::ZERO; N]; 3],
        normal: [[T::ZERO; N]; 3],
        area: [T::ZERO; N],
        characteristic_area: [T::ZERO; N],
    };

    fn gradients(&self) -> [Gradient<T>; N] {
        std::array::from_fn(|k| {
            let third = at(&self.centre, k).map(|by| by * T::of(1.0 / 3.0));
            gradient([third; 3], at(&self.normal, k), self.area[k], self.characteristic_area[k])
        })
    }
}

/// The line between the centroids of a pair.
#[derive(Clone, Copy)]
struct Line<T> {
    d: [T; 3],
    r2: T,
    length: T,
    direction: [T; 3],
    /// 1 where the receiver is on the front side of the source, otherwise -1.
    side: T,
    /// |cos_i| and cos_j.
    from: T,
    to: T,
    /// r² + a/π.
    wide: T,
}

#[inline(always)]
fn line<T: Real>(i: &Facet<T>, j: &Facet<T>) -> Line<T> {
    let d = [j.centre[0] - i.centre[0], j.centre[1] - i.centre[1], j.centre[2] - i.centre[2]];
    let r2 = dot(d, d).most(T::of(R2_MIN));
    let length = r2.root();
    let direction = [d[0] / length, d[1] / length, d[2] / length];
    let along = dot(direction, i.normal);
    let side = if along > T::ZERO { T::ONE } else { -T::ONE };
    Line {
        d,
        r2,
        length,
        direction,
        side,
        from: along.magnitude(),
        to: -dot(direction, j.normal),
        wide: r2 + i.area * T::of(FRAC_1_PI),
    }
}

/// What a block reuses.
pub(super) struct Slopes<T, const N: usize> {
    /// max(cos_j, 0) |cos_i| g_ij a_i with the blend weight; zero where nothing passes.
    weight: [T; N],
    /// 1 where the front of the source sends it, otherwise 0.
    front: [T; N],
    direction: Coordinates<T, N>,
    blend: [T; N],
    /// Slopes of the blend weight by r² and by the range.
    blend_slopes: [[T; N]; 2],
    /// ⟨L, λ⟩.
    value: [T; N],
    exchanged: Exchanged<T, N>,
}

impl<T: Real, const N: usize> Slopes<T, N> {
    pub const NONE: Self = Self {
        weight: [T::ZERO; N],
        front: [T::ZERO; N],
        direction: [[T::ZERO; N]; 3],
        blend: [T::ONE; N],
        blend_slopes: [[T::ZERO; N]; 2],
        value: [T::ZERO; N],
        exchanged: Exchanged::NONE,
    };

    /// Adds the derivatives by the geometry of sources, where `BY_SOURCE`, or receivers. With `half_range` only where pairs may be
    /// close.
    #[inline(always)]
    fn add<const BY_SOURCE: bool>(
        &mut self,
        (layout, shape, half_range): (&Layout<T>, Shape, Option<T>),
        pairs: &impl Pairs<T>,
        sums: &mut Sums<T, N>,
    ) {
        self.weigh(pairs, half_range);
        let any = self.weight.iter().fold(T::ZERO, |most, &weight| most.most(weight));
        if any <= T::ZERO {
            return;
        }
        let bins = [shape.source.has_bins(), shape.receiver_bins];
        if shape.any_bins() {
            let Self { front, direction, exchanged, .. } = self;
            exchanged.aim(layout, bins, (&*direction, &*front), |k| pairs.source(k), |k| pairs.receiver(k));
            for k in 0..N {
                if self.weight[k] > T::ZERO {
                    self.exchange(k, layout, pairs);
                }
            }
            let Self { front, direction, exchanged, .. } = self;
            let (source, receiver) = (|k| pairs.source(k), |k| pairs.receiver(k));
            exchanged.differentiate(layout, bins, (&*direction, &*front), source, receiver);
        } else {
            self.multiply(pairs);
        }
        self.sum::<BY_SOURCE>(pairs, half_range, sums);
    }

    #[inline(always)]
    fn weigh(&mut self, pairs: &impl Pairs<T>, half_range: Option<T>) {
        for k in 0..N {
            let (i, j, [fronts, backs]) = (pairs.source(k), pairs.receiver(k), pairs.sides(k));
            let line = line(&i, &j);
            let front = line.side > T::ZERO;
            let side = if front { fronts } else { backs };
            self.weight[k] = side * line.from * line.to.most(T::ZERO) * (i.area / line.wide);
            self.front[k] = if front { T::ONE } else { T::ZERO };
            for a in 0..3 {
                self.direction[a][k] = line.direction[a];
            }
        }
        if let Some(half_range) = half_range {
            for k in 0..N {
                let (i, j) = (pairs.source(k), pairs.receiver(k));
                let range = half_range * (i.characteristic_area + j.characteristic_area);
                let r2 = line(&i, &j).r2;
                self.blend[k] = far_weight(r2, range);
                self.weight[k] *= self.blend[k];
                [self.blend_slopes[0][k], self.blend_slopes[1][k]] = far_weight_slopes(r2, range);
            }
        } else {
            self.blend = [T::ONE; N];
            self.blend_slopes = [[T::ZERO; N]; 2];
        }
    }

    /// One pair where either end has bins.
    #[inline(always)]
    fn exchange(&mut self, k: usize, layout: &Layout<T>, pairs: &impl Pairs<T>) {
        let front = self.front[k] > T::ZERO;
        let diffuse = if front { pairs.radiance(k) } else { [T::ZERO; 4] };
        let ends = Ends {
            diffuse,
            sent: (pairs.sent(k, front), if front { T::ONE } else { -T::ONE }),
            irradiance: pairs.irradiance(k),
            incident: pairs.incident(k),
            weights: [T::ONE; 2],
        };
        let [binned, importance] = self.exchanged.exchange(k, layout, ends);
        self.value[k] = product(diffuse, importance) + product(binned, importance);
    }

    /// All pairs where no end has bins: backs send nothing.
    #[inline(always)]
    fn multiply(&mut self, pairs: &impl Pairs<T>) {
        for k in 0..N {
            self.value[k] = product(pairs.radiance(k), pairs.irradiance(k));
        }
    }

    #[inline(always)]
    fn sum<const BY_SOURCE: bool>(
        &self,
        pairs: &impl Pairs<T>,
        half_range: Option<T>,
        sums: &mut Sums<T, N>,
    ) {
        let half_range = half_range.unwrap_or(T::ZERO);
        let two = T::of(2.0);
        for k in 0..N {
            let (i, j) = (pairs.source(k), pairs.receiver(k));
            let line = line(&i, &j);
            let Line { d, r2, length, direction, side, from, to, wide, .. } = line;
            let (weight, blend, value) = (self.weight[k], self.blend[k], self.value[k]);
            let kernel = i.area / wide;
            let of_cosine = blend * from * kernel * value;
            let whole = to * value;
            let by_from = side * blend * kernel * whole;
            let plain = whole * from * kernel;
            let by_r2 = self.blend_slopes[0][k] * plain - blend * plain / wide;
            let by_exchanged = at(&self.exchanged.by_direction, k);
            let by_direction =
                |a: usize| by_from * i.normal[a] - of_cosine * j.normal[a] + weight * by_exchanged[a];
            let by_direction = [by_direction(0), by_direction(1), by_direction(2)];
            let through = through_normalization(by_direction, direction, length);
            let lit = weight > T::ZERO;
            let sign = if BY_SOURCE { -T::ONE } else { T::ONE };
            for a in 0..3 {
                let by_between = two * by_r2 * d[a] + through[a];
                let by_normal = if BY_SOURCE {
                    by_from * direction[a] + weight * self.exchanged.by_source_normal[a][k]
                } else {
                    weight * self.exchanged.by_receiver_normal[a][k] - of_cosine * direction[a]
                };
                sums.centre[a][k] += if lit { sign * by_between } else { T::ZERO };
                sums.normal[a][k] += if lit { by_normal } else { T::ZERO };
            }
            let by_range = self.blend_slopes[1][k] * plain * half_range;
            sums.characteristic_area[k] += if lit { by_range } else { T::ZERO };
            if BY_SOURCE {
                let by_area = whole * blend * from * r2 / (wide * wide);
                sums.area[k] += if lit { by_area } else { T::ZERO };
            }
        }
    }
}

//! Derivatives of what passes between N pairs of triangles, point to point. Twin of crates/core/glsl/transport_derivative.comp and
//! listed_gradient.glsl.

use super::derivative::{Derivative, Gradient, gradient};
use super::exchanged::{Coordinates, Ends, Exchanged, at, product, set};
use super::far::{Sources, flag};
use super::far_adjoint::{Cotangents, Receivers};
use super::pairs::{Facet, Facets, R2_MIN, dot, far_weight, far_weight_slopes, through_normalization};
use super::real::Real;
use super::taps::{Layout, add};
use crate::model::{Class, LIST};
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
    /// 1 for pairs that may be close, otherwise 0.
    fn near(&self, k: usize) -> T;
    fn radiance(&self, k: usize) -> [T; 4];
    /// The first moment of the radiance of a cluster.
    fn moment(&self, k: usize) -> [[T; 4]; 3];
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
    near: T,
    radiance: [T; 4],
    moment: [[T; 4]; 3],
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
    fn near(&self, _: usize) -> T {
        self.near
    }

    #[inline(always)]
    fn radiance(&self, _: usize) -> [T; 4] {
        self.radiance
    }

    #[inline(always)]
    fn moment(&self, _: usize) -> [[T; 4]; 3] {
        self.moment
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
    sides: &'a [[T; 2]; N],
    near: &'a [T; N],
    radiance: &'a Rgb<T, N>,
    moment: &'a [Rgb<T, N>; 3],
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
    fn sides(&self, k: usize) -> [T; 2] {
        self.sides[k]
    }

    #[inline(always)]
    fn near(&self, k: usize) -> T {
        self.near[k]
    }

    #[inline(always)]
    fn radiance(&self, k: usize) -> [T; 4] {
        self.radiance.get(k)
    }

    #[inline(always)]
    fn moment(&self, k: usize) -> [[T; 4]; 3] {
        [self.moment[0].get(k), self.moment[1].get(k), self.moment[2].get(k)]
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
        let first = block * LIST;
        let receivers = Facets::<T, N>::new(|k| Facet::read(light.facets, first + k as u32));
        // Padding is within the horizon of everything.
        let exists: [T; N] = std::array::from_fn(|k| flag(receivers.get(k).area > T::ZERO));
        let irradiance = Rgb::<T, N>::new(|k| cotangents.of_irradiance(first + k as u32));
        let clusters = of.clusters();
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
                near: flag(near),
                radiance: light.radiance(index),
                moment: clusters.map_or([[T::ZERO; 4]; 3], |of| light.moment(index, of)),
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
                || match clusters {
                    Some(_) => slopes.add::<true, false>(of, &pairs, &mut sums),
                    None => slopes.add::<false, false>(of, &pairs, &mut sums),
                },
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
        let own = of.sources(block);
        let index = |k: usize| (own.start + k as u32).min(own.end - 1);
        let sources = Facets::<T, N>::new(|k| Facet::read(light.facets, index(k)));
        let radiance = Rgb::<T, N>::new(|k| light.radiance(index(k)));
        let clusters = of.clusters();
        let moment: [Rgb<T, N>; 3] = std::array::from_fn(|row| {
            Rgb::new(|k| clusters.map_or([T::ZERO; 4], |of| light.moment(index(k), of)[row]))
        });
        let bins: [[&[T]; 2]; N] = std::array::from_fn(|k| {
            let (front, back) = light.bins_of(index(k) - self.sources_page, self.shape.source);
            [front, back]
        });
        let mut sums = Sums::NONE;
        of.visit(block, |slots, passing| {
            let sides: [[T; 2]; N] = passing.sides(own.len(), self.shape.source);
            let near: [T; N] = std::array::from_fn(|k| passing.has(k, PAIR_NEAR));
            if sides.as_flattened().iter().all(|side| *side == T::ZERO) {
                return;
            }
            let any_near = near.iter().any(|near| *near > T::ZERO);
            for slot in slots {
                let receiver = Facet::read(light.facets, slot);
                if receiver.area <= T::ZERO {
                    continue;
                }
                let pairs = ToOne {
                    sources: &sources,
                    sides: &sides,
                    near: &near,
                    radiance: &radiance,
                    moment: &moment,
                    bins: &bins,
                    receiver,
                    irradiance: cotangents.of_irradiance(slot),
                    incident: cotangents.of_bins(slot - self.receivers_page, self.shape.receiver_bins),
                };
                let of = (&light.layout, self.shape, any_near.then_some(light.half_range));
                vectorised(
                    #[inline(always)]
                    || match clusters {
                        Some(_) => slopes.add::<true, true>(of, &pairs, &mut sums),
                        None => slopes.add::<false, true>(of, &pairs, &mut sums),
                    },
                );
            }
        });
        sums.gradients()
    }
}

/// Derivatives by the centroids of N triangles, by their normals, areas, and characteristic areas; of clusters, variances in place of
/// these.
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
    /// |cos_i|, cos_j, and the cosine between the normals of the two sides that face each other.
    from: T,
    to: T,
    tilt: T,
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
        tilt: side * dot(j.normal, i.normal),
        wide: r2 + i.area * T::of(FRAC_1_PI),
    }
}

/// `Spread` of crates/core/glsl/spread.glsl, and what it is the result of.
struct Seen<T> {
    cosine: T,
    above: T,
    mean: T,
    width: T,
}

/// How the receiver sees a cluster with this variance of the angle.
#[inline(always)]
fn spread<T: Real>(line: &Line<T>, angle2: T) -> Seen<T> {
    let Line { from, to, tilt, .. } = *line;
    let width = (T::of(1.5) * angle2 * (T::ONE - tilt * tilt)).most(T::ZERO).root();
    let above = (T::of(0.5) + T::of(0.5) * to / width.most(T::of(1e-12))).clamped();
    let mean = if to > width { to } else { above * above * width };
    let change = mean - tilt * from - T::of(3.0) * mean * from * from;
    let cosine = (mean + above * (T::of(2.0) * angle2) * change).most(T::ZERO);
    let lit = if cosine > T::ZERO { T::ONE } else { T::ZERO };
    Seen { cosine, above: lit * above, mean: lit * mean, width }
}

/// `spread_pull` of crates/core/glsl/spread_gradient.glsl: from the derivatives by the results to those by `to`, `from`, `tilt` and `angle2`.
#[inline(always)]
fn spread_pull<T: Real>(line: &Line<T>, seen: &Seen<T>, angle2: T, [cosine, above, mean]: [T; 3]) -> [T; 4] {
    let (Line { from, to, tilt, .. }, width, two) = (*line, seen.width, T::of(2.0));
    let straddles = (width > T::ZERO) & (to.magnitude() <= width);
    let by_width = if straddles { T::ONE / width } else { T::ZERO };
    let beyond = if to > T::ZERO { T::ONE } else { T::ZERO };
    let share = if straddles { T::of(0.5) + T::of(0.5) * to * by_width } else { beyond };
    let of = if straddles { share * share * width } else { to.most(T::ZERO) };
    let second = of - tilt * from - T::of(3.0) * of * from * from;
    let lit = of + share * two * angle2 * second > T::ZERO;
    let by_mean = mean + cosine * (T::ONE + share * two * angle2 * (T::ONE - T::of(3.0) * from * from));
    let by_above = above + cosine * two * angle2 * second;
    let half = T::of(0.5);
    let at_to = by_mean * share + by_above * half * by_width;
    let at_width = by_mean * share * (T::ONE - share) - by_above * half * to * by_width * by_width;
    let at_width = if straddles { at_width } else { T::ZERO };
    let at_from = -cosine * share * two * angle2 * (tilt + T::of(6.0) * of * from);
    let at_tilt = -cosine * share * two * angle2 * from - at_width * T::of(1.5) * angle2 * tilt * by_width;
    let at_angle2 =
        cosine * share * two * second + at_width * T::of(0.75) * (T::ONE - tilt * tilt) * by_width;
    let all = [at_to, at_from, at_tilt, at_angle2];
    let none = T::ZERO;
    [
        if lit { all[0] } else { none },
        if lit { all[1] } else { none },
        if lit { all[2] } else { none },
        if lit { all[3] } else { none },
    ]
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
    /// What the first moment of a cluster's radiance is multiplied by, to count as radiance.
    uneven: Coordinates<T, N>,
    /// ⟨L, λ⟩, without the first moment.
    value: [T; N],
    /// How the importance of light changes with its place in a cluster.
    by_place: Coordinates<T, N>,
    exchanged: Exchanged<T, N>,
}

impl<T: Real, const N: usize> Slopes<T, N> {
    pub const NONE: Self = Self {
        weight: [T::ZERO; N],
        front: [T::ZERO; N],
        direction: [[T::ZERO; N]; 3],
        blend: [T::ONE; N],
        blend_slopes: [[T::ZERO; N]; 2],
        uneven: [[T::ZERO; N]; 3],
        value: [T::ZERO; N],
        by_place: [[T::ZERO; N]; 3],
        exchanged: Exchanged::NONE,
    };

    /// Adds the derivatives by the geometry of sources, where `BY_SOURCE`, or receivers; sources may be `CLUSTERS`. With `half_range` only
    /// where some pairs may be close.
    #[inline(always)]
    fn add<const CLUSTERS: bool, const BY_SOURCE: bool>(
        &mut self,
        (layout, shape, half_range): (&Layout<T>, Shape, Option<T>),
        pairs: &impl Pairs<T>,
        sums: &mut Sums<T, N>,
    ) {
        self.weigh::<CLUSTERS>(pairs, half_range);
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
                    self.exchange::<CLUSTERS>(k, layout, pairs);
                }
            }
            let Self { front, direction, exchanged, .. } = self;
            let (source, receiver) = (|k| pairs.source(k), |k| pairs.receiver(k));
            exchanged.differentiate(layout, bins, (&*direction, &*front), source, receiver);
        } else {
            self.multiply::<CLUSTERS>(pairs);
        }
        self.sum::<CLUSTERS, BY_SOURCE>(pairs, half_range, sums);
    }

    #[inline(always)]
    fn weigh<const CLUSTERS: bool>(&mut self, pairs: &impl Pairs<T>, half_range: Option<T>) {
        for k in 0..N {
            let (i, j, [fronts, backs]) = (pairs.source(k), pairs.receiver(k), pairs.sides(k));
            let line = line(&i, &j);
            let front = line.side > T::ZERO;
            let side = if front { fronts } else { backs };
            let mut cosine = line.to.most(T::ZERO);
            if CLUSTERS {
                let seen = spread(&line, i.characteristic_area / line.r2);
                cosine = seen.cosine;
                let per = T::ONE / (line.length * cosine.most(T::of(1e-30)));
                for a in 0..3 {
                    let slope = seen.above * j.normal[a] + T::of(4.0) * seen.mean * line.direction[a];
                    self.uneven[a][k] = if front { slope * per } else { T::ZERO };
                }
            }
            self.weight[k] = side * line.from * cosine * (i.area / line.wide);
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
                let (near, far, slopes) =
                    (pairs.near(k), far_weight(r2, range), far_weight_slopes(r2, range));
                let blend = T::ONE + near * (far - T::ONE);
                self.blend[k] = blend;
                self.weight[k] *= blend;
                self.blend_slopes[0][k] = near * slopes[0];
                self.blend_slopes[1][k] = near * slopes[1];
            }
        } else {
            self.blend = [T::ONE; N];
            self.blend_slopes = [[T::ZERO; N]; 2];
        }
    }

    /// One pair where either end has bins.
    #[inline(always)]
    fn exchange<const CLUSTERS: bool>(&mut self, k: usize, layout: &Layout<T>, pairs: &impl Pairs<T>) {
        let front = self.front[k] > T::ZERO;
        let even = if front { pairs.radiance(k) } else { [T::ZERO; 4] };
        let (mut diffuse, moment) = (even, pairs.moment(k));
        if CLUSTERS {
            (0..3).for_each(|row| add(&mut diffuse, self.uneven[row][k], moment[row]));
        }
        let ends = Ends {
            diffuse,
            sent: (pairs.sent(k, front), if front { T::ONE } else { -T::ONE }),
            irradiance: pairs.irradiance(k),
            incident: pairs.incident(k),
            weights: [T::ONE; 2],
        };
        let [binned, importance] = self.exchanged.exchange(k, layout, ends);
        self.value[k] = product(even, importance) + product(binned, importance);
        if CLUSTERS {
            (0..3).for_each(|row| self.by_place[row][k] = product(moment[row], importance));
        }
    }

    /// All pairs where no end has bins: backs send nothing.
    #[inline(always)]
    fn multiply<const CLUSTERS: bool>(&mut self, pairs: &impl Pairs<T>) {
        for k in 0..N {
            let (radiance, irradiance) = (pairs.radiance(k), pairs.irradiance(k));
            self.value[k] = product(radiance, irradiance);
            if CLUSTERS {
                let moment = pairs.moment(k);
                for row in 0..3 {
                    self.by_place[row][k] = product(moment[row], irradiance);
                }
            }
        }
    }

    #[inline(always)]
    fn sum<const CLUSTERS: bool, const BY_SOURCE: bool>(
        &self,
        pairs: &impl Pairs<T>,
        half_range: Option<T>,
        sums: &mut Sums<T, N>,
    ) {
        let half_range = half_range.unwrap_or(T::ZERO);
        let (two, four) = (T::of(2.0), T::of(4.0));
        for k in 0..N {
            let (i, j) = (pairs.source(k), pairs.receiver(k));
            let line = line(&i, &j);
            let Line { d, r2, length, direction, side, from, to, wide, .. } = line;
            let (weight, blend, value) = (self.weight[k], self.blend[k], self.value[k]);
            let kernel = i.area / wide;
            let sent = blend * from * kernel;
            let front = self.front[k];
            let mut whole = to * value;
            // By cos_j, |cos_i|, the tilt and the variance of the angle; and what the first moment adds.
            let (mut of_cosine, mut of_line, mut of_normal) =
                ([sent * value, T::ZERO, T::ZERO, T::ZERO], T::ZERO, T::ZERO);
            let (mut by_place, mut by_spread) = ([T::ZERO; 3], T::ZERO);
            let mut by_r2 = T::ZERO;
            if CLUSTERS {
                let angle2 = i.characteristic_area / r2;
                let seen = spread(&line, angle2);
                let per = front / length;
                by_place = [per * self.by_place[0][k], per * self.by_place[1][k], per * self.by_place[2][k]];
                let by = [value, dot(j.normal, by_place), four * dot(direction, by_place)];
                let of_moment = seen.above * by[1] + seen.mean * by[2];
                whole = seen.cosine * value + of_moment;
                let pulled = spread_pull(&line, &seen, angle2, by);
                of_cosine = [sent * pulled[0], sent * pulled[1], sent * pulled[2], sent * pulled[3]];
                of_line = sent * four * seen.mean;
                of_normal = sent * seen.above;
                by_spread = of_cosine[3] / r2;
                by_r2 = -(of_cosine[3] * angle2 + T::of(0.5) * sent * of_moment) / r2;
            }
            let by_from = side * (blend * kernel * whole + of_cosine[1]);
            let by_tilt = side * of_cosine[2];
            let plain = whole * from * kernel;
            let by_r2 = by_r2 + self.blend_slopes[0][k] * plain - blend * plain / wide;
            let by_exchanged = at(&self.exchanged.by_direction, k);
            let by_direction = |a: usize| {
                by_from * i.normal[a] - of_cosine[0] * j.normal[a]
                    + of_line * by_place[a]
                    + weight * by_exchanged[a]
            };
            let by_direction = [by_direction(0), by_direction(1), by_direction(2)];
            let through = through_normalization(by_direction, direction, length);
            let lit = weight > T::ZERO;
            let sign = if BY_SOURCE { -T::ONE } else { T::ONE };
            for a in 0..3 {
                let by_between = two * by_r2 * d[a] + through[a];
                let by_normal = if BY_SOURCE {
                    by_from * direction[a]
                        + by_tilt * j.normal[a]
                        + weight * self.exchanged.by_source_normal[a][k]
                } else {
                    by_tilt * i.normal[a] - of_cosine[0] * direction[a]
                        + of_normal * by_place[a]
                        + weight * self.exchanged.by_receiver_normal[a][k]
                };
                sums.centre[a][k] += if lit { sign * by_between } else { T::ZERO };
                sums.normal[a][k] += if lit { by_normal } else { T::ZERO };
            }
            let by_range = self.blend_slopes[1][k] * plain * half_range;
            let by_characteristic_area = if CLUSTERS && BY_SOURCE { by_spread } else { by_range };
            sums.characteristic_area[k] += if lit { by_characteristic_area } else { T::ZERO };
            if BY_SOURCE {
                let by_area = whole * blend * from * r2 / (wide * wide);
                sums.area[k] += if lit { by_area } else { T::ZERO };
            }
        }
    }
}

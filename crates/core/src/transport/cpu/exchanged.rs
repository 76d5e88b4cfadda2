//! The product of the radiance L of a source in a direction and the importance λ at the receiver, for N directions, with its
//! derivatives by the direction and by both normals. Twin of crates/core/glsl/directional_gradient.glsl.

use super::pairs::{Facet, minus, times};
use super::real::Real;
use super::taps::{Layout, Taps, add};

/// A vector for each of N pairs, by coordinate.
pub type Coordinates<T, const N: usize> = [[T; N]; 3];

#[inline(always)]
pub fn at<T: Real, const N: usize>(of: &Coordinates<T, N>, k: usize) -> [T; 3] {
    [of[0][k], of[1][k], of[2][k]]
}

#[inline(always)]
pub fn set<T: Real, const N: usize>(of: &mut Coordinates<T, N>, k: usize, value: [T; 3]) {
    of[0][k] = value[0];
    of[1][k] = value[1];
    of[2][k] = value[2];
}

/// The dot product of two RGB values.
#[inline(always)]
pub fn product<T: Real>(a: [T; 4], b: [T; 4]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// What is exchanged between the two ends of a pair.
#[derive(Clone, Copy)]
pub struct Ends<'a, T> {
    /// Radiance in all directions; zero where the back sends.
    pub diffuse: [T; 4],
    /// Bins of the side that sends, with their sign; empty without.
    pub sent: (&'a [T], T),
    /// Cotangent of irradiance.
    pub irradiance: [T; 4],
    /// Cotangent of the receiver's bins; empty without.
    pub incident: &'a [T],
    /// Weights of radiance in all directions, and of that of bins.
    pub weights: [T; 2],
}

pub struct Exchanged<T, const N: usize> {
    /// Gradients of ⟨weighted L, λ⟩, with others held fixed.
    pub by_direction: Coordinates<T, N>,
    pub by_source_normal: Coordinates<T, N>,
    pub by_receiver_normal: Coordinates<T, N>,
    at_source: Taps<T, N>,
    at_receiver: Taps<T, N>,
    /// Directions in the frames of both.
    from: Coordinates<T, N>,
    onto: Coordinates<T, N>,
    /// Slopes of the product along rows and columns of the bins of both.
    by_from: [[T; N]; 2],
    by_onto: [[T; N]; 2],
    /// Gradients by `from`, then by `onto`.
    local: Coordinates<T, N>,
}

impl<T: Real, const N: usize> Exchanged<T, N> {
    pub const NONE: Self = Self {
        by_direction: [[T::ZERO; N]; 3],
        by_source_normal: [[T::ZERO; N]; 3],
        by_receiver_normal: [[T::ZERO; N]; 3],
        at_source: Taps::NONE,
        at_receiver: Taps::NONE,
        from: [[T::ZERO; N]; 3],
        onto: [[T::ZERO; N]; 3],
        by_from: [[T::ZERO; N]; 2],
        by_onto: [[T::ZERO; N]; 2],
        local: [[T::ZERO; N]; 3],
    };

    /// Sets the bilinear weights at both ends. `direction`: unit, from source to receiver; `front`: 1 or 0.
    /// Light that leaves the back was incident from the opposite direction. `bins`: whether sources and
    /// receivers have some.
    #[inline(always)]
    pub fn aim(
        &mut self,
        layout: &Layout<T>,
        bins: [bool; 2],
        (direction, front): (&Coordinates<T, N>, &[T; N]),
        source: impl Fn(usize) -> Facet<T>,
        receiver: impl Fn(usize) -> Facet<T>,
    ) {
        let Self { at_source, at_receiver, from, onto, .. } = self;
        if bins[0] {
            for k in 0..N {
                let (direction, sign) = (at(direction, k), T::of(2.0) * front[k] - T::ONE);
                set(from, k, source(k).in_frame(times(sign, direction)));
            }
            at_source.set(layout, |k| at(from, k));
        }
        if bins[1] {
            for k in 0..N {
                let direction = at(direction, k);
                set(onto, k, receiver(k).in_frame(times(-T::ONE, direction)));
            }
            at_receiver.set(layout, |k| at(onto, k));
        }
    }

    /// What pair `k` exchanges: the radiance L of its bins without its weight, and the importance λ.
    #[inline(always)]
    pub fn exchange(&mut self, k: usize, layout: &Layout<T>, ends: Ends<T>) -> [[T; 4]; 2] {
        let Ends { diffuse, sent: (sent, sign), irradiance, incident, weights } = ends;
        let nothing = [(T::ZERO, [T::ZERO; 4]); 4];
        let sent = if sent.is_empty() { nothing } else { self.at_source.terms(k, layout, sent) };
        let received =
            if incident.is_empty() { nothing } else { self.at_receiver.terms(k, layout, incident) };
        let (mut binned, mut importance) = ([T::ZERO; 4], irradiance);
        sent.iter().for_each(|(weight, value)| add(&mut binned, sign * *weight, *value));
        received.iter().for_each(|(weight, value)| add(&mut importance, *weight, *value));
        let mut radiance = [T::ZERO; 4];
        add(&mut radiance, weights[0], diffuse);
        add(&mut radiance, weights[1], binned);
        let by = |tap: usize| sign * weights[1] * product(sent[tap].1, importance);
        let by_from = self.at_source.slopes(k, [by(0), by(1), by(2), by(3)]);
        let by = |tap: usize| product(received[tap].1, radiance);
        let by_onto = self.at_receiver.slopes(k, [by(0), by(1), by(2), by(3)]);
        for a in 0..2 {
            self.by_from[a][k] = by_from[a];
            self.by_onto[a][k] = by_onto[a];
        }
        [binned, importance]
    }

    /// Sets the gradients, once all pairs through which light passes are exchanged; those of others are meaningless. Arguments are those
    /// of [`aim`](Self::aim).
    #[inline(always)]
    pub fn differentiate(
        &mut self,
        layout: &Layout<T>,
        bins: [bool; 2],
        (direction, front): (&Coordinates<T, N>, &[T; N]),
        source: impl Fn(usize) -> Facet<T>,
        receiver: impl Fn(usize) -> Facet<T>,
    ) {
        let Self {
            by_direction,
            by_source_normal,
            by_receiver_normal,
            from,
            onto,
            by_from,
            by_onto,
            local,
            ..
        } = self;
        if bins[0] {
            layout.gradients(from, by_from, local);
            for k in 0..N {
                let (own, direction, sign) = (source(k), at(direction, k), T::of(2.0) * front[k] - T::ONE);
                let by = own.out_of_frame(at(local, k));
                set(by_direction, k, times(sign, by));
                set(by_source_normal, k, own.frame_gradient(times(sign, direction), at(local, k)));
            }
        }
        if bins[1] {
            layout.gradients(onto, by_onto, local);
            for k in 0..N {
                let (own, direction) = (receiver(k), at(direction, k));
                let (by, so_far) = (own.out_of_frame(at(local, k)), at(by_direction, k));
                let so_far = if bins[0] { so_far } else { [T::ZERO; 3] };
                set(by_direction, k, minus(so_far, by));
                set(by_receiver_normal, k, own.frame_gradient(times(-T::ONE, direction), at(local, k)));
            }
        }
    }
}

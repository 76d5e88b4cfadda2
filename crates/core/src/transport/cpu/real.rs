//! The real types of operators, with the functions that they approximate: twin of crates/core/glsl/real.glsl and arctangent.glsl.

use super::state::Vector;
use crate::plan::Weights;
use crate::transport::{State, Values};
use bytemuck::Pod;
use nalgebra::RealField;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};
use std::sync::Arc;

/// A number. Everything is inlined where it is called, to be compiled for the vectors of the CPU.
pub trait Real:
    Pod
    + Send
    + Sync
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + PartialOrd
    + Into<f64>
    + RealField
{
    const ZERO: Self;
    const ONE: Self;
    /// Sines below this are rounding, where there is no azimuth.
    const POLE: Self;
    /// Sides that subtend less than this are ignored.
    const SHORTEST: Self;
    /// Squared distances from a plane below this part of a characteristic area count as in the plane.
    const COINCIDENT: Self;

    fn of(value: f64) -> Self;
    fn root(self) -> Self;
    fn magnitude(self) -> Self;
    fn whole(self) -> Self;
    /// A whole number as an index.
    fn index(self) -> i32;
    /// Arctangent of an argument in [0, 1], exact to rounding.
    fn arctangent(self) -> Self;
    /// Arctangent of an argument in [0, 1], as precise as the coordinates of a layout need.
    fn short_arctangent(self) -> Self;
    fn arccosine(self) -> Self;
    /// e^x.
    fn exponential(self) -> Self;

    /// A state as the vector that it is, where its numbers are of this type.
    fn vector(state: &State) -> Option<&Vector<Self>>;
    fn vector_mut(state: &mut State) -> Option<&mut Vector<Self>>;
    fn state(vector: Vector<Self>) -> State;
    /// Weights of a matrix, shared where they are of this type.
    fn weights(weights: &Weights) -> Arc<Vec<Self>>;

    #[inline(always)]
    fn least(self, other: Self) -> Self {
        if self < other { self } else { other }
    }

    #[inline(always)]
    fn most(self, other: Self) -> Self {
        if self > other { self } else { other }
    }

    #[inline(always)]
    fn clamped(self) -> Self {
        self.most(Self::ZERO).least(Self::ONE)
    }
}

impl Real for f32 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const POLE: Self = 1e-5;
    const SHORTEST: Self = 1e-7;
    const COINCIDENT: Self = 1e-12;

    fn exponential(self) -> Self {
        self.exp()
    }

    fn vector(state: &State) -> Option<&Vector<Self>> {
        match &state.0 {
            Values::Single(vector) => Some(vector),
            _ => None,
        }
    }

    fn vector_mut(state: &mut State) -> Option<&mut Vector<Self>> {
        match &mut state.0 {
            Values::Single(vector) => Some(vector),
            _ => None,
        }
    }

    fn state(vector: Vector<Self>) -> State {
        State(Values::Single(vector))
    }

    fn weights(weights: &Weights) -> Arc<Vec<Self>> {
        match weights {
            Weights::F32(weights) => weights.clone(),
            Weights::F64(weights) => Arc::new(weights.iter().map(|&weight| weight as Self).collect()),
        }
    }

    #[inline(always)]
    fn of(value: f64) -> Self {
        value as Self
    }

    #[inline(always)]
    fn root(self) -> Self {
        self.sqrt()
    }

    #[inline(always)]
    fn magnitude(self) -> Self {
        self.abs()
    }

    #[inline(always)]
    fn whole(self) -> Self {
        self.floor()
    }

    #[inline(always)]
    fn index(self) -> i32 {
        self as i32
    }

    // To 1.2e-8 before rounding.
    #[inline(always)]
    fn arctangent(self) -> Self {
        const SERIES: [f32; 9] = [
            0.002_834_064_3,
            -0.016_005_03,
            0.042_587_608,
            -0.074_954_46,
            0.106_367_54,
            -0.142_025_71,
            0.199_924_84,
            -0.333_330_67,
            0.999_999_984,
        ];
        self * polynomial(SERIES, self * self)
    }

    // Both to 2.5e-7 and 9e-8, less than the rounding of the coordinates of a layout: those of crates/core/glsl/bins.glsl.
    #[inline(always)]
    fn short_arctangent(self) -> Self {
        const SERIES: [f32; 7] = [
            0.006_811_791,
            -0.033_604_213,
            0.079_623_66,
            -0.132_333_42,
            0.198_078_15,
            -0.333_173_7,
            0.999_996_1,
        ];
        self * polynomial(SERIES, self * self)
    }

    #[inline(always)]
    fn arccosine(self) -> Self {
        const SERIES: [f32; 7] = [
            0.002_611_720_5,
            -0.012_003_395,
            0.027_762_914,
            -0.049_197_437,
            0.088_835_89,
            -0.214_591_09,
            std::f32::consts::FRAC_PI_2,
        ];
        (1.0 - self).sqrt() * polynomial(SERIES, self)
    }
}

/// The coefficient of the highest power first.
#[inline(always)]
fn polynomial<const N: usize>(coefficients: [f32; N], x: f32) -> f32 {
    coefficients.into_iter().fold(0.0, |sum, coefficient| sum * x + coefficient)
}

impl Real for f64 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const POLE: Self = 1e-12;
    const SHORTEST: Self = 1e-12;
    const COINCIDENT: Self = 1e-24;

    fn exponential(self) -> Self {
        self.exp()
    }

    fn vector(state: &State) -> Option<&Vector<Self>> {
        match &state.0 {
            Values::Double(vector) => Some(vector),
            _ => None,
        }
    }

    fn vector_mut(state: &mut State) -> Option<&mut Vector<Self>> {
        match &mut state.0 {
            Values::Double(vector) => Some(vector),
            _ => None,
        }
    }

    fn state(vector: Vector<Self>) -> State {
        State(Values::Double(vector))
    }

    fn weights(weights: &Weights) -> Arc<Vec<Self>> {
        match weights {
            Weights::F32(weights) => Arc::new(weights.iter().map(|&weight| weight.into()).collect()),
            Weights::F64(weights) => weights.clone(),
        }
    }

    #[inline(always)]
    fn of(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn root(self) -> Self {
        self.sqrt()
    }

    #[inline(always)]
    fn magnitude(self) -> Self {
        self.abs()
    }

    #[inline(always)]
    fn whole(self) -> Self {
        self.floor()
    }

    #[inline(always)]
    fn index(self) -> i32 {
        self as i32
    }

    // Two halvings of the angle leave t below .199, where the series ends at t^23 / 23.
    #[inline(always)]
    fn arctangent(self) -> Self {
        const TERMS: i32 = 12;
        let halved = |t: f64| t / (1.0 + (1.0 + t * t).sqrt());
        let t = halved(halved(self));
        let mut sum = 0.0;
        for k in (0..TERMS).rev() {
            sum = 1.0 / f64::from(2 * k + 1) - t * t * sum;
        }
        4.0 * t * sum
    }

    #[inline(always)]
    fn short_arctangent(self) -> Self {
        self.arctangent()
    }

    #[inline(always)]
    fn arccosine(self) -> Self {
        // Of arguments up to 1: those of cosines up to 1.
        2.0 * ((1.0 - self) / (1.0 + self)).sqrt().arctangent()
    }
}

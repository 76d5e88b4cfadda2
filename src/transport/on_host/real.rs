//! The real types of the device, with the functions that its kernels approximate: twin of glsl/real.glsl and arctangent.glsl.

use bytemuck::Pod;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

/// A number of the device. Everything is inlined where it is called, to be compiled for the vectors of the CPU.
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
{
    const ZERO: Self;
    const ONE: Self;
    /// Sines below this are rounding, where there is no azimuth.
    const POLE: Self;

    fn of(value: f64) -> Self;
    fn root(self) -> Self;
    fn magnitude(self) -> Self;
    fn whole(self) -> Self;
    /// Of a whole number.
    fn index(self) -> i32;
    /// Of arguments in [0, 1].
    fn short_arctangent(self) -> Self;
    fn arccosine(self) -> Self;

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

    // Both to 2.5e-7 and 9e-8, less than the rounding of the coordinates of a layout: those of glsl/bins.glsl.
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
            0.027_762_913,
            -0.049_197_437,
            0.088_835_89,
            -0.214_591_09,
            1.570_796_3,
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

    #[inline(always)]
    fn short_arctangent(self) -> Self {
        self.atan()
    }

    #[inline(always)]
    fn arccosine(self) -> Self {
        2.0 * ((1.0 - self) / (1.0 + self)).sqrt().atan()
    }
}

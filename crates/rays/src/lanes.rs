//! Eight numbers at once.

use super::numbering::WIDTH;
use std::ops::{Add, Mul, Sub};
use wide::{CmpLe, f32x8};

/// The instructions of a processor. A value says that this one has them.
pub trait Instructions: Copy {
    type Lanes: Lanes;
    fn splat(self, number: f32) -> Self::Lanes;
    fn load(self, numbers: &[f32; WIDTH]) -> Self::Lanes;
}

/// Eight numbers.
pub trait Lanes: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// self · factor + term, rounded once or twice.
    fn mul_add(self, factor: Self, term: Self) -> Self;
    fn mul_sub(self, factor: Self, term: Self) -> Self;
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    /// The signs of numbers, as zeros.
    fn signs(self) -> Self;
    /// With other signs where `signs` is negative.
    fn flip(self, signs: Self) -> Self;
    /// Bit k is set where the k-th of these is at most that of the others.
    fn at_most(self, other: Self) -> u32;
    fn to_array(self) -> [f32; WIDTH];
}

/// Instructions that all processors have.
#[derive(Clone, Copy)]
pub struct Portable;

#[derive(Clone, Copy)]
pub struct PortableLanes(f32x8);

impl Instructions for Portable {
    type Lanes = PortableLanes;
    #[inline(always)]
    fn splat(self, number: f32) -> PortableLanes {
        PortableLanes(f32x8::splat(number))
    }
    #[inline(always)]
    fn load(self, numbers: &[f32; WIDTH]) -> PortableLanes {
        PortableLanes(f32x8::new(*numbers))
    }
}

impl Add for PortableLanes {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0)
    }
}

impl Sub for PortableLanes {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0 - other.0)
    }
}

impl Mul for PortableLanes {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(self.0 * other.0)
    }
}

impl Lanes for PortableLanes {
    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        Self(self.0 * factor.0 + term.0)
    }
    #[inline(always)]
    fn mul_sub(self, factor: Self, term: Self) -> Self {
        Self(self.0 * factor.0 - term.0)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(self.0.fast_min(other.0))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(self.0.fast_max(other.0))
    }
    #[inline(always)]
    fn signs(self) -> Self {
        Self(self.0 & f32x8::splat(-0.0))
    }
    #[inline(always)]
    fn flip(self, signs: Self) -> Self {
        Self(self.0 ^ signs.0)
    }
    #[inline(always)]
    fn at_most(self, other: Self) -> u32 {
        self.0.cmp_le(other.0).move_mask() as u32
    }
    #[inline(always)]
    fn to_array(self) -> [f32; WIDTH] {
        self.0.to_array()
    }
}

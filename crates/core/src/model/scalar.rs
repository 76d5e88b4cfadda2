//! Numbers that formulas are generic over: f64, and dual numbers, which carry derivatives along (forward mode).

use std::ops::{Add, Div, Mul, Neg, Sub};

/// The four operations with something on the right.
pub trait Arithmetic<Right>:
    Sized
    + Add<Right, Output = Self>
    + Sub<Right, Output = Self>
    + Mul<Right, Output = Self>
    + Div<Right, Output = Self>
{
}

impl<Left, Right> Arithmetic<Right> for Left where
    Left: Add<Right, Output = Left>
        + Sub<Right, Output = Left>
        + Mul<Right, Output = Left>
        + Div<Right, Output = Left>
{
}

/// A number, compared by its value. Where a function has no slope, it counts as zero.
pub trait Scalar:
    Copy + From<f64> + PartialOrd<f64> + Neg<Output = Self> + Arithmetic<Self> + Arithmetic<f64>
{
    /// The number without its derivatives.
    fn value(self) -> f64;

    /// A function of this number, by its value and its slope here.
    fn chain(self, value: f64, slope: f64) -> Self;

    /// The square root.
    #[inline]
    fn sqrt(self) -> Self {
        let root = self.value().sqrt();
        self.chain(root, if root > 0.0 { 0.5 / root } else { 0.0 })
    }

    /// The angle of (x, self).
    #[inline]
    fn atan2(self, x: Self) -> Self {
        let (a, b) = (x.value(), self.value());
        let square = a * a + b * b;
        let [by_y, by_x] = if square > 0.0 { [a / square, -b / square] } else { [0.0; 2] };
        self.chain(b.atan2(a), by_y) + x.chain(0.0, by_x)
    }

    /// The angle whose tangent this is.
    #[inline]
    fn atan(self) -> Self {
        self.atan2(1.0.into())
    }

    /// The absolute value.
    #[inline]
    fn abs(self) -> Self {
        if self < 0.0 { -self } else { self }
    }

    /// The nearest number between two; constant at both and beyond.
    #[inline]
    fn clamp(self, low: f64, high: f64) -> Self {
        if self <= low {
            low.into()
        } else if self >= high {
            high.into()
        } else {
            self
        }
    }

    /// The larger one; constant where that is `low`.
    #[inline]
    fn max(self, low: f64) -> Self {
        if self <= low { low.into() } else { self }
    }
}

impl Scalar for f64 {
    #[inline]
    fn value(self) -> f64 {
        self
    }

    #[inline]
    fn chain(self, value: f64, _: f64) -> f64 {
        value
    }
}

/// A number and its derivatives by N others.
#[derive(Clone, Copy, Debug)]
pub struct Dual<const N: usize> {
    /// The number.
    pub value: f64,
    /// Derivatives of the number by each of the N others.
    pub slopes: [f64; N],
}

impl<const N: usize> Dual<N> {
    /// A number that is itself the variable `index`: its derivative by that is 1, by all others 0.
    #[inline]
    pub fn variable(value: f64, index: usize) -> Self {
        Self { value, slopes: std::array::from_fn(|k| f64::from(u8::from(k == index))) }
    }

    /// A function of two numbers, by its value and its slopes here.
    #[inline]
    fn both(self, other: Self, value: f64, [a, b]: [f64; 2]) -> Self {
        Self { value, slopes: std::array::from_fn(|k| a * self.slopes[k] + b * other.slopes[k]) }
    }
}

impl<const N: usize> Scalar for Dual<N> {
    #[inline]
    fn value(self) -> f64 {
        self.value
    }

    #[inline]
    fn chain(self, value: f64, slope: f64) -> Self {
        Self { value, slopes: self.slopes.map(|own| slope * own) }
    }
}

impl<const N: usize> From<f64> for Dual<N> {
    #[inline]
    fn from(value: f64) -> Self {
        Self { value, slopes: [0.0; N] }
    }
}

impl<const N: usize> PartialEq<f64> for Dual<N> {
    #[inline]
    fn eq(&self, other: &f64) -> bool {
        self.value == *other
    }
}

impl<const N: usize> PartialOrd<f64> for Dual<N> {
    #[inline]
    fn partial_cmp(&self, other: &f64) -> Option<std::cmp::Ordering> {
        self.value.partial_cmp(other)
    }
}

impl<const N: usize> Neg for Dual<N> {
    type Output = Self;

    #[inline]
    fn neg(self) -> Self {
        self.chain(-self.value, -1.0)
    }
}

macro_rules! operations {
    ($($Trait:ident, $name:ident, |$a:ident, $b:ident| $value:expr, $by_a:expr, $by_b:expr;)*) => {$(
        impl<const N: usize> $Trait for Dual<N> {
            type Output = Self;

            #[inline]
            fn $name(self, other: Self) -> Self {
                let ($a, $b) = (self.value, other.value);
                self.both(other, $value, [$by_a, $by_b])
            }
        }

        impl<const N: usize> $Trait<f64> for Dual<N> {
            type Output = Self;

            #[inline]
            fn $name(self, $b: f64) -> Self {
                let $a = self.value;
                self.chain($value, $by_a)
            }
        }
    )*};
}

operations! {
    Add, add, |a, b| a + b, 1.0, 1.0;
    Sub, sub, |a, b| a - b, 1.0, -1.0;
    Mul, mul, |a, b| a * b, b, a;
    Div, div, |a, b| a / b, 1.0 / b, -(a / b) / b;
}

//! Vectors that formulas are generic over: of f64, and of dual numbers.

use super::scalar::{Dual, Scalar};
use glam::DVec3;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A vector of three numbers.
pub trait Vector:
    Copy
    + From<DVec3>
    + Neg<Output = Self>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Self::Scalar, Output = Self>
    + Mul<f64, Output = Self>
    + Div<f64, Output = Self>
{
    /// Type of the coordinates.
    type Scalar: Scalar;

    /// The vector with the given coordinates.
    fn from_array(coordinates: [Self::Scalar; 3]) -> Self;

    /// The three coordinates.
    fn to_array(self) -> [Self::Scalar; 3];

    /// The vector without derivatives.
    #[inline]
    fn value(self) -> DVec3 {
        DVec3::from_array(self.to_array().map(Scalar::value))
    }

    /// The scalar product.
    #[inline]
    fn dot(self, other: Self) -> Self::Scalar {
        let ([x, y, z], [u, v, w]) = (self.to_array(), other.to_array());
        x * u + y * v + z * w
    }

    /// The vector product.
    #[inline]
    fn cross(self, other: Self) -> Self {
        let ([x, y, z], [u, v, w]) = (self.to_array(), other.to_array());
        Self::from_array([y * w - v * z, z * u - w * x, x * v - u * y])
    }

    /// The square of the length.
    #[inline]
    fn length_squared(self) -> Self::Scalar {
        self.dot(self)
    }

    /// The length.
    #[inline]
    fn length(self) -> Self::Scalar {
        self.length_squared().sqrt()
    }

    /// The unit vector along this one; NaN for zero.
    #[inline]
    fn normalize(self) -> Self {
        self * (Self::Scalar::from(1.0) / self.length())
    }
}

impl Vector for DVec3 {
    type Scalar = f64;

    #[inline]
    fn from_array(coordinates: [f64; 3]) -> Self {
        coordinates.into()
    }

    #[inline]
    fn to_array(self) -> [f64; 3] {
        self.into()
    }
}

/// A vector with its derivatives by N numbers.
#[derive(Clone, Copy, Debug)]
pub struct DualVector<const N: usize>([Dual<N>; 3]);

impl<const N: usize> DualVector<N> {
    /// The vector by whose coordinates others are derived as those from an index on.
    #[inline]
    pub fn variable(value: DVec3, first: usize) -> Self {
        Self(std::array::from_fn(|axis| Dual::variable(value[axis], first + axis)))
    }
}

impl<const N: usize> Vector for DualVector<N> {
    type Scalar = Dual<N>;

    #[inline]
    fn from_array(coordinates: [Dual<N>; 3]) -> Self {
        Self(coordinates)
    }

    #[inline]
    fn to_array(self) -> [Dual<N>; 3] {
        self.0
    }
}

impl<const N: usize> From<DVec3> for DualVector<N> {
    #[inline]
    fn from(value: DVec3) -> Self {
        Self(value.to_array().map(Dual::from))
    }
}

impl<const N: usize> Neg for DualVector<N> {
    type Output = Self;

    #[inline]
    fn neg(self) -> Self {
        Self(self.0.map(Neg::neg))
    }
}

macro_rules! operations {
    ($($Trait:ident<$Right:ty>, $name:ident, |$a:ident, $b:ident, $axis:ident| $coordinate:expr;)*) => {$(
        impl<const N: usize> $Trait<$Right> for DualVector<N> {
            type Output = Self;

            #[inline]
            fn $name(self, $b: $Right) -> Self {
                let $a = self;
                Self(std::array::from_fn(|$axis| $coordinate))
            }
        }
    )*};
}

operations! {
    Add<Self>, add, |a, b, axis| a.0[axis] + b.0[axis];
    Sub<Self>, sub, |a, b, axis| a.0[axis] - b.0[axis];
    Mul<Dual<N>>, mul, |a, b, axis| a.0[axis] * b;
    Mul<f64>, mul, |a, b, axis| a.0[axis] * b;
    Div<f64>, div, |a, b, axis| a.0[axis] / b;
}

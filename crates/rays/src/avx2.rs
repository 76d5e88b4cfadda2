//! Eight numbers at once by AVX2 and FMA, where a processor has them.

use super::lanes::{Instructions, Lanes};
use super::numbering::WIDTH;
use super::ray::{Hit, Way};
use super::traverse::{Among, traverse};
use std::arch::x86_64::*;
use std::ops::{Add, Mul, Sub};

/// Says that this processor has AVX2 and FMA. Only [`Avx2::found`] makes it.
#[derive(Clone, Copy)]
pub struct Avx2(());

/// Eight numbers. Only an [`Avx2`] makes them.
#[derive(Clone, Copy)]
pub struct Avx2Lanes(__m256);

impl Avx2 {
    pub fn found() -> Option<Self> {
        (is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")).then_some(Self(()))
    }

    /// [`traverse`], compiled for these instructions.
    #[inline(always)]
    pub fn traverse<const ORDERED: bool>(
        self,
        among: Among,
        way: Way,
        limit: f64,
        skip: impl Fn(u32) -> bool,
        call: impl FnMut(u32, Hit) -> Option<f64>,
    ) {
        #[target_feature(enable = "avx2,fma")]
        fn compiled<const ORDERED: bool>(
            instructions: Avx2,
            among: Among,
            way: Way,
            limit: f64,
            skip: impl Fn(u32) -> bool,
            call: impl FnMut(u32, Hit) -> Option<f64>,
        ) {
            traverse::<Avx2, ORDERED>(instructions, among, way, limit, skip, call);
        }
        // SAFETY: `self` exists, and so the processor has the instructions.
        unsafe { compiled::<ORDERED>(self, among, way, limit, skip, call) }
    }
}

impl Instructions for Avx2 {
    type Lanes = Avx2Lanes;
    #[inline(always)]
    fn splat(self, number: f32) -> Avx2Lanes {
        // SAFETY: `self` exists, and so the processor has AVX.
        Avx2Lanes(unsafe { _mm256_set1_ps(number) })
    }
    #[inline(always)]
    fn load(self, numbers: &[f32; WIDTH]) -> Avx2Lanes {
        // SAFETY: as above; the array has eight numbers, and any alignment will do.
        Avx2Lanes(unsafe { _mm256_loadu_ps(numbers.as_ptr()) })
    }
}

/// A function of lanes by an intrinsic of lanes and nothing else.
macro_rules! by {
    ($name:ident($($argument:ident),*) = $intrinsic:ident) => {
        #[inline(always)]
        fn $name(self $(, $argument: Self)*) -> Self {
            // SAFETY: `self` was made by an `Avx2`, and so the processor has AVX2 and FMA; the intrinsic reads no memory.
            Self(unsafe { $intrinsic(self.0 $(, $argument.0)*) })
        }
    };
}

impl Add for Avx2Lanes {
    type Output = Self;
    by!(add(other) = _mm256_add_ps);
}

impl Sub for Avx2Lanes {
    type Output = Self;
    by!(sub(other) = _mm256_sub_ps);
}

impl Mul for Avx2Lanes {
    type Output = Self;
    by!(mul(other) = _mm256_mul_ps);
}

impl Lanes for Avx2Lanes {
    by!(mul_add(factor, term) = _mm256_fmadd_ps);
    by!(mul_sub(factor, term) = _mm256_fmsub_ps);
    by!(min(other) = _mm256_min_ps);
    by!(max(other) = _mm256_max_ps);
    by!(flip(signs) = _mm256_xor_ps);
    #[inline(always)]
    fn signs(self) -> Self {
        // SAFETY: `self` was made by an `Avx2`, and so the processor has AVX.
        Self(unsafe { _mm256_and_ps(self.0, _mm256_set1_ps(-0.0)) })
    }
    #[inline(always)]
    fn at_most(self, other: Self) -> u32 {
        // SAFETY: as above.
        unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0)) as u32 }
    }
    #[inline(always)]
    fn to_array(self) -> [f32; WIDTH] {
        let mut numbers = [0.0; WIDTH];
        // SAFETY: as above; the array has room for eight numbers, and any alignment will do.
        unsafe { _mm256_storeu_ps(numbers.as_mut_ptr(), self.0) };
        numbers
    }
}

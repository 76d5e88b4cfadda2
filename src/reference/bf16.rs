//! Rounding of source bins to bfloat16, as with [`Precision::HalfBins`](crate::scene::Precision::HalfBins).

use glam::DVec3;

/// Significant bits of a bfloat16.
const BITS: i32 = 8;

/// Rounds to the nearest bfloat16, ties to even: relative error up to 2⁻⁸. The range is that of f32; subnormal numbers lose
/// precision.
pub fn to_bf16(value: DVec3) -> DVec3 {
    DVec3::from(value.to_array().map(|x| {
        let unit = 2f64.powi(exponent(x) + 1 - BITS);
        (x / unit).round_ties_even() * unit
    }))
}

/// The largest e with 2^e <= |x|; for zero, that of the smallest normal f32.
fn exponent(x: f64) -> i32 {
    let e = x.abs().max(f64::from(f32::MIN_POSITIVE)).log2().floor() as i32;
    // log2 may round up to the next integer.
    if 2f64.powi(e) > x.abs() && x != 0.0 { e - 1 } else { e }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_the_upper_half_of_an_f32() {
        for k in 0..10_000 {
            let x = (f64::from(k) * 0.618).fract().mul_add(2.0, -1.0) * 10f64.powi(k % 60 - 30);
            let x = f64::from(x as f32);
            let bits = (x as f32).to_bits();
            let half = f32::from_bits((bits + 0x7fff + (bits >> 16 & 1)) & 0xffff_0000);
            let given = to_bf16(DVec3::splat(x)).x;
            assert_eq!(given, f64::from(half), "{x:e}");
            assert!((given - x).abs() <= x.abs() / 256.0);
        }
        assert_eq!(to_bf16(DVec3::new(0.0, 1.0, -1.0)), DVec3::new(0.0, 1.0, -1.0));
    }
}

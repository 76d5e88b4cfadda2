//! Loops compiled for the vectors of this CPU.

/// Calls `work` as compiled for the vectors of this CPU, where it is inlined: mark it, and all that it calls, as such. The same
/// results as without: sums and products are not fused.
#[inline(always)]
pub fn vectorised<R>(work: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn wide<R>(work: impl FnOnce() -> R) -> R {
            work()
        }
        if std::is_x86_feature_detected!("avx2") {
            // SAFETY: the CPU has these instructions.
            return unsafe { wide(work) };
        }
    }
    work()
}

/// The vector instructions that [`vectorised`] uses.
pub fn vector_instructions() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    if std::is_x86_feature_detected!("avx2") {
        return "AVX2";
    }
    if cfg!(target_arch = "x86_64") {
        "SSE2"
    } else if cfg!(target_arch = "aarch64") {
        "NEON"
    } else {
        "as the target has them"
    }
}

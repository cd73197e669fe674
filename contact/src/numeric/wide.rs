//! Compiles loops a second time for processors with wider registers (AVX on x86-64) and calls that
//! version where the processor has them. Both versions give the same bits: the registers only hold
//! more numbers side by side, no sum changes its order, and no operations are fused.

/// Declares functions that call another one, compiled for the registers that the processor has.
/// The called function and everything in which it spends its time have to be `#[inline(always)]`.
macro_rules! wide {
    ($(
        $(#[$about:meta])*
        $seen:vis fn $name:ident($($given:ident: $kind:ty),* $(,)?) $(-> $back:ty)? = $of:path;
    )*) => {$(
        $(#[$about])*
        $seen fn $name($($given: $kind),*) $(-> $back)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx")]
                fn avx($($given: $kind),*) $(-> $back)? {
                    $of($($given),*)
                }
                if std::arch::is_x86_feature_detected!("avx") {
                    #[expect(unsafe_code, reason = "the processor is asked first")]
                    // SAFETY: the function needs AVX and nothing else, and the processor has it.
                    return unsafe { avx($($given),*) };
                }
            }
            $of($($given),*)
        }
    )*};
}
pub(crate) use wide;

/// Detects the processor's registers once, which takes some microseconds, so that no control period
/// pays for it.
pub(crate) fn detect_wide_registers() {
    #[cfg(target_arch = "x86_64")]
    let _ = std::arch::is_x86_feature_detected!("avx");
}

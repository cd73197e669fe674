//! Loops compiled a second time for processors with wider registers (AVX on x86-64), and called so
//! where there are any. Both forms give the same bits: registers only take more numbers side by
//! side, no sum changes its order, and nothing is fused. It refuses nothing.

/// Declares functions that call another one, which has to be `#[inline(always)]` as all that it
/// spends its time in, compiled for the registers that the processor has.
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

/// Has the processor asked, which takes it some microseconds once, so that no lane does.
pub(crate) fn ask() {
    #[cfg(target_arch = "x86_64")]
    let _ = std::arch::is_x86_feature_detected!("avx");
}

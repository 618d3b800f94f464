//! Instructions that newer processors have, chosen while the program runs.

/// Calls `work`, compiled once for the target of the build and once more for AVX2, POPCNT and their kin,
/// which is run where the processor has them. Worth it around a loop over bytes or bits of some hundred
/// nanoseconds.
///
/// Only what is inlined into `work` is compiled twice: mark it `#[inline(always)]`.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub fn vectorized<R>(work: impl FnOnce() -> R) -> R {
    match pulp::x86::V3::try_new() {
        Some(instructions) => instructions.vectorize(work),
        None => work(),
    }
}

/// Calls `work`: the target of the build has all instructions there are.
#[cfg(not(target_arch = "x86_64"))]
#[inline(always)]
pub fn vectorized<R>(work: impl FnOnce() -> R) -> R {
    work()
}

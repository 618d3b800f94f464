//! Vectors of bytes for the corner detector: 32 at a time with AVX2, 16 at a time in code every compiler
//! vectorizes.

/// A vector of unsigned bytes. All functions are inlined into a caller that has the processor features they
/// need.
pub(super) trait Lanes: Copy {
    /// Bytes in the vector, at most 32.
    const N: usize;
    /// The first `N` bytes of `bytes`; panics if there are fewer.
    fn load(bytes: &[u8]) -> Self;
    /// The `N` bytes of `bytes` from `at` on.
    ///
    /// # Safety
    /// There must be as many.
    unsafe fn load_unchecked(bytes: &[u8], at: usize) -> Self;
    /// Into the first `N` bytes of `bytes`; panics if there are fewer.
    fn store(self, bytes: &mut [u8]);
    fn splat(value: u8) -> Self;
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    fn saturating_sub(self, other: Self) -> Self;
    /// Bit `i` tells whether byte `i` is not 0.
    fn non_zero_mask(self) -> u32;
    fn any_non_zero(self) -> bool;
}

/// Bytes of a [`Portable`] vector.
const N_PORTABLE: usize = 16;

/// Plain arrays.
#[derive(Clone, Copy)]
pub(super) struct Portable([u8; N_PORTABLE]);

impl Portable {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(u8, u8) -> u8) -> Self {
        Self(std::array::from_fn(|i| f(self.0[i], other.0[i])))
    }
}

impl Lanes for Portable {
    const N: usize = N_PORTABLE;

    #[inline(always)]
    fn load(bytes: &[u8]) -> Self {
        let mut lanes = [0; N_PORTABLE];
        lanes.copy_from_slice(&bytes[..N_PORTABLE]);
        Self(lanes)
    }

    #[inline(always)]
    unsafe fn load_unchecked(bytes: &[u8], at: usize) -> Self {
        Self::load(&bytes[at..])
    }

    #[inline(always)]
    fn store(self, bytes: &mut [u8]) {
        bytes[..N_PORTABLE].copy_from_slice(&self.0);
    }

    #[inline(always)]
    fn splat(value: u8) -> Self {
        Self([value; N_PORTABLE])
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, u8::min)
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, u8::max)
    }

    #[inline(always)]
    fn saturating_sub(self, other: Self) -> Self {
        self.zip(other, u8::saturating_sub)
    }

    #[inline(always)]
    fn non_zero_mask(self) -> u32 {
        self.0.iter().enumerate().map(|(i, &v)| u32::from(v != 0) << i).sum()
    }

    #[inline(always)]
    fn any_non_zero(self) -> bool {
        u128::from_ne_bytes(self.0) != 0
    }
}

/// AVX2 registers. A value may exist only on a processor that has AVX2: [`Avx2::load`] and [`Avx2::splat`],
/// the only ways to make one from nothing, are called from functions that are entered after a check for it.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
pub(super) struct Avx2(std::arch::x86_64::__m256i);

#[cfg(target_arch = "x86_64")]
impl Lanes for Avx2 {
    const N: usize = 32;

    #[inline(always)]
    fn load(bytes: &[u8]) -> Self {
        let bytes = &bytes[..32];
        // SAFETY: 32 readable bytes; AVX2 is there (see the type).
        Self(unsafe { std::arch::x86_64::_mm256_loadu_si256(bytes.as_ptr().cast()) })
    }

    #[inline(always)]
    unsafe fn load_unchecked(bytes: &[u8], at: usize) -> Self {
        debug_assert!(at + 32 <= bytes.len());
        // SAFETY: the caller says that the bytes are there; AVX2 is (see the type).
        Self(unsafe { std::arch::x86_64::_mm256_loadu_si256(bytes.as_ptr().add(at).cast()) })
    }

    #[inline(always)]
    fn store(self, bytes: &mut [u8]) {
        let bytes = &mut bytes[..32];
        // SAFETY: 32 writable bytes; AVX2 is there (see the type).
        unsafe { std::arch::x86_64::_mm256_storeu_si256(bytes.as_mut_ptr().cast(), self.0) }
    }

    #[inline(always)]
    fn splat(value: u8) -> Self {
        // SAFETY: AVX2 is there (see the type).
        Self(unsafe { std::arch::x86_64::_mm256_set1_epi8(value.cast_signed()) })
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: AVX2 is there (see the type).
        Self(unsafe { std::arch::x86_64::_mm256_min_epu8(self.0, other.0) })
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: AVX2 is there (see the type).
        Self(unsafe { std::arch::x86_64::_mm256_max_epu8(self.0, other.0) })
    }

    #[inline(always)]
    fn saturating_sub(self, other: Self) -> Self {
        // SAFETY: AVX2 is there (see the type).
        Self(unsafe { std::arch::x86_64::_mm256_subs_epu8(self.0, other.0) })
    }

    #[inline(always)]
    fn non_zero_mask(self) -> u32 {
        use std::arch::x86_64::{_mm256_cmpeq_epi8, _mm256_movemask_epi8, _mm256_setzero_si256};
        // SAFETY: AVX2 is there (see the type).
        !unsafe { _mm256_movemask_epi8(_mm256_cmpeq_epi8(self.0, _mm256_setzero_si256())) }.cast_unsigned()
    }

    #[inline(always)]
    fn any_non_zero(self) -> bool {
        // SAFETY: AVX2 is there (see the type).
        unsafe { std::arch::x86_64::_mm256_testz_si256(self.0, self.0) == 0 }
    }
}

//! The one operation that all kernels of the solver are made of.

/// `a b + c`, fused where the processor can: elsewhere `mul_add` would be a slow library call.
#[inline(always)]
pub(crate) fn multiply_add(a: f64, b: f64, c: f64) -> f64 {
    if cfg!(target_feature = "fma") { a.mul_add(b, c) } else { a * b + c }
}

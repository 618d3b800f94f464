//! Loops that are compiled twice, for the instructions of every processor and for those of newer ones, and
//! the one operation that they are made of.

/// How `a b + c` is computed in a loop. Nobody outside the crate can name it.
pub trait Arithmetic {
    /// `a b + c`
    fn multiply_add(a: f64, b: f64, c: f64) -> f64;
}

/// Rounded once. Only where the processor has an instruction for it: elsewhere `mul_add` is a slow library
/// call.
#[cfg(target_arch = "x86_64")]
pub(crate) struct Fused;

#[cfg(target_arch = "x86_64")]
impl Arithmetic for Fused {
    #[inline(always)]
    fn multiply_add(a: f64, b: f64, c: f64) -> f64 {
        a.mul_add(b, c)
    }
}

/// As the target of the compilation has it.
pub(crate) struct Portable;

impl Arithmetic for Portable {
    #[inline(always)]
    fn multiply_add(a: f64, b: f64, c: f64) -> f64 {
        if cfg!(any(target_feature = "fma", target_arch = "aarch64")) { a.mul_add(b, c) } else { a * b + c }
    }
}

/// Makes a closure that takes it one that can be called only once. One that could be called again is called
/// by a function that nothing tells the compiler to inline: where the body is large, it was compiled without
/// the instructions it was meant for, and every fused multiplication became a call of a library.
#[cfg(target_arch = "x86_64")]
pub(crate) struct Once;

/// `vectorized!(A => expression)`: the expression, with `A` the [`Arithmetic`] of this processor. What it
/// inlines is compiled with AVX2 and FMA as well, and that is run where the processor has them.
#[cfg(target_arch = "x86_64")]
macro_rules! vectorized {
    ($A:ident => $body:expr) => {
        match pulp::x86::V3::try_new() {
            Some(instructions) => {
                type $A = $crate::arithmetic::Fused;
                let once = $crate::arithmetic::Once;
                instructions.vectorize(
                    #[inline(always)]
                    || {
                        let _called = once;
                        $body
                    },
                )
            }
            None => {
                type $A = $crate::arithmetic::Portable;
                $body
            }
        }
    };
}

#[cfg(not(target_arch = "x86_64"))]
macro_rules! vectorized {
    ($A:ident => $body:expr) => {{
        type $A = $crate::arithmetic::Portable;
        $body
    }};
}

pub(crate) use vectorized;

#[cfg(test)]
mod tests {
    use super::*;

    #[inline(always)]
    fn dot<A: Arithmetic>(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).fold(0.0, |sum, (a, b)| A::multiply_add(*a, *b, sum))
    }

    #[test]
    fn every_processor_computes_the_same_up_to_rounding() {
        let a: Vec<f64> = (1..200).map(|i| 1.0 / f64::from(i)).collect();
        let b: Vec<f64> = (1..200).map(|i| f64::from(i).sqrt()).collect();
        let here = vectorized!(A => dot::<A>(&a, &b));
        let anywhere = dot::<Portable>(&a, &b);
        assert!((here - anywhere).abs() <= 1e-13 * anywhere, "{here} {anywhere}");
        assert!(anywhere > 20.0);
    }
}

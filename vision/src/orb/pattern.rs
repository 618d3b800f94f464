//! Which pairs of pixels the descriptor compares.

use super::{Descriptor, PATCH_RADIUS_PX};

/// A comparison of two pixels, (dx, dy) from the keypoint, in the keypoint's own orientation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Test {
    pub from: (i8, i8),
    pub to: (i8, i8),
}

const N_TESTS: usize = Descriptor::N_BITS as usize;

/// Standard deviation of the points' coordinates, pixels: a fifth of the patch's side, as in the BRIEF paper.
const SIGMA_PX: f64 = 31.0 / 5.0;

/// The pattern: both points of each test drawn from a Gaussian around the keypoint (GII of the BRIEF paper), from a fixed seed.
pub(super) fn tests() -> [Test; N_TESTS] {
    let mut state = 0x5EED_0F0B_5EED_0F0Bu64;
    let mut uniform = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 32) as f64 / (1u64 << 32) as f64
    };
    let mut gaussian = || ((0..12).map(|_| uniform()).sum::<f64>() - 6.0) * SIGMA_PX;
    let mut point = || {
        loop {
            let (x, y) = (gaussian().round(), gaussian().round());
            if x * x + y * y <= f64::from(PATCH_RADIUS_PX * PATCH_RADIUS_PX) {
                return (x as i8, y as i8);
            }
        }
    };
    std::array::from_fn(|_| {
        loop {
            let test = Test { from: point(), to: point() };
            if test.from != test.to {
                return test;
            }
        }
    })
}

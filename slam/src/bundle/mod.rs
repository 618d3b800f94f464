//! Bundle adjustment: poses and landmarks that agree best with everything that was seen.

pub(crate) mod adjustment;
pub(crate) mod anchored_line;
pub(crate) mod calibration;
pub mod factors;
#[cfg(test)]
mod gauge_tests;
pub(crate) mod global;
pub(crate) mod held_out;
pub(crate) mod local;
mod primitive_terms;
pub(crate) mod readout;
pub(crate) mod scatter;
pub(crate) mod stage_two;
pub(crate) mod two_view;

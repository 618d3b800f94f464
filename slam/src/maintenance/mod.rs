//! What is done to a stored map as a whole, while no frames come in: adjusting it, and joining it with
//! another.

mod join;
mod optimize;

pub use join::{Joined, Merged, PlacedFrame, Recordings, merge};
pub use optimize::{Optimized, optimize};

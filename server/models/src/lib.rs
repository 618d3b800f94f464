//! The server's own `session/updates.rs` and `session/slots.rs`, compiled with primitives that try many
//! orders of steps.

#[path = "../../src/session/slots.rs"]
pub mod slots;
pub mod sync;
#[path = "../../src/session/updates.rs"]
pub mod updates;

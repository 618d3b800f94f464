//! Who may do what: tokens, the sessions they lead to, and the one door that both ports have.
//!
//! [`check`] stands before every route and every call. It finds out who asks ([`Caller`]), whether that
//! allows what is asked ([`rules`]), and how often it was asked lately. What a caller may *see* is decided by
//! names: a [`SessionId`] is made by [`Caller::session`] alone, which leads to no session but those of the
//! caller's owner, so that another's session is not found in the same way as one that does not exist.
//!
//! [`SessionId`]: crate::session::SessionId

mod audit;
mod caller;
mod door;
mod keys;
mod origin;
mod passed;
mod rates;
pub mod rules;
mod tickets;

pub use audit::{Change, record};
pub use caller::{Caller, Role};
pub use door::{Access, Door, check};
pub use keys::{Keys, new_token, token_hash};
pub use passed::{Asked, Marks, Passed};
pub use tickets::{Ticket, cookie_name};

//! The store from outside: what is saved comes back, and nothing else changes.

mod backup;
mod check;
mod durability;
mod graph;
mod lines;
mod primitives;
mod queries;
mod save_load;
mod schema;
mod sessions;
mod tokens;
mod trajectory;
mod viewing;

/// Maps made by hand, and databases of them.
mod world {
    pub use testkit::stored::*;
    pub use testkit::world::*;
}

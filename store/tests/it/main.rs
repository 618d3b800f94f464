//! The store from outside: what is saved comes back, and nothing else changes.

mod check;
mod durability;
mod graph;
mod lines;
mod primitives;
mod queries;
mod save_load;
mod schema;
mod sessions;
mod trajectory;
mod world;

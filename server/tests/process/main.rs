//! The server as a program of its own: killed, copied beside its streams, and put back.

mod backup;
mod cameras;
mod crash;
mod database;
mod faults;
mod fleet;
mod fleet_cut;
mod fleet_kills;
mod fleet_relay;
mod fleet_restart;
mod idle;
mod load;
mod manager;
mod memory;
mod objects;
mod program;
mod reload;
mod traces;

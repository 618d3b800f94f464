//! The server as a program of its own: killed, copied beside its streams, and put back.

mod backup;
mod crash;
mod faults;
mod idle;
mod load;
mod manager;
mod memory;
mod program;
mod reload;
mod traces;

//! The server over real sockets: gRPC in, HTTP out.

mod access;
mod api;
mod bad_frames;
mod bad_requests;
mod connections;
mod encryption;
mod isolation;
mod kidnap;
mod maps;
mod masks;
mod shutdown;
mod storage;
mod tracking;
mod viewer;
mod web_socket;
mod writers;

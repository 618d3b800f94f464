//! The server over real sockets: gRPC in, HTTP out.

mod bad_frames;
mod bad_requests;
mod kidnap;
mod maps;
mod shutdown;
mod storage;
mod tracking;
mod viewer;
mod web_socket;
mod writers;

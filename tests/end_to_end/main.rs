//! The server over real sockets: gRPC in, HTTP out.

mod access;
mod api;
mod bad_frames;
mod bad_requests;
mod cameras;
mod connections;
mod damage;
mod encryption;
mod grpc_web;
mod isolation;
mod kidnap;
mod maps;
mod masks;
mod million;
mod motion;
mod operations;
mod places;
mod segments;
mod shared_recording;
mod shutdown;
mod storage;
mod tracking;
mod viewer;
mod web_socket;
mod writers;

//! Questions about maps made by hand, asked of both interfaces.

mod api;
mod cameras;
mod graphs;
mod grpc;
mod rest;
mod rounded;
mod routes;
mod scene;
mod search;

//! The service's messages, its server trait and its client, generated from `monoslam/v1/slam.proto`.
//!
//! No logic lives here: `server` and `client` convert to and from the domain types by hand.
//!
//! ```
//! use proto::v1::{OpenStream, StreamFramesRequest, StreamPolicy, stream_frames_request::Message};
//!
//! let open = OpenStream {
//!     session_id: "kitchen".into(),
//!     policy: StreamPolicy::Lossless.into(),
//!     ..Default::default()
//! };
//! let request = StreamFramesRequest { message: Some(Message::Open(open)) };
//! assert!(request.message.is_some());
//! ```

/// Version 1 of the interface, package `monoslam.v1`.
pub mod v1 {
    #![allow(missing_docs, clippy::all, rustdoc::all)]
    tonic::include_proto!("monoslam.v1");
}

/// The compiled .proto files with everything they import, a serialised `google.protobuf.FileDescriptorSet`:
/// what the reflection service answers from.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/monoslam_descriptor.bin"));

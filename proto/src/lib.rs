//! The service's messages, its server trait and its client, generated from `monoslam/v1/slam.proto`.
//!
//! No logic lives here: `server` and `client` convert to and from the domain types by hand.
//! After a change of the .proto file, `UPDATE_GENERATED=1 cargo test -p proto --test generated` generates
//! anew; where what is generated does not compile, as after a conflict, empty both files first.
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
    include!("generated/monoslam.v1.rs");
}

/// The compiled .proto files with everything they import, a serialized `google.protobuf.FileDescriptorSet`:
/// what the reflection service answers from.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!("generated/descriptor.bin");

//! What a client may send over gRPC: any bytes are taken or refused with a reason, never with a panic.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Some((kind, message)) = bytes.split_first() {
        server::grpc::fuzzing::take(*kind, message);
    }
});

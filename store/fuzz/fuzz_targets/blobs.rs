//! What a database holds packed: any bytes are read or refused, never with a panic or an allocation without
//! bound.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Some((kind, blob)) = bytes.split_first() {
        store::fuzzing::read(*kind, blob);
    }
});

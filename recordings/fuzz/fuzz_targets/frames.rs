//! MCAP files, bags and JPEG files on a pipe: any bytes are taken or refused with a reason, never with a
//! panic, and never with more memory than is allowed.

#![no_main]

use libfuzzer_sys::fuzz_target;
use recordings::{Bag, FrameReader, FrameTimes, MjpegReader};
use std::path::PathBuf;
use std::sync::OnceLock;
use tempfile::TempDir;

/// Topics that the seeds have.
const TOPICS: [&str; 4] = ["/left/image_raw", "/jpeg", "/bayer", "/mono16_big"];

fn file() -> PathBuf {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    FOLDER.get_or_init(|| tempfile::tempdir().expect("a temporary folder")).path().join("input")
}

fuzz_target!(|bytes: &[u8]| {
    if bytes.starts_with(&[0xff, 0xd8]) {
        return read(MjpegReader::new(bytes, FrameTimes::PerSecond(30.0)));
    }
    let path = file();
    std::fs::write(&path, bytes).expect("a file");
    for topic in std::iter::once(None).chain(TOPICS.map(Some)) {
        match Bag::open(&path, topic) {
            Ok(bag) => read(bag.frames().expect("it was opened before")),
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
});

fn read(mut reader: impl FrameReader) {
    let mut n_frames = 0;
    while let Ok(Some(frame)) = reader.next_frame() {
        let _ = frame.image.size();
        n_frames += 1;
        assert!(n_frames < 1 << 20, "frames without end");
    }
    let _ = reader.remark();
}

//! Decoding of an image that a client sent: any bytes give a gray image within the limits or a reason, never
//! a panic.

#![no_main]

use libfuzzer_sys::fuzz_target;
use vision::decode::{DecodeLimits, EncodedImage, PixelFormat, decode_gray};

/// Small enough that a run is quick, and reached by small inputs.
const LIMITS: DecodeLimits =
    DecodeLimits { max_bytes: 1 << 16, max_pixels: 1 << 16, min_width: 2, min_height: 2 };
const FORMATS: [PixelFormat; 6] = [
    PixelFormat::Gray8,
    PixelFormat::Gray16,
    PixelFormat::Rgb8,
    PixelFormat::Bgr8,
    PixelFormat::Rgba8,
    PixelFormat::Bgra8,
];

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, data)) = bytes.split_first() else { return };
    let image = match kind % 4 {
        0 => EncodedImage::Auto(data),
        1 => EncodedImage::Png(data),
        2 => EncodedImage::Jpeg(data),
        _ => {
            // A head of three little-endian numbers, and the pixels.
            let Some((head, data)) = data.split_first_chunk::<12>() else { return };
            let [width, height, stride] =
                [0, 4, 8].map(|at| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]));
            let format = FORMATS[usize::from(kind / 4) % FORMATS.len()];
            EncodedImage::Raw { width, height, stride, format, data }
        }
    };
    if let Ok(gray) = decode_gray(&image, &LIMITS) {
        let (width, height) = (gray.width(), gray.height());
        assert!(width >= LIMITS.min_width && height >= LIMITS.min_height);
        assert!(u64::from(width) * u64::from(height) <= LIMITS.max_pixels);
        assert_eq!(gray.as_raw().len(), width as usize * height as usize);
    }
});

//! Images to send.

use proto::v1;
use synthetic::{Preset, Sequence, SequenceConfig, SyntheticFrame};

/// A gray image as PNG.
pub fn png(width: u32, height: u32, pixels: &[u8]) -> v1::Image {
    let mut data = Vec::new();
    let mut encoder = png::Encoder::new(&mut data, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().and_then(|mut writer| writer.write_image_data(pixels)).expect("a PNG");
    v1::Image { data: data.into(), ..v1::Image::default() }
}

/// A gray image as JPEG.
pub fn jpeg(width: u32, height: u32, pixels: &[u8]) -> v1::Image {
    let mut data = Vec::new();
    let size = [width, height].map(|side| u16::try_from(side).expect("JPEG has up to 65535 pixels a side"));
    jpeg_encoder::Encoder::new(&mut data, 90)
        .encode(pixels, size[0], size[1], jpeg_encoder::ColorType::Luma)
        .expect("a JPEG");
    v1::Image { data: data.into(), ..v1::Image::default() }
}

/// A gray image as pixels.
pub fn raw_gray(width: u32, height: u32, pixels: &[u8]) -> v1::Image {
    let data = bytes::Bytes::copy_from_slice(pixels);
    v1::Image { encoding: v1::ImageEncoding::Gray8.into(), width, height, data, row_stride: 0 }
}

/// A PNG of a few bytes whose header announces an image of this size.
pub fn oversized_png(width: u32, height: u32) -> v1::Image {
    let mut data = png(1, 1, &[0]).data.to_vec();
    // Signature, length, "IHDR", then width and height; the checksum covers the chunk's name and data.
    data[16..20].copy_from_slice(&width.to_be_bytes());
    data[20..24].copy_from_slice(&height.to_be_bytes());
    let checksum = crc32(&data[12..29]);
    data[29..33].copy_from_slice(&checksum.to_be_bytes());
    v1::Image { data: data.into(), ..v1::Image::default() }
}

/// The checksum of PNG (ISO 3309).
fn crc32(bytes: &[u8]) -> u32 {
    let mut remainder = u32::MAX;
    for byte in bytes {
        remainder ^= u32::from(*byte);
        for _ in 0..8 {
            remainder = (remainder >> 1) ^ if remainder & 1 == 1 { 0xEDB8_8320 } else { 0 };
        }
    }
    !remainder
}

/// Frames of the ready-made sequence to one that is sent: ten a second instead of twenty, to see more of the
/// room in fewer frames.
const FRAME_STEP: usize = 2;

/// A room full of texture that a small camera goes around in: quick to render and easy to track.
pub struct SmallWorld {
    sequence: Sequence,
}

impl SmallWorld {
    /// The same seen by a camera of 640 x 480 pixels.
    pub fn vga(seed: u64) -> Self {
        Self { sequence: Sequence::preset(Preset::RoomRich, seed) }
    }

    /// The world and the path; frames are rendered when asked for.
    pub fn new(seed: u64) -> Self {
        let mut config = SequenceConfig::preset(Preset::RoomRich, seed);
        let camera = &mut config.camera;
        (camera.width, camera.height) = (480, 360);
        (camera.fx, camera.fy, camera.cx, camera.cy) = (345.0, 345.0, 239.5, 179.5);
        Self { sequence: Sequence::new(config).expect("the camera is valid") }
    }

    /// The camera on the wire.
    pub fn camera(&self) -> v1::Camera {
        let camera = self.sequence.camera().parameters();
        v1::Camera {
            model: v1::CameraModel::Pinhole.into(),
            width: camera.width,
            height: camera.height,
            fx: camera.fx,
            fy: camera.fy,
            cx: camera.cx,
            cy: camera.cy,
            distortion: Vec::new(),
        }
    }

    /// Frame `i`, with `i` for its number.
    pub fn frame(&self, i: usize) -> v1::Frame {
        let SyntheticFrame { timestamp_ns, image, .. } = self.sequence.frame(i * FRAME_STEP);
        let image = raw_gray(image.width(), image.height(), image.pixels());
        v1::Frame { sequence: i as u64, timestamp_ns, image: Some(image) }
    }

    /// Pixels of frame `i`, row by row.
    pub fn pixels(&self, i: usize) -> Vec<u8> {
        self.sequence.frame(i * FRAME_STEP).image.into_pixels()
    }

    /// True position of the camera at frame `i`.
    pub fn camera_position(&self, i: usize) -> [f64; 3] {
        let center = self.sequence.camera_from_world(i * FRAME_STEP).inverse().translation;
        [center.x, center.y, center.z]
    }
}

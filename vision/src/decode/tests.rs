//! Good images decode to the right grays, bad ones to the right error, and nothing panics.

use std::io::Cursor;

use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, Rgb};

use super::*;
use crate::test_images::{self, Random};

fn file(image: DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).expect("encoding to memory works");
    bytes.into_inner()
}

fn gray_file(image: &GrayImage, format: ImageFormat) -> Vec<u8> {
    let buffer: ImageBuffer<Luma<u8>, _> =
        ImageBuffer::from_raw(image.width(), image.height(), image.as_raw().to_vec())
            .expect("the size is right");
    file(buffer.into(), format)
}

fn decode(image: EncodedImage<'_>) -> Result<GrayImage, DecodeError> {
    decode_gray(&image, &DecodeLimits::default())
}

/// Mean absolute difference, gray levels.
fn difference(a: &GrayImage, b: &GrayImage) -> f64 {
    assert_eq!((a.width(), a.height()), (b.width(), b.height()));
    let sum: u64 = a.as_raw().iter().zip(b.as_raw()).map(|(&a, &b)| u64::from(a.abs_diff(b))).sum();
    sum as f64 / a.as_raw().len() as f64
}

#[test]
fn png_and_jpeg_give_back_what_was_encoded() {
    let image = test_images::blobs(200, 150, 1);
    let png = gray_file(&image, ImageFormat::Png);
    assert_eq!(decode(EncodedImage::Png(&png)).as_ref(), Ok(&image));
    assert_eq!(decode(EncodedImage::Auto(&png)).as_ref(), Ok(&image));
    let jpeg = gray_file(&image, ImageFormat::Jpeg);
    assert!(difference(&decode(EncodedImage::Jpeg(&jpeg)).unwrap(), &image) < 6.0);
    assert!(difference(&decode(EncodedImage::Auto(&jpeg)).unwrap(), &image) < 6.0);
}

#[test]
fn colors_become_luma() {
    let color = |x: u32, y: u32| [(x % 256) as u8, (y % 256) as u8, 60];
    let expected = GrayImage::from_fn(200, 150, |x, y| {
        let [r, g, b] = color(x, y);
        (0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b)).round() as u8
    });
    let buffer = ImageBuffer::from_fn(200, 150, |x, y| Rgb(color(x, y)));
    for (format, bound) in [(ImageFormat::Png, 0.01), (ImageFormat::Jpeg, 3.0)] {
        let bytes = file(buffer.clone().into(), format);
        let decoded = decode(EncodedImage::Auto(&bytes)).unwrap();
        assert!(difference(&decoded, &expected) < bound, "{format:?}");
    }
    let wide = ImageBuffer::from_fn(200, 150, |x, y| Rgb(color(x, y).map(|v| u16::from(v) * 257)));
    let decoded = decode(EncodedImage::Png(&file(DynamicImage::ImageRgb16(wide), ImageFormat::Png))).unwrap();
    assert!(difference(&decoded, &expected) < 0.01);
}

#[test]
fn sixteen_bits_are_scaled_to_eight() {
    let wide = ImageBuffer::from_fn(160, 120, |x, y| Luma([(x * 400 + y) as u16]));
    let expected = GrayImage::from_fn(160, 120, |x, y| (f64::from(x * 400 + y) / 257.0).round() as u8);
    let png = file(DynamicImage::ImageLuma16(wide.clone()), ImageFormat::Png);
    assert_eq!(decode(EncodedImage::Png(&png)).as_ref(), Ok(&expected));
    let data: Vec<u8> = wide.as_raw().iter().flat_map(|v| v.to_le_bytes()).collect();
    let format = PixelFormat::Gray16;
    let raw = EncodedImage::Raw { width: 160, height: 120, stride: 320, format, data: &data };
    assert_eq!(decode(raw).as_ref(), Ok(&expected));
}

#[test]
fn raw_rows_may_be_padded_but_not_short() {
    let raw = |stride, data| {
        decode(EncodedImage::Raw { width: 160, height: 120, stride, format: PixelFormat::Rgb8, data })
    };
    let bytes = vec![100; 500 * 120];
    let plain = GrayImage::from_fn(160, 120, |_, _| 100);
    assert_eq!(raw(500, &bytes).as_ref(), Ok(&plain));
    assert_eq!(raw(500, &bytes[..500 * 119 + 480]).as_ref(), Ok(&plain));
    assert_eq!(raw(0, &bytes[..480 * 120]).as_ref(), Ok(&plain));
    assert_eq!(raw(479, &bytes), Err(DecodeError::StrideTooShort { stride: 479, row_bytes: 480 }));
    for length in [0, 480 * 120 - 1, 480 * 120 + 1] {
        let expected = DecodeError::WrongLength { expected: 480 * 120, actual: length as u64 };
        assert_eq!(raw(480, &bytes[..length]), Err(expected));
    }
}

/// A PNG of a few bytes whose header announces this size.
fn png_header(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = gray_file(&GrayImage::new(200, 150), ImageFormat::Png);
    bytes[16..20].copy_from_slice(&width.to_be_bytes());
    bytes[20..24].copy_from_slice(&height.to_be_bytes());
    bytes
}

/// A JPEG whose frame header announces this size.
fn jpeg_header(width: u16, height: u16) -> Vec<u8> {
    let mut bytes = gray_file(&GrayImage::new(200, 150), ImageFormat::Jpeg);
    let frame = bytes.windows(2).position(|w| w == [0xFF, 0xC0]).expect("there is a baseline frame");
    bytes[frame + 5..frame + 7].copy_from_slice(&height.to_be_bytes());
    bytes[frame + 7..frame + 9].copy_from_slice(&width.to_be_bytes());
    bytes
}

#[test]
fn sizes_are_refused_from_the_header_alone() {
    let max_pixels = DecodeLimits::default().max_pixels;
    let too_large = DecodeError::TooLarge { width: 30_000, height: 30_000, max_pixels };
    assert_eq!(decode(EncodedImage::Png(&png_header(30_000, 30_000))), Err(too_large.clone()));
    assert_eq!(decode(EncodedImage::Jpeg(&jpeg_header(30_000, 30_000))), Err(too_large));
    assert_eq!(
        decode(EncodedImage::Png(&png_header(u32::MAX, u32::MAX))),
        Err(DecodeError::TooLarge { width: u32::MAX, height: u32::MAX, max_pixels })
    );
    assert_eq!(
        decode(EncodedImage::Png(&png_header(0, 150))),
        Err(DecodeError::Empty { width: 0, height: 150 })
    );
    assert!(matches!(decode(EncodedImage::Jpeg(&jpeg_header(0, 150))), Err(DecodeError::Empty { .. })));
    let small = gray_file(&GrayImage::new(159, 120), ImageFormat::Png);
    assert!(matches!(decode(EncodedImage::Png(&small)), Err(DecodeError::TooSmall { width: 159, .. })));
    let raw = |width, height| {
        decode(EncodedImage::Raw { width, height, stride: 0, format: PixelFormat::Gray8, data: &[] })
    };
    assert_eq!(raw(0, 0), Err(DecodeError::Empty { width: 0, height: 0 }));
    assert!(matches!(raw(u32::MAX, u32::MAX), Err(DecodeError::TooLarge { .. })));
}

#[test]
fn what_is_no_image_is_named() {
    let gif = DecodeError::OtherFormat { format: "GIF" };
    assert_eq!(decode(EncodedImage::Auto(b"GIF89a...")), Err(gif));
    assert_eq!(decode(EncodedImage::Auto(b"hello")), Err(DecodeError::UnknownFormat));
    assert_eq!(decode(EncodedImage::Auto(b"")), Err(DecodeError::UnknownFormat));
    assert_eq!(decode(EncodedImage::Png(b"hello")), Err(DecodeError::WrongFormat { format: "PNG" }));
    assert_eq!(decode(EncodedImage::Jpeg(b"hello")), Err(DecodeError::WrongFormat { format: "JPEG" }));
    let limits = DecodeLimits { max_bytes: 10, ..DecodeLimits::default() };
    let too_many = DecodeError::TooManyBytes { actual: 11, max: 10 };
    assert_eq!(decode_gray(&EncodedImage::Auto(&[0; 11]), &limits), Err(too_many));
}

#[test]
fn a_file_that_ends_early_is_cut_off() {
    let image = test_images::blobs(200, 150, 2);
    let png = gray_file(&image, ImageFormat::Png);
    let jpeg = gray_file(&image, ImageFormat::Jpeg);
    for part in 1..20 {
        let cut = |bytes: &[u8]| bytes[..bytes.len() * part / 20].to_vec();
        assert_eq!(
            decode(EncodedImage::Png(&cut(&png))),
            Err(DecodeError::Truncated { format: "PNG" }),
            "{part}"
        );
        assert_eq!(
            decode(EncodedImage::Jpeg(&cut(&jpeg))),
            Err(DecodeError::Truncated { format: "JPEG" }),
            "{part}"
        );
    }
}

#[test]
fn damaged_files_never_panic() {
    let image = test_images::blobs(170, 130, 3);
    let mut random = Random::new(9);
    let mut n_refused = 0;
    for format in [ImageFormat::Png, ImageFormat::Jpeg] {
        let good = gray_file(&image, format);
        for _ in 0..400 {
            let mut bad = good.clone();
            for _ in 0..1 + random.below(6) {
                // Mostly in the headers, where the structure is.
                let range = if random.below(3) > 0 { bad.len().min(400) } else { bad.len() };
                bad[random.below(range as u32) as usize] = random.bits() as u8;
            }
            bad.truncate(bad.len() - random.below(50) as usize);
            match decode(EncodedImage::Auto(&bad)) {
                Ok(decoded) => {
                    assert!(u64::from(decoded.width()) * u64::from(decoded.height()) <= 4096 * 3072)
                }
                Err(error) => {
                    n_refused += 1;
                    assert!(!error.to_string().is_empty());
                }
            }
        }
    }
    assert!(n_refused > 200, "only {n_refused} of 800 damaged files were refused");
}

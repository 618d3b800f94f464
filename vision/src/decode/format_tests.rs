//! Files as cameras, webcams, phones and programs write them, also damaged.

use std::io::Cursor;

use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, LumaA, Rgb, Rgba};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

use super::*;
use crate::test_images;

const WIDTH: u32 = 200;
const HEIGHT: u32 = 152;

fn decode(data: &[u8]) -> Result<GrayImage, DecodeError> {
    decode_gray(&EncodedImage::Auto(data), &DecodeLimits::default())
}

fn scene() -> GrayImage {
    test_images::blobs(WIDTH, HEIGHT, 5)
}

/// Mean absolute difference, gray levels.
fn difference(a: &GrayImage, b: &GrayImage) -> f64 {
    assert_eq!((a.width(), a.height()), (b.width(), b.height()));
    let sum: u64 = a.as_raw().iter().zip(b.as_raw()).map(|(&a, &b)| u64::from(a.abs_diff(b))).sum();
    sum as f64 / a.as_raw().len() as f64
}

fn jpeg_of(pixels: &[u8], color: ColorType, set: impl FnOnce(&mut Encoder<&mut Vec<u8>>)) -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = Encoder::new(&mut file, 95);
    set(&mut encoder);
    encoder.encode(pixels, WIDTH as u16, HEIGHT as u16, color).expect("encoding to memory works");
    file
}

fn jpeg(set: impl FnOnce(&mut Encoder<&mut Vec<u8>>)) -> Vec<u8> {
    jpeg_of(scene().as_raw(), ColorType::Luma, set)
}

fn rgb(image: &GrayImage) -> Vec<u8> {
    image.as_raw().iter().flat_map(|v| [*v, v / 2, 255 - v]).collect()
}

fn gray_of_rgb(image: &GrayImage) -> GrayImage {
    let raw = EncodedImage::Raw {
        width: WIDTH,
        height: HEIGHT,
        stride: 0,
        format: PixelFormat::Rgb8,
        data: &rgb(image),
    };
    decode_gray(&raw, &DecodeLimits::default()).unwrap()
}

/// The positions of a marker's segments that are not inside another one.
fn segments(file: &[u8], wanted: u8) -> Vec<std::ops::Range<usize>> {
    let (mut at, mut found) = (2, Vec::new());
    while file[at + 1] != 0xDA {
        let end = at + 2 + usize::from(u16::from_be_bytes([file[at + 2], file[at + 3]]));
        if file[at + 1] == wanted {
            found.push(at..end);
        }
        at = end;
    }
    found
}

fn without(file: &[u8], wanted: u8) -> Vec<u8> {
    let mut kept = file.to_vec();
    for range in segments(file, wanted).into_iter().rev() {
        kept.drain(range);
    }
    assert!(kept.len() < file.len(), "there is no such segment");
    kept
}

/// A file with a small file in its metadata, as cameras write them.
fn with_thumbnail(set: impl FnOnce(&mut Encoder<&mut Vec<u8>>)) -> Vec<u8> {
    let small = test_images::blobs(WIDTH, HEIGHT, 8);
    let thumbnail = jpeg_of(small.as_raw(), ColorType::Luma, |encoder| encoder.set_quality(30));
    assert!(thumbnail.ends_with(&[0xFF, 0xD9]));
    jpeg(|encoder| {
        encoder.add_app_segment(1, [b"Exif\0\0", &thumbnail[..]].concat()).expect("it fits");
        set(encoder);
    })
}

type Setting = fn(&mut Encoder<&mut Vec<u8>>);
const KINDS: [(&str, Setting); 4] = [
    ("baseline", |_| {}),
    ("restarts", |encoder| encoder.set_restart_interval(7)),
    ("optimized", |encoder| encoder.set_optimized_huffman_tables(true)),
    ("progressive", |encoder| encoder.set_progressive(true)),
];

#[test]
fn a_file_cut_off_is_refused_whatever_its_metadata_carry() {
    for (kind, set) in KINDS {
        let file = with_thumbnail(set);
        assert!(difference(&decode(&file).unwrap(), &scene()) < 6.0, "{kind}");
        for percent in (1..100).chain([100]) {
            let cut = &file[..file.len() * percent / 100 - usize::from(percent == 100) * 60];
            let truncated = Err(DecodeError::Truncated { format: "JPEG" });
            assert_eq!(decode(cut), truncated, "{kind}, {percent} %");
            // A camera may close a file that it could not finish.
            let closed = [cut, &[0xFF, 0xD9]].concat();
            assert!(decode(&closed).is_err(), "{kind}, {percent} % with an end");
        }
    }
}

#[test]
fn a_file_without_the_marker_of_its_end_is_whole() {
    for (kind, set) in KINDS {
        let file = jpeg(set);
        let whole = decode(&file).unwrap();
        for n_missing in [1, 2] {
            assert_eq!(decode(&file[..file.len() - n_missing]).as_ref(), Ok(&whole), "{kind}");
        }
        // The beginning of the next file of a stream is no end.
        let next = [&file[..file.len() / 2], &file[..]].concat();
        assert_eq!(decode(&next), Err(DecodeError::Truncated { format: "JPEG" }), "{kind}");
        // What comes behind the end is not looked at.
        let trailing = [&file[..], b"\0\0padding\xFF\xD8\xFF"].concat();
        assert_eq!(decode(&trailing).as_ref(), Ok(&whole), "{kind}");
    }
}

#[test]
fn components_may_be_sampled_in_any_way() {
    for factor in [
        SamplingFactor::F_1_1,
        SamplingFactor::F_2_1,
        SamplingFactor::F_1_2,
        SamplingFactor::F_2_2,
        SamplingFactor::F_4_1,
    ] {
        let file = jpeg_of(&rgb(&scene()), ColorType::Rgb, |encoder| encoder.set_sampling_factor(factor));
        let image = decode(&file).unwrap_or_else(|error| panic!("{factor:?}: {error}"));
        assert!(difference(&image, &gray_of_rgb(&scene())) < 3.0, "{factor:?}");
        assert!(decode(&file[..file.len() / 2]).is_err(), "{factor:?}");
    }
    // Whatever bits fill the last byte.
    for seed in 0..60 {
        let scene = test_images::blobs(WIDTH, HEIGHT, seed);
        let file = jpeg_of(&rgb(&scene), ColorType::Rgb, |encoder| {
            encoder.set_sampling_factor(SamplingFactor::F_1_2);
        });
        let image = decode(&file).unwrap_or_else(|error| panic!("{seed}: {error}"));
        assert!(difference(&image, &gray_of_rgb(&scene)) < 3.0, "{seed}");
    }
    for factor in [SamplingFactor::F_4_2, SamplingFactor::F_1_4, SamplingFactor::F_2_4] {
        let file = jpeg_of(&rgb(&scene()), ColorType::Rgb, |encoder| encoder.set_sampling_factor(factor));
        let refused = decode(&file).unwrap_err().to_string();
        assert!(refused.contains("components sampled by"), "{refused}");
    }
    // As ffmpeg writes gray and full color: every component with a factor of 1 across and 2 down.
    let file = include_bytes!("fixtures/equal_sampling.jpg");
    let image = decode(file).unwrap();
    assert_eq!((image.width(), image.height()), (176, 144));
    // What is missing would be gray.
    let (darkest, brightest) = (image.row(143).iter().min(), image.row(143).iter().max());
    assert!(darkest < Some(&30) && brightest > Some(&200), "{darkest:?} {brightest:?}");
}

#[test]
fn a_progressive_file_of_which_scans_are_missing_is_cut_off() {
    let file = jpeg(|encoder| encoder.set_progressive(true));
    let scans: Vec<usize> = (2..file.len() - 1).filter(|i| file[*i..*i + 2] == [0xFF, 0xDA]).collect();
    assert!(scans.len() > 2, "{} scans", scans.len());
    // Between two scans nothing is cut through, but details are missing.
    for at in &scans[1..] {
        assert_eq!(decode(&file[..*at]), Err(DecodeError::Truncated { format: "JPEG" }), "{at}");
    }
}

#[test]
fn frames_of_webcams_have_the_standard_tables() {
    let file = jpeg_of(&rgb(&scene()), ColorType::Rgb, |_| {});
    let whole = decode(&file).unwrap();
    assert_eq!(decode(&without(&file, 0xC4)).as_ref(), Ok(&whole));
    let cut = without(&file, 0xC4);
    assert_eq!(decode(&cut[..cut.len() / 2]), Err(DecodeError::Truncated { format: "JPEG" }));
}

#[test]
fn colors_that_are_no_luma_are_read() {
    let (scene, expected) = (scene(), gray_of_rgb(&scene()));
    // Said to be YCbCr, so that nothing is converted; then said to be what it is.
    let mut unconverted = jpeg_of(&rgb(&scene), ColorType::Ycbcr, |_| {});
    for range in segments(&unconverted, 0xEE).into_iter().chain(segments(&unconverted, 0xE0)).rev() {
        unconverted.drain(range);
    }
    let said = [&unconverted[..2], b"\xFF\xEE\0\x0EAdobe\0\x64\0\0\0\0\0", &unconverted[2..]].concat();
    assert!(difference(&decode(&said).unwrap(), &expected) < 4.0);
    let named = rename_components(unconverted, *b"RGB");
    assert!(difference(&decode(&named).unwrap(), &expected) < 4.0);

    let cmyk: Vec<u8> = scene.as_raw().iter().flat_map(|v| [255 - v, 255 - v, 255 - v, 0]).collect();
    for color in [ColorType::Cmyk, ColorType::CmykAsYcck] {
        let file = jpeg_of(&cmyk, color, |_| {});
        assert!(difference(&decode(&file).unwrap(), &scene) < 4.0);
    }
}

fn rename_components(mut file: Vec<u8>, names: [u8; 3]) -> Vec<u8> {
    let frame = segments(&file, 0xC0)[0].start;
    let scan = (2..file.len()).find(|i| file[*i..*i + 2] == [0xFF, 0xDA]).expect("there is a scan");
    for (i, name) in names.into_iter().enumerate() {
        file[frame + 10 + 3 * i] = name;
        file[scan + 5 + 2 * i] = name;
    }
    file
}

#[test]
fn what_is_not_read_is_said_in_plain_words() {
    let file = jpeg(|_| {});
    let frame = segments(&file, 0xC0)[0].start;
    let message = |marker: u8, n_bits: u8| {
        let mut other = file.clone();
        (other[frame + 1], other[frame + 4]) = (marker, n_bits);
        decode(&other).unwrap_err().to_string()
    };
    assert!(message(0xC9, 8).contains("arithmetic coding is not read"), "{}", message(0xC9, 8));
    assert!(message(0xCA, 8).contains("arithmetic coding"));
    assert!(message(0xC3, 8).contains("lossless JPEG"));
    assert!(message(0xC5, 8).contains("hierarchical"));
    assert!(message(0xC1, 12).contains("12 bits a sample"), "{}", message(0xC1, 12));
    for (bytes, name) in [
        (&b"\0\0\0\x18ftypheic\0\0\0\0"[..], "HEIC"),
        (b"GIF89a......", "GIF"),
        (b"\0\0\0\x18ftypisom\0\0\0\0", "video"),
        (b"\xFF\x0A....", "JPEG XL"),
    ] {
        let message = decode(bytes).unwrap_err().to_string();
        assert!(message.contains(name) && message.contains("convert"), "{message}");
    }
    assert_eq!(decode(b"BZh9..........."), Err(DecodeError::UnknownFormat));
}

fn file(image: DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).expect("encoding to memory works");
    bytes.into_inner()
}

fn gray(image: &GrayImage) -> DynamicImage {
    let pixels = image.as_raw().to_vec();
    ImageBuffer::<Luma<u8>, _>::from_raw(image.width(), image.height(), pixels)
        .expect("the size is right")
        .into()
}

fn color(image: &GrayImage) -> DynamicImage {
    ImageBuffer::<Rgb<u8>, _>::from_raw(WIDTH, HEIGHT, rgb(image)).expect("the size is right").into()
}

#[test]
fn other_formats_are_read_and_refused_when_cut_off() {
    let scene = scene();
    let expected = gray_of_rgb(&scene);
    for format in [ImageFormat::Bmp, ImageFormat::WebP, ImageFormat::Tiff, ImageFormat::Pnm] {
        let colored = file(color(&scene), format);
        assert_eq!(decode(&colored).as_ref(), Ok(&expected), "{format:?}");
        if format != ImageFormat::WebP {
            assert_eq!(decode(&file(gray(&scene), format)).as_ref(), Ok(&scene), "{format:?}");
        }
        for part in 1..10 {
            let cut = decode(&colored[..colored.len() * part / 10]);
            assert!(cut.is_err(), "{format:?} {part}");
        }
        let limits = DecodeLimits { max_pixels: u64::from(WIDTH * HEIGHT) - 1, ..DecodeLimits::default() };
        let large = decode_gray(&EncodedImage::Auto(&colored), &limits);
        assert!(matches!(large, Err(DecodeError::TooLarge { .. })), "{format:?}: {large:?}");
    }
    let text = format!(
        "P2 {WIDTH} {HEIGHT} 255\n{}",
        scene.as_raw().iter().map(|v| format!("{v} ")).collect::<String>()
    );
    assert_eq!(decode(text.as_bytes()).as_ref(), Ok(&scene));
}

#[test]
fn a_bomb_is_refused_before_a_pixel_is_unpacked() {
    let bomb = |head: &str| decode(format!("{head}\n").as_bytes());
    for head in ["P5 60000 60000 255", "P6 100000 100000 65535", "P4 99999 99999", "P2 60000 60000 9"] {
        assert!(matches!(bomb(head), Err(DecodeError::TooLarge { .. })), "{head}: {:?}", bomb(head));
    }
    let mut bmp = file(gray(&scene()), ImageFormat::Bmp);
    bmp[18..22].copy_from_slice(&30_000i32.to_le_bytes());
    bmp[22..26].copy_from_slice(&30_000i32.to_le_bytes());
    assert!(matches!(decode(&bmp), Err(DecodeError::TooLarge { .. })), "{:?}", decode(&bmp));
    let mut tiff = file(gray(&scene()), ImageFormat::Tiff);
    let directory = u32::from_le_bytes([tiff[4], tiff[5], tiff[6], tiff[7]]) as usize;
    for entry in 0..usize::from(tiff[directory]) {
        let at = directory + 2 + 12 * entry;
        // Width and height: a long of one value.
        if tiff[at] <= 1 && tiff[at + 1] == 1 {
            tiff[at + 2..at + 4].copy_from_slice(&4u16.to_le_bytes());
            tiff[at + 8..at + 12].copy_from_slice(&60_000u32.to_le_bytes());
        }
    }
    assert!(decode(&tiff).is_err(), "{:?}", decode(&tiff));
}

#[test]
fn twelve_bits_in_sixteen_are_scaled_by_what_is_there_and_alike_in_a_session() {
    let scene = scene();
    let wide = |bits: u32| {
        let samples = scene.as_raw().iter().map(|v| u16::from(*v) << (bits - 8));
        let samples: Vec<u16> = samples.collect();
        DynamicImage::from(
            ImageBuffer::<Luma<u16>, _>::from_raw(WIDTH, HEIGHT, samples).expect("the size is right"),
        )
    };
    for format in [ImageFormat::Png, ImageFormat::Tiff] {
        for bits in [10, 12, 14] {
            let decoded = decode(&file(wide(bits), format)).unwrap();
            assert!(difference(&decoded, &scene) <= 1.0, "{format:?} of {bits} bits");
        }
        let mut depth = SampleDepth::default();
        let mut alike = |image: &DynamicImage| {
            decode_gray_alike(
                &EncodedImage::Auto(&file(image.clone(), format)),
                &DecodeLimits::default(),
                &mut depth,
            )
        };
        alike(&wide(12)).unwrap();
        let dark = alike(&wide(8)).unwrap();
        assert!(dark.as_raw().iter().all(|v| *v <= 16), "what is dark stays dark");
    }
    // A PGM says what its greatest value is.
    let samples: Vec<u8> = scene.as_raw().iter().flat_map(|v| (u16::from(*v) << 4).to_be_bytes()).collect();
    let pgm = [format!("P5 {WIDTH} {HEIGHT} 4095\n").as_bytes(), &samples].concat();
    assert!(difference(&decode(&pgm).unwrap(), &scene) <= 1.0);
}

#[test]
fn gray_with_alpha_and_color_of_sixteen_bits_are_read() {
    let scene = scene();
    let expected = gray_of_rgb(&scene);
    let wide: Vec<u16> = rgb(&scene).iter().map(|v| u16::from(*v) * 257).collect();
    let with_alpha: Vec<u16> = wide.chunks(3).flat_map(|p| [p[0], p[1], p[2], 65535]).collect();
    let gray_alpha: Vec<u8> = scene.as_raw().iter().flat_map(|v| [*v, 200]).collect();
    let gray_alpha_wide: Vec<u16> = gray_alpha.iter().map(|v| u16::from(*v) * 257).collect();
    let size = |image: Option<DynamicImage>| image.expect("the size is right");
    for (image, expected) in [
        (size(ImageBuffer::<Rgb<u16>, _>::from_raw(WIDTH, HEIGHT, wide).map(DynamicImage::from)), &expected),
        (
            size(ImageBuffer::<Rgba<u16>, _>::from_raw(WIDTH, HEIGHT, with_alpha).map(DynamicImage::from)),
            &expected,
        ),
        (
            size(ImageBuffer::<LumaA<u8>, _>::from_raw(WIDTH, HEIGHT, gray_alpha).map(DynamicImage::from)),
            &scene,
        ),
        (
            size(
                ImageBuffer::<LumaA<u16>, _>::from_raw(WIDTH, HEIGHT, gray_alpha_wide)
                    .map(DynamicImage::from),
            ),
            &scene,
        ),
    ] {
        let decoded = decode(&file(image, ImageFormat::Png)).unwrap();
        assert!(difference(&decoded, expected) < 1.0);
    }
}

#[test]
fn damaged_files_of_every_format_never_panic() {
    let mut random = test_images::Random::new(3);
    let scene = scene();
    let files = [
        jpeg(|encoder| encoder.set_progressive(true)),
        without(&jpeg(|_| {}), 0xC4),
        file(color(&scene), ImageFormat::Bmp),
        file(color(&scene), ImageFormat::WebP),
        file(color(&scene), ImageFormat::Tiff),
        file(gray(&scene), ImageFormat::Pnm),
    ];
    let mut n_refused = 0;
    for good in &files {
        for _ in 0..150 {
            let mut bad = good.clone();
            for _ in 0..1 + random.below(6) {
                let range = if random.below(3) > 0 { bad.len().min(300) } else { bad.len() };
                bad[random.below(range as u32) as usize] = random.bits() as u8;
            }
            bad.truncate(bad.len() - random.below(50) as usize);
            match decode(&bad) {
                Ok(image) => assert!(u64::from(image.width()) * u64::from(image.height()) <= 4096 * 3072),
                Err(error) => {
                    n_refused += 1;
                    assert!(!error.to_string().is_empty());
                }
            }
        }
    }
    assert!(n_refused > 300, "only {n_refused} of 900 damaged files were refused");
}

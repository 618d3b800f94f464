//! What a file is, by its first bytes.

/// A format of image files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FileFormat {
    /// PNG.
    Png,
    /// JPEG.
    Jpeg,
    /// Windows bitmap.
    Bmp,
    /// WebP.
    WebP,
    /// TIFF.
    Tiff,
    /// PBM, PGM, PPM or PAM.
    Pnm,
}

/// What other files begin with that are taken for images, and at which byte.
const OTHERS: [(usize, &[u8], &str); 16] = [
    (0, b"GIF8", "GIF"),
    (4, b"ftypheic", "HEIC"),
    (4, b"ftypheix", "HEIC"),
    (4, b"ftypmif1", "HEIF"),
    (4, b"ftypavif", "AVIF"),
    (4, b"ftyp", "MP4 or MOV video"),
    (0, b"\xFF\x0A", "JPEG XL"),
    (0, b"\0\0\0\x0CJXL ", "JPEG XL"),
    (0, b"\0\0\0\x0CjP  ", "JPEG 2000"),
    (0, b"\xFF\x4F\xFF\x51", "JPEG 2000"),
    (0, b"v/1\x01", "OpenEXR"),
    (0, b"#?RADIANCE", "Radiance HDR"),
    (0, b"%PDF", "PDF"),
    (0, b"<svg", "SVG"),
    (0, b"<!DOCTYPE", "HTML"),
    (0, b"<html", "HTML"),
];

impl FileFormat {
    /// The format of a file that begins like this.
    pub fn of(data: &[u8]) -> Option<Self> {
        let starts = |signature: &[u8]| data.starts_with(signature);
        if starts(b"\x89PNG\r\n\x1a\n") {
            return Some(Self::Png);
        }
        if starts(b"\xFF\xD8\xFF") {
            return Some(Self::Jpeg);
        }
        if starts(b"RIFF") && data.get(8..12) == Some(b"WEBP") {
            return Some(Self::WebP);
        }
        if starts(b"II*\0") || starts(b"MM\0*") {
            return Some(Self::Tiff);
        }
        if starts(b"BM") {
            return Some(Self::Bmp);
        }
        match data {
            [b'P', b'1'..=b'7', space, ..] if space.is_ascii_whitespace() => Some(Self::Pnm),
            _ => None,
        }
    }

    /// What it is called in sentences.
    pub fn name(self) -> &'static str {
        match self {
            Self::Png => "PNG",
            Self::Jpeg => "JPEG",
            Self::Bmp => "BMP",
            Self::WebP => "WebP",
            Self::Tiff => "TIFF",
            Self::Pnm => "PNM",
        }
    }

    /// Its media type.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Jpeg => "image/jpeg",
            Self::Bmp => "image/bmp",
            Self::WebP => "image/webp",
            Self::Tiff => "image/tiff",
            Self::Pnm => "image/x-portable-anymap",
        }
    }

    /// Whether browsers show it.
    pub fn is_shown_by_browsers(self) -> bool {
        matches!(self, Self::Png | Self::Jpeg | Self::WebP | Self::Bmp)
    }
}

/// What it is that is not read, where that can be told.
pub(super) fn other(data: &[u8]) -> Option<&'static str> {
    let found =
        OTHERS.iter().find(|(at, signature, _)| data.get(*at..).is_some_and(|d| d.starts_with(signature)));
    found.map(|(_, _, name)| *name)
}

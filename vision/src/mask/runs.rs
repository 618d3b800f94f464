//! Masks as few bytes.
//!
//! `width u32 | height u32`, then the lengths of runs of pixels, row after row, that are used and left out in
//! turn, the first one used; each length in groups of seven bits, the lowest first, of which all but the last
//! have the highest bit set (LEB128). Numbers are little-endian.

use super::Mask;
use crate::GrayImage;

/// Larger masks than the largest image of a camera are none.
const MAX_PIXELS: u64 = 1 << 28;

impl Mask {
    /// To be stored.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        bytes.extend(self.width().to_le_bytes());
        bytes.extend(self.height().to_le_bytes());
        let (mut is_used, mut length) = (true, 0u64);
        for value in self.picture.as_raw() {
            if (*value != 0) == is_used {
                length += 1;
            } else {
                push_length(&mut bytes, length);
                (is_used, length) = (!is_used, 1);
            }
        }
        push_length(&mut bytes, length);
        bytes
    }

    /// Inverse of [`Mask::to_bytes`]; `None` if the bytes are not those of a mask.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (width, rest) =
            bytes.split_first_chunk().map(|(number, rest)| (u32::from_le_bytes(*number), rest))?;
        let (height, mut rest) =
            rest.split_first_chunk().map(|(number, rest)| (u32::from_le_bytes(*number), rest))?;
        let n_pixels = u64::from(width) * u64::from(height);
        if n_pixels > MAX_PIXELS {
            return None;
        }
        let mut pixels = Vec::new();
        let mut is_used = true;
        while !rest.is_empty() {
            let length = take_length(&mut rest)?;
            if length > n_pixels - pixels.len() as u64 {
                return None;
            }
            let value = if is_used { 255 } else { 0 };
            pixels.resize(pixels.len() + length as usize, value);
            is_used = !is_used;
        }
        Some(Self { picture: GrayImage::from_raw(width, height, pixels).ok()? })
    }
}

fn push_length(bytes: &mut Vec<u8>, mut length: u64) {
    while length >= 0x80 {
        bytes.push(length as u8 | 0x80);
        length >>= 7;
    }
    bytes.push(length as u8);
}

fn take_length(rest: &mut &[u8]) -> Option<u64> {
    let mut length = 0;
    for shift in (0..35).step_by(7) {
        let (byte, others) = rest.split_first()?;
        *rest = others;
        length |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Some(length);
        }
    }
    None
}

//! Image messages as images.

use super::container::{MessageKind, RosMessage};
use super::fields::{Fields, header_time_ns};
use crate::frames::{FrameImage, PixelFormat, RawImage, TimedFrame};

/// How a sensor's message names its pixels, and what is made of them.
enum Pixels {
    AsTheyAre(PixelFormat),
    /// Sixteen bits, the upper byte first.
    Swapped,
    /// A mosaic of red, green and blue.
    Bayer,
    /// Gray every second byte, from this one on.
    EverySecond(usize),
}

/// The image of a message, or why there is none.
pub(super) fn decode(message: &RosMessage) -> Result<TimedFrame, String> {
    let mut fields = Fields::of(&message.data, message.encoding);
    let timestamp_ns = match header_time_ns(&mut fields)? {
        // It was not set.
        0 => message.log_time_ns,
        timestamp_ns => timestamp_ns,
    };
    let image = if message.kind == MessageKind::CompressedImage {
        FrameImage::Encoded(compressed(&mut fields)?)
    } else {
        FrameImage::Raw(raw(&mut fields)?)
    };
    Ok(TimedFrame { timestamp_ns, image })
}

fn compressed(fields: &mut Fields<'_>) -> Result<Vec<u8>, String> {
    let format = fields.text()?;
    let data = fields.bytes()?;
    let is_read = data.starts_with(b"\xff\xd8") || data.starts_with(b"\x89PNG");
    if is_read {
        Ok(data.to_vec())
    } else {
        Err(format!("it is compressed as `{format}`, which is neither JPEG nor PNG"))
    }
}

fn raw(fields: &mut Fields<'_>) -> Result<RawImage, String> {
    let (height, width) = (fields.u32()?, fields.u32()?);
    let encoding = fields.text()?;
    let is_big_endian = fields.u8()? != 0;
    let row_stride = fields.u32()?;
    let data = fields.bytes()?;
    let pixels = pixels(encoding, is_big_endian)?;
    let n_pixel_bytes = match pixels {
        Pixels::AsTheyAre(format) => format.n_bytes(),
        Pixels::Swapped | Pixels::EverySecond(_) => 2,
        Pixels::Bayer => 1,
    };
    let (n_columns, n_rows, stride) = (width as usize, height as usize, row_stride as usize);
    let n_row_bytes = n_columns.checked_mul(n_pixel_bytes).filter(|n| *n > 0 && *n <= stride);
    let is_whole =
        |n_row_bytes| n_rows > 0 && data.len() >= (n_rows - 1).saturating_mul(stride) + n_row_bytes;
    let Some(n_row_bytes) = n_row_bytes.filter(|n| is_whole(*n)) else {
        return Err(format!(
            "{} bytes in rows of {row_stride} are no image of {width}x{height} pixels as `{encoding}`",
            data.len()
        ));
    };
    let rows: Vec<&[u8]> = (0..n_rows).map(|y| &data[y * stride..y * stride + n_row_bytes]).collect();
    let gray = |data| RawImage { format: PixelFormat::Gray8, width, height, row_stride: width, data };
    Ok(match pixels {
        Pixels::AsTheyAre(format) => RawImage { format, width, height, row_stride, data: data.to_vec() },
        Pixels::Swapped => {
            let swapped = rows.iter().flat_map(|row| row.chunks_exact(2).flat_map(|pair| [pair[1], pair[0]]));
            let row_stride = 2 * width;
            RawImage { format: PixelFormat::Gray16, width, height, row_stride, data: swapped.collect() }
        }
        Pixels::Bayer => gray(from_mosaic(&rows)),
        Pixels::EverySecond(first) => {
            gray(rows.iter().flat_map(|row| row.iter().skip(first).step_by(2).copied()).collect())
        }
    })
}

fn pixels(encoding: &str, is_big_endian: bool) -> Result<Pixels, String> {
    Ok(match encoding {
        "mono8" | "8UC1" => Pixels::AsTheyAre(PixelFormat::Gray8),
        "mono16" if is_big_endian => Pixels::Swapped,
        "mono16" => Pixels::AsTheyAre(PixelFormat::Gray16),
        "rgb8" => Pixels::AsTheyAre(PixelFormat::Rgb8),
        "bgr8" | "8UC3" => Pixels::AsTheyAre(PixelFormat::Bgr8),
        "rgba8" => Pixels::AsTheyAre(PixelFormat::Rgba8),
        "bgra8" | "8UC4" => Pixels::AsTheyAre(PixelFormat::Bgra8),
        "bayer_rggb8" | "bayer_bggr8" | "bayer_gbrg8" | "bayer_grbg8" => Pixels::Bayer,
        "yuv422" | "uyvy" => Pixels::EverySecond(1),
        "yuv422_yuy2" | "yuyv" => Pixels::EverySecond(0),
        other => {
            return Err(format!(
                "pixels as `{other}` are not read: mono8, mono16, rgb8, bgr8, rgba8, bgra8, bayer_*8, yuv422 and \
                 yuv422_yuy2 are"
            ));
        }
    })
}

/// Gray of a mosaic of red, green and blue: by the weights 1 2 1 in both directions, each pixel gets a
/// quarter of red, half of green and a quarter of blue, wherever in the pattern it is, and none is shifted.
fn from_mosaic(rows: &[&[u8]]) -> Vec<u8> {
    let last_y = rows.len() - 1;
    let last_x = rows[0].len() - 1;
    // At the border the pattern goes on as in a mirror, which keeps its colors.
    let mirrored = |i: usize, last: usize| {
        [if i == 0 { last.min(1) } else { i - 1 }, i, {
            if i == last { last.saturating_sub(1) } else { i + 1 }
        }]
    };
    let mut gray = Vec::with_capacity(rows.len() * rows[0].len());
    for y in 0..rows.len() {
        let [above, here, below] = mirrored(y, last_y).map(|y| rows[y]);
        let column = |x: usize| u32::from(above[x]) + 2 * u32::from(here[x]) + u32::from(below[x]);
        for x in 0..=last_x {
            let [left, here, right] = mirrored(x, last_x).map(column);
            gray.push(((left + 2 * here + right + 8) / 16) as u8);
        }
    }
    gray
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mosaic_gives_the_same_gray_everywhere() {
        let (red, green, blue) = (40u8, 80, 120);
        let [first, second] = [[red, green, red, green, red], [green, blue, green, blue, green]];
        let rows: Vec<&[u8]> = vec![&first, &second, &first, &second];
        assert_eq!(from_mosaic(&rows), vec![80; 20]);
        assert_eq!(from_mosaic(&[&[7]]), [7]);
    }

    #[test]
    fn what_pixels_are_not_read_is_told_by_name() {
        assert!(pixels("32FC1", false).err().unwrap().contains("`32FC1`"));
        assert!(pixels("16UC1", false).is_err());
    }
}

//! Shrinking images: by area for any ratio, bilinearly and fast for the pyramid.

use crate::GrayImage;

mod bilinear;

pub use bilinear::BilinearResizer;

/// Shrinks (or stretches) `image` to `new_width` x `new_height` by averaging over the area each new pixel
/// covers.
///
/// Fine detail is averaged away rather than aliased. An empty image, or an empty size, gives a black image.
pub fn resize_area(image: &GrayImage, new_width: u32, new_height: u32) -> GrayImage {
    let mut out = GrayImage::new(new_width, new_height);
    if out.is_empty() || image.is_empty() {
        return out;
    }
    let columns = AreaSpan::for_axis(image.width(), new_width);
    let rows = AreaSpan::for_axis(image.height(), new_height);
    let mut sums = vec![0.0f32; image.width() as usize];
    for (y, row_span) in rows.iter().enumerate() {
        sums.fill(0.0);
        for (offset, &weight) in row_span.weights.iter().enumerate() {
            let row = image.row(row_span.start + offset as u32);
            for (sum, &pixel) in sums.iter_mut().zip(row) {
                *sum += weight * f32::from(pixel);
            }
        }
        for (pixel, span) in out.row_mut(y as u32).iter_mut().zip(&columns) {
            let inputs = &sums[span.start as usize..];
            let value: f32 = span.weights.iter().zip(inputs).map(|(w, v)| w * v).sum();
            *pixel = (value + 0.5) as u8;
        }
    }
    out
}

/// The old pixels one new pixel covers along one axis, with the shares they have in it (summing to 1).
struct AreaSpan {
    start: u32,
    weights: Vec<f32>,
}

impl AreaSpan {
    fn for_axis(old: u32, new: u32) -> Vec<Self> {
        let step = f64::from(old) / f64::from(new);
        let span = |index: u32| {
            let (from, to) = (f64::from(index) * step, (f64::from(index) + 1.0) * step);
            let start = (from.floor() as u32).min(old - 1);
            let end = (to.ceil() as u32).clamp(start + 1, old);
            let covered = |pixel: u32| (to.min(f64::from(pixel) + 1.0) - from.max(f64::from(pixel))).max(0.0);
            let total: f64 = (start..end).map(covered).sum();
            let weights = (start..end).map(|pixel| (covered(pixel) / total) as f32).collect();
            Self { start, weights }
        };
        (0..new).map(span).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images;

    #[test]
    fn whole_ratios_average_blocks() {
        let image = test_images::noise(40, 30, 255, 1);
        let out = resize_area(&image, 20, 10);
        for y in 0..10 {
            for x in 0..20 {
                let sum: u32 =
                    (0..6).map(|i| u32::from(image.row(3 * y + i / 2)[(2 * x + i % 2) as usize])).sum();
                assert_eq!(out.get(x, y), Some(((f64::from(sum) / 6.0) + 0.5) as u8));
            }
        }
    }

    #[test]
    fn fine_stripes_average_to_gray() {
        let image = GrayImage::from_fn(640, 480, |x, _| if x % 2 == 0 { 0 } else { 200 });
        let out = resize_area(&image, 150, 100);
        // 4.27 pixels a new pixel: at most a quarter of a stripe more of one kind than of the other.
        assert!(out.as_raw().iter().all(|&p| p.abs_diff(100) < 25));
    }

    #[test]
    fn sizes_of_one_and_none_are_handled() {
        let image = GrayImage::from_fn(7, 5, |_, _| 90);
        for (width, height) in [(1, 1), (7, 5), (20, 3)] {
            assert_eq!(resize_area(&image, width, height), GrayImage::from_fn(width, height, |_, _| 90));
        }
        assert!(resize_area(&image, 0, 3).is_empty());
        assert_eq!(resize_area(&GrayImage::new(0, 4), 2, 2), GrayImage::new(2, 2));
    }
}

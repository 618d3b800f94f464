//! The part of a segment inside an image.

use nalgebra::Vector2;

use super::Segment;

/// The rectangle of pixel centers of an image, or one around it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Frame {
    min: Vector2<f32>,
    max: Vector2<f32>,
}

impl Frame {
    /// The pixel centers of an image of this size. Contains nothing if the image is empty.
    pub fn of_image(width: u32, height: u32) -> Self {
        Self { min: Vector2::zeros(), max: Vector2::new(width as f32 - 1.0, height as f32 - 1.0) }
    }

    /// Grown on all sides, pixels; shrunk if negative.
    pub fn grown(&self, by_px: f32) -> Self {
        Self { min: self.min - Vector2::repeat(by_px), max: self.max + Vector2::repeat(by_px) }
    }

    /// The pixel centers of an image without `border_px` on every side, unless nothing remains of it.
    pub fn inside(width: u32, height: u32, border_px: f32) -> Option<Self> {
        let frame = Self::of_image(width, height).grown(-border_px);
        (0..2).all(|axis| frame.max[axis] > frame.min[axis]).then_some(frame)
    }

    pub fn min(&self) -> Vector2<f32> {
        self.min
    }

    pub fn max(&self) -> Vector2<f32> {
        self.max
    }

    pub fn contains(&self, position: &Vector2<f32>) -> bool {
        (0..2).all(|axis| (self.min[axis]..=self.max[axis]).contains(&position[axis]))
    }

    /// The part of `segment` inside, if there is any; its direction stays.
    pub fn clip(&self, segment: &Segment) -> Option<Segment> {
        let (start, end) = segment.is_finite().then(|| self.clip_ends(segment.start, segment.end))??;
        Some(Segment { start, end, ..*segment })
    }

    /// The part between two pixels that is inside, if there is any.
    pub fn clip_ends(&self, start: Vector2<f32>, end: Vector2<f32>) -> Option<(Vector2<f32>, Vector2<f32>)> {
        if (0..2).any(|axis| self.min[axis] > self.max[axis]) {
            return None;
        }
        let vector = end - start;
        let (mut first, mut last) = (0.0f32, 1.0f32);
        // Liang & Barsky: on each axis the line is inside between two of its parameters.
        for axis in 0..2 {
            let (from, along) = (start[axis], vector[axis]);
            if along == 0.0 {
                if !(self.min[axis]..=self.max[axis]).contains(&from) {
                    return None;
                }
                continue;
            }
            let (a, b) = ((self.min[axis] - from) / along, (self.max[axis] - from) / along);
            first = first.max(a.min(b));
            last = last.min(a.max(b));
        }
        if !(first <= last && vector.iter().all(|value| value.is_finite())) {
            return None;
        }
        let clipped_start = if first > 0.0 { start + vector * first } else { start };
        let clipped_end = if last < 1.0 { start + vector * last } else { end };
        Some((clipped_start, clipped_end))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segment(start: (f32, f32), end: (f32, f32)) -> Segment {
        let vector = |(x, y)| Vector2::new(x, y);
        Segment { start: vector(start), end: vector(end), sigma_px: 0.3, gradient: 9.0 }
    }

    #[test]
    fn what_is_inside_stays() {
        let frame = Frame::of_image(101, 51);
        let inside = segment((3.0, 50.0), (100.0, 2.0));
        assert_eq!(frame.clip(&inside), Some(inside));
        let clipped = frame.clip(&segment((-50.0, 10.0), (150.0, 30.0))).unwrap();
        assert!((clipped.start - Vector2::new(0.0, 15.0)).norm() < 1e-4);
        assert!((clipped.end - Vector2::new(100.0, 25.0)).norm() < 1e-4);
        let upright = frame.clip(&segment((7.0, 80.0), (7.0, -80.0))).unwrap();
        assert_eq!((upright.start.y, upright.end.y), (50.0, 0.0));
    }

    #[test]
    fn what_misses_is_nothing() {
        let frame = Frame::of_image(101, 51);
        for (start, end) in [
            ((-5.0, 3.0), (-5.0, 40.0)),
            ((-10.0, 5.0), (20.0, -30.0)),
            ((f32::NAN, 0.0), (4.0, 4.0)),
            ((f32::MAX, 0.0), (-f32::MAX, 4.0)),
        ] {
            assert_eq!(frame.clip(&segment(start, end)), None, "{start:?}");
        }
        assert_eq!(Frame::of_image(0, 0).clip(&segment((0.0, 0.0), (1.0, 1.0))), None);
    }
}

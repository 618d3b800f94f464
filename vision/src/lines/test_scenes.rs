//! Drawn scenes whose edges are known: a plane of bright and dark rectangles, seen through a homography.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::Segment;
use super::clip::Frame;
use crate::GrayImage;
use crate::test_images::Random;

/// Side of the squares that hold one rectangle each, in units of the plane: a pixel where the homography is
/// the identity.
const CELL: f32 = 90.0;

#[derive(Clone, Copy)]
struct Rectangle {
    center: Vector2<f32>,
    /// Half its sides, along its own axes.
    half: Vector2<f32>,
    /// Unit vector of its first axis.
    axis: Vector2<f32>,
    value: f32,
}

impl Rectangle {
    fn second_axis(&self) -> Vector2<f32> {
        Vector2::new(-self.axis.y, self.axis.x)
    }

    fn contains(&self, point: Vector2<f32>) -> bool {
        let offset = point - self.center;
        offset.dot(&self.axis).abs() <= self.half.x && offset.dot(&self.second_axis()).abs() <= self.half.y
    }
}

/// Rectangles of random size, direction and brightness, one in each square of a board.
pub(super) struct Scene {
    n_columns: i32,
    n_rows: i32,
    rectangles: Vec<Rectangle>,
}

/// Brightness of the plane itself.
const GROUND: f32 = 110.0;

/// Soft spots, with gradients well below an edge's: without them a rectangle's opposite sides would look
/// alike.
fn texture(point: Vector2<f32>) -> f32 {
    let (x, y) = (point.x, point.y);
    7.0 * (x / 13.0 + 2.0 * (y / 41.0).sin()).sin() + 7.0 * (y / 11.0 + 2.0 * (x / 37.0).sin()).sin()
}

impl Scene {
    /// Covers the plane from `(-CELL, -CELL)` to one square beyond `width` and `height`.
    pub fn new(width: u32, height: u32, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let squares = |size: u32| (size as f32 / CELL).ceil() as i32 + 2;
        let (n_columns, n_rows) = (squares(width), squares(height));
        let rectangles = (0..n_columns * n_rows)
            .map(|index| {
                let cell = Vector2::new((index % n_columns - 1) as f32, (index / n_columns - 1) as f32);
                let angle = random.unit() * std::f32::consts::PI;
                let contrast = 35.0 + 60.0 * random.unit();
                Rectangle {
                    center: (cell + Vector2::repeat(0.5)) * CELL,
                    half: Vector2::new(18.0 + 16.0 * random.unit(), 8.0 + 18.0 * random.unit()),
                    axis: Vector2::new(angle.cos(), angle.sin()),
                    value: if random.below(2) == 0 { GROUND - contrast } else { GROUND + contrast },
                }
            })
            .collect();
        Self { n_columns, n_rows, rectangles }
    }

    fn value(&self, point: Vector2<f32>) -> f32 {
        let (column, row) = ((point.x / CELL).floor() as i32 + 1, (point.y / CELL).floor() as i32 + 1);
        if (0..self.n_columns).contains(&column) && (0..self.n_rows).contains(&row) {
            let rectangle = &self.rectangles[(row * self.n_columns + column) as usize];
            if rectangle.contains(point) {
                return rectangle.value + texture(point);
            }
        }
        GROUND + texture(point)
    }

    /// The scene through `image_from_plane`, means of 3 x 3 points per pixel, with a little noise; brightness
    /// `v` becomes `gain * v + offset`.
    pub fn render(
        &self,
        size: (u32, u32),
        image_from_plane: &Matrix3<f32>,
        gain: f32,
        offset: f32,
    ) -> GrayImage {
        let plane_from_image = image_from_plane.try_inverse().expect("a homography");
        let mut random = Random::new(77);
        GrayImage::from_fn(size.0, size.1, |x, y| {
            let mut sum = 0.0;
            for (dx, dy) in (0..9).map(|i| ((i % 3 - 1) as f32 / 3.0, (i / 3 - 1) as f32 / 3.0)) {
                sum += self.value(apply(&plane_from_image, Vector2::new(x as f32 + dx, y as f32 + dy)));
            }
            (gain * sum / 9.0 + offset + 3.0 * random.unit() - 1.5).round().clamp(0.0, 255.0) as u8
        })
    }

    /// The edges in the image, the part further than 1 px from its border, with the number of the edge; those
    /// shorter than 15 px are left out.
    pub fn segments(&self, size: (u32, u32), image_from_plane: &Matrix3<f32>) -> Vec<(usize, Segment)> {
        let frame = Frame::of_image(size.0, size.1).grown(-1.0);
        let mut segments = Vec::new();
        for (index, rectangle) in self.rectangles.iter().enumerate() {
            let (a, b) = (rectangle.axis * rectangle.half.x, rectangle.second_axis() * rectangle.half.y);
            // Clockwise on the screen, so the inside is to the right.
            let corners =
                [-a - b, a - b, a + b, b - a].map(|c| apply(image_from_plane, rectangle.center + c));
            for side in 0..4 {
                let (from, to) = (corners[side], corners[(side + 1) % 4]);
                let (start, end) = if rectangle.value > GROUND { (from, to) } else { (to, from) };
                let gradient = 0.5 * (rectangle.value - GROUND).abs();
                let whole = Segment { start, end, sigma_px: 0.3, gradient };
                if let Some(segment) = frame.clip(&whole).filter(|segment| segment.length() >= 15.0) {
                    segments.push((4 * index + side, segment));
                }
            }
        }
        segments
    }
}

/// Scales and turns (clockwise on the screen) about a point of the image, then moves, pixels.
pub(super) fn similarity(about: Vector2<f32>, scale: f32, turn_deg: f32, by: Vector2<f32>) -> Matrix3<f32> {
    let (sin, cos) = turn_deg.to_radians().sin_cos();
    let (a, b) = (scale * cos, scale * sin);
    let moved = about + by - Vector2::new(a * about.x - b * about.y, b * about.x + a * about.y);
    Matrix3::new(a, -b, moved.x, b, a, moved.y, 0.0, 0.0, 1.0)
}

/// Where a homography puts a point.
pub(super) fn apply(homography: &Matrix3<f32>, point: Vector2<f32>) -> Vector2<f32> {
    let mapped = homography * Vector3::new(point.x, point.y, 1.0);
    mapped.xy() / mapped.z
}

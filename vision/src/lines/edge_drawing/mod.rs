//! Segments by edge drawing: from the sharpest edge pixels, edges are followed pixel by pixel, and cut into
//! straight pieces; pieces of one line with a gap between them are joined.
//!
//! The idea is that of EDLines [Akinlar & Topal, "EDLines: a real-time line segment detector with a false
//! detection control", 2011], joining across gaps that of ELSED [Suárez et al., "ELSED: Enhanced Line SEgment
//! Drawing", 2022]. Here an edge is followed along its own direction, brighter side to the right, so that
//! every pixel has one successor and the opposite edge of a thin bar is never taken for the continuation;
//! pieces are fitted to sub-pixel positions.

mod anchors;
mod bridge;
mod pieces;
mod walk;

use nalgebra::Vector2;

use crate::GrayImage;
use crate::lines::gradient::{Gradients, UNITS_PER_LEVEL};
use crate::lines::raw_detector::RawDetector;
use crate::lines::select::Ends;

/// Pieces shorter than this after joining are not reported, pixels. An accidental alignment of so many pixels
/// of a chain within a pixel of a line is expected less than once in an image [Akinlar & Topal 2011, section
/// 2.3: 12 px for 752x480].
const MIN_LENGTH_PX: f32 = 14.0;

/// Finds segments by edge drawing; keeps its buffers.
#[derive(Clone, Debug)]
pub(super) struct EdgeDrawing {
    /// Weakest edge followed, in units of [`Gradients`].
    min_magnitude: i16,
    anchors: anchors::Anchors,
    walker: walk::Walker,
    /// Sub-pixel positions of the edge being cut.
    points: Vec<Vector2<f32>>,
    pieces: Vec<pieces::Piece>,
    bridger: bridge::Bridger,
}

impl EdgeDrawing {
    /// A detector that follows edges of at least `min_gradient` gray levels per pixel.
    pub fn new(min_gradient: f32) -> Self {
        Self {
            min_magnitude: (min_gradient * UNITS_PER_LEVEL) as i16,
            anchors: anchors::Anchors::default(),
            walker: walk::Walker::default(),
            points: Vec::new(),
            pieces: Vec::new(),
            bridger: bridge::Bridger::default(),
        }
    }
}

impl RawDetector for EdgeDrawing {
    fn detect(&mut self, _: &GrayImage, gradients: &Gradients, segments: &mut Vec<Ends>) {
        self.pieces.clear();
        self.walker.start_image(gradients, self.min_magnitude);
        for &anchor in self.anchors.find(gradients, self.min_magnitude) {
            let chain = self.walker.follow(gradients, anchor as usize);
            if chain.len() >= pieces::SEED {
                walk::sub_pixel(gradients, chain, &mut self.points);
                pieces::cut(gradients, chain, &self.points, &mut self.pieces);
            }
        }
        self.bridger.join(&mut self.pieces);
        let long = self.pieces.iter().map(|piece| piece.ends).filter(|ends| ends.length() >= MIN_LENGTH_PX);
        segments.extend(long);
    }
}

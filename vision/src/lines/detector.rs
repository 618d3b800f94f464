//! Entry point of line detection: a detector of choice, its segments refined, filtered and spread for SLAM.

use crate::GrayImage;
use crate::lines::Segment;
use crate::lines::clip::Frame;
use crate::lines::edge_drawing::EdgeDrawing;
use crate::lines::gradient::Gradients;
use crate::lines::lsd::Lsd;
use crate::lines::raw_detector::RawDetector;
use crate::lines::refine::Refiner;
use crate::lines::sampling::Sampler;
use crate::lines::select;
use crate::lines::sharpen::sharpen;

/// Finds line segments; keeps its buffers from image to image, hence `&mut`.
pub trait SegmentDetector: Send {
    /// The segments of an image, longest first; the same image always gives the same segments. An image
    /// without straight edges, or of no size, gives none.
    fn detect(&mut self, image: &GrayImage) -> Vec<Segment>;
}

/// Ways of finding segments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DetectorKind {
    /// Follow edges pixel by pixel and cut them into straight pieces
    /// [Akinlar & Topal, "EDLines", 2011; Suárez et al., "ELSED", 2022]: fast.
    EdgeDrawing,
    /// Grow regions of like gradient direction and keep those that do not happen by chance
    /// [Grompone von Gioi et al., "LSD: a Line Segment Detector", 2012]: thorough, three to four times as
    /// slow.
    Lsd,
}

/// How line segments are detected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineDetectorConfig {
    /// Which detector. Default [`DetectorKind::EdgeDrawing`].
    pub kind: DetectorKind,
    /// Shorter segments are dropped, pixels: their direction is uncertain and they are seldom found again.
    /// Default 20.
    pub min_length_px: f32,
    /// So are those shorter than this share of the image's width; the larger of the two counts. Default 0.05.
    pub min_length_share: f32,
    /// Segments are cut off this close to the image's edges, pixels: at least 2, since the gradient there is
    /// that of pixels made up. Default 4.
    pub border_px: f32,
    /// Most segments per image: the longest, spread over the image. Default 200.
    pub max_segments: usize,
    /// Edges that stray more from their line are dropped, pixels (root mean square): they are curves. Default
    /// 1.0.
    pub max_sigma_px: f32,
    /// Edges weaker than this are not followed by [`DetectorKind::EdgeDrawing`], gray levels per pixel
    /// (`|gx| + |gy|` of the image smoothed with sigma 1). Default 4: noise of sigma 5 gray levels stays
    /// below.
    pub min_gradient: f32,
    /// [`DetectorKind::Lsd`] works on the image shrunk by this, 0.3 to 1. Default 0.8, which takes the
    /// staircase out of slanted edges; 0.5 is over twice as fast and loses short segments.
    pub lsd_scale: f32,
}

impl Default for LineDetectorConfig {
    fn default() -> Self {
        Self {
            kind: DetectorKind::EdgeDrawing,
            min_length_px: 20.0,
            min_length_share: 0.05,
            border_px: 4.0,
            max_segments: 200,
            max_sigma_px: 1.0,
            min_gradient: 4.0,
            lsd_scale: 0.8,
        }
    }
}

/// Which field of a [`LineDetectorConfig`] is out of range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LineDetectorConfigError {
    /// `min_length_px` is not finite or below 10.
    #[error("min_length_px must be at least 10, not {0}")]
    MinLength(f32),
    /// `min_length_share` is not between 0 and 1.
    #[error("min_length_share must be between 0 and 1, not {0}")]
    MinLengthShare(f32),
    /// `border_px` is not between 2 and 1000.
    #[error("border_px must be between 2 and 1000, not {0}")]
    Border(f32),
    /// `max_segments` is 0.
    #[error("max_segments must be at least 1")]
    MaxSegments,
    /// `max_sigma_px` is not above the smallest sigma, 0.3, and at most 10.
    #[error("max_sigma_px must be above 0.3 and at most 10, not {0}")]
    MaxSigma(f32),
    /// `min_gradient` is not between 0.5 and 128.
    #[error("min_gradient must be between 0.5 and 128, not {0}")]
    MinGradient(f32),
    /// `lsd_scale` is not between 0.3 and 1.
    #[error("lsd_scale must be between 0.3 and 1, not {0}")]
    LsdScale(f32),
}

impl LineDetectorConfig {
    /// Checks every field's range.
    pub fn validate(&self) -> Result<(), LineDetectorConfigError> {
        use LineDetectorConfigError as Error;
        if !(self.min_length_px.is_finite() && self.min_length_px >= 10.0) {
            return Err(Error::MinLength(self.min_length_px));
        }
        if !(0.0..=1.0).contains(&self.min_length_share) {
            return Err(Error::MinLengthShare(self.min_length_share));
        }
        if !(2.0..=1000.0).contains(&self.border_px) {
            return Err(Error::Border(self.border_px));
        }
        if self.max_segments == 0 {
            return Err(Error::MaxSegments);
        }
        if !(self.max_sigma_px > Refiner::MIN_SIGMA_PX && self.max_sigma_px <= 10.0) {
            return Err(Error::MaxSigma(self.max_sigma_px));
        }
        if !(0.5..=128.0).contains(&self.min_gradient) {
            return Err(Error::MinGradient(self.min_gradient));
        }
        if !(0.3..=1.0).contains(&self.lsd_scale) {
            return Err(Error::LsdScale(self.lsd_scale));
        }
        Ok(())
    }

    /// The shortest segment kept in an image of this width, pixels.
    pub fn min_length_px(&self, image_width: u32) -> f32 {
        self.min_length_px.max(self.min_length_share * image_width as f32)
    }
}

/// A detector of the kind `config` asks for, if `config` is valid.
pub fn detector(config: LineDetectorConfig) -> Result<Box<dyn SegmentDetector>, LineDetectorConfigError> {
    config.validate()?;
    Ok(match config.kind {
        DetectorKind::EdgeDrawing => Box::new(ForSlam::new(config, EdgeDrawing::new(config.min_gradient))),
        DetectorKind::Lsd => Box::new(ForSlam::new(config, Lsd::new(config.lsd_scale))),
    })
}

/// A raw detector with its segments made fit for SLAM.
struct ForSlam<D> {
    config: LineDetectorConfig,
    raw: D,
    gradients: Gradients,
    refiner: Refiner,
    found: Vec<select::Ends>,
}

impl<D: RawDetector> ForSlam<D> {
    fn new(config: LineDetectorConfig, raw: D) -> Self {
        Self { config, raw, gradients: Gradients::default(), refiner: Refiner::default(), found: Vec::new() }
    }
}

impl<D: RawDetector> SegmentDetector for ForSlam<D> {
    fn detect(&mut self, image: &GrayImage) -> Vec<Segment> {
        self.gradients.compute(image);
        self.found.clear();
        self.raw.detect(image, &self.gradients, &mut self.found);

        let config = &self.config;
        let Some(frame) = Frame::inside(image.width(), image.height(), config.border_px) else {
            return Vec::new();
        };
        let min_length_px = config.min_length_px(image.width());
        select::clip_and_drop(&mut self.found, &frame, min_length_px);
        select::spread(&mut self.found, &frame, config.max_segments);
        let mut segments: Vec<Segment> = Vec::new();
        for ends in &self.found {
            if segments.len() == config.max_segments {
                break;
            }
            let Some(refined) = self.refiner.refine(&self.gradients, ends) else { continue };
            let refined = sharpen(&Sampler::new(image), &refined);
            let Some(segment) = frame.clip(&refined) else { continue };
            let is_line = segment.sigma_px <= config.max_sigma_px && segment.length() >= min_length_px;
            if is_line && !segments.iter().any(|kept| select::is_repeated(kept, &segment)) {
                segments.push(segment);
            }
        }
        segments.sort_by(|a, b| b.length().total_cmp(&a.length()));
        segments
    }
}

//! Frames through the engine.

use std::collections::BTreeMap;
use std::sync::Arc;

use geometry::{Camera, Pose};
use slam::map::{FrameRecord, MapUpdate};
use slam::{Frame, FrameReport, Map, MapEvent, NoClock, Pipeline, ResumeState, SlamConfig, Threading};
use synthetic::Sequence;
use vision::GrayImage;

/// Time between frames where a test does not say otherwise: 30 Hz.
pub const FRAME_INTERVAL_NS: i64 = 33_333_333;

/// A rendered image as the engine takes it.
pub fn gray_image(rendered: synthetic::GrayImage) -> GrayImage {
    let (width, height) = (rendered.width(), rendered.height());
    GrayImage::from_raw(width, height, rendered.into_pixels()).expect("a rendered image has its size")
}

/// The default configuration with all stages in turn on the caller's thread: the same each time.
pub fn inline(seed: u64) -> SlamConfig {
    SlamConfig { threading: Threading::Inline, seed, ..SlamConfig::default() }
}

/// A session under test, with what a store would keep of it.
pub struct Session {
    /// The engine.
    pub pipeline: Pipeline,
    /// The trajectory so far.
    pub records: BTreeMap<u64, FrameRecord>,
    /// What happened to the map, in order.
    pub events: Vec<MapEvent>,
    /// Whether an update said that the camera is another.
    pub is_correction_stored: bool,
    /// Whether an update said that images are enlarged for their border.
    pub is_enlarged_stored: bool,
}

impl Session {
    /// A session without a map.
    ///
    /// # Panics
    /// If the engine refuses the configuration.
    pub fn new(config: SlamConfig, camera: &Camera) -> Self {
        Self::resume(config, camera, ResumeState::default())
    }

    /// A session that goes on with a map.
    ///
    /// # Panics
    /// If the engine refuses the configuration or the map.
    pub fn resume(config: SlamConfig, camera: &Camera, state: ResumeState) -> Self {
        let pipeline = Pipeline::resume(config, camera.clone(), Arc::new(NoClock), state)
            .unwrap_or_else(|refused| panic!("{refused}"));
        Self {
            pipeline,
            records: BTreeMap::new(),
            events: Vec::new(),
            is_correction_stored: false,
            is_enlarged_stored: false,
        }
    }

    /// Shows the engine an image and takes what is to be stored.
    ///
    /// # Panics
    /// If the engine refuses the frame, or a map on the way is not consistent.
    pub fn show(&mut self, number: u64, timestamp_ns: i64, image: GrayImage) -> FrameReport {
        let frame = Frame { sequence: number, timestamp_ns, image };
        let report = self.pipeline.process_frame(frame).unwrap_or_else(|refused| panic!("{refused}"));
        self.events.extend(&report.map_events);
        let updates = self.pipeline.take_updates();
        self.store(updates);
        report
    }

    /// Shows frames of a sequence, each with its index as its number, at 30 Hz.
    ///
    /// # Panics
    /// As [`Session::show`].
    pub fn show_frames(
        &mut self,
        sequence: &Sequence,
        frames: impl IntoIterator<Item = usize>,
    ) -> Vec<FrameReport> {
        let show = |index: usize| {
            let image = gray_image(sequence.frame(index).image);
            self.show(index as u64, index as i64 * FRAME_INTERVAL_NS, image)
        };
        frames.into_iter().map(show).collect()
    }

    /// Ends the session and returns its map.
    ///
    /// # Panics
    /// If the map is not consistent.
    pub fn finish(&mut self) -> Arc<Map> {
        let updates = self.pipeline.finish();
        self.store(updates);
        let map = self.pipeline.map();
        map.check().unwrap_or_else(|wrong| panic!("{wrong}"));
        map
    }

    /// `world_from_camera` of every frame that has a pose in the map as it is now, by its number.
    pub fn trajectory(&self) -> BTreeMap<u64, Pose> {
        let map = self.pipeline.map();
        let located = |record: &FrameRecord| Some(map.locate(&record.pose?)?.1.inverse());
        self.records.iter().filter_map(|(number, record)| Some((*number, located(record)?))).collect()
    }

    fn store(&mut self, updates: Vec<MapUpdate>) {
        for update in updates {
            update.map.check().unwrap_or_else(|wrong| panic!("{wrong}"));
            self.is_correction_stored |= update.changes.correction;
            self.is_enlarged_stored |= update.changes.enlarged;
            self.records.extend(update.frames.iter().map(|record| (record.sequence, record.clone())));
        }
    }
}

//! Where lines are looked for: on the caller's thread, or beside the keypoints on a thread of their own.

use super::lines::LineFrontEnd;
use crate::clock::{Clock, Stopwatch};
use crate::cores;
use crate::features::LineFeature;
use geometry::Camera;
use geometry::nalgebra::UnitQuaternion;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use vision::GrayImage;
use vision::lines::LineTrackingStatistics;
use vision::mask::Clearance;

/// The stage's name in reports.
const STAGE: &str = "lines";

/// What was found in an image.
pub(super) type Extracted = (Vec<LineFeature>, LineTrackingStatistics);

/// Line extraction as the front end sees it.
pub(super) enum LineStage {
    Inline(Box<LineFrontEnd>),
    Background(LineThread),
}

/// One thread per session that looks for lines.
pub(super) struct LineThread {
    jobs: Option<SyncSender<Job>>,
    results: Receiver<(Extracted, u64)>,
    thread: Option<JoinHandle<()>>,
}

enum Job {
    SetCamera(Box<Camera>),
    SetClearance(Option<Arc<Clearance>>),
    Extract {
        image: Arc<GrayImage>,
        /// Rotation since the last image, as far as it is known.
        now_from_last: Option<UnitQuaternion<f64>>,
        clock: Arc<dyn Clock>,
    },
}

impl LineStage {
    pub fn inline(lines: LineFrontEnd) -> Self {
        Self::Inline(Box::new(lines))
    }

    /// # Errors
    /// If the thread cannot be started.
    pub fn background(mut lines: LineFrontEnd) -> std::io::Result<Self> {
        // One job at a time: the caller waits for each result before it sends the next image.
        let (jobs, incoming) = sync_channel::<Job>(1);
        let (found, results) = sync_channel(1);
        let thread = std::thread::Builder::new().name("slam-lines".into()).spawn(move || {
            for job in incoming {
                match job {
                    Job::SetCamera(camera) => lines.set_camera(&camera),
                    Job::SetClearance(clearance) => lines.set_clearance(clearance),
                    Job::Extract { image, now_from_last, clock } => {
                        let start_ns = clock.wall_ns();
                        let extracted = lines.extract(&image, now_from_last);
                        drop(image);
                        if found.send((extracted, clock.wall_ns().saturating_sub(start_ns))).is_err() {
                            return;
                        }
                    }
                }
            }
        })?;
        Ok(Self::Background(LineThread { jobs: Some(jobs), results, thread: Some(thread) }))
    }

    pub fn set_camera(&mut self, camera: &Camera) {
        match self {
            Self::Inline(lines) => lines.set_camera(camera),
            Self::Background(thread) => thread.send(Job::SetCamera(Box::new(camera.clone()))),
        }
    }

    /// Keeps segments clear of what is left out of the images.
    pub fn set_clearance(&mut self, clearance: Option<Arc<Clearance>>) {
        match self {
            Self::Inline(lines) => lines.set_clearance(clearance),
            Self::Background(thread) => thread.send(Job::SetClearance(clearance)),
        }
    }

    /// Looks for lines while `meanwhile` runs on the caller's thread as a stage of the given name; one after
    /// the other where all is inline.
    pub fn extract_beside<T>(
        &mut self,
        image: &Arc<GrayImage>,
        now_from_last: Option<UnitQuaternion<f64>>,
        stopwatch: &mut Stopwatch,
        (name, meanwhile): (&'static str, impl FnOnce() -> T),
    ) -> (T, Extracted) {
        match self {
            Self::Inline(lines) => {
                let result = stopwatch.time(name, meanwhile);
                (result, stopwatch.time(STAGE, || lines.extract(image, now_from_last)))
            }
            Self::Background(thread) => {
                let clock = stopwatch.clock().clone();
                let job = Job::Extract { image: image.clone(), now_from_last, clock };
                // Where others wait for a core, this frame takes one and not two.
                let (before, after) = if cores::are_wanted() { (None, Some(job)) } else { (Some(job), None) };
                before.into_iter().for_each(|job| thread.send(job));
                let result = stopwatch.time(name, meanwhile);
                after.into_iter().for_each(|job| thread.send(job));
                let (extracted, wall_ns) = thread.receive();
                stopwatch.add(STAGE, wall_ns);
                stopwatch.restart_lap();
                (result, extracted)
            }
        }
    }
}

impl LineThread {
    fn send(&mut self, job: Job) {
        if self.jobs.as_ref().is_none_or(|jobs| jobs.send(job).is_err()) {
            self.pass_on_panic();
        }
    }

    fn receive(&mut self) -> (Extracted, u64) {
        match self.results.recv() {
            Ok(result) => result,
            Err(_) => self.pass_on_panic(),
        }
    }

    /// The thread ends early only by a panic, which is a defect and must not pass unnoticed.
    fn pass_on_panic(&mut self) -> ! {
        match self.thread.take().map(JoinHandle::join) {
            Some(Err(panic)) => std::panic::resume_unwind(panic),
            _ => panic!("the thread that looks for lines has ended"),
        }
    }
}

impl Drop for LineThread {
    fn drop(&mut self) {
        // A closed channel is the stop signal.
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

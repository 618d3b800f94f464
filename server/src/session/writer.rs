//! Saves a map's updates, one transaction each, beside tracking.
//!
//! Tracking hands an update over under a short lock and goes on. Updates that follow within half a second, or
//! while a transaction runs, are merged into one: most landmarks of a keyframe move again with the next, and
//! a slow disk makes transactions larger, never the queue longer. Whoever waits for the disk is not kept
//! waiting. A deterministic session is saved update by update, so that what its database holds does not
//! depend on time; it waits for the disk instead.

use super::frame::SentImage;
use super::images::to_file;
use super::updates::{Bounds, Update, Updates};
use crate::config::SessionConfig;
use crate::error::{ApiError, ErrorCode};
use slam::MapUpdate;
use slam::map::{CameraId, KeyframeId};
use std::collections::BTreeMap;
use std::future::Future;
use std::sync::Arc;
use std::time::{Duration, Instant};
use store::KeyframeImage;
use tokio::sync::watch;

/// Updates a deterministic session may be ahead of the disk before it waits. Others merge into one.
const MAX_UPDATES_AHEAD: usize = 16;
/// Bytes of keyframes' images that wait to be saved, at most; further ones are left out with a warning.
/// Poses and landmarks are never left out.
const MAX_WAITING_IMAGE_BYTES: usize = 128 << 20;

/// Where updates are saved.
pub trait Sink: Send + Sync + 'static {
    /// Saves an update with images of keyframes as one transaction: all of it or nothing.
    fn commit(
        &self,
        update: &MapUpdate,
        images: &[KeyframeImage],
    ) -> impl Future<Output = Result<(), ApiError>> + Send;
}

/// What is saved so far.
#[derive(Clone, Debug, Default)]
pub struct Saved {
    /// Of each camera with frames among them, every frame up to this one is saved.
    pub durable_sequences: BTreeMap<CameraId, u64>,
    /// Updates saved since the writer started.
    pub n_updates: u64,
    /// Attempts to save since the writer started.
    pub n_attempts: u64,
    /// Why the last attempt failed, if it did. It is repeated until it succeeds.
    pub failure: Option<ApiError>,
}

/// The tracking threads' end of the writer. When it is dropped, the writer ends as if it was closed.
#[derive(Debug)]
pub struct Outbox {
    updates: Arc<Updates<Batch>>,
    saved: watch::Receiver<Saved>,
}

/// What is saved in one transaction.
#[derive(Debug)]
struct Batch {
    update: MapUpdate,
    images: Vec<(KeyframeId, SentImage)>,
}

impl Update for Batch {
    fn join(&mut self, later: Self) {
        self.update.merge(later.update);
        self.images.extend(later.images);
    }

    fn ballast_bytes(&self) -> usize {
        self.images.iter().map(|(_, image)| image.data.len()).sum()
    }

    fn drop_ballast(&mut self) {
        self.images.clear();
    }
}

/// When updates are saved.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// Each in a transaction of its own, and at once.
    pub one_by_one: bool,
    /// Least time from the beginning of one transaction to that of the next.
    pub interval: Duration,
    /// Time to the next attempt after one failed.
    pub retry_after: Duration,
}

impl Pace {
    /// As configured; a deterministic session is saved one by one.
    pub fn of(config: &SessionConfig, is_deterministic: bool) -> Self {
        Self {
            one_by_one: is_deterministic,
            interval: Duration::from_secs_f64(config.save_interval_s),
            retry_after: Duration::from_secs_f64(config.save_retry_s),
        }
    }
}

/// Starts the task that saves. It ends when the [`Outbox`] was closed and everything is saved or was tried
/// once more.
pub fn start(sink: impl Sink, pace: Pace) -> (Outbox, tokio::task::JoinHandle<()>) {
    let bounds = Bounds {
        one_by_one: pace.one_by_one,
        max_ahead: MAX_UPDATES_AHEAD,
        max_ballast_bytes: MAX_WAITING_IMAGE_BYTES,
    };
    let updates = Arc::new(Updates::new(bounds));
    let (saved, saved_receiver) = watch::channel(Saved::default());
    let task = tokio::spawn(save_all(EndOnDrop(updates.clone()), sink, saved, pace));
    (Outbox { updates, saved: saved_receiver }, task)
}

impl Outbox {
    /// Hands an update over. Returns at once, save in a deterministic session that is far ahead of a working
    /// disk.
    pub fn push(&self, update: MapUpdate, images: Vec<(KeyframeId, SentImage)>) {
        let n_images = images.len();
        if self.updates.push(Batch { update, images }) {
            tracing::warn!(n_images, "images of keyframes are left out: saving is too far behind");
        }
    }

    /// Every frame of a camera up to this one is saved; `None` if none was since the writer started.
    pub fn durable_sequence(&self, camera: CameraId) -> Option<u64> {
        self.saved.borrow().durable_sequences.get(&camera).copied()
    }

    /// Why saving fails at present, if it does. Not while only images cannot be brought to the object store:
    /// frames go on, `durable_sequence` stands still, and images beyond those that may wait are left out.
    pub fn failure(&self) -> Option<ApiError> {
        let failure = self.saved.borrow().failure.clone();
        let failure = failure.filter(|failure| failure.code != ErrorCode::ObjectsFailed);
        failure.or_else(|| self.saved.has_changed().is_err().then(ended_early))
    }

    /// Whether everything handed over is saved.
    pub fn is_idle(&self) -> bool {
        let n_updates = self.updates.n_pushed();
        self.saved.borrow().n_updates >= n_updates
    }

    /// Waits until everything handed over so far is saved, with a new attempt if the last one failed.
    ///
    /// # Errors
    /// Why it could not be saved. It is kept and tried again.
    pub async fn flush(&self) -> Result<(), ApiError> {
        let n_updates = self.updates.n_pushed();
        let mut saved = self.saved.clone();
        let n_attempts = saved.borrow_and_update().n_attempts;
        self.updates.hurry();
        let finished = saved.wait_for(|saved| {
            saved.n_updates >= n_updates || (saved.failure.is_some() && saved.n_attempts > n_attempts)
        });
        match finished.await {
            Ok(saved) if saved.n_updates >= n_updates => Ok(()),
            Ok(saved) => Err(saved.failure.clone().unwrap_or_else(ended_early)),
            Err(_ended) => Err(ended_early()),
        }
    }

    /// Waits until nothing more is saved, whatever is handed over.
    pub async fn ended(&self) {
        let mut saved = self.saved.clone();
        // An error is what is waited for: the writer has dropped its end.
        let _ = saved.wait_for(|_| false).await;
    }

    /// Lets the writer end once it is through with what it has.
    pub fn close(&self) {
        self.updates.close();
    }
}

impl Drop for Outbox {
    fn drop(&mut self) {
        self.close();
    }
}

fn ended_early() -> ApiError {
    ApiError::internal("the writer has ended early")
}

/// Tells whoever hands updates over when nothing is saved any more, however that comes.
struct EndOnDrop(Arc<Updates<Batch>>);

impl Drop for EndOnDrop {
    fn drop(&mut self) {
        self.0.end();
    }
}

async fn save_all(updates: EndOnDrop, sink: impl Sink, saved: watch::Sender<Saved>, pace: Pace) {
    let EndOnDrop(updates) = &updates;
    while let Some(batch) = updates.next().await {
        let began = tokio::time::Instant::now();
        match save(&sink, &batch.update).await {
            Ok(()) => {
                updates.saved();
                saved.send_modify(|saved| {
                    for frame in &batch.update.update.frames {
                        let last = saved.durable_sequences.entry(frame.camera).or_default();
                        *last = (*last).max(frame.sequence);
                    }
                    saved.n_updates = batch.last_number;
                    saved.n_attempts += 1;
                    saved.failure = None;
                });
                if !pace.one_by_one {
                    let _ = tokio::time::timeout_at(began + pace.interval, updates.hurried()).await;
                }
            }
            Err(error) => {
                let is_last_attempt = batch.is_last_attempt;
                updates.put_back(batch);
                if saved.borrow().failure.is_none() {
                    tracing::error!(error = %error, "saving failed and will be tried again: {error}");
                }
                saved.send_modify(|saved| {
                    saved.n_attempts += 1;
                    saved.failure = Some(error);
                });
                if is_last_attempt {
                    return;
                }
                let _ = tokio::time::timeout(pace.retry_after, updates.woken()).await;
            }
        }
    }
}

async fn save(sink: &impl Sink, batch: &Batch) -> Result<(), ApiError> {
    let images = batch.images.clone();
    let encode = move || images.iter().filter_map(|(keyframe, image)| to_file(*keyframe, image)).collect();
    let files: Vec<_> = tokio::task::spawn_blocking(encode).await.map_err(ApiError::internal)?;
    let start = Instant::now();
    let outcome = sink.commit(&batch.update, &files).await;
    metrics::histogram!("monoslam_commit_seconds").record(start.elapsed().as_secs_f64());
    let label = if outcome.is_ok() { "ok" } else { "failed" };
    metrics::counter!("monoslam_commits_total", "outcome" => label).increment(1);
    outcome
}

#[cfg(test)]
mod tests {
    use super::*;
    use slam::Map;
    use slam::map::{FrameRecord, FrameState, MapChanges};
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicBool, Ordering};
    use tokio::sync::Notify;

    /// Remembers the sequences of each transaction; fails or waits on demand.
    #[derive(Clone, Default)]
    struct FakeSink(Arc<Fake>);

    #[derive(Default)]
    struct Fake {
        transactions: Mutex<Vec<Vec<u64>>>,
        full: AtomicBool,
        away: AtomicBool,
        slow: AtomicBool,
        go: Notify,
    }

    impl Sink for FakeSink {
        async fn commit(&self, update: &MapUpdate, _: &[KeyframeImage]) -> Result<(), ApiError> {
            if self.0.slow.load(Ordering::SeqCst) {
                self.0.go.notified().await;
            }
            if self.0.full.load(Ordering::SeqCst) {
                return Err(ApiError::new(ErrorCode::StorageFull, "full"));
            }
            if self.0.away.load(Ordering::SeqCst) {
                return Err(ApiError::new(ErrorCode::ObjectsFailed, "away"));
            }
            let sequences = update.frames.iter().map(|frame| frame.sequence).collect();
            self.0.transactions.lock().unwrap().push(sequences);
            Ok(())
        }
    }

    fn update(sequence: u64) -> MapUpdate {
        let frame = FrameRecord {
            camera: CameraId::default(),
            sequence,
            timestamp_ns: sequence as i64,
            state: FrameState::Initialising,
            pose: None,
            backfilled: false,
            reason: "the camera has not moved enough yet".to_owned(),
        };
        MapUpdate { map: Arc::new(Map::default()), changes: MapChanges::default(), frames: vec![frame] }
    }

    /// Too long for any test to wait for a second transaction: what is to be saved has to be hurried.
    const JOINED: Pace = Pace {
        one_by_one: false,
        interval: Duration::from_secs(3600),
        retry_after: Duration::from_millis(10),
    };
    const ONE_BY_ONE: Pace = Pace { one_by_one: true, ..JOINED };

    #[tokio::test]
    async fn updates_that_come_during_a_transaction_become_one() {
        let sink = FakeSink::default();
        sink.0.slow.store(true, Ordering::SeqCst);
        let (outbox, _task) = start(sink.clone(), JOINED);
        outbox.push(update(0), Vec::new());
        tokio::time::sleep(Duration::from_millis(20)).await;
        (1..5).for_each(|sequence| outbox.push(update(sequence), Vec::new()));
        sink.0.slow.store(false, Ordering::SeqCst);
        sink.0.go.notify_one();
        outbox.flush().await.unwrap();
        assert_eq!(*sink.0.transactions.lock().unwrap(), [vec![0], vec![1, 2, 3, 4]]);
        assert_eq!(outbox.durable_sequence(CameraId::default()), Some(4));
    }

    #[tokio::test]
    async fn updates_that_follow_within_the_interval_become_one() {
        let sink = FakeSink::default();
        let pace = Pace { interval: Duration::from_millis(300), ..JOINED };
        let (outbox, _task) = start(sink.clone(), pace);
        let begun = Instant::now();
        while outbox.durable_sequence(CameraId::default()).is_none_or(|sequence| sequence < 20) {
            let sequence = begun.elapsed().as_millis() as u64 / 20;
            outbox.push(update(sequence), Vec::new());
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        let n_intervals = begun.elapsed().as_millis() / 300;
        let transactions = sink.0.transactions.lock().unwrap();
        assert!(transactions.len() as u128 <= n_intervals + 1, "{transactions:?} in {n_intervals} intervals");
        assert_eq!(transactions[0].len(), 1, "the first waits for nothing");
    }

    #[tokio::test]
    async fn a_deterministic_session_is_saved_update_by_update() {
        let sink = FakeSink::default();
        let (outbox, _task) = start(sink.clone(), ONE_BY_ONE);
        (0..5).for_each(|sequence| outbox.push(update(sequence), Vec::new()));
        outbox.flush().await.unwrap();
        assert_eq!(*sink.0.transactions.lock().unwrap(), [[0], [1], [2], [3], [4]]);
    }

    #[tokio::test]
    async fn nothing_is_lost_while_the_disk_is_full() {
        let sink = FakeSink::default();
        sink.0.full.store(true, Ordering::SeqCst);
        let (outbox, task) = start(sink.clone(), JOINED);
        outbox.push(update(7), Vec::new());
        let error = outbox.flush().await.unwrap_err();
        assert_eq!(error.code, ErrorCode::StorageFull);
        assert_eq!(outbox.durable_sequence(CameraId::default()), None);
        outbox.push(update(8), Vec::new());
        sink.0.full.store(false, Ordering::SeqCst);
        outbox.flush().await.unwrap();
        assert_eq!(sink.0.transactions.lock().unwrap().concat(), [7, 8]);
        assert!(outbox.failure().is_none());
        outbox.close();
        tokio::time::timeout(Duration::from_secs(5), task).await.unwrap().unwrap();
    }

    #[tokio::test]
    async fn frames_go_on_while_only_the_object_store_is_away() {
        let sink = FakeSink::default();
        sink.0.away.store(true, Ordering::SeqCst);
        let (outbox, _task) = start(sink.clone(), JOINED);
        outbox.push(update(7), Vec::new());
        assert_eq!(outbox.flush().await.unwrap_err().code, ErrorCode::ObjectsFailed);
        assert!(outbox.failure().is_none());
        assert_eq!(outbox.durable_sequence(CameraId::default()), None);
        sink.0.away.store(false, Ordering::SeqCst);
        outbox.flush().await.unwrap();
        assert_eq!(outbox.durable_sequence(CameraId::default()), Some(7));
    }

    /// The disk's driver is broken in a way that nobody expected.
    struct Broken;

    impl Sink for Broken {
        async fn commit(&self, _: &MapUpdate, _: &[KeyframeImage]) -> Result<(), ApiError> {
            panic!("broken for the test")
        }
    }

    #[tokio::test]
    async fn a_deterministic_session_does_not_wait_for_a_writer_that_is_dead() {
        let (outbox, task) = start(Broken, ONE_BY_ONE);
        let push_all = move || {
            (0..2 * MAX_UPDATES_AHEAD as u64).for_each(|sequence| outbox.push(update(sequence), Vec::new()));
            outbox
        };
        let pushed = tokio::task::spawn_blocking(push_all);
        let outbox = tokio::time::timeout(Duration::from_secs(5), pushed).await.expect("it waits").unwrap();
        assert!(task.await.unwrap_err().is_panic());
        outbox.ended().await;
        assert_eq!(outbox.failure().unwrap().code, ErrorCode::Internal);
        assert!(outbox.flush().await.is_err() && !outbox.is_idle());
    }

    #[tokio::test]
    async fn a_writer_ends_when_its_outbox_is_dropped() {
        let sink = FakeSink::default();
        let (outbox, task) = start(sink.clone(), JOINED);
        outbox.push(update(0), Vec::new());
        drop(outbox);
        tokio::time::timeout(Duration::from_secs(5), task).await.expect("it goes on").unwrap();
        assert_eq!(*sink.0.transactions.lock().unwrap(), [[0]]);
    }
}

//! Index, calibration and ground truth of a recording, and calibrations and trajectories of other programs:
//! any text is taken or refused with a reason, never with a panic.

#![no_main]

use libfuzzer_sys::fuzz_target;
use recordings::{
    EvaluationOptions, Layout, OpenOptions, Playback, Recording, Trajectory, evaluate, find_offset, read_calibration,
    read_times,
};
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::OnceLock;
use tempfile::TempDir;

/// Separates the files of an input: it is in no UTF-8 text.
const SEPARATOR: u8 = 0xff;

/// The files of each layout that an input fills in turn: index, calibration, ground truth.
fn files(layout: Layout) -> [&'static str; 3] {
    match layout {
        Layout::Folder => ["rgb.txt", "calib.json", "groundtruth.txt"],
        Layout::Euroc => {
            ["mav0/cam0/data.csv", "mav0/cam0/sensor.yaml", "mav0/state_groundtruth_estimate0/data.csv"]
        }
        Layout::Kitti => ["times.txt", "calib.txt", "poses.txt"],
        Layout::Tum => ["rgb.txt", "unused.txt", "groundtruth.txt"],
        Layout::Icl => ["associations.txt", "unused.txt", "scene.gt.freiburg"],
        Layout::SevenScenes => ["frame-000000.pose.txt", "calibration.yaml", "groundtruth.txt"],
        Layout::ScanNet => ["pose/0.txt", "intrinsic/intrinsic_color.txt", "groundtruth.txt"],
        Layout::Pictures => ["cameras.txt", "calib.json", "groundtruth.txt"],
    }
}

/// A folder for each layout with images that the index may name, made once.
fn folders() -> &'static [TempDir; 8] {
    static FOLDERS: OnceLock<[TempDir; 8]> = OnceLock::new();
    FOLDERS.get_or_init(|| {
        Layout::ALL.map(|layout| {
            let folder = tempfile::Builder::new().prefix("freiburg1-").tempdir().expect("a temporary folder");
            for name in ["0.png", "1.png", "2.png", "000000.png", "000001.png", "frame-000000.color.png"] {
                for place in [
                    "",
                    "rgb",
                    "color",
                    "pose",
                    "intrinsic",
                    "image_0",
                    "mav0/cam0/data",
                    "mav0/state_groundtruth_estimate0",
                ] {
                    let place = folder.path().join(place);
                    std::fs::create_dir_all(&place).expect("a folder");
                    let size = if layout == Layout::Kitti { (32, 24) } else { (640, 480) };
                    std::fs::write(place.join(name), png_head(size)).expect("an image");
                }
            }
            folder
        })
    })
}

/// As much of a PNG file as tells its size; more is not read.
fn png_head((width, height): (u32, u32)) -> Vec<u8> {
    let mut head = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
    head.extend(width.to_be_bytes());
    head.extend(height.to_be_bytes());
    head.extend([8, 0, 0, 0, 0]);
    head
}

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, text)) = bytes.split_first() else { return };
    let layout_idx = usize::from(*kind & 0x3f) % Layout::ALL.len();
    let (layout, folder) = (Layout::ALL[layout_idx], folders()[layout_idx].path());
    let mut parts = text.split(|byte| *byte == SEPARATOR);
    for name in files(layout) {
        match parts.next() {
            Some(part) => std::fs::write(folder.join(name), part).expect("a file"),
            None => drop(std::fs::remove_file(folder.join(name))),
        }
    }
    // Tried first: what it says goes for the recording.
    for name in files(layout) {
        let path = folder.join(name);
        if let (Ok(read), Ok(again)) = (Trajectory::read_as(&path, None), Trajectory::read_as(&path, None)) {
            assert_eq!(read.trajectory.len(), again.trajectory.len());
            let _ = find_offset(&read.trajectory, &again.trajectory);
        }
        for refused in [read_calibration(&path).err(), read_times(&path).err()].into_iter().flatten() {
            assert!(!refused.to_string().is_empty());
        }
    }
    let (sort, skip_bad) = (kind & 0x40 != 0, kind & 0x80 != 0);
    open(folder, &OpenOptions { layout: Some(layout), fps: Some(30.0), sort, skip_bad, ..OpenOptions::default() });
});

fn open(folder: &Path, options: &OpenOptions<'_>) {
    match Recording::open_with(folder, options) {
        Err(error) => assert!(!error.to_string().is_empty()),
        Ok(recording) => {
            assert!(recording.frames.is_sorted_by(|a, b| a.timestamp_ns < b.timestamp_ns));
            if let Some(truth) = &recording.ground_truth {
                let _ = evaluate(truth, truth, &EvaluationOptions::default());
            }
            let every = NonZeroUsize::new(2).expect("two is not zero");
            let _ = recording.played(&Playback { backwards: true, every, ..Playback::default() });
        }
    }
}

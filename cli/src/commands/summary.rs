//! The summary of a stream, for people.

use client::{CameraFinding, Distribution, StreamSummary};

/// A table of what became of the frames, what the session holds, and where the time went.
pub fn table(s: &StreamSummary) -> String {
    let mut text = String::new();
    let mut row = |name: &str, value: String| text.push_str(&format!("{name:<26} {value}\n"));
    row("session", s.session.clone());
    row(
        "frames",
        format!(
            "{}: {} tracked, {} weak, {} initialising, {} lost",
            s.frames, s.tracked, s.weak, s.initialising, s.lost
        ),
    );
    if s.dropped + s.rejected + s.repeated > 0 {
        row(
            "not tracked",
            format!("{} dropped, {} rejected, {} known already", s.dropped, s.rejected, s.repeated),
        );
    }
    row("coverage as they came", format!("{:.1} %", 100.0 * s.coverage));
    row(
        "map",
        format!(
            "{} keyframes, {} points, {} lines, {} primitives, {} submaps",
            s.keyframes, s.points, s.lines, s.primitives, s.submaps
        ),
    );
    row("ms per frame, wall", median_and_p95(s.wall_ms));
    row("ms per frame, tracking CPU", median_and_p95(s.tracking_cpu_ms));
    for stage in &s.stages {
        row(&format!("  {}", stage.name), median_and_p95(Some(stage.ms)));
    }
    row(
        "speed",
        format!(
            "{:.1} s, {:.1} frames/s, {:.2} x real time",
            s.elapsed_s, s.frames_per_second, s.realtime_factor
        ),
    );
    if s.reconnects > 0 {
        row("reconnects", s.reconnects.to_string());
    }
    if let Some(found) = &s.camera {
        row("calibration", camera_sentence(found));
    }
    text
}

/// What was found out about the camera, for whoever can act on it.
fn camera_sentence(found: &CameraFinding) -> String {
    let CameraFinding { focal, center_x, center_y, adopted } = found;
    let [focal, right, down] = [focal, center_x, center_y].map(|share| 100.0 * share);
    let camera = format!(
        "focal length {focal:+.1} %, principal point {right:+.1} % of it to the right and {down:+.1} % down"
    );
    if *adopted {
        format!("put right: {camera}")
    } else {
        format!(
            "contradicted by the images, which would fit {camera}: used as given. Were they resized or cropped, or is the \
             lens described wrongly?"
        )
    }
}

/// `median (p95 …)`.
fn median_and_p95(distribution: Option<Distribution>) -> String {
    distribution.map_or("-".to_owned(), |d| format!("{:.2} (95 %: {:.2})", d.median, d.p95))
}

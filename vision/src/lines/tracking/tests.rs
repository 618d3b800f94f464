use nalgebra::{Matrix3, Vector2};

use super::*;
use crate::lines::test_scenes::{Scene, apply, similarity};
use crate::test_images::{Random, noise};

const SIZE: (u32, u32) = (320, 240);
const CENTER: Vector2<f32> = Vector2::new(160.0, 120.0);

fn tracker() -> LineTracker {
    LineTracker::new(LineTrackerConfig::default()).unwrap()
}

/// What every frame must obey, whatever goes in.
fn check(tracked: &TrackedLines, n_last: usize, image: &GrayImage, config: &LineTrackerConfig) {
    let s = &tracked.statistics;
    let n_continued = s.n_by_flow + s.n_by_descriptor + s.n_by_merging + s.n_flow_only;
    assert_eq!(tracked.lines.len(), n_continued + s.n_new, "{s:?}");
    assert_eq!(n_last, n_continued + s.lost.total(), "{s:?}");
    assert!(tracked.lines.len() <= config.max_lines);
    assert!(tracked.lines.windows(2).all(|pair| pair[0].track < pair[1].track));
    let frame = Frame::of_image(image.width(), image.height()).grown(1e-3);
    for line in &tracked.lines {
        assert!(line.segment.is_finite() && line.segment.sigma_px > 0.0);
        assert!(frame.contains(&line.segment.start) && frame.contains(&line.segment.end), "{line:?}");
        assert!(line.segment.length() >= config.min_length_px * 0.99, "{line:?}");
        assert!(line.age >= 1);
    }
}

/// A detector of known quality: ends move by up to a pixel along, lines by 0.2 px across, and a share is
/// missed.
fn detect(scene: &Scene, view: &Matrix3<f32>, missed: f32, random: &mut Random) -> Vec<(usize, Segment)> {
    let mut detected = scene.segments(SIZE, view);
    detected.retain_mut(|(_, segment)| {
        let mut noise = |amplitude: f32| amplitude * (2.0 * random.unit() - 1.0);
        let (along, across) = (segment.direction(), segment.normal());
        segment.start += along * noise(1.0) + across * noise(0.2);
        segment.end += along * noise(1.0) + across * noise(0.2);
        noise(1.0) >= 2.0 * missed - 1.0
    });
    detected
}

/// The edge nearest to a line: its number and the distance of the line's ends from it, pixels.
fn nearest_edge(edges: &[(usize, Segment)], line: &Segment) -> Option<(usize, f32)> {
    let overlaps = |edge: &Segment| {
        let along = edge.direction().dot(&(line.midpoint() - edge.start));
        edge.direction().dot(&line.direction()) > 0.9 && (-3.0..edge.length() + 3.0).contains(&along)
    };
    let distance = |edge: &Segment| edge.distance(&line.start).abs().max(edge.distance(&line.end).abs());
    edges
        .iter()
        .filter(|(_, edge)| overlaps(edge))
        .map(|(number, edge)| (*number, distance(edge)))
        .min_by(|a, b| a.1.total_cmp(&b.1))
}

/// A camera that turns, shifts and comes nearer.
fn view(frame: u32) -> Matrix3<f32> {
    let t = frame as f32;
    similarity(CENTER, 1.0 + 0.004 * t, 0.4 * t, Vector2::new(2.5 * t, -1.2 * t))
}

/// Where a pixel of frame `from` is in the one after it.
fn motion(from: u32) -> impl Fn(Vector2<f32>) -> Vector2<f32> {
    let next_from_last = view(from + 1) * view(from).try_inverse().unwrap();
    move |pixel| apply(&next_from_last, pixel)
}

#[test]
fn lines_of_a_moving_scene_keep_their_tracks() {
    let scene = Scene::new(SIZE.0, SIZE.1, 1);
    let mut random = Random::new(2);
    let mut tracker = tracker();
    let config = *tracker.config();
    let mut n_last = 0;
    let mut edge_of_track = std::collections::BTreeMap::new();
    let (mut n_lines, mut n_switched, mut n_wrong) = (0, 0, 0);
    let mut last = TrackedLines::default();
    for frame in 0..20 {
        let (image, edges) = (scene.render(SIZE, &view(frame), 1.0, 0.0), scene.segments(SIZE, &view(frame)));
        let detected = detect(&scene, &view(frame), 0.1, &mut random);
        let detected: Vec<Segment> = detected.into_iter().map(|(_, segment)| segment).collect();
        let tracked = tracker.track(&image, detected, None);
        check(&tracked, n_last, &image, &config);
        println!("{frame}: {:?}", tracked.statistics);
        n_last = tracked.lines.len();
        for line in &tracked.lines {
            n_lines += 1;
            match nearest_edge(&edges, &line.segment) {
                Some((edge, distance)) if distance < 1.5 => {
                    let first = *edge_of_track.entry(line.track).or_insert(edge);
                    n_switched += usize::from(first != edge);
                }
                _ => n_wrong += 1,
            }
        }
        last = tracked;
    }
    let n_old = last.lines.iter().filter(|line| line.age >= 18).count();
    println!(
        "{n_lines} lines, {n_switched} on another edge, {n_wrong} on none; {n_old} of {n_last} seen 18 times"
    );
    assert!(n_last >= 25, "{n_last} lines");
    assert!(3 * n_old >= n_last, "{n_old} of {n_last} are old");
    assert!(n_switched * 100 <= n_lines, "{n_switched} of {n_lines} switched");
    assert!(n_wrong * 50 <= n_lines, "{n_wrong} of {n_lines} wrong");
}

#[test]
fn a_prior_carries_lines_through_fast_motion() {
    let scene = Scene::new(SIZE.0, SIZE.1, 3);
    let shift = similarity(CENTER, 1.0, 4.0, Vector2::new(38.0, 21.0));
    let prior = |pixel: Vector2<f32>| apply(&shift, pixel);
    let first = scene.segments(SIZE, &Matrix3::identity());
    let segments: Vec<Segment> = first.iter().map(|(_, segment)| *segment).collect();
    let mut tracker = tracker();
    let n_first =
        tracker.track(&scene.render(SIZE, &Matrix3::identity(), 1.0, 0.0), segments, None).lines.len();
    // Nothing is detected in the second image: flow alone must find the lines.
    let image = scene.render(SIZE, &shift, 1.0, 0.0);
    let tracked = tracker.track(&image, Vec::new(), Some(&prior));
    check(&tracked, n_first, &image, tracker.config());
    let edges = scene.segments(SIZE, &shift);
    let right = |line: &&TrackedLine| nearest_edge(&edges, &line.segment).is_some_and(|(_, d)| d < 0.7);
    let n_right = tracked.lines.iter().filter(right).count();
    println!("{n_right} of {} of {n_first}: {:?}", tracked.lines.len(), tracked.statistics);
    assert!(n_right * 20 >= tracked.lines.len() * 19);
    assert!(n_right * 10 >= n_first * 6, "{n_right} of {n_first}: {:?}", tracked.statistics);
    assert!(tracked.lines.iter().all(|line| line.origin == LineOrigin::Flowed && line.age == 2));
}

#[test]
fn lines_without_detections_live_a_few_frames() {
    let scene = Scene::new(SIZE.0, SIZE.1, 4);
    let image = scene.render(SIZE, &Matrix3::identity(), 1.0, 0.0);
    let segments: Vec<Segment> =
        scene.segments(SIZE, &Matrix3::identity()).into_iter().map(|(_, segment)| segment).collect();
    let mut tracker = tracker();
    let first = tracker.track(&image, segments.clone(), None);
    for _ in 0..tracker.config().max_flow_only_frames {
        let tracked = tracker.track(&image, Vec::new(), None);
        assert!(tracked.statistics.n_flow_only * 10 >= first.lines.len() * 9, "{:?}", tracked.statistics);
        assert!(tracked.lines.iter().all(|line| line.segment.sigma_px >= 1.5 * 0.3));
    }
    let tracked = tracker.track(&image, Vec::new(), None);
    assert!(tracked.lines.is_empty() && tracked.statistics.lost.undetected_too_long > 0);
    // New lines get new numbers.
    let again = tracker.track(&image, segments, None);
    let highest = first.lines.last().unwrap().track;
    assert!(!again.lines.is_empty() && again.lines.iter().all(|line| line.track > highest && line.age == 1));
}

#[test]
fn pieces_become_one_line_again() {
    // One long edge, always detected in two pieces after the first frame.
    let image = GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| if 2 * y + x / 8 > 240 { 170 } else { 80 });
    let whole = Segment {
        start: Vector2::new(30.0, 119.5 - 30.0 / 16.0),
        end: Vector2::new(290.0, 119.5 - 290.0 / 16.0),
        sigma_px: 0.3,
        gradient: 30.0,
    };
    let at = |share: f32| whole.start + whole.vector() * share;
    let pieces = vec![Segment { end: at(0.45), ..whole }, Segment { start: at(0.6), ..whole }];
    let mut tracker = tracker();
    let first = tracker.track(&image, vec![whole], None);
    assert_eq!(first.lines.len(), 1);
    for age in 2..10 {
        let tracked = tracker.track(&image, pieces.clone(), None);
        assert_eq!(tracked.lines.len(), 1, "{:?}", tracked.statistics);
        let line = &tracked.lines[0];
        assert_eq!((line.track, line.age, line.origin), (first.lines[0].track, age, LineOrigin::Merged));
        assert!((line.segment.length() - whole.length()).abs() < 8.0, "{}", line.segment.length());
    }
}

#[test]
fn lines_that_leave_the_image_come_back_as_themselves() {
    // A long edge, steep enough to be seen moving, shifted out to the left and back.
    let render = |shift: f32| {
        GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| {
            let side = (y as f32 - 100.0) - 0.5 * (x as f32 + shift - 100.0);
            (125.0 + 45.0 * (side / 0.9).clamp(-1.0, 1.0)) as u8
        })
    };
    let edge = |shift: f32| Segment {
        start: Vector2::new(40.0 - shift, 70.0),
        end: Vector2::new(200.0 - shift, 150.0),
        sigma_px: 0.3,
        gradient: 40.0,
    };
    let frame = Frame::of_image(SIZE.0, SIZE.1);
    let mut tracker = tracker();
    let mut last_shift = 0.0;
    let mut lengths = Vec::new();
    for step in [0, 1, 2, 3, 4, 5, 6, 7, 6, 5, 4, 3, 2, 1, 0] {
        let shift = 14.0 * step as f32;
        let moved = shift - last_shift;
        let prior = |pixel: Vector2<f32>| pixel - Vector2::new(moved, 0.0);
        // Detected only in the first frame and every third one.
        let visible = frame.clip(&edge(shift)).unwrap();
        let detected = if lengths.len() % 3 == 0 { vec![visible] } else { Vec::new() };
        let tracked = tracker.track(&render(shift), detected, Some(&prior));
        assert_eq!(tracked.lines.len(), 1, "{shift}: {:?}", tracked.statistics);
        assert_eq!(tracked.lines[0].track, 0);
        assert!(frame.grown(0.01).contains(&tracked.lines[0].segment.start));
        lengths.push((tracked.lines[0].segment.length(), visible.length()));
        last_shift = shift;
    }
    println!("{lengths:?}");
    assert!(lengths.iter().all(|(tracked, true_length)| *tracked > true_length - 8.0), "{lengths:?}");
}

#[test]
fn anything_may_go_in() {
    let mut random = Random::new(9);
    let mut tracker = tracker();
    let config = *tracker.config();
    let nan_prior = |_: Vector2<f32>| Vector2::new(f32::NAN, f32::INFINITY);
    let wild_prior = |pixel: Vector2<f32>| pixel * 1e30;
    let point_prior = |_: Vector2<f32>| Vector2::new(5.0, 5.0);
    let priors: [Option<&MotionPrior>; 4] = [None, Some(&nan_prior), Some(&wild_prior), Some(&point_prior)];
    let mut n_last = 0;
    for (round, (width, height)) in
        [(320, 240), (320, 240), (320, 240), (0, 0), (0, 0), (1, 1), (2, 40), (9, 9), (9, 9), (320, 240)]
            .into_iter()
            .enumerate()
    {
        let image = noise(width, height, 255, round as u64);
        for n_segments in [10_000, 0, 300] {
            let mut coordinate = |size: u32| match random.below(200) {
                0 => f32::NAN,
                1 => f32::INFINITY,
                2 => f32::MAX,
                3 => -1e9,
                _ => (1.4 * random.unit() - 0.2) * size as f32,
            };
            let segments = (0..n_segments)
                .map(|_| Segment {
                    start: Vector2::new(coordinate(width), coordinate(height)),
                    end: Vector2::new(coordinate(width), coordinate(height)),
                    sigma_px: coordinate(2),
                    gradient: coordinate(50),
                })
                .collect();
            let tracked = tracker.track(&image, segments, priors[round % 4]);
            check(&tracked, n_last, &image, &config);
            n_last = tracked.lines.len();
        }
        if round == 1 {
            tracker.reset();
            n_last = 0;
        }
    }
}

#[test]
fn the_same_frames_give_the_same_lines() {
    let scene = Scene::new(SIZE.0, SIZE.1, 6);
    let run = || {
        let (mut tracker, mut random) = (tracker(), Random::new(1));
        let frames = (0..3).map(|frame| {
            let detected = detect(&scene, &view(frame), 0.2, &mut random);
            let detected = detected.into_iter().map(|(_, segment)| segment).collect();
            let moved = frame.checked_sub(1).map(motion);
            let prior = moved.as_ref().map(|moved| moved as &MotionPrior);
            tracker.track(&scene.render(SIZE, &view(frame), 1.0, 0.0), detected, prior)
        });
        frames.collect::<Vec<_>>()
    };
    assert_eq!(run(), run());
}

#[test]
fn bad_configurations_are_refused() {
    type Change = fn(&mut LineTrackerConfig);
    let changes: [Change; 7] = [
        |config| config.min_length_px = f32::NAN,
        |config| config.min_new_length_px = 10.0,
        |config| config.max_lines = 0,
        |config| config.max_detections = 1_000_000,
        |config| config.flow_sigma_factor = 0.5,
        |config| config.flow.min_samples = 1,
        |config| config.flow.sample_spacing_px = 0.0,
    ];
    for (number, change) in changes.into_iter().enumerate() {
        let mut config = LineTrackerConfig::default();
        change(&mut config);
        assert!(LineTracker::new(config).is_err(), "change {number}");
    }
}

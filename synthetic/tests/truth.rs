//! What the sequences promise: the same bytes for the same seed, and images that agree with the truth.

use geometry::{CameraModel, CameraParameters};
use nalgebra::Vector2;
use synthetic::{Preset, RenderOptions, Sequence, SequenceConfig, SyntheticFrame};

/// A preset at a quarter of the pixels, with coarse textures and a perfect sensor.
fn small(preset: Preset, seed: u64) -> SequenceConfig {
    let mut config = SequenceConfig::preset(preset, seed);
    config.camera = CameraParameters {
        model: CameraModel::Pinhole,
        width: 320,
        height: 240,
        fx: 230.0,
        fy: 230.0,
        cx: 159.5,
        cy: 119.5,
        distortion: Vec::new(),
    };
    config.render = RenderOptions { texel: 0.008, ..RenderOptions::ideal() };
    config
}

fn sequence(config: SequenceConfig) -> Sequence {
    Sequence::new(config).expect("the camera is valid")
}

/// Pixels on a grid, away from the border.
fn grid(step: usize) -> impl Iterator<Item = Vector2<f64>> {
    (10..230)
        .step_by(step)
        .flat_map(move |y| (10..310).step_by(step).map(move |x| Vector2::new(x as f64, y as f64)))
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_seed_others() {
    let frame = |seed, threads, i| -> SyntheticFrame {
        let mut config = small(Preset::RoomRich, seed);
        config.render = RenderOptions { threads, texel: 0.008, ..RenderOptions::default() };
        sequence(config).frame(i)
    };
    let first = frame(1, 1, 5);
    assert!(first == frame(1, 1, 5), "one seed gave two images");
    assert!(first == frame(1, 3, 5), "the number of threads changed the image");
    assert!(first.image != frame(2, 1, 5).image, "two seeds gave one image");
    assert!(first.image != frame(1, 1, 6).image, "two frames gave one image");
}

#[test]
fn noise_differs_between_frames_and_has_the_sigma_asked_for() {
    let ideal = sequence(small(Preset::RoomPoor, 4)).frame(0).image;
    let mut config = small(Preset::RoomPoor, 4);
    config.render.noise_sigma = 3.0;
    let noisy = sequence(config).frame(0).image;
    let differences = ideal.pixels().iter().zip(noisy.pixels()).map(|(a, b)| f64::from(*a) - f64::from(*b));
    let n = ideal.pixels().len() as f64;
    let (sum, squares) = differences.fold((0.0, 0.0), |(s, q), d| (s + d, q + d * d));
    let sigma = (squares / n - (sum / n).powi(2)).sqrt();
    assert!((sigma - 3.0).abs() < 0.2, "sigma {sigma}");
    assert!((sum / n).abs() < 0.1, "bias {}", sum / n);
}

/// Share of pixels at which the image shows what the ray hits, within `tolerance` gray levels.
fn agreement_with_ray_casting(sequence: &Sequence, i: usize, tolerance: f64) -> f64 {
    let image = sequence.frame(i).image;
    let mut counts = (0, 0);
    for pixel in grid(7) {
        let hit = sequence.cast_pixel(i, &pixel).expect("the world is closed");
        let expected = sequence.renderer().surface_gray(&hit);
        let shown = f64::from(image.get(pixel.x as u32, pixel.y as u32));
        counts.0 += usize::from((shown - expected).abs() < tolerance);
        counts.1 += 1;
    }
    f64::from(counts.0 as u32) / f64::from(counts.1 as u32)
}

#[test]
fn images_show_what_rays_hit() {
    // Plain worlds, where a pixel's mean and its middle are alike except at edges.
    for preset in [Preset::RoomPoor, Preset::CorridorStraight, Preset::CorridorRing] {
        let sequence = sequence(small(preset, 3));
        for i in [0, sequence.len() / 2] {
            let share = agreement_with_ray_casting(&sequence, i, 6.0);
            assert!(share > 0.93, "{}, frame {i}: {share}", preset.name());
        }
    }
}

#[test]
fn lenses_bend_images_as_the_camera_says() {
    let mut config = small(Preset::RoomPoor, 3);
    config.camera.model = CameraModel::Radtan;
    config.camera.distortion = vec![-0.28, 0.07, 0.0002, 0.00002];
    let bent = sequence(config);
    assert!(agreement_with_ray_casting(&bent, 30, 6.0) > 0.93);
    let straight = sequence(small(Preset::RoomPoor, 3)).frame(30).image;
    assert!(straight != bent.frame(30).image);
}

#[test]
fn frames_warp_into_each_other_by_their_true_depth() {
    for preset in [Preset::RoomRich, Preset::FourRooms, Preset::Unstructured] {
        let sequence = sequence(small(preset, 2));
        let (i, j) = (40, 44);
        let (first, second) = (sequence.frame(i).image, sequence.frame(j).image);
        let (mut warped, mut unwarped, mut n) = (0.0, 0.0, 0.0);
        for pixel in grid(3) {
            let Some(hit) = sequence.cast_pixel(i, &pixel) else { continue };
            let Some(seen) = sequence.observe(j, &hit.point) else { continue };
            let Some(there) = second.sample(seen.x, seen.y) else { continue };
            let here = f64::from(first.get(pixel.x as u32, pixel.y as u32));
            warped += (here - there).abs();
            unwarped += (here - f64::from(second.get(pixel.x as u32, pixel.y as u32))).abs();
            n += 1.0;
        }
        assert!(n > 5000.0, "{}: only {n} pixels overlap", preset.name());
        let (warped, unwarped) = (warped / n, unwarped / n);
        assert!(warped < 6.0 && warped < 0.4 * unwarped, "{}: {warped} of {unwarped}", preset.name());
    }
}

#[test]
fn depth_is_the_z_coordinate_of_the_hit() {
    let sequence = sequence(small(Preset::RoomRich, 2));
    let pixel = Vector2::new(40.0, 60.0);
    let hit = sequence.cast_pixel(7, &pixel).expect("the room is closed");
    let depth = sequence.depth(7, &pixel).expect("the room is closed");
    let bearing = sequence.camera().unproject(&pixel).expect("inside of the image");
    assert!((depth - hit.distance * bearing.z).abs() < 1e-9);
    let back = sequence.observe(7, &hit.point).expect("nothing stands before the first hit");
    assert!((back - pixel).norm() < 1e-6);
}

#[test]
fn visible_segments_lie_on_edges_of_the_image() {
    let sequence = sequence(small(Preset::RoomPoor, 5));
    let (mut on_edge, mut n) = (0, 0);
    for i in [0, 60, 120] {
        let image = sequence.frame(i).image;
        for segment in sequence.visible_segments(i).iter().filter(|segment| segment.contrast > 15.0) {
            let [from, to] = segment.ends_px;
            let across = Vector2::new(from.y - to.y, to.x - from.x).normalize() * 2.0;
            for k in 1..8 {
                let middle = from.lerp(&to, f64::from(k) / 8.0);
                let (left, right) = (middle + across, middle - across);
                let sides = (image.sample(left.x, left.y), image.sample(right.x, right.y));
                let (Some(left), Some(right)) = sides else { continue };
                on_edge += usize::from((left - right).abs() > 0.4 * segment.contrast);
                n += 1;
            }
        }
    }
    assert!(n > 200, "only {n} samples");
    assert!(on_edge * 100 > n * 88, "{on_edge} of {n} samples show an edge");
}

#[test]
fn segments_belong_to_the_families_of_their_worlds() {
    for (preset, n_families) in [
        (Preset::RoomPoor, 3),
        (Preset::CorridorRing, 3),
        (Preset::FourRooms, 3),
        (Preset::Atlanta, 5),
        (Preset::Unstructured, 0),
    ] {
        let sequence = sequence(small(preset, 1));
        let world = sequence.world();
        assert_eq!(world.vanishing_directions().len(), n_families, "{}", preset.name());
        let mut sizes = vec![0; n_families];
        for segment in world.segments() {
            let Some(family) = segment.family else { continue };
            let axis = world.vanishing_directions()[family];
            let along = (segment.end - segment.start).normalize();
            assert!(along.dot(axis.as_vector()).abs() > 1.0 - 1e-9);
            sizes[family] += 1;
        }
        assert!(sizes.iter().all(|size| *size >= 12), "{}: {sizes:?}", preset.name());
        assert!(world.segments().len() > 60, "{}", preset.name());
    }
}

/// Number of cells, of 8 x 6, that contain a pixel whose gradients are strong in two directions, and number
/// of such pixels.
fn corners(sequence: &Sequence, i: usize) -> (usize, usize) {
    let image = sequence.frame(i).image;
    let at = |x: u32, y: u32| f64::from(image.get(x, y));
    let mut cells = [false; 48];
    let mut n_corners = 0;
    for y in 4..236 {
        for x in 4..316 {
            let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
            for (dx, dy) in (0..9).map(|k| (k % 3, k / 3)) {
                let (u, v) = (x + dx - 1, y + dy - 1);
                let (gx, gy) = (at(u + 1, v) - at(u - 1, v), at(u, v + 1) - at(u, v - 1));
                xx += gx * gx;
                xy += gx * gy;
                yy += gy * gy;
            }
            let least_eigenvalue = 0.5 * (xx + yy - ((xx - yy).powi(2) + 4.0 * xy * xy).sqrt());
            if least_eigenvalue > 2500.0 {
                cells[(y / 40 * 8 + x / 40) as usize] = true;
                n_corners += 1;
            }
        }
    }
    (cells.iter().filter(|cell| **cell).count(), n_corners)
}

#[test]
fn rich_rooms_have_corners_everywhere_and_poor_ones_few() {
    for seed in [1, 2] {
        let (rich, poor) = (sequence(small(Preset::RoomRich, seed)), sequence(small(Preset::RoomPoor, seed)));
        for i in [0, 100, 200] {
            let ((rich_cells, n_rich), (poor_cells, n_poor)) = (corners(&rich, i), corners(&poor, i));
            let place = format!("seed {seed}, frame {i}");
            assert!(rich_cells >= 40, "{place}: corners in {rich_cells} of 48 cells of the rich room");
            assert!(poor_cells <= 32, "{place}: corners in {poor_cells} of 48 cells of the poor room");
            assert!(
                n_rich > 6 * n_poor,
                "{place}: {n_rich} corners in the rich room, {n_poor} in the poor one"
            );
        }
    }
}

#[test]
fn stretches_of_the_look_alike_corridor_look_alike() {
    let sequence = sequence(small(Preset::LookAlike, 1));
    let pose = sequence.camera_from_world(200);
    let view = |shift: f64| {
        let mut world_from_camera = pose.inverse();
        world_from_camera.translation.x += shift;
        sequence.renderer().render(&[world_from_camera.inverse()], 0.0, 0)
    };
    let difference = |a: &synthetic::GrayImage, b: &synthetic::GrayImage| {
        let sum: f64 = a.pixels().iter().zip(b.pixels()).map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
        sum / a.pixels().len() as f64
    };
    let here = view(0.0);
    assert!(difference(&here, &view(4.5)) < 1.5, "{}", difference(&here, &view(4.5)));
    assert!(difference(&here, &view(2.25)) > 3.0, "{}", difference(&here, &view(2.25)));
}

#[test]
fn datasets_list_what_they_contain() {
    let dir = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("synthetic_dataset");
    let mut config = small(Preset::Unstructured, 1);
    config.n_frames = Some(2);
    let sequence = sequence(config);
    sequence.write_dataset(&dir).expect("the folder can be written");
    let read = |name: &str| std::fs::read_to_string(dir.join(name)).expect("the file was written");
    assert_eq!(read("rgb.txt").lines().next(), Some("1000.000000000 images/000000.png"));
    assert_eq!(read("rgb.txt").lines().count(), 2);
    let truth: Vec<f64> = read("groundtruth.txt")
        .lines()
        .nth(1)
        .unwrap_or("")
        .split(' ')
        .map(|x| x.parse().expect("a number"))
        .collect();
    let position = sequence.camera_from_world(1).center();
    assert!((truth[1] - position.x).abs() < 1e-8 && (truth[3] - position.z).abs() < 1e-8);
    assert!(
        read("calib.json")
            .starts_with("{\"model\": \"pinhole\", \"width\": 320, \"height\": 240, \"fx\": 230.0,")
    );
    let stored = image::open(dir.join("images/000001.png")).expect("a PNG file").into_luma8();
    assert_eq!(stored.as_raw(), sequence.frame(1).image.pixels());
}

#[test]
fn exposure_and_blur_change_the_image_as_asked() {
    let mean = |config: SequenceConfig| {
        let image = sequence(config).frame(10).image;
        image.pixels().iter().map(|p| f64::from(*p)).sum::<f64>() / image.pixels().len() as f64
    };
    let plain = mean(small(Preset::RoomPoor, 1));
    let mut darker = small(Preset::RoomPoor, 1);
    darker.render.exposure = synthetic::ExposureCurve::Table(vec![(0.0, 1.0), (1.0, 0.0)]);
    assert!((mean(darker) - 0.5 * plain).abs() < 1.0, "half a second into the curve the gain is a half");

    let roughness = |blur_samples| {
        let mut config = small(Preset::RoomRich, 1);
        config.render = RenderOptions { shutter_s: 0.05, blur_samples, ..config.render };
        let image = sequence(config).frame(60).image;
        image.pixels().windows(2).map(|pair| f64::from(pair[0].abs_diff(pair[1]))).sum::<f64>()
    };
    assert!(roughness(4) < 0.85 * roughness(1), "motion blur smooths");
}

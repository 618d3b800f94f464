//! Boards rendered through lenses, with blur and noise, against the truth.

use calibration::{Board, CalibrationConfig, DetectionConfig, Verdict, View, calibrate, find_board};
use geometry::nalgebra::{Vector2, Vector3, Vector6};
use geometry::{Camera, CameraModel, CameraParameters, Pose};
use vision::GrayImage;

/// Rays for each pixel, across and down.
const SUPERSAMPLING: u32 = 5;

fn board() -> Board {
    Board::new(9, 6, 0.025).unwrap()
}

fn camera(model: CameraModel, focal: f64, distortion: &[f64]) -> Camera {
    let parameters = CameraParameters::of_focal_length(640, 480, focal);
    Camera::new(CameraParameters { model, distortion: distortion.to_vec(), ..parameters }).unwrap()
}

/// Numbers that look like chance, the same each time.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// The gray level of the board's plane: squares, a white margin, a room's floor of large tiles.
fn paint(board: &Board, x: f64, y: f64) -> f64 {
    let (column, row) = ((x / 0.025).floor() as i64, (y / 0.025).floor() as i64);
    let (columns, rows) = (board.columns() as i64, board.rows() as i64);
    if (-1..columns).contains(&column) && (-1..rows).contains(&row) {
        return if (column + row).rem_euclid(2) == 0 { 30.0 } else { 215.0 };
    }
    if (-2..=columns).contains(&column) && (-2..=rows).contains(&row) {
        return 215.0;
    }
    if ((x / 0.17).floor() + (y / 0.23).floor()).rem_euclid(2.0) == 0.0 { 90.0 } else { 140.0 }
}

/// The board as a camera sees it, blurred by a lens and with noise.
fn render(camera: &Camera, board: &Board, pose: &Pose, blur_px: f64, noise: f64, seed: u64) -> GrayImage {
    let (width, height) = (camera.width() as usize, camera.height() as usize);
    let board_from_camera = pose.inverse();
    let shade = |x: f64, y: f64| {
        let Some(ray) = camera.unproject(&Vector2::new(x, y)) else { return 0.0 };
        let (origin, direction) = (board_from_camera.translation, board_from_camera.rotation_matrix() * ray);
        let at = origin - direction * (origin.z / direction.z);
        if direction.z * origin.z >= 0.0 { 60.0 } else { paint(board, at.x, at.y) }
    };
    let step = 1.0 / f64::from(SUPERSAMPLING);
    let offsets: Vec<f64> = (0..SUPERSAMPLING).map(|i| (f64::from(i) + 0.5) * step - 0.5).collect();
    let sharp: Vec<f64> = (0..width * height)
        .map(|at| {
            let (x, y) = ((at % width) as f64, (at / width) as f64);
            let rays = offsets.iter().flat_map(|dy| offsets.iter().map(move |dx| (x + dx, y + dy)));
            rays.map(|(x, y)| shade(x, y)).sum::<f64>() * step * step
        })
        .collect();
    let reach = (3.0 * blur_px).ceil() as isize;
    let weights: Vec<f64> =
        (-reach..=reach).map(|i| (-0.5 * (i as f64 / blur_px.max(1e-3)).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let blurred = |values: &[f64], by_column: bool| -> Vec<f64> {
        let at = |x: isize, y: isize| {
            let (x, y) = (x.clamp(0, width as isize - 1), y.clamp(0, height as isize - 1));
            values[y as usize * width + x as usize]
        };
        let one = |at_idx: usize| {
            let (x, y) = ((at_idx % width) as isize, (at_idx / width) as isize);
            let shifted = weights
                .iter()
                .zip(-reach..=reach)
                .map(|(weight, i)| weight * if by_column { at(x, y + i) } else { at(x + i, y) });
            shifted.sum::<f64>() / sum
        };
        (0..width * height).map(one).collect()
    };
    let soft = blurred(&blurred(&sharp, false), true);
    let mut chance = Noise(seed);
    GrayImage::from_fn(camera.width(), camera.height(), |x, y| {
        let value = soft[y as usize * width + x as usize] + noise * chance.normal();
        value.round().clamp(0.0, 255.0) as u8
    })
}

/// A pose from which the whole board is seen: tilted, turned, to one side.
fn pose(tilt: f64, turn: f64, roll: f64, distance: f64) -> Pose {
    let center = Vector3::new(0.1, 0.0625, 0.0);
    let rotation = Pose::exp(&Vector6::new(tilt, turn, roll, 0.0, 0.0, 0.0));
    let translation = Vector3::new(0.02, -0.01, distance) - rotation.transform(&center);
    Pose { translation, ..rotation }
}

/// Distances of what was found from the truth, pixels; the board may be found from its other end.
fn errors(view: &View, camera: &Camera, board: &Board, pose: &Pose) -> Vec<f64> {
    let truth: Vec<Vector2<f64>> =
        board.corners().map(|corner| camera.project(&pose.transform(&corner)).unwrap()).collect();
    let distances = |truth: &mut dyn Iterator<Item = &Vector2<f64>>| -> Vec<f64> {
        view.corners.iter().zip(truth).map(|(found, truth)| (found - truth).norm()).collect()
    };
    let (same, turned) = (distances(&mut truth.iter()), distances(&mut truth.iter().rev()));
    if same.iter().sum::<f64>() < turned.iter().sum::<f64>() { same } else { turned }
}

fn rms(errors: &[f64]) -> f64 {
    (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
}

#[test]
fn corners_are_found_to_a_twentieth_of_a_pixel_through_any_lens() {
    let board = board();
    let cameras = [
        camera(CameraModel::Pinhole, 520.0, &[]),
        camera(CameraModel::Radtan, 460.0, &[-0.28, 0.07, 0.0002, -0.0003]),
        camera(CameraModel::KannalaBrandt, 300.0, &[0.01, -0.01, 0.002, 0.0]),
    ];
    let mut seed = 0;
    for camera in &cameras {
        for (tilt, turn, roll, distance) in
            [(0.0, 0.0, 0.05, 0.45), (0.5, -0.2, 0.3, 0.5), (-0.3, 0.6, 1.2, 0.55), (0.4, 0.4, 3.0, 0.42)]
        {
            seed += 1;
            // A wide lens is shown the board from nearer by.
            let pose = pose(tilt, turn, roll, distance * camera.parameters().fx / 520.0);
            let image = render(camera, &board, &pose, 0.8, 3.0, seed);
            let view = find_board(&image, &board, &DetectionConfig::default())
                .unwrap_or_else(|| panic!("no board with tilt {tilt}, turn {turn}, roll {roll}"));
            let errors = errors(&view, camera, &board, &pose);
            let worst = errors.iter().copied().fold(0.0, f64::max);
            assert!(rms(&errors) < 0.05, "{:?}: {:.3} px", camera.parameters().model, rms(&errors));
            assert!(worst < 0.2, "{:?}: {worst:.3} px at worst", camera.parameters().model);
        }
    }
}

#[test]
fn a_board_of_another_size_or_none_is_not_found() {
    let (camera, pose) = (camera(CameraModel::Pinhole, 520.0, &[]), pose(0.2, 0.3, 0.1, 0.5));
    let image = render(&camera, &board(), &pose, 0.8, 2.0, 7);
    let config = DetectionConfig::default();
    assert!(find_board(&image, &Board::new(10, 7, 0.025).unwrap(), &config).is_none());
    let noise = GrayImage::from_fn(320, 240, |x, y| ((x * 7919 + y * 104_729) ^ (x * y)) as u8);
    assert!(find_board(&noise, &board(), &config).is_none());
    assert!(find_board(&GrayImage::new(640, 480), &board(), &config).is_none());
    assert!(find_board(&GrayImage::new(0, 0), &board(), &config).is_none());
    assert!(find_board(&GrayImage::new(3, 900), &board(), &config).is_none());
}

#[test]
fn rendered_boards_give_the_camera_back() {
    let board = board();
    let truth = camera(CameraModel::Radtan, 430.0, &[-0.25, 0.06, 0.0003, -0.0002]);
    let corner = |k: usize, c: f64, s: f64| if k.is_multiple_of(2) { c } else { s };
    let views: Vec<View> = (0..14)
        .filter_map(|k| {
            let t = k as f64;
            let mut pose =
                pose(0.55 * (1.9 * t).sin(), 0.55 * (1.3 * t).cos(), 0.2 * t, 0.33 + 0.02 * (t % 4.0));
            pose.translation +=
                Vector3::new(0.11 * corner(k, 1.0, -1.0), 0.07 * corner(k / 2, 1.0, -1.0), 0.0);
            find_board(
                &render(&truth, &board, &pose, 0.7, 2.0, 100 + k as u64),
                &board,
                &DetectionConfig::default(),
            )
        })
        .collect();
    assert!(views.len() >= 8, "{} boards", views.len());
    let config = CalibrationConfig { min_views: 8, ..CalibrationConfig::default() };
    let found = calibrate(&board, &views, (640, 480), &config).unwrap();
    assert!(found.rms_px < 0.08, "{}", found.rms_px);
    assert_ne!(found.verdict(), Verdict::Poor, "{:?}", found.findings);
    let (camera, truth) = (&found.camera, truth.parameters());
    for (name, found, truth, sigma) in [
        ("fx", camera.fx, truth.fx, found.sigmas[0]),
        ("fy", camera.fy, truth.fy, found.sigmas[1]),
        ("cx", camera.cx, truth.cx, found.sigmas[2]),
        ("cy", camera.cy, truth.cy, found.sigmas[3]),
        ("k1", camera.distortion[0], truth.distortion[0], found.sigmas[4]),
    ] {
        assert!((found - truth).abs() < 4.0 * sigma, "{name}: {found} ± {sigma}, not {truth}");
    }
    assert!((camera.fx / truth.fx - 1.0).abs() < 0.003, "{}", camera.fx);
}

use super::*;
use crate::lines::Segment;
use nalgebra::Vector2;

const SIZE: (u32, u32) = (320, 240);

fn hash(x: u32, y: u32) -> u32 {
    (x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77)).wrapping_mul(0xC2B2_AE35) >> 13
}

/// Tiles of many gray levels as a camera sees them that has moved by so many pixels.
fn scene(x: u32, y: u32, moved: (u32, u32)) -> u8 {
    let (x, y) = (x + moved.0, y + moved.1);
    (60 + hash(x / 24, y / 24) % 120 + hash(x / 7, y / 7) % 40) as u8
}

/// A path that crosses edges of every direction.
fn path(frame: u32) -> (u32, u32) {
    let t = f64::from(frame) * 0.05;
    ((400.0 + 90.0 * t.sin()) as u32, (300.0 + 70.0 * (1.3 * t).cos()) as u32)
}

/// The masks that are found in frames of which `pixel` tells the gray levels.
fn find(n_frames: u32, pixel: impl Fn(u32, u32, u32) -> u8) -> Vec<(u32, Mask)> {
    let mut finder = MaskFinder::new(MaskFinderConfig::default());
    let look = |frame| {
        let image = GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| pixel(frame, x, y));
        finder.look(&image).map(|mask| (frame, mask))
    };
    (0..n_frames).filter_map(look).collect()
}

fn is_framed(x: u32, y: u32) -> bool {
    x < 30 || y < 20 || x >= SIZE.0 - 30 || y >= SIZE.1 - 20
}

fn is_marked(x: u32, y: u32) -> bool {
    let inside = (200..296).contains(&x) && (20..44).contains(&y);
    inside && (x / 8).is_multiple_of(2)
}

#[test]
fn a_black_frame_is_found_as_soon_as_the_camera_moves() {
    let found = find(40, |frame, x, y| if is_framed(x, y) { 0 } else { scene(x, y, path(frame)) });
    let (first, mask) = &found[0];
    assert!(*first <= 20, "found at frame {first}");
    let truth = Mask::from_fn(SIZE.0, SIZE.1, is_framed);
    assert!((mask.share() - truth.share()).abs() < 0.02, "{} of {}", mask.share(), truth.share());
    let wrong = (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y)));
    assert!(wrong.into_iter().all(|(x, y)| !truth.leaves_out(x, y) || mask.leaves_out(x, y)));
}

#[test]
fn a_watermark_is_found_in_time() {
    let found = find(300, |frame, x, y| if is_marked(x, y) { 250 } else { scene(x, y, path(frame)) });
    let (_, mask) = found.last().expect("it stays where it is");
    let pixels = || (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y)));
    let left_out = |(x, y): &(u32, u32)| mask.leaves_out(*x, *y);
    let n_found = pixels().filter(|(x, y)| is_marked(*x, *y)).filter(left_out).count();
    let n_marked = pixels().filter(|(x, y)| is_marked(*x, *y)).count();
    // Its strokes where they stand out; a good part of the way is through what they do not.
    assert!(n_found * 4 >= n_marked, "{n_found} of {n_marked}");
    let is_far = |(x, y): &(u32, u32)| !(192..304).contains(x) || !(12..52).contains(y);
    assert_eq!(pixels().filter(is_far).filter(left_out).count(), 0, "none of the scene");
}

#[test]
fn nothing_of_the_scene_is_left_out() {
    let noise = |frame: u32, x: u32, y: u32| (hash(x + 977 * frame, y) % 9) as u8;
    let moving = find(200, |frame, x, y| scene(x, y, path(frame)) + noise(frame, x, y));
    assert!(moving.is_empty(), "a camera that moves");
    let standing = find(200, |frame, x, y| scene(x, y, path(0)) + noise(frame, x, y));
    assert!(standing.is_empty(), "a camera that stands still");
    let plain = find(200, |frame, x, y| 100 + noise(frame, x, y));
    assert!(plain.is_empty(), "a wall");
    // Somebody walks through what a camera sees that stands still, with black at the image's border.
    let walker = |frame: u32, x: u32| (3 * frame..3 * frame + 60).contains(&x);
    let watched = find(200, |frame, x, y| match () {
        () if is_framed(x, y) => 0,
        () if walker(frame % 100, x) && y > 80 => scene(x, y, path(frame)),
        () => scene(x, y, path(0)) + noise(frame, x, y),
    });
    assert!(watched.is_empty(), "a camera that stands still while somebody passes");
}

#[test]
fn an_edge_along_the_way_is_of_the_scene() {
    // A kerb: the scene moves along it for as long as you like.
    let found =
        find(300, |frame, x, y| if (118..124).contains(&y) { 240 } else { scene(x, y, (3 * frame, 0)) });
    assert!(found.is_empty(), "{} of the image", found[0].1.share());
}

#[test]
fn the_same_images_give_the_same_mask() {
    let run = || find(60, |frame, x, y| if is_framed(x, y) { 0 } else { scene(x, y, path(frame)) });
    assert_eq!(run(), run());
}

#[test]
fn masks_are_of_any_size_and_dark_is_left_out() {
    let picture = GrayImage::from_fn(8, 4, |x, _| if x < 2 { 10 } else { 200 });
    let mask = Mask::from_picture(&picture);
    assert_eq!(mask.share(), 0.25);
    let large = mask.resized(32, 16);
    assert_eq!((large.width(), large.height(), large.share()), (32, 16, 0.25));
    assert!(large.leaves_out(7, 15) && !large.leaves_out(8, 0) && large.leaves_out(32, 0));
    assert_eq!(Mask::default().share(), 0.0);
    assert_eq!(Mask::default().resized(4, 4), Mask::default());
}

#[test]
fn clearance_is_the_distance_to_what_is_left_out() {
    let clearance = Clearance::of(&Mask::from_fn(100, 80, |x, y| x == 50 && y == 40));
    assert_eq!([clearance.at(50, 40), clearance.at(60, 40), clearance.at(50, 10)], [0, 10, 30]);
    let diagonal = clearance.at(60, 50);
    assert!((13..=14).contains(&diagonal), "{diagonal}");
    assert_eq!(clearance.at(100, 0), 0, "outside");
    assert_eq!(Clearance::of(&Mask::from_fn(9, 9, |_, _| false)).at(4, 4), 255);
}

#[test]
fn segments_are_cut_where_the_scene_ends() {
    let clearance = Clearance::of(&Mask::from_fn(200, 100, |x, _| x < 60));
    let segment = |a: (f32, f32), b: (f32, f32)| Segment {
        start: Vector2::new(a.0, a.1),
        end: Vector2::new(b.0, b.1),
        sigma_px: 0.3,
        gradient: 20.0,
    };
    let free = segment((100.0, 20.0), (180.0, 60.0));
    assert_eq!(clearance.visible_part(&free), Some(free));
    let cut = clearance.visible_part(&segment((20.0, 50.0), (180.0, 50.0))).unwrap();
    assert!((64.0..70.0).contains(&cut.start.x) && cut.end.x == 180.0, "{cut:?}");
    assert_eq!(clearance.visible_part(&segment((61.0, 10.0), (61.0, 90.0))), None, "the mask's own edge");
    assert_eq!(clearance.visible_part(&segment((f32::NAN, 0.0), (1.0, 1.0))), None);
}

#[test]
fn masks_come_back_from_few_bytes() {
    for mask in [
        Mask::from_fn(640, 480, |x, y| x < 40 || y > 470),
        Mask::from_fn(7, 5, |x, y| (x + y) % 2 == 0),
        Mask::from_fn(300, 200, |_, _| true),
        Mask::default(),
    ] {
        assert_eq!(Mask::from_bytes(&mask.to_bytes()), Some(mask));
    }
    let bytes = Mask::from_fn(640, 480, |x, y| x < 40 || y > 470).to_bytes();
    assert!(bytes.len() < 4000, "{}", bytes.len());
    for end in 0..bytes.len() {
        assert_eq!(Mask::from_bytes(&bytes[..end]), None);
    }
    assert_eq!(Mask::from_bytes(&[255; 64]), None);
}

#[test]
fn a_black_border_is_told_by_one_image_and_a_dark_scene_is_none() {
    let lens = |x: u32, y: u32| (f64::from(x) - 160.0).hypot(f64::from(y) - 120.0) > 90.0;
    let image = GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| if lens(x, y) { 3 } else { scene(x, y, (0, 0)) });
    let border = black_border(&image);
    let [(left, top), (right, bottom)] = border.used_box().unwrap();
    assert!((68..=72).contains(&left) && (248..=252).contains(&right), "{left} to {right}");
    assert!((28..=32).contains(&top) && (208..=212).contains(&bottom), "{top} to {bottom}");
    // A lamp in the dark fades away; a black picture has no rim.
    let lamp = |x: u32, y: u32| (f64::from(x) - 160.0).hypot(f64::from(y) - 120.0);
    let fading = GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| (200.0 - 1.6 * lamp(x, y)).max(2.0) as u8);
    assert_eq!(black_border(&fading).share(), 0.0);
    assert_eq!(black_border(&GrayImage::new(SIZE.0, SIZE.1)).share(), 0.0);
    assert_eq!(Mask::from_fn(8, 4, |_, _| true).used_box(), None);
    assert_eq!(Mask::from_fn(8, 4, |x, y| x < 2 || y > 2).used_box(), Some([(2, 0), (8, 3)]));
}

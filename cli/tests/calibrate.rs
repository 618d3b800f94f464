//! `monoslam calibrate` as it is called.

use std::process::{Command, Output};

/// Runs the command in a folder with one picture of these gray levels.
fn calibrate(pixels: &[u8], arguments: &[&str]) -> (Output, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let picture = [b"P5 200 150 255\n", pixels].concat();
    std::fs::write(folder.path().join("one.pgm"), picture).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_monoslam"))
        .current_dir(folder.path())
        .arg("calibrate")
        .args(arguments)
        .output()
        .unwrap();
    (output, folder)
}

#[test]
fn pictures_without_a_board_are_told_in_plain_words() {
    let (output, folder) = calibrate(&[90; 200 * 150], &[".", "--board", "7x5"]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success());
    assert!(told.contains("found in 0 of 1 pictures") && told.contains("7x5 inner corners"), "{told}");
    assert!(!folder.path().join("calib.json").exists(), "nothing is written");
}

#[test]
fn a_folder_without_pictures_and_a_broken_picture_are_named() {
    let (output, _folder) = calibrate(&[1, 2, 3], &["one.pgm"]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && told.contains("one.pgm"), "{told}");
    let empty = tempfile::tempdir().unwrap();
    let (output, _folder) = calibrate(&[90; 200 * 150], &[empty.path().to_str().unwrap()]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && told.contains("no pictures"), "{told}");
}

//! Renders a preset sequence into a folder that `monoslam stream` can read.
//!
//! ```text
//! cargo run --release -p synthetic --example render -- --preset room-rich --seed 1 --frames 10 --out DIR
//! ```
//! Then renders the frames twice more and reports the time; without `--out`, only that.
//! `--step N` takes every N-th frame of the path, `--fps N` another number of frames a second, `--laps N`
//! goes around N times where the path is closed, `--threads N` shares each frame between threads.

use std::process::ExitCode;
use std::time::Instant;

use synthetic::{PathKind, Preset, Sequence, SequenceConfig};

struct Arguments {
    preset: Preset,
    seed: u64,
    frames: Option<usize>,
    step: usize,
    fps: Option<u64>,
    laps: Option<u64>,
    threads: usize,
    out: Option<String>,
}

fn main() -> ExitCode {
    let arguments = match parse(std::env::args().skip(1)) {
        Ok(arguments) => arguments,
        Err(message) => {
            eprintln!("{message}");
            eprintln!(
                "usage: render --preset NAME [--out DIR] [--seed N] [--frames N] [--step N] [--fps N] [--laps N] [--threads N]"
            );
            return ExitCode::FAILURE;
        }
    };
    let mut config = SequenceConfig::preset(arguments.preset, arguments.seed);
    config.fps = arguments.fps.map_or(config.fps, |fps| fps as f64) / arguments.step as f64;
    if let (PathKind::Walk { laps: Some(laps), .. }, Some(wanted)) = (&mut config.path.kind, arguments.laps) {
        *laps = wanted as f64;
    }
    config.n_frames = arguments.frames;
    config.render.threads = arguments.threads;
    let sequence = Sequence::new(config).expect("the camera of the presets is valid");
    if let Some(out) = &arguments.out
        && let Err(error) = sequence.write_dataset(out)
    {
        eprintln!("cannot write {out}: {error}");
        return ExitCode::FAILURE;
    }
    // Textures are painted when first seen: the first pass pays for that, the second does not.
    for pass in ["first", "second"] {
        let start = Instant::now();
        let n_bytes: usize = sequence.frames().map(|frame| frame.image.pixels().len()).sum();
        let per_frame_ms = start.elapsed().as_secs_f64() * 1e3 / sequence.len().max(1) as f64;
        println!("{pass} pass: {} frames, {n_bytes} bytes, {per_frame_ms:.1} ms a frame", sequence.len());
    }
    ExitCode::SUCCESS
}

fn parse(mut words: impl Iterator<Item = String>) -> Result<Arguments, String> {
    let mut preset = None;
    let mut out = None;
    let (mut seed, mut frames, mut step, mut fps, mut laps, mut threads) = (1, None, 1, None, None, 1);
    while let Some(option) = words.next() {
        let value = words.next().ok_or_else(|| format!("{option} needs a value"))?;
        let number = || value.parse::<u64>().map_err(|error| format!("{option} {value}: {error}"));
        match option.as_str() {
            "--preset" => preset = Some(value.parse::<Preset>().map_err(|error| error.to_string())?),
            "--out" => out = Some(value),
            "--seed" => seed = number()?,
            "--frames" => frames = Some(number()? as usize),
            "--step" => step = number()?.max(1) as usize,
            "--fps" => fps = Some(number()?.max(1)),
            "--laps" => laps = Some(number()?.max(1)),
            "--threads" => threads = number()? as usize,
            _ => return Err(format!("unknown option {option}")),
        }
    }
    let preset = preset.ok_or("--preset is missing")?;
    Ok(Arguments { preset, seed, frames, step, fps, laps, threads, out })
}

//! `monoslam`: streams recordings to a SLAM server, fetches trajectories, and measures them.

mod commands;

use std::process::ExitCode;

use clap::Parser;
use commands::Command;

/// Client of the SLAM service: streams recordings, fetches trajectories, measures them
#[derive(Debug, Parser)]
#[command(name = "monoslam", version)]
struct Args {
    #[command(subcommand)]
    command: Command,
}

fn main() -> ExitCode {
    let args = Args::parse();
    let runtime = match tokio::runtime::Runtime::new() {
        Ok(runtime) => runtime,
        Err(error) => {
            eprintln!("monoslam: cannot start the runtime: {error}");
            return ExitCode::FAILURE;
        }
    };
    let outcome = runtime.block_on(args.command.run());
    // A server inside that was abandoned must not hold the process up.
    runtime.shutdown_background();
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("monoslam: {}", commands::in_flags(&format!("{error:#}")));
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accepted(line: &str) -> bool {
        Args::try_parse_from(line.split(' ')).is_ok()
    }

    #[test]
    fn the_documented_command_lines_are_accepted() {
        for line in [
            "monoslam stream data --server http://h:50051 --session a-b_1 --policy realtime --fps 20 --start 3 --end 9 \
             --no-lines --no-primitives --no-loops --deterministic --seed 7 --json --layout euroc",
            "monoslam stream data --server http://h:50051",
            "monoslam stream data --policy lossless --fps 12.5",
            "monoslam stream video.mp4 --camera calib.json",
            "monoslam stream video.mp4 --camera unknown",
            "monoslam stream video.mp4 --fov 70",
            "monoslam calibration a --server http://h:50051 -o calib.json",
            "monoslam stream --camera /dev/video0 --calibration calib.json",
            "monoslam stream - --raw 640x480 --fps 30",
            "monoslam stream robot.mcap --topic /camera/image_raw",
            "monoslam trajectory a --server http://h:50051 --format tum --kind frames -o out.txt",
            "monoslam trajectory a --server http://h:50051 --format kitti --kind keyframes",
            "monoslam evaluate truth.txt estimate.txt --align se3 --max-dt 0.02 --json --picture paths.svg",
            "monoslam bench one two --runs 3 --ablation --json -o docs/results.md",
            "monoslam demo --keep --picture room.svg --report room.html",
            "monoslam bench one -o docs/results.md --section lossless --reports reports",
            "monoslam calibrate board/*.jpg --board 9x6 --square 0.024 --model kannala-brandt -o calib.json --plot errors.svg",
            "monoslam export a --format colmap -o folder --server http://h:50051",
            "monoslam report a --truth truth.txt --summary stream.json --plots plots -o report.html",
            "monoslam export a --format mcap --submap 2",
            "monoslam sessions list --server http://h:50051",
            "monoslam sessions list --server https://h:50051 --token monoslam_x --ca cert.pem",
            "monoslam sessions show lab~kitchen",
            "monoslam sessions show a --server http://h:50051",
            "monoslam sessions delete a --server http://h:50051",
            "monoslam stream data --session a --localize-only",
            "monoslam trajectory a --submap largest",
            "monoslam trajectory a --submap 3",
            "monoslam scale a --metres 0.25",
            "monoslam scale a --free",
            "monoslam scale a --distance 1.5 --from point:3 --to keyframe:7@120,80.5",
            "monoslam scale a --positions gps.txt --by-time --max-error 2 --json",
            "monoslam localize a.jpg b.jpg --session x --session y --fov 70",
            "monoslam localize a.jpg --camera unknown --near -1,2,3 --radius 4 --json",
            "monoslam optimize a --detach",
            "monoslam merge a b --json",
            "monoslam operations list --session a",
            "monoslam operations cancel op-1",
        ] {
            assert!(accepted(line), "{line}");
        }
    }

    #[test]
    fn values_that_make_no_sense_are_refused() {
        for line in [
            "monoslam",
            "monoslam stream",
            "monoslam stream data --policy fast",
            "monoslam stream data --fps 0",
            "monoslam stream - --raw 640",
            "monoslam stream video.mp4 --fov 180",
            "monoslam stream data --fps nan",
            "monoslam stream data --layout tartan",
            "monoslam stream data --session a/b",
            "monoslam evaluate truth.txt",
            "monoslam evaluate truth.txt estimate.txt --max-dt -1",
            "monoslam evaluate truth.txt estimate.txt --align affine",
            "monoslam trajectory a --format xml",
            "monoslam trajectory a --submap some",
            "monoslam stream data --localize-only",
            "monoslam scale a",
            "monoslam scale a --free --metres 2",
            "monoslam scale a --distance 2 --from point:1",
            "monoslam localize",
            "monoslam bench",
            "monoslam calibrate",
            "monoslam calibrate board.mp4 --board 9",
            "monoslam calibrate board.mp4 --board 9x1",
            "monoslam bench one --runs 0",
        ] {
            assert!(!accepted(line), "{line}");
        }
    }

    #[test]
    fn the_command_line_is_consistent() {
        <Args as clap::CommandFactory>::command().debug_assert();
    }
}

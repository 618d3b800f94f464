//! What tests of the command share: a real server, a rendered recording, and the program run against it.
#![allow(dead_code, reason = "each test program uses its part")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};

use server::{Config, Running, Server, Shutdown};
use synthetic::{Preset, Sequence, SequenceConfig};
use tempfile::TempDir;
use tokio::process::Command;

/// A server and a folder with `images/`, `calib.json` and `rgb.txt` of a rendered room.
pub struct Stage {
    pub running: Running,
    folder: TempDir,
}

impl Stage {
    /// With so many frames.
    pub async fn set(n_frames: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut config = SequenceConfig::preset(Preset::RoomRich, 1);
        config.n_frames = Some(n_frames);
        Sequence::new(config).unwrap().write_dataset(folder.path().join("room")).unwrap();
        fs::create_dir(folder.path().join("data")).unwrap();
        let running = Server::start(Config::local(folder.path().join("data"))).await.unwrap();
        Self { running, folder }
    }

    /// A file of that folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Makes a file by `ffmpeg`.
    pub async fn make(&self, name: &str, arguments: &[&str]) -> PathBuf {
        let path = self.path(name);
        let images = self.path("room/images/%06d.png");
        let mut command = Command::new("ffmpeg");
        command.args(["-v", "error", "-y", "-framerate", "30", "-i"]).arg(images).args(arguments).arg(&path);
        assert!(command.status().await.expect("ffmpeg runs").success(), "{arguments:?}");
        path
    }

    /// `monoslam ARGUMENTS --server …` with this server.
    pub fn monoslam(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_monoslam"));
        command.args(arguments).arg("--server").arg(format!("http://{}", self.running.grpc_addr));
        command.stdin(Stdio::null()).kill_on_drop(true);
        command
    }

    /// `monoslam stream SOURCE …` into this server.
    pub fn stream(&self, source: &str, session: &str, arguments: &[&str]) -> Command {
        let words = ["stream", source, "--session", session, "--json"];
        self.monoslam(&[&words[..], arguments].concat())
    }

    /// Ends the server in order.
    pub async fn end(self) {
        assert_eq!(self.running.shutdown().await, Shutdown::Complete);
    }
}

/// The JSON object that a command printed last.
pub fn summary(output: &Output) -> serde_json::Value {
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let text = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(text.lines().last().unwrap()).unwrap()
}

/// What a command that failed said.
pub fn refusal(output: &Output) -> String {
    assert!(!output.status.success());
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A path as text.
pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

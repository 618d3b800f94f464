//! SIGHUP: what can change while the server runs does, and a file that cannot be used changes nothing.

use crate::program::ServerProcess;
use std::path::Path;
use std::time::Duration;
use tests::{camera, create_session};
use tonic::Code;

fn write(file: &Path, max_sessions: u64, more: &str) {
    let text = format!("log_filter = \"warn\"\n[limits]\nmax_sessions = {max_sessions}\n{more}");
    std::fs::write(file, text).unwrap();
}

#[tokio::test]
async fn a_hangup_has_the_configuration_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("monoslam.toml");
    write(&file, 1, "");
    let server = ServerProcess::start_with(&folder.path().join("data"), |command| {
        command.arg("--config").arg(&file);
    });
    let mut client = server.client().await;
    create_session(&mut client, "a", camera(320, 240)).await.unwrap();
    let refused = create_session(&mut client, "b", camera(320, 240)).await.unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted, "{refused}");

    write(&file, 2, "max_loaded_sessions = 9\n");
    server.signal(libc::SIGHUP);
    let made = async {
        while create_session(&mut client, "b", camera(320, 240)).await.is_err() {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(10), made).await.expect("the new limit holds");

    write(&file, 3, "max_sesions = 9\n");
    server.signal(libc::SIGHUP);
    tokio::time::sleep(Duration::from_millis(500)).await;
    let refused = create_session(&mut client, "c", camera(320, 240)).await.unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted, "the old limit holds: {refused}");
    assert!(server.terminate());
}

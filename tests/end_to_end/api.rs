//! Every call and every route answers over a real socket, and `docs/api.md` lists them all, with what each
//! needs and where it is tested.
//!
//! After a change of the interface: `UPDATE_GENERATED=1 cargo test -p tests --test end_to_end api`.

use crate::isolation::{Owners, SESSION, ask, call, calls, owners, request, routes};
use server::access::Role;
use server::access::rules::{Need, of_call, of_route};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tonic::Code;

/// What does not answer with success, as there is nothing to tell of a session of one frame, it is not in
/// this version, or it is no plain request.
const OTHERWISE: [(&str, u16); 12] = [
    ("get /v1/operations/{operation}", 404),
    ("post /v1/operations/{operation}/cancel", 404),
    ("get /v1/sessions/{id}/frames/{sequence}/image", 404),
    ("get /v1/sessions/{id}/frames/{sequence}/observed", 404),
    ("get /v1/sessions/{id}/keyframes/{kf}", 404),
    ("get /v1/sessions/{id}/keyframes/{kf}/image", 404),
    ("get /v1/sessions/{id}/keyframes/{kf}/observed", 404),
    ("get /v1/sessions/{id}/mask", 404),
    ("get /v1/sessions/{id}/picture", 404),
    ("get /v1/sessions/{id}/primitives/{p}", 404),
    ("post /v1/sessions/{id}/merge", 400),
    ("get /v1/sessions/{id}/stream", 400),
];

fn need(need: Need) -> &'static str {
    match need {
        Need::Nothing => "nothing",
        Need::Metrics => "admin, or `access.public_metrics`",
        Need::Role(Role::Reader) => "reader",
        Need::Role(Role::Writer) => "writer",
        Need::Role(Role::Admin) => "admin",
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_call_and_route_answers_its_owner() {
    let Owners { server, ann, .. } = owners().await;
    let tests = tests_of_repository();
    let mut document = HEAD.to_owned();
    document.push_str("## gRPC\n\n| call | needs | tests |\n| --- | --- | --- |\n");
    let mut calls: Vec<String> = calls().iter().map(|call| call.name().to_owned()).collect();
    // What is deleted is not there for the others.
    calls.sort_by_key(|name| name == "DeleteSession");
    let mut rows = BTreeMap::new();
    for name in calls {
        let message = match name.as_str() {
            "ListSessions" => bytes::Bytes::new(),
            _ => request(&name, SESSION),
        };
        let mut answer = call(&server, &name, message.clone(), Some(&ann)).await;
        // The stream of a call before may be about to end.
        for _ in 0..100 {
            if !answer.as_ref().is_err_and(|status| status.code() == Code::FailedPrecondition) {
                break;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
            answer = call(&server, &name, message.clone(), Some(&ann)).await;
        }
        let code = answer.as_ref().err().map(tonic::Status::code);
        let expected = match name.as_str() {
            "GetOperation" | "CancelOperation" => Some(Code::NotFound),
            // Nothing is named to be joined.
            "MergeSessions" => Some(Code::InvalidArgument),
            // The request has a name that is taken and no camera.
            "CreateSession" => Some(Code::InvalidArgument),
            // A session of one frame has no keyframes, and an empty answer has no message.
            _ => None,
        };
        assert_eq!(code, expected, "{name}: {answer:?}");
        let needs = need(of_call(&format!("/monoslam.v1.SlamService/{name}")));
        let found = tests.naming(&[format!(".{}(", snake(&name)), helper(&name).to_owned()]);
        rows.insert(name.clone(), format!("| `{name}` | {needs} | {found} |\n"));
    }
    document.extend(rows.into_values());

    let Owners { server, ann, .. } = owners().await;
    document.push_str("\n## HTTP\n\n| route | needs | tests |\n| --- | --- | --- |\n");
    let mut routes = routes(&server).await;
    routes.sort_by_key(|(method, path)| method == "delete" && path.ends_with("{id}"));
    let mut rows = BTreeMap::new();
    for route in routes {
        let name = format!("{} {}", route.0, route.1);
        let needs = of_route(&route.0.to_uppercase().parse().expect("a method"), &route.1);
        let as_writer = !matches!(needs, Need::Metrics | Need::Role(Role::Admin));
        if as_writer && name != "post /v1/sessions" {
            let (mut status, mut answer) = ask(&server, &route, SESSION, Some(&ann)).await;
            // The operation of a route before may be about to end.
            for _ in 0..100 {
                if status != 409 {
                    break;
                }
                tokio::time::sleep(Duration::from_millis(100)).await;
                (status, answer) = ask(&server, &route, SESSION, Some(&ann)).await;
            }
            let expected = OTHERWISE.iter().find(|(other, _)| *other == name).map(|(_, status)| *status);
            let is_expected = expected.map_or((200..300).contains(&status), |expected| status == expected);
            assert!(is_expected, "{name}: {status} {answer}");
        }
        let last = route.1.rsplit('/').find(|segment| !segment.starts_with('{')).unwrap_or_default();
        let found = tests.naming(&[format!("/{last}\""), format!("/{last}?"), format!("/{last}/")]);
        let row = format!("| `{} {}` | {} | {found} |\n", route.0.to_uppercase(), route.1, need(needs));
        rows.insert((route.1, route.0), row);
    }
    document.extend(rows.into_values());

    let path = repository().join("docs/api.md");
    if std::env::var_os("UPDATE_GENERATED").is_some() {
        std::fs::write(&path, &document).unwrap();
    }
    let there = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(there == document, "docs/api.md is stale: see the head of {}", file!());
}

const HEAD: &str = "\
# Every call and route

Made by a test (`cargo test -p tests --test end_to_end api`), which asks each over a real socket, and fails when this
table is not what the server has. `isolation` asks each with another owner's token and with none. Where there is a
third test, it is the first other one that names the call or the end of the path. *Needs* is the
role of the token; what is not listed here needs `admin`. Beside these the HTTP port has the pages `/`, `/capture` and `/api`
with their files, and `/openapi.json`, which need nothing, and takes the calls by gRPC-Web. The gRPC port has health checks and
reflection, which need nothing either.

";

/// Tests that ask everything, or for what is not there.
const SHALLOW: [&str; 3] = ["api.rs", "bad_requests.rs", "isolation.rs"];

/// The tests over real sockets, by file and name, with their text.
struct Tests(Vec<(String, String)>);

fn tests_of_repository() -> Tests {
    let mut files: Vec<PathBuf> = std::fs::read_dir(repository().join("tests/end_to_end"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| !SHALLOW.iter().any(|name| path.ends_with(name)))
        .collect();
    files.push(repository().join("server/tests/maps/grpc.rs"));
    // Who is let in is asked of a few only.
    files.sort_by_key(|file| (file.ends_with("access.rs"), file.clone()));
    let mut tests = Vec::new();
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        let stem = file.file_stem().unwrap().to_string_lossy().into_owned();
        for part in text.split("#[tokio::test").skip(1) {
            let name = part.split_once("async fn ").and_then(|(_, rest)| rest.split_once('('));
            tests.extend(name.map(|(name, _)| (format!("{stem}::{name}"), part.to_owned())));
        }
    }
    assert!(tests.len() > 40, "{}", tests.len());
    Tests(tests)
}

impl Tests {
    /// This test, and the first of the others that has one of these in its text.
    fn naming(&self, patterns: &[String]) -> String {
        let mut found = "`api`, `isolation`".to_owned();
        let is_named =
            |text: &str| patterns.iter().any(|pattern| !pattern.is_empty() && text.contains(pattern));
        if let Some((name, _)) = self.0.iter().find(|(_, text)| is_named(text)) {
            let _ = write!(found, ", `{name}`");
        }
        found
    }
}

/// What tests open streams and make sessions with.
fn helper(call: &str) -> &'static str {
    match call {
        "StreamFrames" => "FrameStream::open(",
        "CreateSession" => "create_session(",
        _ => "",
    }
}

fn snake(name: &str) -> String {
    let mut snake = String::new();
    for (i, letter) in name.char_indices() {
        if letter.is_uppercase() && i > 0 {
            snake.push('_');
        }
        snake.push(letter.to_ascii_lowercase());
    }
    snake
}

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

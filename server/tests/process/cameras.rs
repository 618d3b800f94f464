//! `kill -9` while two clients extend one map: both go on where they were, in one frame of reference.

use crate::crash::stream;
use crate::program::{ServerProcess, check};
use proto::v1;
use tests::{Client, FrameStream, SmallWorld, create_session, open_message};

/// Frames of each session when the server is killed.
const KILLED_AT: [usize; 2] = [25, 55];
/// Frames of each session in all.
const N_FRAMES: usize = 80;
/// Frames in which a camera must have found its place again: two seconds.
const N_RELOCALIZING_FRAMES: usize = 20;

/// Streams what a session does not have of its first `until` frames; what was promised of it, and how many
/// frames came without a pose before the first that has one.
async fn go_on(mut client: Client, id: &'static str, until: usize) -> (Option<u64>, usize) {
    let world = SmallWorld::new(1);
    let mut frames = FrameStream::open(&mut client, open_message(id)).await.unwrap();
    let next = frames.opened.next_sequence as usize;
    let answers = stream(&mut frames, &world, next, until - next).await;
    let promised = answers.last().and_then(|answer| answer.durable_sequence);
    let found = answers.iter().position(|answer| answer.state() == v1::TrackingState::Tracked);
    (promised, found.unwrap_or(usize::MAX))
}

async fn sessions(client: &mut Client) -> Vec<v1::Session> {
    let listed = client.list_sessions(v1::ListSessionsRequest::default()).await.unwrap();
    listed.into_inner().sessions
}

#[tokio::test(flavor = "multi_thread")]
async fn both_cameras_of_a_map_go_on_where_they_were_when_the_server_was_killed() {
    let folder = tempfile::tempdir().unwrap();
    let mut promised = [None, None];
    for (kill, until) in KILLED_AT.into_iter().chain([N_FRAMES]).enumerate() {
        let server = ServerProcess::start(folder.path());
        let mut client = server.client().await;
        if kill == 0 {
            create_session(&mut client, "room", SmallWorld::new(1).camera()).await.unwrap();
            let added = v1::CreateSessionRequest {
                session_id: "second".into(),
                map: "room".into(),
                ..v1::CreateSessionRequest::default()
            };
            client.create_session(added).await.unwrap();
        }
        for (session, promised) in sessions(&mut client).await.iter().zip(promised) {
            assert!(session.durable_sequence >= promised, "{promised:?} of {} was promised", session.id);
            assert!(session.next_sequence >= promised.map_or(0, |sequence: u64| sequence + 1));
        }
        let streams = [("room", server.client().await), ("second", server.client().await)];
        let [first, second] = streams.map(|(id, client)| tokio::spawn(go_on(client, id, until)));
        let outcomes = [first.await.unwrap(), second.await.unwrap()];
        if kill > 0 {
            for (_, found) in outcomes {
                assert!(found < N_RELOCALIZING_FRAMES, "it took {found} frames to find the place again");
            }
        }
        promised = outcomes.map(|(promised, _)| promised);
        server.kill();
        check(folder.path());
    }
    let server = ServerProcess::start(folder.path());
    let sessions = sessions(&mut server.client().await).await;
    assert_eq!(sessions.iter().map(|session| session.n_submaps).collect::<Vec<_>>(), [1, 1]);
    assert_eq!(sessions[0].n_keyframes, sessions[1].n_keyframes);
    assert_eq!(sessions[1].map.as_deref(), Some("room"));
    assert!(server.terminate(), "the server ends well when asked to");
    check(folder.path());
}

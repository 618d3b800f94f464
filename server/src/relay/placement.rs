//! Which server answers what needs one: who works with the session, else who has room for it.

use super::Relay;
use super::target::Need;
use crate::fleet::operation_tag;
use crate::session::SessionId;
use std::time::Duration;
use store::{Holder, Owner, ServerRecord};
use tokio::time::Instant;

/// How long a session is waited for that its server hands over, because it stops. Each takes some tenths of a
/// second, one after the other.
const HANDOVER_PATIENCE: Duration = Duration::from_secs(5);

/// How often it is asked meanwhile whether it was.
const LOOK_AGAIN: Duration = Duration::from_millis(20);

/// Who answers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// This server.
    Here,
    /// Another one.
    There(Owner),
}

impl Relay {
    /// Who answers what needs the server that works with a session. If that cannot be found out, this server
    /// says why.
    pub(super) async fn place(&self, id: &SessionId, need: Need) -> Place {
        let (store, registry) = (&self.0.store, self.0.service.registry());
        // A stream into a session that this server hands over begins where it goes to.
        let goes_away = || need == Need::Stream && registry.is_leaving();
        if store.keeps(id.as_str()) && !goes_away() {
            return Place::Here;
        }
        let deadline = Instant::now() + HANDOVER_PATIENCE;
        loop {
            let Ok(holder) = store.holder(id.as_str()).await else { return Place::Here };
            let own_name = store.own_name();
            match holder {
                Some(Holder { server, .. }) if Some(server.name.as_str()) == own_name => {
                    if !goes_away() || Instant::now() > deadline {
                        return Place::Here;
                    }
                }
                Some(Holder { server, is_leaving }) => {
                    if !is_leaving || Instant::now() > deadline {
                        return Place::There(server);
                    }
                }
                None if need == Need::Stream && registry.own_load().n_free == 0 => {
                    let others = store.servers().await.unwrap_or_default();
                    let roomy = with_most_room(others, own_name);
                    return roomy.map_or(Place::Here, Place::There);
                }
                None => return Place::Here,
            }
            tokio::time::sleep(LOOK_AGAIN).await;
        }
    }

    /// The server that works on an operation, if its name says that it is another one.
    pub(super) async fn server_of_operation(&self, id: &str) -> Option<Owner> {
        let (tag, _) = id.strip_prefix("op-")?.split_once('-')?;
        let servers = self.0.store.servers().await.ok()?;
        let others = servers.into_iter().map(|record| record.server);
        let mut others = others.filter(|server| Some(server.name.as_str()) != self.0.store.own_name());
        others.find(|server| operation_tag(&server.name) == tag)
    }
}

/// The other server with the most room, if one has any.
fn with_most_room(servers: Vec<ServerRecord>, own_name: Option<&str>) -> Option<Owner> {
    let others = servers.into_iter().filter(|record| Some(record.server.name.as_str()) != own_name);
    let roomy = others.filter(|record| record.load.n_free > 0 && !record.load.is_leaving);
    roomy.max_by_key(|record| record.load.n_free).map(|record| record.server)
}

#[cfg(test)]
mod tests {
    use super::*;
    use store::Load;

    #[test]
    fn who_is_full_or_leaves_gets_nothing() {
        let record = |name: &str, n_free, is_leaving| ServerRecord {
            server: Owner { name: name.into(), grpc_url: String::new(), http_url: String::new() },
            version: String::new(),
            load: Load { n_free, is_leaving, ..Load::default() },
        };
        let chosen = |servers: &[ServerRecord]| {
            with_most_room(servers.to_vec(), Some("own")).map(|server| server.name)
        };
        let (own, full, leaving) =
            (record("own", 9, false), record("full", 0, false), record("gone", 8, true));
        let (some, more) = (record("some", 1, false), record("more", 2, false));
        assert_eq!(chosen(&[own.clone(), full.clone(), leaving.clone()]), None);
        assert_eq!(chosen(&[own, some, full, more, leaving]).as_deref(), Some("more"));
    }
}

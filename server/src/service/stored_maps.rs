//! What is asked of stored maps as a whole, and done to them.

use super::{LOCALIZATION_PATIENCE, METRES_PER_UNIT, Service, check_stored_bytes};
use crate::access::{self, Caller, Change};
use crate::error::{ApiError, ErrorCode};
use crate::localization::{Located, MAX_SESSIONS, Question};
use crate::operations::{Kind, Operation, Operations};
use crate::page::MAX_PAGE_SIZE;
use crate::scale::{self, Measurement, ScaleSource};
use crate::session::{SessionId, SessionView};
use slam::map::CameraId;
use std::hash::{BuildHasher, Hash, Hasher};
use std::time::Duration;
use store::{SessionChanges, SessionRecord};

impl Service {
    /// Says how many metres a map unit of a session is: directly, by what somebody measured, or that nobody
    /// knows.
    ///
    /// # Errors
    /// If there is none of this id, the number is not positive, or what was measured does not tell.
    pub async fn set_scale(
        &self,
        caller: &Caller,
        id: &SessionId,
        source: ScaleSource,
    ) -> Result<(SessionView, Option<Measurement>), ApiError> {
        self.registry.check_open()?;
        self.store.get_session(id.as_str()).await?;
        let measured = scale::measure(&self.store, id, &source).await?;
        let metres_per_unit = match source {
            ScaleSource::Given(metres) => Some(metres),
            _ => measured.as_ref().map(|measured| measured.metres_per_unit),
        };
        if metres_per_unit.is_some_and(|metres| !(metres.is_finite() && METRES_PER_UNIT.contains(&metres))) {
            let (least, most) = (METRES_PER_UNIT.start(), METRES_PER_UNIT.end());
            return Err(ApiError::invalid(
                "metres_per_unit",
                format!("must be a number from {least} to {most}"),
            ));
        }
        let changes = SessionChanges { metres_per_unit: Some(metres_per_unit), ..SessionChanges::default() };
        // The units are the map's, whoever extends it.
        let map = id.beside(&self.store.map_of(id.as_str()).await?.id);
        let store = async { Ok(self.store.update_session(map.as_str(), &changes).await?) };
        self.registry.set_scale(&map, metres_per_unit, store).await?;
        access::record(caller, Change::Scaled, id);
        Ok((self.get_session(id).await?, measured))
    }

    /// Locates one image in maps, as of their last commits, without changing anything.
    ///
    /// # Errors
    /// If there is no session of such an id, the image cannot be used, or too many wait. A place that is not
    /// found is no error.
    pub async fn localize(&self, question: Question) -> Result<Located, ApiError> {
        self.registry.check_open()?;
        for id in &question.sessions {
            self.store.get_session(id.as_str()).await?;
            self.soundness.require_sound(id.as_str())?;
        }
        let asked = self.localizations.clone().acquire_owned();
        let turn = tokio::time::timeout(LOCALIZATION_PATIENCE, asked).await;
        let turn = turn
            .map_err(|_elapsed| {
                let sentence = "as many images are being located as this server takes; try again later";
                ApiError::new(ErrorCode::TooBusy, sentence)
            })?
            .map_err(ApiError::internal)?;
        let limit_s = self.config().sessions.localize_timeout_s;
        let only = (question.sessions.len() == 1).then(|| question.sessions[0].clone());
        let locating = self.localization.locate(question, turn);
        let located = tokio::time::timeout(Duration::from_secs_f64(limit_s), locating).await;
        let located = located.map_err(|_elapsed| {
            let sentence = format!(
                "the image was not located within {limit_s} s, which is what this server spends on one \
                 (sessions.localize_timeout_s)"
            );
            ApiError::new(ErrorCode::TookTooLong, sentence)
        })?;
        located.inspect_err(|error| only.iter().for_each(|id| self.note_damage(id, error)))
    }

    /// All sessions of a caller, to look for an image in.
    ///
    /// # Errors
    /// If there is none, or there are more than are looked through at once.
    pub async fn sessions_to_search(&self, caller: &Caller) -> Result<Vec<SessionId>, ApiError> {
        let page = self.store.list_sessions_of(&caller.prefix(), None, MAX_PAGE_SIZE).await?;
        if page.next.is_some() || page.items.len() > MAX_SESSIONS {
            let sentence = format!("are more than {MAX_SESSIONS}; name those to look in");
            return Err(ApiError::invalid("all_sessions", sentence));
        }
        if page.items.is_empty() {
            return Err(ApiError::invalid("all_sessions", "there is no session to look in"));
        }
        // Each map once, whoever extends it.
        let maps = page.items.into_iter().filter(|record| record.map.is_none());
        let sound = maps.filter(|record| self.soundness.require_sound(&record.id).is_ok());
        Ok(sound.map(|record| caller.stored(record.id)).collect())
    }

    /// Names the state of a session's map and of what its lengths mean; another one after each change, and
    /// after each start of the server.
    ///
    /// # Errors
    /// If there is none of this id.
    pub async fn map_tag(&self, id: &SessionId) -> Result<String, ApiError> {
        let revision = self.registry.revision(id);
        let record = self.store.get_session(id.as_str()).await?;
        let mut hasher = self.tags.build_hasher();
        (id.as_str(), record.created_at_ns, record.last_frame).hash(&mut hasher);
        let changing = (revision, record.counts, record.metres_per_unit, record.correction, record.camera);
        format!("{changing:?}").hash(&mut hasher);
        Ok(format!("{:016x}", hasher.finish()))
    }

    /// Keeps what the motion sensors of a session's device measured; how many readings.
    ///
    /// # Errors
    /// If there is none of this id, the caller has stored as much as it may, or a line is no reading.
    pub async fn add_motion(&self, caller: &Caller, id: &SessionId, lines: &str) -> Result<usize, ApiError> {
        self.registry.check_open()?;
        check_stored_bytes(&self.store, caller).await?;
        self.motion().add(id, lines).await
    }

    /// Begins global bundle adjustment of a session's map.
    ///
    /// # Errors
    /// If there is none of this id, a client streams into it, another operation works on it, or too many
    /// wait.
    pub async fn optimize(&self, caller: &Caller, id: &SessionId) -> Result<Operation, ApiError> {
        let record = self.check_idle(id, "adjusting its map").await?;
        if let Some(map) = record.map {
            let map = id.beside(&map);
            let sentence = format!("session {id} extends the map of session {map}: have that one adjusted");
            return Err(ApiError::new(ErrorCode::MapShared, sentence));
        }
        let begun = self.operations.begin(caller, Kind::Optimize, id, None)?;
        access::record(caller, Change::Optimized, id);
        Ok(begun)
    }

    /// Begins to join one session's map and trajectory with another's.
    ///
    /// # Errors
    /// As [`Self::optimize`], or if the two are one.
    pub async fn merge(
        &self,
        caller: &Caller,
        into: &SessionId,
        from: &SessionId,
    ) -> Result<Operation, ApiError> {
        for id in [into, from] {
            let record = self.check_idle(id, "joining it with another").await?;
            if record.map.is_some() || record.last_camera != CameraId::default() {
                let sentence = format!(
                    "the map of session {id} is of several cameras; such maps cannot be joined with others"
                );
                return Err(ApiError::new(ErrorCode::MapShared, sentence));
            }
        }
        if into == from {
            return Err(ApiError::invalid("from", "must be another session than the one it is joined with"));
        }
        check_stored_bytes(&self.store, caller).await?;
        let begun = self.operations.begin(caller, Kind::Merge, into, Some(from))?;
        access::record(caller, Change::Merged, into);
        Ok(begun)
    }

    /// What takes long.
    pub fn operations(&self) -> &Operations {
        &self.operations
    }

    async fn check_idle(&self, id: &SessionId, purpose: &str) -> Result<SessionRecord, ApiError> {
        self.registry.check_open()?;
        let record = self.store.get_session(id.as_str()).await?;
        self.soundness.require_sound(id.as_str())?;
        if self.registry.view(id).is_some_and(|view| view.has_writer) {
            let sentence = format!("a client streams into session {id}; end its stream before {purpose}");
            return Err(ApiError::new(ErrorCode::WriterConnected, sentence));
        }
        Ok(record)
    }
}

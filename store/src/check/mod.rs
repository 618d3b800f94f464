//! Whether everything stored makes sense.

mod lines;
mod points;
mod poses;
mod primitives;
mod taken;

use crate::engine::{Connection, query};
use crate::{SessionCounts, SessionRecord, Store, StoreError};
use slam::map::KeyframeId;
use std::collections::BTreeMap;
use std::fmt;

/// Something that is wrong with the database.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The session it concerns; `None` for the whole file.
    pub session: Option<String>,
    /// What is wrong, in a plain sentence.
    pub what: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.session {
            Some(session) => write!(f, "session {session:?}: {}", self.what),
            None => f.write_str(&self.what),
        }
    }
}

/// Findings reported per session and for the file: enough to see what happened, and no more memory than that.
const MAX_PROBLEMS: usize = 100;

/// Collects what is wrong with one session, or the file.
struct Findings {
    session: Option<String>,
    found: Vec<Finding>,
    n_more: usize,
}

impl Findings {
    fn new(session: Option<String>) -> Self {
        Self { session, found: Vec::new(), n_more: 0 }
    }

    fn add(&mut self, what: impl fmt::Display) {
        if self.found.len() < MAX_PROBLEMS {
            self.found.push(Finding { session: self.session.clone(), what: what.to_string() });
        } else {
            self.n_more += 1;
        }
    }

    /// Notes an error that says that something is damaged; hands on any other.
    fn note<T>(&mut self, result: Result<T, StoreError>) -> Result<Option<T>, StoreError> {
        match result {
            Ok(value) => Ok(Some(value)),
            Err(StoreError::Corrupt(what)) => {
                self.add(what);
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    fn finish(mut self, into: &mut Vec<Finding>) {
        let n_more = self.n_more;
        if n_more > 0 {
            self.found.push(Finding { session: self.session, what: format!("{n_more} further problems") });
        }
        into.append(&mut self.found);
    }
}

impl Store {
    /// Looks at everything stored and lists what is wrong; an empty list is good news. Answers for the last
    /// commit before it began.
    ///
    /// Checks the file (`integrity_check`, `foreign_key_check`, the R*Tree) and the maps: sessions' cameras
    /// and counts, poses that are finite with unit quaternions, features that can be read, observations of
    /// keyframes and features that exist, removed keyframes that hang on something, time that rises with
    /// the frames' numbers.
    ///
    /// # Errors
    /// If the database cannot be read at all.
    pub async fn check(&self) -> Result<Vec<Finding>, StoreError> {
        let mut problems = Vec::new();
        let mut transaction = self.begin_read().await?;
        check_file(&mut transaction, &mut problems).await?;
        check_places(&mut transaction, &mut problems).await?;
        check_sessions(&mut transaction, &mut problems).await?;
        // It only read: nothing is lost with it, and after a damaged page it may not end as it should.
        drop(transaction);
        Ok(problems)
    }

    /// [`Self::check`] of the sessions without the file.
    pub(crate) async fn check_sessions(&self) -> Result<Vec<Finding>, StoreError> {
        let mut problems = Vec::new();
        let mut transaction = self.begin_read().await?;
        check_sessions(&mut transaction, &mut problems).await?;
        // It only read: nothing is lost with it, and after a damaged page it may not end as it should.
        drop(transaction);
        Ok(problems)
    }

    /// [`Self::check`] of the file without what this version of the program keeps in it.
    pub(crate) async fn check_file_alone(&self) -> Result<Vec<Finding>, StoreError> {
        let mut problems = Vec::new();
        let mut reader = self.reader().await?;
        check_file(&mut reader, &mut problems).await?;
        Ok(problems)
    }
}

async fn check_sessions(connection: &mut Connection, problems: &mut Vec<Finding>) -> Result<(), StoreError> {
    let sessions = query("SELECT number, id FROM sessions WHERE id IS NOT NULL ORDER BY id")
        .fetch_all(&mut *connection)
        .await;
    let mut of_table = Findings::new(None);
    let sessions = of_table.note(sessions)?.unwrap_or_default();
    of_table.finish(problems);
    for row in sessions {
        let mut found = Findings::new(Some(row.try_get(1)?));
        let checked = check_session(connection, row.try_get(0)?, &mut found).await;
        // A page that cannot be read ends the look at this session alone.
        found.note(checked)?;
        found.finish(problems);
    }
    Ok(())
}

async fn check_file(connection: &mut Connection, problems: &mut Vec<Finding>) -> Result<(), StoreError> {
    // PostgreSQL looks after its files itself (data checksums, amcheck).
    if let Connection::Postgres(..) = connection {
        return Ok(());
    }
    let mut found = Findings::new(None);
    // The argument bounds how many lines are reported.
    let lines = query("PRAGMA integrity_check(100)").scalars(&mut *connection).await;
    let lines: Vec<String> = found.note(lines)?.unwrap_or_default();
    lines.iter().filter(|line| *line != "ok").for_each(|line| found.add(line));
    let dangling = query("PRAGMA foreign_key_check").fetch_all(&mut *connection).await;
    for row in &found.note(dangling)?.unwrap_or_default() {
        let (table, parent): (String, String) = (row.try_get(0)?, row.try_get(2)?);
        found.add(format!("a row of {table} refers to one of {parent} that is not there"));
    }
    found.finish(problems);
    Ok(())
}

/// Checks the R*Trees of spatial queries; PostgreSQL's indexes are its own.
async fn check_places(connection: &mut Connection, problems: &mut Vec<Finding>) -> Result<(), StoreError> {
    if let Connection::Postgres(..) = connection {
        return Ok(());
    }
    let mut found = Findings::new(None);
    for statement in ["SELECT rtreecheck('point_cells')", "SELECT rtreecheck('line_cells')"] {
        let tree = query(statement).only(&mut *connection).await;
        let tree: Option<String> = found.note(tree)?;
        if let Some(tree) = tree.filter(|tree| tree != "ok") {
            found.add(tree);
        }
    }
    found.finish(problems);
    Ok(())
}

/// How many keypoints, segments and vanishing points each keyframe has, which observations are checked
/// against.
type Measured = BTreeMap<KeyframeId, [usize; 3]>;

async fn check_session(
    connection: &mut Connection,
    session: i64,
    problems: &mut Findings,
) -> Result<(), StoreError> {
    let row =
        query("SELECT * FROM sessions WHERE number = $1").bind(session).fetch_one(&mut *connection).await?;
    let record = problems.note(crate::session::parse_session(&row))?;
    if let Some((_, record)) = &record
        && record.map.is_some()
    {
        return check_added(connection, (session, record), problems).await;
    }
    let measured = poses::check_keyframes(connection, session, problems).await?;
    check_cameras(connection, session, problems).await?;
    poses::check_removed(connection, session, problems).await?;
    let n_points = points::check_points(connection, session, &measured, problems).await?;
    let primitives = primitives::check_primitives(connection, session, &measured, problems).await?;
    let n_lines = lines::check_lines(connection, session, &measured, &primitives, problems).await?;
    let (n_frames, last_frame) = poses::check_frames(connection, session, problems).await?;

    let Some((_, record)) = record else { return Ok(()) };
    problems.note(record.checked_camera())?;
    let counts = [
        ("frames", record.counts.n_frames, n_frames),
        ("keyframes", record.counts.n_keyframes, measured.len() as u64),
        ("points", record.counts.n_points, n_points),
        ("lines", record.counts.n_lines, n_lines),
        ("primitives", record.counts.n_primitives, primitives.len() as u64),
    ];
    for (what, claimed, counted) in counts.into_iter().filter(|(_, claimed, counted)| claimed != counted) {
        problems.add(format!("it claims {claimed} {what} but has {counted}"));
    }
    if record.last_frame != last_frame {
        problems.add(format!("it claims {:?} as its last frame but has {last_frame:?}", record.last_frame));
    }
    Ok(())
}

/// Checks that keyframes are of cameras that are known.
async fn check_cameras(
    connection: &mut Connection,
    session: i64,
    problems: &mut Findings,
) -> Result<(), StoreError> {
    let unknown: Vec<i64> = query(
        "SELECT id FROM keyframes k WHERE session = $1 AND camera <> 0
         AND NOT EXISTS (SELECT 1 FROM added_cameras a WHERE a.session = k.session AND a.camera = k.camera) ORDER BY id",
    )
    .bind(session)
    .scalars(connection)
    .await?;
    unknown
        .iter()
        .for_each(|id| problems.add(format!("keyframe {id} is of a camera that nothing is known of")));
    Ok(())
}

/// Checks a session whose camera extends the map of another, which is checked with that.
async fn check_added(
    connection: &mut Connection,
    (session, record): (i64, &SessionRecord),
    problems: &mut Findings,
) -> Result<(), StoreError> {
    problems.note(record.checked_camera())?;
    let (n_frames, last_frame) = poses::check_frames(connection, session, problems).await?;
    if record.counts.n_frames != n_frames {
        problems.add(format!("it claims {} frames but has {n_frames}", record.counts.n_frames));
    }
    if record.last_frame != last_frame {
        problems.add(format!("it claims {:?} as its last frame but has {last_frame:?}", record.last_frame));
    }
    let map = query("SELECT * FROM sessions WHERE id = $1 AND map IS NULL").bind(record.map.as_deref());
    let Some(map) = map.fetch_optional(connection).await? else {
        problems.add("the session whose map it extends is not there");
        return Ok(());
    };
    let Some((_, map)) = problems.note(crate::session::parse_session(&map))? else { return Ok(()) };
    let of_map = |record: &SessionRecord| SessionCounts { n_frames: 0, ..record.counts };
    if of_map(record) != of_map(&map) {
        problems.add(format!("it claims {:?} of a map that has {:?}", of_map(record), of_map(&map)));
    }
    Ok(())
}

//! Checks of global primitives and their observations.

use super::taken::Taken;
use super::{Findings, Measured};
use crate::StoreError;
use crate::engine::{Connection, query};
use crate::primitives::{PRIMITIVE_COLUMNS, parse_primitive};
use futures_util::TryStreamExt;
use slam::map::PrimitiveId;
use std::collections::BTreeSet;

/// Checks primitives with their observations; which there are.
pub(super) async fn check_primitives(
    connection: &mut Connection,
    session: i64,
    measured: &Measured,
    problems: &mut Findings,
) -> Result<BTreeSet<PrimitiveId>, StoreError> {
    let mut vanishing =
        Taken::new(["primitive", "vanishing point"], measured, |[.., n_vanishing]| n_vanishing);
    let mut primitives = BTreeSet::new();
    let sql = format!("SELECT {PRIMITIVE_COLUMNS} FROM primitives WHERE session = $1 ORDER BY id");
    let mut rows = query(sql).bind(session).fetch(connection);
    while let Some(row) = rows.try_next().await? {
        let Some(primitive) = problems.note(parse_primitive(&row))? else { continue };
        for seen in &primitive.observations {
            vanishing.take(&primitive.id, seen.keyframe, seen.vanishing_idx, problems);
        }
        primitives.insert(primitive.id);
    }
    Ok(primitives)
}

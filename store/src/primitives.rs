//! Global primitives: their rows, alone and in pages.

use crate::blob::{decode_covariance, decode_observations};
use crate::cameras::map_number;
use crate::engine::{Connection, Row, query};
use crate::number::{from_column, keyframe_id, primitive_id, submap_id, to_column};
use crate::{Page, Store, StoreError};
use geometry::Direction;
use nalgebra::Vector3;
use slam::map::{GlobalPrimitive, PrimitiveId, PrimitiveObservation, SubmapId};

/// A stored primitive.
#[derive(Clone, Debug, PartialEq)]
pub struct PrimitiveRecord {
    /// The primitive.
    pub primitive: GlobalPrimitive,
    /// Lines that have its direction.
    pub n_lines: u64,
}

/// The columns of a primitive after its session, in the order [`parse_primitive`] expects.
pub(crate) const PRIMITIVE_COLUMNS: &str = "id, submap, direction_x, direction_y, direction_z, covariance, created_by, \
     n_observations, observations";

impl Store {
    /// Up to `page_size` primitives with ids above the given one, of one submap or of all.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn primitives_page(
        &self,
        session: &str,
        submap: Option<SubmapId>,
        after: Option<PrimitiveId>,
        page_size: u32,
    ) -> Result<Page<PrimitiveRecord, PrimitiveId>, StoreError> {
        let sql = format!(
            "SELECT {PRIMITIVE_COLUMNS},
                 (SELECT count(*) FROM lines l WHERE l.session = p.session AND l.primitive = p.id)
             FROM primitives p WHERE session = $1 AND id > $2 AND submap = coalesce($3, submap) ORDER BY id LIMIT $4"
        );
        let mut reader = self.reader().await?;
        let number = map_number(&mut reader, session).await?;
        let rows = query(sql)
            .bind(number)
            .bind(after.map_or(Ok(0), |id| to_column("primitive id", id.get()))?)
            .bind(submap.map(|submap| submap.0))
            .bind(i64::from(page_size) + 1)
            .fetch_all(&mut reader)
            .await?;
        let primitives = rows.iter().map(parse_record).collect::<Result<Vec<_>, _>>()?;
        Ok(Page::of(primitives, page_size, |last| last.primitive.id))
    }

    /// One primitive; `None` if the session has none with this id, or no longer.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn primitive(
        &self,
        session: &str,
        id: PrimitiveId,
    ) -> Result<Option<PrimitiveRecord>, StoreError> {
        let sql = format!(
            "SELECT {PRIMITIVE_COLUMNS},
                 (SELECT count(*) FROM lines l WHERE l.session = p.session AND l.primitive = p.id)
             FROM primitives p WHERE session = $1 AND id = $2"
        );
        let mut reader = self.reader().await?;
        let number = map_number(&mut reader, session).await?;
        let row = query(sql)
            .bind(number)
            .bind(to_column("primitive id", id.get())?)
            .fetch_optional(&mut reader)
            .await?;
        row.as_ref().map(parse_record).transpose()
    }
}

/// Every primitive of a session in the order of their ids.
pub(crate) async fn read_primitives(
    connection: &mut Connection,
    session: i64,
) -> Result<Vec<GlobalPrimitive>, StoreError> {
    let sql = format!("SELECT {PRIMITIVE_COLUMNS} FROM primitives WHERE session = $1 ORDER BY id");
    let rows = query(sql).bind(session).fetch_all(connection).await?;
    rows.iter().map(parse_primitive).collect()
}

fn parse_record(row: &Row) -> Result<PrimitiveRecord, StoreError> {
    Ok(PrimitiveRecord {
        primitive: parse_primitive(row)?,
        n_lines: from_column("n_lines", row.try_get(9)?)?,
    })
}

/// A primitive from [`PRIMITIVE_COLUMNS`].
pub(crate) fn parse_primitive(row: &Row) -> Result<GlobalPrimitive, StoreError> {
    let id = primitive_id(row.try_get(0)?)?;
    let corrupt = |what: &dyn std::fmt::Display| StoreError::Corrupt(format!("primitive {id}: {what}"));
    let direction = Vector3::new(row.try_get(2)?, row.try_get(3)?, row.try_get(4)?);
    let observations = decode_observations(row.try_get(8)?).map_err(|error| corrupt(&error))?;
    let n_observations: i64 = row.try_get(7)?;
    if n_observations != observations.len() as i64 {
        return Err(corrupt(&"it has the wrong number of observations"));
    }
    let seen = |seen: slam::map::Observation| PrimitiveObservation {
        keyframe: seen.keyframe,
        vanishing_idx: seen.feature_idx,
    };
    Ok(GlobalPrimitive {
        id,
        submap: submap_id(row.try_get(1)?)?,
        direction: Direction::from_stored(direction).ok_or_else(|| corrupt(&"it is no direction"))?,
        covariance: decode_covariance(row.try_get(5)?).map_err(|error| corrupt(&error))?,
        created_by: keyframe_id(row.try_get(6)?)?,
        observations: observations.into_iter().map(seen).collect(),
    })
}

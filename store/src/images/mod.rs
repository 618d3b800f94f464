//! Images of keyframes: in the database, or, where there is one, in an object store ([`Objects`]).
//!
//! An object is written once, under a name that says what is in it and in which hour it was written, and is
//! named by the database only once it is there. What no row names for long enough is removed
//! ([`Store::collect_orphans`]); what is being uploaded is never that old.

mod objects;
mod orphans;

pub use objects::{ObjectOptions, Objects};
pub use orphans::Collected;

use crate::cameras::map_number;
use crate::engine::{Connection, Row, query};
use crate::number::{keyframe_column, to_column};
use crate::{Finding, KeyframeImage, Store, StoreError, StoredImage};
use futures_util::stream::{StreamExt, TryStreamExt};
use slam::map::{KeyframeId, MapUpdate};
use std::collections::BTreeMap;

/// Images that are uploaded at the same time: a round trip takes some tens of milliseconds, and a commit has
/// a few.
const UPLOADS_AT_ONCE: usize = 8;

/// An image on its way into the database.
pub(crate) struct Placed<'a> {
    keyframe: i64,
    media_type: &'a str,
    bytes: &'a [u8],
    /// Its object, if its bytes are there.
    object: Option<String>,
}

impl Store {
    /// With images in an object store from now on; those that are in the database stay there.
    pub fn with_objects(mut self, objects: Option<Objects>) -> Self {
        self.objects = objects;
        self
    }

    /// The image of a keyframe; `None` if it was not kept.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], [`StoreError::Objects`] if it cannot be fetched, and
    /// [`StoreError::Corrupt`] if it is not what was stored.
    pub async fn keyframe_image(
        &self,
        session: &str,
        id: KeyframeId,
    ) -> Result<Option<StoredImage>, StoreError> {
        let mut reader = self.reader().await?;
        let number = map_number(&mut reader, session).await?;
        let select =
            "SELECT media_type, bytes, object FROM keyframe_images WHERE session = $1 AND keyframe = $2";
        let row = query(select).bind(number).bind(keyframe_column(id)?).fetch_optional(&mut reader).await?;
        // Not held while the image is fetched.
        drop(reader);
        let Some(row) = row else { return Ok(None) };
        let (media_type, object): (String, Option<String>) = (row.try_get(0)?, row.try_get(2)?);
        let bytes = match object {
            None => row.try_get(1)?,
            Some(object) => self.objects()?.get(&object).await?,
        };
        Ok(Some(StoredImage { media_type, bytes }))
    }

    /// Brings images of keyframes that are in the map to where they belong, before the rows are written that
    /// name them.
    pub(crate) async fn place_images<'a>(
        &self,
        update: &MapUpdate,
        images: &'a [KeyframeImage],
    ) -> Result<Vec<Placed<'a>>, StoreError> {
        let images = images.iter().filter(|image| update.map.keyframe(image.keyframe).is_some());
        let placing = images.map(|image| async move {
            let object = match &self.objects {
                Some(objects) => Some(objects.put(&image.bytes).await?),
                None => None,
            };
            let keyframe = keyframe_column(image.keyframe)?;
            Ok(Placed { keyframe, media_type: &image.media_type, bytes: &image.bytes, object })
        });
        // In their order, so that what is written does not depend on time.
        let placing: Vec<_> = placing.collect();
        futures_util::stream::iter(placing).buffered(UPLOADS_AT_ONCE).try_collect().await
    }

    /// Copies the images of a session from another database; into the object store, if there is one here.
    pub(crate) async fn copy_images(
        &self,
        source: &mut Connection,
        original: i64,
        number: i64,
    ) -> Result<(), StoreError> {
        let select = "SELECT keyframe, media_type, bytes, object, object_bytes FROM keyframe_images
             WHERE session = $1 ORDER BY keyframe";
        let mut rows = query(select).bind(original).fetch(source);
        while let Some(row) = rows.try_next().await? {
            let (keyframe, media_type): (i64, String) = (row.try_get(0)?, row.try_get(1)?);
            let (bytes, known): (&[u8], Option<String>) = (row.try_get(2)?, row.try_get(3)?);
            let mut n_bytes: i64 = row.try_get(4)?;
            let object = match (known, &self.objects) {
                (Some(object), Some(objects)) => {
                    objects.require(&object).await?;
                    Some(object)
                }
                (None, Some(objects)) => {
                    n_bytes = bytes.len() as i64;
                    Some(objects.put(bytes).await?)
                }
                (known, None) => known,
            };
            let bytes = if object.is_some() { &[][..] } else { bytes };
            let mut transaction = self.begin_write().await?;
            query(
                "INSERT INTO keyframe_images (session, keyframe, media_type, bytes, object, object_bytes)
                 VALUES ($1, $2, $3, $4, $5, $6)",
            )
            .bind(number)
            .bind(keyframe)
            .bind(media_type)
            .bind(bytes)
            .bind(object)
            .bind(n_bytes)
            .execute(&mut transaction)
            .await?;
            transaction.commit().await?;
        }
        Ok(())
    }

    /// How many images the database has in an object store.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn n_image_objects(&self) -> Result<u64, StoreError> {
        let mut reader = self.reader().await?;
        let n: i64 =
            query("SELECT count(*) FROM keyframe_images WHERE object IS NOT NULL").only(&mut reader).await?;
        Ok(n.unsigned_abs())
    }

    /// Compares the images that the database has in the object store with what is there, without reading
    /// them; what is missing or of another length is told.
    ///
    /// # Errors
    /// If either cannot be read.
    pub async fn check_objects(&self) -> Result<Vec<Finding>, StoreError> {
        let there: BTreeMap<String, u64> = self.objects()?.list().try_collect().await?;
        let mut reader = self.reader().await?;
        let mut rows = query(
            "SELECT s.id, i.keyframe, i.object, i.object_bytes FROM keyframe_images i
             JOIN sessions s ON s.number = i.session WHERE i.object IS NOT NULL AND s.id IS NOT NULL
             ORDER BY s.id, i.keyframe",
        )
        .fetch(&mut reader);
        let mut found = Vec::new();
        while let Some(row) = rows.try_next().await? {
            let (object, n_bytes): (String, i64) = (row.try_get(2)?, row.try_get(3)?);
            let what = match there.get(&object) {
                Some(n) if i64::try_from(*n).is_ok_and(|n| n == n_bytes) => continue,
                Some(n) => format!("has {n} bytes in the object store and {n_bytes} in the database"),
                None => "is missing in the object store".to_owned(),
            };
            let keyframe: i64 = row.try_get(1)?;
            let what = format!("the image of keyframe {keyframe}, {object}, {what}");
            found.push(Finding { session: Some(row.try_get(0)?), what });
        }
        Ok(found)
    }

    fn objects(&self) -> Result<&Objects, StoreError> {
        self.objects.as_ref().ok_or_else(|| {
            StoreError::Objects(
                "images lie in an object store, and none is configured (storage.objects)".into(),
            )
        })
    }
}

/// Writes rows of images.
pub(crate) async fn write_images(
    connection: &mut Connection,
    session: i64,
    images: &[Placed<'_>],
) -> Result<(), StoreError> {
    for image in images {
        let bytes = if image.object.is_some() { &[][..] } else { image.bytes };
        let n_object_bytes = if image.object.is_some() { image.bytes.len() as u64 } else { 0 };
        query(
            "INSERT INTO keyframe_images (session, keyframe, media_type, bytes, object, object_bytes)
             VALUES ($1, $2, $3, $4, $5, $6) ON CONFLICT (session, keyframe) DO UPDATE SET
             media_type = excluded.media_type, bytes = excluded.bytes, object = excluded.object,
             object_bytes = excluded.object_bytes",
        )
        .bind(session)
        .bind(image.keyframe)
        .bind(image.media_type)
        .bind(bytes)
        .bind(&image.object)
        .bind(to_column("the size of an image", n_object_bytes)?)
        .execute(&mut *connection)
        .await?;
    }
    Ok(())
}

/// SHA-256 of the image of a row that has its bytes and its object in these columns: the same wherever it
/// lies.
pub(crate) fn image_hash(row: &Row, bytes: usize, object: usize) -> Result<[u8; 32], StoreError> {
    match row.try_get::<Option<String>, _>(object)? {
        Some(object) => objects::hash_in(&object),
        None => Ok(objects::hash_of(row.try_get(bytes)?)),
    }
}

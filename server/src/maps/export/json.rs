//! One object with everything, written piece by piece.

use super::Export;
use crate::error::ApiError;
use crate::maps::{Keyframe, Line, Point, Primitive};
use crate::model::Camera;
use serde::Serialize;
use slam::map::PrimitiveId;
use std::collections::BTreeMap;

pub(super) async fn write(export: &mut Export) -> Result<(), ApiError> {
    let id = serde_json::to_string(&export.session.id.to_string()).map_err(ApiError::internal)?;
    let camera = serde_json::to_string(&Camera::from(export.camera())).map_err(ApiError::internal)?;
    let scale = serde_json::to_string(&export.units.scale()).map_err(ApiError::internal)?;
    let head = format!("{{\"session_id\":{id},\"scale\":{scale},\"camera\":{camera},\"keyframes\":[");
    export.out.write(&head).await?;
    write_keyframes(export).await?;
    export.out.write("\n],\"points\":[").await?;
    write_points(export).await?;
    export.out.write("\n],\"lines\":[").await?;
    let n_lines = write_lines(export).await?;
    export.out.write("\n],\"primitives\":[").await?;
    let primitives = export.snapshot.primitives().await?;
    let wanted = primitives.iter().filter(|primitive| export.wants(primitive.submap));
    let rows: Vec<Primitive> = wanted
        .map(|primitive| Primitive::new(primitive, n_lines.get(&primitive.id).copied().unwrap_or(0)))
        .collect();
    write_rows(export, &rows, &mut "\n").await?;
    export.out.write("\n]}\n").await
}

/// Writes rows with commas between, also between those of one call and the next.
async fn write_rows<T: Serialize>(
    export: &mut Export,
    rows: &[T],
    separator: &mut &'static str,
) -> Result<(), ApiError> {
    for row in rows {
        export.out.write(separator).await?;
        export.out.write(&serde_json::to_string(row).map_err(ApiError::internal)?).await?;
        *separator = ",\n";
    }
    Ok(())
}

async fn write_keyframes(export: &mut Export) -> Result<(), ApiError> {
    let (mut after, mut separator) = (None, "\n");
    loop {
        let records = export.snapshot.keyframes_after(after).await?;
        let Some(last) = records.last() else { return Ok(()) };
        after = Some(last.id);
        let wanted = records.iter().filter(|record| export.wants(record.submap));
        let rows: Vec<_> = wanted.map(|record| Keyframe::new(record, export.units)).collect();
        write_rows(export, &rows, &mut separator).await?;
    }
}

async fn write_points(export: &mut Export) -> Result<(), ApiError> {
    let (mut after, mut separator) = (None, "\n");
    loop {
        let points = export.snapshot.points_after(after, export.submap).await?;
        let Some(last) = points.last() else { return Ok(()) };
        after = Some(last.id);
        let rows: Vec<_> = points.iter().map(|point| Point::new(point, export.units)).collect();
        write_rows(export, &rows, &mut separator).await?;
    }
}

/// Writes lines; how many of them each primitive has.
async fn write_lines(export: &mut Export) -> Result<BTreeMap<PrimitiveId, u64>, ApiError> {
    let (mut after, mut separator) = (None, "\n");
    let mut n_lines = BTreeMap::new();
    loop {
        let lines = export.snapshot.lines_after(after, export.submap).await?;
        let Some(last) = lines.last() else { return Ok(n_lines) };
        after = Some(last.id);
        lines.iter().filter_map(|line| line.primitive).for_each(|id| *n_lines.entry(id).or_default() += 1);
        let rows: Vec<_> = lines.iter().map(|line| Line::new(line, export.units)).collect();
        write_rows(export, &rows, &mut separator).await?;
    }
}

//! Polygon file format, ASCII 1.0 (Turk 1994): points, then the ends of the lines, as vertices; lines as
//! edges.

use super::Export;
use crate::error::ApiError;
use crate::model::Scale;
use slam::map::PrimitiveId;
use std::fmt::Write;

pub(super) type Color = [u8; 3];

/// Lines without a primitive.
pub(super) const BLUE: Color = [70, 130, 220];
/// Lines with one: colors that follow one another differ clearly.
const PALETTE: [Color; 6] =
    [[230, 60, 60], [60, 180, 75], [245, 165, 30], [150, 60, 200], [70, 200, 200], [220, 90, 180]];

pub(super) async fn write(export: &mut Export) -> Result<(), ApiError> {
    let (n_points, n_lines) = export.snapshot.n_landmarks(export.submap).await?;
    let scale = match export.units.scale() {
        Scale::Metric => "metres",
        Scale::UpToScale => "map units",
    };
    let head = format!(
        "ply\nformat ascii 1.0\ncomment points as vertices, lines as edges; lengths in {scale}\n\
         element vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         element edge {n_lines}\nproperty int vertex1\nproperty int vertex2\nend_header\n",
        n_points + 2 * n_lines
    );
    export.out.write(&head).await?;
    write_points(export).await?;
    write_ends(export).await?;
    for line in 0..n_lines {
        let first = n_points + 2 * line;
        export.out.write(&format!("{first} {}\n", first + 1)).await?;
    }
    Ok(())
}

async fn write_points(export: &mut Export) -> Result<(), ApiError> {
    let mut after = None;
    loop {
        let points = export.snapshot.points_after(after, export.submap).await?;
        let Some(last) = points.last() else { return Ok(()) };
        after = Some(last.id);
        let grays = export.grays(&points).await?;
        let mut text = String::new();
        for (point, gray) in points.iter().zip(grays) {
            push_vertex(&mut text, export.units.position(&point.position), [gray; 3]);
        }
        export.out.write(&text).await?;
    }
}

async fn write_ends(export: &mut Export) -> Result<(), ApiError> {
    let mut after = None;
    loop {
        let lines = export.snapshot.lines_after(after, export.submap).await?;
        let Some(last) = lines.last() else { return Ok(()) };
        after = Some(last.id);
        let mut text = String::new();
        for line in &lines {
            let color = line.primitive.map_or(BLUE, color_of);
            line.endpoints.iter().for_each(|end| push_vertex(&mut text, export.units.position(end), color));
        }
        export.out.write(&text).await?;
    }
}

/// The color of a primitive's lines.
pub(super) fn color_of(primitive: PrimitiveId) -> Color {
    PALETTE[(primitive.get() % PALETTE.len() as u64) as usize]
}

fn push_vertex(text: &mut String, [x, y, z]: [f64; 3], [red, green, blue]: Color) {
    // Writing to a string cannot fail.
    let _ = writeln!(text, "{x} {y} {z} {red} {green} {blue}");
}

//! `monoslam scale`: how many metres a map unit is.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::{ArgGroup, Args};
use proto::v1;
use proto::v1::reference_position::Frame;
use proto::v1::scale_place::Place;
use proto::v1::set_scale_request::Reference;
use serde_json::json;

use super::{ServerArgs, positive, session_id};

/// Rows that disagree named one by one, at most.
const MAX_NAMED: usize = 20;

/// Which session, and how its scale is known.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("how").required(true).args(["metres", "free", "distance", "positions"]))]
pub struct ScaleArgs {
    /// The session
    #[arg(value_name = "NAME", value_parser = session_id)]
    session: String,
    #[command(flatten)]
    server: ServerArgs,
    /// Metres per map unit
    #[arg(long, value_name = "M", value_parser = positive)]
    metres: Option<f64>,
    /// Nobody knows: lengths are map units
    #[arg(long)]
    free: bool,
    /// Metres between --from and --to
    #[arg(long, value_name = "M", value_parser = positive, requires = "from", requires = "to")]
    distance: Option<f64>,
    /// A place: point:ID, keyframe:ID (where the camera was), or keyframe:ID@X,Y (what its pixel shows)
    #[arg(long, value_name = "PLACE", value_parser = place, requires = "distance")]
    from: Option<v1::ScalePlace>,
    /// The other place, likewise
    #[arg(long, value_name = "PLACE", value_parser = place, requires = "distance")]
    to: Option<v1::ScalePlace>,
    /// Positions of the camera: lines of `SEQUENCE X Y Z` or, with --by-time, `SECONDS X Y Z` by the frames'
    /// clock; metres; more columns are passed over, so that TUM trajectories do
    #[arg(long, value_name = "FILE")]
    positions: Option<PathBuf>,
    /// The first column of --positions is a time, seconds
    #[arg(long, requires = "positions")]
    by_time: bool,
    /// Rows of --positions that are this far off or farther are left out, metres [default: those that the
    /// others contradict]
    #[arg(long, value_name = "M", value_parser = positive, requires = "positions")]
    max_error: Option<f64>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Sets it.
pub async fn run(args: ScaleArgs) -> Result<()> {
    let reference = match (&args.distance, &args.positions) {
        (Some(metres), _) => {
            let (from, to) = (args.from, args.to);
            Some(Reference::Distance(v1::KnownDistance { from, to, metres: *metres }))
        }
        (None, Some(path)) => {
            let rows = read_positions(path, args.by_time)?;
            Some(Reference::Positions(v1::ReferencePositions { rows, max_error_m: args.max_error }))
        }
        (None, None) => None,
    };
    let mut client = args.server.connect().await?;
    let session = match reference {
        Some(reference) => client.measure_scale(&args.session, reference).await?,
        None => client.set_scale(&args.session, args.metres.filter(|_| !args.free)).await?,
    };
    if args.json {
        println!("{}", as_json(&session));
    } else {
        print!("{}", told(&session));
    }
    Ok(())
}

fn told(session: &v1::Session) -> String {
    let Some(metres) = session.metres_per_unit else {
        return format!("lengths of {} are map units\n", session.id);
    };
    let mut text = format!("a map unit of {} is {metres:.6} m\n", session.id);
    let Some(measured) = &session.scale_measurement else { return text };
    if let (Some(distance), [from, to]) = (measured.map_distance, &measured.places[..]) {
        text += &format!("from {from} to {to} it is {distance:.6} units\n");
    }
    if let Some(rms) = measured.rms_m {
        let n = measured.residuals.len();
        text += &format!("{} of {n} rows, {rms:.4} m root mean square\n", measured.n_used);
        let unused = measured.residuals.iter().enumerate().filter(|(_, residual)| !residual.used);
        for (idx, residual) in unused.clone().take(MAX_NAMED) {
            let error = residual.error_m.map_or_else(String::new, |error| format!(", {error:.3} m off"));
            text += &format!("row {} is left out: {}{error}\n", idx + 1, residual.reason);
        }
        let n_more = unused.count().saturating_sub(MAX_NAMED);
        if n_more > 0 {
            text += &format!("and {n_more} more\n");
        }
    }
    text
}

fn as_json(session: &v1::Session) -> serde_json::Value {
    let measured = session.scale_measurement.as_ref().map(|measured| {
        let residuals: Vec<_> = measured
            .residuals
            .iter()
            .map(|row| json!({ "error_m": row.error_m, "used": row.used, "reason": row.reason }))
            .collect();
        json!({
            "map_distance": measured.map_distance, "places": measured.places, "residuals": residuals,
            "rms_m": measured.rms_m, "n_used": measured.n_used, "submap_id": measured.submap_id,
        })
    });
    json!({ "id": session.id, "metres_per_unit": session.metres_per_unit, "scale_measurement": measured })
}

/// A place of a map as it is written on the command line.
fn place(text: &str) -> Result<v1::ScalePlace, String> {
    let expected = "point:ID, keyframe:ID or keyframe:ID@X,Y expected";
    let parsed = || {
        let (kind, rest) = text.split_once(':')?;
        Some(match (kind, rest.split_once('@')) {
            ("point", None) => Place::PointId(rest.parse().ok()?),
            ("keyframe", None) => Place::KeyframeId(rest.parse().ok()?),
            ("keyframe", Some((id, pixel))) => {
                let (x, y) = pixel.split_once(',')?;
                let keyframe_id = id.parse().ok()?;
                Place::Pixel(v1::PickedPixel { keyframe_id, x: x.parse().ok()?, y: y.parse().ok()? })
            }
            _ => return None,
        })
    };
    parsed().map(|place| v1::ScalePlace { place: Some(place) }).ok_or_else(|| expected.to_owned())
}

fn read_positions(path: &Path, by_time: bool) -> Result<Vec<v1::ReferencePosition>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut rows = Vec::new();
    for (idx, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let words: Vec<&str> = line.split([',', ' ', '\t', ';']).filter(|word| !word.is_empty()).collect();
        let Some(row) = reference_row(&words, by_time) else {
            let first = if by_time { "SECONDS" } else { "SEQUENCE" };
            bail!("{}, line {}: `{first} X Y Z` expected", path.display(), idx + 1);
        };
        rows.push(row);
    }
    Ok(rows)
}

fn reference_row(words: &[&str], by_time: bool) -> Option<v1::ReferencePosition> {
    let [first, x, y, z, ..] = words else { return None };
    let frame =
        if by_time { Frame::TimestampNs(nanoseconds(first)?) } else { Frame::Sequence(first.parse().ok()?) };
    let number = |text: &str| text.parse().ok().filter(|number: &f64| number.is_finite());
    let position = v1::Vector3 { x: number(x)?, y: number(y)?, z: number(z)? };
    Some(v1::ReferencePosition { frame: Some(frame), position: Some(position) })
}

/// Seconds with all their digits, which a floating-point number since 1970 does not hold.
fn nanoseconds(seconds: &str) -> Option<i64> {
    let (whole, fraction) = seconds.split_once('.').unwrap_or((seconds, ""));
    if !fraction.bytes().all(|digit| digit.is_ascii_digit()) {
        return None;
    }
    let digits: String = fraction.chars().chain("000000000".chars()).take(9).collect();
    let (whole_ns, rest) =
        (whole.parse::<i64>().ok()?.checked_mul(1_000_000_000)?, digits.parse::<i64>().ok()?);
    if whole.starts_with('-') { whole_ns.checked_sub(rest) } else { whole_ns.checked_add(rest) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_and_times_are_read() {
        assert_eq!(place("point:12").unwrap().place, Some(Place::PointId(12)));
        assert_eq!(place("keyframe:3").unwrap().place, Some(Place::KeyframeId(3)));
        let pixel = v1::PickedPixel { keyframe_id: 3, x: 10.5, y: 20.0 };
        assert_eq!(place("keyframe:3@10.5,20").unwrap().place, Some(Place::Pixel(pixel)));
        for wrong in ["12", "point:x", "line:3", "keyframe:3@10", "point:3@1,2"] {
            assert!(place(wrong).is_err(), "{wrong}");
        }
        assert_eq!(nanoseconds("1403636579.763555584"), Some(1_403_636_579_763_555_584));
        assert_eq!(nanoseconds("-1.5"), Some(-1_500_000_000));
        assert_eq!(nanoseconds("1.5e3"), None);
    }
}

//! In which unit a file has its times.
//!
//! Programs write seconds, milliseconds, microseconds, nanoseconds, or the numbers of frames. Which, is told
//! by the size of the numbers and by the rate of frames that they would mean.

use std::fmt;
use std::str::FromStr;

use crate::time::decimal_nano;

/// A unit of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeUnit {
    /// Seconds.
    Seconds,
    /// Milliseconds.
    Milliseconds,
    /// Microseconds.
    Microseconds,
    /// Nanoseconds.
    Nanoseconds,
    /// The interval between frames: the numbers are those of frames.
    Frames,
}

/// Billionths of a unit.
const NANO: i128 = 1_000_000_000;

/// Times of day since 1970 in milliseconds have 13 digits, in microseconds 16, in nanoseconds 19; in seconds
/// a recording of so long is none.
const SINCE_1970: [(i128, TimeUnit); 3] = [
    (NANO * 100_000_000_000_000_000, TimeUnit::Nanoseconds),
    (NANO * 100_000_000_000_000, TimeUnit::Microseconds),
    (NANO * 100_000_000_000, TimeUnit::Milliseconds),
];

impl TimeUnit {
    const ALL: [(Self, &str); 5] = [
        (Self::Seconds, "s"),
        (Self::Milliseconds, "ms"),
        (Self::Microseconds, "us"),
        (Self::Nanoseconds, "ns"),
        (Self::Frames, "frames"),
    ];

    /// Nanoseconds of so many billionths of the unit, rounded; frames come `fps` a second.
    pub(crate) fn to_ns(self, nano: i128, fps: Option<f64>) -> Option<i64> {
        let divisor = match self {
            Self::Seconds => 1,
            Self::Milliseconds => 1_000,
            Self::Microseconds => 1_000_000,
            Self::Nanoseconds => NANO,
            // A frame's number is far below what a double holds exactly.
            Self::Frames => {
                let ns = (nano as f64 / fps?).round();
                return (ns.abs() < i64::MAX as f64).then_some(ns as i64);
            }
        };
        i64::try_from((nano + nano.signum() * (divisor / 2)) / divisor).ok()
    }
}

impl fmt::Display for TimeUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Seconds => "seconds",
            Self::Milliseconds => "milliseconds",
            Self::Microseconds => "microseconds",
            Self::Nanoseconds => "nanoseconds",
            Self::Frames => "numbers of frames",
        })
    }
}

impl FromStr for TimeUnit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.iter().find(|(_, name)| *name == text).map(|(unit, _)| *unit).ok_or_else(|| {
            let names = Self::ALL.map(|(_, name)| name).join(", ");
            format!("`{text}` is not a unit of time: {names}")
        })
    }
}

/// What the times of a file seem to be.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Recognized {
    pub unit: TimeUnit,
    /// What the user should know of it.
    pub remark: Option<String>,
}

/// The unit of the poses of a trajectory, as written: seconds, unless they are too great for it.
pub(crate) fn of_poses(times: &[&str]) -> TimeUnit {
    let numbers: Vec<i128> = times.iter().filter_map(|time| decimal_nano(time)).collect();
    let greatest = numbers.iter().map(|number| number.abs()).max().unwrap_or(0);
    by_size(greatest).or_else(|| by_long_steps(&numbers)).unwrap_or(TimeUnit::Seconds)
}

/// The unit of the times of a list of images.
pub(crate) fn of_images(numbers: &[i128]) -> Recognized {
    let seconds = |remark: Option<String>| Recognized { unit: TimeUnit::Seconds, remark };
    let Some(step) = median_step(numbers) else {
        let unit = numbers.first().and_then(|number| by_size(number.abs())).unwrap_or(TimeUnit::Seconds);
        return Recognized { unit, remark: None };
    };
    let greatest = numbers.iter().map(|number| number.abs()).max().unwrap_or(0);
    let is_whole = numbers.iter().all(|number| number % NANO == 0);
    let told = |unit: TimeUnit| {
        let interval_ms = unit.to_ns(step, None).unwrap_or(0) as f64 * 1e-6;
        let remark = format!(
            "the times are read as {unit}, a frame each {interval_ms:.1} ms (--times says otherwise)"
        );
        Recognized { unit, remark: Some(remark) }
    };
    if let Some(unit) = by_size(greatest).or_else(|| by_long_steps(numbers)) {
        return told(unit);
    }
    // Ten digits before the point are seconds since 1970, however far apart.
    let is_date = greatest >= NANO * 100_000_000;
    if is_whole && step == NANO {
        return seconds(Some(
            "the times count by one: read as seconds, that is one frame a second. If they are numbers of frames, \
             give --times frames and the rate with --fps"
                .to_owned(),
        ));
    }
    if is_whole && step >= 2 * NANO && !is_date {
        return told(TimeUnit::Milliseconds);
    }
    if step >= NANO {
        let remark = format!(
            "the frames are {:.1} s apart if the times are seconds (--times says otherwise)",
            step as f64 * 1e-9
        );
        return seconds(Some(remark));
    }
    seconds(None)
}

fn by_size(greatest: i128) -> Option<TimeUnit> {
    SINCE_1970.iter().find(|(least, _)| greatest >= *least).map(|(_, unit)| *unit)
}

/// Numbers a thousand apart and more: microseconds, a million: nanoseconds.
fn by_long_steps(numbers: &[i128]) -> Option<TimeUnit> {
    match median_step(numbers)? {
        step if step >= NANO * 1_000_000 => Some(TimeUnit::Nanoseconds),
        step if step >= NANO * 1_000 => Some(TimeUnit::Microseconds),
        _ => None,
    }
}

fn median_step(numbers: &[i128]) -> Option<i128> {
    let mut steps: Vec<i128> =
        numbers.windows(2).map(|pair| (pair[1] - pair[0]).abs()).filter(|step| *step > 0).collect();
    steps.sort_unstable();
    steps.get(steps.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn images(times: &[&str]) -> (TimeUnit, bool) {
        let numbers: Vec<i128> = times.iter().map(|time| decimal_nano(time).unwrap()).collect();
        let found = of_images(&numbers);
        (found.unit, found.remark.is_some())
    }

    #[test]
    fn the_unit_is_told_by_size_and_rate() {
        use TimeUnit::*;
        for (times, expected) in [
            (&["0.0", "0.033", "0.067"][..], (Seconds, false)),
            (&["1403715285.262", "1403715285.312"], (Seconds, false)),
            (&["1403715285262142976", "1403715285312143104"], (Nanoseconds, true)),
            (&["1.403715285262142976e18", "1.403715285312143104e18"], (Nanoseconds, true)),
            (&["1403715285262142", "1403715285312143"], (Microseconds, true)),
            (&["1403715285262", "1403715285312"], (Milliseconds, true)),
            (&["0", "33", "67", "100"], (Milliseconds, true)),
            (&["0", "33333", "66667"], (Microseconds, true)),
            (&["0", "33333333", "66666667"], (Nanoseconds, true)),
            (&["0", "1", "2", "3"], (Seconds, true)),
            (&["0.5", "10.5", "20.5"], (Seconds, true)),
            (&["1403715285", "1403715295"], (Seconds, true)),
            (&["7"], (Seconds, false)),
            (&["1403715285262142976"], (Nanoseconds, false)),
        ] {
            assert_eq!(images(times), expected, "{times:?}");
        }
    }

    #[test]
    fn key_frames_seconds_apart_are_seconds() {
        assert_eq!(of_poses(&["0", "4", "9"]), TimeUnit::Seconds);
        assert_eq!(
            of_poses(&["1403715285262142976.000000", "1403715285312143104.000000"]),
            TimeUnit::Nanoseconds
        );
    }

    #[test]
    fn units_become_nanoseconds_rounded() {
        let ns = |unit: TimeUnit, text: &str, fps| unit.to_ns(decimal_nano(text).unwrap(), fps);
        assert_eq!(ns(TimeUnit::Milliseconds, "33.5", None), Some(33_500_000));
        assert_eq!(ns(TimeUnit::Nanoseconds, "1403715285262142976.5", None), Some(1_403_715_285_262_142_977));
        assert_eq!(ns(TimeUnit::Nanoseconds, "-2.6", None), Some(-3));
        assert_eq!(ns(TimeUnit::Frames, "3", Some(30.0)), Some(100_000_000));
        assert_eq!(ns(TimeUnit::Frames, "3", None), None);
        assert_eq!(ns(TimeUnit::Seconds, "9223372037", None), None);
    }
}

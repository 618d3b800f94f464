//! What the motion sensors of a session's device measured: taken in and given out as EuRoC recordings have
//! it.
//!
//! Lines of `timestamp [ns],w_x,w_y,w_z [rad s^-1],a_x,a_y,a_z [m s^-2]`; lines that begin with `#` are
//! comments.

use crate::error::ApiError;
use crate::session::SessionId;
use std::fmt::Write;
use store::{MotionReading, Store};

/// First line of what is given out.
pub const HEADER: &str = "#timestamp [ns],w_x [rad s^-1],w_y [rad s^-1],w_z [rad s^-1],\
                          a_x [m s^-2],a_y [m s^-2],a_z [m s^-2]\n";

/// Readings that are taken at once, at most: ten seconds of the fastest sensors.
pub const MAX_READINGS: usize = 10_000;

/// Readings of the sessions of a database.
#[derive(Clone)]
pub struct Motion {
    store: Store,
}

impl Motion {
    /// Those of a database.
    pub fn new(store: Store) -> Self {
        Self { store }
    }

    /// Keeps readings; how many. Sent once more they are kept once.
    ///
    /// # Errors
    /// If a line is no reading, times do not increase, there are too many, there is no such session, or they
    /// cannot be saved.
    pub async fn add(&self, id: &SessionId, text: &str) -> Result<usize, ApiError> {
        let readings = parse(text)?;
        self.store.get_session(id.as_str()).await?;
        self.store.add_motion(id.as_str(), &readings).await?;
        Ok(readings.len())
    }

    /// The lines of the readings that begin next after a time, and when they begin.
    ///
    /// # Errors
    /// If there is no such session, or they cannot be read.
    pub async fn lines_after(
        &self,
        id: &SessionId,
        after_ns: Option<i64>,
    ) -> Result<Option<(i64, String)>, ApiError> {
        let found = self.store.motion_after(id.as_str(), after_ns).await?;
        Ok(found.map(|(first_ns, readings)| (first_ns, readings.iter().fold(String::new(), push_line))))
    }
}

fn push_line(mut lines: String, reading: &MotionReading) -> String {
    let MotionReading { timestamp_ns, angular_velocity: [p, q, r], acceleration: [x, y, z] } = reading;
    // Writing to a string cannot fail.
    let _ = writeln!(lines, "{timestamp_ns},{p},{q},{r},{x},{y},{z}");
    lines
}

fn parse(text: &str) -> Result<Vec<MotionReading>, ApiError> {
    let mut readings: Vec<MotionReading> = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let wrong = |what: &str| ApiError::invalid("body", format!("line {number}: {what}"));
        let expected =
            "must be a time in nanoseconds, three angular velocities and three accelerations, with commas";
        let reading = reading_of(line).ok_or_else(|| wrong(expected))?;
        if readings.last().is_some_and(|last| last.timestamp_ns >= reading.timestamp_ns) {
            return Err(wrong("its time must be after that of the line before"));
        }
        if readings.len() == MAX_READINGS {
            return Err(wrong(&format!("more than {MAX_READINGS} readings at once; send them in parts")));
        }
        readings.push(reading);
    }
    Ok(readings)
}

fn reading_of(line: &str) -> Option<MotionReading> {
    let mut fields = line.split(',').map(str::trim);
    let timestamp_ns = fields.next()?.parse().ok()?;
    let mut values = [0.0_f32; 6];
    for value in &mut values {
        *value = fields.next()?.parse().ok().filter(|value: &f32| value.is_finite())?;
    }
    let [p, q, r, x, y, z] = values;
    let reading = MotionReading { timestamp_ns, angular_velocity: [p, q, r], acceleration: [x, y, z] };
    fields.next().is_none().then_some(reading)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_become_readings_and_come_back() {
        let text =
            format!("{HEADER}1403636579758555392,-0.099,0.147,0.02,8.17,-0.37,-2.4\n\n5e3,0,0,0,0,0,0\n");
        assert!(parse(&text).unwrap_err().to_string().contains("line 4"), "a time is a whole number");
        let text = text.replace("5e3", "1403636579758555393");
        let readings = parse(&text).unwrap();
        assert_eq!(readings.len(), 2);
        let lines = readings.iter().fold(String::new(), push_line);
        assert_eq!(parse(&lines).unwrap(), readings);
        assert!(lines.starts_with("1403636579758555392,-0.099,0.147,0.02,8.17,-0.37,-2.4\n"), "{lines}");
    }

    #[test]
    fn what_is_no_reading_is_refused_with_its_line() {
        for wrong in ["1,2,3", "1,0,0,0,0,0,NaN", "1,0,0,0,0,0,inf", "1,0,0,0,0,0,0,0", "x,0,0,0,0,0,0"] {
            let refused = parse(&format!("0,0,0,0,0,0,0\n{wrong}\n")).unwrap_err().to_string();
            assert!(refused.contains("line 2"), "{wrong}: {refused}");
        }
        assert!(parse("5,0,0,0,0,0,0\n5,0,0,0,0,0,0").unwrap_err().to_string().contains("after"));
        let many: String = (0..=MAX_READINGS).map(|n| format!("{n},0,0,0,0,0,0\n")).collect();
        assert!(parse(&many).unwrap_err().to_string().contains("in parts"));
        assert!(parse("# nothing\n").unwrap().is_empty());
    }
}

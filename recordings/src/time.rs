//! Decimal seconds to integer nanoseconds and back, without passing through floating point.
//!
//! A time of day in seconds has ten digits before the point; a double keeps about seven after it. Recordings
//! written with nanoseconds must come back as those nanoseconds.

/// Nanoseconds per second.
const NS_PER_S: i64 = 1_000_000_000;

/// Decimal places of a nanosecond.
const NS_DIGITS: i32 = 9;

/// Reads decimal seconds such as `1403715285.262142976`, `-0.5` or `1.036224e-01` as nanoseconds, rounding
/// digits beyond the ninth to the nearest.
///
/// `None` if it is not such a number or does not fit.
pub fn parse_seconds_ns(text: &str) -> Option<i64> {
    decimal_nano(text).and_then(|ns| i64::try_from(ns).ok())
}

/// Reads a decimal number in billionths, rounded, as [`parse_seconds_ns`] does seconds.
pub(crate) fn decimal_nano(text: &str) -> Option<i128> {
    let (mantissa, exponent) = match text.find(['e', 'E']) {
        Some(at) => (&text[..at], text[at + 1..].parse::<i32>().ok()?),
        None => (text, 0),
    };
    let (negative, magnitude) = match mantissa.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, mantissa.strip_prefix('+').unwrap_or(mantissa)),
    };
    let (whole, fraction) = magnitude.split_once('.').unwrap_or((magnitude, ""));
    if whole.len() + fraction.len() == 0 || !whole.bytes().chain(fraction.bytes()).all(|b| b.is_ascii_digit())
    {
        return None;
    }
    // The digits read as one integer are the value times 10^fraction.len().
    let shift = exponent.checked_add(NS_DIGITS)?.checked_sub(i32::try_from(fraction.len()).ok()?)?;
    let digits = whole.bytes().chain(fraction.bytes()).map(|b| i128::from(b - b'0'));
    let value = digits.into_iter().try_fold(0i128, |sum, digit| sum.checked_mul(10)?.checked_add(digit))?;
    let ns = scale_by_power_of_ten(value, shift)?;
    Some(if negative { -ns } else { ns })
}

/// `value * 10^power`, rounded half up; `value` is not negative.
fn scale_by_power_of_ten(value: i128, power: i32) -> Option<i128> {
    match (value, 10i128.checked_pow(power.unsigned_abs())) {
        (0, _) => Some(0),
        (_, Some(factor)) if power >= 0 => value.checked_mul(factor),
        (_, Some(divisor)) => Some(value.checked_add(divisor / 2)? / divisor),
        // Dividing by more than 10^38 leaves nothing; multiplying by it leaves the range.
        (_, None) => (power < 0).then_some(0),
    }
}

/// Nanoseconds as decimal seconds with nine places: the inverse of [`parse_seconds_ns`].
pub fn format_seconds(timestamp_ns: i64) -> String {
    let sign = if timestamp_ns < 0 { "-" } else { "" };
    let magnitude = timestamp_ns.unsigned_abs();
    let per_second = NS_PER_S.unsigned_abs();
    format!("{sign}{}.{:09}", magnitude / per_second, magnitude % per_second)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_nanosecond_survives() {
        assert_eq!(parse_seconds_ns("1403715285.262142976"), Some(1_403_715_285_262_142_976));
        assert_eq!(parse_seconds_ns("0.033333"), Some(33_333_000));
        assert_eq!(parse_seconds_ns("1305031102.175304"), Some(1_305_031_102_175_304_000));
        for ns in [0, 1, -1, 999_999_999, 1_403_715_285_262_142_977, i64::MAX, -i64::MAX] {
            assert_eq!(parse_seconds_ns(&format_seconds(ns)), Some(ns));
        }
    }

    #[test]
    fn exponents_and_extra_digits_are_read() {
        assert_eq!(parse_seconds_ns("1.036224e-01"), Some(103_622_400));
        assert_eq!(parse_seconds_ns("4.708000e+02"), Some(470_800_000_000));
        assert_eq!(parse_seconds_ns("0.0000000014"), Some(1));
        assert_eq!(parse_seconds_ns("0.0000000015"), Some(2));
        assert_eq!(parse_seconds_ns("5e-60"), Some(0));
        assert_eq!(parse_seconds_ns("-.5"), Some(-500_000_000));
        assert_eq!(parse_seconds_ns("7."), Some(7_000_000_000));
    }

    #[test]
    fn what_is_not_a_time_is_refused() {
        for text in
            ["", ".", "-", "nan", "inf", "1,5", "1.2.3", "0x10", "1e", "1e400", "1e-2147483649", "9223372037"]
        {
            assert_eq!(parse_seconds_ns(text), None, "{text}");
        }
    }
}

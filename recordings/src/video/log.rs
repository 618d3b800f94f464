//! What `ffmpeg` writes to standard error: a line for each frame, by its filter `showinfo`, and complaints.

use std::io::{self, BufRead};

/// A longer line is cut: of those that are read, none is near that.
const MAX_LINE: usize = 4096;

/// Longest complaint that is passed on, characters.
const MAX_COMPLAINT: usize = 300;

/// What a line says.
#[derive(Debug, PartialEq)]
pub(super) enum LogLine {
    /// A frame follows on standard output.
    Frame(FrameInfo),
    /// Something is wrong.
    Complaint(String),
    /// Nothing that matters here.
    Other,
}

/// A frame that `ffmpeg` has read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FrameInfo {
    /// Its time in the units of the filter; `None` if the container has none.
    pub(super) timestamp_ns: Option<i64>,
    pub(super) width: u32,
    pub(super) height: u32,
}

impl LogLine {
    /// Reads a line as `-loglevel level+info` has it: `[component @ address] [level] message`.
    pub(super) fn parse(line: &str) -> Self {
        if line.starts_with("[Parsed_showinfo_") {
            return frame_info(line).map_or(Self::Other, Self::Frame);
        }
        let complaint = ["[error] ", "[fatal] ", "[panic] "].iter().find_map(|level| line.split_once(level));
        match complaint {
            Some((_, message)) => Self::Complaint(message.trim().chars().take(MAX_COMPLAINT).collect()),
            None => Self::Other,
        }
    }
}

/// `… n:   3 pts:400000000 pts_time:0.4 … s:320x240 i:P …`
fn frame_info(line: &str) -> Option<FrameInfo> {
    let (_, fields) = line.split_once("] n:")?;
    let (_, timestamp) = fields.split_once(" pts:")?;
    let (_, size) = fields.split_once(" s:")?;
    let (width, height) = size.split_whitespace().next()?.split_once('x')?;
    let timestamp_ns = timestamp.split_whitespace().next()?.parse().ok();
    Some(FrameInfo { timestamp_ns, width: width.parse().ok()?, height: height.parse().ok()? })
}

/// Reads the next line into `line`, cut where it gets long. Whether there was one.
pub(super) fn read_line(reader: &mut impl BufRead, line: &mut String) -> io::Result<bool> {
    line.clear();
    let mut bytes = Vec::new();
    let mut has_read = false;
    loop {
        let available = reader.fill_buf()?;
        if available.is_empty() {
            break;
        }
        has_read = true;
        let end = available.iter().position(|byte| matches!(byte, b'\n' | b'\r'));
        let n_content = end.unwrap_or(available.len());
        let n_kept = n_content.min(MAX_LINE.saturating_sub(bytes.len()));
        bytes.extend_from_slice(&available[..n_kept]);
        reader.consume(end.map_or(n_content, |end| end + 1));
        if end.is_some() {
            break;
        }
    }
    line.push_str(&String::from_utf8_lossy(&bytes));
    Ok(has_read)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_and_complaints_are_told_from_the_rest() {
        let frame = "[Parsed_showinfo_1 @ 0x5585] [info] n:   3 pts:400000000 pts_time:0.4     pos:     5521 \
                     fmt:yuv420p sar:1/1 s:240x320 i:P iskey:0 type:B ";
        let info = FrameInfo { timestamp_ns: Some(400_000_000), width: 240, height: 320 };
        assert_eq!(LogLine::parse(frame), LogLine::Frame(info));
        let without = LogLine::parse(&frame.replace("pts:400000000", "pts:NOPTS"));
        assert_eq!(without, LogLine::Frame(FrameInfo { timestamp_ns: None, ..info }));
        let refusal = "[mov,mp4,m4a,3gp,3g2,mj2 @ 0x55] [error] moov atom not found";
        assert_eq!(LogLine::parse(refusal), LogLine::Complaint("moov atom not found".into()));
        for other in [
            "[Parsed_showinfo_1 @ 0x5585] [info] config in time_base: 1/1000000000, frame_rate: 10/1",
            "[Parsed_showinfo_1 @ 0x5585] [info] color_range:unknown",
            "[info]   Duration: 00:00:02.00, start: 0.000000, bitrate: 42 kb/s",
            "",
        ] {
            assert_eq!(LogLine::parse(other), LogLine::Other, "{other}");
        }
    }

    #[test]
    fn long_lines_are_cut_and_the_next_is_whole() {
        let text = format!("{}\nnext\rlast", "x".repeat(3 * MAX_LINE));
        let mut reader = io::BufReader::with_capacity(100, text.as_bytes());
        let mut line = String::new();
        let mut lengths = Vec::new();
        while read_line(&mut reader, &mut line).unwrap() {
            lengths.push(line.len());
        }
        assert_eq!((lengths, line.as_str()), (vec![MAX_LINE, 4, 4], ""));
    }
}

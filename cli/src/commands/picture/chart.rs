//! Charts over time as SVG files, in the manner of the maps: readable on light and dark pages.

use std::fmt::Write;

use super::svg::escaped;

/// Width and height of a chart, units; it is shown half as large in pixels.
const WIDTH: f64 = 1600.0;
const HEIGHT: f64 = 420.0;
/// Space left of the axis, above, right of and below what is drawn, units.
const MARGIN: [f64; 4] = [130.0, 50.0, 30.0, 70.0];
/// Marks along an axis, about.
const N_MARKS: f64 = 5.0;
/// Vertices of a curve at most; of more, the greatest of each few is drawn.
const MAX_VERTICES: usize = 1500;
/// Height of a row of bars, units.
const ROW: f64 = 44.0;

const STYLES: &str = "\
svg{--page:#fff;--ink:#1f2328;--faint:#8c959f;--grid:#d8dee4}\
@media(prefers-color-scheme:dark){svg{--page:#0d1117;--ink:#e6edf3;--faint:#8b949e;--grid:#30363d}}\
text{font:26px system-ui,sans-serif;fill:var(--ink)}.faint{fill:var(--faint)}\
path{fill:none;stroke-linejoin:round}.page{fill:var(--page)}.grid{stroke:var(--grid);stroke-width:2}\
.curve{stroke:#0f7fc4;stroke-width:4}.median{fill:#0f7fc4}.p95{fill:#0f7fc4;opacity:.35}\
.tracked{fill:#1d8f52}.weak{fill:#c98a00}.lost{fill:#c9263f}.initialising{fill:#7488a3}";

/// A curve of values that are not negative over seconds, in the order of time.
pub fn curve(title: &str, unit: &str, values: &[[f64; 2]]) -> String {
    let span = span(values.iter().map(|value| value[0]));
    let greatest = values.iter().map(|value| value[1]).fold(0.0, f64::max);
    let step = round_step(greatest.max(1e-9));
    let top = step * (greatest / step).ceil().max(1.0);
    let mut sheet = Sheet::new(title, HEIGHT);
    let place = |[time, value]: [f64; 2]| [sheet.x(time, span), sheet.y(value / top)];
    let mut path = String::new();
    for (idx, value) in highest(values).into_iter().enumerate() {
        let [x, y] = place(value);
        let _ = write!(path, "{}{x:.0} {y:.0}", if idx == 0 { "M" } else { "L" });
    }
    for mark in 0..=(top / step).round() as u32 {
        let value = f64::from(mark) * step;
        sheet.horizontal(value / top, &short(value, step));
    }
    sheet.time_axis(span);
    let _ = writeln!(sheet.text, "<path class=\"curve\" d=\"{path}\"/>");
    sheet.label(unit);
    sheet.finish()
}

/// The state of each frame over seconds, in the order of time.
pub fn states(title: &str, frames: &[(f64, String)]) -> String {
    let span = span(frames.iter().map(|frame| frame.0));
    let mut sheet = Sheet::new(title, MARGIN[1] + 2.0 * ROW + MARGIN[3]);
    let (top, bottom) = (MARGIN[1], sheet.height - MARGIN[3]);
    let mut start = 0;
    for end in 1..=frames.len() {
        if frames.get(end).is_some_and(|frame| frame.1 == frames[start].1) {
            continue;
        }
        let from = sheet.x(frames[start].0, span);
        let to = sheet.x(frames.get(end).map_or(span.1, |frame| frame.0), span).max(from + 1.0);
        let state = escaped(&frames[start].1);
        let (width, height) = (to - from, bottom - top);
        let _ = writeln!(
            sheet.text,
            "<rect class=\"{state}\" x=\"{from:.0}\" y=\"{top:.0}\" width=\"{width:.1}\" height=\"{height:.0}\"/>"
        );
        start = end;
    }
    sheet.time_axis(span);
    let mut x = MARGIN[0];
    for state in ["tracked", "weak", "lost", "initialising"] {
        let n = frames.iter().filter(|frame| frame.1 == state).count();
        let _ = writeln!(
            sheet.text,
            "<rect class=\"{state}\" x=\"{x}\" y=\"12\" width=\"24\" height=\"24\"/>\
             <text x=\"{}\" y=\"34\">{state} {n}</text>",
            x + 34.0
        );
        x += 260.0;
    }
    sheet.finish()
}

/// Median and 95th percentile of some times, in milliseconds.
pub fn bars(title: &str, rows: &[(String, f64, f64)]) -> String {
    let greatest = rows.iter().map(|row| row.2).fold(1e-9, f64::max);
    let mut sheet = Sheet::new(title, MARGIN[1] + ROW * rows.len() as f64 + 20.0);
    let (left, full) = (360.0, WIDTH - 360.0 - 330.0);
    for (idx, (name, median, p95)) in rows.iter().enumerate() {
        let y = MARGIN[1] + ROW * idx as f64;
        let (to_median, to_p95) = (full * median / greatest, full * p95 / greatest);
        let name = escaped(name);
        let _ = writeln!(
            sheet.text,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{name}</text>\
             <rect class=\"p95\" x=\"{left}\" y=\"{y:.0}\" width=\"{to_p95:.1}\" height=\"30\"/>\
             <rect class=\"median\" x=\"{left}\" y=\"{y:.0}\" width=\"{to_median:.1}\" height=\"30\"/>\
             <text class=\"faint\" x=\"{:.0}\" y=\"{}\">{median:.2} ms, 95 %: {p95:.2}</text>",
            left - 14.0,
            y + 24.0,
            left + to_p95 + 14.0,
            y + 24.0
        );
    }
    sheet.finish()
}

/// A chart under work.
struct Sheet {
    title: String,
    height: f64,
    text: String,
}

impl Sheet {
    fn new(title: &str, height: f64) -> Self {
        Self { title: escaped(title), height, text: String::new() }
    }

    fn x(&self, time: f64, (first, last): (f64, f64)) -> f64 {
        MARGIN[0] + (WIDTH - MARGIN[0] - MARGIN[2]) * (time - first) / (last - first)
    }

    /// Of a share of the height.
    fn y(&self, share: f64) -> f64 {
        let bottom = self.height - MARGIN[3];
        bottom - (bottom - MARGIN[1]) * share
    }

    fn horizontal(&mut self, share: f64, label: &str) {
        let y = self.y(share);
        let (left, right) = (MARGIN[0], WIDTH - MARGIN[2]);
        let _ = writeln!(
            self.text,
            "<path class=\"grid\" d=\"M{left} {y:.0}H{right}\"/>\
             <text class=\"faint\" x=\"{}\" y=\"{:.0}\" text-anchor=\"end\">{label}</text>",
            left - 12.0,
            y + 9.0
        );
    }

    fn time_axis(&mut self, span: (f64, f64)) {
        let step = round_step(span.1 - span.0);
        let y = self.height - MARGIN[3] + 34.0;
        let n_marks = ((span.1 - span.0) / step).floor() as u32;
        for mark in 0..=n_marks {
            let seconds = f64::from(mark) * step;
            let (x, label) = (self.x(span.0 + seconds, span), short(seconds, step));
            let unit = if mark == n_marks { " s" } else { "" };
            let _ = writeln!(
                self.text,
                "<text class=\"faint\" x=\"{x:.0}\" y=\"{y:.0}\" text-anchor=\"middle\">{label}{unit}</text>"
            );
        }
    }

    fn label(&mut self, unit: &str) {
        let _ = writeln!(self.text, "<text x=\"{}\" y=\"34\">{}</text>", MARGIN[0], escaped(unit));
    }

    fn finish(self) -> String {
        let Self { title, height, text } = self;
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height:.0}\" width=\"{}\" \
             height=\"{:.0}\" role=\"img\">\n<title>{title}</title>\n<style>{STYLES}</style>\n\
             <rect class=\"page\" width=\"{WIDTH}\" height=\"{height:.0}\" rx=\"16\"/>\n{text}</svg>\n",
            WIDTH / 2.0,
            height / 2.0
        )
    }
}

/// First and last, a second apart at least.
fn span(times: impl Iterator<Item = f64>) -> (f64, f64) {
    let finite = times.filter(|time| time.is_finite());
    let (first, last) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(t), b.max(t)));
    if first > last { (0.0, 1.0) } else { (first, last.max(first + 1.0)) }
}

/// The greatest values of stretches of equal length, so that no peak is lost.
fn highest(values: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let length = values.len().div_ceil(MAX_VERTICES).max(1);
    let greatest = |stretch: &[[f64; 2]]| stretch.iter().copied().max_by(|a, b| a[1].total_cmp(&b[1]));
    values.chunks(length).filter_map(greatest).collect()
}

/// A round step that divides a length in about [`N_MARKS`].
fn round_step(length: f64) -> f64 {
    let rough = length / N_MARKS;
    let power = 10f64.powf(rough.log10().floor());
    [1.0, 2.0, 5.0].map(|digit| digit * power).into_iter().find(|step| *step >= rough).unwrap_or(10.0 * power)
}

/// With as many digits as the step needs.
fn short(value: f64, step: f64) -> String {
    let digits = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_keeps_its_peak_and_has_round_marks() {
        let values: Vec<[f64; 2]> =
            (0..10_000).map(|i| [f64::from(i) * 0.01, if i == 5003 { 0.4 } else { 0.05 }]).collect();
        assert!(highest(&values).iter().any(|value| value[1] == 0.4));
        let text = curve("error <1>", "m", &values);
        assert!(
            text.contains("<title>error &lt;1&gt;</title>")
                && text.contains(">0.4<")
                && text.contains(">80 s<"),
            "{text}"
        );
        assert!(!text.contains("NaN") && text.len() < 40_000);
        // Nothing to draw is drawn as nothing.
        assert!(!curve("none", "m", &[]).contains("NaN"));
    }

    #[test]
    fn states_are_drawn_in_stretches() {
        let state = |i: u32| {
            if i < 10 {
                "initialising"
            } else if i == 50 {
                "lost"
            } else {
                "tracked"
            }
        };
        let frames: Vec<(f64, String)> =
            (0..100).map(|i| (f64::from(i) * 0.1, state(i).to_owned())).collect();
        let text = states("states", &frames);
        // Four stretches, and four samples in the legend.
        assert_eq!(text.matches("<rect class=\"").count() - 1, 8, "{text}");
        assert!(text.contains(">tracked 89<") && text.contains(">lost 1<"));
        assert!(!states("none", &[]).contains("NaN"));
    }

    #[test]
    fn steps_are_round() {
        for (length, step) in [(1.0, 0.2), (7.62, 2.0), (0.0031, 0.001), (100.0, 20.0)] {
            assert!((round_step(length) - step).abs() < 1e-12, "{length}: {}", round_step(length));
        }
    }
}

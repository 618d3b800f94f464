//! An SVG sheet with a map above and its legend below. Coordinates are whole numbers, twice as fine as
//! pixels.

use std::fmt::Write;

use super::view::Frame;

/// Width of the sheet, units; it is shown half as wide in pixels.
const WIDTH: f64 = 1600.0;
/// Space around the map, units.
const MARGIN: f64 = 24.0;
/// Rows and columns of the legend, units.
const ROW: f64 = 44.0;
const N_COLUMNS: usize = 3;
/// Length of a legend's sample, units.
const SAMPLE: f64 = 56.0;
/// The scale bar is at most this share of the width, so that its label fits beside it.
const SCALE_BAR_SHARE: f64 = 0.1;

/// Colors for light pages, and what differs on dark ones. Those of the primitives can be told apart on both,
/// and with the usual forms of color blindness [Okabe and Ito 2008].
const STYLES: &str = "\
svg{--page:#fff;--ink:#1f2328;--faint:#8c959f;--truth:#ffcf33}\
@media(prefers-color-scheme:dark){svg{--page:#0d1117;--ink:#e6edf3;--faint:#6e7681;--truth:#9a7400}}\
text{font:28px system-ui,sans-serif;fill:var(--ink)}\
path{fill:none;stroke-linecap:round;stroke-linejoin:round}\
.page{fill:var(--page)}\
.points{stroke:var(--faint);stroke-width:4;opacity:.55}\
.lines{stroke:var(--faint);stroke-width:4}\
.other{stroke:#8a63d2;stroke-width:5}\
.p0{stroke:#0f7fc4;stroke-width:5}.p1{stroke:#d55e00;stroke-width:5}.p2{stroke:#009e73;stroke-width:5}\
.p3{stroke:#cc79a7;stroke-width:5}.p4{stroke:#56b4e9;stroke-width:5}.p5{stroke:#b58900;stroke-width:5}\
.truth{stroke:var(--truth);stroke-width:13}\
.estimate{stroke:var(--ink);stroke-width:4}\
.covisible{stroke:#2e9f5b;stroke-width:2;opacity:.5}.tied{stroke:#d1343f;stroke-width:2;opacity:.5}\
.keyframes{stroke:var(--ink);stroke-width:12}\
.bar{stroke:var(--ink);stroke-width:4}";

/// How something looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// Points of the map.
    Points,
    /// Lines without a primitive.
    Lines,
    /// Lines of a primitive with a color of its own, counted from 0.
    Primitive(usize),
    /// Lines of the other primitives.
    OtherPrimitives,
    /// The true trajectory: broad, below the estimate.
    Truth,
    /// The estimated trajectory.
    Estimate,
    /// Pairs of keyframes that share landmarks.
    Covisible,
    /// Pairs of keyframes that see the same global primitive.
    Tied,
    /// Keyframes.
    Keyframes,
}

impl Style {
    fn class(self) -> String {
        match self {
            Self::Points => "points".to_owned(),
            Self::Lines => "lines".to_owned(),
            Self::Primitive(color_idx) => format!("p{color_idx}"),
            Self::OtherPrimitives => "other".to_owned(),
            Self::Truth => "truth".to_owned(),
            Self::Estimate => "estimate".to_owned(),
            Self::Covisible => "covisible".to_owned(),
            Self::Tied => "tied".to_owned(),
            Self::Keyframes => "keyframes".to_owned(),
        }
    }
}

/// Shapes in the plane, units of the world.
#[derive(Clone, Debug)]
pub enum Mark {
    /// A dot at each place.
    Points(Vec<[f64; 2]>),
    /// Lines from place to place.
    Paths(Vec<Vec<[f64; 2]>>),
    /// Single lines.
    Segments(Vec<[[f64; 2]; 2]>),
}

/// Something that is drawn, with its line in the legend.
#[derive(Clone, Debug)]
pub struct Entry {
    /// What it is.
    pub label: String,
    /// How it looks.
    pub style: Style,
    /// Where it is.
    pub mark: Mark,
}

/// A sheet under work.
pub struct Sheet {
    title: String,
    frame: Frame,
    /// Sheet units per unit of the world.
    scale: f64,
    drawn: String,
    legend: Vec<(String, Style)>,
}

impl Sheet {
    /// An empty one for a part of the plane.
    pub fn new(title: &str, frame: &Frame) -> Self {
        let scale = (WIDTH - 2.0 * MARGIN) / frame.size[0];
        Self { title: title.to_owned(), frame: *frame, scale, drawn: String::new(), legend: Vec::new() }
    }

    /// Draws something on top of what is there.
    pub fn add(&mut self, entry: Entry) {
        let mut path = String::new();
        match &entry.mark {
            Mark::Points(points) => points.iter().for_each(|point| self.push(&mut path, &[*point])),
            Mark::Paths(paths) => paths.iter().for_each(|places| self.push(&mut path, places)),
            Mark::Segments(segments) => segments.iter().for_each(|ends| self.push(&mut path, ends)),
        }
        // Writing to a string cannot fail.
        let _ = writeln!(self.drawn, r#"<path class="{}" d="{path}"/>"#, entry.style.class());
        self.legend.push((entry.label, entry.style));
    }

    /// The file; `unit` says whose unit of length the scale bar has.
    pub fn finish(self, unit: &str) -> String {
        let map_height = self.frame.size[1] * self.scale;
        let legend_top = map_height + 2.0 * MARGIN;
        // The scale bar takes the first place of the legend.
        let n_rows = (self.legend.len() + 1).div_ceil(N_COLUMNS);
        let height = (legend_top + ROW * n_rows as f64 + MARGIN).round();
        let title = escaped(&self.title);
        let mut text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" width=\"{w}\" height=\"{h}\" \
             role=\"img\">\n<title>{title}</title>\n<style>{STYLES}</style>\n\
             <clipPath id=\"map\"><rect width=\"{WIDTH}\" height=\"{clip:.0}\"/></clipPath>\n\
             <rect class=\"page\" width=\"{WIDTH}\" height=\"{height}\" rx=\"16\"/>\n\
             <g clip-path=\"url(#map)\">\n{drawn}</g>\n",
            w = WIDTH / 2.0,
            h = height / 2.0,
            clip = legend_top - 0.5 * MARGIN,
            drawn = self.drawn,
        );
        text.push_str(&self.scale_bar(legend_top, unit));
        for (idx, (label, style)) in self.legend.iter().enumerate() {
            let (x, y) = place_in_legend(idx + 1, legend_top);
            let sample = match style {
                Style::Points => format!("M{:.0} {y:.0}h0m12 -6h0m6 10h0m10 -3h0", x + 0.25 * SAMPLE),
                _ => format!("M{x:.0} {y:.0}h{SAMPLE}"),
            };
            let _ = writeln!(
                text,
                r#"<path class="{class}" d="{sample}"/><text x="{tx:.0}" y="{ty:.0}">{label}</text>"#,
                class = style.class(),
                tx = x + SAMPLE + 16.0,
                ty = y + 10.0,
                label = escaped(label),
            );
        }
        text.push_str("</svg>\n");
        text
    }

    /// A bar of a round length with its length in units of the world.
    fn scale_bar(&self, legend_top: f64, unit: &str) -> String {
        let length = round_length(SCALE_BAR_SHARE * self.frame.size[0]);
        let ((x, y), width) = (place_in_legend(0, legend_top), length * self.scale);
        let s = if length == 1.0 { "" } else { "s" };
        format!(
            "<path class=\"bar\" d=\"M{x:.0} {top:.0}v16m0-8h{width:.0}m0-8v16\"/>\
             <text x=\"{tx:.0}\" y=\"{ty:.0}\">{length} unit{s} {unit}</text>\n",
            top = y - 8.0,
            tx = x + width + 16.0,
            ty = y + 10.0,
            unit = escaped(unit),
        )
    }

    /// Appends a line through places, or a dot if there is one only; what is not finite or far outside is
    /// left out.
    fn push(&self, path: &mut String, places: &[[f64; 2]]) {
        let on_sheet: Vec<[i64; 2]> = places.iter().filter_map(|place| self.on_sheet(place)).collect();
        if on_sheet.len() < places.len() && places.len() == 2 {
            return;
        }
        let Some((first, rest)) = on_sheet.split_first() else { return };
        let _ = write!(path, "M{} {}", first[0], first[1]);
        let (mut last, n_before) = (first, path.len());
        for place in rest {
            if place != last {
                let _ = write!(path, "l{} {}", place[0] - last[0], place[1] - last[1]);
                last = place;
            }
        }
        if path.len() == n_before {
            path.push_str("h0");
        }
    }

    fn on_sheet(&self, place: &[f64; 2]) -> Option<[i64; 2]> {
        let at = [0, 1].map(|axis| MARGIN + (place[axis] - self.frame.min[axis]) * self.scale);
        // A line may lead out of the picture, but not so far that its numbers get long.
        let is_near = at.iter().all(|value| value.abs() < 4.0 * WIDTH);
        is_near.then(|| at.map(|value| value.round() as i64))
    }
}

/// Where the sample of an entry begins, and the middle of its row.
fn place_in_legend(idx: usize, legend_top: f64) -> (f64, f64) {
    let column_width = (WIDTH - 2.0 * MARGIN) / N_COLUMNS as f64;
    let (row, column) = (idx / N_COLUMNS, idx % N_COLUMNS);
    (MARGIN + column as f64 * column_width, legend_top + (row as f64 + 0.5) * ROW)
}

/// The greatest of 1, 2 and 5 times a power of ten that is not above a positive length.
fn round_length(length: f64) -> f64 {
    let power = 10f64.powf(length.log10().floor());
    [5.0, 2.0, 1.0].map(|digit| digit * power).into_iter().find(|round| *round <= length).unwrap_or(power)
}

/// Text as it stands in a file.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sheet() -> Sheet {
        Sheet::new("a < b", &Frame { min: [0.0, 0.0], size: [10.0, 5.0] })
    }

    fn drawn(mark: Mark) -> String {
        let mut sheet = sheet();
        sheet.add(Entry { label: "x & y".to_owned(), style: Style::Truth, mark });
        sheet.finish("of the map")
    }

    #[test]
    fn shapes_are_where_they_should_be() {
        // 1600 less two margins of 24 are ten units of the world.
        assert!(drawn(Mark::Points(vec![[0.0, 0.0], [10.0, 5.0]])).contains("d=\"M24 24h0M1576 800h0\""));
        assert!(
            drawn(Mark::Paths(vec![vec![[0.0, 0.0], [0.0, 0.0], [5.0, 0.0], [5.0, 5.0]]]))
                .contains("d=\"M24 24l776 0l0 776\"")
        );
        let segments =
            vec![[[0.0, 0.0], [5.0, 0.0]], [[0.0, 0.0], [1e9, 0.0]], [[0.0, f64::NAN], [1.0, 0.0]]];
        assert!(drawn(Mark::Segments(segments)).contains("d=\"M24 24l776 0\""));
    }

    #[test]
    fn words_are_escaped_and_the_scale_bar_is_as_long_as_it_says() {
        let text = drawn(Mark::Points(Vec::new()));
        assert!(text.contains("<title>a &lt; b</title>") && text.contains(">x &amp; y</text>"));
        // One of ten units of the world, of 1552 on the sheet.
        assert!(text.contains("h155m") && text.contains(">1 unit of the map<"), "{text}");
    }

    #[test]
    fn scale_bars_are_of_round_lengths() {
        for (length, round) in [(0.9, 0.5), (1.0, 1.0), (4.99, 2.0), (70.0, 50.0), (0.023, 0.02)] {
            assert!(
                (round_length(length) - round).abs() < 1e-12 * round,
                "{length}: {}",
                round_length(length)
            );
        }
    }
}

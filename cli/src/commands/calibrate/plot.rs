//! A sheet with the errors of a calibration: where in the image boards were seen and which way corners lie
//! off, and how errors scatter.

use std::fmt::Write;

use calibration::Calibrated;

/// Width of the image as drawn, units.
const WIDTH: f64 = 800.0;
/// Side of the square in which errors scatter, units.
const SCATTER: f64 = 400.0;
const MARGIN: f64 = 40.0;
/// Errors in the image are drawn so long that the root mean square is this, units.
const ARROW: f64 = 12.0;
/// The square reaches so many times the root mean square.
const REACH: f64 = 4.0;

const STYLES: &str = "\
svg{--page:#fff;--ink:#1f2328;--faint:#8c959f;--error:#d55e00;--seen:#0f7fc4}\
@media(prefers-color-scheme:dark){svg{--page:#0d1117;--ink:#e6edf3;--faint:#6e7681;--error:#ff8a3d;--seen:#56b4e9}}\
text{font:16px system-ui,sans-serif;fill:var(--ink)}.page{fill:var(--page)}\
.frame{fill:none;stroke:var(--faint)}.seen{fill:var(--seen)}.error{stroke:var(--error);stroke-width:1.5}\
.dot{fill:var(--error);opacity:.6}";

/// The sheet, SVG.
pub fn draw(calibrated: &Calibrated) -> String {
    let camera = &calibrated.camera;
    let scale = WIDTH / f64::from(camera.width);
    let height = f64::from(camera.height) * scale;
    let (sheet_width, sheet_height) =
        (WIDTH + SCATTER + 3.0 * MARGIN, height.max(SCATTER) + 2.0 * MARGIN + 30.0);
    let rms = calibrated.rms_px.max(1e-6);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {sheet_width:.0} {sheet_height:.0}\" role=\"img\" \
         aria-label=\"Errors of a calibration\"><style>{STYLES}</style><rect class=\"page\" width=\"100%\" height=\"100%\"/>\
         <rect class=\"frame\" x=\"{MARGIN}\" y=\"{MARGIN}\" width=\"{WIDTH}\" height=\"{height:.1}\"/>"
    );
    let (middle_x, middle_y) = (WIDTH + 2.0 * MARGIN + 0.5 * SCATTER, MARGIN + 0.5 * SCATTER);
    let _ = write!(
        svg,
        "<rect class=\"frame\" x=\"{:.1}\" y=\"{MARGIN}\" width=\"{SCATTER}\" height=\"{SCATTER}\"/>\
         <circle class=\"frame\" cx=\"{middle_x:.1}\" cy=\"{middle_y:.1}\" r=\"{:.1}\"/>",
        WIDTH + 2.0 * MARGIN,
        0.5 * SCATTER / REACH
    );
    for view in calibrated.views.iter().filter(|view| view.is_used) {
        for (pixel, residual) in view.pixels.iter().zip(&view.residuals) {
            let (x, y) = (MARGIN + (pixel.x + 0.5) * scale, MARGIN + (pixel.y + 0.5) * scale);
            let off = residual * (ARROW / rms);
            let _ = write!(
                svg,
                "<circle class=\"seen\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"1.5\"/>\
                 <line class=\"error\" x1=\"{x:.1}\" y1=\"{y:.1}\" x2=\"{:.1}\" y2=\"{:.1}\"/>",
                x + off.x,
                y + off.y
            );
            let at = residual.map(|error| 0.5 * SCATTER * (error / (REACH * rms)).clamp(-1.0, 1.0));
            let _ = write!(
                svg,
                "<circle class=\"dot\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"2\"/>",
                middle_x + at.x,
                middle_y + at.y
            );
        }
    }
    let below = sheet_height - 20.0;
    let _ = write!(
        svg,
        "<text x=\"{MARGIN}\" y=\"{below:.0}\">corners in {} views, errors drawn {:.0} times as long; {:.0} % of the image \
         covered</text><text x=\"{:.0}\" y=\"{below:.0}\">errors; the circle is their root mean square, {rms:.3} px</text></svg>",
        calibrated.views.iter().filter(|view| view.is_used).count(),
        ARROW / rms / scale,
        100.0 * calibrated.coverage,
        WIDTH + 2.0 * MARGIN,
    );
    svg
}

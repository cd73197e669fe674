//! Draws wall time against error of the scenes: a mark for each scene and level, in two panels. A
//! level with zero error, or one that loses the contact, has no position on a logarithmic scale and
//! is left out.

use super::{LEVELS, Row};
use taktil_lab_plot::axis::{Scale, decade_ticks};
use taktil_lab_plot::svg::{Anchor, COLOUR_COUNT, Figure, Point};

/// Panels: index of the measure, label below the axis.
const PICTURE_PANELS: [(usize, &str); 2] =
    [(0, "largest difference of M0 (% of its set point)"), (1, "largest difference of x_c (mm)")];
/// Width of a panel.
const PANEL_WIDTH_PX: f64 = 380.0;
/// Lower end of the plotting area.
const PLOT_BOTTOM_PX: f64 = 400.0;
/// Upper end of the plotting area.
const PLOT_TOP_PX: f64 = 50.0;

/// The picture of all rows.
#[must_use]
pub fn picture(rows: &[Row]) -> Figure {
    let mut figure = Figure::new(2.0 * PANEL_WIDTH_PX + 180.0, 450.0, "scenes: time against error");
    let head =
        "Scenes: ms a simulated second of the whole stack against error under the same motions";
    figure.text(60.0, 22.0, Anchor::Start, "head", head);
    let ms = |row: &Row| row.whole_stack.1;
    let y = decade_scale(rows.iter().map(ms), PLOT_BOTTOM_PX, PLOT_TOP_PX);
    for (place, (measure, foot)) in PICTURE_PANELS.into_iter().enumerate() {
        draw_panel(&mut figure, rows, (60.0 + PANEL_WIDTH_PX * place as f64, measure, foot), &y);
    }
    let left = 2.0 * PANEL_WIDTH_PX + 30.0;
    for (i, level) in LEVELS.iter().enumerate() {
        let up = PLOT_TOP_PX + 8.0 + 20.0 * i as f64;
        draw_mark(&mut figure, Point::new(left, up), i);
        figure.text(left + 10.0, up + 4.0, Anchor::Start, "small", &level.name());
    }
    figure
}

/// Levels beyond the number of colours are drawn as rings.
fn draw_mark(figure: &mut Figure, at: Point, level: usize) {
    figure.circle(at.x, at.y, 4.0, &format!("f{}", level % COLOUR_COUNT));
    if level >= COLOUR_COUNT {
        figure.circle(at.x, at.y, 2.0, "paper");
    }
}

/// A logarithmic scale from a power of ten to another one around the values.
fn decade_scale(values: impl Iterator<Item = f64>, from_px: f64, to_px: f64) -> Scale {
    let logs = values.filter(|v| v.is_finite() && *v > 0.0).map(libm::log10);
    let (low, high) = logs.fold((9.0, -12.0), |(l, h), v| (f64::min(l, v), f64::max(h, v)));
    let (low, high) = (libm::floor(low - 0.05), libm::ceil(high + 0.05));
    Scale { low, high: high.max(low + 1.0), from_px, to_px }
}

fn draw_panel(
    figure: &mut Figure,
    rows: &[Row],
    (left, measure, foot): (f64, usize, &str),
    y: &Scale,
) {
    let error = |row: &Row| row.prescribed_motion.most[measure];
    let x = decade_scale(rows.iter().map(error), left, left + PANEL_WIDTH_PX - 50.0);
    let power = |exponent: f64| libm::pow(10.0, exponent);
    for tick in decade_ticks(power(x.low), power(x.high), 8.0) {
        let place = x.position_px(libm::log10(tick.value));
        figure.line(Point::new(place, y.from_px), Point::new(place, y.to_px), "grid");
        figure.text(place, y.from_px + 18.0, Anchor::Middle, "small", &tick.label);
    }
    for tick in decade_ticks(power(y.low), power(y.high), 6.0) {
        let place = y.position_px(libm::log10(tick.value));
        figure.line(Point::new(x.from_px, place), Point::new(x.to_px, place), "grid");
        figure.text(x.from_px - 6.0, place + 4.0, Anchor::End, "small", &tick.label);
    }
    figure.text(
        0.5 * (x.from_px + x.to_px),
        PLOT_BOTTOM_PX + 38.0,
        Anchor::Middle,
        "small dim",
        foot,
    );
    for row in rows {
        let off = error(row);
        let Some(level) = LEVELS.iter().position(|level| *level == row.level) else { continue };
        if off > 0.0 && off.is_finite() {
            let at = Point::new(
                x.position_px(libm::log10(off)),
                y.position_px(libm::log10(row.whole_stack.1)),
            );
            draw_mark(figure, at, level);
            figure.text(at.x + 6.0, at.y + 3.0, Anchor::Start, "strip dim", &row.scene);
        }
    }
}

//! Draws histograms of times on two logarithmic axes, where a single late job among millions stays
//! visible. Bins without a positive upper edge are left out.

use super::axis::{Scale, decade_ticks, format_number};
use super::svg::{Anchor, COLOUR_COUNT, Figure, Point};

/// Counts between edges that grow by a constant factor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Histogram {
    /// What was counted.
    pub title: String,
    /// Upper edge of each bin, ascending, above 0, and its count.
    pub bins: Vec<(f64, f64)>,
    /// Values marked by a vertical line, with a name.
    pub marks: Vec<(f64, String)>,
    /// Index of the colour, modulo [`COLOUR_COUNT`].
    pub colour: usize,
}

/// Space for the labels of the vertical axis.
const LEFT_MARGIN_PX: f64 = 56.0;
/// Space beside the right end of the horizontal axis.
const RIGHT_MARGIN_PX: f64 = 14.0;
/// Height of the line with the title.
const TOP_MARGIN_PX: f64 = 30.0;
/// Space for the labels and the name of the horizontal axis.
const FOOT_HEIGHT_PX: f64 = 38.0;
/// Height of the name of a mark.
const MARK_HEIGHT_PX: f64 = 13.0;

/// A histogram of times in microseconds.
#[must_use]
pub fn log_histogram(histogram: &Histogram, width: f64, height: f64) -> Figure {
    let mut figure = Figure::new(width, height, &histogram.title);
    figure.text(LEFT_MARGIN_PX, 18.0, Anchor::Start, "name", &histogram.title);
    let bins: Vec<(f64, f64)> =
        histogram.bins.iter().copied().filter(|(edge, n)| *edge > 0.0 && *n >= 0.0).collect();
    let mut filled = bins.iter().filter(|(_, count)| *count > 0.0);
    let Some(first) = filled.next() else {
        figure.text(0.5 * width, 0.5 * height, Anchor::Middle, "dim", "nothing was counted");
        return figure;
    };
    let last = filled.next_back().unwrap_or(first);
    let factor = if bins.len() > 1 { (bins[1].0 / bins[0].0).max(1.001) } else { 2.0 };
    let marked = |edge: f64, pick: fn(f64, f64) -> f64| {
        histogram.marks.iter().map(|mark| mark.0).filter(|m| *m > 0.0).fold(edge, pick)
    };
    let low = marked(first.0 / factor, f64::min) / 1.2;
    let high = marked(last.0, f64::max) * 1.2;
    let most = bins.iter().map(|bin| bin.1).fold(1.0, f64::max);
    let log = libm::log10;
    let x = Scale {
        low: log(low),
        high: log(high),
        from_px: LEFT_MARGIN_PX,
        to_px: width - RIGHT_MARGIN_PX,
    };
    let y = Scale {
        low: log(0.5),
        high: log(most * 2.0),
        from_px: height - FOOT_HEIGHT_PX,
        to_px: TOP_MARGIN_PX,
    };
    for tick in decade_ticks(0.5, most * 2.0, 5.0) {
        let place = y.position_px(log(tick.value));
        figure.line(Point::new(x.from_px, place), Point::new(x.to_px, place), "grid");
        figure.text(LEFT_MARGIN_PX - 6.0, place + 4.0, Anchor::End, "small", &tick.label);
    }
    let class = format!("f{}", histogram.colour % COLOUR_COUNT);
    for &(edge, count) in bins.iter().filter(|(_, count)| *count > 0.0) {
        let (left, right) =
            (x.clamped_position_px(log(edge / factor)), x.clamped_position_px(log(edge)));
        let top = y.clamped_position_px(log(count));
        figure.rect(left + 0.4, top, (right - left - 0.8).max(0.6), y.from_px - top, &class);
    }
    // Each name stands below the one before it, so that marks that are near do not cross names.
    for (row, (value, name)) in histogram.marks.iter().filter(|mark| mark.0 > 0.0).enumerate() {
        let place = x.clamped_position_px(log(*value));
        figure.line(Point::new(place, TOP_MARGIN_PX), Point::new(place, y.from_px), "level");
        let left_half = place < 0.5 * width;
        let (anchor, shift) = if left_half { (Anchor::Start, 4.0) } else { (Anchor::End, -4.0) };
        let text = format!("{name} {}", format_number(*value));
        let height = TOP_MARGIN_PX + 11.0 + MARK_HEIGHT_PX * row as f64;
        figure.text(place + shift, height, anchor, "small dim", &text);
    }
    for tick in decade_ticks(low, high, 8.0) {
        let place = x.position_px(log(tick.value));
        figure.line(Point::new(place, y.from_px), Point::new(place, y.from_px + 4.0), "axis");
        figure.text(place, y.from_px + 16.0, Anchor::Middle, "small", &tick.label);
    }
    figure.line(Point::new(x.from_px, y.from_px), Point::new(x.to_px, y.from_px), "axis");
    let middle = 0.5 * (LEFT_MARGIN_PX + width - RIGHT_MARGIN_PX);
    figure.text(middle, height - 6.0, Anchor::Middle, "small dim", "\u{b5}s; jobs upwards");
    figure
}

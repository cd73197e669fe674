//! Draws lines over time: panels stacked on one time axis, with a strip of states above them.
//!
//! Where a line has more points than the picture has pixel columns, each column keeps the smallest
//! and the largest value, so that no spike is lost.

use super::axis::{Scale, finite_range, format_fixed, format_number, linear_ticks, padded_range};
use super::svg::{Anchor, COLOUR_COUNT, Figure, Point};

/// One line of a panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Name in the legend, and of the column in a CSV file.
    pub label: String,
    /// Times (s), ascending.
    pub t_s: Vec<f64>,
    /// Values; what is not finite is a gap.
    pub values: Vec<f64>,
    /// Index of the colour, modulo [`COLOUR_COUNT`].
    pub colour: usize,
    /// Whether the line is dashed, which marks a set point as opposed to a measurement.
    pub dashed: bool,
}

/// A range of values known from elsewhere, shown behind the lines.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// Lower end.
    pub low: f64,
    /// Upper end; the same as `low` for a level.
    pub high: f64,
}

/// One set of axes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Panel {
    /// What is shown, with its unit.
    pub title: String,
    /// A remark beside the title.
    pub note: String,
    /// Lines.
    pub lines: Vec<Line>,
    /// Values stated elsewhere.
    pub bands: Vec<Band>,
}

/// States over time, shown as a strip of named intervals.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StateStrip {
    /// Begin (s) and name, ascending; each lasts until the next begins.
    pub states: Vec<(f64, String)>,
}

/// Width of a figure.
const FIGURE_WIDTH_PX: f64 = 880.0;
/// Space for the labels of the vertical axis.
const LEFT_MARGIN_PX: f64 = 70.0;
/// Space beside the right end of the time axis.
const RIGHT_MARGIN_PX: f64 = 16.0;
/// Height of the line with the figure's title.
const TITLE_HEIGHT_PX: f64 = 30.0;
/// Height of the strip of states.
const STRIP_HEIGHT_PX: f64 = 16.0;
/// Height of the line with a panel's title and legend.
const PANEL_TITLE_HEIGHT_PX: f64 = 24.0;
/// Space between two panels.
const PANEL_GAP_PX: f64 = 8.0;
/// Space for the labels and the name of the time axis.
const FOOT_HEIGHT_PX: f64 = 38.0;

/// A figure of panels over a common time axis; `height` is that of each panel's plotting area (px).
#[must_use]
pub fn stacked_panels(title: &str, panels: &[Panel], strip: &StateStrip, height: f64) -> Figure {
    let times = panels.iter().flat_map(|panel| &panel.lines).flat_map(|line| &line.t_s);
    let (begin, end) = finite_range(times.copied()).unwrap_or((0.0, 1.0));
    // Sampled time ends just before a round number, which gets its tick by this rounding.
    let end = if end > begin { libm::ceil(end * 50.0 - 1e-9) / 50.0 } else { begin + 1.0 };
    let strip_height = if strip.states.is_empty() { 0.0 } else { STRIP_HEIGHT_PX + 4.0 };
    let count = panels.len() as f64;
    let total = TITLE_HEIGHT_PX
        + strip_height
        + count * (PANEL_TITLE_HEIGHT_PX + height + PANEL_GAP_PX)
        + FOOT_HEIGHT_PX;
    let mut figure = Figure::new(FIGURE_WIDTH_PX, total, title);
    figure.text(LEFT_MARGIN_PX, 20.0, Anchor::Start, "head", title);
    let x = Scale {
        low: begin,
        high: end,
        from_px: LEFT_MARGIN_PX,
        to_px: FIGURE_WIDTH_PX - RIGHT_MARGIN_PX,
    };
    draw_strip(&mut figure, strip, &x, TITLE_HEIGHT_PX);
    let mut top = TITLE_HEIGHT_PX + strip_height;
    for panel in panels {
        draw_panel(&mut figure, panel, &x, top, height);
        top += PANEL_TITLE_HEIGHT_PX + height + PANEL_GAP_PX;
    }
    let bottom = top - PANEL_GAP_PX;
    for tick in linear_ticks(begin, end, 10.0) {
        let place = x.position_px(tick.value);
        figure.line(Point::new(place, bottom), Point::new(place, bottom + 4.0), "axis");
        figure.text(place, bottom + 17.0, Anchor::Middle, "small", &tick.label);
    }
    let middle = 0.5 * (LEFT_MARGIN_PX + FIGURE_WIDTH_PX - RIGHT_MARGIN_PX);
    figure.text(middle, bottom + 32.0, Anchor::Middle, "small dim", "time (s)");
    figure
}

fn draw_strip(figure: &mut Figure, strip: &StateStrip, x: &Scale, top: f64) {
    for (index, (begin, name)) in strip.states.iter().enumerate() {
        let end = strip.states.get(index + 1).map_or(x.high, |next| next.0);
        let (left, right) = (x.clamped_position_px(*begin), x.clamped_position_px(end));
        if right - left < 0.5 {
            continue;
        }
        let class = if index % 2 == 0 { "state0" } else { "state1" };
        figure.rect(left, top, right - left, STRIP_HEIGHT_PX, class);
        // A letter takes about 6 px. A name that does not fit into its interval is left out.
        if right - left > 6.2 * name.chars().count() as f64 {
            figure.text(0.5 * (left + right), top + 12.0, Anchor::Middle, "strip", name);
        }
    }
}

/// The range of values that a panel shows: all of its lines, and the reference bands unless they
/// would squeeze the lines.
fn value_range(panel: &Panel) -> (f64, f64) {
    let values = panel.lines.iter().flat_map(|line| line.values.iter().copied());
    let stated = panel.bands.iter().flat_map(|band| [band.low, band.high]);
    match (finite_range(values), finite_range(stated)) {
        (None, None) => (-1.0, 1.0),
        (None, Some((low, high))) => padded_range(low, high),
        (Some((low, high)), None) => padded_range(low, high),
        (Some((low, high)), Some((from, to))) => {
            let width = (high - low).max(to - from);
            if (low.min(from) - low).abs() <= width && (high.max(to) - high).abs() <= width {
                padded_range(low.min(from), high.max(to))
            } else {
                padded_range(low, high)
            }
        }
    }
}

fn draw_panel(figure: &mut Figure, panel: &Panel, x: &Scale, top: f64, height: f64) {
    let (low, high) = value_range(panel);
    let above = top + PANEL_TITLE_HEIGHT_PX;
    let y = Scale { low, high, from_px: above + height, to_px: above };
    figure.text(LEFT_MARGIN_PX, top + 17.0, Anchor::Start, "name", &panel.title);
    if !panel.note.is_empty() {
        let after = LEFT_MARGIN_PX + 16.0 + 7.0 * panel.title.chars().count() as f64;
        figure.text(after, top + 17.0, Anchor::Start, "small dim", &panel.note);
    }
    legend(figure, panel, top);
    for band in &panel.bands {
        let (from, to) = (y.clamped_position_px(band.high), y.clamped_position_px(band.low));
        if band.high > band.low && to - from > 0.5 {
            figure.rect(x.from_px, from, x.to_px - x.from_px, to - from, "band");
        } else if (low..=high).contains(&band.low) {
            figure.line(
                Point::new(x.from_px, y.position_px(band.low)),
                Point::new(x.to_px, y.position_px(band.low)),
                "level",
            );
        }
    }
    for tick in linear_ticks(low, high, (height / 32.0).max(2.0)) {
        let place = y.position_px(tick.value);
        figure.line(Point::new(x.from_px, place), Point::new(x.to_px, place), "grid");
        figure.text(x.from_px - 6.0, place + 4.0, Anchor::End, "small", &tick.label);
    }
    for tick in linear_ticks(x.low, x.high, 10.0) {
        let place = x.position_px(tick.value);
        figure.line(Point::new(place, above), Point::new(place, above + height), "grid");
    }
    for line in &panel.lines {
        let dash = if line.dashed { " dash" } else { "" };
        let class = format!("line s{}{dash}", line.colour % COLOUR_COUNT);
        figure.polyline(&decimated_points(line, x, &y), &class);
    }
    let (left, right, below) = (x.from_px, x.to_px, above + height);
    let corners = [(left, above), (right, above), (right, below), (left, below), (left, above)]
        .map(|(x, y)| Point::new(x, y));
    figure.polyline(&corners, "axis");
}

fn legend(figure: &mut Figure, panel: &Panel, top: f64) {
    if panel.lines.len() < 2 {
        return;
    }
    let mut right = FIGURE_WIDTH_PX - RIGHT_MARGIN_PX;
    for line in panel.lines.iter().rev() {
        figure.text(right, top + 17.0, Anchor::End, "small", &line.label);
        right -= 6.4 * line.label.chars().count() as f64 + 5.0;
        let dash = if line.dashed { " dash" } else { "" };
        let class = format!("line key s{}{dash}", line.colour % COLOUR_COUNT);
        figure.line(Point::new(right - 20.0, top + 13.0), Point::new(right, top + 13.0), &class);
        right -= 32.0;
    }
}

/// The points of a line (px): all of them when they are few, otherwise the smallest and the largest
/// of each pixel column.
fn decimated_points(line: &Line, x: &Scale, y: &Scale) -> Vec<Point> {
    let at = |i: usize| Point::new(x.position_px(line.t_s[i]), y.position_px(line.values[i]));
    let count = line.t_s.len().min(line.values.len());
    let columns = x.to_px - x.from_px;
    if (count as f64) < 3.0 * columns {
        return (0..count).map(at).collect();
    }
    let column = |i: usize| x.position_px(line.t_s[i]).floor();
    let mut out = Vec::new();
    let mut start = 0;
    while start < count {
        let mut stop = start + 1;
        while stop < count && column(stop) == column(start) {
            stop += 1;
        }
        let finite = || (start..stop).filter(|i| line.values[*i].is_finite());
        let lowest = finite().min_by(|a, b| line.values[*a].total_cmp(&line.values[*b]));
        let highest = finite().max_by(|a, b| line.values[*a].total_cmp(&line.values[*b]));
        match (lowest, highest) {
            (Some(a), Some(b)) if a != b => out.extend([at(a.min(b)), at(a.max(b))]),
            (Some(a), _) => out.push(at(a)),
            // A gap in the values stays a gap in the line.
            _ => out.push(Point::new(f64::NAN, f64::NAN)),
        }
        start = stop;
    }
    out
}

/// A range as text, to about a hundredth of its width: `308 .. 342`.
#[must_use]
pub fn format_range(low: f64, high: f64) -> String {
    let width = high - low;
    if !(width > 0.0 && width.is_finite()) {
        return if low == high {
            format_number(low)
        } else {
            format!("{} .. {}", format_number(low), format_number(high))
        };
    }
    let decimals = 2.0 - libm::floor(libm::log10(width));
    format!("{} .. {}", format_fixed(low, decimals), format_fixed(high, decimals))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(count: usize, value: impl Fn(usize) -> f64) -> Line {
        Line {
            label: "a".into(),
            t_s: (0..count).map(|i| i as f64 * 0.0025).collect(),
            values: (0..count).map(value).collect(),
            colour: 0,
            dashed: false,
        }
    }

    #[test]
    fn a_spike_of_one_sample_survives_thinning() {
        let long = line(40_000, |i| if i == 12_345 { 100.0 } else { 0.0 });
        let x = Scale { low: 0.0, high: 100.0, from_px: 0.0, to_px: 800.0 };
        let y = Scale { low: 0.0, high: 100.0, from_px: 100.0, to_px: 0.0 };
        let points = decimated_points(&long, &x, &y);
        assert!(points.len() < 2 * 802);
        assert!(points.iter().any(|p| p.y < 0.01), "the spike is gone");
    }

    #[test]
    fn empty_and_undefined_panels_are_drawn() {
        let gap = line(10, |_| f64::NAN);
        let panels = [Panel::default(), Panel { lines: vec![gap], ..Panel::default() }];
        let text = stacked_panels("nothing", &panels, &StateStrip::default(), 80.0).svg_document();
        assert!(text.ends_with("</svg>\n"));
        assert!(!text.contains("NaN"));
    }

    #[test]
    fn ranges_keep_the_digits_that_tell_their_ends_apart() {
        assert_eq!(format_range(308.0, 342.0), "308 .. 342");
        assert_eq!(format_range(170.85, 171.25), "170.85 .. 171.25");
        assert_eq!(format_range(2.448, 14.61), "2.4 .. 14.6");
        assert_eq!(format_range(15_000.0, 15_000.0), "15000");
        assert_eq!(format_range(-0.0001, 20_000.0), "0 .. 20000");
        assert_eq!(format_range(f64::NAN, 1.0), "\u{2013} .. 1");
    }

    #[test]
    fn a_distant_reference_band_does_not_squeeze_the_lines() {
        let near = Panel {
            lines: vec![line(3, |i| 310.0 + i as f64)],
            bands: vec![Band { low: 308.0, high: 312.5 }],
            ..Panel::default()
        };
        assert!(value_range(&near).0 < 308.0);
        let far = Panel { bands: vec![Band { low: 0.0, high: 1.0 }], ..near };
        assert!(value_range(&far).0 > 300.0);
    }
}

//! Draws charts of curves over a length: one set of axes, a legend, remarks below, and several
//! charts above each other. A value that is not finite is a gap.

use taktil_lab_plot::axis::{Scale, finite_range, linear_ticks, padded_range};
use taktil_lab_plot::svg::{Anchor, COLOUR_COUNT, Figure, Point};

/// One curve.
pub(super) struct Curve {
    pub(super) label: String,
    pub(super) points: Vec<(f64, f64)>,
    pub(super) dashed: bool,
    /// Index of the colour; without it the position of the curve in the list decides.
    pub(super) colour: Option<usize>,
}

impl Curve {
    pub(super) fn new(
        label: impl Into<String>,
        x: &[f64],
        y: impl IntoIterator<Item = f64>,
    ) -> Self {
        let points = x.iter().copied().zip(y).collect();
        Self { label: label.into(), points, dashed: false, colour: None }
    }

    /// Smallest value, which is the peak where compression is negative.
    pub(super) fn minimum(&self) -> f64 {
        self.points.iter().fold(f64::INFINITY, |low, (_, y)| low.min(*y))
    }

    /// Value at the middle position.
    pub(super) fn middle_value(&self) -> f64 {
        self.points.get(self.points.len() / 2).map_or(f64::NAN, |(_, y)| *y)
    }

    pub(super) fn with_dashes(self) -> Self {
        Self { dashed: true, ..self }
    }

    pub(super) fn with_colour(self, colour: usize) -> Self {
        Self { colour: Some(colour), ..self }
    }
}

/// One chart: its curves, and remarks on what the thesis says and what is found here.
pub(super) struct Chart {
    pub(super) title: String,
    pub(super) x: &'static str,
    pub(super) y: &'static str,
    pub(super) curves: Vec<Curve>,
    pub(super) remarks: Vec<String>,
}

/// Width of a chart.
const CHART_WIDTH_PX: f64 = 760.0;
/// Height of the plotting area.
const PLOT_HEIGHT_PX: f64 = 260.0;
/// Space for the labels of the vertical axis.
const LEFT_MARGIN_PX: f64 = 76.0;
/// Space beside the right end of the horizontal axis.
const RIGHT_MARGIN_PX: f64 = 24.0;
/// Height of the title and of a legend of one line.
const HEAD_HEIGHT_PX: f64 = 52.0;
/// Height of one line of the legend or of the remarks.
const LINE_HEIGHT_PX: f64 = 17.0;
/// Width of one character in the legend.
const LETTER_WIDTH_PX: f64 = 6.3;
/// Width of the sample of a line in the legend, with its gaps.
const LEGEND_KEY_WIDTH_PX: f64 = 44.0;

impl Chart {
    /// Left ends of the legend's entries and their lines.
    fn legend(&self) -> Vec<(f64, usize)> {
        let (mut from, mut line) = (LEFT_MARGIN_PX, 0);
        let mut out = Vec::new();
        for curve in &self.curves {
            let wide = LEGEND_KEY_WIDTH_PX + LETTER_WIDTH_PX * curve.label.chars().count() as f64;
            if from > LEFT_MARGIN_PX && from + wide > CHART_WIDTH_PX {
                (from, line) = (LEFT_MARGIN_PX, line + 1);
            }
            out.push((from, line));
            from += wide;
        }
        out
    }

    pub(super) fn figure(&self) -> Figure {
        let legend = self.legend();
        let more = LINE_HEIGHT_PX * legend.last().map_or(0, |(_, line)| *line) as f64;
        let top = HEAD_HEIGHT_PX + more;
        let bottom = top + PLOT_HEIGHT_PX;
        let tall = bottom + 44.0 + LINE_HEIGHT_PX * self.remarks.len() as f64;
        let mut figure = Figure::new(CHART_WIDTH_PX, tall, &self.title);
        figure.text(LEFT_MARGIN_PX, 18.0, Anchor::Start, "head", &self.title);
        let all = || self.curves.iter().flat_map(|curve| curve.points.iter());
        let (low, high) = finite_range(all().map(|p| p.0)).unwrap_or((0.0, 1.0));
        let x =
            Scale { low, high, from_px: LEFT_MARGIN_PX, to_px: CHART_WIDTH_PX - RIGHT_MARGIN_PX };
        let (low, high) = finite_range(all().map(|p| p.1)).unwrap_or((0.0, 1.0));
        let (low, high) = padded_range(low, high);
        let y = Scale { low, high, from_px: bottom, to_px: top };
        for tick in linear_ticks(x.low, x.high, 10.0) {
            let place = x.position_px(tick.value);
            figure.line(Point::new(place, top), Point::new(place, bottom), "grid");
            figure.text(place, bottom + 15.0, Anchor::Middle, "small", &tick.label);
        }
        for tick in linear_ticks(y.low, y.high, 8.0) {
            let place = y.position_px(tick.value);
            figure.line(
                Point::new(LEFT_MARGIN_PX, place),
                Point::new(CHART_WIDTH_PX - RIGHT_MARGIN_PX, place),
                "grid",
            );
            figure.text(LEFT_MARGIN_PX - 6.0, place + 4.0, Anchor::End, "small", &tick.label);
        }
        for ((i, curve), (from, line)) in self.curves.iter().enumerate().zip(legend) {
            let dash = if curve.dashed { " dash" } else { "" };
            let class = format!("line s{}{dash}", curve.colour.unwrap_or(i) % COLOUR_COUNT);
            let point = |at: f64, value: f64| Point::new(x.position_px(at), y.position_px(value));
            let points: Vec<Point> =
                curve.points.iter().map(|(at, value)| point(*at, *value)).collect();
            figure.polyline(&points, &class);
            let at = 36.0 + LINE_HEIGHT_PX * line as f64;
            figure.line(Point::new(from, at), Point::new(from + 20.0, at), &class);
            figure.text(from + 25.0, at + 4.0, Anchor::Start, "small", &curve.label);
        }
        let corners = [
            (LEFT_MARGIN_PX, top),
            (CHART_WIDTH_PX - RIGHT_MARGIN_PX, top),
            (CHART_WIDTH_PX - RIGHT_MARGIN_PX, bottom),
            (LEFT_MARGIN_PX, bottom),
        ]
        .map(|(x, y)| Point::new(x, y));
        figure.polyline(&corners, "axis");
        figure.line(Point::new(LEFT_MARGIN_PX, top), Point::new(LEFT_MARGIN_PX, bottom), "axis");
        let middle = 0.5 * (LEFT_MARGIN_PX + CHART_WIDTH_PX - RIGHT_MARGIN_PX);
        let axes = format!("{} over {}", self.y, self.x);
        figure.text(middle, bottom + 32.0, Anchor::Middle, "small dim", &axes);
        for (i, remark) in self.remarks.iter().enumerate() {
            let at = bottom + 32.0 + LINE_HEIGHT_PX * (i + 1) as f64;
            figure.text(LEFT_MARGIN_PX, at, Anchor::Start, "small", remark);
        }
        figure
    }
}

/// Charts one above the other: the parts (a), (b) of one figure.
pub(super) fn stacked_charts(title: &str, charts: &[Chart]) -> Figure {
    let parts: Vec<Figure> = charts.iter().map(Chart::figure).collect();
    let tall: f64 = parts.iter().map(Figure::height).sum();
    let mut figure = Figure::new(CHART_WIDTH_PX, tall, title);
    let mut top = 0.0;
    for part in &parts {
        figure.embed(0.0, top, part);
        top += part.height();
    }
    figure
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(labels: &[&str]) -> Chart {
        let curves =
            labels.iter().map(|label| Curve::new(*label, &[0.0, 1.0], [f64::NAN, 2.0])).collect();
        Chart { title: "a < b".to_owned(), x: "x (mm)", y: "y", curves, remarks: Vec::new() }
    }

    #[test]
    fn a_long_legend_goes_on_in_a_second_line() {
        let long = "a label of some forty characters, or more";
        let one = chart(&[long, "b"]);
        assert!(one.legend().iter().all(|(_, line)| *line == 0));
        let two = chart(&[long, long, long]);
        let places = two.legend();
        assert_eq!(places[2], (LEFT_MARGIN_PX, 1));
        assert!(places.iter().all(|(from, _)| *from < CHART_WIDTH_PX));
        let more = two.figure().height() - one.figure().height();
        assert!((more - LINE_HEIGHT_PX).abs() < 1e-9);
        let both = stacked_charts("both", &[one, two]);
        assert!(both.svg_document().contains("a &lt; b"));
    }
}

//! Curves over a length: one set of axes, a legend, remarks below; several of them one above the
//! other. Refuses nothing: what is not finite is a gap.

use taktil_lab_plot::axis::{Scale, span, ticks, with_room};
use taktil_lab_plot::svg::{Anchor, COLOURS, Figure};

/// One curve.
pub(super) struct Curve {
    pub(super) label: String,
    pub(super) points: Vec<(f64, f64)>,
    pub(super) dashed: bool,
    /// Colour; that of its place among the curves without one.
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

    /// Smallest value: the peak, in signs where compression is negative.
    pub(super) fn lowest(&self) -> f64 {
        self.points.iter().fold(f64::INFINITY, |low, (_, y)| low.min(*y))
    }

    /// Value in the middle of the places.
    pub(super) fn middle(&self) -> f64 {
        self.points.get(self.points.len() / 2).map_or(f64::NAN, |(_, y)| *y)
    }

    pub(super) fn dashed(self) -> Self {
        Self { dashed: true, ..self }
    }

    pub(super) fn coloured(self, colour: usize) -> Self {
        Self { colour: Some(colour), ..self }
    }
}

/// One picture: what is shown, curves, and what the thesis says beside what we find.
pub(super) struct Chart {
    pub(super) title: String,
    pub(super) x: &'static str,
    pub(super) y: &'static str,
    pub(super) curves: Vec<Curve>,
    pub(super) remarks: Vec<String>,
}

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 260.0;
const LEFT: f64 = 76.0;
const RIGHT: f64 = 24.0;
const HEAD: f64 = 52.0;
const LINE: f64 = 17.0;
/// Of one character in the legend.
const LETTER: f64 = 6.3;
const KEY: f64 = 44.0;

impl Chart {
    /// Left ends of the legend's entries and their lines.
    fn legend(&self) -> Vec<(f64, usize)> {
        let (mut from, mut line) = (LEFT, 0);
        let mut out = Vec::new();
        for curve in &self.curves {
            let wide = KEY + LETTER * curve.label.chars().count() as f64;
            if from > LEFT && from + wide > WIDTH {
                (from, line) = (LEFT, line + 1);
            }
            out.push((from, line));
            from += wide;
        }
        out
    }

    pub(super) fn figure(&self) -> Figure {
        let legend = self.legend();
        let more = LINE * legend.last().map_or(0, |(_, line)| *line) as f64;
        let top = HEAD + more;
        let bottom = top + HEIGHT;
        let tall = bottom + 44.0 + LINE * self.remarks.len() as f64;
        let mut figure = Figure::new(WIDTH, tall, &self.title);
        figure.text(LEFT, 18.0, Anchor::Start, "head", &self.title);
        let all = || self.curves.iter().flat_map(|curve| curve.points.iter());
        let (low, high) = span(all().map(|p| p.0)).unwrap_or((0.0, 1.0));
        let x = Scale { low, high, from_px: LEFT, to_px: WIDTH - RIGHT };
        let (low, high) = span(all().map(|p| p.1)).unwrap_or((0.0, 1.0));
        let (low, high) = with_room(low, high);
        let y = Scale { low, high, from_px: bottom, to_px: top };
        for tick in ticks(x.low, x.high, 10.0) {
            let place = x.place(tick.value);
            figure.line((place, top), (place, bottom), "grid");
            figure.text(place, bottom + 15.0, Anchor::Middle, "small", &tick.label);
        }
        for tick in ticks(y.low, y.high, 8.0) {
            let place = y.place(tick.value);
            figure.line((LEFT, place), (WIDTH - RIGHT, place), "grid");
            figure.text(LEFT - 6.0, place + 4.0, Anchor::End, "small", &tick.label);
        }
        for ((i, curve), (from, line)) in self.curves.iter().enumerate().zip(legend) {
            let dash = if curve.dashed { " dash" } else { "" };
            let class = format!("line s{}{dash}", curve.colour.unwrap_or(i) % COLOURS);
            let points: Vec<(f64, f64)> =
                curve.points.iter().map(|p| (x.place(p.0), y.place(p.1))).collect();
            figure.strips(&points, &class);
            let at = 36.0 + LINE * line as f64;
            figure.line((from, at), (from + 20.0, at), &class);
            figure.text(from + 25.0, at + 4.0, Anchor::Start, "small", &curve.label);
        }
        let corners = [(LEFT, top), (WIDTH - RIGHT, top), (WIDTH - RIGHT, bottom), (LEFT, bottom)];
        figure.strips(&corners, "axis");
        figure.line((LEFT, top), (LEFT, bottom), "axis");
        let middle = 0.5 * (LEFT + WIDTH - RIGHT);
        let axes = format!("{} over {}", self.y, self.x);
        figure.text(middle, bottom + 32.0, Anchor::Middle, "small dim", &axes);
        for (i, remark) in self.remarks.iter().enumerate() {
            let at = bottom + 32.0 + LINE * (i + 1) as f64;
            figure.text(LEFT, at, Anchor::Start, "small", remark);
        }
        figure
    }
}

/// Charts one above the other: the parts (a), (b) of one figure.
pub(super) fn stacked(title: &str, charts: &[Chart]) -> Figure {
    let parts: Vec<Figure> = charts.iter().map(Chart::figure).collect();
    let tall: f64 = parts.iter().map(Figure::height).sum();
    let mut figure = Figure::new(WIDTH, tall, title);
    let mut top = 0.0;
    for part in &parts {
        figure.place(0.0, top, part);
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
        assert_eq!(places[2], (LEFT, 1));
        assert!(places.iter().all(|(from, _)| *from < WIDTH));
        let more = two.figure().height() - one.figure().height();
        assert!((more - LINE).abs() < 1e-9);
        let both = stacked("both", &[one, two]);
        assert!(both.file().contains("a &lt; b"));
    }
}

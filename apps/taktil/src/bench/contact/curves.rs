//! Curves over a length: one set of axes, a legend, remarks below. Refuses nothing: what is not
//! finite is a gap.

use crate::plot::axis::{Scale, span, ticks, with_room};
use crate::plot::svg::{Anchor, COLOURS, Figure};

/// One curve.
pub(super) struct Curve {
    pub(super) label: String,
    pub(super) points: Vec<(f64, f64)>,
    pub(super) dashed: bool,
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
const HEIGHT: f64 = 300.0;
const LEFT: f64 = 76.0;
const RIGHT: f64 = 16.0;
const HEAD: f64 = 52.0;
const LINE: f64 = 17.0;

impl Chart {
    pub(super) fn figure(&self) -> Figure {
        let foot = 44.0 + LINE * self.remarks.len() as f64;
        let mut figure = Figure::new(WIDTH, HEAD + HEIGHT + foot, &self.title);
        figure.text(LEFT, 18.0, Anchor::Start, "head", &self.title);
        let all = || self.curves.iter().flat_map(|curve| curve.points.iter());
        let (low, high) = span(all().map(|p| p.0)).unwrap_or((0.0, 1.0));
        let x = Scale { low, high, from_px: LEFT, to_px: WIDTH - RIGHT };
        let (low, high) = span(all().map(|p| p.1)).unwrap_or((0.0, 1.0));
        let (low, high) = with_room(low, high);
        let y = Scale { low, high, from_px: HEAD + HEIGHT, to_px: HEAD };
        for tick in ticks(x.low, x.high, 10.0) {
            let place = x.place(tick.value);
            figure.line((place, HEAD), (place, HEAD + HEIGHT), "grid");
            let below = HEAD + HEIGHT + 15.0;
            figure.text(place, below, Anchor::Middle, "small", &tick.label);
        }
        for tick in ticks(y.low, y.high, 8.0) {
            let place = y.place(tick.value);
            figure.line((LEFT, place), (WIDTH - RIGHT, place), "grid");
            figure.text(LEFT - 6.0, place + 4.0, Anchor::End, "small", &tick.label);
        }
        let mut from = LEFT;
        for (i, curve) in self.curves.iter().enumerate() {
            let dash = if curve.dashed { " dash" } else { "" };
            let class = format!("line s{}{dash}", i % COLOURS);
            let points: Vec<(f64, f64)> =
                curve.points.iter().map(|p| (x.place(p.0), y.place(p.1))).collect();
            figure.strips(&points, &class);
            figure.line((from, 36.0), (from + 20.0, 36.0), &class);
            figure.text(from + 25.0, 40.0, Anchor::Start, "small", &curve.label);
            from += 44.0 + 6.4 * curve.label.chars().count() as f64;
        }
        let bottom = HEAD + HEIGHT;
        let corners =
            [(LEFT, HEAD), (WIDTH - RIGHT, HEAD), (WIDTH - RIGHT, bottom), (LEFT, bottom)];
        figure.strips(&corners, "axis");
        figure.line((LEFT, HEAD), (LEFT, bottom), "axis");
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

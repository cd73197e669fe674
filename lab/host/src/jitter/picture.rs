//! Draws the histograms as one picture with counts on a logarithmic axis. Figures that do not
//! represent a robot's computer always carry a red banner.

use hdrhistogram::Histogram as Counts;

use super::Findings;
use super::report::{banner, headline};
use taktil_lab_plot::histogram::{Histogram, log_histogram};
use taktil_lab_plot::svg::{Anchor, Figure};

const FIGURE_WIDTH_PX: f64 = 640.0;
const FIGURE_HEIGHT_PX: f64 = 230.0;
const LINE_HEIGHT_PX: f64 = 18.0;
/// Number of classes of the picture in a factor of ten.
const PER_DECADE: i32 = 12;
/// Upper edge of the first class, ns as a power of ten.
const DECADE_FIRST: i32 = 1;
/// Upper edge of the last class, ns as a power of ten.
const DECADE_LAST: i32 = 9;

fn bins(counts: &Counts<u64>) -> Vec<(f64, f64)> {
    let mut below = 0;
    let mut bins = Vec::new();
    for class in DECADE_FIRST * PER_DECADE..=DECADE_LAST * PER_DECADE {
        let edge_ns = libm::exp10(f64::from(class) / f64::from(PER_DECADE));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1e1 to 1e9")]
        let upper = edge_ns as u64;
        let up_to = counts.count_between(0, upper);
        #[expect(clippy::cast_precision_loss, reason = "a count in a picture")]
        bins.push((edge_ns / 1000.0, up_to.saturating_sub(below) as f64));
        below = up_to.max(below);
    }
    bins
}

fn figure(title: String, counts: &Counts<u64>, colour: usize) -> Figure {
    #[expect(clippy::cast_precision_loss, reason = "nanoseconds in a picture")]
    let mark = |quantile: f64, name: &str| {
        (counts.value_at_quantile(quantile) as f64 / 1000.0, name.to_owned())
    };
    let marks = vec![mark(0.5, "p50"), mark(0.999, "p99.9")];
    log_histogram(
        &Histogram { title, bins: bins(counts), marks, colour },
        FIGURE_WIDTH_PX,
        FIGURE_HEIGHT_PX,
    )
}

/// The picture as the text of a file.
pub(super) fn draw(found: &Findings<'_>) -> String {
    let mut figures = Vec::new();
    for (lane, hz) in found.ours.lanes.iter().zip(&found.arguments.rate_hz) {
        figures.push(figure(format!("{hz} Hz: release lateness"), &lane.late, 0));
    }
    if let Some(comparison) = &found.comparison {
        figures.push(figure("cyclictest: latency".to_owned(), &comparison.theirs, 3));
    }
    let warnings = banner(found);
    #[expect(clippy::cast_precision_loss, reason = "a few lines and pictures")]
    let (red, rows) = (warnings.len() as f64 * LINE_HEIGHT_PX, figures.len() as f64);
    let top = 28.0 + red;
    let mut sheet = Figure::new(FIGURE_WIDTH_PX, top + rows * FIGURE_HEIGHT_PX, "release lateness");
    sheet.text(10.0, 18.0, Anchor::Start, "head", &headline(found));
    sheet.coloured_rect(0.0, 26.0, FIGURE_WIDTH_PX, red, "#ff8a80");
    for (index, line) in warnings.iter().enumerate() {
        let text = format!("NOT A ROBOT'S FIGURES: {line}");
        #[expect(clippy::cast_precision_loss, reason = "a few lines")]
        let y = 26.0 + (index as f64 + 0.72) * LINE_HEIGHT_PX;
        sheet.text(10.0, y, Anchor::Start, "name", &text);
    }
    for (index, figure) in figures.iter().enumerate() {
        #[expect(clippy::cast_precision_loss, reason = "a few pictures")]
        sheet.embed(0.0, top + index as f64 * FIGURE_HEIGHT_PX, figure);
    }
    sheet.svg_document()
}

#[cfg(test)]
mod tests {
    use super::super::measure::histogram;
    use super::*;

    #[test]
    fn classes_hold_every_count() {
        let mut counts = histogram();
        for value in [1, 40, 2_000, 2_100, 70_000, 900_000_000] {
            counts.record(value).unwrap();
        }
        let bins = bins(&counts);
        let sum: f64 = bins.iter().map(|bin| bin.1).sum();
        assert!((sum - 6.0).abs() < 1e-9, "{sum}");
        let factors: Vec<f64> = bins.windows(2).map(|pair| pair[1].0 / pair[0].0).collect();
        assert!(factors.iter().all(|f| (f - factors[0]).abs() < 1e-9));
    }
}

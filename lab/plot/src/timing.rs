//! Draws the lateness of the starts of jobs and their execution times, from the closing summary of
//! a run. In virtual time no job waits, so its lateness is not drawn.

use taktil_record::Log;
use taktil_record::summary::{LaneSummary, RunMode, Summary};

use super::histogram::{Histogram, log_histogram};
use super::svg::Figure;

/// Whether jobs waited for their releases, which is not the case in virtual time.
#[must_use]
pub fn waits(summary: &Summary) -> bool {
    summary.mode != RunMode::Fast
}

/// Lateness and execution of one lane.
#[derive(Clone, Debug, PartialEq)]
pub struct LaneTiming {
    /// Name of the lane.
    pub name: String,
    /// Lateness of the starts of jobs.
    pub late: Histogram,
    /// Execution times of jobs.
    pub execution: Histogram,
}

/// The lanes of a summary that have timing figures.
#[must_use]
pub fn lanes(summary: &Summary) -> Vec<LaneTiming> {
    summary.lanes.iter().filter_map(LaneTiming::new).collect()
}

impl LaneTiming {
    /// The figures of a lane; `None` where nothing was measured.
    fn new(lane: &LaneSummary) -> Option<LaneTiming> {
        let name = &lane.name;
        let p99 = |us: f64| (us > 0.0).then(|| (us, "p99".to_owned()));
        let deadline_us = lane.deadline_ns as f64 / 1e3;
        let late = Histogram {
            title: format!("{name}: release lateness"),
            bins: bins(&lane.release_late_bins),
            marks: p99(lane.release_late_us.p99).into_iter().collect(),
            colour: 0,
        };
        let execution = Histogram {
            title: format!("{name}: execution"),
            bins: bins(&lane.exec_bins),
            marks: p99(lane.exec_us.p99)
                .into_iter()
                .chain([(deadline_us, "deadline".to_owned())])
                .collect(),
            colour: 2,
        };
        let measured = !late.bins.is_empty() || !execution.bins.is_empty();
        measured.then(|| LaneTiming { name: name.clone(), late, execution })
    }
}

/// Upper edges (us) and jobs of a histogram.
fn bins(bins: &[(f64, u64)]) -> Vec<(f64, f64)> {
    bins.iter().map(|&(edge_us, jobs)| (edge_us, jobs as f64)).collect()
}

/// Width of one histogram.
const PICTURE_WIDTH_PX: f64 = 430.0;
/// Height of one histogram.
const PICTURE_HEIGHT_PX: f64 = 190.0;

/// Two pictures for each lane, lateness and execution; in virtual time only execution, because no
/// job waits.
#[must_use]
pub fn figures(summary: &Summary) -> Vec<Figure> {
    let waits = waits(summary);
    let drawn = |lane: LaneTiming| {
        let late = waits.then_some(lane.late);
        late.into_iter()
            .chain([lane.execution])
            .map(|histogram| log_histogram(&histogram, PICTURE_WIDTH_PX, PICTURE_HEIGHT_PX))
    };
    lanes(summary).into_iter().flat_map(drawn).collect()
}

/// All histograms of a log in one picture, or as a table; `None` when it has none.
///
/// # Errors
/// Metadata that are not a summary.
pub(super) fn page(log: &Log, csv: bool) -> anyhow::Result<Option<String>> {
    let Some(summary) = Summary::from_log(log)? else { return Ok(None) };
    if csv {
        let mut out = String::from("lane,what,up_to_us,jobs\n");
        let mut any = false;
        for lane in lanes(&summary) {
            for (what, histogram) in [("release_late", &lane.late), ("exec", &lane.execution)] {
                for (edge, count) in &histogram.bins {
                    out.push_str(&format!("{},{what},{edge},{count}\n", lane.name));
                    any = true;
                }
            }
        }
        return Ok(any.then_some(out));
    }
    let all = figures(&summary);
    if all.is_empty() {
        return Ok(None);
    }
    let rows = all.len().div_ceil(2);
    let mut sheet =
        Figure::new(2.0 * PICTURE_WIDTH_PX, rows as f64 * PICTURE_HEIGHT_PX, "timing of the lanes");
    for (index, figure) in all.iter().enumerate() {
        let (row, column) = (index / 2, index % 2);
        sheet.embed(column as f64 * PICTURE_WIDTH_PX, row as f64 * PICTURE_HEIGHT_PX, figure);
    }
    Ok(Some(sheet.svg_document()))
}

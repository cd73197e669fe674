//! Cuts the regions of a surface where a profile touches into cells: margins, grids, and the edges
//! of the cells. A run is such a region.

use taktil_contact::plane::compliance::CELLS_MAX;

/// Margin of cells on each side of a run in contact, as a fraction of the run's length.
const MARGIN_SHARE: f64 = 0.06;
/// Widest cell between two runs in contact, in thicknesses of the layer.
pub(super) const GAP_CELL_WIDTH_MAX: f64 = 10.0;

/// Regions of the surface in mm, ascending.
pub(super) type Runs = Vec<[f64; 2]>;

/// Edges of `n` cells of equal width.
fn uniform_edges([low, high]: [f64; 2], n: u32) -> Vec<f64> {
    (0..=n).map(|i| low + (high - low) * (f64::from(i) / f64::from(n))).collect()
}

/// Number of cells of at most `width` over a length. The number is capped just above what a bed
/// accepts.
pub(super) fn cells_over(length: f64, width: f64) -> u32 {
    (length / width).ceil().min(CELLS_MAX as f64 + 1.0) as u32
}

/// Edges of about `n` cells in `runs`, none wider than `widest` thicknesses, with wide cells
/// between the runs. The number is capped just above what a bed accepts.
pub(super) fn cell_edges(runs: &[[f64; 2]], n: u32, thickness_mm: f64, widest: f64) -> Vec<f64> {
    let total: f64 = runs.iter().map(|[from, to]| to - from).sum();
    let mut edges: Vec<f64> = Vec::new();
    for [from, to] in runs {
        if let Some(&last) = edges.last() {
            let between = uniform_edges(
                [last, *from],
                cells_over(from - last, GAP_CELL_WIDTH_MAX * thickness_mm),
            );
            edges.extend(&between[1..between.len() - 1]);
        }
        let share = (f64::from(n) * ((to - from) / total)).max(8.0) as u32;
        edges.extend(uniform_edges(
            [*from, *to],
            share.max(cells_over(to - from, widest * thickness_mm)),
        ));
    }
    edges
}

/// Sum of the lengths of all runs (mm).
pub(super) fn total_length(runs: &[[f64; 2]]) -> f64 {
    runs.iter().map(|[from, to]| to - from).sum()
}

/// A run with a margin on both sides, extended to a grid over the whole shape. A contact that moves
/// a little keeps its cells, so that the results of two similar requests can be subtracted.
pub(super) fn snapped_run([from, to]: [f64; 2], beside: f64, whole: [f64; 2]) -> [f64; 2] {
    let mut step = whole[1] - whole[0];
    if !step.is_finite() {
        return whole;
    }
    while step > 0.1 * (to - from + beside) {
        step *= 0.5;
    }
    let down = ((from - beside - whole[0]) / step).floor() * step + whole[0];
    let up = ((to + beside - whole[0]) / step).ceil() * step + whole[0];
    [down.max(whole[0]), up.min(whole[1])]
}

/// Runs in contact, each with a margin on both sides.
pub(super) fn with_margins(bare: &[[f64; 2]], edges: &[f64], whole: [f64; 2]) -> Runs {
    let mut runs: Runs = Vec::new();
    for &[from, to] in bare {
        let after = edges.partition_point(|edge| *edge <= from);
        let beside = (edges[after] - edges[after - 1]).max(MARGIN_SHARE * (to - from));
        runs.push([(from - beside).max(whole[0]), (to + beside).min(whole[1])]);
    }
    merge_runs(runs)
}

/// Runs in ascending order; runs that touch are merged.
pub(super) fn merge_runs(mut runs: Runs) -> Runs {
    runs.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut apart: Runs = Vec::new();
    for run in runs {
        match apart.last_mut() {
            Some(last) if run[0] <= last[1] => last[1] = last[1].max(run[1]),
            _ => apart.push(run),
        }
    }
    apart
}

/// True when the contact ends at the end of its run of cells and not at the end of the shape
/// itself. The contact would then extend further, and the solution is cut off.
pub(super) fn is_cut(bare: &[[f64; 2]], runs: &[[f64; 2]], whole: [f64; 2]) -> bool {
    let free = |[from, to]: &[f64; 2]| {
        runs.iter().any(|run| {
            let slack = 1e-9 * (run[1] - run[0]);
            let left = *from > run[0] + slack || run[0] <= whole[0];
            let right = *to < run[1] - slack || run[1] >= whole[1];
            left && right && *from >= run[0] - slack && *to <= run[1] + slack
        })
    };
    !bare.iter().all(free)
}

//! How many points an interval gets, by level and width. It refuses nothing: callers compare with
//! the points that they have.

use super::Level;

/// Points at least, and for each thickness of half-width: the kernel's nearest singularities lie
/// 2i thicknesses away, so the error falls as exp(-4 n/half) where that is the slower.
fn density(level: Level) -> [f64; 2] {
    match level {
        Level::Fast => [5.0, 3.2],
        Level::Default => [10.0, 4.9],
        Level::Fine => [14.0, 6.4],
    }
}

/// Points for a half-width of `half` thicknesses.
pub(super) fn points(level: Level, half: f64) -> usize {
    let [least, each] = density(level);
    // In steps, so that the nodes can often be kept while an edge is searched.
    let step = if level == Level::Fast { 2 } else { 4 };
    (libm::ceil((least + each * half).min(1e6)) as usize).next_multiple_of(step)
}

/// Largest half-width in thicknesses for so many points.
pub(super) fn widest(level: Level, points: usize) -> f64 {
    let [least, each] = density(level);
    (points as f64 - 4.0 - least) / each
}

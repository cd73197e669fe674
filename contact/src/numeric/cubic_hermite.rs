//! Cubics through values and slopes on a uniform grid, and curves made of them.

/// Cubic through two values with their slopes per cell, at 0 <= s <= 1.
#[inline]
pub(crate) fn hermite(left: [f64; 2], right: [f64; 2], s: f64) -> f64 {
    let rise = right[0] - left[0];
    let (bend_left, bend_right) = (left[1] - rise, rise - right[1]);
    let r = 1.0 - s;
    left[0] + s * (rise + r * (r * bend_left + s * bend_right))
}

/// Derivative of [`hermite`] with respect to s.
pub(crate) fn hermite_slope(left: [f64; 2], right: [f64; 2], s: f64) -> f64 {
    let rise = right[0] - left[0];
    let r = 1.0 - s;
    6.0 * rise * s * r + left[1] * r * (r - 2.0 * s) + right[1] * s * (s - 2.0 * r)
}

/// Cubic spline of Catmull and Rom through `values` at 0, 1, 2 ..., at a place inside the table.
pub(crate) fn catmull_rom(values: &[f64], index: f64) -> f64 {
    let last = values.len() - 1;
    let i = (index as usize).min(last - 1);
    let slope = |k: usize| {
        let (low, high) = (k.saturating_sub(1), (k + 1).min(last));
        (values[high] - values[low]) / (high - low) as f64
    };
    hermite([values[i], slope(i)], [values[i + 1], slope(i + 1)], index - i as f64)
}

/// [`catmull_rom`] for increasing values, with slopes limited to three times the neighbouring
/// differences, so that the curve increases between the values too (Fritsch and Carlson 1980).
pub(crate) fn monotone_cubic(values: &[f64], index: f64) -> f64 {
    let last = values.len() - 1;
    let i = (index as usize).min(last - 1);
    let slope = |k: usize| {
        let (low, high) = (k.saturating_sub(1), (k + 1).min(last));
        let (left, right) = (values[k] - values[low], values[high] - values[k]);
        let mean = (left + right) / (high - low) as f64;
        if low == k || high == k { mean } else { mean.min(3.0 * left).min(3.0 * right) }
    };
    hermite([values[i], slope(i)], [values[i + 1], slope(i + 1)], index - i as f64)
}

//! Limits of revolute joints whose range is wider than one turn. An angle and the same angle plus
//! whole turns are *equivalent*: they reach the same pose. This module finds whether an equivalent
//! lies inside the limits, and the one nearest to a given angle.

use core::f64::consts::{PI, TAU};

use nalgebra::SVector;

/// Whether an equivalent of `angle_rad`, which lies in `[-pi, pi)`, is inside `low..=high` (rad).
#[must_use]
#[inline]
pub fn has_equivalent_in_range(low: f64, high: f64, angle_rad: f64) -> bool {
    if angle_rad < low {
        // The lowest equivalent that is not below the lower limit. For most limits it is one turn
        // away, which needs no division.
        let once = angle_rad + TAU;
        let first = if once >= low { once } else { once + TAU * ((low - once) / TAU).ceil() };
        return first <= high;
    }
    if angle_rad > high {
        // The highest equivalent that is not above the upper limit.
        let once = angle_rad - TAU;
        let first = if once <= high { once } else { once - TAU * ((once - high) / TAU).ceil() };
        return low <= first;
    }
    true
}

/// The equivalent of the joint vector `q` inside `low..=high` that is nearest to `previous` (all in
/// rad), and its largest distance from `previous` over all joints (rad). Each joint is shifted by
/// whole turns of its own. `None` where a joint has no equivalent inside its limits or `previous`
/// holds a number that is not finite.
#[must_use]
#[inline]
pub fn nearest_equivalent<const N: usize>(
    q: &SVector<f64, N>,
    previous: &SVector<f64, N>,
    low: &SVector<f64, N>,
    high: &SVector<f64, N>,
) -> Option<(SVector<f64, N>, f64)> {
    let mut out = *q;
    let mut distance: f64 = 0.0;
    for i in 0..N {
        let (low, high, wanted) = (low[i], high[i], previous[i]);
        if !wanted.is_finite() {
            return None;
        }
        let offset = wanted.max(low).min(high) - q[i];
        let near = if offset.abs() <= PI { q[i] } else { q[i] + TAU * (offset / TAU).round() };
        // The nearest equivalent may lie beyond a limit although the next one is inside.
        let shifted = if near < low {
            near + TAU
        } else if near > high {
            near - TAU
        } else {
            near
        };
        if shifted < low || shifted > high {
            return None;
        }
        out[i] = shifted;
        distance = distance.max((shifted - wanted).abs());
    }
    Some((out, distance))
}

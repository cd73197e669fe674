//! Limits of joints that may turn further than once: whole turns against a range, and the turn
//! nearest to where a joint was. Refuses to move an angle other than by whole turns.

use core::f64::consts::{PI, TAU};

use nalgebra::SVector;

/// Whether some whole-turn shift of `angle_rad`, which lies in `[-pi, pi)`, is in `low..=high`
/// (rad).
#[must_use]
#[inline]
pub fn has_equivalent_in_range(low: f64, high: f64, angle_rad: f64) -> bool {
    if angle_rad < low {
        // The first turn at or above the lower limit; one is enough for most limits.
        let once = angle_rad + TAU;
        let first = if once >= low { once } else { once + TAU * ((low - once) / TAU).ceil() };
        return first <= high;
    }
    if angle_rad > high {
        let once = angle_rad - TAU;
        let first = if once <= high { once } else { once - TAU * ((once - high) / TAU).ceil() };
        return low <= first;
    }
    true
}

/// The whole-turn shift of `q` inside `low..=high` nearest to `previous` (rad), and the largest
/// joint distance. Joints are independent, so each takes its own nearest turn. `None` where no
/// turn is inside or `previous` holds a number that is not finite.
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
        let (low, high, wish) = (low[i], high[i], previous[i]);
        if !wish.is_finite() {
            return None;
        }
        let away = wish.max(low).min(high) - q[i];
        let near = if away.abs() <= PI { q[i] } else { q[i] + TAU * (away / TAU).round() };
        let turned = if near < low {
            near + TAU
        } else if near > high {
            near - TAU
        } else {
            near
        };
        if turned < low || turned > high {
            return None;
        }
        out[i] = turned;
        distance = distance.max((turned - wish).abs());
    }
    Some((out, distance))
}

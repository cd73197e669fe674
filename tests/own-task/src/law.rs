//! The law: a pure function, tested by itself.

use core::f64::consts::TAU;

/// How far from where it stood, and how fast (rad, rad/s), `t_s` after the beginning: to the other
/// end `span_rad` away and back in `period_s`, at rest at both.
pub fn offset(span_rad: f64, period_s: f64, t_s: f64) -> (f64, f64) {
    let (half, rate) = (0.5 * span_rad, TAU / period_s);
    (half * (1.0 - libm::cos(rate * t_s)), half * rate * libm::sin(rate * t_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_begins_and_ends_at_rest_where_it_stood() {
        let (span, period) = (0.5, 2.0);
        for t in [0.0, 2.0, 4.0] {
            let (angle, speed) = offset(span, period, t);
            assert!(angle.abs() < 1e-15 && speed.abs() < 1e-14, "{t}");
        }
        assert_eq!(offset(span, period, 1.0).0, span, "the other end");
        let (before, _) = offset(span, period, 0.5 - 1e-6);
        let (after, _) = offset(span, period, 0.5 + 1e-6);
        assert!((offset(span, period, 0.5).1 - (after - before) / 2e-6).abs() < 1e-8);
    }
}

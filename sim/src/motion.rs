//! Motion profiles of one coordinate: ramps with or without blends, minimum-jerk steps, sinusoids,
//! curves through points. Values have the unit of the configuration. The values never jump.

use core::f64::consts::TAU;

use crate::scene::{Motion, MotionKind, STEP_DURATION_S};

/// The profile of a motion, ready to be evaluated at any instant.
#[derive(Clone, Debug)]
pub(crate) enum MotionProfile {
    /// A constant rate with blends at both ends.
    Ramp { rate: f64, from_s: f64, to_s: f64, blend_s: f64 },
    /// A minimum-jerk change.
    Step { by: f64, from_s: f64, to_s: f64 },
    /// A sinusoid.
    Sine { amplitude: f64, frequency_hz: f64, from_s: f64, to_s: f64 },
    /// A curve through knots.
    Points(Vec<Knot>),
}

/// A point of a curve.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Knot {
    t_s: f64,
    value: f64,
    slope: f64,
}

impl MotionProfile {
    /// The profile of a checked motion; allocates.
    pub(crate) fn new(motion: &Motion) -> MotionProfile {
        let from_s = motion.from_s;
        let of = |deg: Option<f64>, mm| motion.by_unit(deg, mm).unwrap_or(0.0);
        match motion.kind {
            MotionKind::Ramp => MotionProfile::Ramp {
                rate: of(motion.rate_deg_s, motion.rate_mm_s),
                from_s,
                to_s: motion.to_s.unwrap_or(from_s),
                blend_s: motion.blend_s.unwrap_or(0.0),
            },
            MotionKind::Step => MotionProfile::Step {
                by: of(motion.by_deg, motion.by_mm),
                from_s,
                to_s: motion.to_s.unwrap_or(from_s + STEP_DURATION_S),
            },
            MotionKind::Sine => MotionProfile::Sine {
                amplitude: of(motion.amplitude_deg, motion.amplitude_mm),
                frequency_hz: motion.frequency_hz.unwrap_or(1.0),
                from_s,
                to_s: motion.to_s.unwrap_or(f64::INFINITY),
            },
            MotionKind::Points => {
                let points = motion.by_unit(&motion.points_deg, &motion.points_mm);
                MotionProfile::Points(knots(points.as_deref().unwrap_or_default(), from_s))
            }
        }
    }

    /// A curve through points (s, value), at rest before the first and after the last.
    pub(crate) fn through(points: &[[f64; 2]]) -> MotionProfile {
        MotionProfile::Points(knots(points, 0.0))
    }

    /// Value and rate at an instant (s).
    pub(crate) fn at(&self, t_s: f64) -> (f64, f64) {
        match self {
            MotionProfile::Ramp { rate, from_s, to_s, blend_s } => {
                ramp(*rate, t_s, *from_s, *to_s, *blend_s)
            }
            MotionProfile::Step { by, from_s, to_s } => step(*by, t_s, *from_s, *to_s),
            MotionProfile::Sine { amplitude, frequency_hz, from_s, to_s } => {
                let end = t_s.clamp(*from_s, *to_s);
                let (sin, cos) = libm::sincos(TAU * frequency_hz * (end - from_s));
                let moves = t_s >= *from_s && t_s < *to_s;
                let rate = if moves { amplitude * TAU * frequency_hz * cos } else { 0.0 };
                (amplitude * sin, rate)
            }
            MotionProfile::Points(knots) => along(knots, t_s),
        }
    }
}

/// Value and rate of a ramp. With blends the rate rises and falls on straight lines, so that the
/// distance is shorter by one blend.
fn ramp(rate: f64, t_s: f64, from_s: f64, to_s: f64, blend_s: f64) -> (f64, f64) {
    let moves = t_s >= from_s && t_s < to_s;
    let gone = t_s.clamp(from_s, to_s) - from_s;
    if blend_s <= 0.0 {
        return (rate * gone, if moves { rate } else { 0.0 });
    }
    // The distance is the area under the trapezoid of the rate, from both ends.
    let up = gone.min(blend_s);
    let late = (gone - (to_s - from_s - blend_s)).max(0.0);
    let way = up * up / (2.0 * blend_s) + (gone - up) - late * late / (2.0 * blend_s);
    let share = (up / blend_s).min(1.0 - late / blend_s);
    (rate * way, if moves { rate * share } else { 0.0 })
}

/// Value and rate of the minimum-jerk polynomial (Flash and Hogan 1985).
fn step(by: f64, t_s: f64, from_s: f64, to_s: f64) -> (f64, f64) {
    let span = to_s - from_s;
    let u = ((t_s - from_s) / span).clamp(0.0, 1.0);
    let value = by * u * u * u * (10.0 + u * (6.0 * u - 15.0));
    let rest = 1.0 - u;
    (value, 30.0 * by / span * u * u * rest * rest)
}

/// Knots with the slopes of Fritsch and Butland (1984): harmonic means of the neighbouring secants,
/// zero at an extremum, so that the curve never overshoots its points. It starts and ends at rest.
fn knots(points: &[[f64; 2]], from_s: f64) -> Vec<Knot> {
    let secant = |i: usize| {
        let ([t0, v0], [t1, v1]) = (points[i], points[i + 1]);
        (v1 - v0) / (t1 - t0)
    };
    let slope = |i: usize| {
        if i == 0 || i + 1 >= points.len() {
            return 0.0;
        }
        let (before, after) = (secant(i - 1), secant(i));
        if before * after <= 0.0 { 0.0 } else { 2.0 * before * after / (before + after) }
    };
    let knot = |(i, [t, value]): (usize, &[f64; 2])| Knot {
        t_s: from_s + t,
        value: *value,
        slope: slope(i),
    };
    points.iter().enumerate().map(knot).collect()
}

/// Value and rate of Hermite's cubic between the knots, at rest outside them.
fn along(knots: &[Knot], t_s: f64) -> (f64, f64) {
    let next = knots.partition_point(|knot| knot.t_s <= t_s);
    let (Some(a), Some(b)) = (next.checked_sub(1).and_then(|i| knots.get(i)), knots.get(next))
    else {
        let end = if next == 0 { knots.first() } else { knots.last() };
        return (end.map_or(0.0, |knot| knot.value), 0.0);
    };
    let span = b.t_s - a.t_s;
    let u = (t_s - a.t_s) / span;
    let (rise, w) = (b.value - a.value, 1.0 - u);
    let bend = w * (a.slope * span - rise) - u * (b.slope * span - rise);
    let value = a.value + u * rise + u * w * bend;
    let turn = (b.slope * span - rise) + (a.slope * span - rise);
    (value, (rise + (1.0 - 2.0 * u) * bend - u * w * turn) / span)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Axis;

    fn courses() -> Vec<(&'static str, MotionProfile)> {
        let mut ramp = Motion::ramp(Axis::Pan, 5.0, 1.0, 3.0);
        let plain = MotionProfile::new(&ramp);
        ramp.blend_s = Some(0.5);
        let mut step = Motion::of(Axis::Slide, MotionKind::Step);
        (step.from_s, step.by_mm, step.to_s) = (1.0, Some(-7.0), Some(1.5));
        let mut sine = Motion::of(Axis::TiltX, MotionKind::Sine);
        (sine.from_s, sine.amplitude_deg, sine.frequency_hz) = (0.5, Some(2.0), Some(1.5));
        let mut points = Motion::of(Axis::Height, MotionKind::Points);
        points.points_mm = Some(vec![[0.5, 1.0], [1.0, 4.0], [1.7, 4.5], [2.0, -1.0], [3.0, -1.0]]);
        vec![
            ("ramp", plain),
            ("blended ramp", MotionProfile::new(&ramp)),
            ("step", MotionProfile::new(&step)),
            ("sine", MotionProfile::new(&sine)),
            ("points", MotionProfile::new(&points)),
        ]
    }

    #[test]
    fn rates_are_derivatives_and_values_never_jump() {
        let h = 1e-6;
        for (name, course) in courses() {
            for i in 0..400 {
                let t = 0.01 * f64::from(i) + 0.003;
                let slope = (course.at(t + h).0 - course.at(t - h).0) / (2.0 * h);
                let rate = course.at(t).1;
                assert!((slope - rate).abs() < 1e-4, "{name} at {t}: {slope} {rate}");
            }
        }
    }

    #[test]
    fn blends_shorten_a_ramp_by_one_blend_and_steps_arrive() {
        let courses = courses();
        assert!((courses[0].1.at(9.0).0 - 10.0).abs() < 1e-12);
        assert!((courses[1].1.at(9.0).0 - 7.5).abs() < 1e-12);
        assert!((courses[1].1.at(1.25).1 - 2.5).abs() < 1e-12);
        assert!((courses[2].1.at(9.0).0 + 7.0).abs() < 1e-12);
        assert_eq!(courses[2].1.at(1.0), (0.0, 0.0));
    }

    #[test]
    fn a_curve_passes_its_points_and_never_overshoots_them() {
        let (_, course) = courses().pop().unwrap();
        for (t, value) in [(0.0, 1.0), (0.5, 1.0), (1.0, 4.0), (1.7, 4.5), (2.0, -1.0), (8.0, -1.0)]
        {
            assert!((course.at(t).0 - value).abs() < 1e-12, "{t}");
        }
        for i in 0..500 {
            let value = course.at(0.01 * f64::from(i)).0;
            assert!((-1.0..=4.5).contains(&value), "{value}");
        }
    }
}

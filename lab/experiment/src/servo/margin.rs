//! The sampled loop of one joint. Its response is the measured response of the law to sines,
//! multiplied by the exact discrete motion of an inertia whose torque acts a fraction of a tick
//! late. The law is not modelled: the code that runs is measured.
//!
//! The joint is a free inertia without friction, the least stable case, because any damping only
//! improves stability.

use core::f64::consts::PI;

use taktil_mechanics::Joints;
use taktil_tasks_joint_servo::law::Pd;

/// Number of samples before a sine is measured.
const SETTLING_SAMPLES: usize = 1200;
/// Number of measured samples.
const MEASURED_SAMPLES: usize = 4000;
/// Points of the frequency sweep.
const SWEEP_POINTS: usize = 240;
/// Amplitude of the sines (rad).
const SINE_AMPLITUDE_RAD: f64 = 1e-4;

/// A complex number.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Complex(f64, f64);

impl Complex {
    fn from_angle(angle: f64) -> Complex {
        let (sin, cos) = libm::sincos(angle);
        Complex(cos, sin)
    }

    fn product(self, b: Complex) -> Complex {
        Complex(self.0 * b.0 - self.1 * b.1, self.0 * b.1 + self.1 * b.0)
    }

    fn sum(self, b: Complex) -> Complex {
        Complex(self.0 + b.0, self.1 + b.1)
    }

    fn quotient(self, b: Complex) -> Complex {
        let size = b.0 * b.0 + b.1 * b.1;
        Complex((self.0 * b.0 + self.1 * b.1) / size, (self.1 * b.0 - self.0 * b.1) / size)
    }

    fn magnitude(self) -> f64 {
        libm::hypot(self.0, self.1)
    }
}

/// The loop of one joint.
#[derive(Clone, Debug)]
pub struct JointLoop {
    /// The law, at rest.
    pub law: Pd,
    /// The joint's inertia (kg m^2).
    pub inertia_kg_m2: f64,
    /// Index of the joint in the law.
    pub joint: usize,
    /// Control period (s).
    pub tick_s: f64,
    /// Fraction of the period after which a torque acts.
    pub delay: f64,
}

/// Stability margins of a loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StabilityMargins {
    /// Crossover frequency, at which the loop's gain is 1 (rad/s).
    pub crossing_rad_s: f64,
    /// Phase margin at the crossover (deg).
    pub phase_deg: f64,
    /// Delay margin, the delay that uses up the phase margin (ms).
    pub delay_ms: f64,
    /// Factor by which the gain could increase.
    pub gain: f64,
    /// Factor by which the gain could decrease; 0 when any decrease is stable.
    pub gain_low: f64,
    /// Largest amplification of a disturbance.
    pub sensitivity: f64,
    /// The gain factor at which a simulated loop becomes unstable.
    pub gain_simulated: f64,
}

impl JointLoop {
    /// Response of the law to a sine of `cycles` in [`MEASURED_SAMPLES`] samples: torque over
    /// error.
    fn law_response(&self, cycles: usize) -> Complex {
        let mut law = self.law;
        let (mut re, mut im) = (0.0, 0.0);
        #[expect(clippy::cast_precision_loss, reason = "a few thousand")]
        let step = 2.0 * PI * cycles as f64 / MEASURED_SAMPLES as f64;
        for sample in 0..SETTLING_SAMPLES + MEASURED_SAMPLES {
            #[expect(clippy::cast_precision_loss, reason = "a few thousand")]
            let (sin, cos) = libm::sincos(step * sample as f64);
            let error = Joints::repeat(SINE_AMPLITUDE_RAD * cos);
            let torque = law.torque_nm(&error, self.tick_s).map_or(0.0, |tau| tau[self.joint]);
            if sample >= SETTLING_SAMPLES {
                re += torque * cos;
                im -= torque * sin;
            }
        }
        #[expect(clippy::cast_precision_loss, reason = "a few thousand")]
        let scale = 2.0 / MEASURED_SAMPLES as f64 / SINE_AMPLITUDE_RAD;
        Complex(re * scale, im * scale)
    }

    /// Position over torque: `(b_q (z - 1) + T b_v) / (z - 1)^2` with `b = B0 + B1/z`. B0 is the
    /// effect of this job's torque in its own tick, B1 its effect in the next one.
    fn joint_response(&self, angle: f64) -> Complex {
        let (t, d) = (self.tick_s, self.tick_s * self.delay);
        let z = Complex::from_angle(angle);
        let back = Complex::from_angle(-angle);
        let b = |own: f64, next: f64| {
            let next = Complex(next / self.inertia_kg_m2, 0.0).product(back);
            Complex(own / self.inertia_kg_m2, 0.0).sum(next)
        };
        let b_q = b(0.5 * (t - d) * (t - d), d * (t - 0.5 * d));
        let b_v = b(t - d, d);
        let one_less = z.sum(Complex(-1.0, 0.0));
        let above = b_q.product(one_less).sum(b_v.product(Complex(t, 0.0)));
        above.quotient(one_less.product(one_less))
    }

    /// The margins from a frequency sweep and from a simulation.
    #[must_use]
    pub fn stability_margins(&self) -> StabilityMargins {
        let mut sweep: Vec<(f64, Complex)> = Vec::new();
        let mut last = 0;
        for point in 0..SWEEP_POINTS {
            #[expect(clippy::cast_precision_loss, reason = "a few hundred")]
            let share = point as f64 / (SWEEP_POINTS - 1) as f64;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "to 2000")]
            let cycles = libm::pow(MEASURED_SAMPLES as f64 / 2.0 - 1.0, share).round() as usize;
            if cycles <= last {
                continue;
            }
            last = cycles;
            #[expect(clippy::cast_precision_loss, reason = "a few thousand")]
            let angle = 2.0 * PI * cycles as f64 / MEASURED_SAMPLES as f64;
            sweep.push((angle, self.law_response(cycles).product(self.joint_response(angle))));
        }
        let mut margin = StabilityMargins { gain: f64::INFINITY, ..StabilityMargins::default() };
        for pair in sweep.windows(2) {
            let [(a, from), (b, to)] = pair else { continue };
            if from.magnitude() > 1.0 && to.magnitude() <= 1.0 {
                let part =
                    libm::log(from.magnitude()) / libm::log(from.magnitude() / to.magnitude());
                let angle = a + part * (b - a);
                let phase = |l: &Complex| libm::atan2(-l.1, -l.0).to_degrees();
                margin.phase_deg = phase(from) + part * (phase(to) - phase(from));
                margin.crossing_rad_s = angle / self.tick_s;
                margin.delay_ms = margin.phase_deg.to_radians() / margin.crossing_rad_s * 1e3;
            }
            // The sweep crosses the negative real axis here.
            if from.0 < 0.0 && to.0 < 0.0 && from.1.signum() != to.1.signum() {
                let part = from.1 / (from.1 - to.1);
                let size = -(from.0 + part * (to.0 - from.0));
                if size < 1.0 {
                    margin.gain = margin.gain.min(1.0 / size);
                } else {
                    margin.gain_low = margin.gain_low.max(1.0 / size);
                }
            }
        }
        for (_, at) in &sweep {
            let apart = at.sum(Complex(1.0, 0.0)).magnitude();
            margin.sensitivity = margin.sensitivity.max(1.0 / apart);
        }
        margin.gain_simulated = self.simulated_gain_margin();
        margin
    }

    /// The smallest factor on the joint's response at which the loop is unstable, by bisection.
    fn simulated_gain_margin(&self) -> f64 {
        let (mut low, mut high) = (1.0, 64.0);
        if self.is_unstable_at(low) {
            return low;
        }
        for _ in 0..24 {
            let middle = (low * high).sqrt();
            if self.is_unstable_at(middle) { high = middle } else { low = middle }
        }
        low
    }

    fn is_unstable_at(&self, gain: f64) -> bool {
        let mut law = self.law;
        let (t, d) = (self.tick_s, self.tick_s * self.delay);
        let (mut q, mut v, mut older) = (1e-6, 0.0, 0.0);
        let (mut early, mut late) = (0.0f64, 0.0f64);
        for tick in 0..4000 {
            let asked = law.torque_nm(&Joints::repeat(-q), t);
            let torque = asked.map_or(f64::NAN, |tau| tau[self.joint]) * gain;
            let (a, b) = (older / self.inertia_kg_m2, torque / self.inertia_kg_m2);
            let e = t - d;
            q += v * t + a * (d * t - 0.5 * d * d) + 0.5 * b * e * e;
            v += a * d + b * e;
            older = torque;
            if !q.is_finite() || q.abs() > 1.0 {
                return true;
            }
            if tick < 2000 { early = early.max(q.abs()) } else { late = late.max(q.abs()) }
        }
        late > early
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::robot::Robot;
    use taktil_tasks_joint_servo::Config;

    fn of(config: &Config) -> JointLoop {
        let tuning = config.tuning(&Robot::puma260()).unwrap();
        JointLoop {
            law: tuning.law(),
            inertia_kg_m2: tuning.inertia_kg_m2[1],
            joint: 1,
            tick_s: 0.0025,
            delay: 0.5,
        }
    }

    #[test]
    fn without_filter_and_delay_the_margin_is_the_textbook_s() {
        // With kp = w^2 and kd = 2 w, far below the sampling rate, the crossover is at w sqrt(2 +
        // sqrt 5), and the phase there is atan(2 crossing / w).
        let slow = Config {
            bandwidth_rad_s: Some(vec![2.0; 6]),
            derivative_filter_hz: 1e5,
            ..Config::default()
        };
        let margin = JointLoop { delay: 1e-6, ..of(&slow) }.stability_margins();
        let crossing = 2.0 * (2.0 + 5f64.sqrt()).sqrt();
        assert!((margin.crossing_rad_s - crossing).abs() < 0.05, "{margin:?}");
        let phase = libm::atan(2.0 * crossing / 2.0).to_degrees();
        assert!((margin.phase_deg - phase).abs() < 1.0, "{phase} {margin:?}");
    }

    #[test]
    fn the_gain_at_which_the_simulated_loop_grows_is_the_one_computed() {
        for config in [
            Config::default(),
            Config { damping: Some(vec![0.5; 6]), derivative_filter_hz: 30.0, ..Config::default() },
            Config { bandwidth_rad_s: Some(vec![110.0; 6]), ..Config::default() },
            Config { observer_hz: Some(60.0), ..Config::default() },
        ] {
            let margin = of(&config).stability_margins();
            assert!(margin.phase_deg > 5.0 && margin.gain > 1.05, "{margin:?}");
            let ratio = margin.gain_simulated / margin.gain;
            // The model inside the observer keeps its gain when the joint's response grows.
            assert!((ratio - 1.0).abs() < 0.03, "{config:?}: {margin:?}");
        }
    }
}

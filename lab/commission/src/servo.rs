//! Holds and moves motors by their own encoders, in counts. It runs only once it is known which
//! encoder follows which motor and which way; nothing of the arm's model is in it.

use taktil_hal::CHANNELS;

use crate::probe::{Pair, whole};

/// Bandwidth of the loop (rad/s): slow, because the gains of the motors are known roughly.
const BANDWIDTH_RAD_S: f64 = 20.0;
/// Share of the bandwidth's cube with which errors are integrated.
const INTEGRAL_SHARE: f64 = 0.2;
/// Cycles over which a speed is a difference of counts.
const SPEED_CYCLES: usize = 4;
/// Error within which a motor that stands still is left alone (counts).
const STILL_COUNTS: f64 = 1.5;
/// Share of the breakaway torque that is fed forward against friction.
const FRICTION_SHARE: f64 = 0.7;
/// Largest error that drives a motor, in breakaway torques: one that goes to a stop, which is to be
/// met gently, and one that holds or follows.
const GENTLE_BREAKAWAYS: f64 = 1.5;
const FIRM_BREAKAWAYS: f64 = 8.0;

/// One motor with its encoder in a loop.
#[derive(Clone, Debug)]
pub(crate) struct Axis {
    pub(crate) pair: Pair,
    /// Where it is to be (counts), and how fast that moves (counts/s).
    pub(crate) reference: f64,
    pub(crate) speed: f64,
    /// Whether it goes to a stop.
    pub(crate) gentle: bool,
    integral: f64,
    before: [f64; SPEED_CYCLES],
}

impl Axis {
    /// Standing at `counts`.
    pub(crate) fn new(pair: Pair, counts: i64) -> Axis {
        let here = counts as f64;
        let before = [here; SPEED_CYCLES];
        Axis { pair, reference: here, speed: 0.0, gentle: false, integral: 0.0, before }
    }

    /// Largest error that drives the motor (counts).
    pub(crate) fn lead(&self) -> f64 {
        self.error_at(if self.gentle { GENTLE_BREAKAWAYS } else { FIRM_BREAKAWAYS })
    }

    /// Largest error that brakes the motor (counts).
    pub(crate) fn braking_lead(&self) -> f64 {
        self.error_at(FIRM_BREAKAWAYS)
    }

    /// Error at which the loop gives so many breakaway torques (counts).
    fn error_at(&self, breakaways: f64) -> f64 {
        let strength = breakaways * self.pair.breakaway * self.pair.gain.abs();
        (strength / (BANDWIDTH_RAD_S * BANDWIDTH_RAD_S)).max(4.0)
    }

    /// The code of this cycle.
    fn code(&mut self, counts: i64, period_s: f64, code_max: f64) -> i32 {
        let here = counts as f64;
        let speed = (here - self.before[SPEED_CYCLES - 1]) / (SPEED_CYCLES as f64 * period_s);
        self.before.rotate_right(1);
        self.before[0] = here;
        let (lead, braking) = (self.lead(), self.braking_lead());
        let (down, up) = if self.speed > 0.0 { (braking, lead) } else { (lead, braking) };
        let error = (self.reference - here).clamp(-down, up);
        let (w, standing) = (BANDWIDTH_RAD_S, self.speed == 0.0);
        let strongest = code_max * self.pair.gain.abs();
        if !(standing && error.abs() < STILL_COUNTS) {
            self.integral += INTEGRAL_SHARE * w * w * w * error * period_s;
            self.integral = self.integral.clamp(-strongest, strongest);
        }
        let wanted = w * w * error + 2.0 * w * (self.speed - speed) + self.integral;
        let against = if standing { 0.0 } else { self.speed.signum() * self.pair.gain.signum() };
        let code = wanted / self.pair.gain + FRICTION_SHARE * self.pair.breakaway * against;
        whole(code.clamp(-code_max, code_max))
    }
}

/// The codes of all motors in this cycle.
pub(crate) fn codes(
    axes: &mut [Axis],
    counts: &[i64; CHANNELS],
    period_s: f64,
    code_max: f64,
) -> [i32; CHANNELS] {
    let mut codes = [0; CHANNELS];
    for axis in axes {
        codes[axis.pair.motor] = axis.code(counts[axis.pair.encoder], period_s, code_max);
    }
    codes
}

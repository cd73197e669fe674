//! One drive: its power section and its cascade.

use taktil_hal::{Counts, DriveActual, DriveLoop, DriveRequest, DriveState, Nanos};

use crate::hash::Hash;

/// Corner of the loop of the velocity (1/s).
const VELOCITY_CORNER_1_S: f64 = 300.0;
/// Corner of the integral part of that loop (1/s).
const INTEGRAL_CORNER_1_S: f64 = 60.0;
/// Corner of the loop of the position (1/s).
const POSITION_CORNER_1_S: f64 = 60.0;
/// Error of the position at which a drive stops following (turns of the motor).
const FOLLOWING_ERROR_TURNS: f64 = 1.0;
/// From the request to the first torque.
const ENABLE_TIME: Nanos = Nanos::from_millis(5);
/// Time constant of the ramp of a quick stop (s).
const STOP_RAMP_S: f64 = 0.03;
/// A stop is over at this speed (turns of the motor a second), or after [`STOP_TIME_MAX`].
const STANDSTILL_TURNS_S: f64 = 0.02;
/// Longest time of a stop.
const STOP_TIME_MAX: Nanos = Nanos::from_millis(500);
/// The code of a following error (CiA 402, object 603F).
const FOLLOWING_ERROR_CODE: u16 = 0x8611;
/// The code of a host that fell silent while it drove.
const SILENCE_CODE: u16 = 0x7500;

/// What a drive knows of its motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MotorScale {
    /// Code of the current for an acceleration of one count/s^2.
    pub(super) codes_per_count_s2: f64,
    /// Counts in a turn of the motor.
    pub(super) counts_per_turn: f64,
    pub(super) code_min: f64,
    pub(super) code_max: f64,
}

/// What all drives of a bank see alike.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surroundings {
    pub(super) t: Nanos,
    pub(super) control_loop: DriveLoop,
    pub(super) request: DriveRequest,
    pub(super) is_powered: bool,
    /// The host has fallen silent while it wanted something.
    pub(super) is_silent: bool,
    pub(super) control_period: Nanos,
}

/// The power section.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Power {
    #[default]
    Off,
    /// Since when.
    Enabling(Nanos),
    Following,
    /// Since when.
    Stopping(Nanos),
    /// With its code.
    Fault(u16),
}

/// A drive.
#[derive(Clone, Debug)]
pub(super) struct DriveModel {
    scale: MotorScale,
    power: Power,
    /// It left operation by itself: the request has to be given up before it counts again.
    is_blocked: bool,
    was_reset: bool,
    /// The target that came last, the one before, and when.
    target: f64,
    before: f64,
    taken: Nanos,
    /// Where the integral part of the velocity's loop stands (counts/s^2).
    integral: f64,
    code: i32,
}

impl DriveModel {
    pub(super) fn new(scale: MotorScale) -> DriveModel {
        DriveModel {
            scale,
            power: Power::Off,
            is_blocked: false,
            was_reset: false,
            target: 0.0,
            before: 0.0,
            taken: Nanos::ZERO,
            integral: 0.0,
            code: 0,
        }
    }

    /// Takes a target, and the wish to reset a fault.
    pub(super) fn take(&mut self, target: i32, t: Nanos, reset: bool) {
        self.before = self.target;
        (self.target, self.taken) = (f64::from(target), t);
        if reset && !self.was_reset && matches!(self.power, Power::Fault(_)) {
            (self.power, self.is_blocked) = (Power::Off, true);
        }
        self.was_reset = reset;
    }

    /// Switches the power section as it is asked for.
    pub(super) fn switch(&mut self, around: &Surroundings, counts: f64, counts_s: f64) {
        if around.request != DriveRequest::Follow {
            self.is_blocked = false;
        }
        self.power = match (self.power, around.request) {
            (Power::Fault(code), _) => Power::Fault(code),
            (Power::Following | Power::Stopping(_), _) if around.is_silent => {
                Power::Fault(SILENCE_CODE)
            }
            (Power::Off, _) if !around.is_powered => Power::Off,
            (_, _) if !around.is_powered => {
                self.is_blocked = around.request == DriveRequest::Follow;
                Power::Off
            }
            (Power::Off, DriveRequest::Follow) if !self.is_blocked => Power::Enabling(around.t),
            (Power::Enabling(since), DriveRequest::Follow) if around.t - since >= ENABLE_TIME => {
                self.begin(around, counts);
                Power::Following
            }
            (Power::Following, DriveRequest::QuickStop) => Power::Stopping(around.t),
            (Power::Stopping(since), DriveRequest::QuickStop | DriveRequest::Follow) => {
                let slow = counts_s.abs() < STANDSTILL_TURNS_S * self.scale.counts_per_turn;
                let is_over = slow || around.t - since > STOP_TIME_MAX;
                self.is_blocked |= around.request == DriveRequest::Follow;
                if is_over { Power::Off } else { Power::Stopping(since) }
            }
            (power, DriveRequest::Follow) => power,
            (_, DriveRequest::Off | DriveRequest::QuickStop) => Power::Off,
        };
        if !self.has_torque() {
            (self.code, self.integral) = (0, 0.0);
        }
    }

    /// The first target acts from where the motor is.
    fn begin(&mut self, around: &Surroundings, counts: f64) {
        self.integral = 0.0;
        self.before = match around.control_loop {
            DriveLoop::Position => counts,
            DriveLoop::Torque | DriveLoop::Velocity => 0.0,
        };
        self.taken = around.t;
    }

    /// Makes the code of the current from where the motor is, for the next `period`.
    pub(super) fn look(
        &mut self,
        around: &Surroundings,
        counts: f64,
        counts_s: f64,
        period: Nanos,
    ) {
        let velocity = match (self.power, around.control_loop) {
            (Power::Following, DriveLoop::Torque) => {
                self.code = self.limited(self.target);
                return;
            }
            (Power::Following, DriveLoop::Velocity) => self.on_the_way(around).0,
            (Power::Following, DriveLoop::Position) => {
                let (target, slope) = self.on_the_way(around);
                let error = target - counts;
                if error.abs() > FOLLOWING_ERROR_TURNS * self.scale.counts_per_turn {
                    (self.power, self.code) = (Power::Fault(FOLLOWING_ERROR_CODE), 0);
                    return;
                }
                slope + POSITION_CORNER_1_S * error
            }
            (Power::Stopping(_), _) => counts_s * (1.0 - period.as_secs_f64() / STOP_RAMP_S),
            _ => return,
        };
        let error = velocity - counts_s;
        let acceleration = match self.power {
            // The ramp asks for an acceleration, not for a place.
            Power::Stopping(_) => error / period.as_secs_f64() + self.integral,
            _ => VELOCITY_CORNER_1_S * error + self.integral,
        };
        let wanted = acceleration * self.scale.codes_per_count_s2;
        self.code = self.limited(wanted);
        let is_limited = (f64::from(self.code) - wanted).abs() > 1.0;
        if !is_limited && self.power == Power::Following {
            let rate = VELOCITY_CORNER_1_S * INTEGRAL_CORNER_1_S;
            self.integral += rate * error * period.as_secs_f64();
        }
    }

    #[expect(clippy::cast_possible_truncation, reason = "clamped to the codes of a converter")]
    fn limited(&self, code: f64) -> i32 {
        code.clamp(self.scale.code_min, self.scale.code_max).round() as i32
    }

    /// The target on its way from the one before, and its slope (1/s).
    fn on_the_way(&self, around: &Surroundings) -> (f64, f64) {
        let span_s = around.control_period.as_secs_f64();
        let share = (around.t - self.taken).as_secs_f64() / span_s;
        let step = self.target - self.before;
        if share >= 1.0 {
            return (self.target, 0.0);
        }
        (self.before + step * share, step / span_s)
    }

    pub(super) fn code(&self) -> i32 {
        self.code
    }

    pub(super) fn has_torque(&self) -> bool {
        matches!(self.power, Power::Following | Power::Stopping(_))
    }

    #[expect(clippy::cast_possible_truncation, reason = "a speed beyond 32 bits saturates")]
    pub(super) fn report(&self, position: Counts, counts_s: f64) -> DriveActual {
        let (state, fault_code) = match self.power {
            Power::Off => (DriveState::Off, 0),
            Power::Enabling(_) => (DriveState::Enabling, 0),
            Power::Following => (DriveState::Following, 0),
            Power::Stopping(_) => (DriveState::Stopping, 0),
            Power::Fault(code) => (DriveState::Fault, code),
        };
        let velocity_counts_s = counts_s.round() as i32;
        DriveActual { position, velocity_counts_s, torque_code: self.code, state, fault_code }
    }

    pub(super) fn digest(&self, hash: &mut Hash) {
        let (kind, since) = match self.power {
            Power::Off => (0, 0),
            Power::Enabling(since) => (1, since.0),
            Power::Following => (2, 0),
            Power::Stopping(since) => (3, since.0),
            Power::Fault(code) => (4, i64::from(code)),
        };
        hash.word(kind << 2 | u64::from(self.is_blocked) << 1 | u64::from(self.was_reset));
        hash.word(since.cast_unsigned());
        hash.word(self.taken.0.cast_unsigned());
        hash.numbers(&[self.target, self.before, self.integral]);
        hash.word(u64::from(self.code.cast_unsigned()));
    }
}

#[cfg(test)]
mod tests;

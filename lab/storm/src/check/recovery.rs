//! After recoverable faults have ended the machine comes back: within two seconds of a reset it is
//! ready, and it then moves where the operator pushes it, without a fault.

use taktil_hal::Nanos;
use taktil_rtcore::Mode;
use taktil_signal::Verb;

use super::{Findings, Weather, allows_torque, mode_of};
use crate::case::Campaign;
use crate::evidence::Tick;

/// Time from a reset without faults about to READY.
const READY_TIME: Nanos = Nanos::from_secs(2);
/// Largest difference between desired and measured joints of an arm that follows a jog (rad): with
/// the torque limits of the scenes it lags by 1.2 degrees where a jog begins.
const FOLLOWING_RAD: f64 = 0.026;
/// The same where the operator may push it into something: the window of the following error, and
/// what the arm does until it stops.
const TOUCHING_RAD: f64 = 0.13;
/// Time in MOVING before the end that is judged.
const JUDGED_TIME: Nanos = Nanos::from_millis(500);

/// What the rule about recovery remembers.
#[derive(Debug, Default)]
pub(super) struct Recovery {
    touches: bool,
    sequence: Option<u32>,
    /// The newest request to reset since the calm began that has not led to READY yet.
    reset: Option<Nanos>,
    /// Since when the machine has moved without a break.
    moving_since: Option<Nanos>,
    /// When a motion in the calm last ended that had lasted long enough to be judged.
    moved_until: Option<Nanos>,
    last: Option<(Nanos, Mode, u64)>,
}

impl Recovery {
    /// For an arm that may be pushed into something, or not.
    pub(super) fn new(touches: bool) -> Recovery {
        Recovery { touches, ..Recovery::default() }
    }

    pub(super) fn tick(&mut self, tick: &Tick, weather: &Weather, findings: &mut Findings) {
        let now = tick.release;
        let request = tick.request.filter(|new| self.sequence != Some(new.sequence));
        self.sequence = tick.request.map(|request| request.sequence).or(self.sequence);
        let Some(mode) = mode_of(tick) else { return };
        self.last = Some((now, mode, tick.control.map_or(0, |control| control.faults)));
        if mode == Mode::Moving {
            self.moving_since.get_or_insert(now);
        } else if let Some(since) = self.moving_since.take()
            && now - since.max(weather.calm_from) > JUDGED_TIME
        {
            self.moved_until = Some(now);
        }
        if weather.campaign != Campaign::Recoverable || now < weather.calm_from {
            return;
        }
        if request.is_some_and(|request| request.verb == Verb::Reset as u32) {
            self.reset.get_or_insert(now);
        }
        if mode == Mode::Ready || allows_torque(mode) {
            self.reset = None;
        }
        if let Some(reset) = self.reset.filter(|reset| now - *reset > READY_TIME) {
            findings.report("ready after a reset", now, || {
                format!("{mode:?} {} after the reset", now - reset)
            });
        }
        let settled = self.moving_since.is_some_and(|since| now - since > JUDGED_TIME);
        let (Some(desired), Some(joints), true) = (tick.desired, tick.joints, settled) else {
            return;
        };
        let error = |joint: usize| (desired.q_rad[joint] - joints.q_rad[joint]).abs();
        let most = if self.touches { TOUCHING_RAD } else { FOLLOWING_RAD };
        if let Some(joint) = (0..6).find(|joint| error(*joint) > most) {
            findings.report("the arm follows after the faults", now, || {
                format!("joint {} is {:.3} deg off", joint + 1, error(joint).to_degrees())
            });
        }
    }

    pub(super) fn finish(&mut self, weather: &Weather, findings: &mut Findings) {
        let Some((now, mode, faults)) = self.last else { return };
        if weather.campaign != Campaign::Recoverable || now < weather.calm_from {
            return;
        }
        // Whoever pushes the arm into something is stopped again, and begins anew.
        let moved = self.moved_until.is_some_and(|until| now - until <= READY_TIME);
        let stopped_again = self.touches && (faults != 0 || mode == Mode::Moving || moved);
        if !stopped_again && self.moving_since.is_none_or(|since| now - since < JUDGED_TIME) {
            findings.report("back at work after the faults", now, || {
                format!("{mode:?} with faults {faults:#x} at the end")
            });
        }
    }
}

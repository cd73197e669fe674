//! No energy goes into the arm unless it is enabled: words to the boards are safe in every mode
//! that does not allow torque, drives and brakes are in the truth where the words put them, and the
//! arm comes to rest after a stop.

use taktil_hal::Nanos;
use taktil_hal::fault::FaultKind;
use taktil_lab_world::WorldTruth;
use taktil_rtcore::Mode;

use super::transitions::takes_drives_off;
use super::{Findings, Weather, allows_torque, mode_of};
use crate::evidence::Tick;

/// Largest time from the word that takes the drives away to rest: the boards' silence of 50 ms, the
/// brakes at the arm's largest speeds, and the delay of the words.
const REST_TIME: Nanos = Nanos::from_millis(400);
/// Longest stop on the servo, as the machine file says, and what a tick more may take.
const STOP_TIME: Nanos = Nanos::from_millis(1_050);
/// Speed of a joint that counts as rest (rad/s): half a degree a second.
const REST_SPEED_RAD_S: f64 = 0.009;
/// A stop that is shorter has ended because the arm stands.
const SHORT_STOP_TIME: Nanos = Nanos::from_millis(900);
/// Jobs in which the arm has to stay at its place until it counts as standing: 40 ms.
const STANDING_JOBS: usize = 16;
/// How far a joint may go in that time (rad): several times the band of the machine file, because
/// an arm in contact swings.
const STANDING_RAD: f64 = 4e-3;
/// Delay of a word to the boards, the boards' own silence, and a tick.
const DRIVE_DELAY: Nanos = Nanos::from_millis(56);

/// What the rules about energy remember.
#[derive(Debug, Default)]
pub(super) struct Energy {
    /// Since when the mode has not allowed torque.
    unpowered_since: Option<Nanos>,
    stopping_since: Option<Nanos>,
    /// Where the joints were in the last jobs of the stop (rad), and in how many jobs it was noted.
    places_rad: [[f64; 6]; STANDING_JOBS],
    places_noted: usize,
    feed: Option<(u64, u8)>,
    /// The last job in which a word to the converters failed.
    failed_word: Option<u64>,
    speed_rad_s: f64,
}

/// Whether the boards may be deaf, so that words say more than the arm does.
fn is_deaf(weather: &Weather, now: Nanos) -> bool {
    let after = Nanos::from_millis(100);
    weather.is_on("digital_out", now, after) && weather.is_on("analog_out", now, after)
        || weather.has(now, after, |name, kind| {
            name == "digital_out"
                && matches!(kind, FaultKind::Hot | FaultKind::Frozen | FaultKind::Inversion)
        })
}

impl Energy {
    pub(super) fn tick(
        &mut self,
        tick: &Tick,
        truth: Option<&WorldTruth>,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        self.words(tick, weather, findings);
        self.lost_converters(tick, weather, findings);
        let Some(mode) = mode_of(tick) else { return };
        if allows_torque(mode) {
            self.unpowered_since = None;
        } else {
            self.unpowered_since.get_or_insert(now);
        }
        if mode == Mode::Stopping {
            let since = *self.stopping_since.get_or_insert(now);
            if let Some(truth) = truth {
                self.places_rad[self.places_noted % STANDING_JOBS] = truth.q_rad;
                self.places_noted += 1;
            }
            if now - since > STOP_TIME && !weather.is_late(now) {
                findings
                    .report("a stop ends", now, || format!("still in STOPPING {}", now - since));
            }
        } else {
            if let Some(since) = self.stopping_since.take() {
                self.end_of_stop(tick, since, weather, findings);
                self.places_noted = 0;
            }
        }
        let (Some(truth), Some(since)) = (truth, self.unpowered_since) else { return };
        let is_due = |span| weather.has_worked(since, now, span);
        if is_due(DRIVE_DELAY) && !is_deaf(weather, now) && truth.enabled == 1 {
            findings.report("drives off when they may not run", now, || {
                format!("enabled {} after {mode:?} began", now - since)
            });
        }
        let speed = truth.qd_rad_s.iter().fold(0.0, |most: f64, qd| most.max(qd.abs()));
        if is_due(REST_TIME) && !is_deaf(weather, now) && speed > REST_SPEED_RAD_S {
            findings.report("rest after a stop", now, || {
                format!("a joint moves at {speed:.3} rad/s {} after {mode:?} began", now - since)
            });
        }
    }

    /// A stop on the servo ends with brakes that close on an arm at rest.
    fn end_of_stop(&self, tick: &Tick, since: Nanos, weather: &Weather, findings: &mut Findings) {
        let now = tick.release;
        let Some(mode) = mode_of(tick).filter(|_| self.places_noted >= STANDING_JOBS) else {
            return;
        };
        let faults = tick.control.map_or(0, |control| control.faults);
        let took_its_time = now - since > SHORT_STOP_TIME;
        let is_spoilt = weather.is_late(now)
            || weather.has_begun("encoders", now)
            || weather.has_panicked(now)
            || !matches!(mode, Mode::Ready | Mode::Fault);
        if took_its_time || is_spoilt || takes_drives_off(faults) {
            return;
        }
        let oldest_rad = &self.places_rad[self.places_noted % STANDING_JOBS];
        let newest_rad = &self.places_rad[(self.places_noted - 1) % STANDING_JOBS];
        let way_rad = |joint: usize| -> f64 { (newest_rad[joint] - oldest_rad[joint]).abs() };
        let most_rad = (0..6).map(way_rad).fold(0.0, f64::max);
        if most_rad > STANDING_RAD {
            findings.report("brakes close on an arm at rest", now, || {
                format!("{:.3} deg in the last 40 ms of the stop", most_rad.to_degrees())
            });
        }
    }

    /// The words to the boards, against the mode of the same job.
    fn words(&mut self, tick: &Tick, weather: &Weather, findings: &mut Findings) {
        let now = tick.release;
        let mode = mode_of(tick);
        if let (Some(analog), Some(lines)) = (&tick.analog, &tick.lines_out) {
            let current = analog.codes.iter().any(|code| *code != 0);
            if current && lines.enable == 0 && analog.outcome == 0 {
                findings.report("no current without enable", now, || {
                    format!("codes {:?} with enable off", analog.codes)
                });
            }
            let allowed = mode.is_some_and(allows_torque);
            if current && !allowed {
                findings.report("no current without a mode for it", now, || {
                    format!("codes {:?} in {mode:?}", analog.codes)
                });
            }
            if lines.enable == 1 && !allowed {
                findings.report("no enable without a mode for it", now, || format!("in {mode:?}"));
            }
            let lifted = matches!(mode, Some(Mode::Hold | Mode::Moving | Mode::Stopping));
            if lines.brake_release == 1 && !lifted {
                findings.report("brakes on without a mode", now, || format!("in {mode:?}"));
            }
            if lines.enable == 1 && lifted && lines.brake_release == 0 {
                findings.report("no brakes against the drives", now, || format!("in {mode:?}"));
            }
            if lines.brake_release == 1 && lines.enable == 0 {
                findings.report("brakes on without drives", now, String::new);
            }
            self.watchdog(tick, weather, findings, lines.watchdog_feed);
        } else if !weather.has_panicked(now) {
            findings.report("each job writes to the boards", now, || {
                format!("{:?} {:?}", tick.analog, tick.lines_out)
            });
        }
    }

    /// Converters that fail in two jobs one after the other are lost: drives and brakes are taken
    /// by the lines of the same job.
    fn lost_converters(&mut self, tick: &Tick, weather: &Weather, findings: &mut Findings) {
        let now = tick.release;
        let (Some(analog), Some(lines)) = (&tick.analog, &tick.lines_out) else { return };
        let failed_before = self.failed_word.is_some_and(|job| job + 1 == tick.tick);
        self.failed_word = (analog.outcome != 0).then_some(tick.tick);
        let is_lost = analog.outcome != 0 && failed_before && !weather.has_panicked(now);
        if is_lost && (lines.enable == 1 || lines.brake_release == 1) {
            findings.report("lost converters take the lines with them", now, || {
                format!("enable {} brake release {}", lines.enable, lines.brake_release)
            });
        }
    }

    /// The watchdog is fed in each job whose inputs arrived, and in no other.
    fn watchdog(&mut self, tick: &Tick, weather: &Weather, findings: &mut Findings, feed: u8) {
        let now = tick.release;
        let before = self.feed.replace((tick.tick, feed));
        let Some((last, level)) = before.filter(|(last, _)| *last + 1 == tick.tick) else { return };
        let fed = level != feed;
        let inputs = tick.joints.is_some() && tick.control.is_some();
        let torque = tick.torque.is_some() || !mode_of(tick).is_some_and(allows_torque);
        if inputs && torque && !fed && !weather.has_panicked(now) {
            findings.report("the watchdog is fed", now, || format!("not between {last} and now"));
        }
        if !inputs && fed {
            findings.report("the watchdog starves without inputs", now, || {
                format!("fed with joints {}", tick.joints.is_some())
            });
        }
    }

    /// With brakes on and drives off nothing gets faster.
    pub(super) fn truth(&mut self, truth: &WorldTruth, _: &Weather, findings: &mut Findings) {
        let speed = truth.qd_rad_s.iter().fold(0.0, |most: f64, qd| most.max(qd.abs()));
        let before = core::mem::replace(&mut self.speed_rad_s, speed);
        let secured = truth.braked == 1 && truth.enabled == 0;
        if secured && speed > before + REST_SPEED_RAD_S && speed > 0.05 {
            findings.report("nothing gets faster without drives", Nanos(truth.t_ns), || {
                format!("from {before:.4} to {speed:.4} rad/s")
            });
        }
        if truth.qd_rad_s.iter().chain(&truth.q_rad).any(|x| !x.is_finite()) {
            findings.report("the arm is somewhere", Nanos(truth.t_ns), || "not finite".to_owned());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Campaign;
    use taktil_hal::fault::FaultPlan;
    use taktil_rtcore::Payload;
    use taktil_signal::ControlState;

    /// Whether a stop of 40 jobs breaks the rule at whose end joint 3 moves at this speed (rad/s).
    fn is_found(speed_rad_s: f64) -> bool {
        let weather = Weather::new(&FaultPlan::default(), Campaign::Anything, Nanos::MAX);
        let (mut check, mut findings) = (Energy::default(), Findings::default());
        for job in 0..42_u32 {
            let mode = if job < 40 { Mode::Stopping } else { Mode::Ready };
            let mut truth = WorldTruth::ZERO;
            truth.q_rad[2] = speed_rad_s * 0.0025 * f64::from(job);
            let tick = Tick {
                tick: u64::from(job),
                release: Nanos(2_500_000 * i64::from(job)),
                control: Some(ControlState { mode: mode.code(), ..ControlState::ZERO }),
                ..Tick::default()
            };
            check.tick(&tick, Some(&truth), &weather, &mut findings);
        }
        findings.violations.iter().any(|one| one.rule == "brakes close on an arm at rest")
    }

    #[test]
    fn a_stop_ends_with_an_arm_at_rest() {
        assert!(!is_found(0.0) && !is_found(0.05));
        assert!(is_found(0.2));
    }
}

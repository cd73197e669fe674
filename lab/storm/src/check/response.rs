//! What the devices said has to be acted on in time: open emergency stops, power that is gone,
//! boards that do not answer, counts that jump, joints that do not follow. The evidence is what the
//! boards answered, not what the tasks made of it.

use taktil_hal::Nanos;
use taktil_rtcore::Mode;
use taktil_rtcore::status::LaneHealth;

use super::transitions::{stops, takes_drives_off};
use super::{ArmLimits, Findings, Weather, allows_torque, mode_of};
use crate::evidence::Tick;

/// Jobs from an answer of a board to the reaction: its own, and those after which the health of the
/// lane has come round.
const REACTION_JOBS: u64 = 3;
/// Failures in a row that are borne.
const FAILURES_BORNE: u32 = 1;
/// Outcomes on a tape: 1 transient, 2 stale, 3 out of range, 4 lost.
const OUTCOME_STALE: u16 = 2;
const OUTCOME_LOST: u16 = 4;
/// How far a joint may move in a tick, over its largest speed, before it is a jump; and how much
/// more than that is one beyond doubt.
const JUMP_RATIO: f64 = 1.5;
const JUMP_DOUBT_RAD: f64 = 2e-3;
/// How long the channels of the emergency stop may disagree, and what a reaction takes.
const DISAGREEMENT_TIME: Nanos = Nanos::from_millis(30);
/// Half width of the window in which a joint has to follow, at rest, its growth with speed, and how
/// much more is beyond doubt.
const WINDOW_RAD: f64 = 0.0873;
const WINDOW_S: f64 = 0.05;
const WINDOW_DOUBT_RAD: f64 = 0.01;
/// Longest time without a task's torque in which the arm may be left to its last one.
const SILENT_TORQUE_JOBS: u64 = 3;
/// Longest time between two jobs after which the boards still hold what they were told: their own
/// silence.
const BOARD_SILENCE: Nanos = Nanos::from_millis(50);
/// Misses without a hundred good jobs between them that a lane does not bear, as the machine file
/// says: one more than fill the bucket.
const MISSES_BORNE: u32 = 5;
const GOOD_JOBS: u64 = 100;
/// Longest time from a panic to the begin of a stop.
const PANIC_TIME: Nanos = Nanos::from_millis(20);

/// A task has panicked, among the faults of a lane.
const PANIC_BIT: u64 = 1 << 12;

/// A reaction that is due.
#[derive(Clone, Copy, Debug)]
struct Due {
    /// By which job.
    by: u64,
    cause: &'static str,
    /// Whether the drives have to be off, rather than the arm be stopping.
    off: bool,
}

/// What the rules about reactions remember.
#[derive(Debug)]
pub(super) struct Response {
    arm: ArmLimits,
    due: Option<Due>,
    encoder_failures: u32,
    line_failures: u32,
    analog_failures: u32,
    digital_failures: u32,
    counts: Option<([i32; 8], i64)>,
    disagree_since: Option<Nanos>,
    astray: u32,
    beyond: u32,
    without_torque: u64,
    /// Misses told so far, those since the lane was well, and the job of the last one.
    missed: u32,
    misses: u32,
    last_miss: u64,
    panicked_since: Option<Nanos>,
}

impl Response {
    pub(super) fn new(arm: ArmLimits) -> Response {
        Response {
            arm,
            due: None,
            encoder_failures: 0,
            line_failures: 0,
            analog_failures: 0,
            digital_failures: 0,
            counts: None,
            disagree_since: None,
            astray: 0,
            beyond: 0,
            without_torque: 0,
            missed: 0,
            misses: 0,
            last_miss: 0,
            panicked_since: None,
        }
    }

    pub(super) fn tick(
        &mut self,
        before: &Tick,
        tick: &Tick,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        if weather.has_panicked(now) {
            self.due = None;
            self.after_panic(tick, weather, findings);
            return;
        }
        let (Some(was), Some(mode)) = (mode_of(before), mode_of(tick)) else { return };
        self.judge_due(tick, mode, findings);
        // Nothing is asked of a machine that was not at work, or has just come to be.
        let at_work = allows_torque(was) && allows_torque(mode);
        let silent = tick.release - before.release > BOARD_SILENCE;
        let gap = silent.then_some(("the boards have let go in a gap between two jobs", true));
        let cause = self.cause(tick, weather).or(gap);
        if let (Some((cause, off)), true, None) = (cause, at_work, self.due) {
            self.due = Some(Due { by: tick.tick + REACTION_JOBS, cause, off });
        }
        let faults = tick.health.map_or(0, |health| health.faults);
        if at_work && self.due.is_none() && stops(faults) {
            let off = takes_drives_off(faults);
            let cause = "a fault in the lane's health";
            self.due = Some(Due { by: tick.tick + REACTION_JOBS, cause, off });
        }
    }

    /// A task that panicked stops the arm; one that decides about it, too.
    fn after_panic(&mut self, tick: &Tick, weather: &Weather, findings: &mut Findings) {
        let now = tick.release;
        // A task that is out stays out, whatever the lane says of it later.
        let is_out = |health: LaneHealth| health.disabled != 0 || health.faults & PANIC_BIT != 0;
        if tick.health.is_some_and(is_out) {
            self.panicked_since.get_or_insert(now);
        }
        let Some(since) = self.panicked_since else { return };
        let driven = tick.lines_out.is_some_and(|lines| lines.enable == 1);
        let stopping = mode_of(tick).is_some_and(|mode| mode == Mode::Stopping);
        if driven && !stopping && weather.has_worked(since, now, PANIC_TIME) {
            findings.report("a panic stops the arm", now, || {
                format!("enabled in {:?} {} after it", mode_of(tick), now - since)
            });
        }
    }

    fn judge_due(&mut self, tick: &Tick, mode: Mode, findings: &mut Findings) {
        let Some(due) = self.due else { return };
        let reacted = !allows_torque(mode) || mode == Mode::Stopping && !due.off;
        if reacted {
            self.due = None;
        } else if tick.tick > due.by {
            self.due = None;
            findings.report("a fault is acted on in time", tick.release, || {
                format!("{} and still {mode:?}", due.cause)
            });
        }
    }

    /// Why the arm has to stop now, by the answers of the boards, and whether at once.
    fn cause(&mut self, tick: &Tick, weather: &Weather) -> Option<(&'static str, bool)> {
        let gone = |outcome: u16, failures: &mut u32| {
            *failures = if outcome == 0 { 0 } else { *failures + 1 };
            outcome == OUTCOME_STALE || outcome == OUTCOME_LOST || *failures > FAILURES_BORNE
        };
        let encoders = tick.encoders.map_or(0, |entry| entry.outcome);
        if gone(encoders, &mut self.encoder_failures) {
            self.counts = None;
            return Some(("the encoders do not answer", true));
        }
        let lines = tick.lines_in.map_or(0, |entry| entry.outcome);
        if gone(lines, &mut self.line_failures) {
            return Some(("the lines do not answer", true));
        }
        let analog = tick.analog.map_or(0, |word| word.outcome);
        if gone(analog, &mut self.analog_failures) {
            return Some(("the D/A converters do not answer", true));
        }
        let digital = tick.lines_out.map_or(0, |word| word.outcome);
        if gone(digital, &mut self.digital_failures) {
            return Some(("the output lines do not answer", true));
        }
        if let Some(cause) = self.open_line(tick) {
            return Some((cause, true));
        }
        if self.misses_too_often(tick) {
            return Some(("jobs miss their deadlines", false));
        }
        if self.has_jumped(tick) {
            return Some(("counts jump", true));
        }
        if self.is_astray(tick) {
            return Some(("a joint does not follow", false));
        }
        if self.is_beyond_limits(tick) {
            return Some(("a joint is beyond its limits", true));
        }
        let silent = tick.torque.is_none() && !weather.is_late(tick.release);
        self.without_torque = if silent { self.without_torque + 1 } else { 0 };
        (self.without_torque > SILENT_TORQUE_JOBS).then_some(("nobody writes a torque", true))
    }

    /// Whether more deadlines were missed than are borne, by the lane's own count.
    fn misses_too_often(&mut self, tick: &Tick) -> bool {
        let Some(health) = tick.health else { return false };
        let new = health.missed - self.missed.min(health.missed);
        self.missed = health.missed;
        if new > 0 {
            let well = tick.tick - self.last_miss > GOOD_JOBS;
            self.misses = if well { new } else { self.misses.saturating_add(new) };
            self.last_miss = tick.tick;
        }
        new > 0 && self.misses > MISSES_BORNE
    }

    fn open_line(&mut self, tick: &Tick) -> Option<&'static str> {
        let lines = tick.lines_in.filter(|entry| entry.outcome == 0)?;
        if lines.estop_a_closed != lines.estop_b_closed {
            let since = *self.disagree_since.get_or_insert(tick.release);
            if tick.release - since > DISAGREEMENT_TIME {
                return Some("the channels of the emergency stop disagree");
            }
        } else {
            self.disagree_since = None;
        }
        if lines.estop_a_closed == 0 || lines.estop_b_closed == 0 {
            return Some("the emergency stop is open");
        }
        (lines.drive_power == 0).then_some("drive power is off")
    }

    /// Whether a joint is further on than it can have moved since the answer before.
    fn has_jumped(&mut self, tick: &Tick) -> bool {
        let Some(entry) = tick.encoders.filter(|entry| entry.outcome == 0) else { return false };
        let before = self.counts.replace((entry.counts, entry.acquired_ns));
        let Some((counts, acquired)) = before else { return false };
        let span_s = (entry.acquired_ns - acquired) as f64 * 1e-9;
        let (here, there) = (self.arm.joints(&entry.counts), self.arm.joints(&counts));
        (0..6).any(|joint| {
            let most = JUMP_RATIO * self.arm.speed_max_rad_s[joint] * span_s + JUMP_DOUBT_RAD;
            (here[joint] - there[joint]).abs() > most
        })
    }

    /// Whether a measured joint of a calibrated arm has been beyond its limits for several jobs.
    fn is_beyond_limits(&mut self, tick: &Tick) -> bool {
        let joints = tick.joints.filter(|joints| joints.calibrated == 1);
        let is_beyond = joints.is_some_and(|joints| self.arm.is_beyond_limits(&joints.q_rad));
        self.beyond = if is_beyond { self.beyond + 1 } else { 0 };
        self.beyond > 2
    }

    /// Whether a joint has been outside the window for several jobs.
    fn is_astray(&mut self, tick: &Tick) -> bool {
        let (Some(desired), Some(joints)) = (tick.desired, tick.joints) else { return false };
        let astray = (0..6).any(|joint| {
            let speed = joints.qd_rad_s[joint].abs().max(desired.qd_rad_s[joint].abs());
            let window = WINDOW_RAD + WINDOW_S * speed + WINDOW_DOUBT_RAD;
            (desired.q_rad[joint] - joints.q_rad[joint]).abs() > window
        });
        self.astray = if astray && desired.valid == 1 { self.astray + 1 } else { 0 };
        self.astray > 2
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Campaign;
    use taktil_hal::fault::FaultPlan;
    use taktil_machine::tape::DigitalWord;
    use taktil_rtcore::Payload;
    use taktil_signal::ControlState;

    #[test]
    fn a_machine_whose_task_has_panicked_stays_off_whatever_its_lane_says_later() {
        let is_found = |enable: u8| {
            let panic = "kind=panic target=task.sense at=0 for=0.01".parse().unwrap();
            let plan = FaultPlan::new(vec![panic]);
            let weather = Weather::new(&plan, Campaign::Anything, Nanos::MAX);
            let mut check = Response::new(ArmLimits::new(None));
            let (mut findings, mut before) = (Findings::default(), Tick::default());
            for job in 1..60_u32 {
                let faults = if job == 3 { PANIC_BIT } else { 0 };
                let tick = Tick {
                    tick: u64::from(job),
                    release: Nanos(2_500_000 * i64::from(job)),
                    control: Some(ControlState { mode: Mode::Hold.code(), ..ControlState::ZERO }),
                    health: Some(LaneHealth { faults, ..LaneHealth::ZERO }),
                    lines_out: Some(DigitalWord { enable, ..DigitalWord::ZERO }),
                    ..Tick::default()
                };
                check.tick(&before, &tick, &weather, &mut findings);
                before = tick;
            }
            findings.violations.iter().any(|one| one.rule == "a panic stops the arm")
        };
        assert!(is_found(1) && !is_found(0));
    }
}

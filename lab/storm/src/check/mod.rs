//! The checkers beside a run. They know the records only, with limits and tables of their own: what
//! they check is computed elsewhere, by other arithmetic. Each finding has the name of the rule
//! that was broken.

mod arm;
mod dead_encoder;
mod energy;
mod false_alarm;
mod history;
mod motion;
mod overload;
mod recovery;
mod reports;
mod response;
mod runaway;
mod start;
mod touch;
mod tracking;
mod transitions;

use taktil_hal::Nanos;
use taktil_hal::fault::{Fault, FaultKind, FaultPlan};
use taktil_lab_world::WorldTruth;
use taktil_rtcore::Mode;
use taktil_signal::State;

use crate::case::{Campaign, Case, fault_end};
use crate::evidence::{Tick, Touch, Witness};

pub use arm::{ArmLimits, JogPace};

/// A rule that was broken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Which rule.
    pub rule: &'static str,
    /// When.
    pub at: Nanos,
    /// How.
    pub what: String,
}

/// Violations that are kept of one run: the first ones say the most.
const VIOLATIONS_MAX: usize = 8;

/// What was found so far.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// The first violations.
    pub violations: Vec<Violation>,
}

impl Findings {
    /// Notes that a rule was broken; the same rule once.
    pub(crate) fn report(&mut self, rule: &'static str, at: Nanos, what: impl Fn() -> String) {
        let known = self.violations.iter().any(|violation| violation.rule == rule);
        if !known && self.violations.len() < VIOLATIONS_MAX {
            self.violations.push(Violation { rule, at, what: what() });
        }
    }
}

/// Which faults of the plan are about; the checkers are as strict as these allow.
#[derive(Clone, Debug)]
pub(crate) struct Weather {
    faults: Vec<Fault>,
    /// Spans in which the servo lane does no job, in order: gaps of the clock and its own silence.
    standstills: Vec<(Nanos, Nanos)>,
    pub(crate) campaign: Campaign,
    pub(crate) calm_from: Nanos,
}

impl Weather {
    fn new(plan: &FaultPlan, campaign: Campaign, calm_from: Nanos) -> Weather {
        let faults = plan.faults().to_vec();
        let stands = |fault: &&Fault| {
            fault.kind == FaultKind::ClockGap
                || fault.kind == FaultKind::Silence && fault.target == "lane.servo"
        };
        let spans = faults.iter().filter(stands).map(|fault| (fault.at, fault_end(fault)));
        let mut standstills: Vec<_> = spans.collect();
        standstills.sort_unstable();
        Weather { faults, standstills, campaign, calm_from }
    }

    /// The instant at which the servo lane has been at work for `span` since `from`: time in which
    /// it stands does not count, because a word that was due goes out at the end of it only.
    fn after_work(&self, from: Nanos, span: Nanos) -> Nanos {
        let mut end = Nanos(from.0.saturating_add(span.0));
        let mut counted = from;
        for (begin, over) in &self.standstills {
            let begin = (*begin).max(counted);
            if begin <= end && *over > begin {
                end = Nanos(end.0.saturating_add((*over - begin).0));
                counted = *over;
            }
        }
        end
    }

    /// Whether the servo lane has been at work for longer than `span` since `from`.
    pub(crate) fn has_worked(&self, from: Nanos, now: Nanos, span: Nanos) -> bool {
        now > self.after_work(from, span)
    }

    /// Whether a fault that `befalls` says is under way at `now`, or ended less than `after` of the
    /// servo lane's work ago.
    pub(crate) fn has(
        &self,
        now: Nanos,
        after: Nanos,
        befalls: impl Fn(&str, FaultKind) -> bool,
    ) -> bool {
        self.faults.iter().any(|fault| {
            befalls(&fault.target, fault.kind)
                && fault.at <= now
                && now < self.after_work(fault_end(fault), after)
        })
    }

    /// The fault that is under way at `now`, or ended less than `after` of the servo lane's work
    /// ago; `None` also where there are several.
    pub(crate) fn only_fault_about(&self, now: Nanos, after: Nanos) -> Option<&Fault> {
        let is_about =
            |fault: &&Fault| fault.at <= now && now < self.after_work(fault_end(fault), after);
        let mut about = self.faults.iter().filter(is_about);
        let only = about.next()?;
        about.next().is_none().then_some(only)
    }

    /// Whether a fault of this target is under way, or ended less than `after` ago.
    pub(crate) fn is_on(&self, target: &str, now: Nanos, after: Nanos) -> bool {
        self.has(now, after, |name, _| name == target)
    }

    /// Whether a fault of this target has begun by `now`, over or not.
    pub(crate) fn has_begun(&self, target: &str, now: Nanos) -> bool {
        self.faults.iter().any(|fault| fault.target == target && fault.at <= now)
    }

    /// Whether jobs of the servo lane may be late or left out.
    pub(crate) fn is_late(&self, now: Nanos) -> bool {
        self.has(now, LATE_AFTERMATH, |name, _| name == "lane.servo" || name == "clock")
    }

    /// Whether a task was taken out of its lane by now.
    pub(crate) fn has_panicked(&self, now: Nanos) -> bool {
        self.faults.iter().any(|fault| fault.kind == FaultKind::Panic && fault.at <= now)
    }

    /// The begin of the first fault.
    pub(crate) fn first_begin(&self) -> Nanos {
        self.faults.iter().map(|fault| fault.at).min().unwrap_or(Nanos::MAX)
    }
}

/// For how long after a late job a lane is not judged by its regular steps.
const LATE_AFTERMATH: Nanos = Nanos::from_millis(30);

/// The mode in a control word.
pub(crate) fn mode_of(tick: &Tick) -> Option<Mode> {
    tick.control.map(|control| control.mode())
}

/// The state in a control word.
pub(crate) fn state_of(tick: &Tick) -> Option<State> {
    tick.control.and_then(|control| State::from_code(control.state))
}

/// Modes in which current may flow, by this crate's own list.
pub(crate) const fn allows_torque(mode: Mode) -> bool {
    matches!(mode, Mode::Enabling | Mode::Hold | Mode::Moving | Mode::Stopping)
}

/// How much the true speeds of the joints change from job to job.
#[derive(Debug, Default)]
pub(crate) struct SpeedChange {
    /// True speeds in the job before (rad/s).
    qd_rad_s: Option<[f64; 6]>,
}

impl SpeedChange {
    /// The sizes of the changes since the job before (rad/s); zero in the first one.
    fn update(&mut self, truth: &WorldTruth) -> [f64; 6] {
        let before = self.qd_rad_s.replace(truth.qd_rad_s).unwrap_or(truth.qd_rad_s);
        core::array::from_fn(|i| (truth.qd_rad_s[i] - before[i]).abs())
    }
}

/// How near to the pin's middle, seen from above, the finger's face has a part of it below itself
/// (m): half of the pad's diagonal and of the length of the pin.
const PIN_REACH_M: f64 = 0.06;

/// How far the finger's face is below the crown of a pin that it reaches (m). The sides of the
/// simulated finger touch nothing: it may be led into the pin from there.
pub(crate) fn below_crown_m(truth: &WorldTruth) -> Option<f64> {
    let apart = |i: usize| truth.tool_m[i] - truth.pin_m[i];
    let square_m2 = apart(0) * apart(0) + apart(1) * apart(1);
    (square_m2 < PIN_REACH_M * PIN_REACH_M).then_some(-truth.gap_m)
}

/// All checkers of a run.
pub struct Judge {
    weather: Weather,
    before: Option<Tick>,
    truth: Option<WorldTruth>,
    energy: energy::Energy,
    transitions: transitions::Transitions,
    history: history::History,
    motion: motion::MotionCheck,
    reports: reports::ReportCheck,
    response: response::Response,
    runaway: runaway::RunawayCheck,
    tracking: tracking::TrackingCheck,
    dead_encoder: dead_encoder::DeadEncoderCheck,
    overload: overload::OverloadCheck,
    arm: arm::ArmCheck,
    touch: touch::TouchCheck,
    recovery: recovery::Recovery,
    start: start::StartCheck,
    /// What they found.
    pub findings: Findings,
    /// Modes and states in the order in which they came, for the coverage.
    pub path: Vec<PathPoint>,
}

/// The machine entered a mode or a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathPoint {
    /// When.
    pub at: Nanos,
    /// The mode.
    pub mode: Mode,
    /// The state.
    pub state: State,
    /// The fault that was latched first; 0 without one.
    pub first_fault: u32,
}

impl Judge {
    /// The checkers of a case, with what is known of its arm.
    #[must_use]
    pub fn new(case: &Case, arm: ArmLimits) -> Judge {
        Judge {
            weather: Weather::new(&case.plan, case.campaign, case.calm_from),
            before: None,
            truth: None,
            energy: energy::Energy::default(),
            transitions: transitions::Transitions::default(),
            history: history::History::default(),
            motion: motion::MotionCheck::new(arm.clone()),
            reports: reports::ReportCheck::default(),
            recovery: recovery::Recovery::new(arm.clone()),
            start: start::StartCheck::new(&arm),
            response: response::Response::new(arm.clone()),
            runaway: runaway::RunawayCheck::default(),
            tracking: tracking::TrackingCheck::new(&arm),
            dead_encoder: dead_encoder::DeadEncoderCheck::default(),
            overload: overload::OverloadCheck::default(),
            arm: arm::ArmCheck::new(arm),
            touch: touch::TouchCheck::default(),
            findings: Findings::default(),
            path: Vec::new(),
        }
    }

    /// Judges what can be said only at the end.
    pub fn finish(&mut self) {
        self.recovery.finish(&self.weather, &mut self.findings);
    }

    /// Whether the plan takes a task out of its lane: a panic allocates.
    #[must_use]
    pub fn has_panicked(&self) -> bool {
        self.weather.has_panicked(Nanos::MAX)
    }

    fn follow_path(&mut self, tick: &Tick) {
        let (Some(mode), Some(state)) = (mode_of(tick), state_of(tick)) else { return };
        let first_fault = tick.control.map_or(0, |control| control.first_fault);
        let point = PathPoint { at: tick.release, mode, state, first_fault };
        let same = |last: &PathPoint| {
            (last.mode, last.state, last.first_fault) == (mode, state, first_fault)
        };
        if !self.path.last().is_some_and(same) {
            self.path.push(point);
        }
    }
}

impl Witness for Judge {
    fn tick(&mut self, tick: &Tick) {
        let (weather, findings) = (&self.weather, &mut self.findings);
        let before = self.before.replace(*tick);
        self.energy.tick(tick, self.truth.as_ref(), weather, findings);
        self.arm.tick(tick, before.as_ref(), self.truth.as_ref(), weather, findings);
        if let Some(before) = &before {
            self.transitions.tick(before, tick, weather, findings);
            self.history.tick(before, tick, weather, findings);
            self.response.tick(before, tick, weather, findings);
            self.motion.tick(before, tick, weather, findings);
            self.reports.tick(before, tick, weather, findings);
        }
        if let Some(truth) = &self.truth {
            self.runaway.tick(tick, truth, weather, findings);
            self.tracking.tick(tick, truth, weather, findings);
            self.dead_encoder.tick(tick, truth, weather, findings);
            self.overload.tick(tick, truth, weather, findings);
        }
        self.touch.tick(tick, weather, findings);
        self.recovery.tick(tick, weather, findings);
        self.start.tick(tick, weather, findings);
        self.follow_path(tick);
    }

    fn touch(&mut self, touch: &Touch) {
        self.touch.frame(touch, &self.weather, &mut self.findings);
    }

    fn truth(&mut self, truth: &WorldTruth) {
        self.energy.truth(truth, &self.weather, &mut self.findings);
        self.truth = Some(*truth);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_follows_a_fault_is_counted_in_time_in_which_the_lane_works() {
        let ms = Nanos::from_millis;
        let gap: Fault = "kind=clock_gap target=clock at=1 value=0.3".parse().unwrap();
        let inverted = "kind=inversion target=digital_out.1 at=0.5 for=0.6".parse().unwrap();
        let plan = FaultPlan::new(vec![gap, inverted]);
        let weather = Weather::new(&plan, Campaign::Anything, Nanos::MAX);
        let is_on = |now| weather.is_on("digital_out", ms(now), ms(100));
        // The inversion ends at 1.1 s, within the gap: the last inverted word goes out at 1.3 s.
        assert!(!is_on(499) && is_on(1250) && is_on(1399) && !is_on(1400));
        let has_worked = |from, now| weather.has_worked(ms(from), ms(now), ms(50));
        assert!(has_worked(900, 951) && !has_worked(900, 950));
        assert!(has_worked(980, 1331) && !has_worked(980, 1330));
        assert!(has_worked(1100, 1351) && !has_worked(1100, 1350));
    }
}
